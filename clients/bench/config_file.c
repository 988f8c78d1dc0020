#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "config_internal.h"

/* Where in the file an error is. */
struct place {
    const char *name;
    char path[256];
};

static bool fail_at(const struct place *place, const char *what, struct error *error)
{
    return error_set(error, STATUS_INVALID, "%.120s: %s%s%.220s", place->name, place->path,
                     *place->path ? ": " : "", what);
}

static struct place inside(const struct place *place, const char *field)
{
    struct place deeper = {.name = place->name};
    snprintf(deeper.path, sizeof deeper.path, "%.150s%s%.60s", place->path, *place->path ? "." : "", field);
    return deeper;
}

static struct place entry(const struct place *place, size_t index)
{
    struct place deeper = {.name = place->name};
    snprintf(deeper.path, sizeof deeper.path, "%.200s[%zu]", place->path, index);
    return deeper;
}

/* The reader of one field of an object. */
struct field {
    const char *name;
    bool (*read)(struct bench_config *config, void *target, json_t *value, const struct place *place,
                 struct error *error);
};

static bool read_object(struct bench_config *config, void *target, json_t *object, const struct field *fields,
                        size_t count, const struct place *place, struct error *error)
{
    const char *key;
    json_t *value;
    if (!json_is_object(object))
        return fail_at(place, "must be an object {...}", error);
    json_object_foreach(object, key, value)
    {
        size_t i = 0;
        while (i < count && strcmp(fields[i].name, key) != 0)
            i++;
        if (i == count) {
            char text[300];
            int used = snprintf(text, sizeof text, "there is no field \"%.40s\"; there are", key);
            for (i = 0; i < count; i++)
                used +=
                    snprintf(text + used, sizeof text - (size_t)used, "%s %s", i ? "," : "", fields[i].name);
            return fail_at(place, text, error);
        }
        struct place deeper = inside(place, key);
        if (!fields[i].read(config, target, value, &deeper, error))
            return false;
    }
    return true;
}

static bool read_text(json_t *value, char *target, size_t size, const struct place *place,
                      struct error *error)
{
    const char *text = json_string_value(value);
    if (!text)
        return fail_at(place, "must be a text", error);
    if (!*text || strlen(text) >= size)
        return fail_at(place, *text ? "is too long" : "is empty", error);
    memcpy(target, text, strlen(text) + 1);
    return true;
}

static bool read_number(json_t *value, double minimum, double maximum, double *number,
                        const struct place *place, struct error *error)
{
    double given = json_number_value(value);
    if (!json_is_number(value) || !(given >= minimum && given <= maximum)) {
        char text[100];
        snprintf(text, sizeof text, "must be a number from %g to %g", minimum, maximum);
        return fail_at(place, text, error);
    }
    *number = given;
    return true;
}

static bool read_bool(json_t *value, bool *target, const struct place *place, struct error *error)
{
    *target = json_is_true(value);
    return json_is_boolean(value) || fail_at(place, "must be true or false", error);
}

/* A setting's value: a number, a text, true or false. */
static bool read_value(json_t *value, char *text, size_t size, const struct place *place, struct error *error)
{
    if (json_is_integer(value))
        snprintf(text, size, "%lld", (long long)json_integer_value(value));
    else if (json_is_real(value))
        snprintf(text, size, "%.9g", json_real_value(value));
    else if (json_is_boolean(value))
        snprintf(text, size, "%s", json_is_true(value) ? "on" : "off");
    else if (!json_is_string(value))
        return fail_at(place, "must be a number, a text, true or false", error);
    else
        return read_text(value, text, size, place, error);
    return true;
}

/* A file's name as seen from where the JSON file lies. */
static bool resolve_path(const char *name, char *path, size_t size, const struct place *place,
                         struct error *error)
{
    const char *slash = strrchr(place->name, '/');
    int folder = slash && *name != '/' ? (int)(slash - place->name + 1) : 0;
    char whole[2 * BENCH_PATH];
    if (snprintf(whole, sizeof whole, "%.*s%s", folder, place->name, name) >= (int)size)
        return fail_at(place, "is too long", error);
    memcpy(path, whole, strlen(whole) + 1);
    return true;
}

