/* The bvh tracer's shader against the plain C traversal of the same trees. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/gpu/gpu.h"
#include "core/scene/bvh.h"
#include "tests/support/check.h"
#include "tests/support/trace_device.h"
#include "tests/support/trace_scenes.h"

static struct gpu *gpu;

static float hit_t(const struct trace_hit_gpu *hit)
{
    float t;
    memcpy(&t, &hit->hit.x, sizeof t);
    return t;
}

static bool is_miss(const struct trace_hit_gpu *hit)
{
    return hit->hit.y == TRACE_DEVICE_MISS;
}

static struct bvh **build_meshes(const struct scene *scene)
{
    struct bvh **meshes = calloc(scene->mesh_count + 1, sizeof *meshes);
    assert_non_null(meshes);
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        struct error error;
        meshes[m] = bvh_create_mesh(scene, m, &error);
        assert_non_null(meshes[m]);
    }
    return meshes;
}

static void destroy_meshes(const struct scene *scene, struct bvh **meshes)
{
    for (uint32_t m = 0; m < scene->mesh_count; m++)
        bvh_destroy(&meshes[m]);
    free(meshes);
}

/* Closest hits of all rays that `stride` leaves, then any-hits, against the reference. Rounding differs
 * between the two (order of sums), so a hit at the very border of a triangle may go to its neighbour, or
 * be missed at an open edge. */
static void compare(const char *name, const struct scene *scene, const struct scene_pose *pose,
                    const struct trace_ray_gpu *rays, uint32_t count, uint32_t stride, bool all_lanes)
{
    struct error error;
    struct trace_device *device = trace_device_create(gpu, scene, pose, false, &error);
    if (!device)
        fail_msg("%s: %s", name, error.message);
    struct bvh **meshes = build_meshes(scene);
    struct trace_hit_gpu *hits = calloc(count, sizeof *hits), *any = calloc(count, sizeof *any);
    assert_true(hits && any);
    struct trace_run run = {.rays = rays, .count = count, .stride = stride, .all_lanes = all_lanes};
    assert_true(trace_device_run(device, &run, hits, NULL, &error));
    run.any = true;
    assert_true(trace_device_run(device, &run, any, NULL, &error));

    uint32_t hit_count = 0, border_count = 0, traced = 0;
    for (uint32_t i = 0; i < count; i += stride) {
        struct trace_hit_gpu expected;
        trace_scene_reference(scene, pose, meshes, &rays[i], &expected);
        traced++;
        assert_int_equal(hits[i].hit.w, 0);
        assert_int_equal(any[i].hit.w, 0);
        if (is_miss(&any[i]) != is_miss(&hits[i]))
            fail_msg("%s: ray %u: any-hit and closest hit disagree", name, i);
        hit_count += !is_miss(&hits[i]);
        if (is_miss(&hits[i]) && is_miss(&expected))
            continue;
        bool is_same = hits[i].hit.y == expected.hit.y && hits[i].hit.z == expected.hit.z;
        /* places are rounded to 6e-8 of where they are, whatever the way to them */
        const float *o = &rays[i].origin_t_max.x;
        float place = fmaxf(fabsf(o[0]), fmaxf(fabsf(o[1]), fabsf(o[2])));
        bool is_near = !is_miss(&hits[i]) && !is_miss(&expected) &&
                       fabsf(hit_t(&hits[i]) - hit_t(&expected)) <= 1e-4f * hit_t(&expected) + 5e-7f * place;
        if (is_same && is_near && fabsf(hits[i].barycentrics.x - expected.barycentrics.x) < 2e-2f &&
            fabsf(hits[i].barycentrics.y - expected.barycentrics.y) < 2e-2f)
            continue;
        double border = INFINITY;
        if (!is_miss(&hits[i]))
            border = trace_scenes_border(scene, pose, &rays[i], &hits[i]);
        if (!is_miss(&expected))
            border = fmin(border, trace_scenes_border(scene, pose, &rays[i], &expected));
        border_count++;
        /* surfaces that touch (a floor through a sphere) are both right */
        if (!(border < 1e-5) && !is_near)
            fail_msg("%s: ray %u: instance %u triangle %u t %g, not instance %u "
                     "triangle %u t %g",
                     name, i, hits[i].hit.y, hits[i].hit.z, (double)hit_t(&hits[i]), expected.hit.y,
                     expected.hit.z, (double)hit_t(&expected));
    }
    print_message("%s, stride %u%s: %u rays, %u hits, %u at borders\n", name, stride,
                  all_lanes ? ", all lanes" : "", traced, hit_count, border_count);
    assert_true(border_count <= traced / 200 + 1);
    if (scene->instance_count)
        assert_true(hit_count > traced / 50);
    else
        assert_int_equal(hit_count, 0);
    free(hits);
    free(any);
    destroy_meshes(scene, meshes);
    trace_device_destroy(&device);
}

