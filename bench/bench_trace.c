/* bench_trace.c: photon rays per second of the tracers, against Embree's rtcIntersect1 on the same rays.
 *
 * The rays are what photons are: 1 M from the scene's first light over the cap of directions that holds
 * the casters, in Morton order of emission, and their second segments, refracted or reflected at the
 * first hit. Every method runs in turn, several rounds, and the median of its rounds counts. Embree runs
 * on as many threads as this process may use, as lavapipe does, over the scene's triangles in world space
 * without instances.
 */
#define _GNU_SOURCE
#include <embree3/rtcore.h>

#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/gpu/gpu.h"
#include "core/scene/scene.h"
#include "core/scene/vec3.h"
#include "shaders/shared/bvh_layout.h"
#include "tests/support/trace_device.h"

#define GRID_BITS    10u
#define RAY_COUNT    (1u << (2 * GRID_BITS))
#define MAX_ROUNDS   101u
#define CHUNK        4096u
#define METHOD_COUNT 3u

enum method { METHOD_EMBREE, METHOD_BVH, METHOD_KHR };

static double seconds(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static _Noreturn void die(const struct error *error)
{
    fprintf(stderr, "bench-trace: %s\n", error->message);
    exit(1);
}

static void *allocate(size_t count, size_t size)
{
    void *memory = calloc(count ? count : 1, size);
    if (!memory) {
        fprintf(stderr, "bench-trace: out of memory\n");
        exit(1);
    }
    return memory;
}

/* ---- rays ------------------------------------------------------------------------------------------ */

static struct vec3 transform(const float m[12], const float p[3], double w)
{
    double x = (double)p[0], y = (double)p[1], z = (double)p[2];
    return vec3_make((double)m[0] * x + (double)m[1] * y + (double)m[2] * z + (double)m[3] * w,
                     (double)m[4] * x + (double)m[5] * y + (double)m[6] * z + (double)m[7] * w,
                     (double)m[8] * x + (double)m[9] * y + (double)m[10] * z + (double)m[11] * w);
}

/* The corners of every caster's box, 8 each. */
static uint32_t caster_corners(const struct scene *scene, const struct scene_pose *pose, struct vec3 *corners)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        if (scene->materials[mesh->material].kind == MATERIAL_DIFFUSE)
            continue;
        for (uint32_t k = 0; k < 8; k++) {
            const float p[3] = {k & 1 ? mesh->bounds_max[0] : mesh->bounds_min[0],
                                k & 2 ? mesh->bounds_max[1] : mesh->bounds_min[1],
                                k & 4 ? mesh->bounds_max[2] : mesh->bounds_min[2]};
            corners[count++] = transform(pose->instance_to_world[i], p, 1);
        }
    }
    return count;
}

static uint32_t compact_bits(uint32_t code)
{
    uint32_t value = 0;
    for (uint32_t b = 0; b < GRID_BITS; b++)
        value |= (code >> (2 * b) & 1) << b;
    return value;
}

static void set_ray(struct trace_ray_gpu *ray, struct vec3 origin, struct vec3 direction)
{
    *ray = (struct trace_ray_gpu){{(float)origin.x, (float)origin.y, (float)origin.z, BVH_FAR_T},
                                  {(float)direction.x, (float)direction.y, (float)direction.z, 0}};
}

/* Shirley and Chiu's concentric map of the square to the disk, then equal area to the cap, or the disk
 * itself across the beam of a directional light. */
