/* Soft caustics of a glass ball: against one punctual light after the other, all over the emitter. */
#include <string.h>

#include "core/measure/image_measure.h"
#include "core/render/renderer.h"
#include "core/scene/scene.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 96, HEIGHT = 54, VALUES = WIDTH * HEIGHT * 3, SIDE = 8 };
#define IRRADIANCE (1u << CHANNEL_IRRADIANCE)

/* `sphere` with its lamp `share` of its distance from the ball in radius. */
static void open_lamp(struct truth *stage, double share, const char *settings, double *radius)
{
    struct error error = {0};
    struct scene *scene = scene_open("sphere", &error);
    assert_non_null(scene);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    const float *p = pose->lights[0].position;
    *radius = share * sqrt((double)(p[0] * p[0] + (p[1] - 0.6f) * (p[1] - 0.6f) + p[2] * p[2]));
    scene_pose_destroy(&pose);
    scene->lights[0].shape = share > 0 ? LIGHT_SHAPE_SPHERE : LIGHT_SHAPE_POINT;
    scene->lights[0].half_size[0] = scene->lights[0].half_size[1] = (float)*radius;
    stage_open_scene(stage, scene, WIDTH, HEIGHT, settings);
}

/* The mean over lights at stratified places of the disk that a ball at the distance of the glass ball sees,
 * each with its share of the sphere's intensity: L cos(theta) dA. */
static void stratified_reference(double radius, float *reference)
{
    struct truth stage;
    struct error error = {0};
    double unused, sum[VALUES] = {0}, way[3], length = 0;
    open_lamp(&stage, 0, "photons=8192 cells=64 density=uniform", &unused);
    struct scene_pose *pose = scene_pose_create(stage.scene, &error);
    assert_non_null(pose);
    double light[3];
    for (int k = 0; k < 3; k++) {
        light[k] = (double)pose->lights[0].position[k];
        way[k] = (k == 1 ? 0.6 : 0) - light[k];
        length += way[k] * way[k];
    }
    scene_pose_destroy(&pose);
    length = sqrt(length);
    double level = hypot(way[0], way[2]), x[3] = {way[2] / level, 0, -way[0] / level}, y[3];
    for (int k = 0; k < 3; k++)
        y[k] = (way[(k + 1) % 3] * x[(k + 2) % 3] - way[(k + 2) % 3] * x[(k + 1) % 3]) / length;
    double sine2 = radius * radius / (length * length), disk = radius / sqrt(1 - sine2);
    for (int i = 0; i < SIDE * SIDE; i++) {
        /* rings of equal area, turned against each other */
        double rho = disk * sqrt((i / SIDE + 0.5) / SIDE),
               phi = 2 * 3.14159265358979 * (i % SIDE + 0.5 + 0.382 * (i / SIDE)) / SIDE;
        struct view_light change = {.overrides = LIGHT_OVERRIDE_POSITION};
        for (int k = 0; k < 3; k++)
            change.position[k] = (float)(light[k] + rho * cos(phi) * x[k] + rho * sin(phi) * y[k]);
        assert_true(view_set_light(stage.view, 0, &change, &error));
        const float *values = truth_channel(truth_render(&stage, 1, IRRADIANCE), CHANNEL_IRRADIANCE);
        double cosine = length / sqrt(length * length + rho * rho);
        for (int k = 0; k < VALUES; k++)
            sum[k] += cosine / (1 - sine2) * (double)values[k];
    }
    for (int k = 0; k < VALUES; k++)
        reference[k] = (float)(sum[k] / (SIDE * SIDE));
    truth_close(&stage);
}

static void soft_caustics_follow_the_emitter(void **state)
{
    (void)state;
    static const double shares[] = {0.01, 0.05, 0.2};
    static float reference[VALUES];
    for (size_t i = 0; i < sizeof shares / sizeof *shares; i++) {
        struct truth stage;
        double radius, error[3];
        open_lamp(&stage, shares[i], "photons=32768", &radius);
        stratified_reference(radius, reference);
        struct measure_image b = {reference, WIDTH, HEIGHT, 3};
        static const char *const ways[3] = {"soft=differentials", "soft=samples", "soft=auto"};
        for (int way = 0; way < 3; way++) {
            truth_set(&stage, ways[way]);
            view_reset(stage.view);
            const struct frame_result *result = truth_render(&stage, 5, IRRADIANCE);
            struct measure_image a = {truth_channel(result, CHANNEL_IRRADIANCE), WIDTH, HEIGHT, 3};
            error[way] = measure_relative_l1(&a, &b);
            double flux = measure_sum(&a, 1, NULL) / measure_sum(&b, 1, NULL);
            print_message(
                "radius %4.0f %% of the distance, %-18s relative L1 %.4f, flux %.4f, %.0f photons\n",
                100 * shares[i], ways[way], error[way], flux, result->stats[STAT_photons_emitted]);
            assert_close(flux, 1, 0.02);
            if (way == 2)
                print_message("  auto measured %.4f\n", result->stats[STAT_soft_error]);
        }
        assert_in_bound(error[2], 0.1);
        assert_in_bound(error[2], 1.5 * fmin(error[0], error[1]) + 0.005);
        truth_close(&stage);
    }
}

