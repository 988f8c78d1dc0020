/* caustic-diff: how far an image is from a reference. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "../../core/image/image_io.h"
#include "../../core/measure/heat_map.h"
#include "compare.h"
#include "options.h"

enum { EXIT_MEASURED = 0, EXIT_ABOVE = 1, EXIT_UNMEASURED = 2 };

/* ---- reading ----------------------------------------------------------------------------------------------
 */

/* Both pictures, cropped; the sizes are compared before that. */
static bool read_pictures(struct comparison *comparison, struct error *error)
{
    const struct options *options = comparison->options;
    const struct picture_params params = {.layer = options->layer,
                                          .is_integer_linear = options->is_integer_linear};
    struct picture *a = &comparison->image, *b = &comparison->reference;
    if (!picture_read(options->image, &params, a, error) ||
        !picture_read(options->reference, &params, b, error))
        return false;
    if (a->width != b->width || a->height != b->height)
        return error_set(error, STATUS_INVALID,
                         "%s has %ux%u pixels and %s has %ux%u; they must be the same size", options->image,
                         a->width, a->height, options->reference, b->width, b->height);
    return true;
}

/* A PNG's values as they are stored: half is half whatever its encoding means. */
static bool read_mask(const struct comparison *comparison, struct picture *mask, struct error *error)
{
    const char *path = comparison->options->mask;
    const struct picture *image = &comparison->image;
    if (!picture_read(path, &(struct picture_params){.is_integer_linear = true}, mask, error))
        return false;
    if (mask->width != image->width || mask->height != image->height)
        return error_set(error, STATUS_INVALID, "the mask %s has %ux%u pixels and %s has %ux%u", path,
                         mask->width, mask->height, comparison->options->image, image->width, image->height);
    return true;
}

static bool crop(const struct comparison *comparison, struct picture *picture, struct error *error)
{
    const struct options *options = comparison->options;
    struct error reason;
    if (!options->has_crop || picture_crop(picture, options->crop[0], options->crop[1], options->crop[2],
                                           options->crop[3], &reason))
        return true;
    return error_set(error, STATUS_INVALID, "--crop: %s", reason.message);
}

static bool check_finite(const char *path, const struct picture *picture, struct error *error)
{
    const struct measure_image image = {picture->values, picture->width, picture->height, 3};
    size_t bad = measure_non_finite_pixels(&image), first = 0;
    if (!bad)
        return true;
    while (isfinite(picture->values[first]))
        first++;
    first /= 3;
    return error_set(error, STATUS_INVALID,
                     "%s: %zu of %zu pixels are NaN or infinite, the first at %zu,%zu; nothing is measured",
                     path, bad, (size_t)picture->width * picture->height, first % picture->width,
                     first / picture->width);
}

static bool make_mask(struct comparison *comparison, const struct picture *mask, struct error *error)
{
    size_t pixels = (size_t)mask->width * mask->height;
    const struct measure_image image = {mask->values, mask->width, mask->height, 3};
    comparison->mask = malloc(pixels);
    if (!comparison->mask)
        return error_set(error, STATUS_MEMORY, "out of memory");
    comparison->pixel_count = 0;
    for (size_t i = 0; i < pixels; i++) {
        comparison->mask[i] = measure_luminance(&image, i) > 0.5;
        comparison->pixel_count += comparison->mask[i];
    }
    return comparison->pixel_count ||
           error_set(error, STATUS_INVALID, "the mask %s leaves no pixel: none is above half",
                     comparison->options->mask);
}

static bool load(struct comparison *comparison, struct error *error)
{
    const struct options *options = comparison->options;
    struct picture mask = {0};
    bool is_loaded =
        read_pictures(comparison, error) && (!options->mask || read_mask(comparison, &mask, error)) &&
        crop(comparison, &comparison->image, error) && crop(comparison, &comparison->reference, error) &&
        (!options->mask || crop(comparison, &mask, error)) &&
        check_finite(options->image, &comparison->image, error) &&
        check_finite(options->reference, &comparison->reference, error) &&
        (!options->mask || check_finite(options->mask, &mask, error));
    comparison->pixel_count = (size_t)comparison->image.width * comparison->image.height;
    is_loaded = is_loaded && (!options->mask || make_mask(comparison, &mask, error));
    picture_free(&mask);
    return is_loaded;
}

