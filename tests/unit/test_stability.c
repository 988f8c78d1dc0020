/* caustic-stability without a server: its paths as functions of the frame, its limits, and its measures of a
 * path that was made up so that every number is known. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/stability/analyse.h"
#include "tests/support/check.h"

#define WIDTH  16u
#define HEIGHT 9u
#define PIXELS (WIDTH * HEIGHT)

static struct error error;

static const struct path_base base = {
    .camera = {.eye = {0, 2, 4}, .at = {0, 1, 2}, .up = {0, 2, 0}, .fov = 40},
    .pivot = {0, 0, 0.5f},
    .has_light = true,
    .light = {.type = PROTOCOL_LIGHT_SPOT, .position = {1, 3, 0.5f}, .direction = {0, -1, 1}},
    .orbit_step = 0.5,
    .cut_angle = 90,
    .light_angle = 90,
    .sweep_step = 1,
    .rate = 10,
    .flicker_period = 4,
    .width_over_height = 16.0 / 9,
};

static struct path_state at(enum path_id id, int64_t frame, uint32_t frames)
{
    struct path_state state, again;
    assert_true(path_at(id, &base, frame, frames, &state, &error));
    assert_true(path_at(id, &base, frame, frames, &again, &error));
    assert_memory_equal(&state, &again, sizeof state);
    return state;
}

static double distance(const float *a, const float *b)
{
    double sum = 0;
    for (int k = 0; k < 3; k++)
        sum += ((double)a[k] - (double)b[k]) * ((double)a[k] - (double)b[k]);
    return sqrt(sum);
}

/* ---- paths -------------------------------------------------------------------------------------------- */

static void an_orbit_keeps_its_distance_and_step(void **state)
{
    (void)state;
    double step = 0;
    for (int64_t frame = 1; frame < 41; frame++) {
        struct path_state a = at(PATH_ORBIT, frame - 1, 41), b = at(PATH_ORBIT, frame, 41);
        assert_true(b.has_camera && !b.has_light);
        assert_close(distance(b.camera.eye, base.pivot), distance(base.camera.eye, base.pivot), 1e-5);
        assert_close(distance(b.camera.eye, b.camera.at), distance(base.camera.eye, base.camera.at), 1e-5);
        assert_close((double)b.camera.eye[1], 2, 1e-6);
        step = distance(a.camera.eye, b.camera.eye);
        assert_close(step, 2 * 3.5 * sin(0.25 * 0.0174532925), 1e-5);
    }
    /* Half way it is at the scene's own camera, and before it begins it waits at the beginning. */
    assert_close(distance(at(PATH_ORBIT, 20, 41).camera.eye, base.camera.eye), 0, 1e-5);
    assert_close(distance(at(PATH_ORBIT, -7, 41).camera.eye, at(PATH_ORBIT, 0, 41).camera.eye), 0, 0);
}

static void a_cut_is_one_jump(void **state)
{
    (void)state;
    struct path_state old = at(PATH_CUT, -1, 32), new = at(PATH_CUT, 0, 32), later = at(PATH_CUT, 31, 32);
    assert_close(distance(old.camera.eye, base.camera.eye), 0, 0);
    assert_memory_equal(&new, &later, sizeof new);
    /* A quarter turn about the pivot and a quarter closer: (0, 2, 3.5) becomes (3.5, 2, 0) * 0.75. */
    assert_close((double)new.camera.eye[0], 2.625, 1e-5);
    assert_close((double)new.camera.eye[1], 1.5, 1e-5);
    assert_close((double)new.camera.eye[2], 0.5, 1e-5);
}

