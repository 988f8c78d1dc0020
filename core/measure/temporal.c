#include "temporal.h"

#include <math.h>
#include <stdlib.h>

#include "image_measure.h"

void temporal_luminance(const float *rgb, size_t count, float *luminance)
{
    const struct measure_image image = {.values = rgb, .components = 3};
    for (size_t i = 0; i < count; i++)
        luminance[i] = (float)measure_luminance(&image, i);
}

double temporal_caustic_threshold(const float *picture, size_t count, double share)
{
    double *lit = malloc((count ? count : 1) * sizeof *lit);
    if (!lit)
        return NAN;
    size_t lit_count = 0;
    for (size_t i = 0; i < count; i++)
        if (picture[i] > 0)
            lit[lit_count++] = (double)picture[i];
    double threshold =
        lit_count ? (share > 0 ? share : 0.02) * measure_percentile(lit, lit_count, 99) : INFINITY;
    free(lit);
    return threshold;
}

/* ---- static flicker ------------------------------------------------------------------------------------ */

struct temporal_pixels {
    uint32_t width, height, frames;
    struct moments {
        double mean, squares; /* of differences from the mean; Welford 1962 */
    } * moments;
};

struct temporal_pixels *temporal_pixels_create(uint32_t width, uint32_t height, struct error *error)
{
    struct temporal_pixels *pixels = calloc(1, sizeof *pixels);
    if (pixels) {
        *pixels =
            (struct temporal_pixels){.width = width,
                                     .height = height,
                                     .moments = calloc((size_t)width * height + 1, sizeof *pixels->moments)};
    }
    if (!pixels || !pixels->moments) {
        error_set(error, STATUS_MEMORY, "no memory for the flicker of %ux%u pixels", width, height);
        temporal_pixels_destroy(&pixels);
    }
    return pixels;
}

void temporal_pixels_destroy(struct temporal_pixels **pixels)
{
    if (*pixels)
        free((*pixels)->moments);
    free(*pixels);
    *pixels = NULL;
}

void temporal_pixels_add(struct temporal_pixels *pixels, const float *picture)
{
    size_t count = (size_t)pixels->width * pixels->height;
    double share = 1.0 / ++pixels->frames;
    for (size_t i = 0; i < count; i++) {
        struct moments *m = &pixels->moments[i];
        double before = (double)picture[i] - m->mean;
        m->mean += before * share;
        m->squares += before * ((double)picture[i] - m->mean);
    }
}

void temporal_pixels_mean(const struct temporal_pixels *pixels, float *picture)
{
    size_t count = (size_t)pixels->width * pixels->height;
    for (size_t i = 0; i < count; i++)
        picture[i] = (float)pixels->moments[i].mean;
}

bool temporal_largest_patch(const uint8_t *mask, uint32_t width, uint32_t height, uint32_t *pixels,
                            struct error *error)
{
    size_t count = (size_t)width * height;
    uint8_t *waiting = malloc(count + 1); /* pixels that no patch has yet */
    uint32_t *stack = malloc((count + 1) * sizeof *stack);
    *pixels = 0;
    if (!waiting || !stack) {
        free(waiting);
        free(stack);
        return error_set(error, STATUS_MEMORY, "no memory for the patches of %ux%u pixels", width, height);
    }
    for (size_t i = 0; i < count; i++)
        waiting[i] = mask[i] != 0;
    for (uint32_t seed = 0; seed < count; seed++) {
        if (!waiting[seed])
            continue;
        uint32_t top = 0, size = 0;
        stack[top++] = seed;
        waiting[seed] = 0;
        while (top > 0) {
            uint32_t at = stack[--top], x = at % width, y = at / width;
            size++;
            for (uint32_t j = y ? y - 1 : 0; j <= y + 1 && j < height; j++) {
                for (uint32_t i = x ? x - 1 : 0; i <= x + 1 && i < width; i++) {
                    uint32_t near = j * width + i;
                    if (waiting[near]) {
                        waiting[near] = 0;
                        stack[top++] = near;
                    }
                }
            }
        }
        *pixels = size > *pixels ? size : *pixels;
    }
    free(waiting);
    free(stack);
    return true;
}

