#include "snapshot.h"

#include <stdlib.h>
#include <string.h>

#include "../../core/measure/flip.h"
#include "../../core/measure/temporal.h"
#include "../lib/tone.h"

static bool no_memory(uint32_t width, uint32_t height, struct error *error)
{
    return error_set(error, STATUS_MEMORY, "no memory for a picture of %ux%u pixels", width, height);
}

size_t snapshot_pixels(const struct snapshot *picture)
{
    return (size_t)picture->width * picture->height;
}

bool snapshot_is_black(const struct snapshot *picture)
{
    size_t i = 0, count = snapshot_pixels(picture);
    while (i < count && !(picture->luminance[i] > 0))
        i++;
    return i == count;
}

bool snapshot_make(float *rgb, uint32_t width, uint32_t height, struct snapshot *picture, struct error *error)
{
    *picture = (struct snapshot){width, height, rgb, malloc((size_t)width * height * sizeof(float))};
    if (!picture->luminance) {
        snapshot_free(picture);
        return no_memory(width, height, error);
    }
    temporal_luminance(rgb, snapshot_pixels(picture), picture->luminance);
    return true;
}

bool snapshot_copy(const struct snapshot *source, struct snapshot *target, struct error *error)
{
    size_t size = snapshot_pixels(source) * 3 * sizeof(float);
    float *rgb = malloc(size);
    if (!rgb)
        return no_memory(source->width, source->height, error);
    memcpy(rgb, source->rgb, size);
    return snapshot_make(rgb, source->width, source->height, target, error);
}

void snapshot_free(struct snapshot *picture)
{
    free(picture->rgb);
    free(picture->luminance);
    *picture = (struct snapshot){0};
}

static struct measure_image luminance_of(const struct snapshot *picture)
{
    return (struct measure_image){picture->luminance, picture->width, picture->height, 1};
}

double snapshot_error(const struct snapshot *picture, const struct snapshot *reference)
{
    struct measure_image a = luminance_of(picture), b = luminance_of(reference);
    return measure_relative_l1(&a, &b);
}

double snapshot_rms_difference(const struct snapshot *picture, const struct snapshot *reference)
{
    struct measure_image a = luminance_of(picture), b = luminance_of(reference);
    return measure_relative_rmse(&a, &b);
}

double snapshot_exposure(const struct snapshot *picture)
{
    return tone_exposure(picture->rgb, snapshot_pixels(picture));
}

/* The light that a display shows of it. */
static float *displayed(const struct snapshot *picture, double exposure)
{
    size_t values = snapshot_pixels(picture) * 3;
    float *light = malloc(values * sizeof *light);
    for (size_t i = 0; light && i < values; i++)
        light[i] = tone_linear(picture->rgb[i], exposure);
    return light;
}

bool snapshot_flip(const struct snapshot *picture, const struct snapshot *reference, double exposure,
                   double *flip, struct error *error)
{
    uint32_t width = picture->width, height = picture->height;
    float *a = displayed(picture, exposure), *b = displayed(reference, exposure);
    struct flip_result result = {0};
    bool is_done = a && b ? flip_compare(&(struct measure_image){a, width, height, 3},
                                         &(struct measure_image){b, width, height, 3},
                                         &(struct flip_params){0}, NULL, &result, error)
                          : no_memory(width, height, error);
    free(a);
    free(b);
    *flip = result.mean;
    return is_done;
}

uint8_t *snapshot_bytes(const struct snapshot *picture, double exposure, struct error *error)
{
    size_t values = snapshot_pixels(picture) * 3;
    uint8_t *bytes = malloc(values);
    if (!bytes)
        no_memory(picture->width, picture->height, error);
    for (size_t i = 0; bytes && i < values; i++)
        bytes[i] = tone_byte(picture->rgb[i], exposure);
    return bytes;
}
