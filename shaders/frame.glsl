// frame.glsl: the view's frame, its camera, features and counters. Included first by every pass of a view.
// Source  design 3, 4
#extension GL_EXT_control_flow_attributes : require
#include "shared/render_layout.h"

layout(constant_id = CONSTANT_FEATURES) const uint FEATURES = 0xffffffffu;
layout(constant_id = CONSTANT_SPLIT) const uint SPLIT = SPLIT_ENERGY_RULE;
layout(constant_id = CONSTANT_DENSITY) const uint DENSITY = DENSITY_SQRT_RULE;
layout(constant_id = CONSTANT_AA) const uint AA = AA_FILTER;
layout(constant_id = CONSTANT_DEPTH) const uint DEPTH = DEPTH_PLANE;

bool has(uint feature)
{
    return (FEATURES & feature) != 0u;
}

layout(std430, binding = BINDING_FRAME) readonly buffer frame_buffer { frame_gpu frame; };

const float PI = 3.14159265358979;

// A pixel position's ray; not unit: dot(d, forward) = 1.
vec3 camera_ray(vec2 pixel)
{
    return frame.ray_origin.xyz + pixel.x * frame.ray_x.xyz + pixel.y * frame.ray_y.xyz;
}

// Pixel position of a point relative to the eye; only where dot(point, forward) > 0.
vec2 camera_project(vec3 relative)
{
    float z = dot(relative, frame.forward.xyz);
    return frame.center.zw + frame.center.xy * vec2(dot(relative, frame.right.xyz), dot(relative, frame.up.xyz)) / z;
}

// World area that one pixel covers on the plane through `relative` with this normal.
float pixel_world_area(vec3 relative, vec3 normal)
{
    float z = dot(relative, frame.forward.xyz);
    return frame.forward.w * z * z * z / max(abs(dot(normal, relative)), 1e-12 * z);
}

// Octahedral packing of a unit vector, 2 x 16 bits.
uint pack_normal(vec3 n)
{
    n /= abs(n.x) + abs(n.y) + abs(n.z);
    vec2 folded = n.z >= 0.0 ? n.xy : (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
    return packSnorm2x16(folded);
}

vec3 unpack_normal(uint bits)
{
    vec2 f = unpackSnorm2x16(bits);
    vec3 n = vec3(f, 1.0 - abs(f.x) - abs(f.y));
    float t = max(-n.z, 0.0);
    n.xy -= vec2(n.x >= 0.0 ? t : -t, n.y >= 0.0 ? t : -t);
    return normalize(n);
}

// 32-bit hash (pcg) of a word; chained to hash several.
uint hash_word(uint value)
{
    uint state = value * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

uint hash_mix(uint hash, uint value)
{
    return hash_word(hash ^ (value * 0x9e3779b9u + 0x7f4a7c15u));
}

// Uniform in (0, 1).
float hash_unit(uint hash)
{
    return (float(hash >> 8) + 0.5) * (1.0 / 16777216.0);
}

float luminance(vec3 color)
{
    return dot(color, vec3(0.2126, 0.7152, 0.0722));
}

float channel_sum(vec3 color)
{
    return color.x + color.y + color.z;
}

bool is_finite(float x)
{
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

bool is_finite(vec3 x)
{
    return is_finite(x.x) && is_finite(x.y) && is_finite(x.z);
}

// Adds a non-negative float, in units of 1, to a 64-bit integer kept as two words: exact and independent of the
// order of additions. Returns false when the value was clamped to the range.
#define ADD_FIXED(low, high, value, is_exact)                                          \
    {                                                                                  \
        float fixed_value = floor(value + 0.5);                                        \
        bool fixed_fits = fixed_value < 4.6e18;                                        \
        fixed_value = fixed_fits ? fixed_value : 4.6e18;                               \
        uint fixed_high = uint(fixed_value * (1.0 / 4294967296.0));                    \
        uint fixed_low = uint(fixed_value - float(fixed_high) * 4294967296.0);         \
        if ((fixed_low | fixed_high) != 0u) {                                          \
            uint fixed_old = atomicAdd(low, fixed_low);                                \
            fixed_high += fixed_old + fixed_low < fixed_old ? 1u : 0u;                 \
            if (fixed_high != 0u)                                                      \
                atomicAdd(high, fixed_high);                                           \
        }                                                                              \
        is_exact = fixed_fits;                                                         \
    }

float fixed_value_of(uint low, uint high)
{
    return float(high) * 4294967296.0 + float(low);
}
