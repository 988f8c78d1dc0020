/* What adapting the density is worth: how many more rays uniform density needs for the same error.
 *
 * For every rule the rays traced and the error of a frame at the default settings are set against two curves
 * of uniform density over growing budgets, log-log between their points: `mask`, over the cells that can meet
 * a caster, and `full`, over the light's whole emission without tile fitting or mask. Where uniform is still
 * worse at its largest budget the factor is a lower bound. Where it is better at its smallest, the factor is
 * an upper bound.
 *
 * With CAUSTICD_ADAPTIVE_TABLE set, the table is made for every built-in scene and nothing is asserted. */

#include <string.h>

#include "tests/support/check.h"
#include "tests/support/reference.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

#ifndef REFERENCE_PHOTONS
#define REFERENCE_PHOTONS 20e6
#endif
#define MASK_AIM 2.0
enum { WIDTH = 480, HEIGHT = 270, WARM_UP = 8, POINTS = 5, RULES = 3 };

struct point {
    double rays, photons, raw, filtered;
};

static struct point measure(struct truth *stage, const struct reference *reference, const char *settings,
                            uint32_t warm_up)
{
    truth_set(stage, settings);
    view_reset(stage->view);
    const struct frame_result *result = truth_render(stage, warm_up + 1, 1u << CHANNEL_CAUSTICS);
    const float *caustics = truth_channel(result, CHANNEL_CAUSTICS);
    return (struct point){result->stats[STAT_rays_traced], result->stats[STAT_photons_emitted],
                          reference_error(reference, caustics),
                          reference_filtered_error(reference, caustics)};
}

/* Uniform density over growing budgets: whole strata of every cell, up to what a device with 128 MiB of
 * storage buffer takes. More subframes would not do: their footprints stay as wide as one's. */
static void measure_uniform(struct truth *stage, const struct reference *reference, const char *settings,
                            struct point points[POINTS])
{
    static const int budgets[POINTS] = {4096, 16384, 65536, 147456, 262144};
    for (int i = 0; i < POINTS; i++) {
        char text[160];
        snprintf(text, sizeof text, "density=uniform photons=%d %s", budgets[i], settings);
        points[i] = measure(stage, reference, text, 0);
    }
}

struct factor {
    double value;
    char bound; /* '>': at least, '<': at most, ' ': between measured points */
};

static double error_of(const struct point *point, bool is_filtered)
{
    return is_filtered ? point->filtered : point->raw;
}

/* Rays of the curve at this error over `rays`. A curve that turns up again counts at the last place where it
 * was above the error: all that follow are better. Beyond the last point it goes on as steep as between the
 * last two: curves only get flatter (what remains is bias, and the reference's noise), so that is the least
 * it can be. */
static struct factor factor_at(const struct point points[POINTS], double error, double rays, bool is_filtered)
{
    int last = -1;
    for (int i = 0; i < POINTS; i++)
        if (error_of(&points[i], is_filtered) > error)
            last = i;
    if (last < 0)
        return (struct factor){points[0].rays / rays, '<'};
    bool is_beyond = last == POINTS - 1;
    const struct point *a = &points[is_beyond ? last - 1 : last], *b = a + 1;
    double from = log(error_of(a, is_filtered)), to = log(error_of(b, is_filtered));
    if (!(to < from))
        return (struct factor){b->rays / rays, '>'};
    double t = (log(error) - from) / (to - from);
    return (struct factor){exp(log(a->rays) + t * (log(b->rays) - log(a->rays))) / rays,
                           is_beyond ? '>' : ' '};
}

static void print_curve(const char *scene, const char *name, const struct point points[POINTS])
{
    for (int i = 0; i < POINTS; i++)
        print_message("%-8s uniform %-4s %9.0f photons %9.0f rays: L1 %6.2f %%, 3x3 %6.2f %%\n", scene, name,
                      points[i].photons, points[i].rays, 100 * points[i].raw, 100 * points[i].filtered);
}

struct outcome {
    struct factor mask, full; /* filtered */
};

