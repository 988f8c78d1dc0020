#version 460
#extension GL_GOOGLE_include_directive : require
// caster_mask.comp: marks the cells of every light's tile whose rays can meet a caster; none of a black light's.
//
// Reads   lights, caster boxes
// Writes  mask, 1 or 0 per cell, conservative
// Source  design 5 (idle cells)
#include "frame.glsl"
#include "light.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS) readonly buffer box_buffer { caster_box boxes[]; };
layout(std430, binding = BINDING_PASS + 1) writeonly buffer mask_buffer { uint mask[]; };

// Can a beam across `light` of a rectangle about `place` with these half sizes meet the box?
bool beam_meets(light_gpu light, vec2 place, vec2 half_size, vec3 middle, vec3 half_box)
{
    vec3 offset = middle - light.tile_origin.xyz;
    vec2 p = vec2(dot(offset, light.tile_x.xyz), dot(offset, light.tile_y.xyz));
    vec2 reach = vec2(dot(abs(light.tile_x.xyz), half_box), dot(abs(light.tile_y.xyz), half_box)) + half_size;
    return all(lessThanEqual(abs(p - place), reach * 1.0001));
}

// Can a cone about `axis` meet the box? The box's bounding sphere stands for it.
bool cone_meets(vec3 apex, vec3 axis, float half_angle, vec3 middle, float radius)
{
    vec3 offset = middle - apex;
    float distance = length(offset);
    if (distance <= radius * 1.0001)
        return true;
    float angle = angle_between(offset / distance, axis);
    return angle <= half_angle + asin(min(radius / distance, 1.0)) + 1e-5;
}

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    uint light_index = cell_light(cell);
    if (light_index >= frame.tile_slots)
        return;
    light_gpu light;
    bool is_lit = light_index < frame.light_count;
    if (is_lit) {
        light = lights[light_index];
        is_lit = light.intensity.w > 0.0;
    }
    if (!is_lit) {
        mask[cell] = 0u;
        return;
    }
    float size = 1.0 / float(frame.cells);
    vec2 corner = vec2(cell_place(cell)) * size;
    bool meets = false;
    if (has(FEATURE_DIRECTIONAL) && light.map == TILE_RECT) {
        vec2 half_size = vec2(light.tile_x.w, light.tile_y.w);
        vec2 place = (2.0 * (corner + 0.5 * size) - 1.0) * half_size;
        for (uint i = 0u; i < frame.caster_box_count && !meets; i++)
            meets = beam_meets(light, place, half_size * size, 0.5 * (boxes[i].minimum.xyz + boxes[i].maximum.xyz),
                               0.5 * (boxes[i].maximum.xyz - boxes[i].minimum.xyz));
    } else {
        vec3 axis = tile_direction(light.map, light.tile_x, light.tile_y, light.tile_z, corner + 0.5 * size);
        float half_angle = 0.0;
        for (uint k = 0u; k < 4u; k++)
            half_angle = max(half_angle, angle_between(axis, tile_direction(light.map, light.tile_x, light.tile_y, light.tile_z,
                                                                            corner + size * vec2(float(k & 1u), float(k >> 1)))));
        // the maps bend a cell's sides outward a little between its corners
        half_angle *= 1.05;
        for (uint i = 0u; i < frame.caster_box_count && !meets; i++) {
            vec3 half_box = 0.5 * (boxes[i].maximum.xyz - boxes[i].minimum.xyz);
            vec3 middle = boxes[i].minimum.xyz + half_box;
            float wider = half_angle;
            if (has(FEATURE_SOFT) && light.shape != EMITTER_POINT) {
                float far = length(middle - light.position.xyz), near = far - length(half_box);
                wider += max(emitter_widening(light, near), emitter_widening(light, far + length(half_box)));
            }
            meets = cone_meets(light.position.xyz, axis, wider, middle, length(half_box));
        }
        // what an emitter's parts send within their cones meets the pivot sphere that much wider
        if (has(FEATURE_SOFT) && light.shape != EMITTER_POINT)
            half_angle += emitter_widening(light, 3.0e38);
        if (has(FEATURE_SPOT) && light.type == LIGHT_TYPE_SPOT)
            meets = meets && angle_between(axis, light.direction.xyz) <= 2.0 * asin(sqrt(0.5 * light.position.w)) + half_angle + 1e-6;
        if (has(FEATURE_SPOT) && light.type == LIGHT_TYPE_COSINE)
            meets = meets && angle_between(axis, light.direction.xyz) <= PI / 2.0 + half_angle;
    }
    mask[cell] = meets || (frame.flags & FLAG_CASTER_MASK) == 0u ? 1u : 0u;
}
