#include "solids.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "extent.h"
#include "vec3.h"

/* Pairs of instances looked at; with more, solids count as nested and touching, which only costs time. */
#define MAX_PAIRS (1u << 22)
/* Triangles of a pair that are looked at for contact, spread evenly over those that lie in the other's box.
 */
#define MAX_SAMPLES 4096u

static const struct scene_material *material_of(const struct scene *scene, uint32_t instance)
{
    return &scene->materials[scene->meshes[scene->instances[instance].mesh].material];
}

static bool is_solid(const struct scene *scene, uint32_t instance)
{
    return material_of(scene, instance)->kind == MATERIAL_DIELECTRIC;
}

/* ---- transforms ---------------------------------------------------------------------------------------- */

static struct vec3 to_world(const float m[12], struct vec3 p, double w)
{
    double out[3];
    for (int row = 0; row < 3; row++)
        out[row] = (double)m[4 * row] * p.x + (double)m[4 * row + 1] * p.y + (double)m[4 * row + 2] * p.z +
                   w * (double)m[4 * row + 3];
    return vec3_make(out[0], out[1], out[2]);
}

/* By Cramer's rule; false for a transform without volume. */
static bool to_object(const float m[12], struct vec3 p, double w, float out[3])
{
    struct vec3 column[3],
        rest = vec3_make(p.x - w * (double)m[3], p.y - w * (double)m[7], p.z - w * (double)m[11]);
    for (int k = 0; k < 3; k++)
        column[k] = vec3_make((double)m[k], (double)m[4 + k], (double)m[8 + k]);
    double volume = vec3_dot(column[0], vec3_cross(column[1], column[2]));
    if (!(fabs(volume) > 0))
        return false;
    vec3_store(out, vec3_scale(vec3_make(vec3_dot(rest, vec3_cross(column[1], column[2])),
                                         vec3_dot(column[0], vec3_cross(rest, column[2])),
                                         vec3_dot(column[0], vec3_cross(column[1], rest))),
                               1 / volume));
    return true;
}

struct box {
    double min[3], max[3];
};

static struct box box_of(const struct solids *solids, const struct scene *scene,
                         const struct scene_pose *pose, uint32_t instance)
{
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[instance].mesh];
    struct box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (int corner = 0; corner < 8; corner++) {
        float place[3];
        for (int k = 0; k < 3; k++)
            place[k] = corner >> k & 1 ? mesh->bounds_max[k] : mesh->bounds_min[k];
        struct vec3 world = to_world(pose->instance_to_world[instance], vec3_load(place), 1);
        const double p[3] = {world.x, world.y, world.z};
        for (int k = 0; k < 3; k++) {
            double slack = EXTENT_STEP * fabs(p[k]) + solids->step_min;
            box.min[k] = fmin(box.min[k], p[k] - slack);
            box.max[k] = fmax(box.max[k], p[k] + slack);
        }
    }
    return box;
}

static bool boxes_meet(const struct box *a, const struct box *b)
{
    for (int k = 0; k < 3; k++)
        if (a->min[k] > b->max[k] || b->min[k] > a->max[k])
            return false;
    return true;
}