static void emit(const struct scene *scene, const struct scene_pose *pose, struct trace_ray_gpu *rays)
{
    struct vec3 *corners = allocate(8 * scene->instance_count, sizeof *corners);
    uint32_t corner_count = caster_corners(scene, pose, corners);
    if (corner_count == 0 || scene->light_count == 0)
        die(&(struct error){STATUS_INVALID, "the scene needs a light and a caster"});
    struct vec3 center = {0};
    for (uint32_t i = 0; i < corner_count; i++)
        center = vec3_add(center, vec3_scale(corners[i], 1.0 / corner_count));

    bool is_beam = scene->lights[0].type == LIGHT_DIRECTIONAL;
    struct vec3 position = vec3_load(pose->lights[0].position);
    struct vec3 axis = is_beam ? vec3_load(pose->lights[0].direction)
                               : vec3_unit(vec3_sub(center, position), vec3_make(0, -1, 0));
    struct vec3 side = vec3_unit(
        vec3_cross(fabs(axis.x) < 0.5 ? vec3_make(1, 0, 0) : vec3_make(0, 1, 0), axis), vec3_make(1, 0, 0));
    struct vec3 up = vec3_cross(axis, side);
    double radius = 0, cosine = 1, depth = 0;
    for (uint32_t i = 0; i < corner_count; i++) {
        struct vec3 from_center = vec3_sub(corners[i], center);
        double along = vec3_dot(from_center, axis);
        radius = fmax(radius, vec3_length(vec3_sub(from_center, vec3_scale(axis, along))));
        depth = fmax(depth, -along);
        cosine = fmin(cosine, vec3_dot(vec3_unit(vec3_sub(corners[i], position), axis), axis));
    }
    free(corners);

    for (uint32_t code = 0; code < RAY_COUNT; code++) {
        double a = 2 * (compact_bits(code) + 0.5) / (1u << GRID_BITS) - 1;
        double b = 2 * (compact_bits(code >> 1) + 0.5) / (1u << GRID_BITS) - 1;
        bool wide = fabs(a) > fabs(b);
        double r = wide ? a : b;
        double angle = wide ? M_PI / 4 * (b / a) : M_PI / 2 - M_PI / 4 * (b == 0 ? 0 : a / b);
        struct vec3 across = vec3_add(vec3_scale(side, cos(angle)), vec3_scale(up, sin(angle)));
        if (is_beam) {
            struct vec3 start = vec3_sub(center, vec3_scale(axis, depth + 1));
            set_ray(&rays[code], vec3_add(start, vec3_scale(across, r * radius)), axis);
        } else {
            double z = 1 - (1 - cosine) * r * r;
            double sine = sqrt(fmax(0, 1 - z * z)) * (r < 0 ? -1 : 1);
            set_ray(&rays[code], position, vec3_add(vec3_scale(axis, z), vec3_scale(across, sine)));
        }
    }
}

/* Second segments of the rays that met a caster, in their order; returns how many. */
static uint32_t continue_rays(const struct scene *scene, const struct scene_pose *pose,
                              const struct trace_ray_gpu *rays, const struct trace_hit_gpu *hits,
                              struct trace_ray_gpu *next)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < RAY_COUNT; i++) {
        if (hits[i].hit.y == TRACE_DEVICE_MISS)
            continue;
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[hits[i].hit.y].mesh];
        const struct scene_material *material = &scene->materials[mesh->material];
        if (material->kind == MATERIAL_DIFFUSE)
            continue;
        struct vec3 p[3], n = {0};
        double weight[3] = {1 - (double)hits[i].barycentrics.x - (double)hits[i].barycentrics.y,
                            (double)hits[i].barycentrics.x, (double)hits[i].barycentrics.y};
        struct vec3 point = {0};
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t index = mesh->first_vertex + scene->indices[mesh->first_index + 3 * hits[i].hit.z + k];
            p[k] = transform(pose->instance_to_world[hits[i].hit.y], scene->vertices[index].position, 1);
            n = vec3_add(n, vec3_scale(transform(pose->instance_to_world[hits[i].hit.y],
                                                 scene->vertices[index].normal, 0),
                                       weight[k]));
            point = vec3_add(point, vec3_scale(p[k], weight[k]));
        }
        struct vec3 d =
            vec3_make((double)rays[i].direction.x, (double)rays[i].direction.y, (double)rays[i].direction.z);
        n = vec3_unit(n, vec3_make(0, 1, 0));
        double cosine = -vec3_dot(n, d);
        double eta = cosine > 0 ? 1 / (double)material->ior : (double)material->ior;
        if (cosine < 0) {
            n = vec3_scale(n, -1);
            cosine = -cosine;
        }
        double k = 1 - eta * eta * (1 - cosine * cosine);
        bool goes_through = material->kind != MATERIAL_MIRROR && k > 0;
        if (material->kind == MATERIAL_THIN)
            eta = 1, k = cosine * cosine;
        struct vec3 turned = goes_through
                                 ? vec3_add(vec3_scale(d, eta), vec3_scale(n, eta * cosine - sqrt(k)))
                                 : vec3_add(d, vec3_scale(n, 2 * cosine));
        set_ray(&next[count++], vec3_add(point, vec3_scale(n, goes_through ? -1e-4 : 1e-4)), turned);
    }
    return count;
}

