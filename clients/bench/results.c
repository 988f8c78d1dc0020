#include "results.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FORMAT 1

/* ---- in memory -------------------------------------------------------------------------------------------
 */

void bench_results_begin(struct bench_results *results)
{
    memset(results, 0, sizeof *results);
}

void bench_results_free(struct bench_results *results)
{
    free(results->results);
    memset(results, 0, sizeof *results);
}

bool bench_results_add(struct bench_results *results, const struct bench_result *result, struct error *error)
{
    if (results->count == results->capacity) {
        uint32_t capacity = results->capacity ? 2 * results->capacity : 64;
        struct bench_result *grown = realloc(results->results, capacity * sizeof *grown);
        if (!grown)
            return error_set(error, STATUS_MEMORY, "no memory for %u points", capacity);
        results->results = grown;
        results->capacity = capacity;
    }
    results->results[results->count++] = *result;
    return true;
}

const struct bench_result *bench_results_find(const struct bench_results *results, const char *key)
{
    for (uint32_t i = 0; i < results->count; i++)
        if (strcmp(results->results[i].key, key) == 0)
            return &results->results[i];
    return NULL;
}

struct bench_spread bench_spread_of(double *values, uint32_t count)
{
    if (count == 0)
        return (struct bench_spread){NAN, NAN, NAN, NAN};
    for (uint32_t i = 0; i < count; i++)
        if (isnan(values[i]))
            return (struct bench_spread){NAN, NAN, NAN, NAN};
    return (struct bench_spread){.median = measure_percentile(values, count, 50),
                                 .low = measure_percentile(values, count, 25),
                                 .high = measure_percentile(values, count, 75),
                                 .least = measure_percentile(values, count, 0)};
}

const char *bench_result_setting(const struct bench_result *result, const char *name)
{
    for (uint32_t i = 0; i < result->setting_count; i++)
        if (strcmp(result->settings[i].name, name) == 0)
            return result->settings[i].value;
    return NULL;
}

void bench_result_name(const struct bench_result *result, const char *without, char *text, size_t size)
{
    size_t used = (size_t)snprintf(text, size, "%s", result->method);
    for (uint32_t i = 0; i < result->setting_count && used < size; i++)
        if (!without || strcmp(result->settings[i].name, without) != 0)
            used += (size_t)snprintf(text + used, size - used, "%s%s=%s", used ? " " : "",
                                     result->settings[i].name, result->settings[i].value);
}

/* ---- to JSON ---------------------------------------------------------------------------------------------
 */

static json_t *number_of(double value)
{
    if (!isfinite(value))
        return json_null();
    return value == floor(value) && fabs(value) < 0x1p53 ? json_integer((json_int_t)value) : json_real(value);
}

static json_t *spread_to(const struct bench_spread *spread)
{
    json_t *object = json_object();
    json_object_set_new(object, "median", number_of(spread->median));
    json_object_set_new(object, "low", number_of(spread->low));
    json_object_set_new(object, "high", number_of(spread->high));
    json_object_set_new(object, "least", number_of(spread->least));
    return object;
}

static json_t *numbers_to(const struct bench_number *numbers, uint32_t count)
{
    json_t *object = json_object();
    for (uint32_t i = 0; i < count; i++)
        json_object_set_new(object, numbers[i].name, number_of(numbers[i].value));
    return object;
}

