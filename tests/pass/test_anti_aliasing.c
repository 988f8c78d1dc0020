/* What anti-aliasing does to whole frames: the light it keeps, the photons it misses, and that every mode
 * gives the same bits again. Each mode's kernel is held to its model in test_pass_splat.c. */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 120, HEIGHT = 68, PIXELS = WIDTH * HEIGHT, FRAMES = 3 };
#define CAUSTICS (1u << CHANNEL_CAUSTICS)

static const char *const modes[] = {"filter",      "none",       "coverage", "pixel",
                                    "msaa_sample", "msaa_small", "msaa"};
enum { MODES = sizeof modes / sizeof *modes, QUADS = 4 /* the first that is rasterised */ };

/* How many of the modes the device has. */
static uint32_t mode_count(const struct truth *stage)
{
    if (gpu_info(stage->gpu)->max_samples > 1)
        return MODES;
    print_message("multisampled modes are left out: the device takes one sample a pixel\n");
    return QUADS;
}

static const struct frame_result *render(struct truth *stage, const char *mode)
{
    char setting[64];
    snprintf(setting, sizeof setting, "aa=%s", mode);
    truth_set(stage, setting);
    view_reset(stage->view);
    return truth_render(stage, FRAMES, CAUSTICS);
}

/* The numbers the thesis' figures 32, 35, 37 and 41 are about, and where filter and coverage stand. */
static void light_and_photons_are_kept(void **state)
{
    (void)state;
    struct truth stage;
    double flux[MODES], missing[MODES];
    stage_open(&stage, "ring", WIDTH, HEIGHT, "photons=16384");
    uint32_t count = mode_count(&stage);
    for (uint32_t i = 0; i < count; i++) {
        const double *stats = render(&stage, modes[i])->stats;
        flux[i] = stats[STAT_flux_buffer] / stats[STAT_flux_splatted] - 1;
        missing[i] = 1 - stats[STAT_photons_contributing] / stats[STAT_photons_splatted];
        print_message("ring aa=%-12s flux %+.2f %%, %.2f %% of the photons reach no pixel\n", modes[i],
                      100 * flux[i], 100 * missing[i]);
    }
    truth_close(&stage);
    assert_in_bound(missing[0], 0.1 * missing[1]); /* what filter misses lies behind an edge */
    assert_in_bound(missing[2], 1e-3);             /* coverage misses none */
    assert_true(missing[1] > 0.2);                 /* thin ellipses slip between pixel centres */
    if (count < MODES)
        return;
    assert_in_bound(missing[4], 0.5 * missing[1]); /* per-sample shading catches many of them */
    assert_true(missing[6] > missing[1]);          /* plain multisampling misses more, */
    assert_in_bound(flux[6], -0.1);                /* and dims, */
    assert_in_bound(fabs(flux[4]), 0.02);          /* which per-sample shading repairs */
}

/* On the sphere no receiver has an edge in view: nothing spills over. */
static void frames_repeat_to_the_bit(void **state)
{
    (void)state;
    struct truth stage;
    float *first = malloc(3 * PIXELS * sizeof *first);
    assert_non_null(first);
    stage_open(&stage, "sphere", WIDTH, HEIGHT, "photons=16384");
    uint32_t count = mode_count(&stage);
    for (uint32_t i = 0; i < count; i++)
        for (int turn = 0; turn < 2; turn++) {
            const struct frame_result *result = render(&stage, modes[i]);
            const float *values = truth_channel(result, CHANNEL_CAUSTICS);
            double flux = result->stats[STAT_flux_buffer] / result->stats[STAT_flux_splatted] - 1;
            if (turn == 0) {
                print_message("sphere aa=%-12s flux %+.2f %%\n", modes[i], 100 * flux);
                if (strcmp(modes[i], "filter") == 0 || strcmp(modes[i], "coverage") == 0)
                    assert_in_bound(fabs(flux), 5e-3);
                memcpy(first, values, 3 * PIXELS * sizeof *first);
            } else if (memcmp(first, values, 3 * PIXELS * sizeof *first) != 0)
                fail_msg("aa=%s: the same frames again have other bits", modes[i]);
        }
    free(first);
    truth_close(&stage);
}

/* Point samples of a spot below a pixel are a matter of where they fall: one frame is off by a tenth and
 * more. `accumulate` moves them within their pixels, and their mean comes to the light there is; what is left
 * after 256 places falls with their number (docs/aaps.md). */
static void moved_samples_keep_the_light(void **state)
{
    (void)state;
    static const char *const sampled[] = {"aa=none", "aa=msaa_sample"};
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH / 2, HEIGHT / 2, "photons=4096 cells=32 kappa=16");
    uint32_t count = mode_count(&stage) > QUADS ? 2 : 1;
    for (uint32_t i = 0; i < count; i++) {
        double flux[2];
        truth_set(&stage, sampled[i]);
        for (int k = 0; k < 2; k++) {
            truth_set(&stage, k ? "accumulate=256" : "accumulate=1");
            view_reset(stage.view);
            const double *stats = truth_render(&stage, k ? 1 : FRAMES, CAUSTICS)->stats;
            flux[k] = stats[STAT_flux_buffer] / stats[STAT_flux_splatted] - 1;
        }
        print_message("sphere %s: flux %+.2f %%, of 256 frames %+.2f %%\n", sampled[i], 100 * flux[0],
                      100 * flux[1]);
        assert_true(fabs(flux[0]) > 0.1);
        assert_in_bound(fabs(flux[1]), 0.015);
    }
    truth_close(&stage);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(light_and_photons_are_kept),
        cmocka_unit_test(frames_repeat_to_the_bit),
        cmocka_unit_test(moved_samples_keep_the_light),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
