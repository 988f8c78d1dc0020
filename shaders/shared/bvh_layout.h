/* bvh_layout.h: the hierarchies of the `bvh` tracer as the host builds them and the shader reads them.
 *
 * The node buffer holds the top level first (node 0 is its root), then the bottom level of every mesh. A
 * reference is relative to its own tree: the shader adds scene_instance_gpu.bvh_root to inner nodes and
 * scene_instance_gpu.bvh_triangle to the triangles of leaves.
 */
#ifndef BVH_LAYOUT_H
#define BVH_LAYOUT_H
#include "shared.h"

/* Child references. A leaf names a range of 1 to BVH_MAX_LEAF triangles, or exactly one instance. A child
 * that does not exist has the box of one point at BVH_FAR on every axis, which no ray reaches (rays end
 * before BVH_FAR_T). */
#define BVH_LEAF        0x80000000u
#define BVH_COUNT_SHIFT 27 /* bits 27 to 30: triangles in the leaf, less one */
#define BVH_COUNT_MASK  15u
#define BVH_INDEX_MASK  0x07ffffffu /* inner node, first triangle or instance */
#define BVH_MAX_LEAF    8u
#define BVH_FAR         1e38f
#define BVH_FAR_T       1e30f

/* Depth of the deepest leaf, and so the most references a stack can hold. The builder turns to even halves
 * where the surface-area heuristic would go deeper: 2^26 triangles still fit. */
#define BVH_MAX_DEPTH 32

/* Steps after which a ray is given up, so that a damaged node cannot hang the device; ordinary rays take
 * hundreds. Mesa 22.3's lavapipe ends all loops of a shader by itself, silently, after 65,535 rounds
 * together: this must come first. */
#define BVH_MAX_STEPS 16384u

/* Two children. Each vector is (left minimum, left maximum, right minimum, right maximum) along its axis. */
struct bvh_node {
    vec4 x, y, z;
    uvec4 child; /* x: left, y: right; z, w: 0 */
};

/* A triangle in leaf order, object space; uints so that no load can change the bits of the index. */
struct bvh_triangle {
    uvec4 vertex[3]; /* xyz: position as float bits; vertex[0].w: the triangle's index within its mesh */
};

SHARED_SIZE(bvh_node, 64);
SHARED_SIZE(bvh_triangle, 48);
#endif
