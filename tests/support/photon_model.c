#include "photon_model.h"

#include <string.h>

#include "check.h"

/* ---- a small scene ------------------------------------------------------------------------------------- */

const struct vector model_sphere_center = {0.3, 0.2, -0.1};

static struct scene_vertex vertices[MODEL_VERTICES];
static uint32_t indices[3 * MODEL_TRIANGLES]; /* relative to the mesh's first vertex */
static struct scene_mesh meshes[MODEL_PARTS];
static struct scene scene = {
    .vertices = vertices, .indices = indices, .meshes = meshes, .mesh_count = MODEL_PARTS};
struct material_gpu model_materials[MODEL_PARTS];
struct scene_vertex_gpu model_vertices[MODEL_VERTICES];
uint32_t model_indices[3 * MODEL_TRIANGLES];
struct scene_instance_gpu model_instances[MODEL_PARTS];
struct bvh_node model_nodes[MODEL_NODES];
struct bvh_triangle model_triangles[MODEL_TRIANGLES];

static void add_quad(uint32_t part, struct vector o, struct vector u, struct vector v)
{
    uint32_t first = MODEL_SPHERE_VERTICES + 4 * (part - 1),
             index = 3 * MODEL_SPHERE_TRIANGLES + 6 * (part - 1);
    struct vector n = vector_cross(u, v);
    double length = sqrt(vector_dot(n, n));
    for (int k = 0; k < 4; k++) {
        double a = k == 1 || k == 2, b = k >= 2;
        vertices[first + (uint32_t)k] = (struct scene_vertex){
            .position = {(float)(o.x + a * u.x + b * v.x), (float)(o.y + a * u.y + b * v.y),
                         (float)(o.z + a * u.z + b * v.z)},
            .normal = {(float)(n.x / length), (float)(n.y / length), (float)(n.z / length)}};
    }
    const uint32_t corners[6] = {0, 1, 2, 0, 2, 3};
    memcpy(indices + index, corners, sizeof corners);
    meshes[part] = (struct scene_mesh){
        .name = "quad", .first_vertex = first, .vertex_count = 4, .first_index = index, .triangle_count = 2};
}

static void make_meshes(void)
{
    for (uint32_t i = 0; i <= MODEL_DOWN; i++)
        for (uint32_t j = 0; j < MODEL_AROUND; j++) {
            double down = PI * i / MODEL_DOWN, around = 2 * PI * j / MODEL_AROUND;
            struct vector n = {sin(down) * cos(around), cos(down), sin(down) * sin(around)};
            vertices[i * MODEL_AROUND + j] = (struct scene_vertex){
                .position = {(float)(model_sphere_center.x + n.x), (float)(model_sphere_center.y + n.y),
                             (float)(model_sphere_center.z + n.z)},
                .normal = {(float)n.x, (float)n.y, (float)n.z}};
        }
    uint32_t count = 0;
    for (uint32_t i = 0; i < MODEL_DOWN; i++)
        for (uint32_t j = 0; j < MODEL_AROUND; j++) {
            uint32_t a = i * MODEL_AROUND + j, b = i * MODEL_AROUND + (j + 1) % MODEL_AROUND;
            const uint32_t corners[6] = {a, b, a + MODEL_AROUND, b, b + MODEL_AROUND, a + MODEL_AROUND};
            memcpy(indices + count, corners, sizeof corners);
            count += 6;
        }
    meshes[MODEL_SPHERE] = (struct scene_mesh){
        .name = "sphere", .vertex_count = MODEL_SPHERE_VERTICES, .triangle_count = MODEL_SPHERE_TRIANGLES};
    add_quad(MODEL_MIRROR, (struct vector){-3, -2, -3}, (struct vector){6, 0, 0.5},
             (struct vector){0, 5, -0.3});
    add_quad(MODEL_FLOOR, (struct vector){-4, -2, 4}, (struct vector){8, 0, 0}, (struct vector){0, 0.1, -8});
    add_quad(MODEL_SHEET, (struct vector){2, -2, 3}, (struct vector){0.5, 0, -6},
             (struct vector){-0.2, 4, 0});
    add_quad(MODEL_SLAB, (struct vector){-2.5, 2, -2.5}, (struct vector){0, 0, 5},
             (struct vector){5, 0.2, 0});
}

