#include "picture.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "image_io.h"

float picture_srgb_decode(float value)
{
    return value <= 0.04045f ? value / 12.92f : powf((value + 0.055f) / 1.055f, 2.4f);
}

float picture_srgb_encode(float value)
{
    return value <= 0.0031308f ? value * 12.92f : 1.055f * powf(value, 1 / 2.4f) - 0.055f;
}

static bool allocate(struct picture *picture, const char *path, uint32_t width, uint32_t height,
                     struct error *error)
{
    *picture = (struct picture){.width = width, .height = height};
    picture->values = malloc((size_t)width * height * 3 * sizeof *picture->values);
    return picture->values ||
           error_set(error, STATUS_MEMORY, "%s: no memory for %ux%u pixels", path, width, height);
}

/* ---- PFM ------------------------------------------------------------------------------------------------
 */

/* "PF" (colour) or "Pf" (grey), width, height and a scale whose sign gives the byte order, each ended by
 * white space, then rows from the bottom. */
static bool read_pfm(const char *path, FILE *file, struct picture *picture, struct error *error)
{
    char kind, end;
    int width, height;
    float scale;
    if (fscanf(file, "P%c %d %d %f%c", &kind, &width, &height, &scale, &end) != 5 ||
        !strchr(" \t\r\n", end) || width < 1 || height < 1 || scale == 0 || !isfinite(scale))
        return error_set(error, STATUS_INVALID, "%s: damaged PFM header", path);
    if (width > IMAGE_MAX_SIDE || height > IMAGE_MAX_SIDE)
        return error_set(error, STATUS_LIMIT, "%s has %d x %d pixels; the most is %d x %d", path, width,
                         height, IMAGE_MAX_SIDE, IMAGE_MAX_SIDE);
    size_t components = kind == 'F' ? 3 : 1, row_bytes = (size_t)width * components * 4;
    long start = ftell(file);
    if (fseek(file, 0, SEEK_END) != 0 || start < 0 || ftell(file) < start)
        return error_set(error, STATUS_IO, "%s cannot be read: %s", path, strerror(errno));
    if ((uint64_t)(ftell(file) - start) < (uint64_t)row_bytes * (uint64_t)height)
        return error_set(error, STATUS_INVALID, "%s: the PFM is truncated", path);
    fseek(file, start, SEEK_SET);
    unsigned char *row = malloc(row_bytes);
    if (!row || !allocate(picture, path, (uint32_t)width, (uint32_t)height, error)) {
        free(row);
        return error_set(error, STATUS_MEMORY, "%s: no memory for %dx%d pixels", path, width, height);
    }
    bool is_read = true;
    for (size_t y = (size_t)height; is_read && y-- > 0;) {
        is_read = fread(row, 1, row_bytes, file) == row_bytes;
        float *to = picture->values + y * (size_t)width * 3;
        for (size_t i = 0; i < (size_t)width * 3; i++) {
            const unsigned char *b = row + (components == 3 ? i : i / 3) * 4;
            uint32_t bits = scale < 0
                                ? (uint32_t)b[3] << 24 | (uint32_t)b[2] << 16 | (uint32_t)b[1] << 8 | b[0]
                                : (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
            memcpy(&to[i], &bits, sizeof bits);
        }
    }
    free(row);
    if (!is_read)
        picture_free(picture);
    return is_read || error_set(error, STATUS_IO, "%s cannot be read: %s", path, strerror(errno));
}

/* ---- layers ---------------------------------------------------------------------------------------------
 */

static const float *plane_of(const struct image_file *file, const char *layer, const char *channel)
{
    char name[2 * IMAGE_CHANNEL_NAME_SIZE];
    snprintf(name, sizeof name, "%s%s%s", layer, *layer ? "." : "", channel);
    return image_file_plane(file, name);
}

/* Its R, G and B, or X, Y and Z. */
static bool pick_three(const struct image_file *file, const char *layer, const float *planes[3])
{
    static const char *const names[2][3] = {{"R", "G", "B"}, {"X", "Y", "Z"}};
    for (int set = 0; set < 2; set++) {
        for (int c = 0; c < 3; c++)
            planes[c] = plane_of(file, layer, names[set][c]);
        if (planes[0] && planes[1] && planes[2])
            return true;
    }
    return false;
}

/* The part before the last dot, empty for a plain channel. */
static void layer_of(const char *channel, char layer[IMAGE_CHANNEL_NAME_SIZE])
{
    const char *dot = strrchr(channel, '.');
    snprintf(layer, IMAGE_CHANNEL_NAME_SIZE, "%.*s", dot ? (int)(dot - channel) : 0, channel);
}

/* What --layer could name: layers and plain channels, comma-separated. Returns how many layers there are. */
static uint32_t list_layers(const struct image_file *file, char *list, size_t size)
{
    uint32_t layers = 0;
    size_t length = 0;
    *list = 0;
    for (uint32_t i = 0; i < file->plane_count; i++) {
        char layer[IMAGE_CHANNEL_NAME_SIZE], before[IMAGE_CHANNEL_NAME_SIZE];
        layer_of(file->planes[i].name, layer);
        bool is_known = false;
        for (uint32_t j = 0; *layer && j < i && !is_known; j++) {
            layer_of(file->planes[j].name, before);
            is_known = strcmp(layer, before) == 0;
        }
        if (is_known)
            continue;
        layers += *layer != 0;
        if (length < size)
            length += (size_t)snprintf(list + length, size - length, "%s%s", length ? ", " : "",
                                       *layer ? layer : file->planes[i].name);
    }
    return layers;
}

static bool pick_planes(const char *path, const struct image_file *file, const char *layer,
                        const float *planes[3], struct error *error)
{
    char list[300], only[IMAGE_CHANNEL_NAME_SIZE] = "";
    uint32_t layers = list_layers(file, list, sizeof list);
    if (layer && layers) {
        if (pick_three(file, layer, planes))
            return true;
        planes[0] = planes[1] = planes[2] = image_file_plane(file, layer);
        return planes[0] ||
               error_set(error, STATUS_NOT_FOUND, "%s has no layer \"%s\"; it has %s", path, layer, list);
    }
    if (pick_three(file, "", planes))
        return true;
    if (file->plane_count <= 2 && !layers) { /* grey, grey and alpha */
        planes[0] = planes[1] = planes[2] = file->planes[0].values;
        return true;
    }
    for (uint32_t i = 0; i < file->plane_count && !*only; i++)
        layer_of(file->planes[i].name, only);
    if (layers == 1 && pick_three(file, only, planes))
        return true;
    return error_set(error, STATUS_NOT_FOUND, "%s has no channels R, G and B; name one of %s", path, list);
}

bool picture_read(const char *path, const struct picture_params *params, struct picture *picture,
                  struct error *error)
{
    *picture = (struct picture){0};
    FILE *stream = fopen(path, "rb");
    char magic[3] = {0};
    bool is_pfm = stream && fread(magic, 1, 3, stream) == 3 && magic[0] == 'P' &&
                  (magic[1] == 'F' || magic[1] == 'f') && strchr(" \t\r\n", magic[2]);
    if (is_pfm) {
        rewind(stream);
        bool is_read = read_pfm(path, stream, picture, error);
        fclose(stream);
        return is_read;
    }
    if (stream)
        fclose(stream);

    struct image_file *file = image_read_planes(path, error);
    const float *planes[3];
    bool is_read = file && pick_planes(path, file, params->layer, planes, error) &&
                   allocate(picture, path, file->width, file->height, error);
    if (is_read) {
        picture->is_display = file->is_integer && !params->is_integer_linear;
        size_t pixels = (size_t)file->width * file->height;
        for (size_t i = 0; i < pixels; i++)
            for (size_t c = 0; c < 3; c++) {
                float value = planes[c][i];
                picture->values[3 * i + c] = picture->is_display ? picture_srgb_decode(value) : value;
            }
    }
    image_file_destroy(&file);
    return is_read;
}

bool picture_crop(struct picture *picture, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                  struct error *error)
{
    if (!width || !height || x > picture->width || width > picture->width - x || y > picture->height ||
        height > picture->height - y)
        return error_set(error, STATUS_INVALID, "%ux%u pixels from %u,%u are not within %ux%u", width, height,
                         x, y, picture->width, picture->height);
    for (uint32_t row = 0; row < height; row++)
        memmove(picture->values + (size_t)row * width * 3,
                picture->values + ((size_t)(y + row) * picture->width + x) * 3,
                (size_t)width * 3 * sizeof *picture->values);
    picture->width = width;
    picture->height = height;
    return true;
}

void picture_free(struct picture *picture)
{
    free(picture->values);
    *picture = (struct picture){0};
}