static json_t *result_to(const struct bench_result *result)
{
    json_t *object = json_object(), *settings = json_object(), *measures = json_object();
    for (uint32_t i = 0; i < result->setting_count; i++)
        json_object_set_new(settings, result->settings[i].name, json_string(result->settings[i].value));
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        if (!isnan(result->measures[i].median))
            json_object_set_new(measures, metric_names[i], spread_to(&result->measures[i]));
    json_object_set_new(object, "key", json_string(result->key));
    json_object_set_new(object, "scene", json_string(result->scene));
    json_object_set_new(object, "method", json_string(result->method));
    json_object_set_new(object, "settings", settings);
    json_object_set_new(object, "width", json_integer(result->width));
    json_object_set_new(object, "height", json_integer(result->height));
    json_object_set_new(object, "time", number_of(result->time));
    json_object_set_new(object, "reference", json_string(result->reference));
    json_object_set_new(object, "image", json_string(result->image));
    json_object_set_new(object, "gpu_ns", spread_to(&result->gpu_ns));
    json_object_set_new(object, "wall_ns", spread_to(&result->wall_ns));
    json_object_set_new(object, "frame_ns", spread_to(&result->frame_ns));
    json_object_set_new(object, "measures", measures);
    json_object_set_new(object, "statistics", numbers_to(result->statistics, result->statistic_count));
    json_object_set_new(object, "passes_ns", numbers_to(result->passes_ns, result->pass_count));
    return object;
}

static json_t *results_to(const struct bench_results *results)
{
    json_t *root = json_object(), *server = json_object(), *references = json_array(), *points = json_array();
    json_object_set_new(server, "version", json_string(results->server.version));
    json_object_set_new(server, "device", json_string(results->server.device));
    json_object_set_new(server, "driver", json_string(results->server.driver));
    json_object_set_new(server, "tracer", json_string(results->server.tracer));
    json_object_set_new(server, "build", json_string(results->server.build));
    for (uint32_t i = 0; i < results->reference_count; i++) {
        const struct bench_reference_note *note = &results->references[i];
        json_t *object = json_object();
        json_object_set_new(object, "key", json_string(note->key));
        json_object_set_new(object, "scene", json_string(note->scene));
        json_object_set_new(object, "file", json_string(note->file));
        json_object_set_new(object, "photons", number_of(note->photons));
        json_object_set_new(object, "noise", number_of(note->noise));
        json_object_set_new(object, "has_confidence", json_boolean(note->has_confidence));
        json_array_append_new(references, object);
    }
    for (uint32_t i = 0; i < results->count; i++)
        json_array_append_new(points, result_to(&results->results[i]));
    json_object_set_new(root, "program", json_string("caustic-bench"));
    json_object_set_new(root, "version", json_string(CAUSTIC_VERSION));
    json_object_set_new(root, "format", json_integer(FORMAT));
    json_object_set_new(root, "server", server);
    json_object_set_new(root, "references", references);
    json_object_set_new(root, "points", points);
    return root;
}

bool bench_results_write(const struct bench_results *results, const char *path, struct error *error)
{
    char part[BENCH_PATH + 64];
    snprintf(part, sizeof part, "%.*s.part", (int)BENCH_PATH, path);
    json_t *root = results_to(results);
    errno = 0;
    bool is_written = root && json_dump_file(root, part, JSON_INDENT(1) | JSON_REAL_PRECISION(10)) == 0;
    is_written = is_written && rename(part, path) == 0;
    int reason = errno;
    json_decref(root);
    if (is_written)
        return true;
    remove(part);
    return error_set(error, STATUS_IO, "%.300s: %s", path,
                     reason ? strerror(reason) : "could not be written whole");
}

/* ---- from JSON -------------------------------------------------------------------------------------------
 */

/* Reads as far as the file makes sense; the first thing that does not is named. */
struct reading {
    const char *path;
    char where[64];
    bool is_broken;
    struct error *error;
};

static void broken(struct reading *reading, const char *field)
{
    if (!reading->is_broken)
        error_set(reading->error, STATUS_INVALID,
                  "%.200s: %s%s%s is missing or not what caustic-bench writes", reading->path, reading->where,
                  *reading->where ? "." : "", field);
    reading->is_broken = true;
}

static json_t *field_of(struct reading *reading, json_t *object, const char *name)
{
    json_t *value = json_object_get(object, name);
    if (!value)
        broken(reading, name);
    return value;
}

