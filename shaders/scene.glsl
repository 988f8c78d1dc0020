// scene.glsl: fetches surfaces of the scene.
//
// Reads   bindings 2 to 6: instances, vertices, indices, materials, texels
// Source  design 4
#include "scene_instances.glsl"

layout(std430, binding = BINDING_VERTICES) readonly buffer vertex_buffer { scene_vertex_gpu scene_vertices[]; };
layout(std430, binding = BINDING_INDICES) readonly buffer index_buffer { uint scene_indices[]; };
layout(std430, binding = BINDING_MATERIALS) readonly buffer material_buffer { material_gpu scene_materials[]; };
layout(std430, binding = BINDING_TEXELS) readonly buffer texel_buffer { uvec2 scene_texels[]; };

struct surface {
    vec3 position;  // world
    vec3 geometric; // unit normal of the triangle, on its front side
    vec3 normal;    // unit interpolated normal, on the same side as `geometric`
    vec2 uv;
    uint material;
    // for differentials: world edges and corner normals
    vec3 edge1, edge2;
    vec3 normal0, normal1, normal2;
    float normal_length; // of the interpolated normal before it was made unit
};

vec3 instance_point(scene_instance_gpu instance, vec3 p)
{
    return vec3(dot(instance.to_world[0].xyz, p) + instance.to_world[0].w,
                dot(instance.to_world[1].xyz, p) + instance.to_world[1].w,
                dot(instance.to_world[2].xyz, p) + instance.to_world[2].w);
}

vec3 instance_vector(scene_instance_gpu instance, vec3 v)
{
    return vec3(dot(instance.to_world[0].xyz, v), dot(instance.to_world[1].xyz, v), dot(instance.to_world[2].xyz, v));
}

// Normals go by the inverse transpose.
vec3 instance_normal(scene_instance_gpu instance, vec3 n)
{
    return normalize(instance.to_object[0].xyz * n.x + instance.to_object[1].xyz * n.y + instance.to_object[2].xyz * n.z);
}

surface surface_fetch(uint instance_index, uint triangle, vec2 barycentrics)
{
    scene_instance_gpu instance = scene_instances[instance_index];
    uint base = instance.first_index + 3u * triangle;
    scene_vertex_gpu v0 = scene_vertices[scene_indices[base]];
    scene_vertex_gpu v1 = scene_vertices[scene_indices[base + 1u]];
    scene_vertex_gpu v2 = scene_vertices[scene_indices[base + 2u]];
    float w0 = 1.0 - barycentrics.x - barycentrics.y;

    surface s;
    vec3 local_edge1 = v1.position_u.xyz - v0.position_u.xyz;
    vec3 local_edge2 = v2.position_u.xyz - v0.position_u.xyz;
    s.position = instance_point(instance, v0.position_u.xyz + barycentrics.x * local_edge1 + barycentrics.y * local_edge2);
    s.edge1 = instance_vector(instance, local_edge1);
    s.edge2 = instance_vector(instance, local_edge2);
    s.normal0 = instance_normal(instance, v0.normal_v.xyz);
    s.normal1 = instance_normal(instance, v1.normal_v.xyz);
    s.normal2 = instance_normal(instance, v2.normal_v.xyz);
    s.uv = w0 * vec2(v0.position_u.w, v0.normal_v.w) + barycentrics.x * vec2(v1.position_u.w, v1.normal_v.w) +
           barycentrics.y * vec2(v2.position_u.w, v2.normal_v.w);
    s.material = instance.material;

    vec3 n = w0 * s.normal0 + barycentrics.x * s.normal1 + barycentrics.y * s.normal2;
    s.normal_length = length(n);
    vec3 g = cross(s.edge1, s.edge2);
    float g_length = length(g);
    s.geometric = g_length > 0.0 ? g / g_length : normalize(n);
    if (s.normal_length > 1e-6)
        s.normal = n / s.normal_length;
    else {
        s.normal = s.geometric;
        s.normal_length = 1.0;
    }
    // The front side is the one the normals are on; a mirrored transform turns the winding, not the normals.
    if (dot(s.geometric, s.normal) < 0.0)
        s.geometric = -s.geometric;
    return s;
}

