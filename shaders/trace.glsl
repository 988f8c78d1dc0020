// trace.glsl: the one ray-tracing interface of all passes; two tracers behind it (design 12).
//
// Reads   bindings 0 (nodes, or the top-level acceleration structure), 1 (triangles, bvh only), 2 (instances)
// Source  design 12
//
// Compiled twice: with TRACER_KHR defined as 1 for VK_KHR_ray_query, without for our own hierarchy.

struct trace_hit {
    float t;         // distance in units of |direction|
    uint  instance;  // TRACE_MISS when nothing was hit
    uint  triangle;  // index within the instance's mesh
    vec2  barycentrics; // weights of vertices 1 and 2
};

const uint TRACE_MISS = 0xffffffffu;

// trace_hit trace_closest(vec3 origin, vec3 direction, float t_max)   nearest hit in (0, t_max)
// bool      trace_any(vec3 origin, vec3 direction, float t_max)       whether there is any
// trace_closest_all, trace_any_all                                    the same where every invocation of the subgroup
//                                                                     calls, a lane without a ray with t_max 0: faster
//                                                                     where branches are masked, not skipped
// uint      trace_excluded                                            with TRACE_EXCLUDES defined: this instance is not
//                                                                     seen; TRACE_MISS for none (FEATURE_CONTACT)
// uint      trace_guard                                               1 after the iteration cap ended a ray
#ifdef TRACER_KHR
#include "trace_khr.glsl"
#else
#include "trace_bvh.glsl"
#endif
