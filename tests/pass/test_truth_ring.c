/* A polished ring from above: the cusp and the envelope of its caustic against the catacaustic of a circle.
 */

#include "core/measure/analytic.h"
#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

static const double pi = 3.14159265358979323846;

/* Plan (x, y) of the closed form is (x, z) of the floor. */
struct ring_case {
    const char *name;
    struct truth_params params;
    struct analytic_ring ring;
};

static double sample(const struct truth *truth, const float *irradiance, const double image[2])
{
    double x = image[0] - 0.5, y = image[1] - 0.5, sum = 0;
    for (int k = 0; k < 4; k++) {
        double i = floor(x) + k % 2, j = floor(y) + k / 2;
        double weight = (1 - fabs(x - i)) * (1 - fabs(y - j));
        if (i >= 0 && j >= 0 && i < truth->width && j < truth->height)
            sum += weight * (double)irradiance[3 * ((size_t)j * truth->width + (size_t)i)];
    }
    return sum;
}

static bool image_of(const struct truth *truth, const struct analytic_ring *ring, double angle,
                     double image[2])
{
    struct analytic_ring_point point;
    if (!analytic_ring_caustic(ring, angle, &point) || !point.is_lit)
        return false;
    truth_image_point(truth, point.position, image);
    return true;
}

/* How far the brightest place across the curve lies from it, in pixels, within 4 of them. */
static double offset_at(const struct truth *truth, const float *irradiance, const double at[2],
                        const double normal[2])
{
    double brightest = -1, offset = 0;
    for (double d = -4; d <= 4; d += 0.125) {
        double place[2] = {at[0] + d * normal[0], at[1] + d * normal[1]};
        double value = sample(truth, irradiance, place);
        if (value > brightest) {
            brightest = value;
            offset = d;
        }
    }
    return fabs(offset);
}

/* The closed form's irradiance times pixel area, deposited ray by ray on a grid `finer` times as fine as the
 * image. */
enum { FINER = 8 };
struct expected {
    uint32_t width, height; /* of the grid */
    double *flux;
};

static struct expected expect(const struct truth *truth, const struct ring_case *test)
{
    struct expected grid = {truth->width * FINER, truth->height * FINER, NULL};
    grid.flux = calloc((size_t)grid.width * grid.height, sizeof *grid.flux);
    assert_non_null(grid.flux);
    enum { ANGLES = 12000, DISTANCES = 1500 };
    double angle_step = 2 * pi / ANGLES, distance_step = 2 * test->ring.radius / DISTANCES;
    for (int i = 0; i < ANGLES; i++) {
        for (int j = 0; j < DISTANCES; j++) {
            struct analytic_ring_ray ray;
            if (!analytic_ring_trace(&test->ring, (i + 0.5) * angle_step, (j + 0.5) * distance_step, &ray))
                break;
            if (ray.flux == 0)
                continue;
            double image[2];
            truth_image_point(truth, ray.position, image);
            int x = (int)floor(image[0] * FINER), y = (int)floor(image[1] * FINER);
            if (x >= 0 && y >= 0 && x < (int)grid.width && y < (int)grid.height)
                grid.flux[(size_t)y * grid.width + (size_t)x] +=
                    ray.flux * test->params.intensity * angle_step * distance_step;
        }
    }
    return grid;
}

/* What a pixel should hold when the image is moved by (u, v) eighths of a pixel. */
static double expected_flux(const struct expected *grid, int x, int y, int u, int v)
{
    double sum = 0;
    for (int j = y * FINER - v; j < (y + 1) * FINER - v; j++)
        for (int i = x * FINER - u; i < (x + 1) * FINER - u; i++)
            if (i >= 0 && j >= 0 && i < (int)grid->width && j < (int)grid->height)
                sum += grid->flux[(size_t)j * grid->width + (size_t)i];
    return sum;
}

/* How far the neighbourhood of the cusp has to be moved to lie best on the closed form's, in pixels: the cusp
 * is a point, but the brightest pixel is the one where the two branches beside it run together, two or three
 * pixels away. */
static double cusp_shift(const struct truth *truth, const float *irradiance, const struct expected *grid,
                         const double cusp[2])
{
    double area = truth_pixel_area(truth, cusp[0], cusp[1]), least = INFINITY, shift = INFINITY;
    for (int v = -2 * FINER; v <= 2 * FINER; v++) {
        for (int u = -2 * FINER; u <= 2 * FINER; u++) {
            double sum = 0;
            for (int y = (int)cusp[1] - 8; y <= (int)cusp[1] + 8; y++) {
                for (int x = (int)cusp[0] - 8; x <= (int)cusp[0] + 8; x++) {
                    double value = (double)irradiance[3 * ((size_t)y * truth->width + (size_t)x)];
                    double difference = value * area - expected_flux(grid, x, y, u, v);
                    sum += difference * difference;
                }
            }
            if (sum < least) {
                least = sum;
                shift = hypot(u, v) / FINER;
            }
        }
    }
    return shift;
}

