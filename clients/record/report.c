#include "report.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef CAUSTIC_VERSION
#error "the build names the version"
#endif

#define NAME_SIZE 64u

struct pass_times {
    char name[NAME_SIZE];
    double *elapsed_ns; /* per frame; NaN where the frame had no such pass */
};

struct report {
    const struct protocol_hello *hello;
    json_t *root, *frames;
    uint32_t frame_count, frame_capacity, pass_count;
    struct pass_times passes[PROTOCOL_MAX_PASSES];
    double *statistics; /* per frame, in HELLO's order */
};

/* ---- JSON --------------------------------------------------------------------------------------------- */

static json_t *json_text(struct protocol_text text)
{
    return json_stringn(text.length ? text.bytes : "", text.length);
}

/* Whole numbers as such, so that counts read as counts. */
static json_t *json_value(double value)
{
    if (!isfinite(value))
        return json_null();
    return value == floor(value) && fabs(value) < 0x1p53 ? json_integer((json_int_t)value) : json_real(value);
}

static json_t *json_floats(const float *values, size_t count)
{
    json_t *array = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(array, json_value((double)values[i]));
    return array;
}

static json_t *json_camera(const struct protocol_camera *camera)
{
    json_t *object = json_object();
    json_object_set_new(object, "eye", json_floats(camera->eye, 3));
    json_object_set_new(object, "at", json_floats(camera->at, 3));
    json_object_set_new(object, "up", json_floats(camera->up, 3));
    json_object_set_new(object, "fov", json_value((double)camera->fov));
    return object;
}

static void set(json_t *object, struct protocol_text name, json_t *value)
{
    char key[PROTOCOL_MAX_TEXT_BYTES + 1];
    protocol_text_copy(name, key, sizeof key);
    json_object_set_new(object, key, value);
}

static json_t *json_settings(const struct protocol_hello *hello, const double *values)
{
    json_t *object = json_object();
    for (uint32_t i = 0; i < hello->setting_count; i++) {
        const struct protocol_setting *setting = &hello->settings[i];
        char text[64];
        client_setting_print(setting, values[i], text, sizeof text);
        json_t *value = setting->type == PROTOCOL_CHOICE ? json_string(text)
                        : setting->type == PROTOCOL_BOOL ? json_boolean(values[i] != 0)
                                                         : json_value(values[i]);
        set(object, setting->name, value);
    }
    return object;
}

static json_t *json_lights(const struct record_options *options)
{
    json_t *object = json_object();
    for (uint32_t i = 0; i < options->light_count; i++) {
        const struct record_light *light = &options->lights[i];
        json_t *change = json_object();
        if (light->change.overrides & PROTOCOL_LIGHT_INTENSITY)
            json_object_set_new(change, "intensity", json_floats(light->change.intensity, 3));
        if (light->change.overrides & PROTOCOL_LIGHT_POSITION)
            json_object_set_new(change, "position", json_floats(light->change.position, 3));
        if (light->change.overrides & PROTOCOL_LIGHT_DIRECTION)
            json_object_set_new(change, "direction", json_floats(light->change.direction, 3));
        json_object_set_new(object, light->name, change);
    }
    return object;
}