static void make_materials(void)
{
    for (uint32_t i = 0; i < MODEL_PARTS; i++)
        model_materials[i] = (struct material_gpu){.color_ior = {0.9f, 0.7f, 0.4f, 1.5f},
                                                   .color_first = NONE,
                                                   .emission_first = NONE,
                                                   .flags = MODEL_SOLID(i) << 8 | i << 16};
    model_materials[MODEL_SPHERE].kind = KIND_DIELECTRIC;
    model_materials[MODEL_SPHERE].absorption = (vec4){0.1f, 0.3f, 1.2f, 0};
    model_materials[MODEL_MIRROR].kind = KIND_MIRROR;
    model_materials[MODEL_FLOOR].kind = KIND_DIFFUSE;
    model_materials[MODEL_SHEET].kind = KIND_THIN;
    model_materials[MODEL_SLAB].kind =
        KIND_DIELECTRIC; /* its upper side is air: rays from below are within */
    model_materials[MODEL_SLAB].color_ior.w = 1.33f;
}

static void make_trees(void)
{
    struct error error;
    float boxes[MODEL_PARTS][6];
    uint32_t node = 2 * MODEL_PARTS + 1, triangle = 0;
    for (uint32_t i = 0; i < MODEL_PARTS; i++) {
        struct bvh *tree = bvh_create_mesh(&scene, i, &error);
        assert_non_null(tree);
        assert_true(node + tree->node_count <= MODEL_NODES);
        memcpy(model_nodes + node, tree->nodes, tree->node_count * sizeof *model_nodes);
        memcpy(model_triangles + triangle, tree->triangles, tree->item_count * sizeof *model_triangles);
        memcpy(boxes[i], tree->bounds_min, 3 * sizeof(float));
        memcpy(boxes[i] + 3, tree->bounds_max, 3 * sizeof(float));
        model_instances[i] = (struct scene_instance_gpu){
            .to_world = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}},
            .to_object = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}},
            .first_index = meshes[i].first_index,
            .material = i,
            .bvh_root = node,
            .bvh_triangle = triangle,
        };
        node += tree->node_count;
        triangle += tree->item_count;
        bvh_destroy(&tree);
    }
    struct bvh *top = bvh_create_boxes((const float(*)[6])boxes, MODEL_PARTS, &error);
    assert_non_null(top);
    assert_true(top->node_count <= 2 * MODEL_PARTS + 1);
    memcpy(model_nodes, top->nodes, top->node_count * sizeof *model_nodes);
    bvh_destroy(&top);
    for (uint32_t i = 0; i < MODEL_VERTICES; i++) {
        const struct scene_vertex *v = &vertices[i];
        model_vertices[i].position_u = (vec4){v->position[0], v->position[1], v->position[2], 0};
        model_vertices[i].normal_v = (vec4){v->normal[0], v->normal[1], v->normal[2], 0};
    }
    for (uint32_t i = 0; i < MODEL_PARTS; i++)
        for (uint32_t k = 0; k < 3 * meshes[i].triangle_count; k++)
            model_indices[meshes[i].first_index + k] =
                indices[meshes[i].first_index + k] + meshes[i].first_vertex;
}

void model_make(void)
{
    make_meshes();
    make_materials();
    make_trees();
}

/* ---- the model ----------------------------------------------------------------------------------------- */

struct vector model_add(struct vector a, struct vector b, double scale)
{
    return (struct vector){a.x + scale * b.x, a.y + scale * b.y, a.z + scale * b.z};
}

struct vector model_unit(struct vector a)
{
    return model_add((struct vector){0, 0, 0}, a, 1 / sqrt(vector_dot(a, a)));
}

double model_length(struct vector a)
{
    return sqrt(vector_dot(a, a));
}

void model_fetch(uint32_t part, uint32_t triangle, struct model_corner corners[3])
{
    for (uint32_t k = 0; k < 3; k++) {
        const struct scene_vertex *v =
            &vertices[meshes[part].first_vertex + indices[meshes[part].first_index + 3 * triangle + k]];
        corners[k].position =
            (struct vector){(double)v->position[0], (double)v->position[1], (double)v->position[2]};
        corners[k].normal = (struct vector){(double)v->normal[0], (double)v->normal[1], (double)v->normal[2]};
    }
}

