#version 460
#extension GL_GOOGLE_include_directive : require
// quadtree.comp: one level of the quadtree over samples per cell. Level 0: n = floor(sqrt(D))^2 under the budget, or
// with density=error k x m <= D with k / m near the cell's aspect; above it every node is the sum of its four children.
//
// Reads   density, aspect, counters.density_scale, the last frame's samples when kept (level 0); the level below
// Writes  density under the budget, columns k (level 0); tree: level l starts at 4 (N - N / 4^l) / 3 for N cells
// Source  design 5; aaps-thesis 2.3.1, fig. 15
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) buffer density_buffer { float density[]; };
layout(std430, binding = BINDING_PASS + 3) buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 4) buffer column_buffer { uint columns[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer aspect_buffer { float aspect[]; };
layout(push_constant) uniform push_block { uint level; };

// A cell keeps strata that lack at most two rows of a square, or a third, of what it may have, are at most a quarter
// more, and aren't twice too long. Two rows are what rounding to k x m and its echo in the feedback move; a share alone
// would keep what is too coarse in cells of many strata.
const float KEEP_ROWS = 2.0, KEEP_LEAST = 2.0 / 3.0, KEEP_MOST = 1.25, KEEP_ASPECT = 1.0; // the last in log2

// Whether the last frame's k x m strata still serve a cell that may have d of them. All cells together stay within the
// budget, which d divides among them.
bool still_serve(uint k, uint m, float d, float aspect)
{
    float n = float(k * m);
    float most = counters.density_scale < 1.0 ? 1.0 : min(KEEP_MOST, float(frame.photon_budget) / counters.density_total);
    return n >= max(KEEP_LEAST * d, d - KEEP_ROWS * sqrt(n)) && n <= most * d &&
           (DENSITY != DENSITY_ERROR_RULE || abs(log2(float(k) / float(m)) - aspect) < KEEP_ASPECT);
}

void main()
{
    uint cells = cell_count();
    uint count = cells >> (2u * level);
    uint node = gl_GlobalInvocationID.x;
    if (node >= count)
        return;
    uint here = 4u * ((cells - count) / 3u);
    uint value = 0u;
    if (level == 0u) {
        float d = density[node];
        if (d > 0.0) {
            float least = float(frame.min_samples);
            d = least + (d - least) * counters.density_scale;
            density[node] = d; // what the next frame starts from is what was really used
            uint k = max(uint(sqrt(d)), 1u), m = k;
            // What a cell's photons report jumps with k, so that a cell near a square could go back and forth
            // between two of them for ever. Once nothing changes its strata stay where they serve, at rest all of
            // them; they were within the budget together.
            uint last_k = max(columns[node], 1u), last_m = max(tree[node] / last_k, 1u);
            if ((frame.flags & FLAG_HOLD) != 0u ||
                ((frame.flags & FLAG_SETTLE) != 0u && still_serve(last_k, last_m, d, aspect[node]))) {
                k = last_k;
                m = last_m;
            } else if (DENSITY == DENSITY_ERROR_RULE) {
                k = clamp(uint(sqrt(d * exp2(aspect[node])) + 0.5), 1u, max(uint(d), 1u));
                m = max(uint(d / float(k)), 1u);
            }
            columns[node] = k;
            value = k * m;
        }
    } else {
        uint below = 4u * ((cells - 4u * count) / 3u) + 4u * node;
        value = tree[below] + tree[below + 1u] + tree[below + 2u] + tree[below + 3u];
    }
    tree[here + node] = value;
    if (count == 1u) {
        counters.task_count = value;
        counters.count[COUNT_EMITTED] = value;
        counters.queue[0] = (value + GROUP_SIZE - 1u) / GROUP_SIZE;
        counters.queue[1] = 1u;
        counters.queue[2] = 1u;
        counters.queue[QUEUE_COUNT] = value;
        counters.photon_groups[1] = 1u;
        counters.photon_groups[2] = 1u;
        // three where a photon may become one per band
        counters.stride[0] = has(FEATURE_DISPERSION) && 3u * value <= frame.ray_capacity && 3u * value <= frame.photon_capacity ? 3u :
            2u * value <= frame.ray_capacity && 2u * value <= frame.photon_capacity ? 2u : 1u;
    }
}
