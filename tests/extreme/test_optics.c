/* Indices, incidences and foci at their limits, against closed forms. */
#include <string.h>

#include "core/measure/analytic.h"
#include "core/measure/image_measure.h"
#include "protocol/tiles.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

#define PI 3.14159265358979323846

/* ---- indices ------------------------------------------------------------------------------------------- */

/* A lamp 1 m above a sheet, the floor 1 m below it: relative error of the irradiance against the closed form,
 * within `radius` of the middle. */
static double sheet_error(double ior, double radius, double *bias)
{
    struct truth truth;
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 6,
        .height = 1,
        .ior = ior,
        .light = {0, 2, 0},
        .intensity = 10,
        .camera = {.eye = {0, 0.9f, 0}, .at = {0, 0, 0}, .up = {0, 0, -1}, .fov = 80},
        .width = 64,
        .height_px = 48,
        .settings = "density=uniform photons=131072 kappa=16",
    };
    truth_open(&truth, &params);
    const struct frame_result *result = truth_render(&truth, 1, 1u << CHANNEL_IRRADIANCE);
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);
    struct analytic_interface scene = {.intensity = 10, .light_height = 1, .depth = 1, .ior = ior};
    double error = 0, sum = 0, wanted = 0;
    int count = 0;
    for (uint32_t y = 0; y < truth.height; y++)
        for (uint32_t x = 0; x < truth.width; x++) {
            double floor[2];
            assert_true(truth_floor_point(&truth, x + 0.5, y + 0.5, floor));
            if (hypot(floor[0], floor[1]) > radius)
                continue;
            double expected = analytic_interface_irradiance(&scene, hypot(floor[0], floor[1]));
            double found = (double)irradiance[3 * ((size_t)y * truth.width + x)];
            error += fabs(found / expected - 1);
            sum += found;
            wanted += expected;
            count++;
        }
    *bias = sum / wanted - 1;
    truth_close(&truth);
    return error / count;
}

static void indices(void **state)
{
    (void)state;
    static const struct {
        double ior, radius;
    } cases[] = {{1, 0.7}, {1.0001, 0.7}, {1 / 1.5, 0.7}, {2.4, 0.7}, {4, 0.7}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        double bias, error = sheet_error(cases[i].ior, cases[i].radius, &bias);
        print_message("index %.4f: mean error %.2f %%, bias %.2f %%\n", cases[i].ior, 100 * error,
                      100 * bias);
        assert_in_bound(error, 0.01);
        assert_in_bound(fabs(bias), 0.003);
    }
}

/* ---- incidences ---------------------------------------------------------------------------------------- */

/* Share of the sun's light that goes through a horizontal sheet, by the flux ledger; *direction is the way
 * the light goes, as the renderer has it. */
static double transmitted(double angle, double ior, bool from_inside, double direction[3], double *guard)
{
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    uint32_t white = scenery_diffuse(&builder), glass = scenery_glass(&builder, ior);
    /* wide enough for what comes or leaves at 89.999 degrees just above it */
    scenery_place(&builder, shape_floor(&builder, "floor", white, vec3_make(0, 0.99, 0), 4e3));
    const struct shape_quad up = {{-1, 1, 1}, {2, 0, 0}, {0, 0, -2}},
                            down = {{-1, 1, -1}, {2, 0, 0}, {0, 0, 2}};
    scenery_place(&builder, shape_quads(&builder, "sheet", glass, from_inside ? &down : &up, 1));
    scenery_sun(&builder, vec3_make(sin(angle), -cos(angle), 0), 1);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 3, 3), vec3_make(0, 1, 0), vec3_make(0, 1, 0), 40);
    scenery_open(&stage, &builder, &camera, 16, 16, "photons=16384 cells=32 split=once density=uniform");
    const double *s = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE)->stats;
    /* what passes the sheet by is direct light on the floor */
    double landed = s[STAT_flux_splatted] + s[STAT_flux_culled_visibility],
           met = landed + s[STAT_flux_escaped];
    *guard = s[STAT_guard_differential];
    assert_true(met > 0);
    struct error error;
    struct scene_pose *pose = scene_pose_create(stage.scene, &error);
    for (int k = 0; k < 3; k++)
        direction[k] = (double)pose->lights[0].direction[k];
    scene_pose_destroy(&pose);
    truth_close(&stage);
    return landed / met;
}

static void from_normal_to_grazing(void **state)
{
    (void)state;
    static const double degrees[] = {0, 45, 80, 89, 89.9, 89.99, 89.999};
    for (size_t i = 0; i < sizeof degrees / sizeof *degrees; i++) {
        double direction[3], guard;
        double found = transmitted(degrees[i] * PI / 180, 1.5, false, direction, &guard);
        double wanted = 1 - analytic_fresnel(-direction[1], 1, 1.5);
        print_message("%.3f degrees: %.6f goes through, expected %.6f, %.0f guarded\n", degrees[i], found,
                      wanted, guard);
        assert_close(found, wanted, 0.005 * wanted);
        assert_true((guard > 0) == (-direction[1] < 1e-4));
    }
}

