/* The task buffers as a control loop at the ends of their settings: totals settle or stay in a band, never
 * leave the budget, and nothing that becomes visible waits long for its photons; several lights share by what
 * they show.
 *
 * docs/limits.md has the figures. */
#include <string.h>

#include "tests/support/balls.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

enum { WIDTH = 64, HEIGHT = 36, VALUES = 3 * WIDTH * HEIGHT };

#define GREY(i)                                                                                              \
    {                                                                                                        \
        i, i, i                                                                                              \
    }
#define COUNT_OF(list) (sizeof(list) / sizeof *(list))

static const struct view_camera camera = {.eye = {0, 5, 4}, .at = {0, 0, 0}, .up = {0, 1, 0}, .fov = 60};
static const struct ball glass = {.centre = {0, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC};
static const struct ball_light lamp = {.position = {0.3, 4, 0.2}, .intensity = GREY(1)};

static struct balls_params of(const struct ball *balls, uint32_t ball_count, const struct ball_light *lights,
                              uint32_t light_count, const char *settings)
{
    return (struct balls_params){.balls = balls,
                                 .ball_count = ball_count,
                                 .subdivisions = 3,
                                 .lights = lights,
                                 .light_count = light_count,
                                 .camera = camera,
                                 .width = WIDTH,
                                 .height = HEIGHT,
                                 .settings = settings};
}

/* ---- totals -------------------------------------------------------------------------------------------- */

/* How far the photons of frames swing: (largest - least) / mean. */
static double band_of(const double *values, uint32_t count)
{
    double low = values[0], high = values[0], sum = 0;
    for (uint32_t i = 0; i < count; i++) {
        low = fmin(low, values[i]);
        high = fmax(high, values[i]);
        sum += values[i];
    }
    return sum > 0 ? (high - low) * count / sum : 0;
}

struct totals {
    double mean;            /* of the frames at rest */
    double moving, resting; /* bands: of the later half of the frames in motion, of the frames at rest */
};

/* Renders from a fresh start with a camera that trembles by 10 um, so that the view does not come to rest,
 * then as many frames with one that doesn't. Every frame keeps to the budget, sends the same flux, and is
 * finite. */
static struct totals run(struct truth *stage, const char *settings, uint32_t frames)
{
    double emitted[32], flux = 0;
    assert_true(2 * frames <= COUNT_OF(emitted));
    truth_set(stage, settings);
    view_reset(stage->view);
    for (uint32_t i = 0; i < 2 * frames; i++) {
        struct error error;
        struct view_camera trembling = camera;
        trembling.eye[0] += i < frames && i % 2 ? 1e-5f : 0;
        assert_true(view_set_camera(stage->view, &trembling, &error));
        const struct frame_result *result = truth_render(stage, 1, 1u << CHANNEL_IRRADIANCE);
        emitted[i] = result->stats[STAT_photons_emitted];
        assert_in_bound(emitted[i], view_settings(stage->view)->photons);
        assert_true(emitted[i] >= 1);
        if (i == 0)
            flux = result->stats[STAT_flux_emitted];
        assert_close(result->stats[STAT_flux_emitted] / flux, 1, 1e-4);
        const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
        for (size_t k = 0; k < VALUES; k++)
            assert_true(isfinite(values[k]));
    }
    uint32_t half = frames / 2;
    return (struct totals){.mean = emitted[2 * frames - 1],
                           .moving = band_of(emitted + half, frames - half),
                           .resting = band_of(emitted + 2 * frames - 2, 2)};
}

/* At rest totals settle to the photon. In motion they stay in a band, a wider one with a variance gain that
 * drowns everything else, where each change of the picture asks for photons, which change the picture. */
static void totals_settle(void **state)
{
    (void)state;
    struct truth stage;
    struct balls_params params = of(&glass, 1, &lamp, 1, NULL);
    balls_open(&stage, &params);
    static const int budgets[] = {1, 100, 8192};
    static const double areas[] = {1e-3, 0.1, 1e5}, gains[] = {0, 2, 1e6}, weights[] = {0, 0.5, 1};
    for (size_t b = 0; b < COUNT_OF(budgets); b++)
        for (size_t a = 0; a < COUNT_OF(areas); a++)
            for (size_t g = 0; g < COUNT_OF(gains); g++)
                for (size_t w = 0; w < COUNT_OF(weights); w++) {
                    bool is_corner = (a == 1) + (g == 1) + (w == 1) != 1;
                    if (!getenv("CAUSTICD_LONG") &&
                        (!is_corner || (b == 0 && a + g + w > 0 && a + g + w < 6)))
                        continue; /* corners, and what is in the middle of two; all of them in a long run */
                    char settings[128];
                    snprintf(settings, sizeof settings,
                             "photons=%d target_area=%g variance_gain=%g temporal_weight=%g", budgets[b],
                             areas[a], gains[g], weights[w]);
                    struct totals t = run(&stage, settings, b == 0 ? 4 : 10);
                    print_message("%-74s %6.0f photons, band %.4f moving, %.4f at rest\n", settings, t.mean,
                                  t.moving, t.resting);
                    /* cells' samples are squares of whole numbers: some go to and fro between two, and where
                     * photons are few a single cell is much */
                    assert_in_bound(t.moving, gains[g] == 1e6 ? 0.2 + 16 / t.mean : 0.04);
                    assert_close(t.resting, 0, 0);
                }
    truth_close(&stage);
}

static void the_largest_budget_is_kept(void **state)
{
    (void)state;
    struct truth stage;
    struct balls_params params = of(&glass, 1, &lamp, 1, NULL);
    balls_open(&stage, &params);
    char settings[128];
    uint32_t most = renderer_limits(stage.renderer)->max_photons;
    snprintf(settings, sizeof settings,
             "photons=%u target_area=1e-3 variance_gain=1e6 temporal_weight=1 max_bounces=2", most);
    struct totals t = run(&stage, settings, 3);
    print_message("%s: %.0f photons, band %.4f\n", settings, t.mean, t.moving);
    assert_true(t.mean > 0.5 * most);
    assert_in_bound(t.moving, 0.2); /* frames 2 and 3 of a loop that has just begun */
    if (most < setting_infos[SETTING_photons].maximum) {
        struct error error = {0};
        assert_false(view_set_setting(stage.view, SETTING_photons, most + 1.0, &error));
        assert_int_equal(error.status, STATUS_LIMIT);
        assert_non_null(strstr(error.message, "photons"));
    }
    truth_close(&stage);
}

/* More least samples than the budget has, and fewer photons than lights. */
static void the_floor_keeps_to_the_budget(void **state)
{
    (void)state;
    enum { LIGHTS = 16 };
    struct truth stage;
    struct ball_light lights[LIGHTS];
    for (int i = 0; i < LIGHTS; i++)
        lights[i] = (struct ball_light){.position = {0.2 * i - 1.5, 4, 0.2}, .intensity = GREY(1)};
    struct balls_params params = of(&glass, 1, lights, LIGHTS, NULL);
    balls_open(&stage, &params);
    static const char *const settings[] = {"photons=16 min_samples=64", "photons=100 min_samples=64",
                                           "photons=1000 min_samples=3", "photons=4096 min_samples=64"};
    for (size_t i = 0; i < COUNT_OF(settings); i++) {
        struct totals t = run(&stage, settings[i], 2);
        print_message("16 lights, %s: %.0f photons\n", settings[i], t.mean);
        assert_true(t.mean >= LIGHTS);
    }
    struct error error = {0};
    assert_false(view_set_setting(stage.view, SETTING_photons, LIGHTS - 1, &error));
    print_message("\"%s\"\n", error.message);
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "at least 16"));
    truth_close(&stage);
}

