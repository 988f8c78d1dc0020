#version 460
#extension GL_GOOGLE_include_directive : require
// temporal.comp: blends the irradiance with that of the frames before, found again where the surface was then and kept
// within what the pixel's neighbourhood shows now.
//
// Reads   targets and irradiance, now; blended irradiance and targets of the last frame
// Writes  blended irradiance; w: frames in it
// Source  aaps-thesis 6.6
#include "frame.glsl"
#include "targets.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer irradiance_buffer { vec4 irradiance[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer history_buffer { vec4 history[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer old_target_buffer { target_gpu old_targets[]; };
layout(std430, binding = BINDING_PASS + 5) writeonly buffer blended_buffer { vec4 blended[]; };
layout(push_constant) uniform push_block { float most; }; // share of the history kept; 0: there is none

// Image position of the last frame, to 1/256 px: what stands still is then found at the very pixel. Below 0: not seen.
vec2 place_before(vec3 relative)
{
    float z = dot(relative, frame.old_forward.xyz);
    if (!(z > 0.0))
        return vec2(-1.0);
    vec2 place = frame.old_scale.zw +
                 frame.old_scale.xy * vec2(dot(relative, frame.old_right.xyz), dot(relative, frame.old_up.xyz)) / z;
    return floor(place * 256.0 + 0.5) * (1.0 / 256.0);
}

// Bilinear between the pixels that showed this surface; w: the fewest frames in any of them, 0 where none did.
vec4 history_of(target_gpu target, out bool is_between)
{
    vec3 relative = target.position_normal.xyz + (frame.eye.xyz - frame.old_eye.xyz);
    vec3 normal = unpack_normal(floatBitsToUint(target.position_normal.w));
    vec2 place = place_before(relative) - 0.5;
    vec2 low = floor(place), f = place - low;
    is_between = f != vec2(0.0);
    float slack = dot(relative, frame.old_forward.xyz) * sqrt(frame.forward.w); // a pixel's width
    vec3 sum = vec3(0.0);
    float weight = 0.0, frames = 1e9;
    for (uint k = 0u; k < 4u; k++) {
        ivec2 at = ivec2(low) + ivec2(int(k & 1u), int(k >> 1));
        float w = ((k & 1u) == 0u ? 1.0 - f.x : f.x) * ((k >> 1) == 0u ? 1.0 - f.y : f.y);
        if (w == 0.0 || any(lessThan(at, ivec2(0))) || at.x >= int(frame.width) || at.y >= int(frame.height))
            continue;
        uint pixel = uint(at.y) * frame.width + uint(at.x);
        target_gpu old = old_targets[pixel];
        if (!target_exists(old) || abs(dot(old.position_normal.xyz - relative, normal)) > slack ||
            dot(unpack_normal(floatBitsToUint(old.position_normal.w)), normal) < 0.9)
            continue;
        vec4 value = history[pixel];
        sum += w * value.xyz;
        weight += w;
        frames = min(frames, value.w);
    }
    // a sliver of one pixel is no history of this one
    return weight >= 0.25 ? vec4(sum / weight, frames) : vec4(0.0);
}

void main()
{
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= frame.width * frame.height)
        return;
    vec3 now = irradiance[pixel].xyz;
    bool is_between = false;
    vec4 before = vec4(0.0);
    if (most > 0.0 && target_exists(targets[pixel]))
        before = history_of(targets[pixel], is_between);
    if (before.w == 0.0) {
        blended[pixel] = vec4(now, 1.0);
        return;
    }
    vec3 least = now, largest = now;
    ivec2 place = ivec2(int(pixel % frame.width), int(pixel / frame.width));
    for (int k = 0; k < 9; k++) {
        ivec2 at = place + ivec2(k % 3 - 1, k / 3 - 1);
        if (any(lessThan(at, ivec2(0))) || at.x >= int(frame.width) || at.y >= int(frame.height))
            continue;
        uint other = uint(at.y) * frame.width + uint(at.x);
        if (!target_exists(targets[other]))
            continue;
        least = min(least, irradiance[other].xyz);
        largest = max(largest, irradiance[other].xyz);
    }
    // the mean of all frames so far, until that is worth more than the share asked for
    float share = min(most, before.w / (before.w + 1.0));
    vec3 range = largest - least;
    if (is_between) {
        // Every look between pixels blurs, which shows where the picture is uneven. On `sphere` in motion (1 - contrast)^2
        // made the error of the spot 5 % larger; with this it is what it was.
        float contrast = luminance(range) / max(luminance(largest + least), 1e-30);
        share *= max(1.0 - 1.5 * contrast, 0.0);
    } else {
        // the very pixel: a peak must not be cut because its own noise is low at the moment
        least -= 0.5 * range;
        largest += 0.5 * range;
    }
    blended[pixel] = vec4(now + share * (clamp(before.xyz, least, largest) - now), min(before.w + 1.0, 1024.0));
}