/* ---- Embree ---------------------------------------------------------------------------------------- */

struct embree {
    RTCDevice device;
    RTCScene scene;
    uint32_t thread_count;
};

struct embree_job {
    RTCScene scene;
    const struct trace_ray_gpu *rays;
    struct trace_hit_gpu *hits;
    uint32_t count;
    atomic_uint next;
};

static void embree_create(struct embree *embree, const struct scene *scene, const struct scene_pose *pose)
{
    cpu_set_t set;
    embree->thread_count = sched_getaffinity(0, sizeof set, &set) == 0 ? (uint32_t)CPU_COUNT(&set) : 1;
    embree->device = rtcNewDevice(NULL);
    embree->scene = rtcNewScene(embree->device);
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        RTCGeometry geometry = rtcNewGeometry(embree->device, RTC_GEOMETRY_TYPE_TRIANGLE);
        float *positions = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                                   mesh->vertex_count);
        uint32_t *indices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                                    mesh->triangle_count);
        for (uint32_t v = 0; v < mesh->vertex_count; v++)
            vec3_store(positions + 3 * v, transform(pose->instance_to_world[i],
                                                    scene->vertices[mesh->first_vertex + v].position, 1));
        memcpy(indices, scene->indices + mesh->first_index, 12 * (size_t)mesh->triangle_count);
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(embree->scene, geometry, i);
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(embree->scene);
}

static void *embree_thread(void *argument)
{
    struct embree_job *job = argument;
    for (uint32_t first; (first = atomic_fetch_add(&job->next, CHUNK)) < job->count;) {
        uint32_t last = first + CHUNK < job->count ? first + CHUNK : job->count;
        for (uint32_t i = first; i < last; i++) {
            const struct trace_ray_gpu *ray = &job->rays[i];
            struct RTCIntersectContext context;
            rtcInitIntersectContext(&context);
            struct RTCRayHit query = {
                .ray = {.org_x = ray->origin_t_max.x,
                        .org_y = ray->origin_t_max.y,
                        .org_z = ray->origin_t_max.z,
                        .dir_x = ray->direction.x,
                        .dir_y = ray->direction.y,
                        .dir_z = ray->direction.z,
                        .tfar = ray->origin_t_max.w,
                        .mask = UINT32_MAX},
                .hit = {.geomID = RTC_INVALID_GEOMETRY_ID, .primID = RTC_INVALID_GEOMETRY_ID}};
            rtcIntersect1(job->scene, &context, &query);
            struct trace_hit_gpu *hit = &job->hits[i];
            memcpy(&hit->hit.x, &query.ray.tfar, sizeof query.ray.tfar);
            hit->hit.y = query.hit.geomID;
            hit->hit.z = query.hit.primID;
            hit->barycentrics.x = query.hit.u;
            hit->barycentrics.y = query.hit.v;
        }
    }
    return NULL;
}

