/* The bvh and khr tracers see the same scene. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/gpu/gpu.h"
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

/* A driver's own triangle test rounds differently, so at borders of triangles a ray may go to the neighbour,
 * or between: ray queries promise no more. Everywhere else both must name the same triangle, and the place of
 * each hit must be true. */
static void compare(const char *name, const struct scene *scene, const struct scene_pose *pose, uint32_t seed)
{
    enum { COUNT = 20000 };
    struct error error;
    struct trace_device *devices[2];
    struct trace_hit_gpu *hits[2], *any[2];
    struct trace_ray_gpu *rays = calloc(COUNT, sizeof *rays);
    assert_non_null(rays);
    trace_scenes_rays(scene, pose, seed, rays, COUNT);
    for (uint32_t k = 0; k < 2; k++) {
        devices[k] = trace_device_create(gpu, scene, pose, k == 1, &error);
        if (!devices[k])
            fail_msg("%s: %s", name, error.message);
        hits[k] = calloc(COUNT, sizeof *hits[k]);
        any[k] = calloc(COUNT, sizeof *any[k]);
        assert_true(hits[k] && any[k]);
        assert_true(trace_device_run(devices[k], &(struct trace_run){.rays = rays, .count = COUNT}, hits[k],
                                     NULL, &error));
        assert_true(trace_device_run(devices[k],
                                     &(struct trace_run){.rays = rays, .count = COUNT, .any = true}, any[k],
                                     NULL, &error));
    }
    uint32_t hit_count = 0, touching_count = 0, border_count = 0;
    double largest_error[2] = {0};
    for (uint32_t i = 0; i < COUNT; i++) {
        const struct trace_hit_gpu *a = &hits[0][i], *b = &hits[1][i];
        bool miss_a = a->hit.y == TRACE_DEVICE_MISS, miss_b = b->hit.y == TRACE_DEVICE_MISS;
        assert_int_equal(any[0][i].hit.y == TRACE_DEVICE_MISS, miss_a);
        assert_int_equal(any[1][i].hit.y == TRACE_DEVICE_MISS, miss_b);
        if (miss_a && miss_b)
            continue;
        hit_count++;
        for (uint32_t k = 0; k < 2; k++)
            if (hits[k][i].hit.y != TRACE_DEVICE_MISS) {
                double off = trace_scenes_hit_error(scene, pose, &rays[i], &hits[k][i]);
                largest_error[k] = fmax(largest_error[k], off);
                if (!(off < 1e-5))
                    fail_msg("%s: ray %u: %s's hit is off by %g of the scene's size", name, i,
                             k ? "khr" : "bvh", off);
            }
        if (a->hit.y == b->hit.y && a->hit.z == b->hit.z)
            continue;
        bool is_near = !miss_a && !miss_b && fabsf(hit_t(a) - hit_t(b)) <= 1e-4f * hit_t(a);
        if (is_near) {
            touching_count++; /* surfaces in one place, or a common edge: either is right */
            continue;
        }
        /* rays along an axis, within the plane of a wall, meet other walls exactly at their rims */
        border_count += rays[i].direction.x != 0 && rays[i].direction.y != 0 && rays[i].direction.z != 0;
        double margin = miss_a ? INFINITY : trace_scenes_border(scene, pose, &rays[i], a);
        margin = miss_b ? margin : fmin(margin, trace_scenes_border(scene, pose, &rays[i], b));
        if (!(margin < 1e-5))
            fail_msg("%s: ray %u, %g from an edge: bvh has instance %u triangle %u t %.9g, khr instance %u "
                     "triangle %u t %.9g",
                     name, i, margin, a->hit.y, a->hit.z, (double)hit_t(a), b->hit.y, b->hit.z,
                     (double)hit_t(b));
    }
    print_message("%s: %u rays, %u hits, %u on touching triangles, %u lost at borders, off by %.1g (bvh) and "
                  "%.1g (khr)\n",
                  name, COUNT, hit_count, touching_count, border_count, largest_error[0], largest_error[1]);
    assert_true(border_count <= COUNT / 1000);
    if (scene->instance_count)
        assert_true(hit_count > COUNT / 50);
    for (uint32_t k = 0; k < 2; k++) {
        free(hits[k]);
        free(any[k]);
        trace_device_destroy(&devices[k]);
    }
    free(rays);
}

static void builtin_scenes_agree(void **state)
{
    (void)state;
    static const char *const names[] = {"sphere", "ring", "square", "cornell", "cube", "prism"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        struct error error;
        struct scene *scene = scene_create_builtin(names[i], &error);
        assert_non_null(scene);
        struct scene_pose *pose = scene_pose_create(scene, &error);
        assert_non_null(pose);
        scene_pose_set_time(scene, pose, 0);
        compare(names[i], scene, pose, (uint32_t)i + 1);
        scene_pose_destroy(&pose);
        scene_destroy(&scene);
    }
}

static void transformed_instances_agree(void **state)
{
    (void)state;
    for (uint32_t instance_count = 1; instance_count <= 729; instance_count *= 27) {
        struct trace_scene *made = trace_scenes_create(instance_count);
        compare("instances", &made->scene, &made->pose, instance_count);
        trace_scenes_destroy(&made);
    }
}

int main(void)
{
    struct error error;
    gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (!gpu)
        skip_program(error.message);
    if (!gpu_info(gpu)->has_ray_query) {
        char reason[512];
        snprintf(reason, sizeof reason, "%s (%s) has no ray queries", gpu_info(gpu)->name,
                 gpu_info(gpu)->driver);
        gpu_destroy(&gpu);
        skip_program(reason);
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(builtin_scenes_agree),
        cmocka_unit_test(transformed_instances_agree),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    gpu_destroy(&gpu);
    return failed;
}
