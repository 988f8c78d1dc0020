#version 460
#extension GL_GOOGLE_include_directive : require
// lookup_resolve.comp: from the irradiance of a pixel's chain points to radiance toward the camera.
//
// Reads   places of chain points, their irradiance sums and weights; broken pixels
// Writes  radiance of caustic light seen through glass and mirrors, rgb per pixel, W/(m^2 sr)
// Source  design 4, 8
#include "frame.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS) readonly buffer place_buffer { uvec2 places[]; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer sum_buffer { uint sums[]; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer weight_buffer { vec4 weights[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer indirect_buffer { vec4 indirect[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer broken_buffer { uint broken[]; };

vec3 radiance_of(uint number)
{
    uint place = places[number].x;
    if (place == NONE)
        return vec3(0.0);
    vec3 value;
    if (has(FEATURE_CHROMATIC))
        value = vec3(fixed_value_of(sums[6u * place], sums[6u * place + 1u]),
                     fixed_value_of(sums[6u * place + 2u], sums[6u * place + 3u]),
                     fixed_value_of(sums[6u * place + 4u], sums[6u * place + 5u]));
    else
        value = vec3(fixed_value_of(sums[2u * place], sums[2u * place + 1u])) * frame.tint.xyz;
    return value * frame.irradiance_unit * weights[number].xyz;
}

void main()
{
    uint pixel = gl_GlobalInvocationID.x, pixels = frame.width * frame.height;
    if (pixel >= pixels)
        return;
    vec3 radiance = vec3(0.0);
    for (uint layer = 0u; layer < frame.camera_branches; layer++)
        radiance += radiance_of(layer * pixels + pixel);
    if (has(FEATURE_SAMPLES) && broken[pixels + pixel] != NONE) {
        uint each = samples_each(lookup.broken, lookup.shown), first = sample_first() + each * broken[pixels + pixel];
        for (uint k = 0u; k < (each > 1u ? each : 0u); k++)
            for (uint layer = 0u; layer < frame.camera_branches; layer++)
                radiance += radiance_of(first + k + layer * frame.sample_capacity);
    }
    indirect[pixel] = vec4(radiance, 0.0);
}
