/* A point light above a flat dielectric, the floor below it seen from inside: every pixel against the closed
 * form. */
#include "core/measure/analytic.h"
#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

struct comparison {
    double mean, percentile99, bias; /* of the relative error; bias: of its sign */
};

static struct comparison compare(double ior, const char *settings)
{
    struct truth truth;
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 6,
        .height = 1,
        .ior = ior,
        .light = {0, 2, 0},
        .intensity = 10,
        .camera = {.eye = {0.3f, 0.9f, 0.4f}, .at = {0.3f, 0, 0.4f}, .up = {0, 0, -1}, .fov = 75},
        .width = 480,
        .height_px = 270,
        .settings = settings,
    };
    truth_open(&truth, &params);
    const struct frame_result *result = truth_render(&truth, 8, 1u << CHANNEL_IRRADIANCE);
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);

    struct analytic_interface scene = {.intensity = 10, .light_height = 1, .depth = 1, .ior = ior};
    size_t count = (size_t)truth.width * truth.height;
    double *errors = malloc(count * sizeof *errors);
    struct comparison comparison = {0};
    assert_non_null(errors);
    for (uint32_t y = 0; y < truth.height; y++) {
        for (uint32_t x = 0; x < truth.width; x++) {
            double floor[2];
            assert_true(truth_floor_point(&truth, x + 0.5, y + 0.5, floor));
            double expected = analytic_interface_irradiance(&scene, hypot(floor[0], floor[1]));
            size_t pixel = (size_t)y * truth.width + x;
            double error = (double)irradiance[3 * pixel] / expected - 1;
            errors[pixel] = fabs(error);
            comparison.mean += errors[pixel] / (double)count;
            comparison.bias += error / (double)count;
            assert_true(irradiance[3 * pixel] == irradiance[3 * pixel + 2]);
        }
    }
    comparison.percentile99 = measure_percentile(errors, count, 99);
    print_message("flat interface, ior %.2f, %s: %.0f photons; error mean %.3f %%, 99th percentile %.2f %%, "
                  "bias %.3f %%\n",
                  ior, settings ? settings : "default settings", result->stats[STAT_photons_emitted],
                  100 * comparison.mean, 100 * comparison.percentile99, 100 * comparison.bias);
    free(errors);
    truth_close(&truth);
    return comparison;
}

/* Even light wants wide footprints, four photon spacings here, and photons spread evenly: what is compared is
 * refraction, Fresnel, the equal-area map and the footprints' energy, not how few photons will do. */
static const char *even = "density=uniform photons=250000 kappa=16";

static void glass(void **state)
{
    (void)state;
    struct comparison comparison = compare(1.5, even);
    assert_in_bound(comparison.mean, 0.005);
    assert_in_bound(comparison.percentile99, 0.03);
}

static void water(void **state)
{
    (void)state;
    struct comparison comparison = compare(1.33, even);
    assert_in_bound(comparison.mean, 0.005);
    assert_in_bound(comparison.percentile99, 0.03);
}

/* Footprints as narrow as the default ones are grainy on an even floor, but they add up. */
static void default_settings(void **state)
{
    (void)state;
    struct comparison comparison = compare(1.5, NULL);
    assert_in_bound(fabs(comparison.bias), 0.005);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(glass), cmocka_unit_test(water),
                                       cmocka_unit_test(default_settings)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
