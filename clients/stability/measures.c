#include "measures.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* 0 is no MEASURED_ name, but reads as one. */
#define MEASURED_0 0u
#define MEASURE_INFO(name, unit, where, references, help)                                                    \
    {#name, unit, help, MEASURED_##where, MEASURED_##references},

const struct measure_info measure_infos[MEASURE_COUNT] = {MEASURES(MEASURE_INFO)};

void measures_set(struct measures *measures, enum measure_id id, double value)
{
    measures->is_set[id] = true;
    measures->values[id] = value;
}

static json_t *json_of(double value)
{
    return isnan(value) ? json_null() : isinf(value) ? json_string("never") : json_real(value);
}

json_t *measures_json(const struct measures *measures)
{
    json_t *object = json_object();
    for (int i = 0; i < MEASURE_COUNT; i++)
        if (measures->is_set[i])
            json_object_set_new(object, measure_infos[i].name, json_of(measures->values[i]));
    return object;
}

void measure_print(json_t *value, char *text, size_t size)
{
    if (json_is_string(value))
        snprintf(text, size, "%s", json_string_value(value));
    else if (json_is_number(value))
        snprintf(text, size, "%.4g", json_number_value(value));
    else
        snprintf(text, size, "-");
}

/* ---- thresholds ---------------------------------------------------------------------------------------- */

static unsigned letters_in_common(const char *a, const char *b)
{
    unsigned count = 0;
    while (a[count] && a[count] == b[count])
        count++;
    return count;
}

bool gate_parse(const char *text, struct gate *gate, struct error *error)
{
    const char *equals = strrchr(text, '=');
    char name[80], *end;
    if (!equals || equals == text || (size_t)(equals - text) >= sizeof name)
        return error_set(error, STATUS_INVALID,
                         "--fail-above %.80s: write MEASURE=LIMIT or PATH.MEASURE=LIMIT, as in "
                         "flicker_p99=0.005",
                         text);
    snprintf(name, sizeof name, "%.*s", (int)(equals - text), text);
    *gate = (struct gate){.limit = strtod(equals + 1, &end)};
    if (end == equals + 1 || *end || !isfinite(gate->limit) || gate->limit < 0)
        return error_set(error, STATUS_INVALID, "--fail-above %.80s: %.40s is not a limit of 0 or more", text,
                         equals + 1);
    char *dot = strchr(name, '.'), *measure = dot ? dot + 1 : name;
    if (dot) {
        *dot = 0;
        if (strlen(name) >= sizeof gate->path)
            return error_set(error, STATUS_NOT_FOUND, "--fail-above %.80s: no path is called %.60s", text,
                             name);
        memcpy(gate->path, name, strlen(name) + 1);
    }
    const char *nearest = measure_infos[0].name;
    for (int i = 0; i < MEASURE_COUNT; i++) {
        gate->measure = (enum measure_id)i;
        if (strcmp(measure_infos[i].name, measure) == 0)
            return true;
        if (letters_in_common(measure_infos[i].name, measure) > letters_in_common(nearest, measure))
            nearest = measure_infos[i].name;
    }
    return error_set(error, STATUS_NOT_FOUND,
                     "--fail-above %.80s: no measure is called %.60s; did you mean %s? --list has them all",
                     text, measure, nearest);
}

bool gate_check(const struct gate *gate, uint32_t kinds, bool has_references, struct error *error)
{
    static const char *const names[] = {"still or drift", "orbit, light-sweep or object", "cut or light-step",
                                        "settings-flicker"};
    const struct measure_info *info = &measure_infos[gate->measure];
    char paths[100] = "";
    if (!(info->where & kinds)) {
        for (int i = 0; i < 4; i++)
            if (info->where >> i & 1)
                snprintf(paths + strlen(paths), sizeof paths - strlen(paths), "%s%s", *paths ? ", " : "",
                         names[i]);
        return error_set(error, STATUS_INVALID,
                         "--fail-above %s: no path that is run measures it; it takes %s", info->name, paths);
    }
    if (!has_references && !(info->where & ~info->references & kinds))
        return error_set(error, STATUS_INVALID, "--fail-above %s: it takes references, and --pairs is 0",
                         info->name);
    return true;
}

json_t *gate_results(const struct gate *gate, json_t *paths)
{
    json_t *results = json_array(), *path;
    size_t i;
    const char *name = measure_infos[gate->measure].name;
    json_array_foreach(paths, i, path)
    {
        const char *path_name = json_string_value(json_object_get(path, "path"));
        json_t *value = json_object_get(json_object_get(path, "measures"), name);
        if (!value || (*gate->path && strcmp(gate->path, path_name) != 0))
            continue;
        bool passed =
            json_is_number(value) ? fabs(json_number_value(value)) <= gate->limit : json_is_null(value);
        json_array_append_new(results,
                              json_pack("{s:s, s:s, s:O, s:f, s:b}", "measure", name, "path", path_name,
                                        "value", value, "limit", gate->limit, "passed", passed));
    }
    return results;
}