/* From inside: at the critical angle, and a millionth of a radian to either side. What floats know of sin^2
 * is 2e-7, and the transmittance goes with the square root of what it lacks of 1. */
static void at_the_critical_angle(void **state)
{
    (void)state;
    static const double offsets[] = {-1e-2, -1e-4, -1e-6, 0, 1e-6, 1e-4};
    for (size_t i = 0; i < sizeof offsets / sizeof *offsets; i++) {
        double direction[3], guard, low = 0, high = 0;
        double found = transmitted(asin(1 / 1.5) + offsets[i], 1.5, true, direction, &guard);
        for (int side = -1; side <= 1; side += 2) {
            double sine2 = direction[0] * direction[0] + direction[2] * direction[2] + side * 2e-7;
            double cosine = sqrt(1 - sine2), through = 1 - analytic_fresnel(cosine, 1.5, 1);
            *(side < 0 ? &high : &low) = through;
        }
        print_message("critical angle %+.0e: %.6f goes through, expected %.6f to %.6f, %.0f guarded\n",
                      offsets[i], found, low, high, guard);
        assert_true(found >= low * 0.995 && found <= high * 1.005);
        if (offsets[i] > 1e-5)
            assert_true(found == 0);
    }
}

/* ---- foci ---------------------------------------------------------------------------------------------- */

struct spot {
    double flux, within, peak; /* of the picture's flux, the share within 2.5 px of the middle; W/m^2 */
    uint32_t non_finite;
};

static struct spot spot_of(const struct frame_result *result, double pixel_area)
{
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);
    const struct frame_channel *channel = &result->channels[0];
    struct measure_image image = {irradiance, channel->width, channel->height, 3};
    struct spot spot = {.non_finite = (uint32_t)measure_non_finite(&image)};
    for (uint32_t y = 0; y < channel->height; y++)
        for (uint32_t x = 0; x < channel->width; x++) {
            double value = (double)irradiance[3 * ((size_t)y * channel->width + x)];
            spot.flux += value * pixel_area;
            spot.peak = fmax(spot.peak, value);
            if (hypot(x + 0.5 - 0.5 * channel->width, y + 0.5 - 0.5 * channel->height) < 2.5)
                spot.within += value * pixel_area;
        }
    spot.within /= spot.flux;
    return spot;
}

/* An ellipsoid of glass of eccentricity 1/n gathers light along its axis in its far focus, here (0, 0, 0). */
#define ELLIPSE_C (1 / 1.5)
static double ellipse_height(double radius)
{
    return ELLIPSE_C + sqrt(1 - radius * radius / (1 - ELLIPSE_C * ELLIPSE_C));
}
static double ellipse_slope(double radius)
{
    double b2 = 1 - ELLIPSE_C * ELLIPSE_C;
    return -radius / b2 / sqrt(1 - radius * radius / b2);
}

static void a_lens_with_a_point_for_a_focus(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 4);
    scenery_dish(&builder, scenery_glass(&builder, 1.5),
                 &(struct scenery_dish){ellipse_height, ellipse_slope, 0.5, 48, 192, false});
    scenery_sun(&builder, vec3_make(0, -1, 0), 1000);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.5, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 20);
    scenery_open(&stage, &builder, &camera, 48, 48, "photons=32768 cells=64");
    double wanted = 0; /* W: the sun's light on the lens, less what each ring reflects */
    const int steps = 2000;
    for (int i = 0; i < steps; i++) {
        double radius = 0.5 * (i + 0.5) / steps, cosine = 1 / hypot(1, ellipse_slope(radius));
        wanted += 1000 * 2 * PI * radius * (0.5 / steps) * (1 - analytic_fresnel(cosine, 1, 1.5));
    }
    double pixel = 2 * 0.5 * tan(10 * PI / 180) / 48;
    const struct frame_result *result = truth_render(&stage, 3, 1u << CHANNEL_IRRADIANCE);
    struct spot spot = spot_of(result, pixel * pixel);
    print_message("lens: %.3f W of %.3f W, %.5f within 2.5 px, peak %.0f suns\n", spot.flux, wanted,
                  spot.within, spot.peak / 1000);
    assert_int_equal(spot.non_finite, 0);
    assert_close(spot.flux, wanted, 0.005 * wanted);
    assert_true(spot.within > 0.999);
    assert_in_bound(spot.peak, wanted / (pixel * pixel)); /* never more than all of it in one pixel */
    assert_true(result->stats[STAT_guard_footprint] == 0 && result->stats[STAT_guard_overflow] == 0);
    truth_close(&stage);
}

