#version 460
#extension GL_GOOGLE_include_directive : require
// photon_tree.comp: sorts the frame's photons into a tree of boxes around their footprints.
// PHASE 0: chain points are listed, and a box around all of them; PHASE 1: photons that meet it find their bucket and
// their rank there; PHASE 2: buckets get their part of the order; PHASE 3: photons go to their places; PHASE 4: a level
// of nodes. What comes first in list, bucket and order depends on who was first; what is summed over them does not.
//
// Reads   chain points, photons to be looked up
// Writes  list of points, nodes, places (bucket and rank), order: photons by bucket
// Source  design 8
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(constant_id = 8) const uint PHASE = 0u;
layout(std430, binding = BINDING_PASS + 1) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer chain_buffer { chain_point chains[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer seen_buffer { lookup_photon seen[]; };
layout(std430, binding = BINDING_PASS + 4) buffer node_buffer { tree_node nodes[]; };
layout(std430, binding = BINDING_PASS + 5) buffer place_buffer { uvec2 photon_places[]; };
layout(std430, binding = BINDING_PASS + 6) writeonly buffer order_buffer { tree_photon order[]; };
layout(std430, binding = BINDING_PASS + 7) buffer list_buffer { uint point_list[]; };
layout(std430, binding = BINDING_PASS + 8) writeonly buffer chain_place_buffer { uvec2 places[]; };
layout(push_constant) uniform push_block { uint level; };
#include "photon_tree.glsl"
#include "lookup_points.glsl"
#include "hand_out.glsl"

void list_point(uint number)
{
    if (!point_is_used(number))
        return;
    bool exists = chain_exists(chains[number]);
    places[number] = uvec2(exists ? number : NONE, 0u);
    if (!exists)
        return;
    point_list[atomicAdd(lookup.listed, 1u)] = number;
    atomicAdd(lookup.count[LOOKUP_COUNT_POINTS], 1u);
    vec3 position = chains[number].position_normal.xyz;
    float extent = point_extent(chains[number]);
    uvec3 low = ~ordered_words(position - extent), high = ordered_words(position + extent);
    atomicMax(lookup.low_x, low.x);
    atomicMax(lookup.low_y, low.y);
    atomicMax(lookup.low_z, low.z);
    atomicMax(lookup.high_x, high.x);
    atomicMax(lookup.high_y, high.y);
    atomicMax(lookup.high_z, high.z);
}

vec3 footprint_extent(lookup_photon p)
{
    vec3 n = unpack_normal(floatBitsToUint(p.position.w)), t1, t2;
    tangent_frame(n, t1, t2);
    vec4 c = p.covariance;
    return 1.0001 * (sqrt(max(c.x * t1 * t1 + 2.0 * c.y * t1 * t2 + c.z * t2 * t2, vec3(0.0))) + c.w * abs(n));
}

uint bucket_of(vec3 position, float size)
{
    vec3 low = bounds_low(), extent = bounds_high() - low;
    float longest = max(extent.x, max(extent.y, extent.z));
    // sizes in steps of four, those above an eighth of the box together
    uint bucket = uint(clamp(0.5 * log2(size / longest) + 4.5, 0.0, 3.0));
    vec3 at = position - low;
    for (uint bit = 2u; bit < 3u * TREE_LEVELS; bit++) {
        uint axis = extent.x >= extent.y && extent.x >= extent.z ? 0u : extent.y >= extent.z ? 1u : 2u;
        extent[axis] *= 0.5;
        bool is_upper = at[axis] >= extent[axis];
        at[axis] -= is_upper ? extent[axis] : 0.0;
        bucket = 2u * bucket + (is_upper ? 1u : 0u);
    }
    return bucket;
}

void insert(uint index)
{
    uvec2 place = uvec2(NONE, 0u);
    lookup_photon p = seen[index];
    if (p.cell != NONE && lookup.listed > 0u) {
        vec3 extent = footprint_extent(p);
        uvec3 low = ~ordered_words(p.position.xyz - extent), high = ordered_words(p.position.xyz + extent);
        if (all(greaterThanEqual(high, ~uvec3(lookup.low_x, lookup.low_y, lookup.low_z))) &&
            all(lessThanEqual(~low, uvec3(lookup.high_x, lookup.high_y, lookup.high_z)))) {
            place.x = bucket_of(p.position.xyz, max(extent.x, max(extent.y, extent.z)));
            place.y = atomicAdd(nodes[place.x].count, 1u);
            atomicMax(nodes[place.x].low_x, low.x);
            atomicMax(nodes[place.x].low_y, low.y);
            atomicMax(nodes[place.x].low_z, low.z);
            atomicMax(nodes[place.x].high_x, high.x);
            atomicMax(nodes[place.x].high_y, high.y);
            atomicMax(nodes[place.x].high_z, high.z);
        }
    }
    photon_places[index] = place;
}

void join(uint node)
{
    if (node >= uint(TREE_BUCKETS) >> (3u * level))
        return;
    uint below = tree_first(level - 1u) + 8u * node, here = tree_first(level) + node;
    uvec3 low = uvec3(0u), high = uvec3(0u);
    for (uint k = 0u; k < 8u; k++) {
        low = max(low, uvec3(nodes[below + k].low_x, nodes[below + k].low_y, nodes[below + k].low_z));
        high = max(high, uvec3(nodes[below + k].high_x, nodes[below + k].high_y, nodes[below + k].high_z));
    }
    nodes[here].low_x = low.x;
    nodes[here].low_y = low.y;
    nodes[here].low_z = low.z;
    nodes[here].high_x = high.x;
    nodes[here].high_y = high.y;
    nodes[here].high_z = high.z;
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    if (PHASE == 0u) {
        list_point(index);
    } else if (PHASE == 2u) {
        uint count = index < uint(TREE_BUCKETS) ? nodes[index].count : 0u;
        uint first = hand_out(count);
        if (count > 0u)
            nodes[index].first = first;
    } else if (PHASE == 4u) {
        join(index);
    } else if (index < counters.photon_count) {
        if (PHASE == 1u)
            insert(index);
        else if (photon_places[index].x != NONE) {
            vec4 c = seen[index].covariance;
            uint at = nodes[photon_places[index].x].first + photon_places[index].y;
            order[at].x = seen[index].position.x;
            order[at].y = seen[index].position.y;
            order[at].z = seen[index].position.z;
            order[at].radius = 1.0001 * (sqrt(c.x + c.z) + c.w);
            order[at].number = index;
        }
    }
}
