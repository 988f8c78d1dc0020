#include "trace_scenes.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "shaders/shared/bvh_layout.h"

static uint64_t random_state;

static uint32_t random_bits(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 33);
}

/* In [-1, 1). */
static float random_unit(void)
{
    return (float)random_bits() / 1073741824.0f - 1.0f;
}

static void *allocate(size_t count, size_t size)
{
    void *memory = calloc(count ? count : 1, size);
    if (!memory)
        abort();
    return memory;
}

/* ---- scenes ------------------------------------------------------------------------------------------- */

enum { GRID = 24, LOOSE = 300 };

/* A random turn times uneven scale, mirrored every third time, then a move within `spread`. */
static void random_transform(float m[12], float spread)
{
    double q[4], length = 0;
    for (int k = 0; k < 4; k++) {
        q[k] = (double)random_unit();
        length += q[k] * q[k];
    }
    for (int k = 0; k < 4; k++)
        q[k] /= sqrt(length) + 1e-9;
    double x = q[0], y = q[1], z = q[2], w = q[3];
    const double turn[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                               {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                               {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
    double scale[3];
    for (int k = 0; k < 3; k++)
        scale[k] = 0.6 + 0.4 * (double)random_unit();
    if (random_bits() % 3 == 0)
        scale[0] = -scale[0];
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            m[4 * r + k] = (float)(turn[r][k] * scale[k]);
        m[4 * r + 3] = spread * random_unit();
    }
}

struct trace_scene *trace_scenes_create(uint32_t instance_count)
{
    struct trace_scene *made = allocate(1, sizeof *made);
    struct scene *scene = &made->scene;
    random_state = instance_count;
    const uint32_t grid_vertices = (GRID + 1) * (GRID + 1), grid_triangles = 2 * GRID * GRID;
    scene->vertex_count = grid_vertices + 3 * LOOSE + 3;
    scene->index_count = 3 * (grid_triangles + LOOSE + 1);
    scene->mesh_count = 3;
    scene->instance_count = instance_count;
    scene->vertices = allocate(scene->vertex_count, sizeof *scene->vertices);
    scene->indices = allocate(scene->index_count, sizeof *scene->indices);
    scene->meshes = allocate(scene->mesh_count, sizeof *scene->meshes);
    scene->instances = allocate(instance_count, sizeof *scene->instances);
    made->pose.instance_to_world = allocate(instance_count, sizeof *made->pose.instance_to_world);

    struct scene_mesh *mesh = scene->meshes;
    mesh[0] = (struct scene_mesh){.vertex_count = grid_vertices, .triangle_count = grid_triangles};
    mesh[1] = (struct scene_mesh){.first_vertex = grid_vertices,
                                  .vertex_count = 3 * LOOSE,
                                  .first_index = 3 * grid_triangles,
                                  .triangle_count = LOOSE};
    mesh[2] = (struct scene_mesh){.first_vertex = grid_vertices + 3 * LOOSE,
                                  .vertex_count = 3,
                                  .first_index = 3 * (grid_triangles + LOOSE),
                                  .triangle_count = 1};
    for (uint32_t j = 0; j <= GRID; j++)
        for (uint32_t i = 0; i <= GRID; i++) {
            float *p = scene->vertices[j * (GRID + 1) + i].position;
            p[0] = 2 * (float)i / GRID - 1;
            p[1] = 0.1f * random_unit();
            p[2] = 2 * (float)j / GRID - 1;
        }
    uint32_t *index = scene->indices;
    for (uint32_t j = 0; j < GRID; j++)
        for (uint32_t i = 0; i < GRID; i++) {
            uint32_t a = j * (GRID + 1) + i;
            const uint32_t corners[6] = {a, a + 1, a + GRID + 2, a, a + GRID + 2, a + GRID + 1};
            memcpy(index, corners, sizeof corners);
            index += 6;
        }
    for (uint32_t i = 0; i <= LOOSE; i++) {
        float center[3];
        for (int a = 0; a < 3; a++)
            center[a] = i < LOOSE ? random_unit() : 0;
        for (uint32_t k = 0; k < 3; k++) {
            for (int a = 0; a < 3; a++)
                scene->vertices[mesh[1].first_vertex + 3 * i + k].position[a] =
                    center[a] + (i < LOOSE ? 0.15f : 1) * random_unit();
            *index++ = i < LOOSE ? 3 * i + k : k;
        }
    }
    float spread = 1.2f * cbrtf((float)instance_count);
    for (uint32_t i = 0; i < instance_count; i++) {
        scene->instances[i].mesh = i % 3;
        random_transform(made->pose.instance_to_world[i], spread);
    }
    return made;
}

void trace_scenes_destroy(struct trace_scene **made)
{
    if (!*made)
        return;
    free((*made)->scene.vertices);
    free((*made)->scene.indices);
    free((*made)->scene.meshes);
    free((*made)->scene.instances);
    free((*made)->pose.instance_to_world);
    free(*made);
    *made = NULL;
}

/* ---- rays --------------------------------------------------------------------------------------------- */

static void world_vertex(const struct scene *scene, const struct scene_pose *pose, uint32_t instance,
                         uint32_t corner, float p[3])
{
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[instance].mesh];
    const float *v =
        scene->vertices[mesh->first_vertex + scene->indices[mesh->first_index + corner]].position;
    const float *m = pose->instance_to_world[instance];
    for (int r = 0; r < 3; r++)
        p[r] = m[4 * r] * v[0] + m[4 * r + 1] * v[1] + m[4 * r + 2] * v[2] + m[4 * r + 3];
}

/* A point of a random triangle of the instance: `kind` 0 a vertex, 1 on an edge, else within. */
static void triangle_point(const struct scene *scene, const struct scene_pose *pose, uint32_t instance,
                           uint32_t kind, float point[3])
{
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[instance].mesh];
    uint32_t triangle = random_bits() % mesh->triangle_count;
    float p[3][3], b = 0.5f + 0.5f * random_unit(), c = 0.5f + 0.5f * random_unit();
    if (b + c > 1) {
        b = 1 - b;
        c = 1 - c;
    }
    if (kind < 2)
        c = 0;
    if (kind < 1)
        b = 0;
    for (uint32_t k = 0; k < 3; k++)
        world_vertex(scene, pose, instance, 3 * triangle + k, p[k]);
    for (int a = 0; a < 3; a++)
        point[a] = p[0][a] + b * (p[1][a] - p[0][a]) + c * (p[2][a] - p[0][a]);
}