static void a_light_turns_about_the_vertical(void **state)
{
    (void)state;
    struct path_state old = at(PATH_LIGHT_STEP, -3, 32), new = at(PATH_LIGHT_STEP, 0, 32);
    assert_true(new.has_light && !new.has_camera);
    assert_close((double)old.position[0], 1, 0);
    assert_close((double)new.position[0], 0, 1e-6);
    assert_close((double)new.position[1], 3, 1e-6);
    assert_close((double)new.position[2], -0.5, 1e-6);
    assert_close((double)new.direction[0], 1, 1e-6); /* a direction turns about no point */
    assert_close((double)new.direction[1], -1, 1e-6);
    assert_close((double)new.direction[2], 0, 1e-6);
    struct path_base dark = base;
    dark.has_light = false;
    struct path_state unused;
    assert_false(path_at(PATH_LIGHT_SWEEP, &dark, 0, 32, &unused, &error));
    assert_non_null(strstr(error.message, "light-sweep"));
}

static void objects_pass_by_animation_or_by_pan(void **state)
{
    (void)state;
    char text[200];
    struct path_base animated = base;
    animated.duration = 2;
    struct path_state seen;
    assert_true(path_at(PATH_OBJECT, &animated, 7, 48, &seen, &error));
    assert_close(seen.time, 0.7, 1e-12);
    assert_false(seen.has_camera);
    path_describe(PATH_OBJECT, &base, text, sizeof text);
    assert_non_null(strstr(text, "no animation"));
    /* At both ends the camera looks where it did; half way everything has left the picture. */
    assert_close(distance(at(PATH_OBJECT, 0, 49).camera.at, base.camera.at), 0, 0);
    assert_close(distance(at(PATH_OBJECT, 48, 49).camera.at, base.camera.at), 0, 1e-5);
    struct path_state away = at(PATH_OBJECT, 24, 49);
    double dot = 0, length = distance(base.camera.at, base.camera.eye);
    for (int k = 0; k < 3; k += 2)
        dot += ((double)away.camera.at[k] - (double)away.camera.eye[k]) *
               ((double)base.camera.at[k] - (double)base.camera.eye[k]);
    double turned = acos(dot / (length * length - 1)), width = 2 * atan(tan(20 * 0.0174532925) * 16 / 9);
    assert_close(turned, 1.5 * width, 1e-4);
}

static void settings_take_turns(void **state)
{
    (void)state;
    for (int64_t frame = -8; frame < 32; frame++)
        assert_int_equal(at(PATH_SETTINGS_FLICKER, frame, 32).is_second, frame >= 0 && frame / 4 % 2 == 1);
}

static void an_unknown_path_is_told_which_there_are(void **state)
{
    (void)state;
    enum path_id id;
    assert_true(path_find("light-step", &id, &error));
    assert_int_equal(id, PATH_LIGHT_STEP);
    assert_false(path_find("lightstep", &id, &error));
    assert_non_null(strstr(error.message, "lightstep"));
    assert_non_null(strstr(error.message, "still, orbit, cut"));
}

/* ---- limits ------------------------------------------------------------------------------------------- */

static void limits_are_read_and_judged(void **state)
{
    (void)state;
    struct gate gate, other;
    assert_true(gate_parse("flicker_p99=0.005", &gate, &error));
    assert_true(gate.measure == MEASURE_flicker_p99 && gate.limit == 0.005 && !*gate.path);
    assert_true(gate_parse("light-step.frames_to_95=3", &other, &error));
    assert_string_equal(other.path, "light-step");
    json_t *paths = json_pack("[{s:s, s:{s:f, s:s}}, {s:s, s:{s:f, s:n}}, {s:s, s:{}}]", "path", "still",
                              "measures", "flicker_p99", 0.004, "frames_to_95", "never", "path", "drift",
                              "measures", "flicker_p99", -0.02, "frames_to_95", "path", "cut", "measures");
    json_t *results = gate_results(&gate, paths);
    assert_int_equal(json_array_size(results), 2);
    assert_true(json_is_true(json_object_get(json_array_get(results, 0), "passed")));
    /* The size counts: a drift downwards is one. */
    assert_true(json_is_false(json_object_get(json_array_get(results, 1), "passed")));
    json_decref(results);
    assert_true(gate_parse("frames_to_95=1000", &other, &error));
    results = gate_results(&other, paths);
    assert_true(json_is_false(json_object_get(json_array_get(results, 0), "passed"))); /* never */
    assert_true(json_is_true(json_object_get(json_array_get(results, 1), "passed")));  /* nothing to tell */
    json_decref(results);
    json_decref(paths);
}