static bool read_group(struct bench_group *group, json_t *value, const struct place *place,
                       struct error *error)
{
    const char *key;
    json_t *entry_value;
    char text[BENCH_TEXT];
    struct error reason;
    if (!json_is_object(value))
        return fail_at(place, "must be an object {\"setting\": value, ...}", error);
    json_object_foreach(value, key, entry_value)
    {
        struct place deeper = inside(place, key);
        if (!read_value(entry_value, text, sizeof text, &deeper, error))
            return false;
        if (!config_add_setting(group, key, text, &reason))
            return fail_at(&deeper, reason.message, error);
    }
    return true;
}

static bool read_vector(struct bench_config *config, void *target, json_t *value, const struct place *place,
                        struct error *error)
{
    (void)config;
    float *vector = target;
    if (json_array_size(value) != 3)
        return fail_at(place, "must be [x, y, z]", error);
    for (size_t i = 0; i < 3; i++) {
        double number;
        struct place deeper = entry(place, i);
        if (!read_number(json_array_get(value, i), -1e9, 1e9, &number, &deeper, error))
            return false;
        vector[i] = (float)number;
    }
    return true;
}

static bool read_eye(struct bench_config *config, void *camera, json_t *value, const struct place *place,
                     struct error *error)
{
    return read_vector(config, ((struct protocol_camera *)camera)->eye, value, place, error);
}

static bool read_at(struct bench_config *config, void *camera, json_t *value, const struct place *place,
                    struct error *error)
{
    return read_vector(config, ((struct protocol_camera *)camera)->at, value, place, error);
}

static bool read_up(struct bench_config *config, void *camera, json_t *value, const struct place *place,
                    struct error *error)
{
    return read_vector(config, ((struct protocol_camera *)camera)->up, value, place, error);
}

static bool read_fov(struct bench_config *config, void *camera, json_t *value, const struct place *place,
                     struct error *error)
{
    (void)config;
    double number;
    if (!read_number(value, 1e-3, 178.999, &number, place, error))
        return false;
    ((struct protocol_camera *)camera)->fov = (float)number;
    return true;
}

static bool read_scene_source(struct bench_config *config, void *target, json_t *value,
                              const struct place *place, struct error *error)
{
    (void)config;
    (void)target;
    return json_is_string(value) || fail_at(place, "must be a text", error);
}

static bool read_scene_reference(struct bench_config *config, void *target, json_t *value,
                                 const struct place *place, struct error *error)
{
    (void)config;
    struct bench_scene *scene = target;
    char name[BENCH_PATH];
    return read_text(value, name, sizeof name, place, error) &&
           resolve_path(name, scene->reference, sizeof scene->reference, place, error);
}

static bool read_scene_time(struct bench_config *config, void *target, json_t *value,
                            const struct place *place, struct error *error)
{
    (void)config;
    return read_number(value, -1e9, 1e9, &((struct bench_scene *)target)->time, place, error);
}

static bool read_scene_camera(struct bench_config *config, void *target, json_t *value,
                              const struct place *place, struct error *error)
{
    static const struct field fields[] = {
        {"eye", read_eye}, {"at", read_at}, {"up", read_up}, {"fov", read_fov}};
    struct bench_scene *scene = target;
    if (json_is_string(value)) {
        scene->camera_kind = BENCH_CAMERA_NAMED;
        return read_text(value, scene->camera_name, sizeof scene->camera_name, place, error);
    }
    scene->camera_kind = BENCH_CAMERA_FREE;
    scene->camera = (struct protocol_camera){.up = {0, 1, 0}, .fov = 45};
    if (!read_object(config, &scene->camera, value, fields, sizeof fields / sizeof *fields, place, error))
        return false;
    if (!json_object_get(value, "eye") || !json_object_get(value, "at"))
        return fail_at(place, "needs \"eye\" and \"at\", or is the name of a camera of the scene", error);
    return true;
}

