/* What quality and budget_ms make of the photons, on a device. How long a frame takes is not compared: the
 * governor's answer to it is tests/unit/test_governor.c. */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 64, HEIGHT = 36, VALUES = 3 * WIDTH * HEIGHT };
#define CAUSTICS (1u << CHANNEL_CAUSTICS)

static void expect_same_frames(const char *settings, const char *others)
{
    struct truth one, other;
    stage_open(&one, "sphere", WIDTH, HEIGHT, settings);
    stage_open(&other, "sphere", WIDTH, HEIGHT, others);
    for (int i = 0; i < 4; i++) {
        const float *a = truth_channel(truth_render(&one, 1, CAUSTICS), CHANNEL_CAUSTICS);
        const float *b = truth_channel(truth_render(&other, 1, CAUSTICS), CHANNEL_CAUSTICS);
        if (memcmp(a, b, VALUES * sizeof *a) != 0)
            fail_msg("frame %d differs with \"%s\" and \"%s\"", i, settings, others);
    }
    truth_close(&one);
    truth_close(&other);
}

static void quality_is_photons_and_target_area(void **state)
{
    (void)state;
    expect_same_frames("photons=16384 quality=draft", "photons=4096 target_area=0.4");
    expect_same_frames("photons=16384 quality=final", "photons=65536 target_area=0.025");
    expect_same_frames("photons=16384 quality=good budget_ms=0", "photons=16384");
}

static double governed(struct truth *stage, const char *settings, uint32_t frames)
{
    truth_set(stage, settings);
    const struct frame_result *result = truth_render(stage, frames, CAUSTICS);
    assert_in_bound(result->stats[STAT_photons_emitted], result->stats[STAT_governor_photons]);
    return result->stats[STAT_governor_photons];
}

/* An hour has all photons, a millionth of a millisecond those that every cell keeps; buffers are made once.
 */
static void the_budget_stays_within_its_limits(void **state)
{
    (void)state;
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, "photons=16384 cells=32");
    truth_render(&stage, 1, CAUSTICS);
    const double start = 4096; /* between 1,024 and 16,384 */
    assert_close(governed(&stage, "budget_ms=3600000", 1), start, 0);
    double bytes = truth_render(&stage, 1, CAUSTICS)->stats[STAT_device_bytes];
    assert_close(governed(&stage, "budget_ms=3600000", 24), 16384, 0);
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    assert_close(result->stats[STAT_governor_target_area], 0.1 / 64, 1e-6);
    assert_true(result->stats[STAT_photons_emitted] > 8192);
    assert_close(governed(&stage, "budget_ms=0.000001", 24), 32 * 32, 0);
    assert_close(truth_render(&stage, 1, CAUSTICS)->stats[STAT_device_bytes], bytes, 0);
    assert_close(governed(&stage, "budget_ms=10 quality=final", 1), 1024, 0);
    result = truth_render(&stage, 1, 1u << CHANNEL_DEPTH);
    assert_close(result->stats[STAT_governor_photons], 0, 0);
    truth_close(&stage);
}

/* Samples of multisampled splats give way where time is scarce, and are all there again without a budget. */
static void samples_give_way(void **state)
{
    (void)state;
    static const char *const modes[] = {"aa=msaa", "aa=msaa_sample", "aa=msaa_small"};
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, "photons=16384 cells=32");
    const double most = gpu_info(stage.gpu)->max_samples;
    if (most < 2) {
        truth_close(&stage);
        print_message("left out: the device takes one sample a pixel\n");
        return;
    }
    for (int i = 0; i < 3; i++) {
        truth_set(&stage, modes[i]);
        truth_set(&stage, "budget_ms=3600000");
        assert_close(truth_render(&stage, 8, CAUSTICS)->stats[STAT_aa_samples], most, 0);
        truth_set(&stage, "budget_ms=0.000001");
        const struct frame_result *result = truth_render(&stage, 40, CAUSTICS);
        assert_close(result->stats[STAT_aa_samples], 1, 0);
        assert_true(result->stats[STAT_photons_contributing] > 0);
        truth_set(&stage, "budget_ms=0");
        assert_close(truth_render(&stage, 1, CAUSTICS)->stats[STAT_aa_samples], most, 0);
    }
    truth_close(&stage);
}

/* At a limit nothing is steered: a still view comes to rest as any other, and repeats to the bit. */
static void a_governed_view_comes_to_rest(void **state)
{
    (void)state;
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, "photons=16384 cells=32 budget_ms=3600000");
    static float before[VALUES];
    memcpy(before, truth_channel(truth_render(&stage, 40, CAUSTICS), CHANNEL_CAUSTICS), sizeof before);
    const float *after = truth_channel(truth_render(&stage, 1, CAUSTICS), CHANNEL_CAUSTICS);
    assert_memory_equal(before, after, sizeof before);
    truth_close(&stage);
}

static void times_out_of_range_are_refused(void **state)
{
    (void)state;
    struct truth stage;
    struct error error;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, NULL);
    const double wrong[] = {-1, 3.7e6, NAN, INFINITY};
    for (int i = 0; i < 4; i++) {
        assert_false(view_set_setting(stage.view, SETTING_budget_ms, wrong[i], &error));
        assert_non_null(strstr(error.message, "budget_ms"));
    }
    truth_close(&stage);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(quality_is_photons_and_target_area),
        cmocka_unit_test(the_budget_stays_within_its_limits),
        cmocka_unit_test(samples_give_way),
        cmocka_unit_test(a_governed_view_comes_to_rest),
        cmocka_unit_test(times_out_of_range_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