static void nonsense_limits_are_refused(void **state)
{
    (void)state;
    const char *const texts[][2] = {
        {"flicker_p99", "write MEASURE=LIMIT"},        {"=3", "write MEASURE=LIMIT"},
        {"flicker_p99=low", "low is not a limit"},     {"flicker_p99=-1", "-1 is not a limit"},
        {"flicker_p99=nan", "nan is not a limit"},     {"flicker_p9=1", "did you mean flicker_p9"},
        {"frames_to_96=1", "did you mean frames_to_9"}};
    struct gate gate;
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        assert_false(gate_parse(texts[i][0], &gate, &error));
        if (!strstr(error.message, texts[i][1]) || !strstr(error.message, texts[i][0]))
            fail_msg("%s", error.message);
    }
    assert_true(gate_parse("ghost_1=0.1", &gate, &error));
    assert_false(gate_check(&gate, MEASURED_RESTING | MEASURED_MOVING, true, &error));
    assert_non_null(
        strstr(error.message, "ghost_1: no path that is run measures it; it takes cut or light-step"));
    assert_true(gate_check(&gate, MEASURED_STEPPING, false, &error));
    assert_true(gate_parse("difference_rmse=0.1", &gate, &error));
    assert_false(gate_check(&gate, MEASURED_MOVING, false, &error));
    assert_non_null(strstr(error.message, "--pairs is 0"));
    assert_true(gate_check(&gate, MEASURED_RESTING, false, &error)); /* what stands still needs none */
}

/* ---- measures of what was made up -----------------------------------------------------------------------
 */

/* A picture of one brightness on its left half and another on its right. */
static struct snapshot halves(float left, float right)
{
    struct snapshot picture;
    float *rgb = malloc(PIXELS * 3 * sizeof *rgb);
    for (uint32_t i = 0; i < PIXELS * 3; i++)
        rgb[i] = i / 3 % WIDTH < WIDTH / 2 ? left : right;
    assert_true(snapshot_make(rgb, WIDTH, HEIGHT, &picture, &error));
    return picture;
}

static const struct stability_options options = {
    .caustic_share = 0.02, .flicker_limit = 0.005, .settle_band = 0.02, .warmup = 4};

/* Memory as drive_path makes it, for drive_clear to free. */
static struct drive make_drive(enum path_id path, uint32_t frames)
{
    struct drive drive = {.options = &options, .base = base, .width = WIDTH, .height = HEIGHT};
    drive.path = path;
    drive.warmup = options.warmup;
    drive.frames = frames;
    drive.done = frames + drive.warmup;
    for (int i = 0; i < STATISTIC_COUNT; i++)
        drive.series[i] = calloc(drive.done, sizeof(double));
    drive.light = calloc(drive.done, sizeof(double));
    drive.flip = calloc(drive.done, sizeof(double));
    drive.successive = calloc(drive.done, sizeof(double));
    return drive;
}

static double value_of(const struct analysis *analysis, enum measure_id id)
{
    if (!analysis->measures.is_set[id])
        fail_msg("%s was not measured", measure_infos[id].name);
    return analysis->measures.values[id];
}

/* Light moves from the left half to the right one: a fifth of what is left stays behind in every frame. So
 * 0.04 is left after two frames and 0.008 after three. Photons go from 1000 to 2000 and on to 2500 once. */
