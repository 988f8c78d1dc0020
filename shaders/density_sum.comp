#version 460
#extension GL_GOOGLE_include_directive : require
// density_sum.comp: sums the densities that the budget has to fit.
//
// Reads   density, mask
// Writes  per workgroup: sum; largest and number of masked cells
// Source  design 5 (budget)
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer density_buffer { float density[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer partial_buffer { vec2 partials[]; };

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    bool is_masked = cell < cell_count() && mask[cell] != 0u;
    float value = is_masked ? density[cell] : 0.0;
    float total = group_sum(value);
    float largest = group_max(value);
    float cells = group_sum(is_masked ? 1.0 : 0.0);
    if (gl_LocalInvocationIndex == 0u) {
        uint groups = (cell_count() + GROUP_SIZE - 1u) / GROUP_SIZE;
        partials[gl_WorkGroupID.x] = vec2(total, 0.0);
        partials[groups + gl_WorkGroupID.x] = vec2(largest, cells);
    }
}
