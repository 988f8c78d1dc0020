#version 460
#extension GL_GOOGLE_include_directive : require
// lookup_report.comp: what of each photon is seen through glass and mirrors, for the feedback.
//
// Reads   photons to be looked up, shares of lookup_gather.comp
// Writes  area and root of photons, counts
// Source  design 5 (feedback), 8
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer seen_buffer { lookup_photon seen[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer share_buffer { uvec2 shares[]; };
layout(std430, binding = BINDING_PASS + 7) buffer photon_buffer { photon photons[]; };
#include "lookup_report.glsl"

void main()
{
    uint index = gl_GlobalInvocationID.x;
    uint counts = 0u;
    if (index < counters.photon_count && seen[index].cell != NONE) {
        counts = shares[index] != uvec2(0u) ? 0x10001u : 1u;
        report(index, shares[index]);
    }
    uint sum = group_count(counts);
    if (gl_LocalInvocationIndex == 0u) {
        atomicAdd(lookup.count[LOOKUP_COUNT_PHOTONS], sum & 0xffffu);
        atomicAdd(lookup.count[LOOKUP_COUNT_SEEN], sum >> 16);
    }
}