static double number_from(struct reading *reading, json_t *object, const char *name)
{
    json_t *value = field_of(reading, object, name);
    if (json_is_null(value))
        return NAN;
    if (!json_is_number(value))
        broken(reading, name);
    return json_number_value(value);
}

static uint32_t count_from(struct reading *reading, json_t *object, const char *name)
{
    double value = number_from(reading, object, name);
    if (!(value >= 0 && value <= 1e9)) {
        broken(reading, name);
        return 0;
    }
    return (uint32_t)value;
}

static void text_from(struct reading *reading, json_t *object, const char *name, char *text, size_t size)
{
    const char *value = json_string_value(field_of(reading, object, name));
    if (!value || strlen(value) >= size)
        broken(reading, name);
    else
        memcpy(text, value, strlen(value) + 1);
}

static struct bench_spread spread_from(struct reading *reading, json_t *parent, const char *name)
{
    json_t *object = field_of(reading, parent, name);
    if (!json_is_object(object)) {
        broken(reading, name);
        return (struct bench_spread){NAN, NAN, NAN, NAN};
    }
    return (struct bench_spread){number_from(reading, object, "median"), number_from(reading, object, "low"),
                                 number_from(reading, object, "high"), number_from(reading, object, "least")};
}

static uint32_t numbers_from(struct reading *reading, json_t *parent, const char *name,
                             struct bench_number *numbers, uint32_t capacity)
{
    json_t *object = field_of(reading, parent, name), *value;
    const char *key;
    uint32_t count = 0;
    if (!json_is_object(object))
        broken(reading, name);
    json_object_foreach(object, key, value)
    {
        if (count == capacity || strlen(key) >= BENCH_TEXT ||
            !(json_is_number(value) || json_is_null(value))) {
            broken(reading, name);
            break;
        }
        snprintf(numbers[count].name, BENCH_TEXT, "%s", key);
        numbers[count++].value = json_is_null(value) ? NAN : json_number_value(value);
    }
    return count;
}

static void result_from(struct reading *reading, json_t *object, struct bench_result *result)
{
    const char *key;
    json_t *value;
    text_from(reading, object, "key", result->key, sizeof result->key);
    text_from(reading, object, "scene", result->scene, sizeof result->scene);
    text_from(reading, object, "method", result->method, sizeof result->method);
    text_from(reading, object, "reference", result->reference, sizeof result->reference);
    text_from(reading, object, "image", result->image, sizeof result->image);
    result->width = count_from(reading, object, "width");
    result->height = count_from(reading, object, "height");
    result->time = number_from(reading, object, "time");
    result->gpu_ns = spread_from(reading, object, "gpu_ns");
    result->wall_ns = spread_from(reading, object, "wall_ns");
    result->frame_ns = spread_from(reading, object, "frame_ns");
    json_object_foreach(field_of(reading, object, "settings"), key, value)
    {
        struct option_setting *setting = &result->settings[result->setting_count];
        if (result->setting_count == BENCH_MAX_SET || strlen(key) >= sizeof setting->name ||
            !json_is_string(value) || json_string_length(value) >= sizeof setting->value) {
            broken(reading, "settings");
            break;
        }
        snprintf(setting->name, sizeof setting->name, "%s", key);
        snprintf(setting->value, sizeof setting->value, "%s", json_string_value(value));
        result->setting_count++;
    }
    json_t *measures = field_of(reading, object, "measures");
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        result->measures[i] = json_object_get(measures, metric_names[i])
                                  ? spread_from(reading, measures, metric_names[i])
                                  : (struct bench_spread){NAN, NAN, NAN, NAN};
    result->statistic_count =
        numbers_from(reading, object, "statistics", result->statistics, PROTOCOL_MAX_STATISTICS);
    result->pass_count = numbers_from(reading, object, "passes_ns", result->passes_ns, PROTOCOL_MAX_PASSES);
}