static void choose_metrics(struct options *options, const struct comparison *comparison)
{
    bool is_display = comparison->image.is_display && comparison->reference.is_display;
    if (!options->metric_count) {
        static const enum metric usual[] = {METRIC_RMSE, METRIC_RELL1, METRIC_FLUX, METRIC_SSIM};
        for (size_t i = 0; i < sizeof usual / sizeof *usual; i++)
            options_add_metric(options, usual[i]);
        options_add_metric(options, is_display ? METRIC_FLIP : METRIC_HDRFLIP);
    }
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        if (isfinite(options->limits[i]))
            options_add_metric(options, (enum metric)i);
}

/* ---- reporting --------------------------------------------------------------------------------------------
 */

static double limit_of(const struct options *options, enum metric metric)
{
    return isfinite(options->limits[metric]) ? options->limits[metric] : options->limit;
}

static bool is_above(const struct comparison *comparison, enum metric metric)
{
    return compare_badness(comparison, metric) > limit_of(comparison->options, metric);
}

static bool write_heat_map(const struct comparison *comparison, struct error *error)
{
    uint32_t width = comparison->image.width, height = comparison->image.height;
    size_t pixels = (size_t)width * height;
    uint8_t *rgb = malloc(pixels * 3);
    if (!rgb)
        return error_set(error, STATUS_MEMORY, "out of memory");
    heat_map_colors(comparison->map, pixels, 0, comparison->map_top, rgb);
    bool is_written = image_write_png(comparison->options->heat_map, width, height, 3, rgb, error);
    free(rgb);
    return is_written;
}

/* Remarks on one value: what it was measured with, and what an infinite one means. */
static void describe(const struct comparison *comparison, enum metric metric, char *text, size_t size)
{
    const struct flip_exposures *exposures = &comparison->hdr_flip.exposures;
    *text = 0;
    if (!isfinite(comparison->values[metric]))
        snprintf(text, size, "the reference is black");
    else if (metric == METRIC_HDRFLIP)
        snprintf(text, size, "%u exposures from %.2f to %.2f stops, largest %.4f", exposures->count,
                 exposures->start, exposures->stop, comparison->hdr_flip.largest);
    else if (metric == METRIC_FLIP)
        snprintf(text, size, "largest %.4f", comparison->flip.largest);
    else if (metric == METRIC_SSIM)
        snprintf(text, size, "dynamic range %.6g", comparison->ssim.dynamic_range);
    else if (metric == METRIC_RELMSE)
        snprintf(text, size, "epsilon %g", comparison->options->epsilon);
}

static void print_table(const struct comparison *comparison)
{
    const struct options *options = comparison->options;
    printf("%s against %s: %ux%u pixels", options->image, options->reference, comparison->image.width,
           comparison->image.height);
    if (options->mask)
        printf(", %zu of them by the mask", comparison->pixel_count);
    printf("\n");
    for (uint32_t i = 0; i < options->metric_count; i++) {
        enum metric metric = options->metrics[i];
        char remark[160];
        describe(comparison, metric, remark, sizeof remark);
        if (metric == METRIC_FIREFLIES)
            printf("  %-10s %-12.0f", metric_names[metric], comparison->values[metric]);
        else
            printf("  %-10s %-12.6g", metric_names[metric], comparison->values[metric]);
        if (is_above(comparison, metric))
            printf(" above %g%s", limit_of(options, metric), *remark ? "; " : "");
        printf("%s%s\n", *remark && !is_above(comparison, metric) ? " " : "", remark);
    }
    if (options->heat_map)
        printf("%s shows %s%s from 0 to %.6g\n", options->heat_map,
               options->metrics[0] == METRIC_SSIM ? "1 - " : "", metric_names[options->metrics[0]],
               comparison->map_top);
}