/* ---- penumbrae -------------------------------------------------------------------------------------------
 */

/* A square mirror at y = 1 looks down on the floor and, beside the floor's caustic, on a rectangle that
 * shines upwards: a floor point sees the rectangle's image, 0.8 m above the mirror, as far as the mirror's
 * edges let it. */
enum { PENUMBRA_WIDTH = 120, PENUMBRA_HEIGHT = 68 };
static const double emitter[3] = {-0.4, 0.2, 0}, emitter_half[2] = {0.1, 0.06}, mirror_half = 0.25;

/* Irradiance over radiance of a horizontal rectangle `height` above a point that faces it, its sides at x and
 * z from there (Lambert's formula: half the sum over its edges of the angle an edge takes up times the cosine
 * of the edge's plane). */
static double lambert(const double x[2], const double z[2], double height)
{
    struct vec3 corners[4];
    double sum = 0;
    for (int i = 0; i < 4; i++)
        corners[i] = vec3_unit(vec3_make(x[i == 1 || i == 2], height, z[i / 2]), vec3_make(0, 1, 0));
    for (int i = 0; i < 4; i++) {
        struct vec3 across = vec3_cross(corners[i], corners[(i + 1) % 4]);
        double sine = vec3_length(across);
        if (sine > 0)
            sum += atan2(sine, vec3_dot(corners[i], corners[(i + 1) % 4])) * across.y / sine;
    }
    return 0.5 * fabs(sum);
}

static double penumbra(const double floor[2])
{
    double sides[2][2], height = 2 - emitter[1];
    for (int axis = 0; axis < 2; axis++)
        for (int end = 0; end < 2; end++) {
            double sign = end ? 1 : -1, place = axis ? emitter[2] : emitter[0];
            double at = place + sign * emitter_half[axis] - floor[axis];
            double edge = (sign * mirror_half - floor[axis]) * height; /* the mirror's, seen at the image */
            sides[axis][end] = end ? fmin(at, edge) : fmax(at, edge);
        }
    bool is_seen = sides[0][0] < sides[0][1] && sides[1][0] < sides[1][1];
    return is_seen ? lambert(sides[0], sides[1], height) : 0;
}

static void penumbrae_are_those_of_the_emitter(void **state)
{
    (void)state;
    struct scene_builder builder;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 16);
    uint32_t metal = scenery_mirror(&builder);
    for (int k = 0; k < 3; k++)
        builder.scene->materials[metal].base_color[k] = 1;
    scenery_place(&builder, shape_floor(&builder, "mirror", metal, vec3_make(0, 1, 0), 2 * mirror_half));
    const double intensity = 10, up[3] = {0, 1, 0};
    struct scene_light light = {.type = LIGHT_SPOT,
                                .node = truth_aimed_node(&builder, "emitter", emitter, up),
                                .intensity = {10, 10, 10},
                                .inner_cone = 1.5f,
                                .outer_cone = 1.57f,
                                .shape = LIGHT_SHAPE_RECTANGLE,
                                .half_size = {(float)emitter_half[0], (float)emitter_half[1]},
                                .is_emissive_mesh = true};
    scene_name_copy(light.name, "emitter");
    scene_builder_light(&builder, &light);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0.5, 2.2, 1.9), vec3_make(0.5, 0, 0), vec3_make(0, 1, 0), 42);
    struct truth stage;
    scenery_open(&stage, &builder, &camera, PENUMBRA_WIDTH, PENUMBRA_HEIGHT, "photons=65536");
    static float expected[PENUMBRA_WIDTH * PENUMBRA_HEIGHT * 3];
    double radiance = intensity / (4 * emitter_half[0] * emitter_half[1]);
    for (uint32_t p = 0; p < (uint32_t)PENUMBRA_WIDTH * PENUMBRA_HEIGHT; p++) {
        /* the mean over a pixel, from sixteen places of it */
        double floor[2], sum = 0;
        for (int k = 0; k < 16; k++) {
            assert_true(truth_floor_point(&stage, p % PENUMBRA_WIDTH + (k % 4 + 0.5) / 4,
                                          p / PENUMBRA_WIDTH + (k / 4 + 0.5) / 4, floor));
            sum += penumbra(floor);
        }
        for (uint32_t c = 0; c < 3; c++)
            expected[3 * p + c] = (float)(radiance * sum / 16);
    }
    static const char *const ways[] = {"soft=differentials", "soft=samples", "soft=auto",
                                       "aa=pixel accumulate=16"};
    for (size_t way = 0; way < sizeof ways / sizeof *ways; way++) {
        truth_set(&stage, ways[way]);
        view_reset(stage.view);
        const struct frame_result *result = truth_render(&stage, 5, IRRADIANCE);
        struct measure_image a = {truth_channel(result, CHANNEL_IRRADIANCE), PENUMBRA_WIDTH, PENUMBRA_HEIGHT,
                                  3},
                             b = {expected, PENUMBRA_WIDTH, PENUMBRA_HEIGHT, 3};
        double error = measure_relative_l1(&a, &b),
               flux = measure_sum(&a, 1, NULL) / measure_sum(&b, 1, NULL);
        print_message("penumbra of a rectangle, %-22s relative L1 %.4f, flux %.4f, auto measured %.4f\n",
                      ways[way], error, flux, result->stats[STAT_soft_error]);
        assert_in_bound(error, 0.05);
        assert_close(flux, 1, 0.01);
    }
    truth_close(&stage);
}