static json_t *json_head(const struct protocol_hello *hello, const struct record_options *options,
                         const double *values)
{
    json_t *server = json_object(), *scene = json_object(), *view = json_object(), *units = json_object();
    json_object_set_new(server, "version", json_text(hello->version));
    json_object_set_new(server, "device", json_text(hello->device));
    json_object_set_new(server, "driver", json_text(hello->driver));
    json_object_set_new(server, "tracer", json_text(hello->tracer));
    json_object_set_new(scene, "name", json_text(hello->scene));
    json_object_set_new(scene, "triangles", json_integer(hello->triangles));
    json_object_set_new(scene, "duration", json_value(hello->duration));
    json_object_set_new(view, "width", json_integer(options->width));
    json_object_set_new(view, "height", json_integer(options->height));
    json_object_set_new(view, "camera",
                        options->camera_name ? json_string(options->camera_name) : json_null());
    json_object_set_new(view, "path", options->path_file ? json_string(options->path_file) : json_null());
    json_object_set_new(view, "frames", json_integer(options->frames));
    json_object_set_new(view, "warmup", json_integer(options->warmup));
    json_object_set_new(view, "time", json_value(options->time));
    json_object_set_new(view, "fps", json_value(options->rate));
    for (uint32_t i = 0; i < hello->statistic_count; i++)
        set(units, hello->statistics[i].name, json_text(hello->statistics[i].unit));
    json_t *root = json_object();
    json_object_set_new(root, "program", json_string("caustic-record"));
    json_object_set_new(root, "version", json_string(CAUSTIC_VERSION));
    json_object_set_new(root, "server", server);
    json_object_set_new(root, "scene", scene);
    json_object_set_new(root, "view", view);
    json_object_set_new(root, "settings", json_settings(hello, values));
    json_object_set_new(root, "lights", json_lights(options));
    json_object_set_new(root, "units", units);
    return root;
}

static bool begins_with(struct protocol_text text, const char *start)
{
    return text.length > strlen(start) && memcmp(text.bytes, start, strlen(start)) == 0;
}

static struct protocol_text without(struct protocol_text text, const char *start)
{
    return (struct protocol_text){text.bytes + strlen(start), (uint16_t)(text.length - strlen(start))};
}

static void add_statistics(const struct protocol_hello *hello, const struct protocol_frame *info,
                           json_t *object)
{
    json_t *statistics = json_object(), *flux = json_object(), *guards = json_object();
    for (uint32_t i = 0; i < info->statistic_count && i < hello->statistic_count; i++) {
        struct protocol_text name = hello->statistics[i].name;
        set(statistics, name, json_value(info->statistics[i]));
        if (begins_with(name, "flux_"))
            set(flux, without(name, "flux_"), json_value(info->statistics[i]));
        if (begins_with(name, "guard_"))
            set(guards, without(name, "guard_"), json_value(info->statistics[i]));
    }
    json_object_set_new(object, "statistics", statistics);
    json_object_set_new(object, "flux_by_fate", flux);
    json_object_set_new(object, "guards", guards);
}

static json_t *json_frame(const struct protocol_hello *hello, const struct client_frame *frame,
                          uint32_t number, const char *file, uint64_t request_ns)
{
    const struct protocol_frame *info = &frame->info;
    json_t *object = json_object(), *passes = json_object(), *plan = json_array(), *channels = json_array();
    json_object_set_new(object, "number", json_integer(number));
    json_object_set_new(object, "frame", json_integer((json_int_t)info->frame));
    json_object_set_new(object, "file", *file ? json_string(file) : json_null());
    json_object_set_new(object, "time", json_value(info->time));
    json_object_set_new(object, "request_ns", json_integer((json_int_t)request_ns));
    json_object_set_new(object, "camera", json_camera(&info->camera));
    json_object_set_new(object, "world_to_camera", json_floats(info->world_to_camera, 16));
    json_object_set_new(object, "camera_to_clip", json_floats(info->camera_to_clip, 16));
    for (uint32_t i = 0; i < info->pass_count; i++)
        set(passes, info->passes[i].name, json_integer((json_int_t)info->passes[i].elapsed_ns));
    json_object_set_new(object, "passes_ns", passes);
    add_statistics(hello, info, object);
    for (uint32_t i = 0; i < info->plan_count; i++) {
        json_t *line = json_object();
        json_object_set_new(line, "name", json_text(info->plan[i].name));
        json_object_set_new(line, "used", json_boolean(info->plan[i].is_used));
        json_object_set_new(line, "reason", json_text(info->plan[i].reason));
        json_array_append_new(plan, line);
    }
    json_object_set_new(object, "plan", plan);
    for (uint32_t i = 0; i < info->channel_count; i++) {
        const struct protocol_channel *channel = &info->channels[i];
        json_t *entry = json_object();
        json_object_set_new(entry, "name",
                            channel->channel < hello->channel_count
                                ? json_text(hello->channels[channel->channel].name)
                                : json_integer(channel->channel));
        json_object_set_new(entry, "format", json_string(channel->format == PROTOCOL_F16 ? "f16" : "f32"));
        json_object_set_new(entry, "bytes", json_integer(channel->bytes));
        json_object_set_new(entry, "clamped", json_integer(channel->clamped));
        json_object_set_new(entry, "not_a_number", json_integer(channel->not_a_number));
        json_array_append_new(channels, entry);
    }
    json_object_set_new(object, "channels", channels);
    json_object_set_new(object, "black_reason",
                        info->black_reason.length ? json_text(info->black_reason) : json_null());
    return object;
}

