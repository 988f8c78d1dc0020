#include "config_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void bench_config_default(struct bench_config *config)
{
    memset(config, 0, sizeof *config);
    config->width = 480;
    config->height = 270;
    config->warmup = 8;
    config->repeats = 5;
    config->confidence = 0.02;
    config->reference_photons = 2e8;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        config->metrics[i] = true;
    config->judge = METRIC_RELL1;
}

/* ---- what both the file and the command line say --------------------------------------------------------
 */

static bool copy_text(const char *what, const char *text, char *target, size_t size, struct error *error)
{
    if (!*text || strlen(text) >= size)
        return error_set(error, STATUS_INVALID, "%s: \"%.80s\" %s", what, text,
                         *text ? "is too long" : "is empty");
    memcpy(target, text, strlen(text) + 1);
    return true;
}

bool bench_config_add_scene(struct bench_config *config, const char *source, struct error *error)
{
    if (config->scene_count == BENCH_MAX_SCENES)
        return error_set(error, STATUS_LIMIT, "at most %u scenes", BENCH_MAX_SCENES);
    struct bench_scene *scene = &config->scenes[config->scene_count];
    memset(scene, 0, sizeof *scene);
    if (!copy_text("scene", source, scene->source, sizeof scene->source, error))
        return false;
    const char *slash = strrchr(source, '/'), *base = slash ? slash + 1 : source;
    snprintf(scene->label, sizeof scene->label, "%.*s", (int)strcspn(base, "."), base);
    for (uint32_t i = 0; i < config->scene_count; i++)
        if (strcmp(config->scenes[i].label, scene->label) == 0)
            return error_set(error, STATUS_INVALID, "scene \"%s\" is given twice", scene->label);
    config->scene_count++;
    return true;
}

bool config_check_setting(const char *name, struct error *error)
{
    if (strcmp(name, "accumulate") == 0)
        return error_set(error, STATUS_INVALID,
                         "accumulate: is how references are made; a point is one frame");
    return true;
}

/* An empty axis of that name: a new one, or the old one emptied. NULL when there are too many. */
struct bench_axis *config_axis(struct bench_config *config, const char *name, struct error *error)
{
    uint32_t i = 0;
    while (i < config->axis_count && strcmp(config->axes[i].name, name) != 0)
        i++;
    if (i == BENCH_MAX_AXES) {
        error_set(error, STATUS_LIMIT, "at most %u settings with several values", BENCH_MAX_AXES);
        return NULL;
    }
    struct bench_axis *axis = &config->axes[i];
    memset(axis, 0, sizeof *axis);
    if (!config_check_setting(name, error) ||
        !copy_text("the name of a setting", name, axis->name, sizeof axis->name, error))
        return NULL;
    config->axis_count += i == config->axis_count;
    return axis;
}

bool config_add_value(struct bench_axis *axis, const char *text, struct error *error)
{
    if (axis->count == BENCH_MAX_VALUES)
        return error_set(error, STATUS_LIMIT, "%s: at most %u values", axis->name, BENCH_MAX_VALUES);
    if (!copy_text(axis->name, text, axis->values[axis->count], sizeof axis->values[0], error))
        return false;
    for (uint32_t i = 0; i < axis->count; i++)
        if (strcmp(axis->values[i], text) == 0)
            return error_set(error, STATUS_INVALID, "%s: %s is given twice", axis->name, text);
    axis->count++;
    return true;
}

bool config_add_setting(struct bench_group *group, const char *name, const char *value, struct error *error)
{
    if (group->count == BENCH_MAX_VALUES)
        return error_set(error, STATUS_LIMIT, "%s: at most %u settings", group->name, BENCH_MAX_VALUES);
    struct option_setting *setting = &group->settings[group->count];
    if (!copy_text("the name of a setting", name, setting->name, sizeof setting->name, error) ||
        !copy_text(name, value, setting->value, sizeof setting->value, error))
        return false;
    group->count++;
    return true;
}

struct bench_group *config_method(struct bench_config *config, const char *name, struct error *error)
{
    uint32_t i = 0;
    while (i < config->method_count && strcmp(config->methods[i].name, name) != 0)
        i++;
    if (i == BENCH_MAX_METHODS) {
        error_set(error, STATUS_LIMIT, "at most %u methods", BENCH_MAX_METHODS);
        return NULL;
    }
    struct bench_group *method = &config->methods[i];
    memset(method, 0, sizeof *method);
    if (!copy_text("the name of a method", name, method->name, sizeof method->name, error))
        return NULL;
    config->method_count += i == config->method_count;
    return method;
}

/* Hands out the parts of a list with commas one after another; false at its end. Cuts what is too long, which
 * its reader then refuses. */
static bool next_part(const char **list, char *part, size_t size)
{
    if (!*list)
        return false;
    size_t length = strcspn(*list, ",");
    snprintf(part, size, "%.*s", (int)length, *list);
    *list = (*list)[length] ? *list + length + 1 : NULL;
    return true;
}