static void set_ray(struct trace_ray_gpu *ray, const float o[3], const float d[3])
{
    *ray = (struct trace_ray_gpu){{o[0], o[1], o[2], BVH_FAR_T}, {d[0], d[1], d[2], 0}};
}

void trace_scenes_rays(const struct scene *scene, const struct scene_pose *pose, uint32_t seed,
                       struct trace_ray_gpu *rays, uint32_t count)
{
    random_state = seed;
    float low[3] = {-1, -1, -1}, high[3] = {1, 1, 1};
    for (uint32_t i = 0; i < 64 * scene->instance_count; i++) {
        float p[3];
        triangle_point(scene, pose, i % scene->instance_count, 0, p);
        for (int a = 0; a < 3; a++) {
            low[a] = i ? fminf(low[a], p[a]) : p[a];
            high[a] = i ? fmaxf(high[a], p[a]) : p[a];
        }
    }
    for (uint32_t i = 0; i < count; i++) {
        float o[3], d[3], target[3];
        for (int a = 0; a < 3; a++) {
            float size = high[a] - low[a] + 0.1f;
            o[a] = 0.5f * (low[a] + high[a]) + size * random_unit();
            target[a] = 0.5f * (low[a] + high[a]) + 0.5f * size * random_unit();
        }
        if (scene->instance_count && i % 4)
            triangle_point(scene, pose, random_bits() % scene->instance_count, 2, target);
        float length = i % 3 ? 1 : ldexpf(1, (int)(random_bits() % 16) - 8);
        for (int a = 0; a < 3; a++)
            d[a] = length * (target[a] - o[a]);
        if (i % 8 == 7) {
            /* along an axis, toward the target's place in the other two */
            int axis = (int)(random_bits() % 3);
            for (int a = 0; a < 3; a++) {
                o[a] = a == axis ? o[a] : target[a];
                d[a] = a == axis ? (target[a] < o[a] ? -length : length) : random_bits() % 2 ? 0.0f : -0.0f;
            }
        }
        set_ray(&rays[i], o, d);
    }
}

