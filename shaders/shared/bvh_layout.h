/* bvh_layout.h: the hierarchies of the `bvh` tracer as the host builds them and the shader reads them.
 *
 * The node buffer holds the top level first (node 0 is its header), then the bottom level of every mesh. A
 * reference is relative to its own tree: the shader adds scene_instance_gpu.bvh_root to inner nodes and
 * scene_instance_gpu.bvh_triangle to the triangles of leaves.
 */
#ifndef BVH_LAYOUT_H
#define BVH_LAYOUT_H
#include "shared.h"

/* References: bit 31 marks a leaf. Bits 0 to 26 are then its first triangle and bits 27 to 30 the number of
 * triangles less one, or bits 0 to 26 are its one instance; without bit 31 they are the number of an inner
 * node. */
#define BVH_LEAF        0x80000000u
#define BVH_COUNT_SHIFT 27
#define BVH_COUNT_MASK  15u
#define BVH_INDEX_MASK  0x07ffffffu
#define BVH_MAX_LEAF    8u          /* triangles */
#define BVH_DONE        0xffffffffu /* nothing (left) to visit; a leaf, so that loops over inner nodes end */
#define BVH_FAR_T       1e30f       /* rays end here at the latest */

/* Depth of the deepest leaf, and so the most references a stack can hold. The builder turns to even halves
 * where the surface-area heuristic would go deeper: 2^26 triangles still fit. */
#define BVH_MAX_DEPTH 31

/* Nodes and triangles together after which a ray is given up, so that a damaged node cannot hang the device;
 * ordinary rays take hundreds. Mesa 22.3's lavapipe ends all loops of a shader by itself, silently, after
 * 65,535 rounds together, those of up to three rays and of the ledger among them: this must come first. A
 * leaf takes a round more than it has triangles. */
#define BVH_MAX_STEPS 8192u

/* Two children with their boxes on a grid over the tree, 16 bits a plane, rounded outward: a node is read as
 * eight words, one for each lane of a packet. A span holds the minimum in its low and the maximum in its high
 * half. */
struct bvh_node {
    uint left_x, right_x, left_y, right_y, left_z, right_z;
    uint left, right; /* references */
};

/* What stands in place of a tree's node 0. A grid place g is at origin + g * scale; scale is a power of two,
 * so that going to the grid rounds nothing but the difference. */
struct bvh_header {
    uint origin[3]; /* float bits */
    uint scale[3];  /* float bits */
    uint root;      /* reference to node 1, to the only leaf, or BVH_DONE for a tree of nothing */
    uint unused;
};

/* A triangle in leaf order, object space; uints so that no load can change the bits of the index. */
struct bvh_triangle {
    uvec4 vertex[3]; /* xyz: position as float bits; vertex[0].w: the triangle's index within its mesh */
};

SHARED_SIZE(bvh_node, 32);
SHARED_SIZE(bvh_header, 32);
SHARED_SIZE(bvh_triangle, 48);
#endif
