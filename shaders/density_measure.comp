#version 460
#extension GL_GOOGLE_include_directive : require
// density_measure.comp: sums what the photons of the last frame reported, for the scale of the sqrt rule.
//
// Reads   feedback
// Writes  two partial sums per workgroup: areas, roots
// Source  design 5
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer feedback_buffer { feedback_gpu feedback[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer partial_buffer { vec2 partials[]; };

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    float area = 0.0, root = 0.0;
    if (cell < cell_count() && mask[cell] != 0u) {
        area = fixed_value_of(feedback[cell].area_low, feedback[cell].area_high) * (1.0 / 65536.0);
        root = fixed_value_of(feedback[cell].root_low, feedback[cell].root_high) * (1.0 / 1048576.0);
    }
    area = group_sum(area);
    root = group_sum(root);
    if (gl_LocalInvocationIndex == 0u)
        partials[gl_WorkGroupID.x] = vec2(area, root);
}
