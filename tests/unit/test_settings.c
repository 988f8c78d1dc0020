/* test_settings.c: the settings table: what every setting takes, refuses, and how it is written. */
#include <string.h>

#include "core/render/settings.h"
#include "tests/support/check.h"

static int choice_count(const struct setting_info *info)
{
    int count = 1;
    for (const char *at = info->choices; *at; at++)
        count += *at == ',';
    return count;
}

static void the_table_is_sound(void **state)
{
    (void)state;
    struct settings settings;
    settings_default(&settings);
    for (unsigned id = 0; id < SETTING_COUNT; id++) {
        const struct setting_info *info = &setting_infos[id];
        assert_true(strlen(info->name) > 0 && strlen(info->help) > 0);
        assert_true(info->minimum < info->maximum);
        assert_true(info->value >= info->minimum && info->value <= info->maximum);
        assert_close(settings_get(&settings, (enum setting_id)id), info->value, 1e-7 * fabs(info->value));
        for (unsigned other = 0; other < id; other++)
            assert_string_not_equal(info->name, setting_infos[other].name);
        if (info->type == SETTING_CHOICE) {
            assert_true(info->minimum == 0);
            assert_true(info->maximum == choice_count(info) - 1);
        } else
            assert_string_equal(info->choices, "");
        if (info->type == SETTING_BOOL)
            assert_true(info->minimum == 0 && info->maximum == 1);
        if (info->type != SETTING_FLOAT)
            assert_true(info->value == floor(info->value) && info->maximum == floor(info->maximum));
        struct error error;
        assert_true(
            settings_set(&settings, (enum setting_id)id, info->value, &error)); /* and is taken as it is */
    }
}

/* A refusal names the setting and leaves all of them alone. */
static void refuse(enum setting_id id, double value)
{
    struct settings settings, before;
    settings_default(&settings);
    before = settings;
    struct error error = {0};
    if (settings_set(&settings, id, value, &error))
        fail_msg("%s took %g", setting_infos[id].name, value);
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, setting_infos[id].name));
    for (unsigned other = 0; other < SETTING_COUNT; other++)
        assert_true(settings_get(&settings, (enum setting_id)other) ==
                    settings_get(&before, (enum setting_id)other));
}

