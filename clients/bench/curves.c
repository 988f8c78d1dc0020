#include "curves.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NAME_SIZE 256u

static bool is_number(const char *text)
{
    char *end;
    strtod(text, &end);
    return end != text && !*end;
}

static uint32_t numbers_of(const struct bench_axis *axis)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < axis->count; i++)
        count += is_number(axis->values[i]);
    return count;
}

const char *curve_axis(const struct bench_config *config)
{
    const char *first = "";
    if (*config->curve)
        return config->curve;
    for (uint32_t i = 0; i < config->axis_count; i++) {
        if (numbers_of(&config->axes[i]) < 2)
            continue;
        if (strcmp(config->axes[i].name, "photons") == 0)
            return "photons";
        if (!*first)
            first = config->axes[i].name;
    }
    return first;
}

void point_name(const struct bench_config *config, const struct bench_result *result, const char *without,
                char *text, size_t size)
{
    size_t used = (size_t)snprintf(text, size, "%s", result->method);
    for (uint32_t i = 0; i < config->axis_count && used < size; i++) {
        const struct bench_axis *axis = &config->axes[i];
        const char *value = bench_result_setting(result, axis->name);
        if (!value || axis->count < 2 || (without && strcmp(axis->name, without) == 0))
            continue;
        used += (size_t)snprintf(text + used, size - used, "%s%s=%s", used ? " " : "", axis->name, value);
    }
    if (used == 0)
        snprintf(text, size, "%s", config->axis_count ? "all" : "defaults");
}

/* ---- curves ----------------------------------------------------------------------------------------------
 */

struct curve_point {
    uint32_t series;
    double x, y;
    char label[NAME_SIZE];
};

static int compare_points(const void *a, const void *b)
{
    const struct curve_point *p = a, *q = b;
    if (p->series != q->series)
        return p->series < q->series ? -1 : 1;
    return (p->x > q->x) - (p->x < q->x);
}

struct curve_memory {
    struct curve_point *points;
    char (*names)[NAME_SIZE];
    double *numbers;
    const char **labels;
};

static void free_memory(struct curve_memory *memory)
{
    if (!memory)
        return;
    free(memory->points);
    free(memory->names);
    free(memory->numbers);
    free(memory->labels);
    free(memory);
}

void curves_free(struct curves *curves)
{
    free(curves->series);
    free_memory(curves->memory);
    *curves = (struct curves){0};
}

static bool is_shown(const char *wanted, const char *name)
{
    return !wanted || !*wanted || strcmp(wanted, name) == 0;
}

/* The place of `name` among those that are known, new ones at the end. */
static uint32_t series_of(struct curve_memory *memory, uint32_t *count, const char *name)
{
    uint32_t i = 0;
    while (i < *count && strncmp(memory->names[i], name, 250) != 0)
        i++;
    if (i == *count)
        snprintf(memory->names[(*count)++], NAME_SIZE, "%.250s", name);
    return i;
}

static uint32_t collect(const struct curves_params *params, struct curve_memory *memory, uint32_t *series)
{
    uint32_t count = 0;
    const char *axis = curve_axis(params->config);
    bool has_scenes = (!params->scene || !*params->scene) && params->config->scene_count > 1;
    for (uint32_t i = 0; i < params->results->count; i++) {
        const struct bench_result *result = &params->results->results[i];
        struct curve_point *point = &memory->points[count];
        char name[NAME_SIZE], whole[NAME_SIZE + BENCH_TEXT + 1];
        if (!is_shown(params->scene, result->scene) || !is_shown(params->method, result->method))
            continue;
        point->x = bench_quantity(result, params->x);
        point->y = bench_quantity(result, params->y);
        if (!isfinite(point->x) || !isfinite(point->y))
            continue;
        point_name(params->config, result, axis, name, sizeof name);
        if (has_scenes && strcmp(name, "all") == 0)
            snprintf(whole, sizeof whole, "%s", result->scene);
        else
            snprintf(whole, sizeof whole, "%s%s%s", has_scenes ? result->scene : "", has_scenes ? " " : "",
                     name);
        point->series = series_of(memory, series, whole);
        const char *value = bench_result_setting(result, axis);
        snprintf(point->label, sizeof point->label, "%s%s%s", axis, *axis ? "=" : "", value ? value : "");
        count++;
    }
    return count;
}

bool curves_make(const struct curves_params *params, struct curves *curves, struct error *error)
{
    size_t capacity = params->results->count + (size_t)1;
    struct curve_memory *memory = calloc(1, sizeof *memory);
    *curves = (struct curves){.memory = memory, .series = calloc(capacity, sizeof *curves->series)};
    if (memory) {
        memory->points = calloc(capacity, sizeof *memory->points);
        memory->names = calloc(capacity, sizeof *memory->names);
        memory->numbers = calloc(2 * capacity, sizeof *memory->numbers);
        memory->labels = calloc(capacity, sizeof *memory->labels);
    }
    if (!memory || !curves->series || !memory->points || !memory->names || !memory->numbers ||
        !memory->labels) {
        curves_free(curves);
        return error_set(error, STATUS_MEMORY, "no memory for a plot");
    }
    uint32_t count = collect(params, memory, &curves->count);
    qsort(memory->points, count, sizeof *memory->points, compare_points);
    for (uint32_t i = 0; i < count; i++) {
        struct plot_series *series = &curves->series[memory->points[i].series];
        if (series->count++ == 0)
            *series = (struct plot_series){.name = memory->names[memory->points[i].series],
                                           .x = memory->numbers + i,
                                           .y = memory->numbers + capacity + i,
                                           .count = 1,
                                           .labels = memory->labels + i,
                                           .has_line = true,
                                           .has_marks = true};
        memory->numbers[i] = memory->points[i].x;
        memory->numbers[capacity + i] = memory->points[i].y;
        memory->labels[i] = memory->points[i].label;
    }
    return true;
}

