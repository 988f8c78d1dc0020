/* Where the light goes: everything emitted is accounted for, what is drawn is what was deposited, and neither
 * depends on where photons are sent. */

#include <string.h>

#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 320, HEIGHT = 180, FRAMES = 3 };

static bool has_caustics(const struct frame_result *result)
{
    return result->black_reason == NULL;
}

/* Every statistic in W is a fate of emitted light, but for the light itself and the buffer made of it. */
static bool is_fate(enum stat_id stat)
{
    return !strncmp(stat_infos[stat].name, "flux_", 5) && stat != STAT_flux_emitted &&
           stat != STAT_flux_buffer;
}

/* What thinning shifts between photons is sampling error, not a place where light goes: the balance has to
 * hold without it as well. */
static bool is_place(enum stat_id stat)
{
    return is_fate(stat) && strcmp(stat_infos[stat].name, "flux_thinned") != 0;
}

static double sum_of(const struct frame_result *result, bool (*counts)(enum stat_id))
{
    double sum = 0;
    for (enum stat_id stat = 0; stat < STAT_COUNT; stat++)
        if (counts(stat))
            sum += result->stats[stat];
    return sum;
}

static uint32_t failures;

static void expect(double value, double bound, const char *scene, const char *what)
{
    if (value <= bound)
        return;
    failures++;
    print_error("%s: %s is %.4g, above %.4g\n", scene, what, value, bound);
}

/* ---- the ledger ---------------------------------------------------------------------------------------- */

static void check_ledger(struct truth *stage, const char *scene, const char *split, int photons)
{
    char settings[64];
    snprintf(settings, sizeof settings, "split=%s photons=%d", split, photons);
    truth_set(stage, settings);
    view_reset(stage->view);
    double worst = 0, worst_place = 0;
    for (int frame = 0; frame < FRAMES; frame++) {
        const struct frame_result *result = truth_render(stage, 1, 1u << CHANNEL_CAUSTICS);
        double emitted = result->stats[STAT_flux_emitted];
        if (!has_caustics(result)) {
            expect(emitted, 0, scene, "light emitted without a caustic");
            return;
        }
        assert_true(emitted > 0);
        for (enum stat_id stat = 0; stat < STAT_COUNT; stat++)
            if (is_place(stat))
                expect(-result->stats[stat], 0, scene, stat_infos[stat].name);
        if (strcmp(split, "once") != 0)
            expect(result->stats[STAT_guard_split] > 0 ? 0 : result->stats[STAT_flux_split_once] / emitted, 0,
                   scene, "flux_split_once where branches are followed");
        worst = fmax(worst, fabs(sum_of(result, is_fate) / emitted - 1));
        worst_place = fmax(worst_place, fabs(sum_of(result, is_place) / emitted - 1));
        for (enum stat_id stat = STAT_guard_density; stat <= STAT_guard_overflow; stat++)
            if (stat == STAT_guard_density || stat == STAT_guard_traversal || stat == STAT_guard_overflow)
                expect(result->stats[stat], 0, scene, stat_infos[stat].name);
    }
    print_message("%-9s split=%-8s fates sum to emitted within %.4f %%, without thinning %.4f %%\n", scene,
                  split, 100 * worst, 100 * worst_place);
    expect(worst, 1e-3, scene, "the ledger's error");
    expect(worst_place, 1e-3, scene, "the ledger's error without thinning");
}

/* ---- the buffer ---------------------------------------------------------------------------------------- */

/* Of the next frame of a view whose density has settled. */
static void check_buffer(struct truth *stage, const char *scene, const char *aa)
{
    char setting[64];
    snprintf(setting, sizeof setting, "aa=%s", aa);
    truth_set(stage, setting);
    const struct frame_result *result = truth_render(stage, 1, 1u << CHANNEL_CAUSTICS);
    double splatted = result->stats[STAT_flux_splatted], buffer = result->stats[STAT_flux_buffer];
    double share = splatted / fmax(result->stats[STAT_flux_emitted], 1e-30);
    if (!has_caustics(result)) {
        expect(buffer, 0, scene, "the flux of a black buffer");
        return;
    }
    /* Every built-in camera shows its caustic: a thousandth of the light at the very least. */
    expect(1e-3, share, scene, "a thousandth of the light (against what the view sees)");
    double error = fabs(buffer / splatted - 1);
    print_message(
        "%-9s aa=%-6s buffer %.5g W, deposited in view %.5g W (%.1f %% of emitted): %.3f %% apart\n", scene,
        aa, buffer, splatted, 100 * share, 100 * error);
    char what[64];
    snprintf(what, sizeof what, "buffer against deposit, aa=%s", aa);
    expect(error, 5e-3, scene, what);
}

static void every_builtin_scene_keeps_its_light(void **state)
{
    (void)state;
    failures = 0;
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        struct truth stage;
        const char *scene = builtin_scenes[i].name;
        stage_open(&stage, scene, WIDTH, HEIGHT, NULL);
        check_ledger(&stage, scene, "once", 32768);
        check_ledger(&stage, scene, "roulette", 32768);
        check_ledger(&stage, scene, "energy", (int)setting_infos[SETTING_photons].value);
        check_buffer(&stage, scene, "filter");
        check_buffer(&stage, scene, "pixel");
        truth_close(&stage);
    }
    assert_int_equal(failures, 0);
}

