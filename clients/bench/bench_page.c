#include "bench_page.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/measure/heat_map.h"
#include "../lib/tone.h"
#include "../report/page.h"
#include "curves.h"

#define MAX_PICTURES 8u
#define NAME_SIZE    256u

double bench_overhead(const struct bench_results *results)
{
    double wall = 0, frame = 0;
    for (uint32_t i = 0; i < results->count; i++) {
        wall += results->results[i].wall_ns.median;
        frame += results->results[i].frame_ns.median;
    }
    return wall / frame - 1;
}

/* ---- one scene's points ----------------------------------------------------------------------------------
 */

/* The scene's points with what they are judged by; `front` by rising time. */
struct scene_points {
    uint32_t *places, *front, count, front_count;
    double *times, *errors;
};

static bool gather(const struct bench_page_params *params, const char *scene, struct scene_points *points,
                   struct error *error)
{
    size_t capacity = params->results->count + (size_t)1;
    *points = (struct scene_points){.places = calloc(2 * capacity, sizeof *points->places),
                                    .times = calloc(2 * capacity, sizeof *points->times)};
    if (!points->places || !points->times)
        return error_set(error, STATUS_MEMORY, "no memory for the report");
    points->front = points->places + capacity;
    points->errors = points->times + capacity;
    for (uint32_t i = 0; i < params->results->count; i++) {
        const struct bench_result *result = &params->results->results[i];
        if (strcmp(result->scene, scene) != 0)
            continue;
        points->places[points->count] = i;
        points->times[points->count] = bench_quantity(result, "gpu_ms");
        points->errors[points->count++] = bench_quantity(result, metric_names[params->config->judge]);
    }
    points->front_count = bench_front(points->times, points->errors, points->count, points->front);
    return true;
}

static void release(struct scene_points *points)
{
    free(points->places);
    free(points->times);
}

static const struct bench_result *point_at(const struct bench_page_params *params,
                                           const struct scene_points *points, uint32_t index)
{
    return &params->results->results[points->places[index]];
}

/* ---- curves and tables -----------------------------------------------------------------------------------
 */

static bool add_curves(struct page *page, const struct bench_page_params *params, const char *scene,
                       enum metric metric, const char *x, const char *x_label,
                       const struct scene_points *points, struct error *error)
{
    struct curves curves;
    if (!curves_make(&(struct curves_params){.config = params->config,
                                             .results = params->results,
                                             .scene = scene,
                                             .x = x,
                                             .y = metric_names[metric]},
                     &curves, error))
        return false;
    /* The front as a step behind the curves of the measure it is about. */
    double *front = points ? calloc(2 * (size_t)points->front_count + 1, sizeof *front) : NULL;
    struct plot_series *series = calloc(curves.count + (size_t)1, sizeof *series);
    uint32_t count = 0;
    if (series && front && points->front_count > 1) {
        for (uint32_t i = 0; i < points->front_count; i++) {
            front[i] = points->times[points->front[i]];
            front[points->front_count + i] = points->errors[points->front[i]];
        }
        series[count++] = (struct plot_series){.name = "Pareto front",
                                               .x = front,
                                               .y = front + points->front_count,
                                               .count = points->front_count,
                                               .has_line = true,
                                               .is_stepped = true,
                                               .style = 7};
    }
    for (uint32_t i = 0; series && i < curves.count; i++) {
        series[count] = curves.series[i];
        /* The front has the grey, the seventh, for itself. */
        series[count++].style = i % 7 < 6 ? i % 7 + 1 : 8;
    }
    if (series && curves.count > 0)
        page_plot(page, &(struct plot){.title = metric_titles[metric],
                                       .x_label = x_label,
                                       .y_label = metric_titles[metric],
                                       .is_log_x = true,
                                       .is_log_y = true,
                                       .width = 760,
                                       .series = series,
                                       .series_count = count});
    free(series);
    free(front);
    curves_free(&curves);
    return true;
}

