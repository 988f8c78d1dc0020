#version 460
#extension GL_GOOGLE_include_directive : require
// trace_rays.comp: traces a list of rays, for tests and the benchmark.
//
// Reads   bindings 0 to 3, rays
// Writes  a hit per ray: t, instance, triangle, guard, barycentrics; with ANY set only whether there is one
// Source  design 12
#include "shared/scene_layout.h"
#include "shared/trace_rays_layout.h"
layout(constant_id = 0) const bool ANY = false;
layout(constant_id = 1) const bool ALL_LANES = false;
#include "trace.glsl"
layout(local_size_x = 64) in;
layout(std430, binding = BINDING_PASS) readonly buffer ray_buffer { trace_ray_gpu rays[]; };
layout(std430, binding = BINDING_PASS + 1) writeonly buffer hit_buffer { trace_hit_gpu hits[]; };
layout(push_constant) uniform push_block { trace_rays_push push; };

void main()
{
    uint index = gl_GlobalInvocationID.x;
    bool has_ray = index < push.ray_count && index % push.stride == 0u;
    if (!ALL_LANES && !has_ray)
        return;
    uint place = has_ray ? index : 0u;
    vec4 origin = rays[place].origin_t_max;
    vec3 direction = rays[place].direction.xyz;
    float t_max = has_ray ? origin.w : 0.0;
    trace_hit_gpu result;
    if (ANY) {
        bool is_hit = ALL_LANES ? trace_any_all(origin.xyz, direction, t_max)
                                : trace_any(origin.xyz, direction, t_max);
        result.hit = uvec4(0u, is_hit ? 0u : TRACE_MISS, 0u, trace_guard);
        result.barycentrics = vec4(0.0);
    } else {
        trace_hit hit;
        if (ALL_LANES)
            hit = trace_closest_all(origin.xyz, direction, t_max);
        else
            hit = trace_closest(origin.xyz, direction, t_max);
        result.hit = uvec4(floatBitsToUint(hit.t), hit.instance, hit.triangle, trace_guard);
        result.barycentrics = vec4(hit.barycentrics, 0.0, 0.0);
    }
    if (has_ray)
        hits[index] = result;
}