static void results_from(struct reading *reading, json_t *root, struct bench_results *results)
{
    json_t *server = field_of(reading, root, "server"), *object;
    size_t index;
    text_from(reading, server, "version", results->server.version, sizeof results->server.version);
    text_from(reading, server, "device", results->server.device, sizeof results->server.device);
    text_from(reading, server, "driver", results->server.driver, sizeof results->server.driver);
    text_from(reading, server, "tracer", results->server.tracer, sizeof results->server.tracer);
    text_from(reading, server, "build", results->server.build, sizeof results->server.build);
    json_array_foreach(field_of(reading, root, "references"), index, object)
    {
        if (index == BENCH_MAX_SCENES) {
            broken(reading, "references");
            return;
        }
        struct bench_reference_note *note = &results->references[results->reference_count++];
        snprintf(reading->where, sizeof reading->where, "references[%zu]", index);
        text_from(reading, object, "key", note->key, sizeof note->key);
        text_from(reading, object, "scene", note->scene, sizeof note->scene);
        text_from(reading, object, "file", note->file, sizeof note->file);
        note->photons = number_from(reading, object, "photons");
        note->noise = number_from(reading, object, "noise");
        note->has_confidence = json_is_true(field_of(reading, object, "has_confidence"));
    }
    *reading->where = 0;
    json_t *points = field_of(reading, root, "points");
    if (!json_is_array(points))
        broken(reading, "points");
    json_array_foreach(points, index, object)
    {
        static struct bench_result result;
        memset(&result, 0, sizeof result);
        snprintf(reading->where, sizeof reading->where, "points[%zu]", index);
        result_from(reading, object, &result);
        if (reading->is_broken || !bench_results_add(results, &result, reading->error)) {
            reading->is_broken = true;
            return;
        }
    }
}

bool bench_results_read(struct bench_results *results, const char *path, struct error *error)
{
    bench_results_begin(results);
    FILE *stream = fopen(path, "rb");
    if (!stream)
        return error_set(error, errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "%.300s: %s", path,
                         strerror(errno));
    json_error_t json_error;
    json_t *root = json_loadf(stream, 0, &json_error);
    fclose(stream);
    if (!root)
        return error_set(error, STATUS_INVALID, "%.200s: line %d, column %d: %.200s", path, json_error.line,
                         json_error.column, json_error.text);
    struct reading reading = {.path = path, .error = error};
    const char *program = json_string_value(json_object_get(root, "program"));
    if (!program || strcmp(program, "caustic-bench") != 0) {
        error_set(error, STATUS_INVALID, "%.300s: holds no results of caustic-bench", path);
        reading.is_broken = true;
    } else if (json_integer_value(json_object_get(root, "format")) != FORMAT) {
        error_set(error, STATUS_UNSUPPORTED, "%.300s: is of another version of caustic-bench", path);
        reading.is_broken = true;
    } else {
        results_from(&reading, root, results);
    }
    json_decref(root);
    if (reading.is_broken)
        bench_results_free(results);
    return !reading.is_broken;
}

/* ---- CSV -------------------------------------------------------------------------------------------------
 */

/* Names of one kind over all points, each once, in the order of their first appearance. */
struct names {
    char names[PROTOCOL_MAX_STATISTICS][BENCH_TEXT];
    uint32_t count;
};

static void add_name(struct names *names, const char *name)
{
    for (uint32_t i = 0; i < names->count; i++)
        if (strcmp(names->names[i], name) == 0)
            return;
    if (names->count < PROTOCOL_MAX_STATISTICS)
        snprintf(names->names[names->count++], BENCH_TEXT, "%s", name);
}

/* Quoted where it has a comma or a quote. */
static void write_field(FILE *stream, const char *text)
{
    if (!strpbrk(text, ",\"\n")) {
        fputs(text, stream);
        return;
    }
    fputc('"', stream);
    for (; *text; text++)
        fputs(*text == '"' ? "\"\"" : (char[2]){*text, 0}, stream);
    fputc('"', stream);
}

static void write_number(FILE *stream, double value)
{
    if (isfinite(value))
        fprintf(stream, ",%.10g", value);
    else
        fputc(',', stream);
}