static bool is_measured(const struct options *options, enum metric metric)
{
    for (uint32_t i = 0; i < options->metric_count; i++)
        if (options->metrics[i] == metric)
            return true;
    return false;
}

static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static void print_json(const struct comparison *comparison)
{
    const struct options *options = comparison->options;
    json_t *root =
        json_pack("{s:s, s:s, s:i, s:i, s:I, s:s?}", "image", options->image, "reference", options->reference,
                  "width", (int)comparison->image.width, "height", (int)comparison->image.height, "pixels",
                  (json_int_t)comparison->pixel_count, "layer", options->layer);
    json_t *values = json_object(), *remarks = json_object(), *above = json_array();
    for (uint32_t i = 0; i < options->metric_count; i++) {
        enum metric metric = options->metrics[i];
        const char *name = metric_names[metric];
        char remark[160];
        json_object_set_new(values, name,
                            metric == METRIC_FIREFLIES ? json_integer((json_int_t)comparison->values[metric])
                                                       : number(comparison->values[metric]));
        describe(comparison, metric, remark, sizeof remark);
        if (*remark)
            json_object_set_new(remarks, name, json_string(remark));
        if (is_above(comparison, metric))
            json_array_append_new(above, json_string(name));
    }
    json_object_set_new(root, "metrics", values);
    json_object_set_new(root, "remarks", remarks);
    json_object_set_new(root, "above", above);
    if (is_measured(options, METRIC_HDRFLIP)) {
        const struct flip_exposures *exposures = &comparison->hdr_flip.exposures;
        json_object_set_new(root, "exposures",
                            json_pack("{s:f, s:f, s:i}", "start", exposures->start, "stop", exposures->stop,
                                      "count", (int)exposures->count));
    }
    if (is_measured(options, METRIC_SSIM))
        json_object_set_new(root, "ssim_range", json_real(comparison->ssim.dynamic_range));
    if (options->heat_map)
        json_object_set_new(root, "heatmap",
                            json_pack("{s:s, s:s, s:o}", "file", options->heat_map, "metric",
                                      metric_names[options->metrics[0]], "top", number(comparison->map_top)));
    json_dumpf(root, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    printf("\n");
    json_decref(root);
}

static int fail(const struct options *options, const struct error *error)
{
    fprintf(stderr, "caustic-diff: %s\n", error->message);
    if (options->is_json) {
        json_t *root = json_pack("{s:s}", "error", error->message);
        json_dumpf(root, stdout, JSON_INDENT(2));
        printf("\n");
        json_decref(root);
    }
    return EXIT_UNMEASURED;
}

int main(int argc, char **argv)
{
    struct options options;
    struct error error;
    if (!options_parse(argc, argv, &options, &error)) {
        fprintf(stderr, "caustic-diff: %s\ncaustic-diff --help tells more\n", error.message);
        return EXIT_UNMEASURED;
    }
    if (options.is_help) {
        fputs(diff_help, stdout);
        return 0;
    }
    struct comparison comparison = {.options = &options};
    int status = EXIT_MEASURED;
    bool is_done = load(&comparison, &error);
    if (is_done) {
        choose_metrics(&options, &comparison);
        is_done =
            compare_all(&comparison, &error) && (!options.heat_map || write_heat_map(&comparison, &error));
    }
    if (!is_done) {
        status = fail(&options, &error);
    } else {
        (options.is_json ? print_json : print_table)(&comparison);
        for (uint32_t i = 0; i < options.metric_count; i++)
            if (is_above(&comparison, options.metrics[i]))
                status = EXIT_ABOVE;
    }
    free(comparison.mask);
    free(comparison.map);
    picture_free(&comparison.image);
    picture_free(&comparison.reference);
    if (fflush(stdout) != 0) {
        fprintf(stderr, "caustic-diff: cannot write the result: %s\n", strerror(errno));
        return EXIT_UNMEASURED;
    }
    return status;
}
