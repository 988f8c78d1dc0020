#include "bvh.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- building -------------------------------------------------------------------------------------- */

#define BIN_COUNT 16
/* Relative costs of a step down and of a triangle test, and the leaf size, tuned on `sphere` and `pool`
 * with the shader's packets: 2 % over equal costs. */
#define STEP_COST     1.0f
#define TRIANGLE_COST 0.7f
/* Depth that is left to even halves once the heuristic has used up the rest: 2^26 items need 26. */
#define HALVING_SLACK 1

struct box {
    float min[3], max[3];
};

/* What is sorted into a tree: a box and who it belongs to, 32 bytes, moved as a whole so that binning
 * reads memory in order. */
struct primitive {
    float min[3];
    uint32_t index;
    float max[3];
    uint32_t unused;
};

struct task {
    uint32_t first, count;
    uint32_t parent, side; /* where the reference to this range is written */
    uint32_t depth;
    struct box centroids; /* of the boxes' minimum + maximum */
};

struct bin {
    struct box box;
    uint32_t count;
};

struct split {
    float cost; /* relative to the parent's half area; INFINITY: no plane
                   separates the centroids */
    uint32_t axis, bin;
};

static struct box box_empty(void)
{
    return (struct box){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
}

static inline void box_add(struct box *box, const float min[3], const float max[3])
{
    for (int a = 0; a < 3; a++) {
        box->min[a] = min[a] < box->min[a] ? min[a] : box->min[a];
        box->max[a] = max[a] > box->max[a] ? max[a] : box->max[a];
    }
}

static float box_half_area(const struct box *box)
{
    float x = box->max[0] - box->min[0], y = box->max[1] - box->min[1], z = box->max[2] - box->min[2];
    return x >= 0 ? x * y + y * z + z * x : 0;
}

static void range_bounds(const struct primitive *primitives, uint32_t count, struct box *box,
                         struct box *centroids)
{
    *box = box_empty();
    *centroids = box_empty();
    for (uint32_t i = 0; i < count; i++) {
        float c[3];
        for (int a = 0; a < 3; a++)
            c[a] = primitives[i].min[a] + primitives[i].max[a];
        box_add(box, primitives[i].min, primitives[i].max);
        box_add(centroids, c, c);
    }
}

static float bin_scale(const struct box *centroids, int axis)
{
    float extent = centroids->max[axis] - centroids->min[axis];
    float scale = (float)BIN_COUNT / extent;
    return extent > 0 && isfinite(scale) ? scale : 0;
}

static inline uint32_t bin_of(const struct primitive *p, const struct box *centroids, float scale, int axis)
{
    if (!(scale > 0))
        return 0;
    int bin = (int)((p->min[axis] + p->max[axis] - centroids->min[axis]) * scale);
    return bin < BIN_COUNT ? (uint32_t)bin : BIN_COUNT - 1;
}

static struct split find_split(const struct primitive *primitives, uint32_t count,
                               const struct box *centroids)
{
    struct bin bins[3][BIN_COUNT];
    float scale[3];
    for (int a = 0; a < 3; a++) {
        scale[a] = bin_scale(centroids, a);
        for (int b = 0; b < BIN_COUNT; b++)
            bins[a][b] = (struct bin){box_empty(), 0};
    }
    for (uint32_t i = 0; i < count; i++)
        for (int a = 0; a < 3; a++) {
            struct bin *bin = &bins[a][bin_of(&primitives[i], centroids, scale[a], a)];
            box_add(&bin->box, primitives[i].min, primitives[i].max);
            bin->count++;
        }

    struct split best = {.cost = INFINITY};
    for (uint32_t a = 0; a < 3; a++) {
        if (!(scale[a] > 0))
            continue;
        float right_cost[BIN_COUNT];
        struct box right = box_empty();
        uint32_t right_count = 0;
        for (uint32_t b = BIN_COUNT - 1; b > 0; b--) {
            box_add(&right, bins[a][b].box.min, bins[a][b].box.max);
            right_count += bins[a][b].count;
            right_cost[b] = right_count ? box_half_area(&right) * (float)right_count : INFINITY;
        }
        struct box left = box_empty();
        uint32_t left_count = 0;
        for (uint32_t b = 1; b < BIN_COUNT; b++) {
            box_add(&left, bins[a][b - 1].box.min, bins[a][b - 1].box.max);
            left_count += bins[a][b - 1].count;
            float cost = left_count ? box_half_area(&left) * (float)left_count + right_cost[b] : INFINITY;
            if (cost < best.cost)
                best = (struct split){cost, a, b};
        }
    }
    return best;
}

/* Moves the primitives of bins below the split to the front; returns how many. Keeps a fixed order for
 * fixed input. */
static uint32_t partition(struct primitive *primitives, uint32_t count, const struct box *centroids,
                          struct split split)
{
    int axis = (int)split.axis;
    float scale = bin_scale(centroids, axis);
    uint32_t left = 0, right = count;
    while (left < right) {
        if (bin_of(&primitives[left], centroids, scale, axis) < split.bin) {
            left++;
        } else {
            right--;
            struct primitive moved = primitives[left];
            primitives[left] = primitives[right];
            primitives[right] = moved;
        }
    }
    return left;
}

/* ---- the grid -------------------------------------------------------------------------------------- */

#define GRID_STEPS 65535

const struct bvh_header *bvh_header(const struct bvh *bvh)
{
    return (const struct bvh_header *)(const void *)bvh->nodes;
}

static float header_float(const uint32_t *bits)
{
    float value;
    memcpy(&value, bits, sizeof value);
    return value;
}

/* The finest steps that span the box with one to spare at either end. */
static void header_set(struct bvh *bvh, const struct box *box)
{
    struct bvh_header header = {.root = BVH_DONE};
    double largest = 0;
    for (int a = 0; a < 3; a++)
        largest = fmax(largest, (double)box->max[a] - (double)box->min[a]);
    for (int a = 0; a < 3; a++) {
        /* A flat side gets steps that are small but not so small that distances in steps overflow. */
        double extent = fmax((double)box->max[a] - (double)box->min[a], largest * 0x1p-20);
        int exponent;
        frexp(fmax(extent, 0x1p-80) / (GRID_STEPS - 3), &exponent);
        float scale = ldexpf(1, exponent);
        float origin = (float)fmax((double)box->min[a] - (double)scale, -(double)FLT_MAX);
        memcpy(&header.origin[a], &origin, sizeof origin);
        memcpy(&header.scale[a], &scale, sizeof scale);
    }
    memcpy(bvh->nodes, &header, sizeof header);
}

static void set_root(struct bvh *bvh, uint32_t reference)
{
    struct bvh_header header = *bvh_header(bvh);
    header.root = reference;
    memcpy(bvh->nodes, &header, sizeof header);
}

/* A box's side along an axis, in steps, rounded outward. */
static uint32_t grid_span(const struct bvh *bvh, const struct box *box, int axis)
{
    const struct bvh_header *header = bvh_header(bvh);
    double origin = (double)header_float(&header->origin[axis]),
           scale = (double)header_float(&header->scale[axis]);
    double low = floor(((double)box->min[axis] - origin) / scale),
           high = ceil(((double)box->max[axis] - origin) / scale);
    return (uint32_t)fmax(low, 0) | (uint32_t)fmin(high, GRID_STEPS) << 16;
}

static void set_child(struct bvh *bvh, uint32_t node, uint32_t side, const struct box *box,
                      uint32_t reference)
{
    struct bvh_node *n = &bvh->nodes[node];
    uint32_t x = grid_span(bvh, box, 0), y = grid_span(bvh, box, 1), z = grid_span(bvh, box, 2);
    if (side == 0)
        n->left_x = x, n->left_y = y, n->left_z = z, n->left = reference;
    else
        n->right_x = x, n->right_y = y, n->right_z = z, n->right = reference;
}

uint32_t bvh_child(const struct bvh *bvh, uint32_t node, uint32_t side, float box[6])
{
    const struct bvh_header *header = bvh_header(bvh);
    const struct bvh_node *n = &bvh->nodes[node];
    const uint32_t spans[3] = {side ? n->right_x : n->left_x, side ? n->right_y : n->left_y,
                               side ? n->right_z : n->left_z};
    for (int a = 0; a < 3; a++) {
        double origin = (double)header_float(&header->origin[a]),
               scale = (double)header_float(&header->scale[a]);
        box[a] = (float)(origin + scale * (spans[a] & 0xffffu));
        box[3 + a] = (float)(origin + scale * (spans[a] >> 16));
    }
    return side ? n->right : n->left;
}

/* ---- the build ------------------------------------------------------------------------------------- */

static uint32_t halvings(uint32_t count)
{
    uint32_t n = 0;
    while ((1ull << n) < count)
        n++;
    return n;
}

/* Decides where a range is cut: returns the size of its left part, or 0 to make it a leaf. */
static uint32_t cut(struct primitive *primitives, const struct task *task, const struct box *box,
                    uint32_t max_leaf)
{
    if (task->count == 1)
        return 0;
    bool has_depth = task->depth + halvings(task->count) + HALVING_SLACK < BVH_MAX_DEPTH;
    struct split split = find_split(primitives, task->count, &task->centroids);
    float area = box_half_area(box);
    if (task->count <= max_leaf &&
        !(split.cost * TRIANGLE_COST + STEP_COST * area < (float)task->count * TRIANGLE_COST * area))
        return 0;
    if (has_depth && split.cost < INFINITY) {
        uint32_t left = partition(primitives, task->count, &task->centroids, split);
        if (left > 0 && left < task->count)
            return left;
    }
    return task->count / 2; /* coinciding centroids, or too deep: even halves in
                               the order at hand */
}

/* Sorts `primitives` into leaf order and writes bvh->nodes. */
static bool build(struct bvh *bvh, struct primitive *primitives, uint32_t count, uint32_t max_leaf,
                  struct error *error)
{
    struct task stack[BVH_MAX_DEPTH + 2];
    uint32_t stack_size = 0;
    /* A header, and n - 1 inner nodes of a binary tree of n leaves. */
    bvh->nodes = malloc((size_t)(count ? count : 1) * sizeof *bvh->nodes);
    if (!bvh->nodes)
        return error_set(error, STATUS_MEMORY, "no memory for the hierarchy of %u primitives", count);
    bvh->node_count = 1;
    struct box bounds = {{0}, {0}};
    struct task root = {.count = count};
    if (count)
        range_bounds(primitives, count, &bounds, &root.centroids);
    memcpy(bvh->bounds_min, bounds.min, sizeof bounds.min);
    memcpy(bvh->bounds_max, bounds.max, sizeof bounds.max);
    header_set(bvh, &bounds);
    if (count)
        stack[stack_size++] = root; /* its parent 0 is the header */

