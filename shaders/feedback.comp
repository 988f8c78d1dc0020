#version 460
#extension GL_GOOGLE_include_directive : require
// feedback.comp: every photon reports to its cell: projected area, its root with the flux, the error that its size
// makes, and how much the picture changed where it landed.
//
// Reads   photons, targets, irradiance now and of the last frame
// Writes  feedback per cell, 64-bit fixed point
// Source  design 5; aaps-thesis 2.3.2, 3.1.5
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "targets.glsl"
#include "branches.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 5) readonly buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 2) buffer feedback_buffer { feedback_gpu feedback[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer irradiance_buffer { vec4 irradiance[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer old_buffer { vec4 old_irradiance[]; };
layout(std430, binding = BINDING_PASS + 6) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 7) readonly buffer column_buffer { uint columns[]; };

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

// Luminance at an image position, bilinear between the pixels that show a receiver; below 0 where none does.
float luminance_at(vec2 place)
{
    vec2 low = floor(place - 0.5), f = place - 0.5 - low;
    float sum = 0.0, weight = 0.0;
    for (uint k = 0u; k < 4u; k++) {
        ivec2 at = ivec2(low) + ivec2(int(k & 1u), int(k >> 1));
        if (any(lessThan(at, ivec2(0))) || at.x >= int(frame.width) || at.y >= int(frame.height))
            continue;
        uint pixel = uint(at.y) * frame.width + uint(at.x);
        if (!target_exists(targets[pixel]))
            continue;
        float w = ((k & 1u) == 0u ? 1.0 - f.x : f.x) * ((k >> 1) == 0u ? 1.0 - f.y : f.y);
        sum += w * luminance(irradiance[pixel].xyz);
        weight += w;
    }
    return weight > 0.0 ? sum / weight : -1.0;
}

// Which part of a photon's flux lands in the wrong place because its stratum is as wide as it is, in u and v: a kernel of
// variance C / 6 blurs by half the picture's second difference over its own axes.
const float ERROR_LEAST = 0.001; // keeps cells comparable that make none

vec2 footprint_error(photon p)
{
    if (p.ellipse == vec4(0.0)) // seen through glass only: no place in the picture; its area stands for the error
        return vec2(ERROR_LEAST + min(p.area / ROOT_AREA_MAX, 1.0));
    vec2 center = p.center.xy;
    float here = luminance_at(center);
    float u00 = p.ellipse.x, u01 = p.ellipse.y, u11 = p.ellipse.z;
    float cyy = 1.0 / (u11 * u11);
    float cxy = -u01 / (u00 * u11 * u11);
    float cxx = 1.0 / (u00 * u00) + cxy * cxy / cyy;
    float filter2 = frame.filter_radius * frame.filter_radius;
    if (p.ellipse.w < 0.0) {
        // a box, without filter: of the variance C / 6 that a kernel has
        cxx = 0.5 * p.ellipse.x * p.ellipse.x + filter2;
        cyy = 0.5 * p.ellipse.y * p.ellipse.y + filter2;
        cxy = 0.0;
    }
    float middle = 0.5 * (cxx + cyy), apart = sqrt(0.25 * (cxx - cyy) * (cxx - cyy) + cxy * cxy);
    float major = middle + apart;
    vec2 axis = abs(cxx - major) > abs(cyy - major) ? vec2(cxy, major - cxx) : vec2(major - cyy, cxy);
    float size = length(axis);
    axis = size > 0.0 ? axis / size : vec2(1.0, 0.0);
    vec2 blur = vec2(0.0); // along the major and the minor axis
    vec2 width = max(vec2(major, middle - apart) - filter2, vec2(0.0));
    if (here > 0.0)
        for (uint k = 0u; k < 2u; k++) {
            float far = max(width[k], 1.0); // the picture has no differences below a pixel
            vec2 reach = sqrt(far) * (k == 0u ? axis : vec2(-axis.y, axis.x));
            float a = luminance_at(center + reach), b = luminance_at(center - reach);
            blur[k] = min(abs((a < 0.0 ? here : a) + (b < 0.0 ? here : b) - 2.0 * here) * (width[k] / far) / (12.0 * here), 1.0);
        }
    float from_u = float((p.shape >> 16) & 255u) / 255.0;
    vec2 error = vec2(mix(blur.y, blur.x, from_u), mix(blur.x, blur.y, from_u));
    return ERROR_LEAST + error;
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
    uint spacing = 1u << (p.cell >> CELL_SPACING_SHIFT);
    p.cell &= CELL_INDEX_MASK;
    if (DENSITY == DENSITY_ERROR_RULE) {
        float flux = p.root * p.root / clamp(p.area, ROOT_AREA_MIN, ROOT_AREA_MAX);
        // one that stands for n makes n times the error with their flux
        vec2 width = branch_width(columns[p.cell], tree[p.cell], spacing);
        vec2 error = flux * footprint_error(p) * (1073741824.0 / (width.x * width.y));
        ADD_FIXED(feedback[p.cell].error_u_low, feedback[p.cell].error_u_high, error.x, is_exact);
        ADD_FIXED(feedback[p.cell].error_v_low, feedback[p.cell].error_v_high, error.y, is_exact);
    }
    ADD_FIXED(feedback[p.cell].area_low, feedback[p.cell].area_high, p.area * 65536.0, is_exact);
    ADD_FIXED(feedback[p.cell].root_low, feedback[p.cell].root_high, p.root * 1048576.0, is_exact);
    if (has(FEATURE_VARIANCE) && (frame.flags & FLAG_HAS_PREVIOUS) != 0u)
        ADD_FIXED(feedback[p.cell].change_low, feedback[p.cell].change_high, unpackHalf2x16(p.shape).x * change_at(p) * 16777216.0, is_exact);
}