/* ---- the picture --------------------------------------------------------------------------------------- */

/* The caustics channel of a scene whose only receiver is a floor at y = 0, integrated here: radiance times pi
 * over the floor's albedo times the area of floor in a pixel, which follows from the camera alone. */
static void check_picture(const char *scene, const char *settings)
{
    struct truth stage;
    stage_open(&stage, scene, WIDTH, HEIGHT, settings);
    const struct scene_material *floor = NULL;
    for (uint32_t i = 0; i < stage.scene->instance_count; i++) {
        const struct scene_mesh *mesh = &stage.scene->meshes[stage.scene->instances[i].mesh];
        if (stage.scene->materials[mesh->material].kind == MATERIAL_DIFFUSE) {
            assert_null(floor);
            floor = &stage.scene->materials[mesh->material];
            assert_close((double)mesh->bounds_min[1], 0, 0);
            assert_close((double)mesh->bounds_max[1], 0, 0);
        }
    }
    assert_non_null(floor);
    const struct frame_result *result = truth_render(&stage, FRAMES, 1u << CHANNEL_CAUSTICS);
    const float *radiance = truth_channel(result, CHANNEL_CAUSTICS);
    stage.camera = result->camera;
    double flux = 0;
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++)
            for (uint32_t k = 0; k < 3; k++)
                flux += (double)radiance[3 * (y * WIDTH + x) + k] * 3.14159265358979323846 /
                        (double)floor->base_color[k] * truth_pixel_area(&stage, x + 0.5, y + 0.5);
    double error = flux / result->stats[STAT_flux_splatted] - 1;
    print_message("%-9s %s: the picture holds %+.3f %% more than was deposited in view\n", scene, settings,
                  100 * error);
    expect(fabs(error), 5e-3, scene, settings);
    truth_close(&stage);
}

static void pictures_hold_the_light(void **state)
{
    (void)state;
    failures = 0;
    check_picture("sphere", "aa=filter");
    check_picture("sphere", "aa=pixel");
    check_picture("ring", "aa=filter");
    check_picture("ring", "aa=pixel");
    assert_int_equal(failures, 0);
}

/* ---- density ------------------------------------------------------------------------------------------- */

enum { SAMPLES = 8 };
struct mean {
    double value, error; /* standard error of the mean */
};

/* Of flux_splatted / flux_emitted over frames whose photons move within their strata. */
static struct mean visible_share(struct truth *stage, const char *settings, double *emitted)
{
    truth_set(stage, settings);
    view_reset(stage->view);
    truth_render(stage, 3, 1u << CHANNEL_CAUSTICS);
    double sum = 0, squares = 0;
    for (int i = 0; i < SAMPLES; i++) {
        const struct frame_result *result = truth_render(stage, 1, 1u << CHANNEL_CAUSTICS);
        *emitted = result->stats[STAT_flux_emitted];
        double share = result->stats[STAT_flux_splatted] / *emitted;
        sum += share;
        squares += share * share;
    }
    double value = sum / SAMPLES, variance = fmax(squares / SAMPLES - value * value, 0);
    return (struct mean){value, sqrt(variance / (SAMPLES - 1))};
}

static void flux_does_not_depend_on_the_density(void **state)
{
    (void)state;
    static const char *const scenes[] = {"sphere", "ring", "square", "cube"};
    failures = 0;
    for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++) {
        struct truth stage;
        stage_open(&stage, scenes[i], WIDTH, HEIGHT, "photons=32768 jitter=on");
        double emitted[3];
        struct mean uniform = visible_share(&stage, "density=uniform", &emitted[0]);
        struct mean root = visible_share(&stage, "density=sqrt", &emitted[1]);
        struct mean area = visible_share(&stage, "density=area", &emitted[2]);
        print_message("%-9s seen share of the light: uniform %.5f +- %.5f, sqrt %.5f +- %.5f, area %.5f +- "
                      "%.5f\n",
                      scenes[i], uniform.value, uniform.error, root.value, root.error, area.value,
                      area.error);
        /* Four standard errors of the difference, and what single precision costs the sums. */
        expect(fabs(root.value - uniform.value), 4 * hypot(root.error, uniform.error) + 2e-5, scenes[i],
               "sqrt against uniform");
        expect(fabs(area.value - uniform.value), 4 * hypot(area.error, uniform.error) + 2e-5, scenes[i],
               "area against uniform");
        /* Otherwise the line above compares noise with noise. */
        expect(uniform.error, 0.01 * uniform.value, scenes[i], "the sampling error");
        expect(fabs(emitted[1] / emitted[0] - 1), 1e-5, scenes[i], "emitted by sqrt against uniform");
        expect(fabs(emitted[2] / emitted[0] - 1), 1e-5, scenes[i], "emitted by area against uniform");
        truth_close(&stage);
    }
    assert_int_equal(failures, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(pictures_hold_the_light),
                                       cmocka_unit_test(every_builtin_scene_keeps_its_light),
                                       cmocka_unit_test(flux_does_not_depend_on_the_density)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