    while (stack_size) {
        struct task task = stack[--stack_size];
        struct primitive *range = primitives + task.first;
        struct box box;
        range_bounds(range, task.count, &box, &task.centroids);
        uint32_t left = cut(range, &task, &box, max_leaf);
        uint32_t reference =
            left ? bvh->node_count : BVH_LEAF | (task.count - 1) << BVH_COUNT_SHIFT | task.first;
        if (task.parent)
            set_child(bvh, task.parent, task.side, &box, reference);
        else
            set_root(bvh, reference);
        if (!left) {
            bvh->depth = task.depth > bvh->depth ? task.depth : bvh->depth;
            continue;
        }
        uint32_t node = bvh->node_count++;
        /* Left is built next, so that it lies right behind its parent. */
        stack[stack_size++] = (struct task){.first = task.first + left,
                                            .count = task.count - left,
                                            .parent = node,
                                            .side = 1,
                                            .depth = task.depth + 1};
        stack[stack_size++] = (struct task){
            .first = task.first, .count = left, .parent = node, .side = 0, .depth = task.depth + 1};
    }
    struct bvh_node *shrunk = realloc(bvh->nodes, bvh->node_count * sizeof *bvh->nodes);
    if (shrunk)
        bvh->nodes = shrunk;
    return true;
}

static struct bvh *bvh_create(uint32_t count, const char *what, struct primitive **primitives,
                              struct error *error)
{
    struct bvh *bvh = calloc(1, sizeof *bvh);
    *primitives = malloc((size_t)(count ? count : 1) * sizeof **primitives);
    if (bvh && *primitives && count <= BVH_INDEX_MASK) {
        bvh->item_count = count;
        return bvh;
    }
    if (count > BVH_INDEX_MASK)
        error_set(error, STATUS_LIMIT, "%u %s are more than a hierarchy can hold (%u)", count, what,
                  BVH_INDEX_MASK);
    else
        error_set(error, STATUS_MEMORY, "no memory for the hierarchy of %u %s", count, what);
    free(bvh);
    free(*primitives);
    *primitives = NULL;
    return NULL;
}

struct bvh *bvh_create_mesh(const struct scene *scene, uint32_t mesh_index, struct error *error)
{
    const struct scene_mesh *mesh = &scene->meshes[mesh_index];
    const uint32_t *indices = scene->indices + mesh->first_index;
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    struct primitive *primitives;
    struct bvh *bvh = bvh_create(mesh->triangle_count, "triangles", &primitives, error);
    if (!bvh)
        return NULL;

