/* image_io.h: image files in and out. The only user of OpenImageIO, behind a C header.
 *
 * Read: PNG, JPEG, OpenEXR and Radiance HDR from memory, told apart by their first bytes, never by a name.
 * Written: OpenEXR (32-bit float channels with any names) and 8-bit PNG. A build without CAUSTICD_IMAGES has
 * all of these and each answers STATUS_UNSUPPORTED. Threads: any; calls do not share state.
 */
#ifndef CAUSTIC_IMAGE_IO_H
#define CAUSTIC_IMAGE_IO_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#include "../status.h"

/* ---- textures ----------------------------------------------------------------------------------------- */

struct image_decode_params {
    const char *name;    /* for error texts; NULL: "image" */
    uint32_t max_size;   /* pixels along a side; 0: 8192. Checked before anything is decoded */
    uint64_t max_texels; /* 0: max_size squared. Likewise */
    bool is_srgb; /* 8- and 16-bit colour is sRGB-encoded and is decoded; float images are linear already */
};

/* RGBA half floats, linear, row 0 at the top. Grey becomes R = G = B; a missing alpha is 1. */
struct image_texels {
    uint32_t width, height;
    uint16_t *texels;         /* width * height * 4, malloc'ed; the caller frees */
    uint64_t nonfinite_count; /* NaN and infinite components, passed on as they are */
};

bool image_decode(const void *bytes, size_t size, const struct image_decode_params *params,
                  struct image_texels *texels, struct error *error);

/* ---- float planes ------------------------------------------------------------------------------------- */

#define IMAGE_CHANNEL_NAME_SIZE 64u

/* One channel: `name` as EXR has it ("R", "caustics.G", "Z"), values in rows from the top, tight. */
struct image_plane {
    char name[IMAGE_CHANNEL_NAME_SIZE];
    const float *values;
};

enum image_attribute_type {
    IMAGE_ATTRIBUTE_STRING,
    IMAGE_ATTRIBUTE_FLOAT,
    IMAGE_ATTRIBUTE_INT,
    IMAGE_ATTRIBUTE_MATRIX
};

struct image_attribute {
    const char *name;
    enum image_attribute_type type;
    const char *string;
    double number; /* FLOAT and INT */
    const float
        *matrix; /* 16, column-major as in the renderer; EXR's own order (row vectors) has the same bytes */
};

struct image_write_params {
    uint32_t width, height;
    const struct image_plane *planes; /* stored in EXR's order, by name */
    uint32_t plane_count;             /* at least 1 */
    const struct image_attribute *attributes;
    uint32_t attribute_count;
};

/* Zip-compressed. Written under a temporary name beside `path` and renamed, so that a file is whole or
 * absent. */
bool image_write_exr(const char *path, const struct image_write_params *params, struct error *error);

/* 8-bit PNG of 1, 3 or 4 interleaved components, rows from the top, values as they are to be stored
 * (sRGB-encoded by the caller). Likewise whole or absent. */
bool image_write_png(const char *path, uint32_t width, uint32_t height, uint32_t components,
                     const uint8_t *pixels, struct error *error);

struct image_file {
    uint32_t width, height, plane_count;
    bool is_integer;            /* stored as integers: the planes hold 0..1, most likely sRGB-encoded */
    struct image_plane *planes; /* in the file's order */
    float *values;              /* of all planes */
};

/* Limits of what is read: a file's header alone must not decide how much memory is asked for. */
#define IMAGE_MAX_SIDE   16384
#define IMAGE_MAX_VALUES (1ull << 29) /* pixels times channels */

/* Every channel of an EXR file. NULL and *error when it is missing, damaged or beyond the limits. */
struct image_file *image_read_exr(const char *path, struct error *error);
/* Likewise of a PNG, JPEG, EXR or HDR file, whatever its name says. */
struct image_file *image_read_planes(const char *path, struct error *error);
/* The named channel's values, or NULL. */
const float *image_file_plane(const struct image_file *file, const char *name);
/* A string attribute, or a matrix (16 floats): false when the file has none of that name and type. */
bool image_read_exr_string(const char *path, const char *name, char *text, size_t size, struct error *error);
bool image_read_exr_matrix(const char *path, const char *name, float matrix[16], struct error *error);
void image_file_destroy(struct image_file **file);

/* ---- half floats -------------------------------------------------------------------------------------- */

uint16_t image_half_from_float(float value); /* to nearest, ties to even; beyond 65504 becomes infinity */
float image_half_to_float(uint16_t half);

#ifdef __cplusplus
}
#endif
#endif
