// trace_khr.glsl: VK_KHR_ray_query over the top-level acceleration structure.
//
// Reads   binding 0 (top-level structure; custom index = instance)
// Source  design 12
#include "scene_instances.glsl"
#extension GL_EXT_ray_query : require

layout(binding = BINDING_NODES) uniform accelerationStructureEXT scene_structure;

const uint trace_guard = 0u; // the driver's traversal ends by itself
#ifdef TRACE_EXCLUDES
uint trace_excluded = TRACE_MISS; // an instance that is not there
#endif

// Vulkan wants directions and distances that are finite; farther than this nothing is looked for.
const float TRACE_FAR = 1e30;

trace_hit trace_closest(vec3 origin, vec3 direction, float t_max)
{
    trace_hit hit;
    hit.t = t_max;
    hit.instance = TRACE_MISS;
    hit.triangle = 0u;
    hit.barycentrics = vec2(0.0);
    rayQueryEXT query;
    uint flags = gl_RayFlagsOpaqueEXT;
#ifdef TRACE_EXCLUDES
    if (has(FEATURE_CONTACT) && trace_excluded != TRACE_MISS)
        flags = gl_RayFlagsNoOpaqueEXT; // hits are then offered, not taken
#endif
    rayQueryInitializeEXT(query, scene_structure, flags, 0xff, origin, 0.0, direction, clamp(t_max, 0.0, TRACE_FAR));
    while (rayQueryProceedEXT(query)) {
#ifdef TRACE_EXCLUDES
        if (has(FEATURE_CONTACT) &&
            uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false)) != trace_excluded)
            rayQueryConfirmIntersectionEXT(query);
#endif
    }
    if (rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionTriangleEXT) {
        hit.t = rayQueryGetIntersectionTEXT(query, true);
        hit.instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, true));
        hit.triangle = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, true));
        hit.barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, true);
    }
    return hit;
}

bool trace_any(vec3 origin, vec3 direction, float t_max)
{
    rayQueryEXT query;
    rayQueryInitializeEXT(query, scene_structure, gl_RayFlagsOpaqueEXT | gl_RayFlagsTerminateOnFirstHitEXT, 0xff, origin,
                          0.0, direction, clamp(t_max, 0.0, TRACE_FAR));
    while (rayQueryProceedEXT(query))
        ;
    return rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionTriangleEXT;
}

trace_hit trace_closest_all(vec3 origin, vec3 direction, float t_max)
{
    return trace_closest(origin, direction, t_max);
}

bool trace_any_all(vec3 origin, vec3 direction, float t_max)
{
    return trace_any(origin, direction, t_max);
}
