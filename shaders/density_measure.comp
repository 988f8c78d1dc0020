#version 460
#extension GL_GOOGLE_include_directive : require
// density_measure.comp: what every cell asks for after what its photons reported, not yet scaled to the total that the
// area rule would ask for.
//
// Reads   feedback; density=error: the last frame's strata, rays
// Writes  wish per cell, two partial sums per workgroup: areas, wishes; density=error: aspect
// Source  design 5; docs/how-a-frame-works.md
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer feedback_buffer { feedback_gpu feedback[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer partial_buffer { vec2 partials[]; };
layout(std430, binding = BINDING_PASS + 4) writeonly buffer wish_buffer { float wishes[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 6) readonly buffer column_buffer { uint columns[]; };
layout(std430, binding = BINDING_PASS + 7) buffer aspect_buffer { float aspect[]; };
layout(std430, binding = BINDING_PASS + 8) readonly buffer cost_buffer { uint costs[]; };

const float ASPECT_MAX = 6.0; // log2 of the most columns over rows

// The error of k x m strata is U / k^2 + V / m^2. For n strata in all it is least at k / m = sqrt(U / V), where it is
// 2 sqrt(U V) / n; over all cells together it is least when n goes with the root of that over a photon's rays. Where the
// light breaks up, at facets and rims, errors fall more slowly than measured errors say, and would take all: the root of
// it, between that and uniform, was best on `sphere` and `square` both (of exponents 0.35 to 1).
float error_wish(uint cell)
{
    float u = fixed_value_of(feedback[cell].error_u_low, feedback[cell].error_u_high) * (1.0 / 1073741824.0);
    float v = fixed_value_of(feedback[cell].error_v_low, feedback[cell].error_v_high) * (1.0 / 1073741824.0);
    float k = float(columns[cell]), m = float(tree[cell]) / max(k, 1.0);
    u *= k * k;
    v *= m * m;
    if (!(u * v > 0.0))
        return 0.0;
    aspect[cell] = mix(aspect[cell], clamp(0.5 * log2(u / v), -ASPECT_MAX, ASPECT_MAX), frame.temporal_weight);
    return sqrt(sqrt(sqrt(u * v) * k * m / float(max(costs[cell], 1u))));
}

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    float area = 0.0, wish = 0.0;
    if (cell < cell_count() && mask[cell] != 0u) {
        area = fixed_value_of(feedback[cell].area_low, feedback[cell].area_high) * (1.0 / 65536.0);
        wish = DENSITY == DENSITY_ERROR_RULE ? error_wish(cell) : fixed_value_of(feedback[cell].root_low, feedback[cell].root_high) * (1.0 / 1048576.0);
        wishes[cell] = wish;
    }
    area = group_sum(area);
    wish = group_sum(wish);
    if (gl_LocalInvocationIndex == 0u)
        partials[gl_WorkGroupID.x] = vec2(area, wish);
}
