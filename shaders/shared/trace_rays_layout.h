/* trace_rays_layout.h: what trace_rays.comp reads and writes. */
#ifndef TRACE_RAYS_LAYOUT_H
#define TRACE_RAYS_LAYOUT_H
#include "shared.h"

struct trace_ray_gpu {
    vec4 origin_t_max;
    vec4 direction; /* w: unused */
};

struct trace_hit_gpu {
    uvec4 hit; /* t as float bits, instance (0xffffffff: missed), triangle, 1 if the iteration cap ended it */
    vec4 barycentrics; /* x, y: weights of vertices 1 and 2 */
};

struct trace_rays_push {
    uint ray_count;
    uint stride; /* every stride-th ray is traced, so that subgroups are partly idle; the hits of others stay
                    as they are */
};

SHARED_SIZE(trace_ray_gpu, 32);
SHARED_SIZE(trace_hit_gpu, 32);
#endif