static bool add_all_curves(struct page *page, const struct bench_page_params *params, const char *scene,
                           const struct scene_points *points, struct error *error)
{
    enum metric judge = params->config->judge;
    page_subheading(page, "Error against time on the device");
    if (!add_curves(page, params, scene, judge, "gpu_ms", "time on the device, ms", points, error))
        return false;
    page_subheading(page, "Error against photons");
    if (!add_curves(page, params, scene, judge, "photons", "photons emitted", NULL, error))
        return false;
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        if (!params->config->metrics[i] || i == judge)
            continue;
        page_details_begin(page, metric_titles[i]);
        bool is_added =
            add_curves(page, params, scene, (enum metric)i, "gpu_ms", "time on the device, ms", NULL,
                       error) &&
            add_curves(page, params, scene, (enum metric)i, "photons", "photons emitted", NULL, error);
        page_details_end(page);
        if (!is_added)
            return false;
    }
    return true;
}

static void add_front(struct page *page, const struct bench_page_params *params,
                      const struct scene_points *points)
{
    page_subheading(page, "Pareto front");
    page_paragraph(page, "No other point is both faster and nearer to the reference than one of these.");
    page_table_begin(page, (const char *const[]){"#ms", "#error", "settings"}, 3);
    for (uint32_t i = 0; i < points->front_count; i++) {
        char name[600];
        bench_result_name(point_at(params, points, points->front[i]), NULL, name, sizeof name);
        page_cell_number(page, points->times[points->front[i]]);
        page_cell_number(page, points->errors[points->front[i]]);
        page_cell(page, "%s", *name ? name : "defaults");
    }
    page_table_end(page);
}

/* Steps of 1, 2 and 5 over the times that were measured. */
static uint32_t default_budgets(const struct scene_points *points, double budgets[BENCH_MAX_BUDGETS])
{
    static const double steps[] = {1, 2, 5};
    double least = INFINITY, most = 0;
    uint32_t count = 0;
    for (uint32_t i = 0; i < points->count; i++) {
        least = fmin(least, points->times[i]);
        most = fmax(most, points->times[i]);
    }
    if (!isfinite(least) || least <= 0)
        return 0;
    for (double decade = pow(10, floor(log10(least))); count < BENCH_MAX_BUDGETS; decade *= 10)
        for (uint32_t i = 0; i < 3 && count < BENCH_MAX_BUDGETS; i++) {
            if (decade * steps[i] >= least)
                budgets[count++] = decade * steps[i];
            if (decade * steps[i] >= most)
                return count;
        }
    return count;
}

static void add_budgets(struct page *page, const struct bench_page_params *params,
                        const struct scene_points *points)
{
    double budgets[BENCH_MAX_BUDGETS];
    uint32_t count = params->config->budget_count;
    if (count > 0)
        memcpy(budgets, params->config->budgets_ms, sizeof budgets);
    else
        count = default_budgets(points, budgets);
    page_subheading(page, "Best settings for a time budget");
    page_table_begin(page, (const char *const[]){"#budget, ms", "#ms", "#error", "settings"}, 4);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t best = bench_best_within(points->times, points->errors, points->count, budgets[i]);
        char name[600] = "nothing is that fast";
        page_cell_number(page, budgets[i]);
        page_cell_number(page, best == UINT32_MAX ? NAN : points->times[best]);
        page_cell_number(page, best == UINT32_MAX ? NAN : points->errors[best]);
        if (best != UINT32_MAX)
            bench_result_name(point_at(params, points, best), NULL, name, sizeof name);
        page_cell(page, "%s", *name ? name : "defaults");
    }
    page_table_end(page);
}

static void add_points(struct page *page, const struct bench_page_params *params,
                       const struct scene_points *points)
{
    const char *columns[10 + METRIC_COUNT] = {"settings", "#gpu ms", "#quartiles", "#wall ms",
                                              "#photons", "#rays",   "#MiB"};
    uint32_t count = 7;
    char titles[METRIC_COUNT][40];
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        if (!params->config->metrics[i])
            continue;
        snprintf(titles[i], sizeof titles[i], "#%s", metric_titles[i]);
        columns[count++] = titles[i];
    }
    page_details_begin(page, "All points");
    page_table_begin(page, columns, count);
    for (uint32_t i = 0; i < points->count; i++) {
        const struct bench_result *result = point_at(params, points, i);
        char name[600], low[32], high[32];
        bench_result_name(result, NULL, name, sizeof name);
        plot_number(result->gpu_ns.low * 1e-6, low, sizeof low);
        plot_number(result->gpu_ns.high * 1e-6, high, sizeof high);
        page_cell(page, "%s", *name ? name : "defaults");
        page_cell_number(page, bench_quantity(result, "gpu_ms"));
        page_cell(page, "%s to %s", low, high);
        page_cell_number(page, bench_quantity(result, "wall_ms"));
        page_cell_number(page, bench_quantity(result, "photons"));
        page_cell_number(page, bench_quantity(result, "rays"));
        page_cell_number(page, bench_quantity(result, "memory_mib"));
        for (uint32_t k = 0; k < METRIC_COUNT; k++)
            if (params->config->metrics[k])
                page_cell_number(page, bench_quantity(result, metric_names[k]));
    }
    page_table_end(page);
    page_details_end(page);
}