    float largest = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        struct box box = box_empty();
        for (uint32_t k = 0; k < 3; k++) {
            const float *p = vertices[indices[3 * i + k]].position;
            box_add(&box, p, p);
        }
        for (int a = 0; a < 3; a++)
            largest = fmaxf(largest, fmaxf(fabsf(box.min[a]), fabsf(box.max[a])));
        primitives[i] = (struct primitive){
            {box.min[0], box.min[1], box.min[2]}, i, {box.max[0], box.max[1], box.max[2]}, 0};
    }
    /* A ray along an axis, in the very plane of a box's side, would count as leaving where it stands. */
    float slack = largest * 0x1p-23f;
    for (uint32_t i = 0; i < mesh->triangle_count; i++)
        for (int a = 0; a < 3; a++) {
            primitives[i].min[a] = fmaxf(primitives[i].min[a] - slack, -FLT_MAX);
            primitives[i].max[a] = fminf(primitives[i].max[a] + slack, FLT_MAX);
        }
    if (!build(bvh, primitives, mesh->triangle_count, BVH_MAX_LEAF, error))
        goto fail;

    bvh->triangles =
        malloc((size_t)(mesh->triangle_count ? mesh->triangle_count : 1) * sizeof *bvh->triangles);
    if (!bvh->triangles) {
        error_set(error, STATUS_MEMORY, "no memory for the %u triangles of mesh '%s'", mesh->triangle_count,
                  mesh->name);
        goto fail;
    }
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        struct bvh_triangle *triangle = &bvh->triangles[i];
        for (uint32_t k = 0; k < 3; k++)
            memcpy(&triangle->vertex[k], vertices[indices[3 * primitives[i].index + k]].position,
                   3 * sizeof(float));
        triangle->vertex[0].w = primitives[i].index;
        triangle->vertex[1].w = triangle->vertex[2].w = 0;
    }
    free(primitives);
    return bvh;

