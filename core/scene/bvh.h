/* bvh.h: binary bounding volume hierarchies for the `bvh` tracer, built on the CPU.
 *
 * One bottom-level tree per mesh in object space, built once; one top-level tree over instances, rebuilt
 * when anything moves. A node is a pair of children in 32 bytes, their boxes on a 16-bit grid over the
 * tree (struct bvh_node in shaders/shared/bvh_layout.h, read by the shader as it is). Binned surface-area
 * heuristic, iterative, deterministic. Source: design 12; Wald 2007, "On fast construction of SAH-based
 * bounding volume hierarchies".
 */
#ifndef CAUSTIC_BVH_H
#define CAUSTIC_BVH_H

#include "../../shaders/shared/bvh_layout.h"
#include "scene.h"

struct bvh {
    struct bvh_node *nodes;         /* node 0 is a struct bvh_header, node 1 the root pair */
    uint32_t node_count;            /* header included: at most max(1, item_count) */
    struct bvh_triangle *triangles; /* leaf order; NULL for a top-level tree */
    uint32_t *items;                /* leaf order -> instance; NULL for a bottom-level tree */
    uint32_t item_count;            /* triangles or instances */
    uint32_t depth;                 /* of the deepest leaf; at most BVH_MAX_DEPTH */
    float bounds_min[3], bounds_max[3];
};

/* Bottom level, over one mesh. */
struct bvh *bvh_create_mesh(const struct scene *scene, uint32_t mesh, struct error *error);
/* Top level, over `count` world-space boxes (6 floats each: min, max). */
struct bvh *bvh_create_boxes(const float (*boxes)[6], uint32_t count, struct error *error);
void bvh_destroy(struct bvh **bvh);

/* Plain C reference of the shader's traversal, for tests and CPU measures. Object space. Returns whether
 * anything was hit; *t, *triangle (index within the mesh), *u, *v (barycentrics of vertex 1 and 2) as in
 * shaders/trace.glsl. */
bool bvh_trace(const struct bvh *bvh, const float origin[3], const float direction[3], float t_max, float *t,
               uint32_t *triangle, float *u, float *v);

/* The header, and one child of inner node `node`: its box (min, max; rounded outward) and reference. */
const struct bvh_header *bvh_header(const struct bvh *bvh);
uint32_t bvh_child(const struct bvh *bvh, uint32_t node, uint32_t side, float box[6]);

/* Up to `capacity` world boxes that together enclose the tree's leaves: the frontier of its upper levels,
 * for conservative tests (caster mask). Returns the count. */
uint32_t bvh_frontier(const struct bvh *bvh, float (*boxes)[6], uint32_t capacity);

#endif
