#version 460
#extension GL_GOOGLE_include_directive : require
// photon_compact.comp: lines up the next bounce's queue and turns deposits into photons ready to be drawn.
//
// Reads   outcomes, prefix sums, photon rays, quadtree leaves, targets
// Writes  queue of the next bounce, photon list (both in task and branch order), flux by fate; where somebody looks
//         through glass and mirrors, photons to be looked up there, seen directly or not
// Source  design 5 (culling), 6 (one covariance), 7; aaps-thesis 3.1.2, 3.3.5
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "spread.glsl"
#include "targets.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer ray_buffer { photon_ray rays[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer queue_buffer { uint queue[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer outcome_buffer { uint outcomes[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer group_buffer { uvec2 group_starts[]; };
layout(std430, binding = BINDING_PASS + 6) writeonly buffer next_buffer { uint next_queue[]; };
layout(std430, binding = BINDING_PASS + 7) writeonly buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 8) readonly buffer tree_buffer { uint tree[]; };
layout(std430, binding = BINDING_PASS + 9) writeonly buffer seen_buffer { lookup_photon seen[]; };
layout(std430, binding = BINDING_PASS + 10) readonly buffer spread_buffer { float spreads[]; };
layout(push_constant) uniform push_block { uint parity; };

const float SPREAD_RADIUS_MAX = 1024.0; // px

shared uint group_outcomes[GROUP_SIZE];

uint fate = FATE_NONE;
uint guard = 0u;   // footprints that are not finite
uint limited = 0u; // by max_radius or max_anisotropy

bool sees(vec2 pixel, vec3 position, vec3 normal, float slack)
{
    if (any(lessThan(pixel, vec2(0.0))) || any(greaterThanEqual(pixel, vec2(float(frame.width), float(frame.height)))))
        return false;
    return target_accepts(targets[uint(pixel.y) * frame.width + uint(pixel.x)], position, normal, slack);
}

// Covariance of what spreads the photon, m^2 in the tangent plane: xx, xy, yy; at most `limit` along both axes together.
vec3 spread_covariance(uint slot, vec3 t1, vec3 t2, float limit)
{
    photon_spread spread;
    SPREAD_LOAD(spreads, slot, spread);
    vec3 c = vec3(0.0);
    for (uint k = 0u; k < 5u; k++) {
        if (k < 2u ? !SPREAD_EMITTER : k < 4u ? !SPREAD_LOBE : !SPREAD_BAND)
            continue;
        vec3 p = k == 0u ? spread.emitter.p_u : k == 1u ? spread.emitter.p_v : k == 2u ? spread.lobe.p_u : k == 3u ? spread.lobe.p_v : spread.band_p;
        vec2 a = vec2(dot(p, t1), dot(p, t2));
        c += vec3(a.x * a.x, a.x * a.y, a.y * a.y);
    }
    float largest = c.x + c.z;
    if (!is_finite(largest)) {
        guard++;
        c = vec3(0.0);
    } else if (largest > limit) {
        limited = 1u;
        c *= limit / largest;
    }
    return c;
}

// Strata as small as a 64th of what spreads them suffice: smaller ones only cost kernels. `area` in px^2.
float spread_area_scale(float area)
{
    return frame.target_area / max(frame.target_area, area / 64.0);
}

