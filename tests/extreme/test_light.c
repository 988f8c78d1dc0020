/* Lights at their limits: brightness over eighteen orders, many at once, places where they touch what they
 * light, a beam thinner than float cosines resolve, darkness.
 *
 * docs/limits.md has the figures. */
#include <string.h>

#include "tests/support/balls.h"
#include "tests/support/check.h"
#include "tests/support/glb.h"
#include "tests/support/truth.h"

enum { WIDTH = 64, HEIGHT = 36 };

#define PI 3.14159265358979323846
#define GREY(i)                                                                                              \
    {                                                                                                        \
        i, i, i                                                                                              \
    }

static const struct view_camera camera = {.eye = {0, 5, 4}, .at = {0, 0, 0}, .up = {0, 1, 0}, .fov = 60};
static const struct ball glass = {.centre = {0, 1, 0}, .radius = 0.5, .kind = MATERIAL_DIELECTRIC};

static struct balls_params lit_by(const struct ball_light *lights, uint32_t count, const char *settings)
{
    return (struct balls_params){.balls = &glass,
                                 .ball_count = 1,
                                 .lights = lights,
                                 .light_count = count,
                                 .camera = camera,
                                 .width = WIDTH,
                                 .height = HEIGHT,
                                 .settings = settings};
}

static float *copy_of(const float *values)
{
    float *copy = malloc(3 * WIDTH * HEIGHT * sizeof *copy);
    assert_non_null(copy);
    memcpy(copy, values, 3 * WIDTH * HEIGHT * sizeof *copy);
    return copy;
}

static const struct frame_result *fresh(struct truth *stage, uint32_t frames)
{
    view_reset(stage->view);
    return truth_render(stage, frames, 1u << CHANNEL_IRRADIANCE);
}

/* Intensity is a factor of the picture: to the bit for powers of two, to float rounding for others. */
static void intensity_is_a_factor(void **state)
{
    (void)state;
    struct truth stage;
    const struct ball_light lamp = {.position = {0.3, 4, 0.2}, .intensity = GREY(1)};
    struct balls_params params = lit_by(&lamp, 1, "photons=16384");
    balls_open(&stage, &params);
    float *one = copy_of(truth_channel(fresh(&stage, 3), CHANNEL_IRRADIANCE));
    double largest = 0;
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        largest = fmax(largest, (double)one[i]);
    assert_true(largest > 0);
    static const double factors[] = {1e-6, 0x1p-19, 1e-3, 0x1p19, 1e6, 1e9, 0x1p39, 1e12};
    for (size_t k = 0; k < sizeof factors / sizeof *factors; k++) {
        balls_set_intensity(&stage, 0, factors[k]);
        const struct frame_result *result = fresh(&stage, 3);
        const float *scaled = truth_channel(result, CHANNEL_IRRADIANCE);
        int exponent;
        bool is_power = frexp(factors[k], &exponent) == 0.5;
        double apart = 0;
        for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
            apart = fmax(apart, fabs((double)scaled[i] / factors[k] - (double)one[i]));
        print_message("intensity %-12g off by %.2g of the brightest pixel\n", factors[k], apart / largest);
        assert_in_bound(apart / largest, is_power ? 0 : 1e-6);
        assert_close(result->stats[STAT_guard_overflow], 0, 0);
    }
    free(one);
    truth_close(&stage);
}

/* ---- many ---------------------------------------------------------------------------------------------- */