fail:
    free(primitives);
    bvh_destroy(&bvh);
    return NULL;
}

struct bvh *bvh_create_boxes(const float (*boxes)[6], uint32_t count, struct error *error)
{
    struct primitive *primitives;
    struct bvh *bvh = bvh_create(count, "boxes", &primitives, error);
    if (!bvh)
        return NULL;
    for (uint32_t i = 0; i < count; i++) {
        primitives[i].index = i;
        for (int a = 0; a < 3; a++) {
            /* A world box comes from corners carried through a matrix; its rounding must not cut off what
             * it holds. */
            float slack = 1e-6f * fmaxf(fabsf(boxes[i][a]), fabsf(boxes[i][3 + a]));
            primitives[i].min[a] = fmaxf(boxes[i][a] - slack, -FLT_MAX);
            primitives[i].max[a] = fminf(boxes[i][3 + a] + slack, FLT_MAX);
        }
    }
    bvh->items = malloc((size_t)(count ? count : 1) * sizeof *bvh->items);
    if (!bvh->items)
        error_set(error, STATUS_MEMORY, "no memory for the hierarchy of %u boxes", count);
    if (!bvh->items || !build(bvh, primitives, count, 1, error)) {
        free(primitives);
        bvh_destroy(&bvh);
        return NULL;
    }
    for (uint32_t i = 0; i < count; i++)
        bvh->items[i] = primitives[i].index;
    /* The shader's leaves name instances, not places in the leaf order. */
    if (count == 1)
        set_root(bvh, BVH_LEAF | bvh->items[0]);
    for (uint32_t n = 1; n < bvh->node_count; n++)
        for (uint32_t side = 0; side < 2; side++) {
            uint32_t *reference = side ? &bvh->nodes[n].right : &bvh->nodes[n].left;
            if (*reference & BVH_LEAF)
                *reference = BVH_LEAF | bvh->items[*reference & BVH_INDEX_MASK];
        }
    free(primitives);
    return bvh;
}

