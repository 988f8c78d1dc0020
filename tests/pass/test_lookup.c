/* Caustics seen through glass and mirrors: a mirror shows what a mirrored camera sees, water shows its floor
 * as the closed form has it, and what is seen only so gets its photons. */
#include <string.h>

#include "core/measure/analytic.h"
#include "core/measure/image_measure.h"
#include "core/scene/scene_builder.h"
#include "core/scene/shapes.h"
#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

#define CAUSTICS (1u << CHANNEL_CAUSTICS)
#define INDIRECT (1u << CHANNEL_INDIRECT)

/* ---- a plane mirror ------------------------------------------------------------------------------------ */

enum { WIDTH = 120, HEIGHT = 80, VALUES = 3 * WIDTH * HEIGHT };
static const double mirror_x = -1.6;

static void place(struct scene_builder *builder, const char *name, uint32_t mesh)
{
    struct scene_node node = scene_node_default(name, SCENE_NONE);
    scene_builder_instance(builder, scene_builder_node(builder, &node), mesh);
}

/* A glass ball over a floor in a spot light that does not reach the mirror beside it. */
static struct scene *mirror_scene(bool has_mirror, struct error *error)
{
    struct scene_builder builder;
    scene_builder_begin(&builder, "mirror");
    struct scene_material material = scene_material_default("floor");
    material.double_sided = true;
    uint32_t floor = scene_builder_material(&builder, &material);
    material = scene_material_default("glass");
    material.kind = MATERIAL_DIELECTRIC;
    material.roughness = 0;
    material.transmission = 1;
    uint32_t glass = scene_builder_material(&builder, &material);
    material = scene_material_default("metal");
    material.kind = MATERIAL_MIRROR;
    material.metallic = 1;
    material.roughness = 0;
    uint32_t metal = scene_builder_material(&builder, &material);
    place(&builder, "floor", shape_floor(&builder, "floor", floor, vec3_make(0, 0, 0), 16));
    place(&builder, "ball", shape_icosphere(&builder, "ball", glass, vec3_make(0, 0.6, 0), 0.5, 5));
    const struct shape_quad quad = {vec3_make(mirror_x, 0.01, 3), vec3_make(0, 0, -6), vec3_make(0, 3, 0)};
    if (has_mirror)
        place(&builder, "mirror", shape_quads(&builder, "mirror", metal, &quad, 1));
    struct scene_light spot = {.type = LIGHT_SPOT, .intensity = {40, 40, 40}, .outer_cone = 0.145f};
    struct scene_node node = scene_node_default("spot", SCENE_NONE);
    struct vec3 back = vec3_unit(vec3_make(1.3, 3, -0.7), vec3_make(0, 1, 0));
    struct vec3 right = vec3_unit(vec3_cross(vec3_make(0, 1, 0), back), vec3_make(1, 0, 0));
    node.has_matrix = true;
    vec3_store(node.matrix, right);
    vec3_store(node.matrix + 4, vec3_cross(back, right));
    vec3_store(node.matrix + 8, back);
    vec3_store(node.matrix + 12, vec3_make(1.3, 3.6, -0.7));
    node.matrix[15] = 1;
    spot.inner_cone = 0.14f;
    spot.node = scene_builder_node(&builder, &node);
    scene_builder_light(&builder, &spot);
    return scene_builder_finish(&builder, error);
}

static struct view_camera mirrored(struct view_camera camera)
{
    camera.eye[0] = (float)(2 * mirror_x) - camera.eye[0];
    camera.at[0] = (float)(2 * mirror_x) - camera.at[0];
    return camera;
}

static void open_scene(struct truth *stage, struct scene *scene, uint32_t width, uint32_t height)
{
    struct error error = {0};
    *stage = (struct truth){.scene = scene, .width = width, .height = height};
    if (scene)
        stage->gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (stage->gpu)
        stage->renderer =
            renderer_create(&(struct renderer_params){.gpu = stage->gpu, .scene = scene}, &error);
    if (stage->renderer)
        stage->view = view_create(stage->renderer, width, height, &error);
    if (!stage->view)
        fail_msg("%s", error.message);
}