static void the_limit_is_named(void **state)
{
    (void)state;
    struct ball_light lights[SCENE_MAX_LIGHTS + 1];
    for (uint32_t i = 0; i < SCENE_MAX_LIGHTS + 1; i++)
        lights[i] = (struct ball_light){.position = {0, 4, 0}, .intensity = GREY(1)};
    struct error error = {0};
    struct balls_params params = lit_by(lights, SCENE_MAX_LIGHTS + 1, NULL);
    assert_null(balls_scene(&params, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "64 lights"));

    /* a thousand nodes that all carry the one light of a file */
    static char json[80000];
    size_t at =
        (size_t)snprintf(json, sizeof json,
                         "{'asset':{'version':'2.0'},'extensionsUsed':['KHR_lights_punctual'],'extensions':{"
                         "'KHR_lights_punctual':{'lights':[{'type':'point'}]}},'scenes':[{'nodes':[0");
    for (int i = 1; i < 1000; i++)
        at += (size_t)snprintf(json + at, sizeof json - at, ",%d", i);
    at += (size_t)snprintf(json + at, sizeof json - at, "]}],'nodes':[");
    for (int i = 0; i < 1000; i++)
        at += (size_t)snprintf(json + at, sizeof json - at,
                               "%s{'extensions':{'KHR_lights_punctual':{'light':0}}}", i ? "," : "");
    snprintf(json + at, sizeof json - at, "]}");
    for (char *c = json; *c; c++)
        *c = *c == '\'' ? '"' : *c;
    error = (struct error){0};
    assert_null(glb_import(json, NULL, 0, &error));
    print_message("1,000 lights: \"%s\"\n", error.message);
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "64 lights"));
}

static void no_light_no_picture(void **state)
{
    (void)state;
    struct truth stage;
    struct balls_params params = lit_by(NULL, 0, NULL);
    balls_open(&stage, &params);
    const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE);
    const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        assert_true(values[i] == 0);
    assert_non_null(result->black_reason);
    assert_non_null(strstr(result->black_reason, "no light"));
    assert_close(result->stats[STAT_photons_emitted], 0, 0);
    assert_int_equal(result->pass_count, 0);
    truth_close(&stage);
}

/* 64 lights over the ball. With uniform density each has its 64th of the budget, and the picture is the sum
 * of the single ones but for rounding; with the default rule it is near that sum of finer pictures. */
static void sixty_four_lights_add_up(void **state)
{
    (void)state;
    enum { LIGHTS = SCENE_MAX_LIGHTS, SHARE = 1024, VALUES = 3 * WIDTH * HEIGHT };
    struct ball_light lights[LIGHTS];
    for (uint32_t i = 0; i < LIGHTS; i++)
        lights[i] = (struct ball_light){
            .position = {0.5 * (i % 8) - 1.75, 3.5 + 0.02 * (i % 5), 0.5 * (int)(i / 8) - 1.75},
            .intensity = GREY(1)};
    char settings[96];
    snprintf(settings, sizeof settings, "density=uniform photons=%d cells=16", LIGHTS * SHARE);
    struct truth stage;
    struct balls_params params = lit_by(lights, LIGHTS, settings);
    balls_open(&stage, &params);
    uint32_t channels = 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DENSITY;
    float *uniform = copy_of(truth_channel(truth_render(&stage, 1, channels), CHANNEL_IRRADIANCE));
    truth_set(&stage, "density=sqrt");
    const struct frame_result *result =
        truth_render(&stage, 3, channels); /* from the fourth on cells keep samples */
    float *adaptive = copy_of(truth_channel(result, CHANNEL_IRRADIANCE));
    double photons[LIGHTS], least = 1e30, emitted = 0;
    balls_light_photons(result, LIGHTS, photons);
    for (uint32_t i = 0; i < LIGHTS; i++) {
        least = fmin(least, photons[i]);
        emitted += photons[i];
    }
    assert_close(emitted, result->stats[STAT_photons_emitted], 0);
    assert_in_bound(emitted, LIGHTS * SHARE);
    for (uint32_t i = 0; i < LIGHTS; i++)
        balls_set_intensity(&stage, i, 0);
    double sum[2][VALUES] = {{0}}, apart[2] = {0, 0}, whole = 0;
    for (int fine = 0; fine < 2; fine++) {
        snprintf(settings, sizeof settings, "density=uniform photons=%d cells=%d", fine ? 4096 : SHARE,
                 fine ? 32 : 16);
        truth_set(&stage, settings);
        for (uint32_t i = 0; i < LIGHTS; i++) {
            balls_set_intensity(&stage, i, 1);
            const float *one =
                truth_channel(truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE), CHANNEL_IRRADIANCE);
            balls_set_intensity(&stage, i, 0);
            for (size_t k = 0; k < VALUES; k++)
                sum[fine][k] += (double)one[k];
        }
    }
    for (size_t k = 0; k < VALUES; k++) {
        apart[0] += fabs((double)uniform[k] - sum[0][k]);
        apart[1] += fabs((double)adaptive[k] - sum[1][k]);
        whole += sum[1][k];
    }
    print_message("64 lights, uniform: %.2g from the sum of single pictures\n", apart[0] / whole);
    print_message("64 lights: %.0f photons of %d, each light at least %.0f; %.4f from the sum of fine single "
                  "pictures\n",
                  emitted, LIGHTS * SHARE, least, apart[1] / whole);
    assert_in_bound(apart[0] / whole, 1e-5);
    assert_in_bound(apart[1] / whole, 0.1);
    free(uniform);
    free(adaptive);
    truth_close(&stage);
}

