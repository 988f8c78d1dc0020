#version 460
#extension GL_GOOGLE_include_directive : require
// gbuffer.comp: the surface every pixel shows: the first receiver, seen directly or through glass and mirrors, with
// direct light where somebody asked for it.
//
// Reads   scene, lights
// Writes  surfaces, targets of splats
// Source  design 4 (radiance across interfaces), 8 (dominant branch); aaps-thesis 3.1.1
#include "frame.glsl"
#define TRACE_EXCLUDES
#include "trace.glsl"
#include "scene.glsl"
#include "light.glsl"
#include "media.glsl"
#include "optics.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
layout(std430, binding = BINDING_PASS) writeonly buffer surface_buffer { surface_gpu surfaces[]; };
layout(std430, binding = BINDING_PASS + 1) writeonly buffer target_buffer { target_gpu targets[]; };

// Radiance that lights send back from a diffuse point toward the viewer; everything blocks, glass too: what glass
// lets through is caustic light.
vec3 direct_radiance(vec3 position, vec3 geometric, vec3 normal, vec3 albedo)
{
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < frame.light_count; i++) {
        light_gpu light = lights[i];
        vec3 to_light;
        float distance2 = 1.0, reach = 3.0e38;
        if (light.type == LIGHT_TYPE_DIRECTIONAL) {
            to_light = -light.direction.xyz;
        } else {
            vec3 offset = light.position.xyz - position;
            distance2 = max(dot(offset, offset), 1e-20);
            reach = sqrt(distance2);
            to_light = offset / reach;
        }
        float cosine = dot(to_light, normal);
        if (cosine <= 0.0 || dot(to_light, geometric) <= 0.0)
            continue;
        float falloff = light_falloff(light, -to_light);
        if (falloff <= 0.0 || trace_any(offset_origin(position, geometric), to_light, reach * 0.9999))
            continue;
        sum += light.intensity.xyz * (falloff * cosine / distance2);
    }
    return sum * albedo / PI;
}

void main()
{
    uvec2 place = gl_GlobalInvocationID.xy;
    if (place.x >= frame.width || place.y >= frame.height)
        return;
    uint pixel = place.y * frame.width + place.x;
    vec3 ray = camera_ray(vec2(place) + 0.5);
    vec3 origin = frame.eye.xyz, direction = normalize(ray);
    vec3 throughput = vec3(1.0);

    surface_gpu result;
    result.relative_position = vec4(0.0, 0.0, 0.0, uintBitsToFloat(0x7f800000u));
    result.normal = vec4(0.0);
    result.albedo = vec4(0.0);
    result.radiance = vec4(0.0);
    target_gpu target;
    target.position_normal = vec4(0.0, 0.0, 0.0, uintBitsToFloat(NONE));

    uint medium = frame.eye_medium;
    for (uint bounce = 0u; bounce <= frame.camera_bounces; bounce++) {
        trace_hit hit = trace_closest(origin, direction, 3.0e38);
        if (hit.instance == TRACE_MISS)
            break;
        surface s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
        uint touching = NONE;
        bool touching_front = false;
        if (has(FEATURE_CONTACT) && scene_materials[s.material].kind == KIND_DIELECTRIC) {
            bool front = dot(direction, s.geometric) < 0.0;
            trace_hit other = media_contact(s.position, front ? s.geometric : -s.geometric, hit.instance);
            if (media_take_contact(other, direction, hit, touching, touching_front))
                s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
        }
        material_gpu material = scene_materials[s.material];
        bool front = dot(direction, s.geometric) < 0.0;
        vec3 geometric = front ? s.geometric : -s.geometric;
        vec3 normal = front ? s.normal : -s.normal;
        if (dot(normal, direction) > -1e-4)
            normal = geometric;
        if (bounce == 0u)
            result.relative_position.w = dot(direction * hit.t, frame.forward.xyz);
        if (has(FEATURE_ABSORPTION)) {
            uint here = material.kind == KIND_DIELECTRIC ? media_here(medium, s.material, front) : media_top(medium);
            if (here != NONE)
                throughput *= exp(-scene_materials[here].absorption.xyz * hit.t);
        }
        result.radiance.xyz += throughput * surface_emission(s);

        if (material.kind == KIND_DIFFUSE) {
            vec3 albedo = surface_color(s);
            result.relative_position.xyz = bounce == 0u ? direction * hit.t : s.position - frame.eye.xyz;
            result.normal = vec4(normal, bounce == 0u ? 1.0 : 2.0);
            result.albedo = vec4(albedo, 0.0);
            if (has(FEATURE_BEAUTY))
                result.radiance.xyz += throughput * direct_radiance(s.position, geometric, normal, albedo);
            if (bounce == 0u)
                target.position_normal = vec4(result.relative_position.xyz, uintBitsToFloat(pack_normal(geometric)));
            break;
        }
        if (!has(FEATURE_CHAINS))
            break; // nobody looks through: caustics land on what is seen directly
        float cos_i = -dot(direction, normal);
        if (has(FEATURE_MIRROR) && material.kind == KIND_MIRROR) {
            throughput *= fresnel_metal(cos_i, surface_color(s));
            direction = reflect(direction, normal);
            if (dot(direction, geometric) <= 0.0)
                direction = reflect(direction, geometric);
            origin = offset_origin(s.position, geometric);
        } else if (has(FEATURE_THIN) && material.kind == KIND_THIN) {
            throughput *= surface_color(s) * (1.0 - fresnel_thin(cos_i, material.color_ior.w));
            origin = offset_origin(s.position, -geometric);
        } else if (has(FEATURE_DIELECTRIC)) {
            boundary b = media_boundary(medium, s.material, front, touching, touching_front);
            float eta = b.eta;
            float cos_t;
            float reflectance = fresnel_dielectric(cos_i, eta, cos_t);
            if (reflectance > 0.5) {
                throughput *= reflectance;
                direction = reflect(direction, normal);
                if (dot(direction, geometric) <= 0.0)
                    direction = reflect(direction, geometric);
                origin = offset_origin(s.position, geometric);
            } else {
                throughput *= 1.0 - reflectance;
                // radiance from the other side arrives scaled by (n_here / n_there)^2
                if ((frame.flags & FLAG_RADIANCE_SCALING) != 0u)
                    throughput *= eta * eta;
                direction = eta * direction + (eta * cos_i - cos_t) * normal;
                if (dot(direction, geometric) >= 0.0)
                    direction -= (dot(direction, geometric) + 1e-3) * geometric;
                origin = offset_origin(s.position, -geometric);
                medium = b.beyond;
            }
        }
        direction = normalize(direction);
    }
    surfaces[pixel] = result;
    targets[pixel] = target;
}