/* ---- the public face ---------------------------------------------------------------------------------- */

struct report *report_create(const struct protocol_hello *hello, const struct record_options *options,
                             const double *values, struct error *error)
{
    struct report *report = calloc(1, sizeof *report);
    if (report) {
        report->hello = hello;
        report->frame_capacity = options->frames;
        report->root = json_head(hello, options, values);
        report->frames = json_array();
        report->statistics =
            calloc((size_t)options->frames * hello->statistic_count + 1, sizeof *report->statistics);
    }
    if (!report || !report->root || !report->frames || !report->statistics) {
        error_set(error, STATUS_MEMORY, "no memory for the statistics of %u frames", options->frames);
        report_destroy(&report);
        return NULL;
    }
    json_object_set(report->root, "frames", report->frames);
    return report;
}

void report_destroy(struct report **report)
{
    if (*report) {
        for (uint32_t i = 0; i < (*report)->pass_count; i++)
            free((*report)->passes[i].elapsed_ns);
        free((*report)->statistics);
        json_decref((*report)->frames);
        json_decref((*report)->root);
        free(*report);
    }
    *report = NULL;
}

static bool add_pass(struct report *report, const struct protocol_pass *pass, struct error *error)
{
    uint32_t i = 0;
    while (i < report->pass_count && !protocol_text_equals(pass->name, report->passes[i].name))
        i++;
    if (i == report->pass_count) {
        if (i == PROTOCOL_MAX_PASSES || pass->name.length >= NAME_SIZE)
            return true; /* stats.json has it; the table need not */
        double *times = malloc(report->frame_capacity * sizeof *times);
        if (!times)
            return error_set(error, STATUS_MEMORY, "no memory for the times of %u frames",
                             report->frame_capacity);
        for (uint32_t frame = 0; frame < report->frame_capacity; frame++)
            times[frame] = NAN;
        protocol_text_copy(pass->name, report->passes[i].name, NAME_SIZE);
        report->passes[i].elapsed_ns = times;
        report->pass_count++;
    }
    report->passes[i].elapsed_ns[report->frame_count] = (double)pass->elapsed_ns;
    return true;
}

bool report_add(struct report *report, const struct client_frame *frame, uint32_t number, const char *file,
                uint64_t request_ns, struct error *error)
{
    if (report->frame_count == report->frame_capacity)
        return error_set(error, STATUS_LIMIT, "the report has room for %u frames", report->frame_capacity);
    for (uint32_t i = 0; i < frame->info.pass_count; i++)
        if (!add_pass(report, &frame->info.passes[i], error))
            return false;
    uint32_t count = report->hello->statistic_count;
    for (uint32_t i = 0; i < count; i++)
        report->statistics[(size_t)report->frame_count * count + i] =
            i < frame->info.statistic_count ? frame->info.statistics[i] : NAN;
    report->frame_count++;
    return json_array_append_new(report->frames,
                                 json_frame(report->hello, frame, number, file, request_ns)) == 0 ||
           error_set(error, STATUS_MEMORY, "no memory for the statistics of frame %u", number);
}