/* ---- pictures and passes ---------------------------------------------------------------------------------
 */

/* The best point of every curve, at most MAX_PICTURES. */
static uint32_t choose(const struct bench_page_params *params, const struct scene_points *points,
                       uint32_t chosen[MAX_PICTURES], char names[MAX_PICTURES][NAME_SIZE])
{
    uint32_t count = 0;
    const char *axis = curve_axis(params->config);
    for (uint32_t i = 0; i < points->count; i++) {
        char name[NAME_SIZE];
        uint32_t place = 0;
        point_name(params->config, point_at(params, points, i), axis, name, sizeof name);
        while (place < count && strcmp(names[place], name) != 0)
            place++;
        if (place == MAX_PICTURES)
            continue;
        if (place < count && !(points->errors[i] < points->errors[chosen[place]]))
            continue;
        memcpy(names[place], name, sizeof name);
        chosen[place] = i;
        count += place == count;
    }
    return count;
}

static void tone(const float *values, size_t count, double exposure, uint8_t *pixels)
{
    for (size_t i = 0; i < 3 * count; i++)
        pixels[i] = tone_byte(values[i], exposure);
}

struct picture_buffers {
    uint32_t width, height;
    size_t count;
    float *truth, *map;
    uint8_t *shown, *expected, *heat;
    double exposure;
};

static void add_picture(struct page *page, const struct bench_page_params *params,
                        const struct bench_result *result, const char *name, struct picture_buffers *buffers)
{
    char path[BENCH_PATH + 128], caption[NAME_SIZE + 128], map_caption[128];
    uint32_t width, height;
    double values[METRIC_COUNT];
    struct error reason;
    snprintf(path, sizeof path, "%s/%s", params->folder, result->image);
    float *image = bench_image_read(path, &width, &height, &reason);
    if (!image || width != buffers->width || height != buffers->height) {
        page_warning(page, "The picture of \"%s\" cannot be shown: %s", name,
                     image ? "it has another size" : reason.message);
        free(image);
        return;
    }
    struct measure_image a = {image, width, height, 3}, b = {buffers->truth, width, height, 3};
    bool wanted[METRIC_COUNT] = {[METRIC_HDRFLIP] = true};
    bool has_map = metrics_compute(&a, &b, buffers->exposure, wanted, buffers->map, values, &reason);
    tone(image, buffers->count, buffers->exposure, buffers->shown);
    snprintf(caption, sizeof caption, "left: %s, %s %.4g in %.4g ms", name,
             metric_titles[params->config->judge],
             bench_quantity(result, metric_names[params->config->judge]), bench_quantity(result, "gpu_ms"));
    page_subheading(page, name);
    struct page_picture before = {caption, buffers->shown, width, height};
    struct page_picture after = {"right: the reference", buffers->expected, width, height};
    page_row_begin(page);
    page_slider(page, &before, &after);
    if (has_map) {
        heat_map_colors(buffers->map, buffers->count, 0, 1, buffers->heat);
        snprintf(map_caption, sizeof map_caption, "HDR-FLIP, black 0 to pale yellow 1; mean %.4f",
                 values[METRIC_HDRFLIP]);
        page_pictures(page, &(struct page_picture){map_caption, buffers->heat, width, height}, 1);
    } else {
        page_warning(page, "%s", reason.message);
    }
    page_row_end(page);
    free(image);
}