/* Where the ray meets the triangle's plane: distance, weights of the corners. */
static double meet(const struct model_corner c[3], struct vector o, struct vector d, double weights[3])
{
    struct vector e1 = model_add(c[1].position, c[0].position, -1),
                  e2 = model_add(c[2].position, c[0].position, -1);
    struct vector n = vector_cross(e1, e2);
    double t = vector_dot(model_add(c[0].position, o, -1), n) / vector_dot(d, n);
    struct vector p = model_add(model_add(o, d, t), c[0].position, -1);
    weights[1] = vector_dot(vector_cross(p, e2), n) / vector_dot(n, n);
    weights[2] = vector_dot(vector_cross(e1, p), n) / vector_dot(n, n);
    weights[0] = 1 - weights[1] - weights[2];
    return t;
}

bool model_trace(struct vector o, struct vector d, struct model_hit *hit)
{
    hit->t = 1e30;
    hit->border = 1;
    for (uint32_t part = 0; part < MODEL_PARTS; part++)
        for (uint32_t i = 0; i < meshes[part].triangle_count; i++) {
            struct model_corner c[3];
            double w[3];
            model_fetch(part, i, c);
            double t = meet(c, o, d, w);
            double inside = fmin(w[0], fmin(w[1], w[2]));
            if (!(t > 0) || inside < -1e-3)
                continue;
            hit->border = fmin(hit->border, fabs(inside));
            hit->border = fmin(hit->border, fabs(t - hit->t));
            if (inside >= 0 && t < hit->t) {
                hit->t = t;
                hit->part = part;
                memcpy(hit->corners, c, sizeof c);
            }
        }
    return hit->t < 1e30;
}

struct model_turn model_turn_of(const struct model_hit *hit, struct vector o, struct vector d,
                                enum model_way way)
{
    struct model_turn turn;
    double w[3];
    double t = meet(hit->corners, o, d, w);
    turn.position = model_add(o, d, t);
    struct vector n = {0, 0, 0}, e1 = model_add(hit->corners[1].position, hit->corners[0].position, -1),
                  e2 = model_add(hit->corners[2].position, hit->corners[0].position, -1);
    for (int k = 0; k < 3; k++)
        n = model_add(n, hit->corners[k].normal, w[k]);
    n = model_unit(n);
    struct vector g = model_unit(vector_cross(e1, e2));
    if (vector_dot(g, n) < 0)
        g = model_add((struct vector){0, 0, 0}, g, -1);
    bool front = vector_dot(g, d) < 0;
    turn.geometric = model_add((struct vector){0, 0, 0}, g, front ? 1 : -1);
    turn.normal = model_add((struct vector){0, 0, 0}, n, front ? 1 : -1);
    double ior = (double)model_materials[hit->part].color_ior.w, ratio = front ? ior : 1 / ior;
    turn.cos_i = -vector_dot(d, turn.normal);
    double sin_i = sqrt(fmax(1 - turn.cos_i * turn.cos_i, 0)), sin_t = sin_i / ratio;
    turn.cos_t = sin_t < 1 ? cos(asin(sin_t)) : 0;
    /* along the surface, in the plane of incidence */
    struct vector along = model_add(d, turn.normal, turn.cos_i);
    if (way == MODEL_REFLECT)
        turn.direction = model_add(along, turn.normal, turn.cos_i);
    else if (way == MODEL_REFRACT)
        turn.direction =
            model_add(model_add((struct vector){0, 0, 0}, along, 1 / ratio), turn.normal, -turn.cos_t);
    else
        turn.direction = d;
    return turn;
}

double model_reflectance(double cos_i, double ratio)
{
    double i = acos(fmin(cos_i, 1)), sine = sin(i) / ratio;
    if (sine >= 1)
        return 1;
    if (i < 1e-5)
        return pow((ratio - 1) / (ratio + 1), 2);
    double t = asin(sine), s = sin(i - t) / sin(i + t), p = tan(i - t) / tan(i + t);
    return 0.5 * (s * s + p * p);
}