/* ---- the configuration's plots ---------------------------------------------------------------------------
 */

static const char *or_else(const char *text, const char *other)
{
    return *text ? text : other;
}

static bool write_curves(const struct bench_config *config, const struct bench_results *results,
                         const struct bench_plot *wanted, const char *path, struct error *error)
{
    struct curves curves;
    if (!curves_make(&(struct curves_params){.config = config,
                                             .results = results,
                                             .scene = wanted->scene,
                                             .method = wanted->method,
                                             .x = wanted->x,
                                             .y = wanted->y},
                     &curves, error))
        return false;
    struct plot plot = {.title = *wanted->title ? wanted->title : NULL,
                        .x_label = or_else(wanted->x_label, wanted->x),
                        .y_label = or_else(wanted->y_label, wanted->y),
                        .is_log_x = wanted->is_log_x,
                        .is_log_y = wanted->is_log_y,
                        .is_zero_based = !wanted->is_log_y,
                        .series = curves.series,
                        .series_count = curves.count};
    bool is_written = curves.count > 0
                          ? plot_write_file(path, &plot, error)
                          : error_set(error, STATUS_INVALID, "%.300s: no point has both %.60s and %.60s",
                                      path, wanted->x, wanted->y);
    curves_free(&curves);
    return is_written;
}

struct bar_rows {
    char names[BENCH_MAX_VALUES][NAME_SIZE], parts[PROTOCOL_MAX_PASSES][BENCH_TEXT];
    const char *row_pointers[BENCH_MAX_VALUES], *part_pointers[PROTOCOL_MAX_PASSES];
    const struct bench_result *results[BENCH_MAX_VALUES];
    double values[BENCH_MAX_VALUES * PROTOCOL_MAX_PASSES];
    uint32_t row_count, part_count;
};

static void collect_bars(const struct bench_config *config, const struct bench_results *results,
                         const struct bench_plot *wanted, struct bar_rows *rows)
{
    for (uint32_t i = 0; i < results->count && rows->row_count < BENCH_MAX_VALUES; i++) {
        const struct bench_result *result = &results->results[i];
        if (!is_shown(wanted->scene, result->scene) || !is_shown(wanted->method, result->method))
            continue;
        point_name(config, result, NULL, rows->names[rows->row_count], NAME_SIZE);
        rows->row_pointers[rows->row_count] = rows->names[rows->row_count];
        rows->results[rows->row_count++] = result;
        for (uint32_t k = 0; k < result->pass_count; k++) {
            uint32_t part = 0;
            while (part < rows->part_count && strcmp(rows->parts[part], result->passes_ns[k].name) != 0)
                part++;
            if (part == rows->part_count && part < PROTOCOL_MAX_PASSES) {
                snprintf(rows->parts[part], BENCH_TEXT, "%s", result->passes_ns[k].name);
                rows->part_pointers[part] = rows->parts[part];
                rows->part_count++;
            }
        }
    }
    for (uint32_t row = 0; row < rows->row_count; row++) {
        double total = bench_quantity(rows->results[row], "passes_ms");
        for (uint32_t part = 0; part < rows->part_count; part++) {
            char name[BENCH_TEXT + 8];
            snprintf(name, sizeof name, "pass.%s", rows->parts[part]);
            double value = bench_quantity(rows->results[row], name);
            value = isfinite(value) ? value : 0;
            rows->values[row * rows->part_count + part] = wanted->is_share ? 100 * value / total : value;
        }
    }
}

static bool write_bars(const struct bench_config *config, const struct bench_results *results,
                       const struct bench_plot *wanted, const char *path, struct error *error)
{
    struct bar_rows *rows = calloc(1, sizeof *rows);
    if (!rows)
        return error_set(error, STATUS_MEMORY, "no memory for a plot");
    collect_bars(config, results, wanted, rows);
    struct plot_bars bars = {.title = *wanted->title ? wanted->title : NULL,
                             .x_label = wanted->is_share ? "% of all passes" : "ms",
                             .rows = rows->row_pointers,
                             .parts = rows->part_pointers,
                             .row_count = rows->row_count,
                             .part_count = rows->part_count,
                             .values = rows->values};
    bool is_written = rows->row_count > 0
                          ? plot_bars_write_file(path, &bars, error)
                          : error_set(error, STATUS_INVALID, "%.300s: there are no such points", path);
    free(rows);
    return is_written;
}

bool curves_write_plot(const struct bench_config *config, const struct bench_results *results,
                       const struct bench_plot *plot, const char *folder, struct error *error)
{
    char path[BENCH_PATH + 128];
    snprintf(path, sizeof path, "%s/plots/%s", folder, plot->file);
    return plot->is_bars ? write_bars(config, results, plot, path, error)
                         : write_curves(config, results, plot, path, error);
}
