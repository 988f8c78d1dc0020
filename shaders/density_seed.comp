#version 460
#extension GL_GOOGLE_include_directive : require
// density_seed.comp: densities for tiles without a past: flat at first, remapped when a light's tile moved. Flat always
// with density=uniform.
//
// Reads   lights, mask, last frame's density
// Writes  density, per cell
// Source  design 4 (a change of the cap remaps the density instead of restarting it)
#include "frame.glsl"
#include "light.glsl"
#include "density.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer old_buffer { float old_density[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer density_buffer { float density[]; };

// The last frame's tile of a light that had this place of its unit square: the smallest that holds it.
uint old_tile_at(uint light, vec2 uv)
{
    uint found = NONE;
    float smallest = 2.0;
    for (uint i = 0u; i < frame.old_part_count; i++) {
        vec4 part = lights[i].old_part;
        vec2 at = uv - part.xy;
        float area = part.z * part.w;
        if (lights[i].old_light != light || any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, part.zw)) || area >= smallest)
            continue;
        found = i;
        smallest = area;
    }
    return found;
}

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    if (cell >= cell_count())
        return;
    uint light_index = cell_light(cell);
    if (light_index >= frame.part_count || mask[cell] == 0u) {
        density[cell] = 0.0;
        return;
    }
    light_gpu light = lights[light_index];
    // the budget's scale turns this into what the budget allows
    float value = float(frame.photon_budget);
    if (DENSITY != DENSITY_UNIFORM_RULE && light.has_previous != 0u) {
        value = old_density[cell];
        if (light.changed != 0u) {
            vec2 uv = (vec2(cell_place(cell)) + 0.5) / float(frame.cells);
            if (has(FEATURE_INSETS))
                uv = light.part.xy + uv * light.part.zw;
            vec2 old_uv = vec2(-1.0);
            float measure = light.tile_origin.w / light.old_origin.w;
            if (light.map == TILE_RECT) {
                vec2 o = 2.0 * uv - 1.0;
                vec3 p = light.tile_origin.xyz + light.tile_x.xyz * (light.tile_x.w * o.x) +
                         light.tile_y.xyz * (light.tile_y.w * o.y) - light.old_origin.xyz;
                old_uv = 0.5 * vec2(dot(p, light.old_x.xyz) / light.old_x.w, dot(p, light.old_y.xyz) / light.old_y.w) + 0.5;
            } else {
                vec3 d = tile_direction(light.map, light.tile_x, light.tile_y, light.tile_z, uv);
                vec3 local = vec3(dot(d, light.old_x.xyz), dot(d, light.old_y.xyz), dot(d, light.old_z.xyz));
                if (light.old_map == TILE_SPHERE)
                    old_uv = sphere_inverse(local);
                else if (1.0 - local.z <= light.old_z.w) {
                    float rho = sqrt(max(1.0 - local.z, 0.0) / light.old_z.w);
                    float across = length(local.xy);
                    old_uv = concentric_inverse(across > 0.0 ? local.xy * (rho / across) : vec2(0.0));
                }
            }
            uint old_tile = light_index;
            if (has(FEATURE_INSETS)) {
                old_tile = old_tile_at(light.part_light, old_uv);
                if (old_tile != NONE) {
                    vec4 old_part = lights[old_tile].old_part;
                    old_uv = (old_uv - old_part.xy) / old_part.zw;
                    measure *= light.part.z * light.part.w / (old_part.z * old_part.w);
                }
            }
            if (old_tile != NONE && all(greaterThanEqual(old_uv, vec2(0.0))) && all(lessThan(old_uv, vec2(1.0)))) {
                uint old_cell = (old_tile << (2u * frame.tile_levels)) + morton_encode(uvec2(old_uv * float(frame.cells)));
                value = old_density[old_cell] * measure;
                // the cells that were there saw next to nothing of a new inset: an even share of the budget
                if (has(FEATURE_INSETS) && measure < 0.25)
                    value = max(value, float(frame.photon_budget) / float((frame.part_count << (2u * frame.tile_levels))));
            } else
                value = float(frame.min_samples);
        }
        value = max(value, float(frame.min_samples));
    }
    density[cell] = value;
}