static bool box_holds(const struct box *box, struct vec3 p)
{
    return p.x >= box->min[0] && p.x <= box->max[0] && p.y >= box->min[1] && p.y <= box->max[1] &&
           p.z >= box->min[2] && p.z <= box->max[2];
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

struct rank {
    uint32_t material;
    double volume; /* mean of its instances' boxes */
};

static int smaller_first(const void *left, const void *right)
{
    const struct rank *a = left, *b = right;
    if (a->volume != b->volume)
        return a->volume < b->volume ? -1 : 1;
    return a->material < b->material ? -1 : 1;
}

static bool number_solids(struct solids *solids, const struct scene *scene, const struct box *boxes)
{
    struct rank *ranks = calloc((size_t)scene->material_count + 1, sizeof *ranks);
    uint32_t *uses = calloc((size_t)scene->material_count + 1, sizeof *uses);
    solids->number = calloc((size_t)scene->material_count + 1, sizeof *solids->number);
    solids->material = calloc((size_t)scene->material_count + 1, sizeof *solids->material);
    bool ok = ranks && uses && solids->number && solids->material;
    for (uint32_t i = 0; ok && i < scene->instance_count; i++) {
        if (!is_solid(scene, i))
            continue;
        uint32_t material = scene->meshes[scene->instances[i].mesh].material;
        double volume = 1;
        for (int k = 0; k < 3; k++)
            volume *= boxes[i].max[k] - boxes[i].min[k];
        ranks[material].volume += volume;
        uses[material]++;
    }
    uint32_t count = 0;
    for (uint32_t i = 0; ok && i < scene->material_count; i++)
        if (uses[i])
            ranks[count++] = (struct rank){i, ranks[i].volume / uses[i]};
    if (ok) {
        qsort(ranks, count, sizeof *ranks, smaller_first);
        solids->count = count < SOLIDS_MAX ? count : SOLIDS_MAX;
    }
    for (uint32_t i = 0; ok && i < solids->count; i++) {
        solids->number[ranks[i].material] = (uint8_t)(i + 1);
        solids->material[i] = ranks[i].material;
    }
    free(ranks);
    free(uses);
    return ok;
}

/* ---- contact ------------------------------------------------------------------------------------------- */

/* Whether triangles of instance `a` lie in the surface of `b`, whose tree is given. */
static bool touches(const struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                    uint32_t a, uint32_t b, const struct box *box_b, const struct bvh *tree_b)
{
    const struct scene_mesh *mesh = &scene->meshes[scene->instances[a].mesh];
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    const uint32_t *indices = scene->indices + mesh->first_index;
    const float *world_a = pose->instance_to_world[a], *world_b = pose->instance_to_world[b];
    uint32_t inside = 0, stride = 1;
    for (int pass = 0; pass < 2; pass++) { /* count first, then look at every stride-th */
        uint32_t found = 0;
        for (uint32_t i = 0; i < mesh->triangle_count; i++) {
            struct vec3 corner[3];
            for (uint32_t k = 0; k < 3; k++)
                corner[k] = to_world(world_a, vec3_load(vertices[indices[3 * i + k]].position), 1);
            struct vec3 middle = vec3_scale(vec3_add(corner[0], vec3_add(corner[1], corner[2])), 1.0 / 3);
            if (!box_holds(box_b, middle) || found++ % stride != 0 || pass == 0)
                continue;
            struct vec3 none = {0},
                        normal = vec3_unit(
                            vec3_cross(vec3_sub(corner[1], corner[0]), vec3_sub(corner[2], corner[0])), none);
            float origin[3], direction[3], t, u, v;
            uint32_t triangle;
            double largest = fmax(fabs(middle.x), fmax(fabs(middle.y), fabs(middle.z)));
            double reach = fmax(EXTENT_STEP * largest, solids->step_min);
            if (to_object(world_b, vec3_add(middle, vec3_scale(normal, reach)), 1, origin) &&
                to_object(world_b, vec3_scale(normal, -reach), 0, direction) &&
                bvh_trace(tree_b, origin, direction, 2, &t, &triangle, &u, &v))
                return true;
        }
        inside = found;
        stride = inside / MAX_SAMPLES + 1;
    }
    return false;
}

static bool find_contacts(struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                          struct bvh *const *trees, const struct box *boxes, struct error *error)
{
    for (uint32_t a = 0; a < scene->instance_count && !solids->has_contact; a++) {
        if (!is_solid(scene, a))
            continue;
        for (uint32_t b = 0; b < scene->instance_count && !solids->has_contact; b++) {
            if (a == b || material_of(scene, b)->kind == MATERIAL_THIN || !boxes_meet(&boxes[a], &boxes[b]))
                continue;
            uint32_t mesh = scene->instances[b].mesh;
            struct bvh *own = trees[mesh] ? NULL : bvh_create_mesh(scene, mesh, error);
            if (!trees[mesh] && !own)
                return false;
            solids->has_contact =
                touches(solids, scene, pose, a, b, &boxes[b], own ? own : trees[mesh]) ||
                touches(solids, scene, pose, b, a, &boxes[a], trees[scene->instances[a].mesh]);
            bvh_destroy(&own);
        }
    }
    return true;
}

bool solids_find(struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                 struct bvh *const *trees, double scale, struct error *error)
{
    *solids = (struct solids){.step_min = EXTENT_STEP_MIN * scale};
    struct box *boxes = calloc((size_t)scene->instance_count + 1, sizeof *boxes);
    for (uint32_t i = 0; boxes && i < scene->instance_count; i++)
        boxes[i] = box_of(solids, scene, pose, i);
    bool ok = boxes && number_solids(solids, scene, boxes);
    if (!ok)
        error_set(error, STATUS_MEMORY, "out of memory for the solids of scene '%s'", scene->name);
    uint64_t solid_instances = 0;
    for (uint32_t i = 0; ok && i < scene->instance_count; i++)
        solid_instances += is_solid(scene, i);
    if (ok && solid_instances * scene->instance_count > MAX_PAIRS) {
        solids->is_nested = solids->has_contact = true;
    } else if (ok && solid_instances > 0) {
        solids->is_nested = solid_instances > 1 && scene->channel_count > 0;
        for (uint32_t a = 0; a < scene->instance_count && !solids->is_nested; a++)
            for (uint32_t b = a + 1; is_solid(scene, a) && b < scene->instance_count; b++)
                solids->is_nested |= is_solid(scene, b) && boxes_meet(&boxes[a], &boxes[b]);
        ok = find_contacts(solids, scene, pose, trees, boxes, error);
    }
    free(boxes);
    if (!ok)
        solids_free(solids);
    return ok;
}

void solids_free(struct solids *solids)
{
    free(solids->number);
    free(solids->material);
    *solids = (struct solids){0};
}

/* ---- points -------------------------------------------------------------------------------------------- */

/* Whether the first surface of the instance ahead of the point is seen from its back. */
static bool is_inside(const struct scene *scene, const float world[12], uint32_t mesh_index,
                      const struct bvh *tree, struct vec3 point)
{
    /* any direction will do; along none of the usual edges */
    const struct vec3 way = {0.3713, 0.8411, 0.3931};
    float origin[3], direction[3], t, u, v;
    uint32_t triangle;
    if (!to_object(world, point, 1, origin) || !to_object(world, way, 0, direction) ||
        !bvh_trace(tree, origin, direction, BVH_FAR_T, &t, &triangle, &u, &v))
        return false;
    const struct scene_mesh *mesh = &scene->meshes[mesh_index];
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    const uint32_t *corner = scene->indices + mesh->first_index + 3 * (size_t)triangle;
    struct vec3 p0 = vec3_load(vertices[corner[0]].position), p1 = vec3_load(vertices[corner[1]].position),
                p2 = vec3_load(vertices[corner[2]].position);
    struct vec3 geometric = vec3_cross(vec3_sub(p1, p0), vec3_sub(p2, p0));
    struct vec3 normal = vec3_scale(vec3_load(vertices[corner[0]].normal), 1 - (double)u - (double)v);
    normal = vec3_add(normal, vec3_scale(vec3_load(vertices[corner[1]].normal), (double)u));
    normal = vec3_add(normal, vec3_scale(vec3_load(vertices[corner[2]].normal), (double)v));
    double side = vec3_dot(geometric, normal) < 0 ? -1 : 1; /* the front is where the normals are */
    return side * vec3_dot(geometric, vec3_load(direction)) > 0;
}

uint32_t solids_at(const struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                   struct bvh *const *trees, const float point[3])
{
    uint32_t list = 0, depth = 0;
    struct vec3 place = vec3_load(point);
    for (uint32_t i = 0; i < scene->instance_count && depth < SOLIDS_MAX_DEPTH; i++) {
        uint32_t mesh = scene->instances[i].mesh;
        uint8_t number = solids->number[scene->meshes[mesh].material];
        if (!number)
            continue;
        struct box box = box_of(solids, scene, pose, i);
        if (box_holds(&box, place) && is_inside(scene, pose->instance_to_world[i], mesh, trees[mesh], place))
            list |= (uint32_t)number << 8 * depth++;
    }
    return list;
}