/* Memory for the relative deviations of all caustic pixels, and for where they flicker. */
static bool measure_flicker(const struct temporal_pixels *pixels, double share, double limit, float *map,
                            struct temporal_flicker *flicker, double *relative, uint8_t *mask, float *mean,
                            struct error *error)
{
    size_t count = (size_t)pixels->width * pixels->height;
    temporal_pixels_mean(pixels, mean);
    flicker->threshold = temporal_caustic_threshold(mean, count, share);
    if (isnan(flicker->threshold))
        return error_set(error, STATUS_MEMORY, "no memory for the flicker of %zu pixels", count);
    double sum = 0;
    for (size_t i = 0; i < count; i++) {
        const struct moments *m = &pixels->moments[i];
        bool is_caustic = (double)mean[i] >= flicker->threshold;
        double deviation = is_caustic ? sqrt(m->squares / (pixels->frames - 1)) / m->mean : 0;
        mask[i] = deviation > limit;
        if (map)
            map[i] = (float)deviation;
        if (!is_caustic)
            continue;
        relative[flicker->caustic_pixels++] = deviation;
        flicker->flickering_pixels += mask[i];
        flicker->largest = fmax(flicker->largest, deviation);
        sum += deviation;
    }
    if (flicker->caustic_pixels) {
        flicker->mean = sum / flicker->caustic_pixels;
        flicker->p95 = measure_percentile(relative, flicker->caustic_pixels, 95);
        flicker->p99 = measure_percentile(relative, flicker->caustic_pixels, 99);
    }
    return temporal_largest_patch(mask, pixels->width, pixels->height, &flicker->largest_patch, error);
}

bool temporal_flicker(const struct temporal_pixels *pixels, const struct temporal_flicker_params *params,
                      float *map, struct temporal_flicker *flicker, struct error *error)
{
    size_t count = (size_t)pixels->width * pixels->height;
    *flicker = (struct temporal_flicker){.frames = pixels->frames};
    if (pixels->frames < 2)
        return error_set(error, STATUS_INVALID, "%u frames are too few to measure flicker; it takes 2",
                         pixels->frames);
    double *relative = malloc((count + 1) * sizeof *relative);
    uint8_t *mask = malloc(count + 1);
    float *mean = calloc(count + 1, sizeof *mean);
    bool is_done =
        relative && mask && mean
            ? measure_flicker(pixels, params->caustic_share, params->limit > 0 ? params->limit : 0.005, map,
                              flicker, relative, mask, mean, error)
            : error_set(error, STATUS_MEMORY, "no memory for the flicker of %zu pixels", count);
    free(relative);
    free(mask);
    free(mean);
    return is_done;
}

/* ---- differences and steps ----------------------------------------------------------------------------- */

/* Of sums of squares; nothing of nothing is 0. */
static double root_share(double part, double whole)
{
    return whole > 0 ? sqrt(part / whole) : part > 0 ? (double)INFINITY : 0;
}

void temporal_difference(const float *before, const float *now, const float *reference_before,
                         const float *reference_now, size_t count, struct temporal_difference *difference)
{
    double wrong = 0, change = 0, light = 0;
    for (size_t i = 0; i < count; i++) {
        double own = (double)reference_now[i] - (double)reference_before[i];
        double off = (double)now[i] - (double)before[i] - own;
        wrong += off * off;
        change += own * own;
        light += (double)reference_now[i] * (double)reference_now[i];
    }
    double pixels = count ? (double)count : 1;
    *difference = (struct temporal_difference){
        .rmse = sqrt(wrong / pixels),
        .reference_change = sqrt(change / pixels),
        .relative = root_share(wrong, light),
        .relative_change = root_share(change, light),
    };
}

double temporal_remaining(const float *picture, const float *old, const float *settled, size_t count)
{
    double rest = 0, whole = 0;
    for (size_t i = 0; i < count; i++) {
        rest += fabs((double)picture[i] - (double)settled[i]);
        whole += fabs((double)old[i] - (double)settled[i]);
    }
    return whole > 0 ? rest / whole : NAN;
}

double temporal_ghost(const float *picture, const float *old, const float *settled, size_t count,
                      double threshold)
{
    double rest = 0, whole = 0;
    for (size_t i = 0; i < count; i++) {
        if ((double)old[i] < threshold || (double)settled[i] >= threshold)
            continue;
        rest += fmax((double)picture[i] - (double)settled[i], 0);
        whole += (double)old[i] - (double)settled[i];
    }
    return whole > 0 ? rest / whole : NAN;
}