static bool add_pictures(struct page *page, const struct bench_page_params *params, const char *scene,
                         const struct scene_points *points, struct error *error)
{
    uint32_t chosen[MAX_PICTURES], width = 0, height = 0;
    char names[MAX_PICTURES][NAME_SIZE];
    uint32_t count = choose(params, points, chosen, names), note = 0;
    while (note < params->results->reference_count &&
           strcmp(params->results->references[note].scene, scene) != 0)
        note++;
    struct picture_buffers buffers = {0};
    struct error reason;
    page_heading(page, "Pictures");
    if (note < params->results->reference_count)
        buffers.truth = bench_image_read(params->results->references[note].file, &width, &height, &reason);
    if (!buffers.truth) {
        page_warning(page, "The reference cannot be shown: %s",
                     note < params->results->reference_count ? reason.message : "there is none");
        return true;
    }
    buffers.width = width;
    buffers.height = height;
    buffers.count = (size_t)width * height;
    buffers.exposure = tone_exposure(buffers.truth, buffers.count);
    buffers.map = malloc(buffers.count * sizeof *buffers.map);
    buffers.shown = malloc(9 * buffers.count);
    bool has_memory = buffers.map && buffers.shown;
    if (has_memory) {
        buffers.expected = buffers.shown + 3 * buffers.count;
        buffers.heat = buffers.expected + 3 * buffers.count;
        tone(buffers.truth, buffers.count, buffers.exposure, buffers.expected);
        page_paragraph(page,
                       "The best point of each curve against the reference, whose lit pixels' median is a "
                       "middle grey in all of them.");
        for (uint32_t i = 0; i < count; i++)
            add_picture(page, params, point_at(params, points, chosen[i]), names[i], &buffers);
    }
    free(buffers.truth);
    free(buffers.map);
    free(buffers.shown);
    return has_memory || error_set(error, STATUS_MEMORY, "no memory for the report's pictures");
}

static void add_passes(struct page *page, const struct bench_page_params *params,
                       const struct scene_points *points)
{
    uint32_t chosen[MAX_PICTURES], part_count = 0;
    static char names[MAX_PICTURES][NAME_SIZE];
    const char *rows[MAX_PICTURES], *parts[PROTOCOL_MAX_PASSES];
    double values[MAX_PICTURES * PROTOCOL_MAX_PASSES];
    uint32_t count = choose(params, points, chosen, names);
    for (uint32_t i = 0; i < count; i++) {
        const struct bench_result *result = point_at(params, points, chosen[i]);
        rows[i] = names[i];
        for (uint32_t k = 0; k < result->pass_count; k++) {
            uint32_t part = 0;
            while (part < part_count && strcmp(parts[part], result->passes_ns[k].name) != 0)
                part++;
            if (part == part_count && part < PROTOCOL_MAX_PASSES)
                parts[part_count++] = result->passes_ns[k].name;
        }
    }
    for (uint32_t i = 0; i < count; i++)
        for (uint32_t part = 0; part < part_count; part++) {
            char name[BENCH_TEXT + 8];
            snprintf(name, sizeof name, "pass.%s", parts[part]);
            double value = bench_quantity(point_at(params, points, chosen[i]), name);
            values[i * part_count + part] = isfinite(value) ? value : 0;
        }
    page_heading(page, "Where the time goes");
    page_paragraph(page, "Passes on the device, of the best point of each curve.");
    page_bars(page, &(struct plot_bars){.x_label = "ms",
                                        .rows = rows,
                                        .parts = parts,
                                        .row_count = count,
                                        .part_count = part_count,
                                        .values = values,
                                        .width = 900});
}

/* ---- comparison and head ---------------------------------------------------------------------------------
 */