/* ---- what becomes visible ------------------------------------------------------------------------------ */

static double apart(const float *values, const float *reference)
{
    double sum = 0, whole = 0;
    for (size_t k = 0; k < VALUES; k++) {
        sum += fabs((double)values[k] - (double)reference[k]);
        whole += (double)reference[k];
    }
    return sum / whole;
}

/* What came into view must not wait: from the first frame on its flux, in columns from x0 on, is within
 * `flux_bound` of what four times the budget gives, and by frame `settled` the picture's error is at most a
 * quarter above the last one's. */
static void check_frames(struct truth *stage, const char *what, uint32_t x0, double flux_bound, int settled)
{
    enum { FRAMES = 8 };
    const uint32_t channel = 1u << CHANNEL_IRRADIANCE;
    float *pictures = malloc(FRAMES * VALUES * sizeof(float));
    assert_non_null(pictures);
    for (int i = 0; i < FRAMES; i++)
        memcpy(pictures + i * VALUES, truth_channel(truth_render(stage, 1, channel), CHANNEL_IRRADIANCE),
               VALUES * sizeof(float));
    char settings[64];
    int budget = view_settings(stage->view)->photons;
    snprintf(settings, sizeof settings, "photons=%d", 4 * budget);
    truth_set(stage, settings);
    view_reset(stage->view);
    const float *reference = truth_channel(truth_render(stage, 4, channel), CHANNEL_IRRADIANCE);
    double whole = balls_floor_flux(stage, reference, x0, WIDTH), worst = 0, errors[FRAMES];
    assert_true(whole > 0);
    for (int i = FRAMES - 1; i >= 0; i--) {
        errors[i] = apart(pictures + i * VALUES, reference);
        worst = fmax(worst, fabs(balls_floor_flux(stage, pictures + i * VALUES, x0, WIDTH) / whole - 1));
    }
    int first = FRAMES - 1;
    while (first > 0 && errors[first - 1] <= 1.25 * errors[FRAMES - 1])
        first--;
    print_message(
        "%-34s flux within %.3f from frame 1 on; error %.3f %.3f %.3f ... %.3f, settled in frame %d\n", what,
        worst, errors[0], errors[1], errors[2], errors[FRAMES - 1], first + 1);
    assert_in_bound(worst, flux_bound);
    assert_true(first + 1 <= settled);
    free(pictures);
    snprintf(settings, sizeof settings, "photons=%d", budget);
    truth_set(stage, settings);
}