// The same photon without a camera: its footprint in metres.
lookup_photon make_lookup_photon(photon_ray ray, uint slot)
{
    lookup_photon p;
    vec3 position = ray.origin.xyz - frame.eye.xyz;
    uint packed = pack_normal(ray.direction.xyz);
    vec3 t1, t2;
    tangent_frame(unpack_normal(packed), t1, t2);
    differential x = ray_differential(ray);
    vec2 a = vec2(dot(x.p_u, t1), dot(x.p_u, t2)), b = vec2(dot(x.p_v, t1), dot(x.p_v, t2));
    if (!is_finite(dot(a, a) + dot(b, b)))
        a = b = vec2(0.0);
    float cxx = frame.kappa * (a.x * a.x + b.x * b.x);
    float cxy = frame.kappa * (a.x * a.y + b.x * b.y);
    float cyy = frame.kappa * (a.y * a.y + b.y * b.y);
    // The limits of make_photon, as if the point were seen straight from the eye.
    float pixel2 = dot(position, position) * frame.forward.w;
    float middle = 0.5 * (cxx + cyy);
    float apart = sqrt(0.25 * (cxx - cyy) * (cxx - cyy) + cxy * cxy);
    float major = middle + apart, minor = max(middle - apart, 0.0);
    float limit = pixel2 * min(frame.max_radius * frame.max_radius,
                               frame.max_anisotropy * frame.max_anisotropy *
                                   (minor / max(pixel2, 1e-30) + frame.filter_radius * frame.filter_radius));
    if (major > limit) {
        vec2 e = abs(cxx - major) > abs(cyy - major) ? vec2(cxy, major - cxx) : vec2(major - cyy, cxy);
        // from its axes, not by subtraction: what is left of a very long footprint would be rounding
        e *= inversesqrt(max(dot(e, e), 1e-30));
        minor = min(minor, limit);
        cxx = minor + (limit - minor) * e.x * e.x;
        cxy = (limit - minor) * e.x * e.y;
        cyy = minor + (limit - minor) * e.y * e.y;
    }
    float spread = 0.25 * sqrt(frame.kappa) * (length(a) + length(b));
    float area = abs(a.x * b.y - a.y * b.x);
    if (SPREADS) {
        vec3 wide = spread_covariance(slot, t1, t2, SPREAD_RADIUS_MAX * SPREAD_RADIUS_MAX * pixel2);
        cxx += wide.x;
        cxy += wide.y;
        cyy += wide.z;
        spread += 0.25 * sqrt(wide.x + wide.z);
        area *= spread_area_scale(sqrt(max(wide.x * wide.z - wide.y * wide.y, 0.0)) / pixel2);
    }
    p.position = vec4(position, uintBitsToFloat(packed));
    // Where photons focus and the glass magnifies, neither footprint nor pixel bounds the kernel: an eighth of a pixel.
    float least = pixel2 * (1.0 / 64.0);
    p.covariance = vec4(max(cxx, 0.0) + least, cxy, max(cyy, 0.0) + least, min(spread, 0.25 * frame.max_radius * sqrt(pixel2)));
    p.flux = vec4(ray.flux.xyz, area);
    p.cell = fate == FATE_CULLED_SOLID_ANGLE ? NONE : photon_cell(ray);
    return p;
}