static double named_number(const struct bench_number *numbers, uint32_t count, const char *name)
{
    for (uint32_t i = 0; i < count; i++)
        if (strcmp(numbers[i].name, name) == 0)
            return numbers[i].value;
    return NAN;
}

static void write_row(FILE *stream, const struct bench_result *result, const struct names *settings,
                      const struct names *passes, const struct names *statistics)
{
    write_field(stream, result->scene);
    fputc(',', stream);
    write_field(stream, result->method);
    for (uint32_t i = 0; i < settings->count; i++) {
        const char *value = bench_result_setting(result, settings->names[i]);
        fputc(',', stream);
        write_field(stream, value ? value : "");
    }
    fprintf(stream, ",%u,%u", result->width, result->height);
    const struct bench_spread *times[] = {&result->gpu_ns, &result->wall_ns, &result->frame_ns};
    for (uint32_t i = 0; i < 3; i++) {
        write_number(stream, times[i]->median * 1e-6);
        write_number(stream, times[i]->low * 1e-6);
        write_number(stream, times[i]->high * 1e-6);
    }
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        write_number(stream, result->measures[i].median);
        write_number(stream, result->measures[i].low);
        write_number(stream, result->measures[i].high);
    }
    for (uint32_t i = 0; i < passes->count; i++)
        write_number(stream, named_number(result->passes_ns, result->pass_count, passes->names[i]) * 1e-6);
    for (uint32_t i = 0; i < statistics->count; i++)
        write_number(stream, named_number(result->statistics, result->statistic_count, statistics->names[i]));
    fputc('\n', stream);
}

bool bench_results_write_csv(const struct bench_results *results, const char *path, struct error *error)
{
    char part[BENCH_PATH + 64];
    snprintf(part, sizeof part, "%.*s.part", (int)BENCH_PATH, path);
    FILE *stream = fopen(part, "w");
    if (!stream)
        return error_set(error, STATUS_IO, "%.300s: %s", path, strerror(errno));
    static struct names settings, passes, statistics;
    settings.count = passes.count = statistics.count = 0;
    for (uint32_t i = 0; i < results->count; i++) {
        const struct bench_result *result = &results->results[i];
        for (uint32_t k = 0; k < result->setting_count; k++)
            add_name(&settings, result->settings[k].name);
        for (uint32_t k = 0; k < result->pass_count; k++)
            add_name(&passes, result->passes_ns[k].name);
        for (uint32_t k = 0; k < result->statistic_count; k++)
            add_name(&statistics, result->statistics[k].name);
    }
    fputs("scene,method", stream);
    for (uint32_t i = 0; i < settings.count; i++)
        fprintf(stream, ",%s", settings.names[i]);
    fputs(
        ",width,height,gpu_ms,gpu_ms_low,gpu_ms_high,wall_ms,wall_ms_low,wall_ms_high,frame_ms,frame_ms_low,"
        "frame_ms_high",
        stream);
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        fprintf(stream, ",%s,%s_low,%s_high", metric_names[i], metric_names[i], metric_names[i]);
    for (uint32_t i = 0; i < passes.count; i++)
        fprintf(stream, ",pass_%s_ms", passes.names[i]);
    for (uint32_t i = 0; i < statistics.count; i++)
        fprintf(stream, ",stat_%s", statistics.names[i]);
    fputc('\n', stream);
    for (uint32_t i = 0; i < results->count; i++)
        write_row(stream, &results->results[i], &settings, &passes, &statistics);
    errno = 0;
    bool is_whole = fflush(stream) == 0 && ferror(stream) == 0;
    is_whole = fclose(stream) == 0 && is_whole && rename(part, path) == 0;
    int reason = errno;
    if (is_whole)
        return true;
    remove(part);
    return error_set(error, STATUS_IO, "%.300s: %s", path,
                     reason ? strerror(reason) : "could not be written whole");
}
