#version 460
#extension GL_GOOGLE_include_directive : require
// photon_scan.comp: one workgroup; prefix sums over what the workgroups of a bounce produced, and the size of the
// next bounce.
//
// Reads   totals per workgroup
// Writes  their exclusive prefix sums, in place; counters: queue, photons, indirect sizes, stride
// Source  design 3 (photons ordered by task and branch, never by who finished first), 5 (budget)
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) buffer group_buffer { uvec2 group_totals[]; };
layout(push_constant) uniform push_block { uint parity; };
shared uvec2 part[GROUP_SIZE];

void main()
{
    uint i = gl_LocalInvocationIndex;
    uint groups = counters.queue[4u * parity];
    uint share = (groups + GROUP_SIZE - 1u) / GROUP_SIZE;
    uint first = min(i * share, groups), end = min(first + share, groups);
    uvec2 sum = uvec2(0u);
    for (uint k = first; k < end; k++)
        sum += group_totals[k];
    part[i] = sum;
    barrier();
    uvec2 before = uvec2(0u), all = uvec2(0u);
    for (uint k = 0u; k < GROUP_SIZE; k++) {
        before += k < i ? part[k] : uvec2(0u);
        all += part[k];
    }
    for (uint k = first; k < end; k++) {
        uvec2 own = group_totals[k];
        group_totals[k] = before;
        before += own;
    }
    barrier();
    if (i == 0u) {
        counters.count[COUNT_RAYS] += counters.queue[4u * parity + QUEUE_COUNT];
        counters.count[COUNT_STORED] += all.y;
        counters.photon_base = counters.photon_count;
        uint photons = counters.photon_count + all.y;
        counters.photon_count = photons;
        counters.photon_groups[0] = (photons + GROUP_SIZE - 1u) / GROUP_SIZE;
        counters.photon_quads[0] = 6u * photons;
        counters.photon_quads[1] = 1u;
        uint next = 4u * (1u - parity);
        counters.queue[next] = (all.x + GROUP_SIZE - 1u) / GROUP_SIZE;
        counters.queue[next + 1u] = 1u;
        counters.queue[next + 2u] = 1u;
        counters.queue[next + QUEUE_COUNT] = all.x;
        // every ray in flight must find room for its photon, whatever splits
        bool has_room = 2u * all.x <= frame.ray_capacity && photons + 2u * all.x <= frame.photon_capacity;
        counters.stride[1u - parity] = has_room ? 2u : 1u;
        if (has(FEATURE_DISPERSION) && 3u * all.x <= frame.ray_capacity && photons + 3u * all.x <= frame.photon_capacity)
            counters.stride[1u - parity] = 3u;
        if (!has_room)
            counters.count[COUNT_GUARD_SPLIT]++;
    }
}