static double embree_run(const struct embree *embree, const struct trace_ray_gpu *rays, uint32_t count,
                         struct trace_hit_gpu *hits)
{
    struct embree_job job = {.scene = embree->scene, .rays = rays, .hits = hits, .count = count};
    pthread_t threads[256];
    uint32_t thread_count = embree->thread_count < 256 ? embree->thread_count : 256;
    double start = seconds();
    for (uint32_t i = 1; i < thread_count; i++)
        pthread_create(&threads[i], NULL, embree_thread, &job);
    embree_thread(&job);
    for (uint32_t i = 1; i < thread_count; i++)
        pthread_join(threads[i], NULL);
    return seconds() - start;
}

/* ---- table ----------------------------------------------------------------------------------------- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *values, uint32_t count)
{
    qsort(values, count, sizeof *values, compare_doubles);
    return values[count / 2];
}

/* Rays whose hit differs: hit or missed, or more than 0.1 % of the distance apart. */
static uint32_t disagreements(const struct trace_hit_gpu *a, const struct trace_hit_gpu *b, uint32_t count)
{
    uint32_t differing = 0;
    for (uint32_t i = 0; i < count; i++) {
        float ta, tb;
        memcpy(&ta, &a[i].hit.x, sizeof ta);
        memcpy(&tb, &b[i].hit.x, sizeof tb);
        bool missed_a = a[i].hit.y == TRACE_DEVICE_MISS, missed_b = b[i].hit.y == TRACE_DEVICE_MISS;
        differing += missed_a != missed_b || (!missed_a && fabsf(ta - tb) > 1e-3f * fmaxf(ta, tb));
    }
    return differing;
}

