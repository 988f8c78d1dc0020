#version 460
#extension GL_GOOGLE_include_directive : require
// resolve.comp: turns the fixed-point sums, or what quads drew, into irradiance and integrates it over what the view sees.
//
// Reads   irradiance sums, irradiance of quads, targets
// Writes  irradiance, rgb per pixel (times albedo for aa=pixel); flux of the whole buffer
// Source  design 4, 7
#include "frame.glsl"
#include "light.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "targets.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer sum_buffer { uint sums[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer irradiance_buffer { vec4 irradiance[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer surface_buffer { surface_gpu surfaces[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer picture_buffer { vec4 picture[]; };
const bool HAS_QUADS = AA == AA_MSAA || AA == AA_MSAA_SAMPLE || AA == AA_MSAA_SMALL;
const bool HAS_SUMS = AA != AA_MSAA && AA != AA_MSAA_SAMPLE;

void main()
{
    uint pixel = gl_GlobalInvocationID.x;
    float flux = 0.0;
    if (pixel < frame.width * frame.height) {
        vec3 value = vec3(0.0);
        if (HAS_SUMS && has(FEATURE_CHROMATIC))
            value = vec3(fixed_value_of(sums[6u * pixel], sums[6u * pixel + 1u]),
                         fixed_value_of(sums[6u * pixel + 2u], sums[6u * pixel + 3u]),
                         fixed_value_of(sums[6u * pixel + 4u], sums[6u * pixel + 5u]));
        else if (HAS_SUMS)
            value = vec3(fixed_value_of(sums[2u * pixel], sums[2u * pixel + 1u])) * frame.tint.xyz;
        value *= frame.irradiance_unit;
        if (HAS_QUADS)
            value += picture[pixel].xyz;
        // With aa=pixel a pixel whose middle sees glass may hold light of a receiver beside it: a neighbour tells its area.
        uint lender = pixel;
        if (AA == AA_PIXEL && !target_exists(targets[pixel]) && value != vec3(0.0)) {
            ivec2 place = ivec2(int(pixel % frame.width), int(pixel / frame.width));
            for (uint k = 0u; k < 9u; k++) {
                ivec2 p = place + ivec2(int(k % 3u) - 1, int(k / 3u) - 1);
                if (all(greaterThanEqual(p, ivec2(0))) && p.x < int(frame.width) && p.y < int(frame.height)) {
                    uint other = uint(p.y) * frame.width + uint(p.x);
                    if (target_exists(targets[other]))
                        lender = other;
                }
            }
        }
        target_gpu target = targets[lender];
        if (target_exists(target)) {
            vec3 seen = value;
            if (AA == AA_PIXEL) {
                vec3 albedo = surfaces[lender].albedo.xyz;
                seen = mix(vec3(0.0), value / max(albedo, vec3(1e-6)), greaterThan(albedo, vec3(0.0)));
            }
            flux = channel_sum(seen) * pixel_world_area(target.position_normal.xyz,
                                                        unpack_normal(floatBitsToUint(target.position_normal.w)));
        }
        irradiance[pixel] = vec4(value, 0.0);
    }
    ledger_add(FATE_BUFFER, flux, 0.0);
}
