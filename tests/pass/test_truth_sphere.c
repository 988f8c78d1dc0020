/* A glass sphere with the light straight above it: the floor's irradiance ring by ring against the density of
 * rays. */

#include "core/measure/analytic.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

/* Rings of 2 cm: five pixels across, three along the line of sight, so that the focus stays within its own.
 */
enum { RINGS = 50 };
static const double ring_width = 0.02;

static void profile(void **state)
{
    (void)state;
    struct truth truth;
    struct truth_params params = {
        .caster = TRUTH_SPHERE,
        .size = 0.5,
        .height = 0.9,
        .light = {0, 3.9, 0},
        .intensity = 40,
        .camera = {.eye = {0, 0.9f, 1.6f}, .at = {0, 0, 0.1f}, .up = {0, 1, 0}, .fov = 40},
        .width = 960,
        .height_px = 540,
    };
    truth_open(&truth, &params);
    const struct frame_result *result =
        truth_render(&truth, 8, 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DEPTH);
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);

    struct analytic_sphere scene = {
        .intensity = 40, .radius = 0.5, .ior = 1.5, .centre_height = 0.9, .light_height = 3};
    unsigned paths = ANALYTIC_SPHERE_REFLECTED | ANALYTIC_SPHERE_TRANSMITTED | ANALYTIC_SPHERE_ONE_INTERNAL |
                     ANALYTIC_SPHERE_TWO_INTERNAL;
    double edges[RINGS + 1], expected[RINGS], flux[RINGS] = {0}, area[RINGS] = {0};
    for (int i = 0; i <= RINGS; i++)
        edges[i] = ring_width * i;
    analytic_sphere_profile(&scene, paths, edges, RINGS, expected, 0);

    /* Sixteen points of every pixel that shows floor, and nothing but floor, each with its share of the
     * floor's area. */
    const float *depth = truth_channel(result, CHANNEL_DEPTH);
    for (uint32_t y = 0; y < truth.height; y++) {
        for (uint32_t x = 0; x < truth.width; x++) {
            size_t pixel = (size_t)y * truth.width + x;
            double floor[2];
            if (!truth_shows_floor(&truth, depth, x, y))
                continue;
            for (int k = 0; k < 16; k++) {
                double u = x + 0.125 + 0.25 * (k % 4), v = y + 0.125 + 0.25 * (k / 4);
                truth_floor_point(&truth, u, v, floor);
                int ring = (int)(hypot(floor[0], floor[1]) / ring_width);
                if (ring >= RINGS)
                    continue;
                double part = truth_pixel_area(&truth, x + 0.5, y + 0.5) / 16;
                flux[ring] += (double)irradiance[3 * pixel] * part;
                area[ring] += part;
            }
        }
    }
    double difference = 0, total = 0;
    for (int i = 0; i < RINGS; i++) {
        double whole = 3.14159265358979323846 * (edges[i + 1] * edges[i + 1] - edges[i] * edges[i]);
        assert_true(area[i] > 0.2 * whole); /* enough of the ring is seen */
        difference += fabs(flux[i] / area[i] - expected[i]) * whole;
        total += expected[i] * whole;
    }
    print_message(
        "glass sphere, default settings, %.0f photons: radial profile to %.2f m, relative L1 %.2f %%\n",
        result->stats[STAT_photons_emitted], edges[RINGS], 100 * difference / total);
    assert_in_bound(difference / total, 0.02);
    truth_close(&truth);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(profile)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
