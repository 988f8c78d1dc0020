#include "compare.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/measure/image_measure.h"

static struct measure_image all_of(const struct picture *picture)
{
    return (struct measure_image){picture->values, picture->width, picture->height, 3};
}

static bool out_of_memory(struct error *error)
{
    return error_set(error, STATUS_MEMORY, "out of memory");
}

/* The pixels that count, one after the other: for measures to which it is all the same where a pixel is. */
static bool gather(const struct comparison *comparison, const struct picture *picture,
                   struct measure_image *gathered, struct error *error)
{
    size_t pixels = (size_t)picture->width * picture->height, count = 0;
    float *values = malloc(comparison->pixel_count * 3 * sizeof *values);
    if (!values)
        return out_of_memory(error);
    for (size_t i = 0; i < pixels; i++)
        if (!comparison->mask || comparison->mask[i])
            memcpy(values + 3 * count++, picture->values + 3 * i, 3 * sizeof *values);
    *gathered = (struct measure_image){values, (uint32_t)count, 1, 3};
    return true;
}

static double by_pixels(const struct options *options, enum metric metric, const struct measure_image *image,
                        const struct measure_image *reference)
{
    switch (metric) {
    case METRIC_RMSE:
        return measure_rmse(image, reference);
    case METRIC_RELRMSE:
        return measure_relative_rmse(image, reference);
    case METRIC_RELMSE:
        return measure_relmse(image, reference, options->epsilon);
    case METRIC_RELL1:
        return measure_relative_l1(image, reference);
    default:
        return measure_flux(image, reference);
    }
}

/* Their heat map: per pixel, the mean over R, G and B of what the measure adds up. */
static void map_by_pixels(struct comparison *comparison, enum metric metric)
{
    const float *a = comparison->image.values, *b = comparison->reference.values;
    size_t pixels = (size_t)comparison->image.width * comparison->image.height;
    for (size_t i = 0; i < pixels; i++) {
        double sum = 0;
        for (size_t c = 3 * i; c < 3 * i + 3; c++) {
            double truth = (double)b[c], difference = fabs((double)a[c] - truth);
            sum += metric == METRIC_RELMSE
                       ? difference * difference / (truth * truth + comparison->options->epsilon)
                       : difference;
        }
        comparison->map[i] = (float)(sum / 3);
    }
}

/* The 99th percentile of what is not 0, so that a few large values leave the others visible. */
static bool find_top(struct comparison *comparison, struct error *error)
{
    size_t pixels = (size_t)comparison->image.width * comparison->image.height, count = 0;
    double *lit = malloc(pixels * sizeof *lit);
    if (!lit)
        return out_of_memory(error);
    for (size_t i = 0; i < pixels; i++)
        if (comparison->map[i] > 0 && (!comparison->mask || comparison->mask[i]))
            lit[count++] = (double)comparison->map[i];
    comparison->map_top = measure_percentile(lit, count, 99);
    free(lit);
    return true;
}

static bool measure_ssim(struct comparison *comparison, float *map, struct error *error)
{
    struct picture *a = &comparison->image, *b = &comparison->reference;
    struct measure_image image = all_of(a), reference = all_of(b);
    struct ssim_params params = {.dynamic_range = comparison->options->ssim_range, .mask = comparison->mask};
    bool is_display = a->is_display && b->is_display;
    float *stored = NULL;
    if (is_display) { /* as the paper has it: on values as they are stored */
        size_t count = (size_t)a->width * a->height * 3;
        stored = malloc(2 * count * sizeof *stored);
        if (!stored)
            return out_of_memory(error);
        for (size_t i = 0; i < count; i++) {
            stored[i] = picture_srgb_encode(a->values[i]);
            stored[count + i] = picture_srgb_encode(b->values[i]);
        }
        image.values = stored;
        reference.values = stored + count;
        params.dynamic_range = params.dynamic_range > 0 ? params.dynamic_range : 1;
    }
    bool is_done = ssim_compare(&image, &reference, &params, map, &comparison->ssim, error);
    free(stored);
    return is_done;
}