static void a_caster_appears(void **state)
{
    (void)state;
    static const struct {
        const char *what;
        double radius;
        int photons;
        double flux_bound;
    } cases[] = {{"a ball of 1 m appears", 0.5, 8192, 0.03},
                 {"the same, 1,024 photons", 0.5, 1024, 0.1},
                 {"a ball of 20 cm appears", 0.1, 8192, 0.1},
                 {"a ball of 6 cm appears", 0.03, 32768, 0.06}};
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        struct truth stage;
        struct error error;
        const struct ball balls[2] = {
            {.centre = {-1.5, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC},
            {.centre = {1.5, 1, 0}, .radius = cases[i].radius, .kind = MATERIAL_DIELECTRIC, .appears = 1}};
        char settings[64];
        snprintf(settings, sizeof settings, "photons=%d", cases[i].photons);
        struct balls_params params = of(balls, 2, &lamp, 1, settings);
        balls_open(&stage, &params);
        const float *before =
            truth_channel(truth_render(&stage, 6, 1u << CHANNEL_IRRADIANCE), CHANNEL_IRRADIANCE);
        double dark = balls_floor_flux(&stage, before, WIDTH / 2 + 4, WIDTH);
        assert_true(view_set_time(stage.view, 1.5, &error));
        check_frames(&stage, cases[i].what, WIDTH / 2 + 4, cases[i].flux_bound, 3);
        print_message("  before that %.2g W there\n", dark);
        truth_close(&stage);
    }
}

static void light_and_camera_jump(void **state)
{
    (void)state;
    struct truth stage;
    struct error error;
    struct balls_params params = of(&glass, 1, &lamp, 1, "photons=8192");
    balls_open(&stage, &params);
    const uint32_t channel = 1u << CHANNEL_IRRADIANCE;
    truth_render(&stage, 6, channel);
    const struct view_light moved = {.overrides = LIGHT_OVERRIDE_POSITION, .position = {-1, 3.5f, -1}};
    assert_true(view_set_light(stage.view, 0, &moved, &error));
    check_frames(&stage, "the light jumps", 0, 0.03, 3);
    static const double before[] = {1e-3, 0};
    for (int i = 0; i < 2; i++) {
        view_reset(stage.view);
        balls_set_intensity(&stage, 0, before[i]);
        truth_render(&stage, 4, channel);
        balls_set_intensity(&stage, 0, 1);
        check_frames(&stage, i ? "the light is turned on" : "the light is turned up a thousandfold", 0, 0.03,
                     3);
    }
    struct view_camera away = camera;
    away.at[2] = 20;
    view_reset(stage.view);
    assert_true(view_set_camera(stage.view, &away, &error));
    truth_render(&stage, 6, channel);
    assert_true(view_set_camera(stage.view, &camera, &error));
    check_frames(&stage, "the camera turns to it", 0, 0.03, 3);
    truth_close(&stage);
}

/* ---- several lights ------------------------------------------------------------------------------------ */

/* With density=sqrt photons go where the square root of flux times area says. What every lit light keeps
 * whatever it shows: min_samples in each cell that can meet a caster, which is a 16th to a quarter of an even
 * share of the budget (as far as `cells` allows), times the part of its tile that casters fill. */