static void a_step_that_was_made_up(void **state)
{
    (void)state;
    struct drive drive = make_drive(PATH_LIGHT_STEP, 32);
    drive.kept = calloc(33, sizeof *drive.kept);
    for (uint32_t k = 0; k <= 32; k++) {
        double rest = pow(0.2, k);
        drive.kept[k] = halves((float)(4 * rest), (float)(4 * (1 - rest)));
    }
    for (uint32_t i = 0; i < drive.done; i++)
        drive.series[STATISTIC_PHOTONS][i] = i < 4 ? 1000 : i == 5 ? 2500 : 2000;
    drive.pair_count = 1;
    drive.pairs = calloc(1, sizeof *drive.pairs);
    drive.pairs[0] = (struct drive_pair){.before = halves(4, 0),
                                         .now = halves(0.8f, 3.2f),
                                         .reference_before = halves(4, 0),
                                         .reference_now = halves(0, 4.4f)};
    struct analysis analysis = {0};
    assert_true(analysis_make(&drive, &analysis, &error));
    assert_close(value_of(&analysis, MEASURE_frames_to_90), 2, 0);
    assert_close(value_of(&analysis, MEASURE_frames_to_95), 2, 0);
    assert_close(value_of(&analysis, MEASURE_frames_to_99), 3, 0);
    assert_close(value_of(&analysis, MEASURE_ghost_1), 0.2, 1e-5);
    assert_close(value_of(&analysis, MEASURE_ghost_3), 0.008, 1e-6);
    assert_close(value_of(&analysis, MEASURE_ghost_end), 0, 1e-6);
    assert_close(value_of(&analysis, MEASURE_photons_settling), 3, 0);
    assert_close(value_of(&analysis, MEASURE_photons_overshoot), 0.5, 1e-9);
    assert_close(value_of(&analysis, MEASURE_photons_oscillation), 0, 0);
    /* Settled, 0.4 of 4.4 is missing; frame 3 misses 0.4 + 0.032 and has 0.032 where nothing should be. */
    assert_close(value_of(&analysis, MEASURE_reference_error), 0.4 / 4.4, 1e-5);
    assert_close(value_of(&analysis, MEASURE_step_error_3), (0.4 + 2 * 0.032) / 0.4, 1e-4);
    assert_close(value_of(&analysis, MEASURE_frames_to_error), 4, 0); /* 1 + 5 * 4 * 0.2^k <= 1.15 */
    /* Frame 1 changed by (-3.2, 3.2) where the reference changed by (-4, 4.4), whose RMS is 4.4 over a half.
     */
    assert_close(value_of(&analysis, MEASURE_difference_rmse), sqrt(0.8 * 0.8 + 1.2 * 1.2) / 4.4, 1e-5);
    assert_close(value_of(&analysis, MEASURE_reference_change), sqrt(16 + 4.4 * 4.4) / 4.4, 1e-5);
    assert_in_bound(value_of(&analysis, MEASURE_step_flip_3), value_of(&analysis, MEASURE_step_flip_1));
    assert_false(analysis.measures.is_set[MEASURE_flicker_p99]);
    analysis_free(&analysis);
    drive_clear(&drive);
}