/* The picture in the mirror, or without one what the mirrored camera sees, turned round. */
static void render_mirror(bool has_mirror, const char *settings, float values[VALUES])
{
    struct error error = {0};
    struct truth stage;
    open_scene(&stage, mirror_scene(has_mirror, &error), WIDTH, HEIGHT);
    const struct view_camera camera = {
        .eye = {0.9f, 1.7f, 1.8f}, .at = {-2.95f, 0.05f, 0.1f}, .up = {0, 1, 0}, .fov = 24};
    const struct view_camera used = has_mirror ? camera : mirrored(camera);
    assert_true(view_set_camera(stage.view, &used, &error));
    truth_set(&stage, settings);
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS | INDIRECT);
    const float *caustics = truth_channel(result, CHANNEL_CAUSTICS);
    const float *indirect = truth_channel(result, CHANNEL_INDIRECT);
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++)
            for (uint32_t k = 0; k < 3; k++) {
                uint32_t from = 3 * (y * WIDTH + (has_mirror ? x : WIDTH - 1 - x)) + k;
                values[3 * (y * WIDTH + x) + k] = caustics[from] + indirect[from];
            }
    truth_close(&stage);
}

/* The mirror is in the photons' way only for what the ball's outside reflects: 4 % of the light, spread wide.
 */
static void mirror_shows_what_a_mirrored_camera_sees(void **state)
{
    (void)state;
    static float seen[VALUES], expected[VALUES];
    const char *settings = "density=uniform photons=60000 max_bounces=2 tile=full caster_mask=off cells=128";
    render_mirror(true, settings, seen);
    render_mirror(false, settings, expected);
    double sum = 0, seen_sum = 0;
    for (uint32_t i = 0; i < VALUES; i++) {
        sum += (double)expected[i];
        seen_sum += (double)seen[i];
    }
    assert_true(sum > 0);
    /* Splats share out small photons by area, chain points sample a kernel: compare what is wider than that.
     */
    static float smooth_seen[VALUES], smooth_expected[VALUES];
    struct measure_image a = {seen, WIDTH, HEIGHT, 3}, b = {expected, WIDTH, HEIGHT, 3};
    double raw = measure_relative_l1(&a, &b);
    measure_box3(&a, smooth_seen);
    measure_box3(&b, smooth_expected);
    a.values = smooth_seen;
    b.values = smooth_expected;
    double filtered = measure_relative_l1(&a, &b);
    print_message("mirror: relative L1 %.4f, 3x3 %.4f, flux %.4f\n", raw, filtered, seen_sum / sum);
    assert_in_bound(filtered, 0.03);
    assert_close(seen_sum / sum, 1, 0.01);
}

/* ---- water from above ---------------------------------------------------------------------------------- */

/* Where the ray from a camera `above` the water meets the floor `depth` below it, both measured along the
 * vertical; `slope` is the ray's run per metre of drop in air. */
static double floor_run(double above, double depth, double slope, double ior)
{
    double sine = slope / sqrt(1 + slope * slope) / ior;
    return above * slope + depth * sine / sqrt(1 - sine * sine);
}

static void water_shows_its_floor(void **state)
{
    (void)state;
    const double ior = 1.33, depth = 1, above = 1.5, intensity = 10;
    struct truth truth;
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 8,
        .height = depth,
        .ior = ior,
        .light = {0, 2, 0},
        .intensity = intensity,
        .camera = {.eye = {0.3f, (float)(depth + above), 0.4f},
                   .at = {0.3f, 0, 0.4f},
                   .up = {0, 0, -1},
                   .fov = 50},
        .width = WIDTH,
        .height_px = HEIGHT,
        .settings = "density=uniform photons=200000 kappa=16",
    };
    truth_open(&truth, &params);
    const struct frame_result *result = truth_render(&truth, 1, CAUSTICS | INDIRECT);
    const float *indirect = truth_channel(result, CHANNEL_INDIRECT),
                *caustics = truth_channel(result, CHANNEL_CAUSTICS);
    struct analytic_interface scene = {.intensity = intensity, .light_height = 1, .depth = depth, .ior = ior};
    static double errors[WIDTH * HEIGHT];
    double mean = 0, bias = 0, tangent = tan(25 * 3.14159265358979 / 180) / (0.5 * HEIGHT);
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++) {
            double across = (x + 0.5 - 0.5 * WIDTH) * tangent, down = (y + 0.5 - 0.5 * HEIGHT) * tangent;
            double slope = hypot(across, down), run = floor_run(above, depth, slope, ior);
            double radius = hypot(0.3 + run * across / slope, 0.4 + run * down / slope);
            double kept = 1 - analytic_fresnel(1 / sqrt(1 + slope * slope), 1, ior);
            double expected =
                analytic_interface_irradiance(&scene, radius) / 3.14159265358979 * kept / (ior * ior);
            size_t at = 3 * ((size_t)y * WIDTH + x);
            double error = (double)indirect[at] / expected - 1;
            errors[at / 3] = fabs(error);
            mean += fabs(error) / (WIDTH * HEIGHT);
            bias += error / (WIDTH * HEIGHT);
            assert_true(caustics[at] == 0);
        }
    double percentile99 = measure_percentile(errors, WIDTH * HEIGHT, 99);
    print_message("water from above: error mean %.4f, 99th percentile %.4f, bias %.5f\n", mean, percentile99,
                  bias);
    assert_true(result->stats[STAT_pixels_looked_up] == WIDTH * HEIGHT);
    truth_close(&truth);
    assert_in_bound(mean, 0.005);
    assert_in_bound(percentile99, 0.03);
    assert_in_bound(fabs(bias), 0.002);
}