/* Relative L1 over the pixels inside the ring, without the light that meets the wall twice. */
static double one_bounce_error(struct truth *truth, const struct expected *grid, const struct ring_case *test,
                               const char *settings)
{
    truth_set(truth, settings);
    const float *irradiance =
        truth_channel(truth_render(truth, 8, 1u << CHANNEL_IRRADIANCE), CHANNEL_IRRADIANCE);
    double difference = 0, total = 0, area = truth_pixel_area(truth, 0.5 * truth->width, 0.5 * truth->height);
    for (int y = 0; y < (int)truth->height; y++) {
        for (int x = 0; x < (int)truth->width; x++) {
            double floor[2];
            truth_floor_point(truth, x + 0.5, y + 0.5, floor);
            if (hypot(floor[0], floor[1]) > 0.98 * test->ring.radius)
                continue;
            double expected = expected_flux(grid, x, y, 0, 0);
            double value = (double)irradiance[3 * ((size_t)y * truth->width + (size_t)x)];
            difference += fabs(value * area - expected);
            total += expected;
        }
    }
    return difference / total;
}

static void check_ring(const struct ring_case *test)
{
    struct truth truth;
    truth_open(&truth, &test->params);
    const struct frame_result *result = truth_render(&truth, 8, 1u << CHANNEL_IRRADIANCE);
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);
    struct expected grid = expect(&truth, test);

    double cusp_plan[2], cusp[2];
    assert_true(analytic_ring_cusp(&test->ring, cusp_plan));
    truth_image_point(&truth, cusp_plan, cusp);
    double shift = cusp_shift(&truth, irradiance, &grid, cusp);

    /* The envelope, where it is lit, away from the cusp, where its two branches run into each other, and from
     * the wall. */
    double offsets[4000], sum = 0;
    size_t count = 0;
    for (int i = 0; i < 4000; i++) {
        double angle = 2 * pi * i / 4000, at[2], next[2];
        if (!image_of(&truth, &test->ring, angle, at) || !image_of(&truth, &test->ring, angle + 1e-5, next))
            continue;
        struct analytic_ring_point point;
        analytic_ring_caustic(&test->ring, angle, &point);
        double length = hypot(next[0] - at[0], next[1] - at[1]);
        if (hypot(at[0] - cusp[0], at[1] - cusp[1]) < 12 || length == 0 ||
            hypot(point.position[0], point.position[1]) > 0.93 * test->ring.radius)
            continue;
        double normal[2] = {(at[1] - next[1]) / length, (next[0] - at[0]) / length};
        offsets[count] = offset_at(&truth, irradiance, at, normal);
        sum += offsets[count++];
    }
    assert_true(count > 100);
    double mean = sum / (double)count, largest = measure_percentile(offsets, count, 100);

    double coarse = one_bounce_error(&truth, &grid, test, "max_bounces=1");
    double fine = one_bounce_error(&truth, &grid, test, "photons=250000 target_area=0.05");
    print_message(
        "ring, %s: cusp %.2f px off; envelope at %zu places, mean %.2f px, largest %.2f px; relative L1 of "
        "one bounce %.2f %%, with more photons %.2f %%\n",
        test->name, shift, count, mean, largest, 100 * coarse, 100 * fine);
    assert_in_bound(shift, 1);
    assert_in_bound(largest, 1);
    assert_in_bound(fine, 0.03);
    assert_true(fine < coarse);
    free(grid.flux);
    truth_close(&truth);
}

/* Straight down on the floor inside the ring, 4.4 mm a pixel. */
#define ABOVE                                                                                                \
    .camera = {.eye = {0, 3, 0}, .at = {0, 0, 0}, .up = {0, 0, -1}, .fov = 22.6f}, .width = 480,             \
    .height_px = 270

static void lamp(void **state)
{
    (void)state;
    struct ring_case test = {"lamp at 2.5 m",
                             {.caster = TRUTH_RING,
                              .size = 0.5,
                              .height = 0.25,
                              .light = {2.4, 1.7, -0.6},
                              .intensity = 30,
                              ABOVE},
                             {.radius = 0.5, .wall_height = 0.25, .light = {2.4, -0.6}, .light_height = 1.7}};
    check_ring(&test);
}

static void sun(void **state)
{
    (void)state;
    struct ring_case test = {"sun",
                             {.caster = TRUTH_RING,
                              .size = 0.5,
                              .height = 0.25,
                              .is_directional = true,
                              .light = {-1, -0.7, 0.25},
                              .intensity = 3,
                              ABOVE},
                             {.radius = 0.5,
                              .wall_height = 0.25,
                              .is_directional = true,
                              .light = {-1, 0.25},
                              .light_height = 0.7 / 1.0307764064044151}};
    check_ring(&test);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(lamp), cmocka_unit_test(sun)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