bool bench_config_set_axis(struct bench_config *config, const char *text, struct error *error)
{
    char name[BENCH_TEXT + 1], value[BENCH_TEXT + 1];
    const char *equals = strchr(text, '=');
    if (!equals || equals == text || !equals[1])
        return error_set(error, STATUS_INVALID, "\"%.100s\": write NAME=VALUE or NAME=VALUE,VALUE,...", text);
    snprintf(name, sizeof name, "%.*s", (int)(equals - text), text);
    struct bench_axis *axis = config_axis(config, name, error);
    const char *list = equals + 1;
    while (axis && next_part(&list, value, sizeof value))
        if (!config_add_value(axis, value, error))
            return false;
    return axis != NULL;
}

bool bench_config_set_method(struct bench_config *config, const char *text, struct error *error)
{
    char name[BENCH_TEXT + 1], part[2 * BENCH_TEXT + 2];
    const char *colon = strchr(text, ':');
    snprintf(name, sizeof name, "%.*s", (int)(colon ? colon - text : (ptrdiff_t)strlen(text)), text);
    struct bench_group *method = config_method(config, name, error);
    const char *list = colon ? colon + 1 : NULL;
    while (method && next_part(&list, part, sizeof part)) {
        char *equals = strchr(part, '=');
        if (!equals)
            return error_set(error, STATUS_INVALID, "\"%.100s\": write NAME:SETTING=VALUE,SETTING=VALUE,...",
                             text);
        *equals = 0;
        if (!config_check_setting(part, error) || !config_add_setting(method, part, equals + 1, error))
            return false;
    }
    return method != NULL;
}

bool config_add_metric(struct bench_config *config, const char *name, bool is_first, struct error *error)
{
    enum metric metric;
    if (!metric_find(name, &metric, error))
        return false;
    if (is_first) {
        memset(config->metrics, 0, sizeof config->metrics);
        config->judge = metric;
    }
    config->metrics[metric] = true;
    return true;
}

bool bench_config_set_metrics(struct bench_config *config, const char *list, struct error *error)
{
    char name[BENCH_TEXT];
    for (bool is_first = true; next_part(&list, name, sizeof name); is_first = false)
        if (!config_add_metric(config, name, is_first, error))
            return false;
    return true;
}

bool bench_config_check(const struct bench_config *config, struct error *error)
{
    if (config->scene_count == 0)
        return error_set(error, STATUS_INVALID, "no scene: give --scene NAME, or a file with --config");
    uint64_t count = (uint64_t)config->scene_count * (config->method_count ? config->method_count : 1);
    bool has_curve = !*config->curve;
    for (uint32_t i = 0; i < config->axis_count; i++) {
        count *= config->axes[i].count;
        has_curve |= strcmp(config->axes[i].name, config->curve) == 0;
        if (count > BENCH_MAX_POINTS)
            return error_set(error, STATUS_LIMIT, "these are more than %u points", BENCH_MAX_POINTS);
    }
    return has_curve ||
           error_set(error, STATUS_INVALID, "curve: no setting \"%s\" has several values", config->curve);
}

/* ---- points ----------------------------------------------------------------------------------------------
 */

static void put_setting(struct bench_point *point, const char *name, const char *value)
{
    uint32_t i = 0;
    while (i < point->setting_count && strcmp(point->settings[i].name, name) != 0)
        i++;
    snprintf(point->settings[i].name, sizeof point->settings[i].name, "%s", name);
    snprintf(point->settings[i].value, sizeof point->settings[i].value, "%s", value);
    point->setting_count += i == point->setting_count;
}

static uint32_t methods_of(const struct bench_config *config)
{
    return config->method_count ? config->method_count : 1;
}

uint32_t bench_point_count(const struct bench_config *config)
{
    uint32_t count = config->scene_count * methods_of(config);
    for (uint32_t i = 0; i < config->axis_count; i++)
        count *= config->axes[i].count;
    return count;
}

struct bench_point bench_point_at(const struct bench_config *config, uint32_t index)
{
    struct bench_point point = {0};
    uint32_t choice[BENCH_MAX_AXES];
    for (uint32_t i = config->axis_count; i-- > 0;) {
        choice[i] = index % config->axes[i].count;
        index /= config->axes[i].count;
    }
    point.method = index % methods_of(config);
    point.scene = index / methods_of(config);
    for (uint32_t i = 0; config->method_count && i < config->methods[point.method].count; i++)
        put_setting(&point, config->methods[point.method].settings[i].name,
                    config->methods[point.method].settings[i].value);
    for (uint32_t i = 0; i < config->axis_count; i++)
        put_setting(&point, config->axes[i].name, config->axes[i].values[choice[i]]);
    return point;
}