/* From under water the surface mirrors the floor, more of it the flatter the view: that is the weaker branch
 * up to total reflection, and only camera_branches=2 shows it. */
static void second_branch_is_the_reflection(void **state)
{
    (void)state;
    const double ior = 1.33, intensity = 10;
    struct truth truth;
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 8,
        .height = 1,
        .ior = ior,
        .light = {0, 2, 0},
        .intensity = intensity,
        .camera = {.eye = {0.3f, 0.5f, 0.4f}, .at = {0.3f, 1, 0.4f}, .up = {0, 0, -1}, .fov = 80},
        .width = WIDTH,
        .height_px = HEIGHT,
        /* the closed form is taken at the pixels' middles, beside an edge of total reflection */
        .settings = "density=uniform photons=200000 kappa=16 camera_branches=2 camera_samples=1",
    };
    truth_open(&truth, &params);
    const float *indirect = truth_channel(truth_render(&truth, 1, INDIRECT), CHANNEL_INDIRECT);
    struct analytic_interface scene = {.intensity = intensity, .light_height = 1, .depth = 1, .ior = ior};
    static double errors[WIDTH * HEIGHT];
    double mean = 0, bias = 0, tangent = tan(40 * 3.14159265358979 / 180) / (0.5 * HEIGHT);
    uint32_t partial = 0;
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++) {
            /* the image's right is -x */
            double across = -(x + 0.5 - 0.5 * WIDTH) * tangent, down = (y + 0.5 - 0.5 * HEIGHT) * tangent;
            double radius = hypot(0.3 + 1.5 * across, 0.4 + 1.5 * down);
            double reflected = analytic_fresnel(1 / sqrt(1 + across * across + down * down), ior, 1);
            double expected = analytic_interface_irradiance(&scene, radius) / 3.14159265358979 * reflected;
            size_t at = (size_t)y * WIDTH + x;
            double error = (double)indirect[3 * at] / expected - 1;
            errors[at] = fabs(error);
            mean += fabs(error) / (WIDTH * HEIGHT);
            bias += error / (WIDTH * HEIGHT);
            partial += reflected < 0.5;
        }
    double percentile99 = measure_percentile(errors, WIDTH * HEIGHT, 99);
    print_message("surface from below: error mean %.4f, 99th percentile %.4f, bias %.5f\n", mean,
                  percentile99, bias);
    assert_true(partial > WIDTH * HEIGHT / 4 && partial < WIDTH * HEIGHT);
    truth_set(&truth, "camera_branches=1");
    double one = truth_render(&truth, 1, INDIRECT)->stats[STAT_pixels_looked_up];
    assert_close(one, WIDTH * HEIGHT - partial, 0.01 * WIDTH * HEIGHT);
    truth_close(&truth);
    assert_in_bound(mean, 0.005);
    assert_in_bound(percentile99, 0.03);
    assert_in_bound(fabs(bias), 0.002);
}

/* ---- frames -------------------------------------------------------------------------------------------- */

/* Photons of frame `frames` that are seen through glass per photon emitted, when the frames before had these
 * channels. */