static bool measure_fireflies_masked(struct comparison *comparison, float *map, struct error *error)
{
    struct measure_image image = all_of(&comparison->image), reference = all_of(&comparison->reference);
    size_t pixels = (size_t)image.width * image.height, count = 0;
    uint8_t *found = malloc(pixels);
    if (!found || measure_fireflies(&image, &reference, MEASURE_FIREFLY_FACTOR,
                                    comparison->options->firefly_floor, found) == SIZE_MAX) {
        free(found);
        return out_of_memory(error);
    }
    for (size_t i = 0; i < pixels; i++) {
        count += found[i] && (!comparison->mask || comparison->mask[i]);
        if (map)
            map[i] = found[i];
    }
    free(found);
    comparison->values[METRIC_FIREFLIES] = (double)count;
    return true;
}

static bool measure_flip(struct comparison *comparison, bool is_hdr, float *map, struct error *error)
{
    struct measure_image image = all_of(&comparison->image), reference = all_of(&comparison->reference);
    const struct flip_params params = {.pixels_per_degree = comparison->options->pixels_per_degree,
                                       .is_hdr = is_hdr,
                                       .mask = comparison->mask};
    return flip_compare(&image, &reference, &params, map, is_hdr ? &comparison->hdr_flip : &comparison->flip,
                        error);
}

/* `map`: NULL, or where its heat map goes. */
static bool measure_one(struct comparison *comparison, enum metric metric,
                        const struct measure_image gathered[2], float *map, struct error *error)
{
    double *value = &comparison->values[metric];
    comparison->map_top = map ? 1 : comparison->map_top;
    switch (metric) {
    case METRIC_SSIM:
        if (!measure_ssim(comparison, map, error))
            return false;
        *value = comparison->ssim.mean;
        for (size_t i = 0; map && i < (size_t)comparison->image.width * comparison->image.height; i++)
            map[i] = 1 - map[i];
        return true;
    case METRIC_FLIP:
        if (!measure_flip(comparison, false, map, error))
            return false;
        *value = comparison->flip.mean;
        return true;
    case METRIC_HDRFLIP:
        if (!measure_flip(comparison, true, map, error))
            return false;
        *value = comparison->hdr_flip.mean;
        return true;
    case METRIC_FIREFLIES:
        return measure_fireflies_masked(comparison, map, error);
    default:
        *value = by_pixels(comparison->options, metric, &gathered[0], &gathered[1]);
        if (!map)
            return true;
        map_by_pixels(comparison, metric);
        return find_top(comparison, error);
    }
}

bool compare_all(struct comparison *comparison, struct error *error)
{
    const struct options *options = comparison->options;
    struct measure_image gathered[2] = {0};
    bool is_done = gather(comparison, &comparison->image, &gathered[0], error) &&
                   gather(comparison, &comparison->reference, &gathered[1], error);
    if (is_done && options->heat_map) {
        size_t pixels = (size_t)comparison->image.width * comparison->image.height;
        comparison->map = malloc(pixels * sizeof *comparison->map);
        is_done = comparison->map || out_of_memory(error);
    }
    for (uint32_t i = 0; is_done && i < options->metric_count; i++)
        is_done = measure_one(comparison, options->metrics[i], gathered, i ? NULL : comparison->map, error);
    if (is_done && comparison->map && comparison->mask)
        for (size_t i = 0; i < (size_t)comparison->image.width * comparison->image.height; i++)
            if (!comparison->mask[i])
                comparison->map[i] = NAN;
    free((float *)gathered[0].values);
    free((float *)gathered[1].values);
    return is_done;
}

double compare_badness(const struct comparison *comparison, enum metric metric)
{
    double value = comparison->values[metric];
    return metric == METRIC_SSIM ? 1 - value : fabs(value);
}
