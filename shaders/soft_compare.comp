#version 460
#extension GL_GOOGLE_include_directive : require
// soft_compare.comp: how far the picture made with differentials of the emitter is from the one made with samples of it.
//
// Reads   irradiance of both
// Writes  counters: sums over all pixels of the difference and of the irradiance by samples
// Source  design 6; docs/aaps.md
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) readonly buffer samples_buffer { vec4 by_samples[]; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer differentials_buffer { vec4 by_differentials[]; };

void main()
{
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= frame.width * frame.height)
        return;
    float total = channel_sum(by_samples[pixel].xyz) / frame.irradiance_unit;
    float difference = abs(channel_sum(by_samples[pixel].xyz - by_differentials[pixel].xyz)) / frame.irradiance_unit;
    bool is_exact;
    ADD_FIXED(counters.flux_low[SUM_SOFT_DIFFERENCE], counters.flux_high[SUM_SOFT_DIFFERENCE], difference, is_exact);
    ADD_FIXED(counters.flux_low[SUM_SOFT_TOTAL], counters.flux_high[SUM_SOFT_TOTAL], total, is_exact);
}