static double render_cube(uint32_t frames, uint32_t channels_before, float *copy)
{
    struct truth stage;
    stage_open(&stage, "cube", WIDTH, HEIGHT, "photons=20000 cells=64");
    truth_render(&stage, frames - 1, channels_before);
    const struct frame_result *result = truth_render(&stage, 1, INDIRECT);
    if (copy)
        memcpy(copy, truth_channel(result, CHANNEL_INDIRECT), VALUES * sizeof *copy);
    double seen = result->stats[STAT_lookup_photons_seen] / result->stats[STAT_photons_emitted];
    truth_close(&stage);
    return seen;
}

static void reruns_give_the_same_bits(void **state)
{
    (void)state;
    static float first[VALUES], second[VALUES];
    render_cube(3, INDIRECT, first);
    render_cube(3, INDIRECT, second);
    assert_memory_equal(first, second, sizeof first);
}

/* One camera ray a pixel draws the torus with steps; several where it ends come nearer to the mean of 64
 * whole frames with moved rays, and cost rays at its edges only. */
static void samples_smooth_what_breaks_up(void **state)
{
    (void)state;
    static float pictures[3][VALUES];
    double points[2] = {0, 0};
    for (int i = 0; i < 3; i++) {
        struct truth stage;
        stage_open(&stage, "cube", WIDTH, HEIGHT, "density=uniform photons=20000 cells=64");
        truth_set(&stage, i == 0 ? "camera_samples=1" : i == 1 ? "camera_samples=8" : "accumulate=64");
        const struct frame_result *result = truth_render(&stage, 1, INDIRECT);
        memcpy(pictures[i], truth_channel(result, CHANNEL_INDIRECT), sizeof pictures[i]);
        if (i < 2)
            points[i] = result->stats[STAT_pixels_looked_up];
        truth_close(&stage);
    }
    struct measure_image images[3];
    for (int i = 0; i < 3; i++)
        images[i] = (struct measure_image){pictures[i], WIDTH, HEIGHT, 3};
    double one = measure_relative_l1(&images[0], &images[2]),
           eight = measure_relative_l1(&images[1], &images[2]);
    print_message("camera samples: relative L1 %.4f with one, %.4f with eight; %.0f and %.0f points\n", one,
                  eight, points[0], points[1]);
    assert_true(eight < 0.7 * one);
    assert_true(points[1] > points[0] && points[1] < 8 * points[0]);
}

/* Seen through glass only, the torus gets the photons that its pixels need. Density that knows of splats
 * alone takes them away from it. */
static void what_is_seen_so_gets_photons(void **state)
{
    (void)state;
    double without = render_cube(7, CAUSTICS, NULL), with = render_cube(7, INDIRECT, NULL);
    print_message("photons seen through glass per emitted: %.3f, %.3f with feedback\n", without, with);
    assert_true(with > 1.5 * without);
}

/* Footprints of kilometres, from rays that leave glass at a grazing angle, are cut to size with their energy:
 * how short does not change how much light there is, and no pixel blows up. */
static void long_footprints_keep_their_energy(void **state)
{
    (void)state;
    struct truth stage;
    struct error error = {0};
    double sums[2] = {0, 0}, largest = 0;
    stage_open(&stage, "square", WIDTH, HEIGHT, "density=uniform photons=20000");
    assert_true(view_follow_camera(stage.view, 1, &error));
    for (int i = 0; i < 2; i++) {
        truth_set(&stage, i ? "max_radius=4" : "max_radius=64");
        const float *indirect = truth_channel(truth_render(&stage, 1, INDIRECT), CHANNEL_INDIRECT);
        for (uint32_t k = 0; k < VALUES; k++) {
            sums[i] += (double)indirect[k];
            largest = fmax(largest, (double)indirect[k]);
        }
    }
    truth_close(&stage);
    print_message("long footprints: sums %.4g and %.4g, largest %.3g\n", sums[0], sums[1], largest);
    assert_true(sums[0] > 0);
    assert_close(sums[1] / sums[0], 1, 0.02);
    assert_in_bound(largest, 50);
}

int main(void)
{
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(mirror_shows_what_a_mirrored_camera_sees),
        cmocka_unit_test(water_shows_its_floor),
        cmocka_unit_test(second_branch_is_the_reflection),
        cmocka_unit_test(long_footprints_keep_their_energy),
        cmocka_unit_test(reruns_give_the_same_bits),
        cmocka_unit_test(samples_smooth_what_breaks_up),
        cmocka_unit_test(what_is_seen_so_gets_photons),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