/* A radius of nothing is a punctual light, to the last bit; one that swallows the scene is taken as smaller
 * and said so. */
static void sizes_without_sense(void **state)
{
    (void)state;
    struct truth stage;
    double radius;
    static float point[VALUES];
    open_lamp(&stage, 0, "photons=8192 cells=32", &radius);
    memcpy(point, truth_channel(truth_render(&stage, 2, IRRADIANCE), CHANNEL_IRRADIANCE), sizeof point);
    truth_close(&stage);
    static const double shares[] = {1e-9, 1e6};
    for (int i = 0; i < 2; i++) {
        open_lamp(&stage, shares[i], "photons=8192 cells=32", &radius);
        const struct frame_result *result = truth_render(&stage, 3, IRRADIANCE);
        const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
        struct measure_image a = {values, WIDTH, HEIGHT, 3}, b = {point, WIDTH, HEIGHT, 3};
        assert_int_equal(measure_non_finite(&a), 0);
        double flux = measure_sum(&a, 1, NULL) / measure_sum(&b, 1, NULL);
        print_message("radius %g of the distance: flux %.4f of a point's, %.0f shrunk\n", shares[i], flux,
                      result->stats[STAT_lights_shrunk]);
        assert_close(result->stats[STAT_lights_shrunk], i, 0);
        assert_close(flux, 1, i ? 0.5 : 0.01);
        truth_close(&stage);
    }
}

/* What a soft light needs is there with one, and only then. */
static void plan_and_memory(void **state)
{
    (void)state;
    static const char *const names[3] = {"soft light", "spreads", "emitter samples"};
    double less[2];
    for (int soft = 0; soft < 2; soft++) {
        struct truth stage;
        double radius;
        open_lamp(&stage, soft ? 0.2 : 0, "photons=4096 cells=32", &radius);
        const struct frame_result *result = truth_render(&stage, 4, IRRADIANCE);
        for (uint32_t i = 0; i < result->plan_count; i++)
            for (int k = 0; k < 3; k++)
                if (!strcmp(result->plan[i].name, names[k]))
                    assert_int_equal(result->plan[i].is_used, soft);
        double bytes = result->stats[STAT_device_bytes];
        truth_set(&stage, "aa=pixel");
        less[soft] = bytes - truth_render(&stage, 4, IRRADIANCE)->stats[STAT_device_bytes];
        print_message("%s: aa=pixel takes %.0f bytes less\n", soft ? "soft" : "hard", less[soft]);
        truth_close(&stage);
    }
    /* twelve floats beside each of four rays a photon, for two bounces, and the comparison's image */
    assert_close(less[1] - less[0], 2 * 4 * 4096 * 48.0 + 16.0 * WIDTH * HEIGHT, 4096);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(soft_caustics_follow_the_emitter),
                                       cmocka_unit_test(penumbrae_are_those_of_the_emitter),
                                       cmocka_unit_test(sizes_without_sense),
                                       cmocka_unit_test(plan_and_memory)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