/* A right half that swings by 1 % up and down in turn, photons that do by 5 %, and light that grows. */
static void a_rest_that_was_made_up(void **state)
{
    (void)state;
    struct drive drive = make_drive(PATH_STILL, 64);
    drive.pixels = temporal_pixels_create(WIDTH, HEIGHT, &error);
    for (uint32_t i = 0; i < drive.done; i++) {
        double swing = i % 2 ? 1 : -1;
        struct snapshot picture = halves(2, (float)(2 * (1 + 0.01 * swing)));
        drive.series[STATISTIC_PHOTONS][i] = 1000 * (1 + 0.05 * swing);
        drive.series[STATISTIC_DENSITY][i] = 500;
        drive.light[i] = 3 + 0.003 * ((int)i - 4);
        drive.successive[i] = i ? 0.014 : (double)NAN;
        drive.flip[i] = i % 3 ? (double)NAN : 0.02;
        if (i >= drive.warmup)
            temporal_pixels_add(drive.pixels, picture.luminance);
        if (i == drive.warmup)
            drive.first = picture;
        else if (i + 1 == drive.done)
            drive.last = picture;
        else
            snapshot_free(&picture);
    }
    struct analysis analysis = {0};
    assert_true(analysis_make(&drive, &analysis, &error));
    assert_close(value_of(&analysis, MEASURE_caustic_pixels), PIXELS, 0);
    assert_close(value_of(&analysis, MEASURE_flicker_p99), 0.01 * sqrt(64.0 / 63), 1e-6);
    assert_close(value_of(&analysis, MEASURE_flicker_mean), 0.005 * sqrt(64.0 / 63), 1e-6);
    assert_close(value_of(&analysis, MEASURE_flicker_pixels), PIXELS / 2, 0);
    assert_close(value_of(&analysis, MEASURE_flicker_patch), PIXELS / 2, 0);
    assert_true(isinf(value_of(&analysis, MEASURE_photons_settling)));
    /* Measured about the line through the last half, which leans by a tenth of the swing. */
    assert_close(value_of(&analysis, MEASURE_photons_oscillation), 0.05, 0.005);
    assert_close(value_of(&analysis, MEASURE_photons_period), 2, 0.01);
    assert_in_bound(0.99, value_of(&analysis, MEASURE_photons_period_share));
    assert_close(value_of(&analysis, MEASURE_density_settling), 1,
                 0); /* the first is the seed, whatever it is */
    assert_true(isnan(value_of(&analysis, MEASURE_density_period)));
    assert_close(value_of(&analysis, MEASURE_difference_rmse), 0.014, 1e-9);
    assert_close(value_of(&analysis, MEASURE_flip_mean), 0.02, 1e-9);
    /* 3 + 0.003 t over 64 frames: a mean of 3.0945. */
    assert_close(value_of(&analysis, MEASURE_light_drift), 3 / 3.0945, 1e-6);
    assert_close(value_of(&analysis, MEASURE_picture_drift), 0.02 / 1.99, 1e-5);
    assert_close((double)analysis.flicker_map[WIDTH - 1], 0.01 * sqrt(64.0 / 63), 1e-6);
    assert_true(analysis.flicker_map[0] == 0);
    analysis_free(&analysis);
    drive_clear(&drive);
}

/* Two pictures in turn, four frames each; the new one is there at once but for 2 % in its first frame. */
static void an_alternation_that_was_made_up(void **state)
{
    (void)state;
    struct drive drive = make_drive(PATH_SETTINGS_FLICKER, 32);
    drive.pixels = temporal_pixels_create(WIDTH, HEIGHT, &error);
    drive.kept = calloc(33, sizeof *drive.kept);
    drive.kept[0] = halves(1, 0.5f);
    for (uint32_t k = 0; k < 32; k++) {
        bool is_first = k % 4 == 0 && k > 0, is_second = k / 4 % 2 == 1;
        float from = is_second ? 0.5f : 1.5f, to = is_second ? 1.5f : 0.5f;
        drive.kept[k + 1] = halves(1, is_first ? to + 0.02f * (from - to) : to);
        temporal_pixels_add(drive.pixels, drive.kept[k + 1].luminance);
    }
    struct analysis analysis = {0};
    assert_true(analysis_make(&drive, &analysis, &error));
    assert_close(value_of(&analysis, MEASURE_frames_to_95), 1, 0);
    assert_close(value_of(&analysis, MEASURE_frames_to_99), 2, 0);
    assert_close(value_of(&analysis, MEASURE_return_difference), 0, 1e-6);
    assert_close(value_of(&analysis, MEASURE_flicker_p99), 0.5, 0.02);
    analysis_free(&analysis);
    drive_clear(&drive);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_orbit_keeps_its_distance_and_step),
        cmocka_unit_test(a_cut_is_one_jump),
        cmocka_unit_test(a_light_turns_about_the_vertical),
        cmocka_unit_test(objects_pass_by_animation_or_by_pan),
        cmocka_unit_test(settings_take_turns),
        cmocka_unit_test(an_unknown_path_is_told_which_there_are),
        cmocka_unit_test(limits_are_read_and_judged),
        cmocka_unit_test(nonsense_limits_are_refused),
        cmocka_unit_test(a_step_that_was_made_up),
        cmocka_unit_test(a_rest_that_was_made_up),
        cmocka_unit_test(an_alternation_that_was_made_up),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
