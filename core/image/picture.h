/* picture.h: a file's colours as linear light, for whoever compares or shows them.
 *
 * Reads PNG, JPEG, OpenEXR and Radiance HDR through image_io.h, and PFM, which not every OpenImageIO knows,
 * by itself. The format is told by the first bytes. Alpha is left aside and colours are not multiplied by it.
 */
#ifndef CAUSTIC_PICTURE_H
#define CAUSTIC_PICTURE_H

#include <stdbool.h>
#include <stdint.h>

#include "../status.h"

struct picture_params {
    const char *layer; /* "caustics": the channels caustics.R, .G and .B of an EXR. A channel of that name
                          alone is grey. NULL: R, G and B, or all that there is when that is one layer or
                          one channel. A file without layers is taken as it is */
    bool is_integer_linear; /* integers hold linear light; false: they are sRGB-encoded and are decoded */
};

/* Linear Rec. 709. Grey becomes R = G = B. */
struct picture {
    uint32_t width, height;
    float *values;   /* width * height * 3, rows from the top; may hold NaN and infinities */
    bool is_display; /* was sRGB-encoded: the light of a display whose white is 1 */
};

/* False and *error, naming the file, when it is missing, empty, damaged, larger than image_io.h's limits or
 * without such a layer; then it names those that there are. */
bool picture_read(const char *path, const struct picture_params *params, struct picture *picture,
                  struct error *error);

/* Cuts it down to `width` x `height` pixels from column x and row y. Fails when they are not inside or 0. */
bool picture_crop(struct picture *picture, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                  struct error *error);

/* Frees and zeroes. */
void picture_free(struct picture *picture);

/* IEC 61966-2-1, both ways, of 0..1; values beyond are continued. */
float picture_srgb_decode(float value);
float picture_srgb_encode(float value);

#endif