static void ranges_hold(void **state)
{
    (void)state;
    for (unsigned i = 0; i < SETTING_COUNT; i++) {
        enum setting_id id = (enum setting_id)i;
        const struct setting_info *info = &setting_infos[id];
        struct settings settings;
        struct error error;
        settings_default(&settings);
        const double ends[2] = {info->minimum, info->maximum};
        for (int k = 0; k < 2; k++) {
            assert_true(settings_set(&settings, id, ends[k], &error));
            assert_close(settings_get(&settings, id), ends[k], 1e-6 * fabs(ends[k]));
        }
        refuse(id, NAN);
        refuse(id, INFINITY);
        refuse(id, -INFINITY);
        refuse(id, info->maximum + 1);
        refuse(id, info->minimum - 1);
        refuse(id, 1e300);
        refuse(id, -1e300);
        if (info->type != SETTING_FLOAT)
            refuse(id, info->minimum + 0.5);
    }
    for (int cells = 17; cells < 512; cells++)
        if (cells & (cells - 1))
            refuse(SETTING_cells, cells);
    struct settings settings;
    struct error error;
    assert_false(settings_set(&settings, SETTING_COUNT, 0, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    assert_false(settings_set(&settings, (enum setting_id)12345, 0, &error));
}

/* Every setting keeps to itself: setting one changes no other. */
static void settings_are_apart(void **state)
{
    (void)state;
    for (unsigned id = 0; id < SETTING_COUNT; id++) {
        struct settings settings, before;
        struct error error;
        settings_default(&settings);
        before = settings;
        const struct setting_info *info = &setting_infos[id];
        double value = info->value == info->maximum ? info->minimum : info->maximum;
        assert_true(settings_set(&settings, (enum setting_id)id, value, &error));
        for (unsigned other = 0; other < SETTING_COUNT; other++) {
            double found = settings_get(&settings, (enum setting_id)other);
            if (other == id)
                assert_true(found == (info->type == SETTING_FLOAT ? (double)(float)value : value));
            else
                assert_true(found == settings_get(&before, (enum setting_id)other));
        }
    }
}

static void what_is_printed_is_read(void **state)
{
    (void)state;
    uint32_t tried = 0;
    for (unsigned id = 0; id < SETTING_COUNT; id++) {
        const struct setting_info *info = &setting_infos[id];
        for (int step = 0; step <= 20; step++) {
            struct settings settings, read;
            struct error error;
            char text[64];
            settings_default(&settings);
            settings_default(&read);
            double value = info->minimum + (info->maximum - info->minimum) * step / 20;
            if (info->type != SETTING_FLOAT)
                value = floor(value);
            if (!settings_set(&settings, (enum setting_id)id, value, &error))
                continue; /* cells between powers of two */
            value = settings_get(&settings, (enum setting_id)id);
            settings_print((enum setting_id)id, value, text, sizeof text);
            if (!settings_set_text(&read, info->name, text, &error))
                fail_msg("%s=%s: %s", info->name, text, error.message);
            assert_true(settings_get(&read, (enum setting_id)id) == value);
            tried++;
        }
    }
    assert_true(tried > 20 * (SETTING_COUNT - 1));
}

static void texts_are_understood(void **state)
{
    (void)state;
    static const struct {
        const char *name, *text;
        double value;
    } good[] = {{"density", "area", DENSITY_AREA},
                {"split", "once", SPLIT_ONCE},
                {"aa", "pixel", SPLAT_AA_PIXEL},
                {"jitter", "on", 1},
                {"jitter", "Yes", 1},
                {"caster_mask", "FALSE", 0},
                {"caster_mask", "0", 0},
                {"photons", "4096", 4096},
                {"photons", "1e3", 1000},
                {"kappa", "1.5", 1.5},
                {"tile", "full", TILE_FIT_FULL}};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        struct settings settings;
        struct error error;
        settings_default(&settings);
        if (!settings_set_text(&settings, good[i].name, good[i].text, &error))
            fail_msg("%s=%s: %s", good[i].name, good[i].text, error.message);
        for (unsigned id = 0; id < SETTING_COUNT; id++)
            if (strcmp(setting_infos[id].name, good[i].name) == 0)
                assert_true(settings_get(&settings, (enum setting_id)id) == good[i].value);
    }
    static const struct {
        const char *name, *text;
    } bad[] = {{"density", "Area"}, {"density", "are"},  {"density", "area,uniform"},
               {"density", ""},     {"jitter", "maybe"}, {"photons", "12x"},
               {"photons", ""},     {"photons", "nan"},  {"photons", "inf"},
               {"photons", "1.5"},  {"photons", "-1"},   {"kappa", "1e999"},
               {"kappa", "1 2"},    {"cells", "100"},    {"aa", "taa"}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct settings settings;
        struct error error = {0};
        settings_default(&settings);
        if (settings_set_text(&settings, bad[i].name, bad[i].text, &error))
            fail_msg("%s='%s' was taken", bad[i].name, bad[i].text);
        assert_int_equal(error.status, STATUS_INVALID);
        assert_non_null(strstr(error.message, bad[i].name));
    }
}

static void unknown_names_get_the_nearest(void **state)
{
    (void)state;
    static const char *const names[][2] = {
        {"photon", "photons"},         {"densty", "density"}, {"filter_radus", "filter_radius"},
        {"max_bounce", "max_bounces"}, {"Kappa", "kappa"},    {"split_", "split"}};
    struct settings settings;
    struct error error;
    settings_default(&settings);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        char quoted[64];
        assert_false(settings_set_text(&settings, names[i][0], "1", &error));
        assert_int_equal(error.status, STATUS_NOT_FOUND);
        snprintf(quoted, sizeof quoted, "'%s'", names[i][0]);
        assert_non_null(strstr(error.message, quoted));
        snprintf(quoted, sizeof quoted, "'%s'", names[i][1]);
        assert_non_null(strstr(error.message, quoted));
    }
    /* names of any length, from a socket */
    static char name[100000];
    memset(name, 'x', sizeof name - 1);
    assert_false(settings_set_text(&settings, name, "1", &error));
    assert_false(settings_set_text(&settings, "", "1", &error));
    memset(name, '9', sizeof name - 1);
    assert_false(settings_set_text(&settings, "photons", name, &error));
    assert_false(settings_set_text(&settings, "density", name, &error));
}

/* Text cut to any room ends, and nothing past it is touched. */
static void printing_keeps_to_its_room(void **state)
{
    (void)state;
    for (size_t size = 1; size < 12; size++) {
        char text[16];
        memset(text, '#', sizeof text);
        settings_print(SETTING_density, DENSITY_UNIFORM, text, size);
        assert_true(strlen(text) < size);
        for (size_t i = size; i < sizeof text; i++)
            assert_int_equal(text[i], '#');
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_table_is_sound),         cmocka_unit_test(ranges_hold),
        cmocka_unit_test(settings_are_apart),         cmocka_unit_test(what_is_printed_is_read),
        cmocka_unit_test(texts_are_understood),       cmocka_unit_test(unknown_names_get_the_nearest),
        cmocka_unit_test(printing_keeps_to_its_room),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
