#version 460
#extension GL_GOOGLE_include_directive : require
// feedback.comp: every photon reports to its cell: projected area, its root with the flux, and how much the picture
// changed where it landed.
//
// Reads   photons, irradiance now and of the last frame
// Writes  feedback per cell, 64-bit fixed point
// Source  design 5; aaps-thesis 2.3.2, 3.1.5
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) readonly buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 2) buffer feedback_buffer { feedback_gpu feedback[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer irradiance_buffer { vec4 irradiance[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer old_buffer { vec4 old_irradiance[]; };

// Relative change of luminance between the photon's pixel and where that point was last frame, in [0, 1].
float change_at(photon p)
{
    vec2 now = p.center.xy;
    vec3 relative = p.position.xyz + (frame.eye.xyz - frame.old_eye.xyz);
    float z = dot(relative, frame.old_forward.xyz);
    vec2 size = vec2(float(frame.width), float(frame.height));
    if (!(z > 0.0) || any(lessThan(now, vec2(0.0))) || any(greaterThanEqual(now, size)))
        return 0.0;
    vec2 before = frame.old_scale.zw +
                  frame.old_scale.xy * vec2(dot(relative, frame.old_right.xyz), dot(relative, frame.old_up.xyz)) / z;
    if (any(lessThan(before, vec2(0.0))) || any(greaterThanEqual(before, size)))
        return 0.0;
    float a = luminance(irradiance[uint(now.y) * frame.width + uint(now.x)].xyz);
    float b = luminance(old_irradiance[uint(before.y) * frame.width + uint(before.x)].xyz);
    float sum = a + b;
    return sum > 0.0 ? abs(a - b) / sum : 0.0;
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    if (index >= counters.photon_count)
        return;
    photon p = photons[index];
    if (p.cell == NONE || !(p.area > 0.0))
        return;
    bool is_exact;
    bool is_weak = (p.cell & CELL_WEAK) != 0u;
    p.cell &= ~CELL_WEAK;
    if (is_weak)
        ADD_FIXED(feedback[p.cell].weak_low, feedback[p.cell].weak_high, p.root * 1048576.0, is_exact);
    ADD_FIXED(feedback[p.cell].area_low, feedback[p.cell].area_high, p.area * 65536.0, is_exact);
    ADD_FIXED(feedback[p.cell].root_low, feedback[p.cell].root_high, p.root * 1048576.0, is_exact);
    if (has(FEATURE_VARIANCE) && (frame.flags & FLAG_HAS_PREVIOUS) != 0u)
        ADD_FIXED(feedback[p.cell].change_low, feedback[p.cell].change_high, p.share * change_at(p) * 16777216.0, is_exact);
}
