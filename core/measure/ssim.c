#include "ssim.h"

#include <math.h>
#include <stdlib.h>

#define RADIUS (SSIM_WINDOW / 2)
#define SIGMA  1.5
#define K1     0.01
#define K2     0.03

/* The windowed means that the index is made of. */
enum field { FIELD_IMAGE, FIELD_REFERENCE, FIELD_SQUARES, FIELD_PRODUCT, FIELD_COUNT };

struct work {
    double window[RADIUS + 1];  /* from the centre outward; all 11 sum to 1 */
    double *image, *reference;  /* one row of luminances */
    double *moments;            /* one row before it is filtered */
    double *rows[FIELD_COUNT];  /* SSIM_WINDOW rows, filtered across; row y is at y % SSIM_WINDOW */
    double *means[FIELD_COUNT]; /* one row, filtered both ways */
};

static bool work_create(struct work *work, uint32_t width, struct error *error)
{
    double total = 0;
    for (uint32_t i = 0; i <= RADIUS; i++) {
        work->window[i] = exp(-(double)(i * i) / (2 * SIGMA * SIGMA));
        total += work->window[i] * (i ? 2 : 1);
    }
    for (uint32_t i = 0; i <= RADIUS; i++)
        work->window[i] /= total;

    size_t row_count = 3 + FIELD_COUNT * (SSIM_WINDOW + 1);
    double *memory = malloc(row_count * width * sizeof *memory);
    if (!memory)
        return error_set(error, STATUS_MEMORY, "no memory for %u pixels of SSIM", width);
    work->image = memory;
    work->reference = work->image + width;
    work->moments = work->reference + width;
    for (uint32_t field = 0; field < FIELD_COUNT; field++) {
        work->means[field] = work->moments + (1 + field) * (size_t)width;
        work->rows[field] = work->moments + (1 + FIELD_COUNT + field * SSIM_WINDOW) * (size_t)width;
    }
    return true;
}

/* Weighs a row by the window: `to` has `count` values, `from` has RADIUS more at either end. */
static void filter_across(const double *window, const double *from, double *to, uint32_t count)
{
    for (uint32_t x = 0; x < count; x++)
        to[x] = window[0] * from[x + RADIUS];
    for (uint32_t i = 1; i <= RADIUS; i++)
        for (uint32_t x = 0; x < count; x++)
            to[x] += window[i] * (from[x + RADIUS - i] + from[x + RADIUS + i]);
}

static void filter_row(struct work *work, const struct measure_image *image,
                       const struct measure_image *reference, uint32_t y)
{
    uint32_t width = image->width;
    for (uint32_t x = 0; x < width; x++) {
        size_t index = (size_t)y * width + x;
        work->image[x] = measure_luminance(image, index);
        work->reference[x] = measure_luminance(reference, index);
    }
    for (uint32_t field = 0; field < FIELD_COUNT; field++) {
        const double *a = work->image, *b = work->reference;
        for (uint32_t x = 0; x < width; x++)
            work->moments[x] = field == FIELD_IMAGE       ? a[x]
                               : field == FIELD_REFERENCE ? b[x]
                               : field == FIELD_SQUARES   ? a[x] * a[x] + b[x] * b[x]
                                                          : a[x] * b[x];
        filter_across(work->window, work->moments, work->rows[field] + (size_t)(y % SSIM_WINDOW) * width,
                      width - 2 * RADIUS);
    }
}

/* The rows around `y`, all of them filtered across, into one row of means. */
static void filter_down(struct work *work, uint32_t width, uint32_t y)
{
    uint32_t count = width - 2 * RADIUS;
    for (uint32_t field = 0; field < FIELD_COUNT; field++) {
        const double *rows = work->rows[field];
        double *to = work->means[field];
        const double *centre = rows + (size_t)(y % SSIM_WINDOW) * width;
        for (uint32_t x = 0; x < count; x++)
            to[x] = work->window[0] * centre[x];
        for (uint32_t i = 1; i <= RADIUS; i++) {
            const double *above = rows + (size_t)((y - i) % SSIM_WINDOW) * width;
            const double *below = rows + (size_t)((y + i) % SSIM_WINDOW) * width;
            for (uint32_t x = 0; x < count; x++)
                to[x] += work->window[i] * (above[x] + below[x]);
        }
    }
}

#define LIT_SHARE 0.99

/* NAN when there is no memory. */
static double reference_range(const struct measure_image *reference)
{
    size_t pixels = (size_t)reference->width * reference->height, lit = 0;
    float *luminances = malloc(pixels * sizeof *luminances);
    if (!luminances)
        return (double)NAN;
    for (size_t i = 0; i < pixels; i++) {
        luminances[i] = (float)measure_luminance(reference, i);
        lit += luminances[i] > 0 ? 1 : 0;
    }
    double range = 1;
    if (lit)
        range = (double)measure_rank_above_zero(luminances, pixels, (size_t)(LIT_SHARE * (double)(lit - 1)));
    free(luminances);
    return range;
}

bool ssim_compare(const struct measure_image *image, const struct measure_image *reference,
                  const struct ssim_params *params, float *map, struct ssim_result *result,
                  struct error *error)
{
    uint32_t width = image->width, height = image->height;
    if (width != reference->width || height != reference->height ||
        image->components != reference->components)
        return error_set(error, STATUS_INVALID, "SSIM of %ux%u pixels of %u against %ux%u of %u", width,
                         height, image->components, reference->width, reference->height,
                         reference->components);
    if (width < SSIM_WINDOW || height < SSIM_WINDOW)
        return error_set(error, STATUS_INVALID, "SSIM needs %ux%u pixels at least; these have %ux%u",
                         SSIM_WINDOW, SSIM_WINDOW, width, height);
    size_t bad = measure_non_finite_pixels(image) + measure_non_finite_pixels(reference);
    if (bad)
        return error_set(error, STATUS_INVALID, "SSIM of %zu pixels that are not finite", bad);

    double range = params->dynamic_range > 0 ? params->dynamic_range : reference_range(reference);
    if (isnan(range))
        return error_set(error, STATUS_MEMORY, "no memory for %zu luminances", (size_t)width * height);
    double c1 = K1 * range * K1 * range, c2 = K2 * range * K2 * range, total = 0;
    size_t counted = 0;
    struct work work;
    if (!work_create(&work, width, error))
        return false;
    for (size_t i = 0; map && i < (size_t)width * height; i++)
        map[i] = 1;
    for (uint32_t next = 0; next < height; next++) {
        filter_row(&work, image, reference, next);
        if (next < 2 * RADIUS)
            continue;
        uint32_t y = next - RADIUS;
        filter_down(&work, width, y);
        for (uint32_t x = 0; x < width - 2 * RADIUS; x++) {
            double a = work.means[FIELD_IMAGE][x], b = work.means[FIELD_REFERENCE][x];
            double variances =
                work.means[FIELD_SQUARES][x] - (a * a + b * b); /* so that a = b gives 1 exactly */
            double covariance = work.means[FIELD_PRODUCT][x] - a * b;
            double index =
                (2 * a * b + c1) * (2 * covariance + c2) / ((a * a + b * b + c1) * (variances + c2));
            size_t pixel = (size_t)y * width + x + RADIUS;
            if (map)
                map[pixel] = (float)index;
            if (!params->mask || params->mask[pixel]) {
                total += index;
                counted++;
            }
        }
    }
    free(work.image);
    if (!counted)
        return error_set(error, STATUS_INVALID, "the mask leaves no pixel whose SSIM window is inside");
    *result = (struct ssim_result){.mean = total / (double)counted, .dynamic_range = range};
    return true;
}