void bvh_destroy(struct bvh **bvh)
{
    if (!*bvh)
        return;
    free((*bvh)->nodes);
    free((*bvh)->triangles);
    free((*bvh)->items);
    free(*bvh);
    *bvh = NULL;
}

/* ---- tracing --------------------------------------------------------------------------------------- */

/* The same arithmetic as shaders/trace_bvh.glsl, operation by operation. */

/* Five roundings of 2^-24 on each side: the origin's place on the grid, the inverse, difference and
 * product. */
#define LEAVE_SLACK 1.000001f

struct ray {
    float origin[3], inverse[3];
    float grid_origin[3], grid_inverse[3]; /* in steps of the tree's grid */
    int axis_x, axis_y, axis_z;            /* z: along which the direction is longest */
    float shear_x, shear_y, shear_z;
};

static void ray_prepare(struct ray *ray, const struct bvh_header *header, const float origin[3],
                        const float direction[3])
{
    for (int a = 0; a < 3; a++) {
        ray->origin[a] = origin[a];
        float d = direction[a], scale = header_float(&header->scale[a]);
        ray->inverse[a] = 1.0f / (fabsf(d) < 1e-20f ? copysignf(1e-20f, d) : d);
        ray->grid_origin[a] = (origin[a] - header_float(&header->origin[a])) * (1.0f / scale);
        ray->grid_inverse[a] = ray->inverse[a] * scale;
    }
    float x = fabsf(direction[0]), y = fabsf(direction[1]), z = fabsf(direction[2]);
    ray->axis_z = z >= x && z >= y ? 2 : y >= x ? 1 : 0;
    ray->axis_x = (ray->axis_z + 1) % 3;
    ray->axis_y = (ray->axis_z + 2) % 3;
    ray->shear_z = ray->inverse[ray->axis_z];
    ray->shear_x = direction[ray->axis_x] * ray->shear_z;
    ray->shear_y = direction[ray->axis_y] * ray->shear_z;
}

/* Where the ray enters the box whose spans these are, or INFINITY. */
static float ray_enter(const struct ray *ray, uint32_t x, uint32_t y, uint32_t z, float t_max)
{
    const uint32_t spans[3] = {x, y, z};
    float enter = 0, leave = t_max;
    for (int a = 0; a < 3; a++) {
        float t0 = ((float)(spans[a] & 0xffffu) - ray->grid_origin[a]) * ray->grid_inverse[a];
        float t1 = ((float)(spans[a] >> 16) - ray->grid_origin[a]) * ray->grid_inverse[a];
        enter = fmaxf(enter, fminf(t0, t1));
        /* Roundings on each side must not lose a box the ray only grazes (Ize 2013). */
        leave = fminf(leave, fmaxf(t0, t1) * LEAVE_SLACK);
    }
    return enter <= leave ? enter : INFINITY;
}

/* Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection": corners sheared into the ray's
 * frame. A product never rounds past an equal one, so an edge function can only be 0 where its sign would
 * be in doubt, and 0 counts as inside for both triangles at an edge. */
