#version 460
#extension GL_GOOGLE_include_directive : require
// density_scale.comp: one workgroup; turns partial sums into the scale of the suggestion (PHASE 0) or of the
// budget (PHASE 1).
//
// Reads   partial sums per workgroup
// Writes  counters: suggestion_scale, or density_total, density_largest, density_scale
// Source  design 5 (budget)
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(constant_id = 8) const uint PHASE = 0u;
layout(std430, binding = BINDING_PASS + 2) readonly buffer partial_buffer { vec2 partials[]; };

void main()
{
    uint groups = (cell_count() + GROUP_SIZE - 1u) / GROUP_SIZE;
    vec2 sum = vec2(0.0);
    float largest = 0.0, cells = 0.0;
    for (uint i = gl_LocalInvocationIndex; i < groups; i += GROUP_SIZE) {
        sum += partials[i];
        if (PHASE == 1u) {
            largest = max(largest, partials[groups + i].x);
            cells += partials[groups + i].y;
        }
    }
    float x = group_sum(sum.x);
    float y = group_sum(sum.y);
    if (PHASE == 0u) {
        // A few singular footprints have areas of any size: more than the budget would only reach the cells' limit.
        if (DENSITY == DENSITY_ERROR_RULE)
            x = min(x, float(frame.photon_budget) * frame.target_area);
        if (gl_LocalInvocationIndex == 0u)
            counters.suggestion_scale = y > 0.0 ? x / y : 0.0;
        return;
    }
    largest = group_max(largest);
    cells = group_sum(cells);
    if (gl_LocalInvocationIndex == 0u) {
        // x: total density, of which the minimum of every masked cell is not negotiable
        float floor_total = cells * float(frame.min_samples);
        float room = max(float(frame.photon_budget) - floor_total, 0.0);
        float wish = x - floor_total;
        counters.density_total = x;
        counters.density_largest = largest;
        counters.density_scale = wish > room ? room / wish : 1.0;
        counters.count[COUNT_CELLS] = uint(cells);
    }
}