/* ---- touching ------------------------------------------------------------------------------------------ */

/* A lamp in the floor, on it and a hair above it sends up what one a millimetre above it does. */
static void a_lamp_on_the_floor(void **state)
{
    (void)state;
    struct truth stage;
    const struct ball mirror = {.centre = {0, 1, 0}, .radius = 0.5, .kind = MATERIAL_MIRROR};
    const struct ball_light lamp = {.position = {0, 1e-3, 0}, .intensity = GREY(1)};
    struct balls_params params = lit_by(&lamp, 1, "photons=16384");
    params.balls = &mirror;
    balls_open(&stage, &params);
    double above = fresh(&stage, 4)->stats[STAT_flux_buffer];
    assert_true(above > 0);
    static const float heights[] = {1e-5f, 1e-7f, 0};
    for (size_t i = 0; i < sizeof heights / sizeof *heights; i++) {
        struct error error;
        assert_true(view_set_light(
            stage.view, 0,
            &(struct view_light){.overrides = LIGHT_OVERRIDE_POSITION, .position = {0, heights[i], 0}},
            &error));
        double flux = fresh(&stage, 4)->stats[STAT_flux_buffer];
        print_message("lamp %g m above the floor: %.5f of the flux of 1 mm\n", (double)heights[i],
                      flux / above);
        assert_close(flux / above, 1, 0.005);
    }
    truth_close(&stage);
}

/* In the middle of the ball every ray leaves straight, and what is reflected inside comes out on the other
 * side: the floor has what it would have without the ball, I cos / d^2. */
static void a_lamp_in_the_middle_of_the_ball(void **state)
{
    (void)state;
    struct truth stage;
    const struct ball_light lamp = {.position = {0, 1, 0}, .intensity = GREY(1)};
    struct balls_params params = lit_by(&lamp, 1, "photons=65536");
    balls_open(&stage, &params);
    const struct frame_result *result =
        truth_render(&stage, 4, 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DEPTH);
    const float *values = truth_channel(result, CHANNEL_IRRADIANCE),
                *depth = truth_channel(result, CHANNEL_DEPTH);
    double apart = 0, whole = 0;
    uint32_t count = 0;
    for (uint32_t y = 1; y + 1 < HEIGHT; y++)
        for (uint32_t x = 1; x + 1 < WIDTH; x++) {
            double floor[2];
            if (!truth_shows_floor(&stage, depth, x, y) ||
                !truth_floor_point(&stage, x + 0.5, y + 0.5, floor))
                continue;
            double d2 = floor[0] * floor[0] + 1 + floor[1] * floor[1];
            apart += fabs((double)values[3 * (y * WIDTH + x)] - 1 / (d2 * sqrt(d2)));
            whole += 1 / (d2 * sqrt(d2));
            count++;
        }
    assert_true(count > 500);
    print_message("lamp in the middle of the ball: %u pixels, %.4f from I cos / d^2\n", count, apart / whole);
    assert_in_bound(apart / whole, 0.02);
    truth_close(&stage);
}

