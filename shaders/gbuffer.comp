#version 460
#extension GL_GOOGLE_include_directive : require
// gbuffer.comp: the surface every pixel shows: the first receiver, seen directly or through glass and mirrors, with
// direct light where somebody asked for it. PHASE 1: the samples of broken pixels, chain points only, to which those through
// their middles give way.
//
// Reads   scene, lights; broken pixels
// Writes  surfaces, targets of splats; chain points where somebody wants caustics seen through glass and mirrors
// Source  design 4 (radiance across interfaces), 8 (dominant branch); aaps-thesis 3.1.1
#include "frame.glsl"
#define TRACE_EXCLUDES
#include "trace.glsl"
#include "scene.glsl"
#include "light.glsl"
#include "media.glsl"
#include "optics.glsl"
#include "scene_differentials.glsl"
#include "lookup.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
layout(constant_id = 8) const uint PHASE = 0u;
layout(std430, binding = BINDING_PASS) writeonly buffer surface_buffer { surface_gpu surfaces[]; };
layout(std430, binding = BINDING_PASS + 1) writeonly buffer target_buffer { target_gpu targets[]; };
layout(std430, binding = BINDING_PASS + 2) writeonly buffer chain_buffer { chain_point chains[]; };
layout(std430, binding = BINDING_PASS + 3) writeonly buffer weight_buffer { vec4 weights[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer broken_buffer { uint broken[]; };

const float REACH_MAX = 16.0; // of a pixel's axes on a surface, against the same distance seen straight
const float LEAST_REACH = 0.125; // of a point for the grid, px of the same distance seen straight
const float STRETCH_MAX = 16.0; // and of one against the other
const vec2 SAMPLE_STEP = vec2(0.7548776662, 0.5698402910); // of Roberts' sequence: even for any number of samples
const float BRANCH_SHARE_MIN = 1e-3; // of the light at the first glass, for the weaker branch to be followed

// Where a camera's ray goes on after a specular surface.
struct chain_step {
    vec3 origin, direction, throughput;
    differential x; // over one pixel
    uint medium;
};

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

// The change of the camera's ray over one pixel.
differential camera_differential(vec3 ray, vec3 direction)
{
    differential x;
    float scale = inversesqrt(dot(ray, ray));
    x.p_u = x.p_v = vec3(0.0);
    x.d_u = (frame.ray_x.xyz - direction * dot(direction, frame.ray_x.xyz)) * scale;
    x.d_v = (frame.ray_y.xyz - direction * dot(direction, frame.ray_y.xyz)) * scale;
    return x;
}

// `share`: of the pixel, when it has several samples.
chain_point make_chain_point(vec3 relative, vec3 normal, differential x, vec3 throughput, float share)
{
    chain_point point;
    vec3 a = frame.lookup_filter * x.p_u, b = frame.lookup_filter * x.p_v;
    // At a silhouette a pixel may show metres: the little of them that it samples needs no wider filter, and a few such
    // points would meet every photon.
    float most2 = REACH_MAX * REACH_MAX * dot(relative, relative) * frame.forward.w * frame.lookup_filter * frame.lookup_filter;
    if (!is_finite(dot(a, a) + dot(b, b)))
        a = b = vec3(0.0);
    float a2 = dot(a, a), b2 = dot(b, b);
    most2 = min(most2, STRETCH_MAX * STRETCH_MAX * min(a2, b2));
    a *= min(1.0, sqrt(most2 / max(a2, 1e-30)));
    b *= min(1.0, sqrt(most2 / max(b2, 1e-30)));
    point.position_normal = vec4(relative, uintBitsToFloat(pack_normal(normal)));
    // Magnified without end, a point would ask for cells so fine that no photon could be walked through them.
    float least = LEAST_REACH * sqrt(dot(relative, relative) * frame.forward.w);
    float scale = sqrt(share);
    point.axes = pack_axes(scale * a, scale * b, scale * least, channel_sum(throughput) * share / 3.0);
    return point;
}

// Through a dielectric's surface by reflection or refraction.
chain_step pass_glass(chain_step at, surface s, vec3 geometric, vec3 normal, float eta, float cos_i, float cos_t,
                      float reflectance, bool reflects, uint beyond)
{
    uint guard = 0u; // singular differentials are caught in make_chain_point
    vec3 direction = at.direction;
    if (reflects) {
        if (has(FEATURE_LOOKUP))
            reflect_differential(at.x, direction, normal, s);
        at.throughput *= reflectance;
        at.direction = reflect(direction, normal);
        if (dot(at.direction, geometric) <= 0.0)
            at.direction = reflect(direction, geometric);
        at.origin = offset_origin(s.position, geometric);
    } else {
        if (has(FEATURE_LOOKUP))
            refract_differential(at.x, direction, normal, s, eta, cos_t, guard);
        at.throughput *= 1.0 - reflectance;
        if (has(FEATURE_TINT))
            at.throughput *= surface_color(s);
        // radiance from the other side arrives scaled by (n_here / n_there)^2
        if ((frame.flags & FLAG_RADIANCE_SCALING) != 0u)
            at.throughput *= eta * eta;
        at.direction = eta * direction + (eta * cos_i - cos_t) * normal;
        if (dot(at.direction, geometric) >= 0.0)
            at.direction -= (dot(at.direction, geometric) + 1e-3) * geometric;
        at.origin = offset_origin(s.position, -geometric);
        at.medium = beyond;
    }
    return at;
}

void main()
{
    uvec2 place = gl_GlobalInvocationID.xy;
    uint number = place.y * frame.width + place.x, layer_size = frame.width * frame.height;
    vec2 within = vec2(0.5); // its pixel
    float share = 1.0;       // of its pixel
    if (PHASE == 1u) {
        uint each = samples_each(lookup.broken, lookup.shown), sample_number = GROUP_SIZE * gl_WorkGroupID.x + gl_LocalInvocationIndex;
        if (each < 2u || sample_number >= each * lookup.broken)
            return;
        uint pixel = broken[sample_number / each];
        place = uvec2(pixel % frame.width, pixel / frame.width);
        within = fract(0.5 + float(sample_number % each) * SAMPLE_STEP);
        share = 1.0 / float(each);
        number = sample_first() + sample_number;
        if (sample_number % each == 0u)
            for (uint layer = 0u; layer < frame.camera_branches; layer++)
                chains[layer * layer_size + pixel].position_normal.w = uintBitsToFloat(NONE);
        layer_size = frame.sample_capacity;
    } else if (place.x >= frame.width || place.y >= frame.height)
        return;
    vec3 ray = camera_ray(vec2(place) + within);
    chain_step at;
    at.origin = frame.eye.xyz;
    at.direction = normalize(ray);
    at.throughput = vec3(1.0);
    at.medium = frame.eye_medium;
    at.x = camera_differential(ray, at.direction);

    surface_gpu result;
    result.relative_position = vec4(0.0, 0.0, 0.0, uintBitsToFloat(0x7f800000u));
    result.normal = vec4(0.0);
    result.albedo = vec4(0.0);
    result.radiance = vec4(0.0);
    target_gpu target;
    target.position_normal = vec4(0.0, 0.0, 0.0, uintBitsToFloat(NONE));

    // The dominant branch first; then, where both are wanted, the weaker one of the first glass.
    chain_step weaker = at;
    uint first_bounce = 0u, weaker_bounce = NONE, guard = 0u;
    const uint layers = has(FEATURE_BRANCHES) ? 2u : 1u;
    for (uint layer = 0u; layer < layers; layer++) {
        chain_point point;
        point.position_normal = vec4(0.0, 0.0, 0.0, uintBitsToFloat(NONE));
        point.axes = uvec4(0u);
        vec3 weight = vec3(0.0);
        if (layer == 1u) {
            at = weaker;
            first_bounce = weaker_bounce;
        }
        for (uint bounce = first_bounce; bounce <= frame.camera_bounces; bounce++) {
            trace_hit hit = trace_closest(at.origin, at.direction, 3.0e38);
            if (hit.instance == TRACE_MISS)
                break;
            surface s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
            uint touching = NONE;
            bool touching_front = false;
            if (has(FEATURE_CONTACT) && scene_materials[s.material].kind == KIND_DIELECTRIC) {
                bool front = dot(at.direction, s.geometric) < 0.0;
                trace_hit other = media_contact(s.position, front ? s.geometric : -s.geometric, hit.instance);
                if (media_take_contact(other, at.direction, hit, touching, touching_front))
                    s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
            }
            material_gpu material = scene_materials[s.material];
            bool front = dot(at.direction, s.geometric) < 0.0;
            vec3 geometric = front ? s.geometric : -s.geometric;
            vec3 normal = front ? s.normal : -s.normal;
            if (dot(normal, at.direction) > -1e-4)
                normal = geometric;
            if (bounce == 0u)
                result.relative_position.w = dot(at.direction * hit.t, frame.forward.xyz);
            if (has(FEATURE_ABSORPTION)) {
                uint here =
                    material.kind == KIND_DIELECTRIC ? media_here(at.medium, s.material, front) : media_top(at.medium);
                if (here != NONE)
                    at.throughput *= exp(-scene_materials[here].absorption.xyz * hit.t);
            }
            if (has(FEATURE_LOOKUP))
                differential_transfer(at.x, at.direction, hit.t, geometric, guard);
            result.radiance.xyz += at.throughput * surface_emission(s);

            if (material.kind != KIND_DIFFUSE)
                point.axes.w = 1u;
            if (material.kind == KIND_DIFFUSE) {
                vec3 albedo = surface_color(s);
                vec3 relative = bounce == 0u ? at.direction * hit.t : s.position - frame.eye.xyz;
                if (layer == 0u) {
                    result.relative_position.xyz = relative;
                    result.normal = vec4(normal, bounce == 0u ? 1.0 : 2.0);
                    result.albedo = vec4(albedo, 0.0);
                }
                if (has(FEATURE_BEAUTY) && PHASE == 0u)
                    result.radiance.xyz += at.throughput * direct_radiance(s.position, geometric, normal, albedo);
                if (bounce == 0u)
                    target.position_normal = vec4(relative, uintBitsToFloat(pack_normal(geometric)));
                else if (has(FEATURE_LOOKUP)) {
                    point = make_chain_point(relative, geometric, at.x, at.throughput, share);
                    weight = at.throughput * albedo * (share / PI);
                }
                break;
            }
            if (!has(FEATURE_CHAINS))
                break; // nobody looks through: caustics land on what is seen directly
            float cos_i = -dot(at.direction, normal);
            if (has(FEATURE_MIRROR) && material.kind == KIND_MIRROR) {
                at = pass_glass(at, s, geometric, normal, 1.0, cos_i, cos_i, 1.0, true, NONE);
                at.throughput *= fresnel_metal(cos_i, surface_color(s));
            } else if (has(FEATURE_THIN) && material.kind == KIND_THIN) {
                float reflectance = fresnel_thin(cos_i, material.color_ior.w);
                if (has(FEATURE_BRANCHES) && weaker_bounce == NONE && layer == 0u && reflectance >= BRANCH_SHARE_MIN) {
                    weaker = pass_glass(at, s, geometric, normal, 1.0, cos_i, cos_i, reflectance, true, NONE);
                    weaker_bounce = bounce + 1u;
                }
                at.throughput *= surface_color(s) * (1.0 - reflectance);
                at.origin = offset_origin(s.position, -geometric);
            } else if (has(FEATURE_DIELECTRIC)) {
                boundary b = media_boundary(at.medium, s.material, front, touching, touching_front);
                float eta = b.eta;
                float cos_t;
                float reflectance = fresnel_dielectric(cos_i, eta, cos_t);
                bool reflects = reflectance > 0.5;
                if (has(FEATURE_BRANCHES) && weaker_bounce == NONE && layer == 0u) {
                    if (min(reflectance, 1.0 - reflectance) >= BRANCH_SHARE_MIN) {
                        weaker = pass_glass(at, s, geometric, normal, eta, cos_i, cos_t, reflectance, !reflects, b.beyond);
                        weaker.direction = normalize(weaker.direction);
                        weaker_bounce = bounce + 1u;
                    }
                }
                at = pass_glass(at, s, geometric, normal, eta, cos_i, cos_t, reflectance, reflects, b.beyond);
            }
            at.direction = normalize(at.direction);
        }
        if (has(FEATURE_LOOKUP)) {
            chains[number + layer * layer_size] = point;
            weights[number + layer * layer_size] = vec4(weight, 0.0);
        }
        if (weaker_bounce == NONE)
            weaker_bounce = frame.camera_bounces + 1u; // nothing to follow in the second layer
    }
    if (PHASE == 0u) {
        surfaces[number] = result;
        targets[number] = target;
    }
}
