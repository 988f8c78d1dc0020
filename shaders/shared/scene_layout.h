/* scene_layout.h: the scene as shaders see it. Bindings 0 to 9 of every pass that touches geometry. */
#ifndef SCENE_LAYOUT_H
#define SCENE_LAYOUT_H
#include "shared.h"

#define BINDING_NODES                                                                                        \
    0 /* bvh nodes (bottom levels, then the top level), or the top-level acceleration structure */
#define BINDING_TRIANGLES      1 /* bvh triangles; bvh tracer only */
#define BINDING_MORE_TRIANGLES 2 /* those past the first buffer's; the first buffer where there are none */
#define BINDING_INSTANCES      3
#define BINDING_VERTICES       4
#define BINDING_INDICES        5
#define BINDING_MATERIALS      6
#define BINDING_TEXELS         7
#define BINDING_LIGHTS         8
#define BINDING_FRAME          9
#define BINDING_PASS           10 /* the first binding a pass has for itself */

/* constant_id 5: how many bvh triangles the first buffer holds, 0 where it holds all. A device may take less
 * in one buffer than a scene has: lavapipe 128 MiB, 2.8 million triangles. */
#define CONSTANT_FIRST_TRIANGLES 5

struct scene_vertex_gpu {
    vec4 position_u; /* object space */
    vec4 normal_v;
};

struct scene_instance_gpu {
    vec4 to_world[3]; /* rows of 3x4 */
    vec4 to_object[3];
    uint first_index; /* of its mesh in the index list; indices are absolute vertex numbers */
    uint material;
    uint bvh_root;     /* first node of the mesh's bottom-level tree; bvh tracer only */
    uint bvh_triangle; /* its mesh's first triangle, counted through both buffers; bvh tracer only */
};

SHARED_SIZE(scene_vertex_gpu, 32);
SHARED_SIZE(scene_instance_gpu, 112);
#endif