bool report_write(const struct report *report, const char *path, struct error *error)
{
    char temporary[4200];
    if (snprintf(temporary, sizeof temporary, "%s.part", path) >= (int)sizeof temporary)
        return error_set(error, STATUS_INVALID, "%.100s...: the name is too long", path);
    if (json_dump_file(report->root, temporary, JSON_INDENT(2) | JSON_REAL_PRECISION(17)) != 0 ||
        rename(temporary, path) != 0) {
        int reason = errno;
        remove(temporary);
        return error_set(error, STATUS_IO, "%.300s: %s", path, strerror(reason));
    }
    return true;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Of the values that are numbers; NaN when none is. Reorders `values`. */
static double median(double *values, uint32_t count)
{
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i++)
        if (isfinite(values[i]))
            values[kept++] = values[i];
    if (kept == 0)
        return NAN;
    qsort(values, kept, sizeof *values, compare_doubles);
    return kept % 2 ? values[kept / 2] : (values[kept / 2 - 1] + values[kept / 2]) / 2;
}

static void print_statistic(const struct protocol_statistic *statistic, double value, FILE *stream)
{
    int length = statistic->name.length;
    bool is_named_ns = length > 3 && memcmp(statistic->name.bytes + length - 3, "_ns", 3) == 0;
    if (protocol_text_equals(statistic->unit, "ns"))
        fprintf(stream, "  %-26.*s %14.3f  ms\n", is_named_ns ? length - 3 : length, statistic->name.bytes,
                value * 1e-6);
    else if (value == floor(value))
        fprintf(stream, "  %-26.*s %14.0f  %.*s\n", statistic->name.length, statistic->name.bytes, value,
                statistic->unit.length, statistic->unit.bytes);
    else
        fprintf(stream, "  %-26.*s %14.6g  %.*s\n", statistic->name.length, statistic->name.bytes, value,
                statistic->unit.length, statistic->unit.bytes);
}

void report_print(const struct report *report, FILE *stream)
{
    double *values = malloc((report->frame_count + 1) * sizeof *values);
    double medians[PROTOCOL_MAX_PASSES], total = 0;
    if (!values || report->frame_count == 0) {
        free(values);
        return;
    }
    for (uint32_t i = 0; i < report->pass_count; i++) {
        memcpy(values, report->passes[i].elapsed_ns, report->frame_count * sizeof *values);
        medians[i] = median(values, report->frame_count);
        total += medians[i];
    }
    fprintf(stream, "  %-26s %14s  share\n", "pass", "median ms");
    for (uint32_t i = 0; i < report->pass_count; i++)
        fprintf(stream, "  %-26s %14.3f  %4.1f %%\n", report->passes[i].name, medians[i] * 1e-6,
                total > 0 ? medians[i] / total * 100 : 0);
    fprintf(stream, "  %-26s %14.3f\n\n  %-26s %14s  unit\n", "all passes", total * 1e-6, "statistic",
            "median");
    uint32_t count = report->hello->statistic_count, guards = 0, silent = 0;
    for (uint32_t i = 0; i < count; i++) {
        const struct protocol_statistic *statistic = &report->hello->statistics[i];
        for (uint32_t frame = 0; frame < report->frame_count; frame++)
            values[frame] = report->statistics[(size_t)frame * count + i];
        double value = median(values, report->frame_count);
        bool is_guard = begins_with(statistic->name, "guard_");
        guards += is_guard;
        silent += is_guard && value == 0;
        if (!is_guard || value != 0)
            print_statistic(statistic, value, stream);
    }
    if (guards)
        fprintf(stream, "  %u of %u guards had nothing to repair\n", silent, guards);
    free(values);
}