static void lights_share_by_what_they_show(void **state)
{
    (void)state;
    /* each lights a ball of its own; 6 m apart, so that the camera can see the one's caustic and not the
     * other's */
    static const struct ball balls[2] = {{.centre = {-3, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC},
                                         {.centre = {3, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC}};
    static const struct ball_light lights[2] = {
        {.type = LIGHT_SPOT, .position = {-3, 4, 0.5}, .intensity = GREY(1), .inner = 0.25, .outer = 0.3},
        {.type = LIGHT_SPOT, .position = {3, 4, 0.5}, .intensity = GREY(1), .inner = 0.25, .outer = 0.3}};
    enum { BUDGET = 16384 };
    struct truth stage;
    struct error error;
    struct balls_params params = of(balls, 2, lights, 2, "photons=16384 density=sqrt");
    balls_open(&stage, &params);
    struct view_camera wide = camera, left = camera;
    wide.eye[1] = 9;
    left.eye[0] = left.at[0] = -3;
    left.fov = 30;
    const uint32_t channels = 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DENSITY;
    static const double intensities[] = {1, 1e-3, 1e-9};
    for (size_t i = 0; i < COUNT_OF(intensities); i++) {
        balls_set_intensity(&stage, 1, intensities[i]);
        for (int view = 0; view < 2; view++) {
            assert_true(view_set_camera(stage.view, view ? &left : &wide, &error));
            view_reset(stage.view);
            const struct frame_result *result = truth_render(&stage, 10, channels);
            double photons[2], least = result->stats[STAT_cells_masked] / 2;
            balls_light_photons(result, 2, photons);
            print_message("lights of 1 and %g, %s: %.0f and %.0f photons, the guaranteed share is %.0f\n",
                          intensities[i], view ? "the second out of sight" : "both in sight", photons[0],
                          photons[1], least);
            assert_in_bound(photons[0] + photons[1], BUDGET);
            assert_in_bound(least, BUDGET / (2 * 4));
            assert_true(least >= 0.5 * BUDGET / (2 * 16));
            assert_true(photons[1] >=
                        0.98 * least); /* half the masked cells each, but for rounding at rims */
            if (intensities[i] == 1 && view == 0)
                assert_close(photons[0] / photons[1], 1, 0.05);
            else /* the left camera still sees a little that the far ball reflects */
                assert_in_bound(photons[1], view == 1 && intensities[i] == 1 ? photons[0] / 10 : 1.3 * least);
        }
    }
    truth_close(&stage);
}

/* A blue light's caustic is complete beside a red light a thousand times as bright. */
static void a_dim_light_beside_a_bright_one(void **state)
{
    (void)state;
    static const struct ball balls[2] = {{.centre = {-2, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC},
                                         {.centre = {2, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC}};
    static const struct ball_light lights[2] = {
        {.type = LIGHT_SPOT,
         .position = {-2, 4, 0.5},
         .intensity = {1000, 0, 0},
         .inner = 0.25,
         .outer = 0.3},
        {.type = LIGHT_SPOT, .position = {2, 4, 0.5}, .intensity = {0, 0, 1}, .inner = 0.25, .outer = 0.3}};
    struct truth stage;
    struct balls_params params = of(balls, 2, lights, 2, "photons=32768");
    params.camera.eye[1] = 7;
    balls_open(&stage, &params);
    const uint32_t channel = 1u << CHANNEL_IRRADIANCE;
    float both[VALUES];
    memcpy(both, truth_channel(truth_render(&stage, 6, channel), CHANNEL_IRRADIANCE), sizeof both);
    balls_set_intensity(&stage, 0, 0);
    view_reset(stage.view);
    const float *alone = truth_channel(truth_render(&stage, 6, channel), CHANNEL_IRRADIANCE);
    double sum[2] = {0, 0}, distance = 0;
    for (uint32_t i = 2; i < VALUES; i += 3) {
        sum[0] += (double)both[i];
        sum[1] += (double)alone[i];
        distance += fabs((double)both[i] - (double)alone[i]);
    }
    print_message(
        "a light beside one of 1,000 times its intensity: %.4f of its flux, picture %.3f from what it is "
        "alone\n",
        sum[0] / sum[1], distance / sum[1]);
    assert_close(sum[0] / sum[1], 1, 0.08);
    assert_in_bound(distance / sum[1], 0.25);
    truth_close(&stage);
}

int main(void)
{
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(totals_settle),
        cmocka_unit_test(the_largest_budget_is_kept),
        cmocka_unit_test(the_floor_keeps_to_the_budget),
        cmocka_unit_test(a_caster_appears),
        cmocka_unit_test(light_and_camera_jump),
        cmocka_unit_test(lights_share_by_what_they_show),
        cmocka_unit_test(a_dim_light_beside_a_bright_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
