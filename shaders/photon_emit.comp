#version 460
#extension GL_GOOGLE_include_directive : require
// photon_emit.comp: one thread per photon: finds its cell and place in the quadtree and leaves the light.
//
// Reads   lights, quadtree
// Writes  photon rays, in task order; queue of the first bounce; flux emitted
// Source  design 4, 5; aaps-thesis 2.3.1, 3.1.2, 3.2.1
#include "frame.glsl"
#include "light.glsl"
#include "optics.glsl"
#include "photons.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 2) writeonly buffer ray_buffer { photon_ray rays[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer queue_buffer { uint queue[]; };

void main()
{
    uint task = gl_GlobalInvocationID.x;
    float emitted = 0.0;
    if (task < counters.task_count) {
        uint cells = frame.tile_slots << (2u * frame.tile_levels);
        uint node = 0u, rest = task;
        for (uint count = 4u; count <= cells; count *= 4u) {
            uint level_start = 4u * ((cells - count) / 3u);
            node *= 4u;
            uint below = tree[level_start + node];
            for (uint k = 0u; k < 3u && rest >= below; k++) {
                rest -= below;
                node++;
                below = tree[level_start + node];
            }
        }
        uint samples = tree[node];
        uint side = uint(sqrt(float(samples)) + 0.5);
        light_gpu light = lights[cell_light(node)];

        uint hash = hash_mix(hash_mix(hash_word(frame.seed), node), rest);
        vec2 place = vec2(0.5);
        if ((frame.flags & FLAG_JITTER) != 0u) {
            // a start of its own in every stratum, then the R2 sequence (Roberts 2018) over the subframes
            uint h = hash_mix(hash, 0x4au);
            place = fract(vec2(hash_unit(h), hash_unit(hash_word(h))) +
                          float(frame.subframe) * vec2(0.7548776662, 0.5698402910));
            hash = hash_mix(hash, frame.subframe);
        }
        uvec2 turn = uvec2(0u); // which strata carry thinned branches changes with the subframe
        if ((frame.flags & FLAG_JITTER) != 0u)
            turn = uvec2(hash_word(frame.subframe ^ frame.seed), hash_word(frame.subframe + 0x9e37u));
        uvec2 lattice = (cell_place(node) * side + uvec2(rest % side, rest / side) + turn) & 3u;
        vec2 stratum = vec2(float(rest % side), float(rest / side)) + place;
        float size = 1.0 / (float(frame.cells) * float(side)); // of a stratum
        vec2 uv = vec2(cell_place(node)) / float(frame.cells) + stratum * size;
        emission e = light_emit(light, uv);

        float share = light_falloff(light, e.direction) * light.tile_origin.w * size * size;
        photon_ray ray;
        float measure = 1.0 / max(light.tile_origin.w * size * size, 1e-30);
        ray.origin = vec4(e.origin, light.map == TILE_RECT ? -measure : measure);
        ray.direction = vec4(e.direction, 0.0);
        ray.flux = vec4(light.intensity.xyz * share, light.intensity.w * share);
        differential x;
        x.p_u = e.origin_u * size;
        x.p_v = e.origin_v * size;
        x.d_u = e.direction_u * size;
        x.d_v = e.direction_v * size;
        ray_set_differential(ray, x);
        ray.cell = node;
        ray.hash = hash;
        ray.medium = light.medium;
        ray.state = (lattice.x << 14) | (lattice.y << 16);
        rays[task] = ray;
        queue[task] = task;
        emitted = ray.flux.w;
    }
    ledger_add(FATE_EMITTED, emitted, 0.0);
}
