#version 460
#extension GL_GOOGLE_include_directive : require
// compose.comp: writes the requested channels, averaged over subframes, ready for reading back.
//
// Reads   surfaces, irradiance, caustics seen through glass and mirrors
// Writes  channels, one after the other, each width * height * components floats
// Source  design 4 (radiance is albedo/pi times irradiance), 14 (channels)
#include "frame.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS) readonly buffer surface_buffer { surface_gpu surfaces[]; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer irradiance_buffer { vec4 irradiance[]; };
layout(std430, binding = BINDING_PASS + 2) buffer output_buffer { float outputs[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer indirect_buffer { vec4 indirect[]; };
layout(push_constant) uniform push_block { uint channel_mask; };

void put(inout uint offset, uint pixel, vec3 value)
{
    uint at = offset + 3u * pixel;
    bool adds = frame.subframe > 0u;
    value *= frame.subframe_weight;
    outputs[at] = (adds ? outputs[at] : 0.0) + value.x;
    outputs[at + 1u] = (adds ? outputs[at + 1u] : 0.0) + value.y;
    outputs[at + 2u] = (adds ? outputs[at + 2u] : 0.0) + value.z;
    offset += 3u * frame.width * frame.height;
}

void main()
{
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= frame.width * frame.height)
        return;
    surface_gpu s = surfaces[pixel];
    bool direct = s.normal.w == 1.0;
    vec3 sum = has(FEATURE_CAUSTICS) ? irradiance[pixel].xyz : vec3(0.0);
    vec3 caustics, received;
    if (AA == AA_PIXEL) {
        // sums carry the albedo of the very point each photon met
        caustics = sum / PI;
        received = direct ? mix(vec3(0.0), sum / max(s.albedo.xyz, vec3(1e-6)), greaterThan(s.albedo.xyz, vec3(0.0))) : vec3(0.0);
    } else {
        received = direct ? sum : vec3(0.0);
        caustics = received * s.albedo.xyz / PI;
    }
    vec3 looked_up = has(FEATURE_LOOKUP) ? indirect[pixel].xyz : vec3(0.0);
    uint offset = 0u;
    if ((channel_mask & 1u) != 0u)
        put(offset, pixel, caustics);
    if ((channel_mask & 2u) != 0u)
        put(offset, pixel, received);
    if ((channel_mask & 4u) != 0u)
        put(offset, pixel, s.radiance.xyz + caustics + looked_up);
    if ((channel_mask & 8u) != 0u) {
        // depth, normal and albedo of the first subframe: averages of them mean nothing
        if (frame.subframe == 0u)
            outputs[offset + pixel] = s.relative_position.w;
        offset += frame.width * frame.height;
    }
    uint pixel_words = 3u * frame.width * frame.height;
    if (frame.subframe == 0u) {
        vec3 scale = vec3(1.0 / frame.subframe_weight);
        if ((channel_mask & 16u) != 0u)
            put(offset, pixel, s.normal.xyz * scale);
        if ((channel_mask & 32u) != 0u)
            put(offset, pixel, s.albedo.xyz * scale);
    } else
        offset += pixel_words * (((channel_mask >> 4) & 1u) + ((channel_mask >> 5) & 1u));
    if ((channel_mask & 64u) != 0u)
        put(offset, pixel, looked_up);
}