static double paraboloid_height(double radius)
{
    return -1 + radius * radius / 4;
}
static double paraboloid_slope(double radius)
{
    return radius / 2;
}

/* A mirror of 1 m radius and 1 m focal length under the sun: the light of a square of 0.1 m that receives it
 * is missing. The picture's f16 form is clamped where it must be, and says how often. */
static void a_paraboloid_in_the_sun(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    uint32_t white = scenery_diffuse(&builder);
    scenery_place(&builder, shape_floor(&builder, "receiver", white, vec3_make(0, 0, 0), 0.1));
    scenery_dish(&builder, scenery_mirror(&builder),
                 &(struct scenery_dish){paraboloid_height, paraboloid_slope, 1, 64, 256, false});
    scenery_sun(&builder, vec3_make(0, -1, 0), 1000);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, -0.5, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 8);
    scenery_open(&stage, &builder, &camera, 48, 48, "photons=32768 cells=64");
    double wanted = 1000 * (PI - 0.1 * 0.1), pixel = 2 * 0.5 * tan(4 * PI / 180) / 48;
    const struct frame_result *result = truth_render(&stage, 3, 1u << CHANNEL_IRRADIANCE);
    struct spot spot = spot_of(result, pixel * pixel);
    print_message("paraboloid: %.2f W of %.2f W, %.5f within 2.5 px, peak %.3g suns\n", spot.flux, wanted,
                  spot.within, spot.peak / 1000);
    assert_int_equal(spot.non_finite, 0);
    assert_close(spot.flux, wanted, 0.01 * wanted);
    assert_true(spot.within > 0.999);
    assert_true(spot.peak > 1e4 * 1000);

    const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
    size_t count = (size_t)48 * 48 * 3;
    uint32_t beyond = 0;
    for (size_t i = 0; i < count; i++)
        beyond += values[i] > 65504;
    struct error error;
    struct tile_codec *codec = tile_codec_create(&error);
    struct protocol_channel channel;
    const uint8_t *bytes;
    float *decoded = malloc(count * sizeof *decoded);
    assert_true(codec && decoded);
    assert_true(
        tiles_encode(codec, values, 48, 48, 3, PROTOCOL_F16, PROTOCOL_ZSTD, &channel, &bytes, &error));
    uint8_t *copy = malloc(channel.bytes);
    assert_non_null(copy);
    memcpy(copy, bytes, channel.bytes);
    assert_true(tiles_decode(codec, &channel, copy, decoded, &error));
    print_message("f16: %u of %zu values clamped\n", channel.clamped, count);
    assert_true(beyond > 0);
    assert_int_equal(channel.clamped, beyond);
    for (size_t i = 0; i < count; i++)
        assert_true(decoded[i] >= 0 && decoded[i] <= 65504);
    free(copy);
    free(decoded);
    tile_codec_destroy(&codec);
    truth_close(&stage);
}

/* At a fold (ring, sphere) and a cusp (ring) footprints collapse and stretch: the picture's integral is the
 * flux that was drawn, and no footprint is longer than max_radius allows. */
static void folds_and_cusps(void **state)
{
    (void)state;
    static const char *const scenes[] = {"ring", "sphere", "prism"};
    for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++) {
        struct truth stage;
        stage_open(&stage, scenes[i], 128, 72, "photons=16384 cells=64 max_radius=6");
        const struct frame_result *result = truth_render(&stage, 3, 1u << CHANNEL_IRRADIANCE);
        const double *s = result->stats;
        struct measure_image image = {truth_channel(result, CHANNEL_IRRADIANCE), 128, 72, 3};
        double per_photon = s[STAT_kernel_pixels] / s[STAT_photons_splatted];
        print_message("%s: %.4f W drawn, %.4f W in the picture, %.1f px a photon\n", scenes[i],
                      s[STAT_flux_splatted], s[STAT_flux_buffer], per_photon);
        assert_int_equal(measure_non_finite(&image), 0);
        assert_close(s[STAT_flux_buffer], s[STAT_flux_splatted], 0.02 * s[STAT_flux_splatted]);
        assert_in_bound(per_photon, PI * pow(6 + 0.75, 2));
        truth_close(&stage);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(indices),
        cmocka_unit_test(from_normal_to_grazing),
        cmocka_unit_test(at_the_critical_angle),
        cmocka_unit_test(a_lens_with_a_point_for_a_focus),
        cmocka_unit_test(a_paraboloid_in_the_sun),
        cmocka_unit_test(folds_and_cusps),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