static void compare_builtin(const char *name)
{
    struct error error;
    struct scene *scene = scene_create_builtin(name, &error);
    assert_non_null(scene);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    scene_pose_set_time(scene, pose, 0);
    const uint32_t count = 20003; /* the last subgroup is not full */
    struct trace_ray_gpu *rays = calloc(count, sizeof *rays);
    assert_non_null(rays);
    trace_scenes_rays(scene, pose, 7, rays, count);
    compare(name, scene, pose, rays, count, 1, false);
    compare(name, scene, pose, rays, count, 3, false);
    compare(name, scene, pose, rays, count, 3, true);
    free(rays);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static void builtin_scenes_match_the_reference(void **state)
{
    (void)state;
    static const char *const names[] = {"sphere", "ring", "square", "cornell", "cube", "prism", "empty"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        compare_builtin(names[i]);
}

/* A device whose largest buffer takes two thirds of the triangles: the others lie in a second one, and every
 * ray meets what it met. */
static void two_triangle_buffers_give_the_same_bits(void **state)
{
    (void)state;
    struct error error;
    struct scene *scene = scene_create_builtin("sphere", &error);
    assert_non_null(scene);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    scene_pose_set_time(scene, pose, 0);
    const uint32_t count = 8003;
    const uint64_t bytes = scene->triangle_count * sizeof(struct bvh_triangle), most = 2 * bytes / 3;
    struct trace_ray_gpu *rays = calloc(count, sizeof *rays);
    struct trace_hit_gpu *whole = calloc(count, sizeof *whole), *halves = calloc(count, sizeof *halves);
    assert_true(rays && whole && halves);
    trace_scenes_rays(scene, pose, 11, rays, count);
    struct gpu *small = gpu_create(&(struct gpu_params){.max_storage_bytes = most}, &error);
    assert_non_null(small);
    struct trace_device *devices[2] = {trace_device_create(gpu, scene, pose, false, &error),
                                       trace_device_create(small, scene, pose, false, &error)};
    assert_true(devices[0] && devices[1]);
    struct bvh **meshes = build_meshes(scene);
    uint32_t later = 0;                      /* hits in the second buffer */
    for (uint32_t way = 0; way < 6; way++) { /* as a packet, lane by lane, idle lanes; closest and any */
        struct trace_run run = {.rays = rays, .count = count, .stride = way % 3 ? 3 : 1};
        run.all_lanes = way % 3 == 2;
        run.any = way >= 3;
        memset(whole, 0, count * sizeof *whole);
        memset(halves, 0, count * sizeof *halves);
        assert_true(trace_device_run(devices[0], &run, whole, NULL, &error));
        assert_true(trace_device_run(devices[1], &run, halves, NULL, &error));
        for (uint32_t i = 0; i < count; i += run.stride)
            assert_memory_equal(&whole[i], &halves[i], sizeof *whole);
        if (way > 0)
            continue;
        for (uint32_t i = 0; i < count; i++) {
            if (is_miss(&whole[i]))
                continue;
            uint32_t mesh = scene->instances[whole[i].hit.y].mesh, place = 0;
            for (uint32_t m = 0; m < mesh; m++)
                place += meshes[m]->item_count;
            for (uint32_t k = 0; meshes[mesh]->triangles[k].vertex[0].w != whole[i].hit.z; k++)
                place++;
            later += place >= most / sizeof(struct bvh_triangle);
        }
    }
    print_message("%u of %u rays meet triangles of the second buffer\n", later, count);
    assert_in_range(later, count / 50, count / 2);
    destroy_meshes(scene, meshes);
    trace_device_destroy(&devices[0]);
    trace_device_destroy(&devices[1]);
    gpu_destroy(&small);
    free(rays);
    free(whole);
    free(halves);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static void many_transformed_instances_match_the_reference(void **state)
{
    (void)state;
    for (uint32_t instance_count = 1; instance_count <= 729; instance_count *= 9) {
        struct trace_scene *made = trace_scenes_create(instance_count);
        const uint32_t count = 10000;
        struct trace_ray_gpu *rays = calloc(count, sizeof *rays);
        assert_non_null(rays);
        trace_scenes_rays(&made->scene, &made->pose, instance_count, rays, count);
        compare("instances", &made->scene, &made->pose, rays, count, 1, true);
        compare("instances", &made->scene, &made->pose, rays, count, 5, false);
        free(rays);
        trace_scenes_destroy(&made);
    }
}

/* From inside the closed sphere, to vertices, edges and anywhere: every ray hits, whole subgroups and
 * partial ones. */
static void closed_meshes_have_no_cracks(void **state)
{
    (void)state;
    struct error error;
    struct scene *scene = scene_create_builtin("sphere", &error);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_true(scene && pose);
    scene_pose_set_time(scene, pose, 0);
    struct trace_device *device = trace_device_create(gpu, scene, pose, false, &error);
    assert_non_null(device);
    uint32_t sphere = 0;
    while (scene->materials[scene->meshes[scene->instances[sphere].mesh].material].kind !=
           MATERIAL_DIELECTRIC)
        sphere++;
    const uint32_t count = 1u << 20;
    struct trace_ray_gpu *rays = calloc(count, sizeof *rays);
    struct trace_hit_gpu *hits = calloc(count, sizeof *hits);
    assert_true(rays && hits);
    trace_scenes_rays_inside(scene, pose, sphere, rays, count);
    for (uint32_t stride = 1; stride <= 16; stride *= 16) {
        struct trace_run run = {.rays = rays, .count = count, .stride = stride};
        assert_true(trace_device_run(device, &run, hits, NULL, &error));
        uint32_t cracks = 0;
        for (uint32_t i = 0; i < count; i += stride)
            cracks += hits[i].hit.y != sphere;
        assert_int_equal(cracks, 0);
    }
    free(rays);
    free(hits);
    trace_device_destroy(&device);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static void distances_beyond_the_limit_do_not_count(void **state)
{
    (void)state;
    struct trace_scene *made = trace_scenes_create(9);
    struct error error;
    struct trace_device *device = trace_device_create(gpu, &made->scene, &made->pose, false, &error);
    assert_non_null(device);
    enum { COUNT = 4096 };
    struct trace_ray_gpu *rays = calloc(COUNT, sizeof *rays);
    struct trace_hit_gpu *hits = calloc(COUNT, sizeof *hits), *limited = calloc(COUNT, sizeof *limited);
    assert_true(rays && hits && limited);
    trace_scenes_rays(&made->scene, &made->pose, 3, rays, COUNT);
    assert_true(
        trace_device_run(device, &(struct trace_run){.rays = rays, .count = COUNT}, hits, NULL, &error));
    /* lanes with limits just behind, at and before the hit, 0 and negative, side by side */
    for (uint32_t i = 0; i < COUNT; i++) {
        float t = is_miss(&hits[i]) ? 1 : hit_t(&hits[i]);
        const float limits[5] = {nextafterf(t, INFINITY), t, 0.5f * t, 0, -1};
        rays[i].origin_t_max.w = limits[i % 5];
    }
    for (uint32_t any = 0; any < 2; any++) {
        struct trace_run run = {.rays = rays, .count = COUNT, .any = any};
        assert_true(trace_device_run(device, &run, limited, NULL, &error));
        for (uint32_t i = 0; i < COUNT; i++) {
            assert_int_equal(limited[i].hit.w, 0);
            assert_int_equal(is_miss(&limited[i]), is_miss(&hits[i]) || i % 5 != 0);
        }
    }
    free(rays);
    free(hits);
    free(limited);
    trace_device_destroy(&device);
    trace_scenes_destroy(&made);
}

/* A node that is its own child: rays end, and say so. */
static void damaged_nodes_do_not_hang_the_device(void **state)
{
    (void)state;
    struct trace_scene *made = trace_scenes_create(9);
    struct error error;
    struct trace_device *device = trace_device_create(gpu, &made->scene, &made->pose, false, &error);
    assert_non_null(device);
    /* a grid that holds every ray, and both children as large as it */
    const float origin = -1e6f, scale = 32;
    uint32_t origin_bits, scale_bits, all = 0xffff0000u;
    memcpy(&origin_bits, &origin, sizeof origin);
    memcpy(&scale_bits, &scale, sizeof scale);
    struct bvh_header header = {
        {origin_bits, origin_bits, origin_bits}, {scale_bits, scale_bits, scale_bits}, 1, 0};
    struct bvh_node node = {all, all, all, all, all, all, 1, 1};
    assert_true(trace_device_write_nodes(device, 0, &header, sizeof header, &error));
    assert_true(trace_device_write_nodes(device, sizeof header, &node, sizeof node, &error));
    enum { COUNT = 64 };
    struct trace_ray_gpu rays[COUNT];
    struct trace_hit_gpu hits[COUNT];
    trace_scenes_rays(&made->scene, &made->pose, 1, rays, COUNT);
    for (uint32_t stride = 1; stride <= 3; stride += 2) {
        struct trace_run run = {.rays = rays, .count = COUNT, .stride = stride};
        assert_true(trace_device_run(device, &run, hits, NULL, &error));
        for (uint32_t i = 0; i < COUNT; i += stride) {
            assert_true(is_miss(&hits[i]));
            assert_int_equal(hits[i].hit.w, 1);
        }
    }
    trace_device_destroy(&device);
    trace_scenes_destroy(&made);
}

int main(void)
{
    struct error error;
    gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (!gpu)
        skip_program(error.message);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(builtin_scenes_match_the_reference),
        cmocka_unit_test(two_triangle_buffers_give_the_same_bits),
        cmocka_unit_test(many_transformed_instances_match_the_reference),
        cmocka_unit_test(closed_meshes_have_no_cracks),
        cmocka_unit_test(distances_beyond_the_limit_do_not_count),
        cmocka_unit_test(damaged_nodes_do_not_hang_the_device),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    gpu_destroy(&gpu);
    return failed;
}