/* A lamp over the middle of a sheet with glass below it: what arrives at the bottom, h below, has a closed
 * form as long as the lamp is much nearer to the sheet than h. */
static void a_lamp_at_the_glass(void **state)
{
    (void)state;
    const double h = 1, ior = 1.5;
    struct truth stage;
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 2,
        .height = h,
        .ior = ior,
        .light = {0, h + 1e-3, 0},
        .intensity = 1,
        .camera = {.eye = {0, 0.95f, 0.3f}, .at = {0, 0, 0}, .up = {0, 1, 0}, .fov = 60},
        .width = WIDTH,
        .height_px = HEIGHT,
        .settings = "photons=32768"};
    truth_open(&stage, &params);
    static const double gaps[] = {1e-3, 1e-5, 1e-6};
    double worst = 0;
    for (size_t i = 0; i < sizeof gaps / sizeof *gaps; i++) {
        struct error error;
        assert_true(view_set_light(stage.view, 0,
                                   &(struct view_light){.overrides = LIGHT_OVERRIDE_POSITION,
                                                        .position = {0, (float)(h + gaps[i]), 0}},
                                   &error));
        const struct frame_result *result = fresh(&stage, 4);
        const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
        double apart = 0, whole = 0;
        for (uint32_t y = 0; y < HEIGHT; y++)
            for (uint32_t x = 0; x < WIDTH; x++) {
                double floor[2];
                assert_true(truth_floor_point(&stage, x + 0.5, y + 0.5, floor));
                double d2 = floor[0] * floor[0] + floor[1] * floor[1] + h * h, cos_t = h / sqrt(d2);
                double sin_i = ior * sqrt(1 - cos_t * cos_t);
                if (sin_i > 0.95) /* grazing: the gap is no longer small */
                    continue;
                double cos_i = sqrt(1 - sin_i * sin_i);
                double parallel = (ior * cos_i - cos_t) / (ior * cos_i + cos_t);
                double across = (cos_i - ior * cos_t) / (cos_i + ior * cos_t);
                double through = 1 - 0.5 * (parallel * parallel + across * across);
                double expected = through * ior * ior * cos_t / cos_i * cos_t / d2;
                apart += fabs((double)values[3 * (y * WIDTH + x)] - expected);
                whole += expected;
            }
        print_message("lamp %g m above glass: %.4f from the closed form\n", gaps[i], apart / whole);
        worst = fmax(worst, apart / whole);
    }
    assert_in_bound(worst, 0.03);
    truth_close(&stage);
}

/* ---- thin, black, coloured ----------------------------------------------------------------------------- */

/* A beam of 0.1 degree from 200 m up through the middle of the ball: its flux in closed form, and what
 * arrives on the floor is what 4 % reflection at either side and everything between leave of it. */
static void a_spot_of_a_tenth_of_a_degree(void **state)
{
    (void)state;
    static const double inner_shares[] = {0, 0.5, 0.999};
    for (int i = 0; i < 3; i++) {
        struct truth stage;
        double outer = 0.05 * PI / 180, inner = inner_shares[i] * outer;
        const struct ball_light lamp = {.type = LIGHT_SPOT,
                                        .position = {0, 200, 0},
                                        .intensity = GREY(1e6),
                                        .inner = inner,
                                        .outer = outer};
        struct balls_params params = lit_by(&lamp, 1, "photons=16384");
        balls_open(&stage, &params);
        const struct frame_result *result = truth_render(&stage, 4, 1u << CHANNEL_IRRADIANCE);
        /* the fall-off t^2 is linear in the cosine's t */
        double h_inner = 2 * pow(sin(inner / 2), 2), h_outer = 2 * pow(sin(outer / 2), 2);
        double flux = 3e6 * 2 * PI * (h_inner + (h_outer - h_inner) / 3);
        double through = 0.96 / 1.04;
        print_message(
            "spot of 0.1 degree, inner %.3f of it: emitted %.5f of the closed form, %.5f on the floor\n",
            inner_shares[i], result->stats[STAT_flux_emitted] / flux,
            result->stats[STAT_flux_buffer] / (through * flux));
        assert_close(result->stats[STAT_flux_emitted] / flux, 1, 0.002);
        assert_close(result->stats[STAT_flux_buffer] / (through * flux), 1, 0.01);
        truth_close(&stage);
    }
}