static bool read_scenes(struct bench_config *config, void *target, json_t *value, const struct place *place,
                        struct error *error)
{
    static const struct field fields[] = {{"scene", read_scene_source},
                                          {"camera", read_scene_camera},
                                          {"time", read_scene_time},
                                          {"reference", read_scene_reference}};
    (void)target;
    size_t index;
    json_t *item;
    struct error reason;
    if (!json_is_array(value))
        return fail_at(place, "must be a list [...]", error);
    config->scene_count = 0;
    json_array_foreach(value, index, item)
    {
        struct place deeper = entry(place, index);
        json_t *source = json_is_object(item) ? json_object_get(item, "scene") : item;
        char path[BENCH_PATH];
        if (!json_is_string(source))
            return fail_at(&deeper, "must be the name of a scene, or an object with a field \"scene\"",
                           error);
        /* Built-in scenes have no ending. */
        const char *name = json_string_value(source);
        bool is_file = strchr(name, '.') != NULL;
        if (is_file && !resolve_path(name, path, sizeof path, &deeper, error))
            return false;
        if (!bench_config_add_scene(config, is_file ? path : name, &reason))
            return fail_at(&deeper, reason.message, error);
        if (json_is_object(item) && !read_object(config, &config->scenes[config->scene_count - 1], item,
                                                 fields, sizeof fields / sizeof *fields, &deeper, error))
            return false;
    }
    return true;
}

static bool read_size(struct bench_config *config, void *target, json_t *value, const struct place *place,
                      struct error *error)
{
    (void)target;
    struct error reason;
    char text[BENCH_TEXT];
    if (!read_text(value, text, sizeof text, place, error))
        return false;
    return option_size(text, &config->width, &config->height, &reason) ||
           fail_at(place, "must be \"WIDTHxHEIGHT\" in pixels", error);
}

static bool read_methods(struct bench_config *config, void *target, json_t *value, const struct place *place,
                         struct error *error)
{
    (void)target;
    const char *key;
    json_t *item;
    struct error reason;
    if (!json_is_object(value))
        return fail_at(place, "must be an object {\"name\": {\"setting\": value, ...}, ...}", error);
    config->method_count = 0;
    json_object_foreach(value, key, item)
    {
        struct place deeper = inside(place, key);
        struct bench_group *method = config_method(config, key, &reason);
        if (!method)
            return fail_at(&deeper, reason.message, error);
        if (!read_group(method, item, &deeper, error))
            return false;
        for (uint32_t i = 0; i < method->count; i++)
            if (!config_check_setting(method->settings[i].name, &reason))
                return fail_at(&deeper, reason.message, error);
    }
    return true;
}

static bool read_axes(struct bench_config *config, void *target, json_t *value, const struct place *place,
                      struct error *error)
{
    (void)target;
    const char *key;
    json_t *list;
    struct error reason;
    char text[BENCH_TEXT];
    if (!json_is_object(value))
        return fail_at(place, "must be an object {\"setting\": [value, ...], ...}", error);
    json_object_foreach(value, key, list)
    {
        struct place deeper = inside(place, key);
        size_t count = json_is_array(list) ? json_array_size(list) : 1;
        struct bench_axis *axis = config_axis(config, key, &reason);
        if (!axis || count == 0)
            return fail_at(&deeper, axis ? "needs a value" : reason.message, error);
        for (size_t i = 0; i < count; i++) {
            struct place deepest = json_is_array(list) ? entry(&deeper, i) : deeper;
            if (!read_value(json_is_array(list) ? json_array_get(list, i) : list, text, sizeof text, &deepest,
                            error))
                return false;
            if (!config_add_value(axis, text, &reason))
                return fail_at(&deepest, reason.message, error);
        }
    }
    return true;
}

static bool read_curve(struct bench_config *config, void *target, json_t *value, const struct place *place,
                       struct error *error)
{
    (void)target;
    return read_text(value, config->curve, sizeof config->curve, place, error);
}

static bool read_frames(json_t *value, double minimum, uint32_t *count, const struct place *place,
                        struct error *error)
{
    double number;
    if (!read_number(value, minimum, 1e6, &number, place, error))
        return false;
    *count = (uint32_t)number;
    return number == floor(number) || fail_at(place, "must be a whole number", error);
}

static bool read_warmup(struct bench_config *config, void *target, json_t *value, const struct place *place,
                        struct error *error)
{
    (void)target;
    return read_frames(value, 0, &config->warmup, place, error);
}

