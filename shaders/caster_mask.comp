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
layout(std430, binding = BINDING_PASS) readonly buffer box_buffer { caster_box boxes[]; }; // of casters, then of their parts
layout(std430, binding = BINDING_PASS + 1) writeonly buffer mask_buffer { uint mask[]; };

// What leaves the light through a cell: a beam across the light of a rectangle about `place`, or a cone about `axis`.
struct cell_rays {
    vec2 place, half_size;
    vec3 axis;
    float half_angle;
};

bool beam_meets(light_gpu light, cell_rays rays, vec3 middle, vec3 half_box)
{
    vec3 offset = middle - light.tile_origin.xyz;
    vec2 p = vec2(dot(offset, light.tile_x.xyz), dot(offset, light.tile_y.xyz));
    vec2 reach = vec2(dot(abs(light.tile_x.xyz), half_box), dot(abs(light.tile_y.xyz), half_box)) + rays.half_size;
    return all(lessThanEqual(abs(p - rays.place), reach * 1.0001));
}

// A sphere stands for the box.
bool cone_meets(light_gpu light, cell_rays rays, vec3 middle, float radius)
{
    vec3 offset = middle - light.position.xyz;
    float distance = length(offset), half_angle = rays.half_angle;
    if (distance <= radius * 1.0001)
        return true;
    if (has(FEATURE_SOFT) && light.shape != EMITTER_POINT)
        half_angle += max(emitter_widening(light, distance - radius), emitter_widening(light, distance + radius));
    float angle = angle_between(offset / distance, rays.axis);
    return angle <= half_angle + asin(min(radius / distance, 1.0)) + 1e-5;
}

// `wider` scales the sphere: that of a caster has to hold those of its parts.
bool box_meets(light_gpu light, cell_rays rays, caster_box box, float wider)
{
    vec3 half_box = 0.5 * (box.maximum.xyz - box.minimum.xyz);
    if (has(FEATURE_DIRECTIONAL) && light.map == TILE_RECT)
        return beam_meets(light, rays, 0.5 * (box.minimum.xyz + box.maximum.xyz), half_box);
    return cone_meets(light, rays, box.minimum.xyz + half_box, wider * length(half_box));
}

void main()
{
    uint cell = gl_GlobalInvocationID.x;
    uint light_index = cell_light(cell);
    if (light_index >= frame.tile_slots)
        return;
    light_gpu light;
    bool is_lit = light_index < frame.part_count;
    if (is_lit) {
        light = lights[light_index];
        is_lit = light.intensity.w > 0.0;
    }
    if (!is_lit) {
        mask[cell] = 0u;
        return;
    }
    vec2 size = vec2(1.0 / float(frame.cells));
    vec2 corner = vec2(cell_place(cell)) * size;
    if (has(FEATURE_INSETS)) {
        corner = light.part.xy + corner * light.part.zw;
        size *= light.part.zw;
        if (inset_share(light, light_index, corner, size) > 0.99999) {
            mask[cell] = 0u;
            return;
        }
    }
    cell_rays rays;
    if (has(FEATURE_DIRECTIONAL) && light.map == TILE_RECT) {
        vec2 half_size = vec2(light.tile_x.w, light.tile_y.w);
        rays.place = (2.0 * (corner + 0.5 * size) - 1.0) * half_size;
        rays.half_size = half_size * size;
    } else {
        rays.axis = tile_direction(light.map, light.tile_x, light.tile_y, light.tile_z, corner + 0.5 * size);
        rays.half_angle = 0.0;
        for (uint k = 0u; k < 4u; k++)
            rays.half_angle = max(rays.half_angle,
                                  angle_between(rays.axis, tile_direction(light.map, light.tile_x, light.tile_y, light.tile_z,
                                                                          corner + size * vec2(float(k & 1u), float(k >> 1)))));
        // the maps bend a cell's sides outward a little between its corners
        rays.half_angle *= 1.05;
    }
    bool meets = false;
    for (uint i = 0u; i < frame.caster_count && !meets; i++) {
        if (!box_meets(light, rays, boxes[i], 2.0))
            continue;
        uint first = frame.caster_count + uint(boxes[i].minimum.w), count = uint(boxes[i].maximum.w);
        for (uint k = 0u; k < count && !meets; k++)
            meets = box_meets(light, rays, boxes[first + k], 1.0);
    }
    if (!has(FEATURE_DIRECTIONAL) || light.map != TILE_RECT) {
        float half_angle = rays.half_angle;
        // what an emitter's parts send within their cones meets the pivot sphere that much wider
        if (has(FEATURE_SOFT) && light.shape != EMITTER_POINT)
            half_angle += emitter_widening(light, 3.0e38);
        if (has(FEATURE_SPOT) && light.type == LIGHT_TYPE_SPOT)
            meets = meets && angle_between(rays.axis, light.direction.xyz) <= 2.0 * asin(sqrt(0.5 * light.position.w)) + half_angle + 1e-6;
        if (has(FEATURE_SPOT) && light.type == LIGHT_TYPE_COSINE)
            meets = meets && angle_between(rays.axis, light.direction.xyz) <= PI / 2.0 + half_angle;
    }
    mask[cell] = meets || (frame.flags & FLAG_CASTER_MASK) == 0u ? 1u : 0u;
}
