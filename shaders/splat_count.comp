#version 460
#extension GL_GOOGLE_include_directive : require
// splat_count.comp: counts the photons whose quads reached a pixel.
//
// Reads   marks of the photons
// Writes  photons that contributed, added to the counter
// Source  aaps-thesis 4.5.2
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) readonly buffer reached_buffer { uint reached[]; };

void main()
{
    uint index = gl_GlobalInvocationID.x;
    uint sum = group_count(index < counters.photon_count ? reached[index] : 0u);
    if (sum != 0u)
        atomicAdd(counters.count[COUNT_CONTRIBUTING], sum);
}