static bool read_repeats(struct bench_config *config, void *target, json_t *value, const struct place *place,
                         struct error *error)
{
    (void)target;
    return read_frames(value, 1, &config->repeats, place, error);
}

static bool read_metrics(struct bench_config *config, void *target, json_t *value, const struct place *place,
                         struct error *error)
{
    (void)target;
    size_t index;
    json_t *item;
    struct error reason;
    if (!json_is_array(value) || json_array_size(value) == 0)
        return fail_at(place, "must be a list [\"metric\", ...]", error);
    json_array_foreach(value, index, item)
    {
        struct place deeper = entry(place, index);
        char name[BENCH_TEXT];
        if (!read_text(item, name, sizeof name, &deeper, error))
            return false;
        if (!config_add_metric(config, name, index == 0, &reason))
            return fail_at(&deeper, reason.message, error);
    }
    return true;
}

static bool read_confidence(struct bench_config *config, void *target, json_t *value,
                            const struct place *place, struct error *error)
{
    (void)target;
    return read_number(value, 1e-6, 1, &config->confidence, place, error);
}

static bool read_photons(struct bench_config *config, void *target, json_t *value, const struct place *place,
                         struct error *error)
{
    (void)target;
    return read_number(value, 1, 1e15, &config->reference_photons, place, error);
}

static bool read_reference_settings(struct bench_config *config, void *target, json_t *value,
                                    const struct place *place, struct error *error)
{
    (void)target;
    config->reference.count = 0;
    return read_group(&config->reference, value, place, error);
}

static bool read_cache(struct bench_config *config, void *target, json_t *value, const struct place *place,
                       struct error *error)
{
    (void)target;
    char name[BENCH_PATH];
    return read_text(value, name, sizeof name, place, error) &&
           resolve_path(name, config->cache, sizeof config->cache, place, error);
}

static bool read_reference(struct bench_config *config, void *target, json_t *value,
                           const struct place *place, struct error *error)
{
    static const struct field fields[] = {{"confidence", read_confidence},
                                          {"photons", read_photons},
                                          {"settings", read_reference_settings},
                                          {"cache", read_cache}};
    return read_object(config, target, value, fields, sizeof fields / sizeof *fields, place, error);
}

static bool read_budgets(struct bench_config *config, void *target, json_t *value, const struct place *place,
                         struct error *error)
{
    (void)target;
    size_t index;
    json_t *item;
    if (!json_is_array(value) || json_array_size(value) > BENCH_MAX_BUDGETS)
        return fail_at(place, "must be a list of at most 16 times in milliseconds", error);
    config->budget_count = 0;
    json_array_foreach(value, index, item)
    {
        struct place deeper = entry(place, index);
        if (!read_number(item, 1e-6, 1e9, &config->budgets_ms[config->budget_count++], &deeper, error))
            return false;
    }
    return true;
}

/* ---- plots -----------------------------------------------------------------------------------------------
 */

#define PLOT_TEXT(field)                                                                                     \
    static bool read_plot_##field(struct bench_config *config, void *target, json_t *value,                  \
                                  const struct place *place, struct error *error)                            \
    {                                                                                                        \
        (void)config;                                                                                        \
        struct bench_plot *plot = target;                                                                    \
        return read_text(value, plot->field, sizeof plot->field, place, error);                              \
    }
#define PLOT_BOOL(field)                                                                                     \
    static bool read_plot_##field(struct bench_config *config, void *target, json_t *value,                  \
                                  const struct place *place, struct error *error)                            \
    {                                                                                                        \
        (void)config;                                                                                        \
        return read_bool(value, &((struct bench_plot *)target)->field, place, error);                        \
    }
PLOT_TEXT(title)
PLOT_TEXT(scene)
PLOT_TEXT(method)
PLOT_TEXT(x)
PLOT_TEXT(y)
PLOT_TEXT(x_label)
PLOT_TEXT(y_label)
PLOT_BOOL(is_log_x)
PLOT_BOOL(is_log_y)
PLOT_BOOL(is_share)