// Change of the unit interpolated normal for a move `delta` along the triangle's plane.
vec3 surface_normal_change(surface s, vec3 delta)
{
    vec3 g = cross(s.edge1, s.edge2);
    float g2 = dot(g, g);
    if (!(g2 > 1e-30))
        return vec3(0.0);
    float w1 = dot(cross(delta, s.edge2), g) / g2;
    float w2 = dot(cross(s.edge1, delta), g) / g2;
    vec3 change = w1 * (s.normal1 - s.normal0) + w2 * (s.normal2 - s.normal0);
    return (change - s.normal * dot(s.normal, change)) / s.normal_length;
}

// Bilinear texel, linear Rec. 709.
vec3 texel_fetch(uint first, uint width, uint height, bool clamp_u, bool clamp_v, vec2 uv)
{
    // Huge coordinates lose their fraction: wrap before scaling.
    vec2 p = vec2(clamp_u ? clamp(uv.x, 0.0, 1.0) : fract(uv.x), clamp_v ? clamp(uv.y, 0.0, 1.0) : fract(uv.y)) *
             vec2(float(width), float(height)) - 0.5;
    ivec2 size = ivec2(int(width), int(height));
    ivec2 i0 = ivec2(floor(p));
    vec2 f = p - vec2(i0);
    ivec2 i1 = i0 + 1;
    i0.x = clamp_u ? clamp(i0.x, 0, size.x - 1) : (i0.x + size.x) % size.x;
    i1.x = clamp_u ? clamp(i1.x, 0, size.x - 1) : (i1.x + size.x) % size.x;
    i0.y = clamp_v ? clamp(i0.y, 0, size.y - 1) : (i0.y + size.y) % size.y;
    i1.y = clamp_v ? clamp(i1.y, 0, size.y - 1) : (i1.y + size.y) % size.y;
    uvec2 t00 = scene_texels[first + uint(i0.y * size.x + i0.x)];
    uvec2 t10 = scene_texels[first + uint(i0.y * size.x + i1.x)];
    uvec2 t01 = scene_texels[first + uint(i1.y * size.x + i0.x)];
    uvec2 t11 = scene_texels[first + uint(i1.y * size.x + i1.x)];
    vec3 c00 = vec3(unpackHalf2x16(t00.x), unpackHalf2x16(t00.y).x);
    vec3 c10 = vec3(unpackHalf2x16(t10.x), unpackHalf2x16(t10.y).x);
    vec3 c01 = vec3(unpackHalf2x16(t01.x), unpackHalf2x16(t01.y).x);
    vec3 c11 = vec3(unpackHalf2x16(t11.x), unpackHalf2x16(t11.y).x);
    return mix(mix(c00, c10, f.x), mix(c01, c11, f.x), f.y);
}

vec3 surface_color(surface s)
{
    vec3 color = scene_materials[s.material].color_ior.xyz;
    if (has(FEATURE_TEXTURE) && scene_materials[s.material].color_first != NONE) {
        material_gpu m = scene_materials[s.material];
        color *= texel_fetch(m.color_first, m.color_width, m.color_height, (m.flags & 1u) != 0u, (m.flags & 2u) != 0u, s.uv);
    }
    return color;
}

vec3 surface_emission(surface s)
{
    if (!has(FEATURE_EMISSION))
        return vec3(0.0);
    vec3 emission = scene_materials[s.material].emission.xyz;
    if (has(FEATURE_TEXTURE) && scene_materials[s.material].emission_first != NONE) {
        material_gpu m = scene_materials[s.material];
        emission *= texel_fetch(m.emission_first, m.emission_width, m.emission_height, (m.flags & 4u) != 0u, (m.flags & 8u) != 0u, s.uv);
    }
    return emission;
}

// A ray origin safely off the surface, on the side of `normal` (Waechter and Binder 2019, Ray Tracing Gems 6).
vec3 offset_origin(vec3 p, vec3 normal)
{
    float origin_limit = frame.offset_scale / 32.0;
    float float_scale = frame.offset_scale / 65536.0;
    ivec3 steps = ivec3(frame.offset_steps * normal);
    vec3 moved = vec3(intBitsToFloat(floatBitsToInt(p.x) + (p.x < 0.0 ? -steps.x : steps.x)),
                      intBitsToFloat(floatBitsToInt(p.y) + (p.y < 0.0 ? -steps.y : steps.y)),
                      intBitsToFloat(floatBitsToInt(p.z) + (p.z < 0.0 ? -steps.z : steps.z)));
    return vec3(abs(p.x) < origin_limit ? p.x + float_scale * normal.x : moved.x,
                abs(p.y) < origin_limit ? p.y + float_scale * normal.y : moved.y,
                abs(p.z) < origin_limit ? p.z + float_scale * normal.z : moved.z);
}
