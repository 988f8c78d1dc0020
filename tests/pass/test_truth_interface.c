/* A point light above a flat dielectric, the floor below it seen from inside: every pixel against the closed
 * form. */
#include "core/measure/analytic.h"
#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

static void compare(double ior, const char *settings, double *mean, double *percentile99)
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
    double *errors = malloc(count * sizeof *errors), sum = 0;
    assert_non_null(errors);
    for (uint32_t y = 0; y < truth.height; y++) {
        for (uint32_t x = 0; x < truth.width; x++) {
            double floor[2];
            assert_true(truth_floor_point(&truth, x + 0.5, y + 0.5, floor));
            double expected = analytic_interface_irradiance(&scene, hypot(floor[0], floor[1]));
            size_t pixel = (size_t)y * truth.width + x;
            errors[pixel] = fabs((double)irradiance[3 * pixel] - expected) / expected;
            sum += errors[pixel];
            assert_true(irradiance[3 * pixel] == irradiance[3 * pixel + 2]);
        }
    }
    *mean = sum / (double)count;
    *percentile99 = measure_percentile(errors, count, 99);
    print_message("flat interface, ior %.2f, %s: %.0f photons; error mean %.3f %%, 99th percentile %.2f %%\n",
                  ior, settings ? settings : "default settings", result->stats[STAT_photons_emitted],
                  100 * *mean, 100 * *percentile99);
    free(errors);
    truth_close(&truth);
}

static void glass(void **state)
{
    (void)state;
    double mean, percentile;
    compare(1.5, NULL, &mean, &percentile);
    assert_in_bound(mean, 0.005);
    assert_in_bound(percentile, 0.03);
}

static void water(void **state)
{
    (void)state;
    double mean, percentile;
    compare(1.33, NULL, &mean, &percentile);
    assert_in_bound(mean, 0.005);
    assert_in_bound(percentile, 0.03);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(glass), cmocka_unit_test(water)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