static void bench(struct gpu *gpu, const char *name, uint32_t rounds)
{
    struct error error;
    struct scene *scene = scene_open(name, &error);
    struct scene_pose *pose = scene ? scene_pose_create(scene, &error) : NULL;
    if (!pose)
        die(&error);
    scene_pose_set_time(scene, pose, 0);
    struct embree embree;
    embree_create(&embree, scene, pose);
    struct trace_device *devices[METHOD_COUNT] = {NULL};
    devices[METHOD_BVH] = trace_device_create(gpu, scene, pose, false, &error);
    if (!devices[METHOD_BVH])
        die(&error);
    if (gpu_info(gpu)->has_ray_query) {
        devices[METHOD_KHR] = trace_device_create(gpu, scene, pose, true, &error);
        if (!devices[METHOD_KHR])
            die(&error);
    }

    struct trace_ray_gpu *rays[2] = {allocate(RAY_COUNT, sizeof *rays[0]),
                                     allocate(RAY_COUNT, sizeof *rays[1])};
    uint32_t counts[2] = {RAY_COUNT, 0};
    struct trace_hit_gpu *hits[METHOD_COUNT];
    for (uint32_t m = 0; m < METHOD_COUNT; m++)
        hits[m] = allocate(RAY_COUNT, sizeof *hits[m]);
    emit(scene, pose, rays[0]);
    embree_run(&embree, rays[0], RAY_COUNT, hits[METHOD_EMBREE]);
    counts[1] = continue_rays(scene, pose, rays[0], hits[METHOD_EMBREE], rays[1]);

    static const char *method_names[METHOD_COUNT] = {"embree", "bvh", "khr"};
    double rates[METHOD_COUNT][3][MAX_ROUNDS]; /* first segments, second, both; Mray/s */
    uint32_t differing[METHOD_COUNT] = {0};
    for (uint32_t round = 0; round < rounds + 1; round++) /* the first, which compiles, does not count */
        for (uint32_t m = 0; m < METHOD_COUNT; m++) {
            if (m != METHOD_EMBREE && !devices[m])
                continue;
            double elapsed[2] = {0};
            for (uint32_t segment = 0; segment < 2 && counts[segment]; segment++) {
                uint64_t elapsed_ns = 0;
                if (m == METHOD_EMBREE)
                    elapsed[segment] = embree_run(&embree, rays[segment], counts[segment], hits[m]);
                else if (!trace_device_run(devices[m],
                                           &(struct trace_run){.rays = rays[segment],
                                                               .count = counts[segment],
                                                               .all_lanes = true},
                                           hits[m], &elapsed_ns, &error))
                    die(&error);
                else
                    elapsed[segment] = 1e-9 * (double)elapsed_ns;
                if (round == 0 && m != METHOD_EMBREE) {
                    embree_run(&embree, rays[segment], counts[segment], hits[METHOD_EMBREE]);
                    differing[m] += disagreements(hits[m], hits[METHOD_EMBREE], counts[segment]);
                }
            }
            if (round == 0)
                continue;
            rates[m][0][round - 1] = 1e-6 * counts[0] / elapsed[0];
            rates[m][1][round - 1] = counts[1] ? 1e-6 * counts[1] / elapsed[1] : 0;
            rates[m][2][round - 1] = 1e-6 * (counts[0] + counts[1]) / (elapsed[0] + elapsed[1]);
        }

    double reference = median(rates[METHOD_EMBREE][2], rounds);
    for (uint32_t m = 0; m < METHOD_COUNT; m++) {
        if (m != METHOD_EMBREE && !devices[m])
            continue;
        double both = median(rates[m][2], rounds);
        printf("%-10s %10u  %-7s %8.2f %8.2f %8.2f   %6.2f   %7u\n", name, scene->triangle_count,
               method_names[m], median(rates[m][0], rounds), median(rates[m][1], rounds), both,
               both / reference, differing[m]);
        fflush(stdout);
    }

    for (uint32_t m = 0; m < METHOD_COUNT; m++) {
        trace_device_destroy(&devices[m]);
        free(hits[m]);
    }
    free(rays[0]);
    free(rays[1]);
    rtcReleaseScene(embree.scene);
    rtcReleaseDevice(embree.device);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static const char usage[] = "usage: bench-trace [--device NAME] [--rounds N] [SCENE...]\n"
                            "Photon rays per second (millions) of each tracer and of Embree's "
                            "rtcIntersect1 on as many threads as "
                            "this\n"
                            "process may use: medians of N alternating rounds (9), 1 M rays and their "
                            "second segments.\n"
                            "SCENE is a built-in scene or a glTF file; sphere and pool when none is "
                            "given.\n";

int main(int argc, char **argv)
{
    struct gpu_params params = {0};
    uint32_t rounds = 9;
    int first = 1;
    for (; first + 1 < argc && strncmp(argv[first], "--", 2) == 0; first += 2) {
        if (strcmp(argv[first], "--device") == 0) {
            params.device = argv[first + 1];
        } else if (strcmp(argv[first], "--rounds") == 0) {
            rounds = (uint32_t)strtoul(argv[first + 1], NULL, 10);
        } else {
            break;
        }
    }
    if (rounds < 1 || rounds > MAX_ROUNDS || (first < argc && argv[first][0] == '-')) {
        fputs(usage, first < argc && strcmp(argv[first], "--help") == 0 ? stdout : stderr);
        return first < argc && strcmp(argv[first], "--help") == 0 ? 0 : 2;
    }
    struct error error;
    struct gpu *gpu = gpu_create(&params, &error);
    if (!gpu)
        die(&error);
    printf("%s, %s\n", gpu_info(gpu)->name, gpu_info(gpu)->driver);
    printf("%-10s %10s  %-7s %8s %8s %8s   %6s   %7s\n", "scene", "triangles", "tracer", "first", "second",
           "both", "ratio", "differ");
    if (first == argc) {
        bench(gpu, "sphere", rounds);
        bench(gpu, "pool", rounds);
    }
    for (int i = first; i < argc; i++)
        bench(gpu, argv[i], rounds);
    gpu_destroy(&gpu);
    return 0;
}