static struct outcome compare(const char *scene)
{
    struct reference reference = reference_make(scene, WIDTH, HEIGHT, REFERENCE_PHOTONS, "energy");
    print_message("%-8s reference of %.1f M photons, noise %.2f %%, 3x3 %.2f %%\n", scene,
                  1e-6 * reference.photons, 100 * reference.noise, 100 * reference.filtered_noise);
    struct truth stage;
    stage_open(&stage, scene, WIDTH, HEIGHT, NULL);
    static const char *const names[RULES] = {"error", "sqrt", "area"}; /* the default first */
    struct point rules[RULES], mask[POINTS], full[POINTS];
    for (int i = 0; i < RULES; i++) {
        char settings[64];
        snprintf(settings, sizeof settings, "density=%s photons=%d", names[i],
                 (int)setting_infos[SETTING_photons].value);
        rules[i] = measure(&stage, &reference, settings, WARM_UP);
    }
    measure_uniform(&stage, &reference, "", mask);
    measure_uniform(&stage, &reference, "tile=full caster_mask=off", full);
    truth_close(&stage);
    print_curve(scene, "mask", mask);
    print_curve(scene, "full", full);
    struct outcome outcome = {0};
    for (int i = 0; i < RULES; i++) {
        struct factor factors[4];
        for (int k = 0; k < 4; k++)
            factors[k] = factor_at(k < 2 ? mask : full, k % 2 ? rules[i].raw : rules[i].filtered,
                                   rules[i].rays, k % 2 == 0);
        print_message("%-8s density=%-4s %9.0f photons %9.0f rays: L1 %6.2f %%, 3x3 %6.2f %%; uniform needs "
                      "%c%.2f (raw %c%.2f) times the rays over the mask, %c%.2f (raw %c%.2f) over all\n",
                      scene, names[i], rules[i].photons, rules[i].rays, 100 * rules[i].raw,
                      100 * rules[i].filtered, factors[0].bound, factors[0].value, factors[1].bound,
                      factors[1].value, factors[2].bound, factors[2].value, factors[3].bound,
                      factors[3].value);
        if (i == 0)
            outcome = (struct outcome){factors[0], factors[2]};
    }
    /* A reference as noisy as what it judges would hide the difference. */
    if (!getenv("CAUSTICD_ADAPTIVE_TABLE"))
        assert_in_bound(reference.filtered_noise, 0.5 * rules[0].filtered);
    reference_free(&reference);
    return outcome;
}

static void check(const char *scene)
{
    struct outcome outcome = compare(scene);
    if (getenv("CAUSTICD_ADAPTIVE_TABLE"))
        return;
    if (outcome.mask.value < MASK_AIM)
        print_error("%s: uniform over the mask needs %.2f times the rays, not %g\n", scene,
                    outcome.mask.value, MASK_AIM);
    if (outcome.full.value < 10 || outcome.full.bound == '<')
        print_error("%s: uniform over the whole emission needs %.2f times the rays, not 10\n", scene,
                    outcome.full.value);
    assert_true(outcome.full.value >= 10 && outcome.full.bound != '<');
    assert_true(outcome.mask.value >= MASK_AIM && outcome.mask.bound != '<');
}

static void sphere(void **state)
{
    (void)state;
    check("sphere");
}

static void square(void **state)
{
    (void)state;
    check("square");
}

static void the_others(void **state)
{
    (void)state;
    if (!getenv("CAUSTICD_ADAPTIVE_TABLE"))
        skip();
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        const char *name = builtin_scenes[i].name;
        if (strcmp(name, "sphere") != 0 && strcmp(name, "square") != 0 && strcmp(name, "empty") != 0 &&
            strcmp(name, "no-caster") != 0)
            check(name);
    }
}

int main(void)
{
    if (!getenv("CAUSTICD_LONG") && !getenv("CAUSTICD_ADAPTIVE_TABLE"))
        skip_program("takes 8 minutes on two cores; CAUSTICD_LONG=1 runs it");
    const struct CMUnitTest tests[] = {cmocka_unit_test(sphere), cmocka_unit_test(square),
                                       cmocka_unit_test(the_others)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
