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
#include "spread.glsl"
#include "branches.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 2) writeonly buffer ray_buffer { photon_ray rays[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer queue_buffer { uint queue[]; };
layout(std430, binding = BINDING_PASS + 4) writeonly buffer spread_buffer { float spreads[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer column_buffer { uint columns[]; };

// Where on the emitter the photon starts, and what of its size is left to differentials. Returns its share of the
// light's flux against a point's.
float leave_emitter(light_gpu light, uvec2 lattice, vec2 place, inout emission e, out differential spread)
{
    vec3 to_pivot = e.direction;
    uint side = light.emitter_side;
    vec2 strata = (vec2(lattice & (side - 1u)) + place) / float(side);
    vec3 e_s, e_t;
    vec3 start = emitter_point(light, to_pivot, strata, e_s, e_t);
    float weight = side == 1u && AA != AA_PIXEL ? emitter_mean_weight(light, to_pivot) : emitter_weight(light, to_pivot, start);
    vec3 way = light.emitter_x.w * to_pivot - start;
    float inverse = inversesqrt(dot(way, way));
    e.origin += start;
    e.direction = way * inverse;
    vec3 pivot_u = light.emitter_x.w * e.direction_u, pivot_v = light.emitter_x.w * e.direction_v;
    e.direction_u = inverse * (pivot_u - e.direction * dot(e.direction, pivot_u));
    e.direction_v = inverse * (pivot_v - e.direction * dot(e.direction, pivot_v));
    // columns with a sixth of their squares for variance: of a stratum's twelfth, of the whole disk's quarter
    float scale = sqrt(0.5) / float(side);
    if (side == 1u && light.shape != EMITTER_RECTANGLE) {
        e_s = normalize(e_s) * (length(e_s) * 0.5 * sqrt(1.5));
        e_t = normalize(e_t) * (length(e_t) * (2.0 / PI) * sqrt(1.5));
        scale = 1.0;
    }
    spread.p_u = scale * e_s;
    spread.p_v = scale * e_t;
    spread.d_u = -inverse * (spread.p_u - e.direction * dot(e.direction, spread.p_u));
    spread.d_v = -inverse * (spread.p_v - e.direction * dot(e.direction, spread.p_v));
    return weight;
}

// The part of a stratum that insets of its tile do not cover. A place in one of them moves to the widest strip beside it.
float leave_insets(light_gpu light, uint tile, vec2 corner, vec2 size, vec2 place, inout vec2 uv)
{
    if (light.part_insets == 0u)
        return 1.0;
    float kept = 1.0 - inset_share(light, tile, corner, size);
    if (kept < 1e-5)
        return 0.0;
    for (uint pass = 0u; pass < 2u; pass++)
        for (uint i = frame.light_count; i < frame.part_count; i++) {
            vec4 part = lights[i].part;
            vec2 at = uv - part.xy;
            if (lights[i].part_parent != tile || any(lessThan(at, vec2(0.0))) || any(greaterThan(at, part.zw)))
                continue;
            if (pass == 1u)
                return 0.0; // many insets in one stratum
            vec2 below = max(part.xy - corner, vec2(0.0)) / size, above = max(corner + size - part.xy - part.zw, vec2(0.0)) / size;
            vec2 strip = max(below, above);
            uint axis = strip.x >= strip.y ? 0u : 1u;
            uv[axis] = corner[axis] + size[axis] * (below[axis] >= above[axis] ? below[axis] * place[axis]
                                                                               : 1.0 - above[axis] * place[axis]);
        }
    return kept;
}

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
        uvec2 strata = uvec2(columns[node], tree[node] / columns[node]);
        uvec2 at = uvec2(rest % strata.x, rest / strata.x);
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
        uvec2 turn = uvec2(0u); // which strata follow dim branches changes with the subframe
        if ((frame.flags & FLAG_JITTER) != 0u)
            turn = uvec2(hash_word(frame.subframe ^ frame.seed), hash_word(frame.subframe + 0x9e37u));
        uvec2 turned = (at + turn % strata) % strata;
        uint follows = 0u;
        if (follows_2(turned.x, strata.x) && follows_2(turned.y, strata.y))
            follows = follows_4(turned.x, strata.x) && follows_4(turned.y, strata.y) ? 3u : 1u;
        follows <<= STATE_FOLLOWS;
        vec2 size = 1.0 / (float(frame.cells) * vec2(strata)); // of a stratum
        vec2 corner = vec2(cell_place(node)) / float(frame.cells), uv = corner + (vec2(at) + place) * size;
        float kept = 1.0; // of the stratum, by its tile
        if (has(FEATURE_INSETS)) {
            corner = light.part.xy + (corner + vec2(at) * size) * light.part.zw;
            uv = light.part.xy + uv * light.part.zw;
            size *= light.part.zw;
            kept = leave_insets(light, cell_light(node), corner, size, place, uv);
        }
        emission e = light_emit(light, uv);

        float weight;
        photon_spread spread = spread_zero();
        vec2 spacing = size; // of photons that stand for each other
        if (has(FEATURE_SOFT) && light.shape != EMITTER_POINT) {
            vec2 emitter_place = vec2(0.5);
            if ((frame.flags & FLAG_JITTER) != 0u && (light.emitter_side > 1u || AA == AA_PIXEL)) {
                uint h = hash_mix(hash, 0x5eu);
                emitter_place = fract(vec2(hash_unit(h), hash_unit(hash_word(h))) +
                                      float(frame.subframe) * vec2(0.8191725134, 0.6710436067));
            }
            weight = leave_emitter(light, cell_place(node) * strata + at + turn, emitter_place, e, spread.emitter);
            // Neighbours have the emitter's strata between them: none can follow a branch for the others.
            spacing *= float(light.emitter_side);
            if (light.emitter_side > 1u)
                follows = STATE_FOLLOWS_ALL;
        } else
            weight = light_falloff(light, e.direction);
        if (has(FEATURE_INSETS))
            weight *= kept;
        SPREAD_STORE(spreads, task, spread);
        float share = weight * light.tile_origin.w * size.x * size.y;
        photon_ray ray;
        float measure = 1.0 / max(light.tile_origin.w * spacing.x * spacing.y, 1e-30);
        ray.origin = vec4(e.origin, light.map == TILE_RECT ? -measure : measure);
        ray.direction = vec4(e.direction, 0.0);
        ray.flux = vec4(light.intensity.xyz * share, light.intensity.w * share);
        differential x;
        x.p_u = e.origin_u * spacing.x;
        x.p_v = e.origin_v * spacing.y;
        x.d_u = e.direction_u * spacing.x;
        x.d_v = e.direction_v * spacing.y;
        ray_set_differential(ray, x);
        ray.cell = node;
        ray.hash = hash;
        ray.medium = light.medium;
        ray.state = follows;
        rays[task] = ray;
        queue[task] = task;
        emitted = ray.flux.w;
    }
    ledger_add(FATE_EMITTED, emitted, 0.0);
}