void trace_scenes_rays_inside(const struct scene *scene, const struct scene_pose *pose, uint32_t instance,
                              struct trace_ray_gpu *rays, uint32_t count)
{
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[instance].mesh];
    const float *m = pose->instance_to_world[instance];
    random_state = 1;
    for (uint32_t i = 0; i < count; i++) {
        float o[3], d[3], local[3], target[3];
        for (int a = 0; a < 3; a++)
            local[a] = 0.5f * (mesh->bounds_min[a] + mesh->bounds_max[a]) +
                       0.2f * (mesh->bounds_max[a] - mesh->bounds_min[a]) * random_unit();
        for (int r = 0; r < 3; r++)
            o[r] = m[4 * r] * local[0] + m[4 * r + 1] * local[1] + m[4 * r + 2] * local[2] + m[4 * r + 3];
        triangle_point(scene, pose, instance, i % 3, target);
        for (int a = 0; a < 3; a++)
            d[a] = i % 3 == 2 ? random_unit() : target[a] - o[a];
        set_ray(&rays[i], o, d);
    }
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

/* A ray and the world corners of the triangle it hit, in double; `size` is the largest coordinate. */
struct exact {
    double o[3], d[3], p[3][3], size;
};

static struct exact exact_hit(const struct scene *scene, const struct scene_pose *pose,
                              const struct trace_ray_gpu *ray, const struct trace_hit_gpu *hit)
{
    struct exact x = {
        .o = {(double)ray->origin_t_max.x, (double)ray->origin_t_max.y, (double)ray->origin_t_max.z},
        .d = {(double)ray->direction.x, (double)ray->direction.y, (double)ray->direction.z},
    };
    const float *m = pose->instance_to_world[hit->hit.y];
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[hit->hit.y].mesh];
    x.size = fmax(fabs(x.o[0]), fmax(fabs(x.o[1]), fabs(x.o[2])));
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t index = scene->indices[mesh->first_index + 3 * hit->hit.z + k];
        const float *v = scene->vertices[mesh->first_vertex + index].position;
        for (int r = 0; r < 3; r++) {
            x.p[k][r] = (double)m[4 * r] * (double)v[0] + (double)m[4 * r + 1] * (double)v[1] +
                        (double)m[4 * r + 2] * (double)v[2] + (double)m[4 * r + 3];
            x.size = fmax(x.size, fabs(x.p[k][r]));
        }
    }
    return x;
}

double trace_scenes_hit_error(const struct scene *scene, const struct scene_pose *pose,
                              const struct trace_ray_gpu *ray, const struct trace_hit_gpu *hit)
{
    struct exact x = exact_hit(scene, pose, ray, hit);
    float t;
    memcpy(&t, &hit->hit.x, sizeof t);
    const double weight[3] = {1 - (double)hit->barycentrics.x - (double)hit->barycentrics.y,
                              (double)hit->barycentrics.x, (double)hit->barycentrics.y};
    double e1[3], e2[3], normal[3], above[3], from_origin[3], across[3];
    for (int a = 0; a < 3; a++) {
        e1[a] = x.p[1][a] - x.p[0][a];
        e2[a] = x.p[2][a] - x.p[0][a];
        above[a] = x.o[a] + (double)t * x.d[a] - x.p[0][a];
        from_origin[a] = weight[0] * x.p[0][a] + weight[1] * x.p[1][a] + weight[2] * x.p[2][a] - x.o[a];
    }
    cross(e1, e2, normal);
    cross(from_origin, x.d, across);
    double off_plane = fabs(dot(above, normal)) / sqrt(dot(normal, normal));
    double off_ray = sqrt(dot(across, across) / dot(x.d, x.d));
    return fmax(off_plane, off_ray) / x.size;
}

double trace_scenes_border(const struct scene *scene, const struct scene_pose *pose,
                           const struct trace_ray_gpu *ray, const struct trace_hit_gpu *hit)
{
    struct exact x = exact_hit(scene, pose, ray, hit);
    double nearest = INFINITY;
    for (int k = 0; k < 3; k++) {
        double edge[3], to_corner[3], common[3];
        for (int a = 0; a < 3; a++) {
            edge[a] = x.p[(k + 1) % 3][a] - x.p[k][a];
            to_corner[a] = x.p[k][a] - x.o[a];
        }
        cross(x.d, edge, common);
        double length = sqrt(dot(common, common));
        nearest = fmin(nearest, length > 0 ? fabs(dot(to_corner, common)) / length : 0);
    }
    return nearest / x.size;
}
