// density.glsl: task buffers of a view: density, mask, quadtree of samples, feedback.
// Source  design 5; aaps-thesis 2.3.4, 3.1.5
layout(std430, binding = BINDING_PASS) buffer counter_buffer { counters_gpu counters; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer mask_buffer { uint mask[]; };

uint cell_count()
{
    return frame.tile_slots << (2u * frame.tile_levels);
}

// A density is finite and not negative; what is not is clamped and counted.
const float DENSITY_MAX = 1073741824.0;
// What a cell may ask for before the budget's scale: a few cells at a focus or a grazing rim ask for millions and would
// starve all others. On `square` this lowered the error from 0.096 to 0.072, with 40 % fewer rays.
const float DENSITY_WISH_MAX = 1048576.0;

float density_guard(float density)
{
    if (!(density >= 0.0 && density <= DENSITY_MAX)) {
        atomicAdd(counters.count[COUNT_GUARD_DENSITY], 1u);
        return density > 0.0 ? DENSITY_WISH_MAX : 0.0;
    }
    return min(density, DENSITY_WISH_MAX);
}

// Sums over the workgroup in a fixed order.
shared float group_values[GROUP_SIZE];

float group_sum(float value)
{
    uint i = gl_LocalInvocationIndex;
    barrier();
    group_values[i] = value;
    barrier();
    for (uint step = GROUP_SIZE / 2u; step > 0u; step /= 2u) {
        if (i < step)
            group_values[i] += group_values[i + step];
        barrier();
    }
    return group_values[0];
}

float group_max(float value)
{
    uint i = gl_LocalInvocationIndex;
    barrier();
    group_values[i] = value;
    barrier();
    for (uint step = GROUP_SIZE / 2u; step > 0u; step /= 2u) {
        if (i < step)
            group_values[i] = max(group_values[i], group_values[i + step]);
        barrier();
    }
    return group_values[0];
}
