#version 460
#extension GL_GOOGLE_include_directive : require
// density_update.comp: the control loop: next frame's density of a cell from what its photons did.
//
// Reads   last density, mask, feedback, wishes of density_measure.comp, counters.suggestion_scale
// Writes  density, variance
// Source  design 5; aaps-thesis 2.3.4: D' = D A / A_t + g v, blended in time and with the neighbours
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer feedback_buffer { feedback_gpu feedback[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer old_buffer { float old_density[]; };
layout(std430, binding = BINDING_PASS + 4) buffer density_buffer { float density[]; }; // holds the wishes at first
layout(std430, binding = BINDING_PASS + 5) writeonly buffer variance_buffer { float variance[]; };

const float CHANGE_TRUST = 4.0; // per relative change of the picture

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    if (cell >= cell_count())
        return;
    if (mask[cell] == 0u) {
        density[cell] = 0.0;
        if (has(FEATURE_VARIANCE))
            variance[cell] = 0.0;
        return;
    }
    float value = old_density[cell];
    if (DENSITY != DENSITY_UNIFORM_RULE) {
        // D A is the sum of the cell's projected areas, whatever D was: the loop settles in one step
        float suggested;
        if (DENSITY == DENSITY_AREA_RULE)
            suggested = fixed_value_of(feedback[cell].area_low, feedback[cell].area_high) * (1.0 / 65536.0);
        else
            suggested = density[cell] * counters.suggestion_scale;
        suggested /= frame.target_area;
        float trust = frame.temporal_weight;
        if (has(FEATURE_VARIANCE)) {
            float change = fixed_value_of(feedback[cell].change_low, feedback[cell].change_high) * (1.0 / 16777216.0);
            suggested += frame.variance_gain * change;
            variance[cell] = change;
            // where the picture is another one, what it was does not count: after a jump the loop settles in two frames
            trust = min(trust * (1.0 + CHANGE_TRUST * change), 1.0);
        }
        suggested = density_guard(suggested);

        // the neighbourhood's last densities, the cell's own counted as much as its four neighbours together
        uvec2 place = cell_place(cell);
        uint tile = cell_light(cell) << (2u * frame.tile_levels);
        float sum = 4.0 * value, weight = 4.0;
        for (uint k = 0u; k < 4u; k++) {
            ivec2 p = ivec2(place) + ivec2(k == 0u ? 1 : k == 1u ? -1 : 0, k == 2u ? 1 : k == 3u ? -1 : 0);
            if (any(lessThan(p, ivec2(0))) || any(greaterThanEqual(p, ivec2(int(frame.cells)))))
                continue;
            uint neighbour = tile + morton_encode(uvec2(p));
            if (mask[neighbour] == 0u)
                continue;
            sum += old_density[neighbour];
            weight += 1.0;
        }
        value = mix(sum / weight, suggested, trust);
    }
    density[cell] = max(density_guard(value), float(frame.min_samples));
}
