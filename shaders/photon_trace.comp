#version 460
#extension GL_GOOGLE_include_directive : require
// photon_trace.comp: one bounce of every photon in flight: trace, interact, hand over to the next bounce.
//
// Reads   scene, queue, photon rays of this bounce
// Writes  photon rays of the next bounce (slots by ray, one or two each), the deposit in the ray's own record,
//         outcome per ray, sums per workgroup, flux by fate
// Source  design 4, 5 (splitting), 6; aaps-thesis 3.1.2, 3.3.1, 3.3.2
#include "frame.glsl"
#define TRACE_EXCLUDES
#include "trace.glsl"
#include "scene.glsl"
#include "media.glsl"
#include "optics.glsl"
#include "scene_differentials.glsl"
#include "photons.glsl"
#include "spread.glsl"
#include "spread_surface.glsl"
#include "branches.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) buffer ray_buffer { photon_ray rays[]; };
layout(std430, binding = BINDING_PASS + 2) writeonly buffer child_buffer { photon_ray children[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer queue_buffer { uint queue[]; };
layout(std430, binding = BINDING_PASS + 4) writeonly buffer outcome_buffer { uint outcomes[]; };
layout(std430, binding = BINDING_PASS + 5) writeonly buffer group_buffer { uvec2 group_totals[]; };
layout(std430, binding = BINDING_PASS + 6) buffer spread_buffer { float spreads[]; };
layout(std430, binding = BINDING_PASS + 7) writeonly buffer child_spread_buffer { float child_spreads[]; };
layout(std430, binding = BINDING_PASS + 8) buffer cost_buffer { uint costs[]; };
layout(std430, binding = BINDING_PASS + 9) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 10) readonly buffer column_buffer { uint columns[]; };

layout(push_constant) uniform push_block { uint parity; };

const uint LAST_NONE = 0u, LAST_REFLECT = 1u, LAST_REFRACT = 2u;
const uint SPLITS_MAX = 6u;
// Below this share of the emitted flux the weaker branch is left to fewer strata, which brings it back to the share: on `square` a third fewer rays for the same error, on `sphere` a sixth; 0.1 to 0.2 are as good.
const float BRANCH_SHARE = 0.15;
const float SPLIT_SHARE_MIN = 1e-2; // of the emitted flux; 1e-3 cost 30 % more rays for the same error on `sphere`

// Fate of this thread's ray and what it did, for the ledger.
uint fate = FATE_NONE;
float fate_flux = 0.0;
float absorbed = 0.0;
uint guard = 0u;

void finish(uint which, vec3 flux)
{
    fate = which;
    fate_flux = channel_sum(flux);
}

// Continues the ray in child slot `slot`.
void spawn(photon_ray ray, uint slot, vec3 origin, vec3 direction, differential x, photon_spread spread, vec3 flux,
           uint branch, uint last, uint splits, uint medium, float flown)
{
    ray.origin.xyz = origin;
    ray.direction = vec4(direction, flown);
    ray.flux.xyz = flux;
    ray_set_differential(ray, x);
    ray.hash = hash_mix(ray.hash, branch + 1u);
    ray.medium = medium;
    ray.state = (ray.state & STATE_KEPT) + ((ray.state & 0xffu) + 1u) + (splits << 8) + (last << 12);
    children[slot] = ray;
    SPREAD_STORE(child_spreads, slot, spread);
}

// From here on the photon is one channel's share of the light.
void take_band(inout photon_ray ray, inout vec3 flux, uint band, float factor)
{
    flux *= factor * vec3(band == 1u ? 1.0 : 0.0, band == 2u ? 1.0 : 0.0, band == 3u ? 1.0 : 0.0);
    ray.state |= band << STATE_BAND_SHIFT;
    media_wave = BAND_MIDDLES[band - 1u] - DISPERSION_MIDDLE;
}

// The slopes of a rough surface where it has no footprint to widen: one of them, at random.
vec3 rough_normal(vec3 n, float roughness, uint hash)
{
    float radius = roughness * roughness * sqrt(-log(hash_unit(hash_mix(hash, 0x60u))));
    float angle = 2.0 * PI * hash_unit(hash_mix(hash, 0x61u));
    vec3 n1 = normalize(abs(n.y) < 0.9 ? cross(n, vec3(0.0, 1.0, 0.0)) : cross(n, vec3(1.0, 0.0, 0.0)));
    return normalize(n + radius * (cos(angle) * n1 + sin(angle) * cross(n, n1)));
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    bool in_flight = index < counters.queue[4u * parity + QUEUE_COUNT];
    uint outcome = 0u;
    uint counts = 0u; // hits in the low half, splits in the high half
    uint culled_energy = 0u;

    // Every lane calls the tracer, those without a ray with no distance to go: see trace.glsl.
    uint entry = in_flight ? queue[index] : 0u;
    uint slot = has(FEATURE_DISPERSION) ? entry & QUEUE_SLOT_MASK : entry;
    photon_ray ray = rays[slot];
    trace_hit hit = trace_closest_all(ray.origin.xyz, ray.direction.xyz, in_flight ? 3.0e38 : 0.0);
    uint touching = NONE;
    bool touching_front = false;
    if (has(FEATURE_CONTACT) && in_flight && hit.instance != TRACE_MISS) {
        surface s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
        if (scene_materials[s.material].kind == KIND_DIELECTRIC) {
            bool front = dot(ray.direction.xyz, s.geometric) < 0.0;
            trace_hit other = media_contact(s.position, front ? s.geometric : -s.geometric, hit.instance);
            media_take_contact(other, ray.direction.xyz, hit, touching, touching_front);
        }
    }
    if (in_flight) {
        if (DENSITY == DENSITY_ERROR_RULE)
            atomicAdd(costs[ray.cell], 1u);
        uint stride = counters.stride[parity];
        uint bounces = ray.state & 0xffu;
        uint splits = (ray.state >> 8) & 0xfu;
        uint last = (ray.state >> 12) & 3u;
        vec3 direction = ray.direction.xyz;
        vec3 flux = ray.flux.xyz;
        differential x = ray_differential(ray);
        photon_spread spread;
        SPREAD_LOAD(spreads, slot, spread);
        uint band = 0u;
        if (has(FEATURE_DISPERSION)) {
            band = (ray.state >> STATE_BAND_SHIFT) & 3u;
            if (band != 0u)
                media_wave = BAND_MIDDLES[band - 1u] - DISPERSION_MIDDLE;
            else if ((entry >> QUEUE_BAND_SHIFT) != 0u) {
                // traced again from where the last bounce left it: three threads share this record, and none writes
                // to it, for they meet the dispersive glass that the first trace met
                band = entry >> QUEUE_BAND_SHIFT;
                take_band(ray, flux, band, 1.0);
            }
        }

        if (hit.instance == TRACE_MISS) {
            finish(FATE_ESCAPED, flux);
        } else {
            counts = 1u;
            surface s = surface_fetch(hit.instance, hit.triangle, hit.barycentrics);
            material_gpu material = scene_materials[s.material];
            bool front = dot(direction, s.geometric) < 0.0;
            vec3 geometric = front ? s.geometric : -s.geometric; // opposes the ray
            vec3 normal = front ? s.normal : -s.normal;
            if (dot(normal, direction) > -1e-4)
                normal = geometric; // interpolation tipped it past grazing
            float flown = ray.direction.w + hit.t;

            if (has(FEATURE_ABSORPTION)) {
                uint here = material.kind == KIND_DIELECTRIC ? media_here(ray.medium, s.material, front) : media_top(ray.medium);
                if (here != NONE) {
                    vec3 kept = flux * exp(-scene_materials[here].absorption.xyz * hit.t);
                    absorbed += channel_sum(flux - kept);
                    flux = kept;
                }
            }
            differential_transfer(x, direction, hit.t, geometric, guard);
            spread_transfer(spread, direction, hit.t, geometric);
            if (has(FEATURE_ROUGH) && AA == AA_PIXEL && material.kind != KIND_DIFFUSE && material.absorption.w > ROUGHNESS_MIN) {
                vec3 tilted = rough_normal(normal, material.absorption.w, ray.hash);
                normal = dot(tilted, direction) < -1e-4 ? tilted : normal;
            }

            if (material.kind == KIND_DIFFUSE) {
                if (bounces == 0u) {
                    finish(FATE_DIRECT, flux);
                } else {
                    outcome = OUTCOME_PHOTON;
                    ray.origin.xyz = s.position;
                    ray.direction = vec4(geometric, flown);
                    ray.flux.xyz = flux;
                    if (has(FEATURE_TEXTURED_FLUX))
                        ray.dd_u2_dd_v = vec4(surface_color(s), 0.0);
                    ray.dp_u_v0 = vec4(x.p_u, x.p_v.x);
                    ray.dp_v1_dd_u = vec4(x.p_v.yz, 0.0, 0.0);
                    // the unbiased mode knows exactly whether the camera sees the point
                    if (AA == AA_PIXEL) {
                        vec3 start = offset_origin(s.position, geometric);
                        vec3 to_eye = frame.eye.xyz - start;
                        bool hidden = dot(to_eye, geometric) <= 0.0 || trace_any(start, to_eye, 1.0);
                        ray.state |= hidden ? STATE_HIDDEN : 0u;
                    }
                    rays[slot] = ray;
                    SPREAD_STORE(spreads, slot, spread);
                }
            } else if (bounces >= frame.max_bounces) {
                finish(FATE_BOUNCE_LIMIT, flux);
            } else if (channel_sum(flux) < frame.cull_energy * ray.flux.w) {
                finish(FATE_CULLED_ENERGY, flux);
                culled_energy = 1u;
            } else if (has(FEATURE_DISPERSION) && stride == 3u && band == 0u && material.kind == KIND_DIELECTRIC &&
                       material.emission.w > 0.0) {
                children[stride * index] = ray;
                SPREAD_LOAD(spreads, slot, spread);
                SPREAD_STORE(child_spreads, stride * index, spread);
                outcome = OUTCOME_CHILD0 | OUTCOME_BANDS;
                absorbed = 0.0;
            } else if (has(FEATURE_MIRROR) && material.kind == KIND_MIRROR) {
                float cos_i = -dot(direction, normal);
                vec3 kept = flux * fresnel_metal(cos_i, surface_color(s));
                absorbed += channel_sum(flux - kept);
                vec3 turned = reflect(direction, normal);
                differential y = x;
                reflect_differential(y, direction, normal, s);
                if (dot(turned, geometric) <= 0.0)
                    turned = reflect(direction, geometric);
                spread_reflect(spread, direction, normal, s, normalize(turned), material.absorption.w);
                spawn(ray, stride * index, offset_origin(s.position, geometric), normalize(turned), y, spread, kept, 0u,
                      LAST_REFLECT, splits, ray.medium, flown);
                outcome = OUTCOME_CHILD0;
            } else if (has(FEATURE_DIELECTRIC | FEATURE_THIN)) {
                bool thin = has(FEATURE_THIN) && material.kind == KIND_THIN;
                if (has(FEATURE_DISPERSION) && band == 0u && !thin && material.emission.w > 0.0) {
                    // no room for three: one of them stands for all
                    band = 1u + hash_mix(ray.hash, 0x3bu) % 3u;
                    take_band(ray, flux, band, 3.0);
                    differential_scale(x, sqrt(3.0));
                }
                boundary b = media_boundary(ray.medium, s.material, front, touching, touching_front);
                float eta = b.eta;
                float cos_i = -dot(direction, normal);
                float cos_t;
                float reflectance = fresnel_dielectric(cos_i, eta, cos_t);
                vec3 transmitted = flux;
                if (has(FEATURE_TINT) && !thin)
                    transmitted = flux * surface_color(s);
                if (thin) {
                    reflectance = fresnel_thin(cos_i, material.color_ior.w);
                    transmitted = flux * surface_color(s);
                    // the tint is paid by what goes through
                    cos_t = cos_i;
                }
                vec3 reflected_flux = flux * reflectance;
                vec3 refracted_flux = transmitted * (1.0 - reflectance);
                float lost_tint = channel_sum(flux - transmitted) * (1.0 - reflectance);

                // which branches to follow
                bool take_reflect, take_refract;
                uint weak_branch = 0u;   // 1: refraction, 2: reflection, when both are followed
                vec2 weak_scale = vec2(1.0); // its photons lie that much further apart, in u and v
                uint weak_state = 0u;
                float scale = 1.0; // of a branch chosen at random: its photons lie that much further apart
                uint new_splits = splits;
                uint rule = SPLIT;
                float weaker = min(reflectance, 1.0 - reflectance) * channel_sum(flux);
                bool may_split = stride >= 2u && splits < SPLITS_MAX;
                if (reflectance >= 1.0) {
                    take_reflect = true;
                    take_refract = false;
                } else if (rule == SPLIT_ONCE_RULE) {
                    bool is_first = splits == 0u;
                    take_refract = is_first || last != LAST_REFLECT;
                    take_reflect = is_first ? stride >= 2u : last == LAST_REFLECT;
                    // past the split the other branch is not followed: that light is lost, and said so
                    if (!take_refract || !take_reflect)
                        finish(FATE_SPLIT_ONCE, take_reflect ? refracted_flux : reflected_flux);
                    if (!take_refract)
                        absorbed += lost_tint;
                    if (is_first && stride == 1u)
                        new_splits++;
                } else if (rule == SPLIT_ENERGY_RULE && may_split && weaker >= SPLIT_SHARE_MIN * ray.flux.w) {
                    take_reflect = take_refract = true;
                    // a dim one: a few strata follow it for all
                    uint had = 1u << ((ray.state >> STATE_SPACING_SHIFT) & 3u), apart = had;
                    if (DENSITY != DENSITY_UNIFORM_RULE && (ray.state & STATE_FOLLOWS_ALL) == 0u)
                        while (apart < 4u && weaker * float(apart * apart) < BRANCH_SHARE * ray.flux.w * float(had * had))
                            apart *= 2u;
                    weak_state = uint(findMSB(apart)) << STATE_SPACING_SHIFT;
                    bool weak_is_reflect = reflectance < 0.5;
                    if (apart > had) {
                        bool carries = (ray.state & (apart << (STATE_FOLLOWS - 1u))) != 0u;
                        weak_scale = branch_width(columns[ray.cell], tree[ray.cell], apart) /
                                     branch_width(columns[ray.cell], tree[ray.cell], had);
                        vec3 weak_flux = weak_is_reflect ? reflected_flux : refracted_flux;
                        float others = carries ? weak_scale.x * weak_scale.y - 1.0 : 0.0;
                        if (carries) {
                            finish(FATE_THINNED_IN, others * weak_flux);
                            if (weak_is_reflect)
                                reflected_flux *= 1.0 + others;
                            else {
                                refracted_flux *= 1.0 + others;
                                lost_tint *= 1.0 + others;
                            }
                        } else {
                            finish(FATE_THINNED_OUT, weak_flux + (weak_is_reflect ? vec3(0.0) : flux - transmitted));
                            take_reflect = !weak_is_reflect;
                            take_refract = weak_is_reflect;
                        }
                    }
                    weak_branch = weak_is_reflect ? 2u : 1u;
                } else {
                    take_reflect = hash_unit(hash_mix(ray.hash, 0x51u)) < reflectance;
                    take_refract = !take_reflect;
                    float p = take_reflect ? reflectance : 1.0 - reflectance;
                    reflected_flux = flux;
                    refracted_flux = transmitted;
                    lost_tint = take_refract ? channel_sum(flux - transmitted) : 0.0;
                    scale = inversesqrt(max(p, 1e-4));
                }
                if (take_refract)
                    absorbed += lost_tint;
                if (take_reflect && take_refract) {
                    new_splits++;
                    counts |= 1u << 16;
                }
                differential_scale(x, scale);

                uint next = stride * index;
                uint flags = ray.state;
                if (take_refract) {
                    differential y = x;
                    if (weak_branch == 1u) {
                        differential_scale_both(y, weak_scale);
                        ray.state = (flags & ~STATE_SPACING) | weak_state;
                    }
                    photon_spread z = spread;
                    vec3 turned = direction;
                    uint medium = ray.medium;
                    if (!thin) {
                        if (eta != 1.0)
                            turned = normalize(eta * direction + (eta * cos_i - cos_t) * normal);
                        refract_differential(y, direction, normal, s, eta, cos_t, guard);
                        if (dot(turned, geometric) >= 0.0)
                            turned = normalize(turned - (dot(turned, geometric) + 1e-3) * geometric);
                        float eta_change = 0.0;
                        if (SPREAD_BAND && band != 0u) {
                            float middle = media_wave, half_width = 0.5 * BAND_WIDTHS[band - 1u];
                            media_wave = middle + half_width;
                            eta_change = media_boundary(ray.medium, s.material, front, touching, touching_front).eta;
                            media_wave = middle - half_width;
                            eta_change -= media_boundary(ray.medium, s.material, front, touching, touching_front).eta;
                            media_wave = middle;
                        }
                        spread_refract(z, direction, normal, s, eta, cos_t, turned, material.absorption.w, sqrt(0.5) * eta_change);
                        medium = b.beyond;
                    } else
                        spread_pass(z, direction, normal, material.absorption.w);
                    spawn(ray, next, offset_origin(s.position, -geometric), turned, y, z, refracted_flux, 0u,
                          LAST_REFRACT, new_splits, medium, flown);
                    outcome |= OUTCOME_CHILD0;
                    next++;
                }
                if (take_reflect) {
                    vec3 turned = reflect(direction, normal);
                    differential y = x;
                    ray.state = flags;
                    if (weak_branch == 2u) {
                        differential_scale_both(y, weak_scale);
                        ray.state = (flags & ~STATE_SPACING) | weak_state;
                    }
                    photon_spread z = spread;
                    reflect_differential(y, direction, normal, s);
                    if (dot(turned, geometric) <= 0.0)
                        turned = reflect(direction, geometric);
                    spread_reflect(z, direction, normal, s, normalize(turned), material.absorption.w);
                    spawn(ray, next, offset_origin(s.position, geometric), normalize(turned), y, z, reflected_flux, 1u,
                          LAST_REFLECT, new_splits, ray.medium, flown);
                    outcome |= (outcome & OUTCOME_CHILD0) != 0u ? OUTCOME_CHILD1 : OUTCOME_CHILD0;
                }
            }
        }
        outcomes[index] = outcome;
    }

    ledger_add(fate, fate_flux, absorbed);
    // children and photons of the workgroup, then statistics: each fits 16 bits for 64 threads
    uint totals = group_count((outcome & 1u) + ((outcome >> 1) & 1u) + ((outcome & OUTCOME_BANDS) >> 2) +
                               ((outcome & OUTCOME_PHOTON) << 14));
    uint events = group_count(counts);
    uint guards = group_count(guard + (culled_energy << 16));
    uint caps = group_count(trace_guard);
    if (gl_LocalInvocationIndex == 0u) {
        group_totals[gl_WorkGroupID.x] = uvec2(totals & 0xffffu, totals >> 16);
        atomicAdd(counters.count[COUNT_HITS], events & 0xffffu);
        atomicAdd(counters.count[COUNT_SPLIT], events >> 16);
        if (guards != 0u) {
            atomicAdd(counters.count[COUNT_GUARD_DIFFERENTIAL], guards & 0xffffu);
            atomicAdd(counters.count[COUNT_CULLED_ENERGY], guards >> 16);
        }
        if (caps != 0u)
            atomicAdd(counters.count[COUNT_GUARD_TRAVERSAL], caps);
    }
}