static void black_lights_cost_nothing(void **state)
{
    (void)state;
    struct truth stage;
    const struct ball_light lamps[2] = {{.position = {0.3, 4, 0.2}, .intensity = GREY(1)},
                                        {.position = {-1, 4, 0.2}, .intensity = GREY(0)}};
    struct balls_params params = lit_by(lamps, 2, "photons=16384");
    balls_open(&stage, &params);
    const struct frame_result *result =
        truth_render(&stage, 4, 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DENSITY);
    double photons[2];
    balls_light_photons(result, 2, photons);
    print_message("a lit light has %.0f photons, a black one %.0f\n", photons[0], photons[1]);
    assert_true(photons[0] > 1000);
    assert_close(photons[1], 0, 0);
    float *first = copy_of(truth_channel(result, CHANNEL_IRRADIANCE));
    double flux = result->stats[STAT_flux_buffer];
    /* and it comes back with its whole caustic when it is lit: by symmetry close to the other's */
    balls_set_intensity(&stage, 1, 1);
    result = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE);
    const float *both = truth_channel(result, CHANNEL_IRRADIANCE);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        assert_true(isfinite(both[i]));
    assert_close(result->stats[STAT_flux_buffer] / flux, 2, 0.2);
    balls_set_intensity(&stage, 0, 0);
    balls_set_intensity(&stage, 1, 0);
    result = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE);
    assert_non_null(strstr(result->black_reason, "black"));
    const float *dark = truth_channel(result, CHANNEL_IRRADIANCE);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        assert_true(dark[i] == 0);
    free(first);
    truth_close(&stage);
}

static void channels_without_light_stay_black(void **state)
{
    (void)state;
    for (int two = 0; two < 2; two++) { /* one tint for all photons; a red and a blue light */
        struct truth stage;
        const struct ball_light lamps[2] = {{.position = {0.3, 4, 0.2}, .intensity = {5, 0, 0}},
                                            {.position = {-1, 4, 0.2}, .intensity = {0, 0, 7}}};
        struct balls_params params = lit_by(lamps, two ? 2 : 1, "photons=16384");
        balls_open(&stage, &params);
        const float *values = truth_channel(fresh(&stage, 3), CHANNEL_IRRADIANCE);
        double sum[3] = {0, 0, 0};
        for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++) {
            sum[i % 3] += (double)values[i];
            if (i % 3 == 1 || (i % 3 == 2 && !two))
                assert_true(values[i] == 0);
        }
        print_message("%s: sums %.4g %.4g %.4g\n", two ? "red and blue" : "red", sum[0], sum[1], sum[2]);
        assert_true(sum[0] > 0);
        assert_true(!two || sum[2] > 0);
        truth_close(&stage);
    }
}

int main(void)
{
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(intensity_is_a_factor),     cmocka_unit_test(the_limit_is_named),
        cmocka_unit_test(no_light_no_picture),       cmocka_unit_test(sixty_four_lights_add_up),
        cmocka_unit_test(a_lamp_on_the_floor),       cmocka_unit_test(a_lamp_in_the_middle_of_the_ball),
        cmocka_unit_test(a_lamp_at_the_glass),       cmocka_unit_test(a_spot_of_a_tenth_of_a_degree),
        cmocka_unit_test(black_lights_cost_nothing), cmocka_unit_test(channels_without_light_stay_black),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