static bool ray_triangle(const struct ray *ray, const struct bvh_triangle *triangle, float t_max, float *t,
                         float *u, float *v)
{
    float x[3], y[3], z[3];
    for (int k = 0; k < 3; k++) {
        float p[3];
        memcpy(p, &triangle->vertex[k], sizeof p);
        for (int a = 0; a < 3; a++)
            p[a] -= ray->origin[a];
        x[k] = p[ray->axis_x] - ray->shear_x * p[ray->axis_z];
        y[k] = p[ray->axis_y] - ray->shear_y * p[ray->axis_z];
        z[k] = p[ray->axis_z] * ray->shear_z;
    }
    float w0 = x[2] * y[1] - y[2] * x[1];
    float w1 = x[0] * y[2] - y[0] * x[2];
    float w2 = x[1] * y[0] - y[1] * x[0];
    if (fminf(w0, fminf(w1, w2)) < 0 && fmaxf(w0, fmaxf(w1, w2)) > 0)
        return false;
    float determinant = w0 + w1 + w2;
    if (determinant == 0)
        return false; /* seen edge-on, or without area */
    float inverse = 1.0f / determinant;
    float distance = (w0 * z[0] + w1 * z[1] + w2 * z[2]) * inverse;
    if (!(distance > 0 && distance < t_max))
        return false;
    *t = distance;
    *u = w1 * inverse;
    *v = w2 * inverse;
    return true;
}

bool bvh_trace(const struct bvh *bvh, const float origin[3], const float direction[3], float t_max, float *t,
               uint32_t *triangle, float *u, float *v)
{
    struct ray ray;
    ray_prepare(&ray, bvh_header(bvh), origin, direction);
    float nearest = fminf(t_max, BVH_FAR_T);
    bool is_hit = false;
    struct {
        uint32_t reference;
        float enter;
    } stack[BVH_MAX_DEPTH + 1];
    uint32_t stack_size = 0;
    stack[stack_size].reference = bvh_header(bvh)->root;
    stack[stack_size++].enter = 0;

    for (uint32_t step = 0; stack_size && step < BVH_MAX_STEPS; step++) {
        uint32_t reference = stack[--stack_size].reference;
        if (stack[stack_size].enter > nearest || reference == BVH_DONE)
            continue;
        if (reference & BVH_LEAF) {
            uint32_t first = reference & BVH_INDEX_MASK;
            uint32_t count = (reference >> BVH_COUNT_SHIFT & BVH_COUNT_MASK) + 1;
            for (uint32_t i = first; i < first + count; i++)
                if (ray_triangle(&ray, &bvh->triangles[i], nearest, &nearest, u, v)) {
                    *triangle = bvh->triangles[i].vertex[0].w;
                    is_hit = true;
                }
            continue;
        }
        const struct bvh_node *node = &bvh->nodes[reference];
        float left = ray_enter(&ray, node->left_x, node->left_y, node->left_z, nearest);
        float right = ray_enter(&ray, node->right_x, node->right_y, node->right_z, nearest);
        uint32_t near_side = right < left;
        float near_enter = near_side ? right : left, far_enter = near_side ? left : right;
        if (far_enter < INFINITY) {
            stack[stack_size].reference = near_side ? node->left : node->right;
            stack[stack_size++].enter = far_enter;
        }
        if (near_enter < INFINITY) {
            stack[stack_size].reference = near_side ? node->right : node->left;
            stack[stack_size++].enter = near_enter;
        }
    }
    if (is_hit)
        *t = nearest;
    return is_hit;
}

/* ---- frontier -------------------------------------------------------------------------------------- */

uint32_t bvh_frontier(const struct bvh *bvh, float (*boxes)[6], uint32_t capacity)
{
    if (bvh->item_count == 0 || capacity == 0)
        return 0;
    uint32_t count = 1;
    uint32_t *references = malloc(capacity * sizeof *references);
    memcpy(boxes[0], bvh->bounds_min, sizeof bvh->bounds_min);
    memcpy(boxes[0] + 3, bvh->bounds_max, sizeof bvh->bounds_max);
    if (references)
        references[0] = bvh_header(bvh)->root;
    while (references && count < capacity) {
        float largest = -1;
        uint32_t slot = 0;
        for (uint32_t i = 0; i < count; i++) {
            struct box box;
            memcpy(&box, boxes[i], sizeof box);
            float area = box_half_area(&box);
            if (!(references[i] & BVH_LEAF) && area > largest) {
                largest = area;
                slot = i;
            }
        }
        if (largest < 0)
            break;
        uint32_t node = references[slot];
        references[slot] = bvh_child(bvh, node, 0, boxes[slot]);
        references[count] = bvh_child(bvh, node, 1, boxes[count]);
        count++;
    }
    free(references);
    return count;
}
