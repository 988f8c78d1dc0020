// gpu_trace.comp: one ray per thread, down a grid of starting points, through an acceleration structure.
#version 460
#extension GL_EXT_ray_query : require
layout(local_size_x = 64) in;
struct hit {
    float t;
    uint instance; // 0xffffffff: none
    uint triangle;
    float u, v;
    uint unused0, unused1, unused2;
};
layout(set = 0, binding = 0) uniform accelerationStructureEXT top;
layout(set = 0, binding = 1) readonly buffer Rays { vec4 rays[]; }; // origin, then direction
layout(set = 0, binding = 2) writeonly buffer Hits { hit hits[]; };

void main()
{
    uint i = gl_GlobalInvocationID.x;
    if (i >= hits.length()) {
        return;
    }
    rayQueryEXT query;
    rayQueryInitializeEXT(query, top, gl_RayFlagsOpaqueEXT, 0xff, rays[2 * i].xyz, 0, rays[2 * i + 1].xyz, 1e30);
    while (rayQueryProceedEXT(query)) {
    }
    hit h = hit(0, 0xffffffffu, 0, 0, 0, 0, 0, 0);
    if (rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionTriangleEXT) {
        vec2 barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, true);
        h.t = rayQueryGetIntersectionTEXT(query, true);
        h.instance = rayQueryGetIntersectionInstanceCustomIndexEXT(query, true);
        h.triangle = rayQueryGetIntersectionPrimitiveIndexEXT(query, true);
        h.u = barycentrics.x;
        h.v = barycentrics.y;
    }
    hits[i] = h;
}