photon make_photon(photon_ray ray, uint slot)
{
    photon p;
    vec3 position = ray.origin.xyz - frame.eye.xyz;
    vec3 normal = ray.direction.xyz;
    differential x = ray_differential(ray);
    p.position = vec4(position, uintBitsToFloat(pack_normal(normal)));
    p.cell = NONE;
    p.area = 0.0;
    p.root = 0.0;
    float samples = float(tree[ray.cell]);
    float total = channel_sum(ray.flux.xyz);
    p.shape = packHalf2x16(vec2(total / max(ray.flux.w * samples, 1e-30), 0.0));
    p.ellipse = vec4(0.0);
    p.center = vec4(0.0);
    p.density = vec4(0.0);

    if (frame.cull_magnification > 0.0) {
        // footprint per unit of the light's own solid angle (or beam area), against free flight: design 5
        float flown = max(ray.direction.w, 1e-12);
        float magnification = length(cross(x.p_u, x.p_v)) * abs(ray.origin.w);
        if (ray.origin.w > 0.0)
            magnification /= flown * flown;
        if (magnification > frame.cull_magnification) {
            fate = FATE_CULLED_SOLID_ANGLE;
            return p;
        }
    }

    // The tangent plane and how it projects.
    float z = dot(position, frame.forward.xyz);
    float facing = -dot(normal, position);
    fate = FATE_CULLED_VISIBILITY;
    if (!(z > 0.0) || !(facing > 0.0))
        return p;
    vec3 t1 = normalize(abs(normal.y) < 0.9 ? cross(normal, vec3(0.0, 1.0, 0.0)) : cross(normal, vec3(1.0, 0.0, 0.0)));
    vec3 t2 = cross(normal, t1);
    vec2 screen = vec2(dot(position, frame.right.xyz), dot(position, frame.up.xyz)) / z;
    vec2 scale = frame.center.xy / z;
    vec2 c = vec2(dot(t1, frame.forward.xyz), dot(t2, frame.forward.xyz));
    vec2 j1 = scale * (vec2(dot(t1, frame.right.xyz), dot(t1, frame.up.xyz)) - screen * c.x);
    vec2 j2 = scale * (vec2(dot(t2, frame.right.xyz), dot(t2, frame.up.xyz)) - screen * c.y);
    float det_j = j1.x * j2.y - j1.y * j2.x; // px^2 per m^2
    vec2 center = frame.center.zw + frame.center.xy * screen;
    if (!is_finite(det_j) || abs(det_j) < 1e-20 || any(greaterThan(abs(center), vec2(1e6))))
        return p;

    vec2 a = j1 * dot(x.p_u, t1) + j2 * dot(x.p_u, t2);
    vec2 b = j1 * dot(x.p_v, t1) + j2 * dot(x.p_v, t2);
    if (!is_finite(dot(a, a) + dot(b, b))) {
        guard++;
        a = b = vec2(0.0);
    }
    float area = abs(a.x * b.y - a.y * b.x);

    // Everything adds up in the covariance, in px^2.
    // det C without the cancellation of cxx cyy - cxy^2 on thin footprints, as long as no limit acts
    float det_free = frame.kappa * frame.kappa * area * area;
    float filter2 = AA == AA_FILTER ? frame.filter_radius * frame.filter_radius : 1e-6;
    float cxx = frame.kappa * (a.x * a.x + b.x * b.x);
    float cxy = frame.kappa * (a.x * a.y + b.x * b.y);
    float cyy = frame.kappa * (a.y * a.y + b.y * b.y);

    vec3 wide = vec3(0.0);
    if (SPREADS) {
        vec3 m = spread_covariance(slot, t1, t2, SPREAD_RADIUS_MAX * SPREAD_RADIUS_MAX / abs(det_j));
        wide = vec3(j1.x * j1.x * m.x + 2.0 * j1.x * j2.x * m.y + j2.x * j2.x * m.z,
                    j1.x * j1.y * m.x + (j1.x * j2.y + j1.y * j2.x) * m.y + j2.x * j2.y * m.z,
                    j1.y * j1.y * m.x + 2.0 * j1.y * j2.y * m.y + j2.y * j2.y * m.z);
    }

    // A photon smaller than a pixel is shared out among the pixels it overlaps, as a box of the same variance: what
    // many of them add up to is the pixel's exact average, which no sampled kernel reaches.
    vec2 box = sqrt(2.0 * vec2(cxx + wide.x, cyy + wide.z));
    bool is_small = AA == AA_FILTER && max(box.x, box.y) <= 1.0;

    // Limits act on the singular values of the footprint, never on its energy.
    float middle = 0.5 * (cxx + cyy);
    float apart = sqrt(0.25 * (cxx - cyy) * (cxx - cyy) + cxy * cxy);
    float major = middle + apart, minor = max(middle - apart, 0.0);
    float limit = min(frame.max_radius * frame.max_radius, frame.max_anisotropy * frame.max_anisotropy * (minor + filter2));
    float trace_free = cxx + cyy;
    vec2 axis = abs(cxx - major) > abs(cyy - major) ? vec2(cxy, major - cxx) : vec2(major - cyy, cxy);
    float along_u = dot(a, axis), along_v = dot(b, axis);
    float from_u = along_u * along_u / max(along_u * along_u + along_v * along_v, 1e-30);
    p.shape |= (uint(clamp(from_u, 0.0, 1.0) * 255.0) << 16);
    bool is_limited = !is_small && major > limit;
    if (is_limited) {
        // along the major axis e: C -= (major - limit) e e^T
        float length2 = dot(axis, axis);
        if (length2 > 0.0) {
            vec2 e = axis * inversesqrt(length2);
            float excess = major - limit;
            cxx -= excess * e.x * e.x;
            cxy -= excess * e.x * e.y;
            cyy -= excess * e.y * e.y;
        }
        if (minor > limit) {
            cxx = cyy = limit;
            cxy = 0.0;
        }
        limited = 1u;
    }
    cxx = max(cxx, 0.0) + wide.x + filter2;
    cxy += wide.y;
    cyy = max(cyy, 0.0) + wide.z + filter2;
    float det_c = max(is_limited || SPREADS ? cxx * cyy - cxy * cxy : det_free + filter2 * trace_free + filter2 * filter2, filter2 * filter2);

    // Perspective: 1 + w.o is depth over depth; kept away from the horizon.
    vec2 w = -vec2(j2.y * c.x - j1.y * c.y, -j2.x * c.x + j1.x * c.y) / (det_j * z);
    float bend = sqrt(max(w.x * w.x * cxx + 2.0 * w.x * w.y * cxy + w.y * w.y * cyy, 0.0));
    if (bend > 0.5) {
        w *= 0.5 / bend;
        bend = 0.5;
    }
    float u00 = sqrt(cyy / det_c);
    float u01 = -cxy / (det_c * u00);
    float u11 = inversesqrt(cyy);
    vec2 extent = is_small ? vec2(1.0) : sqrt(vec2(cxx, cyy)) / (1.0 - bend);

    if (AA == AA_PIXEL) {
        if ((ray.state & STATE_HIDDEN) != 0u || any(lessThan(center, vec2(0.0))) ||
            any(greaterThanEqual(center, vec2(float(frame.width), float(frame.height)))))
            return p;
    } else if (any(lessThan(center + extent, vec2(0.0))) ||
               any(greaterThan(center - extent, vec2(float(frame.width), float(frame.height)))))
        return p;

    float spread = 0.25 * sqrt(frame.kappa) * (length(x.p_u) + length(x.p_v));
    if (SPREADS)
        spread += 0.25 * sqrt((wide.x + wide.z) / abs(det_j));
    float slack = min(spread, 0.25 * frame.max_radius * inversesqrt(abs(det_j))) + inversesqrt(abs(det_j));
    bool sees_center = AA == AA_PIXEL || sees(center, position, normal, slack);
    bool sees_any = sees_center;
    if (!sees_any) {
        vec2 along = vec2(cxy / cyy, 1.0) * sqrt(cyy) * 0.7;
        vec2 across = vec2(sqrt(det_c / cyy), 0.0) * 0.7;
        sees_any = sees(center + along, position, normal, slack) || sees(center - along, position, normal, slack) ||
                   sees(center + across, position, normal, slack) || sees(center - across, position, normal, slack);
    }
    if (!sees_any)
        return p;
    // A photon hidden at its own place but not at its rim is drawn; its flux counts as hidden, as the flux that
    // a visible neighbour spills behind the edge counts as seen.
    fate = sees_center ? FATE_SPLATTED : FATE_CULLED_VISIBILITY;

    p.cell = photon_cell(ray);
    // Photons at a rim count as well: a coarse one just out of sight spills more light into view than it should.
    p.area = photon_area(area);
    if (SPREADS)
        p.area *= spread_area_scale(sqrt(max(wide.x * wide.z - wide.y * wide.y, 0.0)));
    p.root = photon_root(p.area, total);
    p.ellipse = vec4(u00, u01, u11, extent.y);
    p.center = vec4(center, w);
    if (is_small) {
        p.ellipse = vec4(box, 0.0, -1.0);
        p.density = vec4(ray.flux.xyz * abs(det_j), slack);
    } else if (AA == AA_PIXEL)
        p.density = vec4(ray.flux.xyz * (has(FEATURE_TEXTURED_FLUX) ? ray.dd_u2_dd_v.xyz : vec3(1.0)) * abs(det_j), slack);
    else if (AA == AA_FILTER)
        p.density = vec4(ray.flux.xyz * (2.0 * abs(det_j) / (PI * sqrt(det_c))), slack);
    else
        p.density = vec4(ray.flux.xyz * (abs(det_j) / (PI * sqrt(det_c))), slack);
    return p;
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    uint local = gl_LocalInvocationIndex;
    uint outcome = index < counters.queue[4u * parity + QUEUE_COUNT] ? outcomes[index] : 0u;
    group_outcomes[local] = outcome;
    barrier();
    uvec2 before = group_starts[gl_WorkGroupID.x];
    for (uint k = 0u; k < local; k++) {
        uint other = group_outcomes[k];
        before += uvec2((other & 1u) + ((other >> 1) & 1u) + ((other & OUTCOME_BANDS) >> 2), (other >> 2) & 1u);
    }
    uint slot = counters.stride[parity] * index;
    if (has(FEATURE_DISPERSION) && (outcome & OUTCOME_BANDS) != 0u) {
        for (uint band = 1u; band <= 3u; band++)
            next_queue[before.x++] = slot | (band << QUEUE_BAND_SHIFT);
    } else if ((outcome & OUTCOME_CHILD0) != 0u)
        next_queue[before.x++] = slot;
    if ((outcome & OUTCOME_CHILD1) != 0u)
        next_queue[before.x] = slot + 1u;
    float flux = 0.0;
    uint is_drawn = 0u;
    if ((outcome & OUTCOME_PHOTON) != 0u) {
        photon_ray ray = rays[queue[index] & QUEUE_SLOT_MASK];
        photon p = make_photon(ray, queue[index] & QUEUE_SLOT_MASK);
        photons[counters.photon_base + before.y] = p;
        if (has(FEATURE_LOOKUP))
            seen[counters.photon_base + before.y] = make_lookup_photon(ray, queue[index] & QUEUE_SLOT_MASK);
        flux = channel_sum(ray.flux.xyz);
        is_drawn = p.cell != NONE ? 1u : 0u;
    }
    ledger_add(fate, flux, 0.0);
    uint drawn = group_count(is_drawn + (guard << 10) + (limited << 20));
    uint culled = group_count((fate == FATE_CULLED_VISIBILITY && is_drawn == 0u ? 1u : 0u) +
                              (fate == FATE_CULLED_SOLID_ANGLE ? 1u << 16 : 0u));
    if (local == 0u) {
        atomicAdd(counters.count[COUNT_SPLATTED], drawn & 0x3ffu);
        atomicAdd(counters.count[COUNT_GUARD_FOOTPRINT], (drawn >> 10) & 0x3ffu);
        atomicAdd(counters.count[COUNT_LIMITED], drawn >> 20);
        atomicAdd(counters.count[COUNT_CULLED_VISIBILITY], culled & 0xffffu);
        atomicAdd(counters.count[COUNT_CULLED_SOLID_ANGLE], culled >> 16);
    }
}