static bool read_plot_file(struct bench_config *config, void *target, json_t *value,
                           const struct place *place, struct error *error)
{
    (void)config;
    struct bench_plot *plot = target;
    if (!read_text(value, plot->file, sizeof plot->file, place, error))
        return false;
    size_t length = strlen(plot->file);
    if (length < 5 || strcmp(plot->file + length - 4, ".svg") != 0 || strchr(plot->file, '/'))
        return fail_at(place, "must be the name of an .svg file, without a folder", error);
    return true;
}

static bool read_plot_list(struct bench_config *config, json_t *value, const struct field *fields,
                           size_t field_count, bool is_bars, const struct place *place, struct error *error)
{
    size_t index;
    json_t *item;
    if (!json_is_array(value))
        return fail_at(place, "must be a list [...]", error);
    json_array_foreach(value, index, item)
    {
        struct place deeper = entry(place, index);
        if (config->plot_count == BENCH_MAX_PLOTS)
            return fail_at(&deeper, "is one plot too many", error);
        struct bench_plot *plot = &config->plots[config->plot_count++];
        memset(plot, 0, sizeof *plot);
        plot->is_bars = is_bars;
        if (!read_object(config, plot, item, fields, field_count, &deeper, error))
            return false;
        if (!*plot->file || (!is_bars && (!*plot->x || !*plot->y)))
            return fail_at(&deeper, is_bars ? "needs \"file\"" : "needs \"file\", \"x\" and \"y\"", error);
    }
    return true;
}

static bool read_plots(struct bench_config *config, void *target, json_t *value, const struct place *place,
                       struct error *error)
{
    static const struct field fields[] = {{"file", read_plot_file},
                                          {"title", read_plot_title},
                                          {"scene", read_plot_scene},
                                          {"method", read_plot_method},
                                          {"x", read_plot_x},
                                          {"y", read_plot_y},
                                          {"x_label", read_plot_x_label},
                                          {"y_label", read_plot_y_label},
                                          {"log_x", read_plot_is_log_x},
                                          {"log_y", read_plot_is_log_y}};
    (void)target;
    return read_plot_list(config, value, fields, sizeof fields / sizeof *fields, false, place, error);
}

static bool read_bars(struct bench_config *config, void *target, json_t *value, const struct place *place,
                      struct error *error)
{
    static const struct field fields[] = {{"file", read_plot_file},
                                          {"title", read_plot_title},
                                          {"scene", read_plot_scene},
                                          {"method", read_plot_method},
                                          {"is_share", read_plot_is_share}};
    (void)target;
    return read_plot_list(config, value, fields, sizeof fields / sizeof *fields, true, place, error);
}

bool bench_config_parse(struct bench_config *config, const char *text, const char *name, struct error *error)
{
    static const struct field fields[] = {
        {"scenes", read_scenes},      {"size", read_size},       {"methods", read_methods},
        {"settings", read_axes},      {"curve", read_curve},     {"warmup", read_warmup},
        {"repeats", read_repeats},    {"metrics", read_metrics}, {"reference", read_reference},
        {"budgets_ms", read_budgets}, {"plots", read_plots},     {"bars", read_bars}};
    struct place place = {.name = name};
    json_error_t json_error;
    json_t *root = json_loads(text, JSON_REJECT_DUPLICATES, &json_error);
    if (!root)
        return error_set(error, STATUS_INVALID, "%.200s: line %d, column %d: %.200s", name, json_error.line,
                         json_error.column, json_error.text);
    bool is_read = read_object(config, config, root, fields, sizeof fields / sizeof *fields, &place, error);
    json_decref(root);
    return is_read;
}

bool bench_config_read(struct bench_config *config, const char *file, struct error *error)
{
    FILE *stream = fopen(file, "rb");
    if (!stream)
        return error_set(error, STATUS_NOT_FOUND, "%.300s: %s", file, strerror(errno));
    size_t capacity = 1u << 20;
    char *text = malloc(capacity + 1);
    size_t size = text ? fread(text, 1, capacity, stream) : 0;
    bool is_whole = text && feof(stream) != 0;
    fclose(stream);
    if (is_whole)
        text[size] = 0;
    bool is_read =
        is_whole ? bench_config_parse(config, text, file, error)
                 : error_set(error, STATUS_INVALID, "%.300s: cannot be read, or is larger than 1 MiB", file);
    free(text);
    return is_read;
}