static void add_comparison(struct page *page, const struct bench_page_params *params)
{
    const struct bench_comparison *comparison = params->comparison;
    page_heading(page, "Against an earlier run");
    page_paragraph(page, "%u points in both runs: %u worse, %u better. %u only before, %u only now.",
                   comparison->count, comparison->worse, comparison->better, comparison->only_before,
                   comparison->only_after);
    if (strcmp(params->before->server.device, params->results->server.device) != 0)
        page_warning(page, "The earlier run was on another device (%s): times do not compare.",
                     params->before->server.device);
    page_paragraph(page, "Factors: errors and time now, divided by those before.");
    const char *columns[3 + METRIC_COUNT] = {"scene", "settings", "#gpu time"};
    char titles[METRIC_COUNT][40];
    uint32_t count = 3;
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        snprintf(titles[i], sizeof titles[i], "#%s", metric_titles[i]);
        columns[count++] = titles[i];
    }
    page_table_begin(page, columns, count);
    for (uint32_t i = 0; i < comparison->count; i++) {
        const struct bench_change *change = &comparison->changes[i];
        char name[600];
        bench_result_name(&params->results->results[change->after], NULL, name, sizeof name);
        page_cell(page, "%s", params->results->results[change->after].scene);
        page_cell(page, "%s", *name ? name : "defaults");
        page_next_tone(page, change->is_gpu_worse ? PAGE_BAD : PAGE_NEUTRAL);
        page_cell(page, "%.3f", change->gpu);
        for (uint32_t k = 0; k < METRIC_COUNT; k++) {
            page_next_tone(page, change->is_error_worse[k]  ? PAGE_BAD
                                 : change->errors[k] < 0.95 ? PAGE_GOOD
                                                            : PAGE_NEUTRAL);
            if (isnan(change->errors[k]))
                page_cell(page, "–");
            else
                page_cell(page, "%.3f", change->errors[k]);
        }
    }
    page_table_end(page);
}

static void add_head(struct page *page, const struct bench_page_params *params)
{
    const struct bench_server *server = &params->results->server;
    char points[32], size[32], overhead[32];
    snprintf(points, sizeof points, "%u", params->results->count);
    snprintf(size, sizeof size, "%ux%u", params->config->width, params->config->height);
    snprintf(overhead, sizeof overhead, "%.2f %%", 100 * bench_overhead(params->results));
    page_facts(page,
               (struct page_fact[]){{"device", server->device},
                                    {"driver", server->driver},
                                    {"tracer", server->tracer},
                                    {"server", server->version},
                                    {"size", size},
                                    {"points", points},
                                    {"waiting above the server's frame time", overhead}},
               7);
    page_paragraph(page,
                   "Each point: %u warm-up frames, then %u that count; medians, with quartiles as spread. "
                   "Judged by %s.",
                   params->config->warmup, params->config->repeats, metric_titles[params->config->judge]);
    for (uint32_t i = 0; i < params->results->reference_count; i++) {
        const struct bench_reference_note *note = &params->results->references[i];
        if (isnan(note->noise))
            page_paragraph(page, "Reference of %s: %s.", note->scene, note->file);
        else
            page_paragraph(page,
                           "Reference of %s: %.3g photons, within %.2f %% (relative L1) of the truth by what "
                           "its halves differ; errors near that are its own noise.",
                           note->scene, note->photons, 100 * note->noise);
        if (!note->has_confidence)
            page_warning(page,
                         "The reference of %s ran out of photons before it reached the confidence of %.3g; "
                         "--reference-photons gives it more.",
                         note->scene, params->config->confidence);
    }
}

static bool add_scene(struct page *page, const struct bench_page_params *params, const char *scene,
                      struct error *error)
{
    struct scene_points points;
    bool is_added = gather(params, scene, &points, error);
    if (is_added && points.count > 0) {
        page_heading(page, scene);
        is_added = add_all_curves(page, params, scene, &points, error);
        add_front(page, params, &points);
        add_budgets(page, params, &points);
        add_points(page, params, &points);
        add_passes(page, params, &points);
        is_added = is_added && add_pictures(page, params, scene, &points, error);
    }
    release(&points);
    return is_added;
}

bool bench_page_write(const struct bench_page_params *params, struct error *error)
{
    char path[BENCH_PATH + 64];
    snprintf(path, sizeof path, "%s/report.html", params->folder);
    struct page *page = page_create("caustic-bench", "error against run time", error);
    if (!page)
        return false;
    add_head(page, params);
    if (params->comparison)
        add_comparison(page, params);
    bool is_written = true;
    for (uint32_t i = 0; i < params->config->scene_count && is_written; i++)
        is_written = add_scene(page, params, params->config->scenes[i].label, error);
    is_written = is_written && page_write(page, path, error);
    page_destroy(&page);
    return is_written;
}
