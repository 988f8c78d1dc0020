// block.glsl: what the photons of a cell and of its block of 4 x 4 cells reported. A block, because a cell whose weaker
// branches are thinned out need not follow any itself.
//
// Reads   mask, feedback
// Source  design 5
layout(std430, binding = BINDING_PASS + 2) readonly buffer feedback_buffer { feedback_gpu feedback[]; };

// Sums over the block: x of main branches, y of weaker ones, z cells in the mask. In the unit of the rule: roots, or with
// density=error errors.
vec3 block_sums(uint cell)
{
    vec3 sum = vec3(0.0);
    uint first = cell & ~15u;
    for (uint k = first; k < min(first + 16u, cell_count()); k++) {
        float weak = fixed_value_of(feedback[k].weak_low, feedback[k].weak_high);
        if (DENSITY == DENSITY_ERROR_RULE)
            sum.x += fixed_value_of(feedback[k].error_u_low, feedback[k].error_u_high) +
                     fixed_value_of(feedback[k].error_v_low, feedback[k].error_v_high);
        else
            sum.x += fixed_value_of(feedback[k].root_low, feedback[k].root_high) - weak;
        sum.y += weak;
        sum.z += mask[k] != 0u ? 1.0 : 0.0;
    }
    return sum;
}
