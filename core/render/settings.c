#include "settings.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

const struct setting_info setting_infos[SETTING_COUNT] = {
#define S(name, type, minimum, maximum, value, choices, help)                                                \
    {#name, choices, help, SETTING_##type, minimum, maximum, value},
    SETTINGS(S)
#undef S
};

void settings_default(struct settings *settings)
{
#define S(name, type, minimum, maximum, value, choices, help) settings->name = (SETTING_FIELD_##type)(value);
    SETTINGS(S)
#undef S
}

double settings_get(const struct settings *settings, enum setting_id id)
{
    switch (id) {
#define S(name, type, minimum, maximum, value, choices, help)                                                \
    case SETTING_##name:                                                                                     \
        return (double)settings->name;
        SETTINGS(S)
#undef S
    case SETTING_COUNT:
        break;
    }
    return 0;
}

/* Length of choice number `index` in a comma-separated list, 0 when there is none; *begin is where it starts.
 */
static int choice_at(const char *choices, int index, const char **begin)
{
    const char *at = choices;
    for (; index > 0; index--) {
        at = strchr(at, ',');
        if (!at)
            return 0;
        at++;
    }
    *begin = at;
    return (int)strcspn(at, ",");
}

bool settings_set(struct settings *settings, enum setting_id id, double value, struct error *error)
{
    if ((unsigned)id >= SETTING_COUNT)
        return error_set(error, STATUS_NOT_FOUND, "setting number %u does not exist; there are %d",
                         (unsigned)id, (int)SETTING_COUNT);
    const struct setting_info *info = &setting_infos[id];
    if (!isfinite(value))
        return error_set(error, STATUS_INVALID, "setting '%s' must be a finite number", info->name);
    if (info->type != SETTING_FLOAT && value != floor(value))
        return error_set(error, STATUS_INVALID, "setting '%s' must be a whole number, not %g", info->name,
                         value);
    if (value < info->minimum || value > info->maximum)
        return error_set(error, STATUS_INVALID, "setting '%s' must be from %.10g to %.10g, not %.10g",
                         info->name, info->minimum, info->maximum, value);
    if (id == SETTING_cells && ((int)value & ((int)value - 1)) != 0)
        return error_set(error, STATUS_INVALID, "setting 'cells' must be a power of two, not %g", value);
    switch (id) {
#define S(name, type, minimum, maximum, default_value, choices, help)                                        \
    case SETTING_##name:                                                                                     \
        settings->name = (SETTING_FIELD_##type)value;                                                        \
        break;
        SETTINGS(S)
#undef S
    case SETTING_COUNT:
        break;
    }
    return true;
}

/* Letters to add, drop or swap between two short names. */
static unsigned edit_distance(const char *a, const char *b)
{
    unsigned row[64];
    size_t length = strlen(b);
    if (length >= 63)
        return 64;
    for (size_t j = 0; j <= length; j++)
        row[j] = (unsigned)j;
    for (size_t i = 0; a[i]; i++) {
        unsigned diagonal = row[0];
        row[0] = (unsigned)i + 1;
        for (size_t j = 0; j < length; j++) {
            unsigned change = diagonal + (a[i] != b[j]);
            diagonal = row[j + 1];
            unsigned insert = (diagonal < row[j] ? diagonal : row[j]) + 1;
            row[j + 1] = change < insert ? change : insert;
        }
    }
    return row[length];
}

bool settings_set_text(struct settings *settings, const char *name, const char *text, struct error *error)
{
    unsigned nearest = 0, nearest_distance = 1000;
    for (unsigned id = 0; id < SETTING_COUNT; id++) {
        const struct setting_info *info = &setting_infos[id];
        if (strcmp(info->name, name) != 0) {
            unsigned distance = edit_distance(name, info->name);
            if (distance < nearest_distance) {
                nearest_distance = distance;
                nearest = id;
            }
            continue;
        }
        if (info->type == SETTING_CHOICE) {
            const char *begin;
            int length;
            for (int i = 0; (length = choice_at(info->choices, i, &begin)) > 0; i++)
                if ((size_t)length == strlen(text) && strncmp(begin, text, (size_t)length) == 0)
                    return settings_set(settings, (enum setting_id)id, i, error);
            return error_set(error, STATUS_INVALID, "setting '%s' must be one of %s, not '%.40s'", name,
                             info->choices, text);
        }
        if (info->type == SETTING_BOOL) {
            static const char *const words[] = {"0", "1", "off", "on", "false", "true", "no", "yes"};
            for (int i = 0; i < 8; i++)
                if (strcasecmp(text, words[i]) == 0)
                    return settings_set(settings, (enum setting_id)id, i & 1, error);
            return error_set(error, STATUS_INVALID, "setting '%s' must be on or off, not '%.40s'", name,
                             text);
        }
        char *end;
        double value = strtod(text, &end);
        if (end == text || *end)
            return error_set(error, STATUS_INVALID, "setting '%s' must be a number, not '%.40s'", name, text);
        return settings_set(settings, (enum setting_id)id, value, error);
    }
    return error_set(error, STATUS_NOT_FOUND, "unknown setting '%.40s'; did you mean '%s'?", name,
                     setting_infos[nearest].name);
}

void settings_print(enum setting_id id, double value, char *text, size_t size)
{
    const struct setting_info *info = &setting_infos[id];
    const char *begin;
    int length = info->type == SETTING_CHOICE ? choice_at(info->choices, (int)value, &begin) : 0;
    if (length > 0)
        snprintf(text, size, "%.*s", length, begin);
    else if (info->type == SETTING_BOOL)
        snprintf(text, size, "%s", value != 0 ? "on" : "off");
    else
        snprintf(text, size, "%.*g", info->type == SETTING_FLOAT ? 9 : 10,
                 value); /* digits of any float, any int32 */
}
