#version 460
#extension GL_GOOGLE_include_directive : require
// splat.comp: one thread per photon draws its footprint: walks the ellipse's own span in every pixel row and adds
// to 64-bit fixed-point sums, exact in any order.
//
// Reads   photons, targets
// Writes  irradiance sums in units of frame.irradiance_unit: low and high word per channel
// Source  design 6, 7; aaps-thesis 3.1.3, 5.1.3 to 5.1.5
#include "frame.glsl"
#include "ellipse.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "targets.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 3) buffer sum_buffer { uint sums[]; };

uint overflow = 0u;
shared uint totals[4]; // of the workgroup: kernels evaluated, inside, photons that reached a pixel, overflows

void add_pixel(uint pixel, vec3 value)
{
    bool is_exact;
    if (has(FEATURE_CHROMATIC)) {
        ADD_FIXED(sums[6u * pixel], sums[6u * pixel + 1u], value.x, is_exact);
        overflow += is_exact ? 0u : 1u;
        ADD_FIXED(sums[6u * pixel + 2u], sums[6u * pixel + 3u], value.y, is_exact);
        overflow += is_exact ? 0u : 1u;
        ADD_FIXED(sums[6u * pixel + 4u], sums[6u * pixel + 5u], value.z, is_exact);
        overflow += is_exact ? 0u : 1u;
    } else {
        ADD_FIXED(sums[2u * pixel], sums[2u * pixel + 1u], value.x, is_exact);
        overflow += is_exact ? 0u : 1u;
    }
}

// Walks the pixels that the ellipse overlaps. Each gets its share exactly, as the difference of areas up to its edges, so
// that the shares add up to the whole ellipse whatever their rounding.
void draw_overlaps(photon p, vec3 value, vec3 normal, ivec2 size, inout uint evaluated, inout uint inside, inout uint reached)
{
    screen_ellipse e = ellipse_on_screen(p);
    vec2 extent = sqrt(vec2(e.xx, e.yy));
    float across = extent.x * extent.y, cosine = clamp(e.xy / across, -1.0, 1.0);
    float sine = clamp(sqrt(e.det) / across, 1e-6, 1.0);
    float turn = atan(sine, cosine);
    float disk_px2 = sqrt(e.det);
    int y = max(int(floor(e.middle.y - extent.y)), 0);
    int y_end = min(int(floor(e.middle.y + extent.y)), size.y - 1);
    int x = 1, x_end = 0;
    float low = 0.0, high = 0.0, before = 0.0; // the row's edges, in units of the ellipse; area left of x
    for (;;) {
        if (x > x_end) {
            if (y > y_end)
                break;
            low = clamp((float(y) - e.middle.y) / extent.y, -1.0, 1.0);
            high = clamp((float(y + 1) - e.middle.y) / extent.y, -1.0, 1.0);
            // how far the ellipse reaches in this row: at its extreme point, or at an edge
            float low_width = sine * sqrt((1.0 - low) * (1.0 + low)), high_width = sine * sqrt((1.0 - high) * (1.0 + high));
            float left = low <= -cosine && -cosine <= high ? -1.0 : min(cosine * low - low_width, cosine * high - high_width);
            float right = low <= cosine && cosine <= high ? 1.0 : max(cosine * low + low_width, cosine * high + high_width);
            x = max(int(floor(e.middle.x + extent.x * left)), 0);
            x_end = min(int(floor(e.middle.x + extent.x * right)), size.x - 1);
            float edge = clamp((float(x) - e.middle.x) / extent.x, -1.0, 1.0);
            before = disk_wedge(edge, high, turn, cosine, sine) - disk_wedge(edge, low, turn, cosine, sine);
            y++;
        }
        if (x <= x_end) {
            evaluated++;
            float edge = clamp((float(x + 1) - e.middle.x) / extent.x, -1.0, 1.0);
            float up_to = disk_wedge(edge, high, turn, cosine, sine) - disk_wedge(edge, low, turn, cosine, sine);
            float share = (up_to - before) * disk_px2;
            before = up_to;
            if (share > 0.0) {
                inside++;
                uint pixel = uint((y - 1) * size.x + x);
                if (target_accepts(targets[pixel], p.position.xyz, normal, p.density.w)) {
                    reached = 1u;
                    add_pixel(pixel, value * share);
                }
            }
            x++;
        }
    }
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    if (gl_LocalInvocationIndex < 4u)
        totals[gl_LocalInvocationIndex] = 0u;
    uint evaluated = 0u, inside = 0u, reached = 0u;
    photon p;
    bool is_drawn = index < counters.photon_count;
    if (is_drawn) {
        p = photons[index];
        is_drawn = p.cell != NONE && !(AA == AA_MSAA_SMALL && ellipse_is_small(p)); // those are quads
    }
    if (is_drawn) {
        vec3 normal = unpack_normal(floatBitsToUint(p.position.w));
        vec3 value = p.density.xyz / frame.irradiance_unit;
        if (!has(FEATURE_CHROMATIC))
            value = vec3(channel_sum(value) / 3.0); // all photons have the tint of frame.tint
        vec2 center = p.center.xy, w = p.center.zw;
        ivec2 size = ivec2(int(frame.width), int(frame.height));
        if (AA == AA_PIXEL) {
            ivec2 at = ivec2(floor(center));
            if (all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size))) {
                add_pixel(uint(at.y * size.x + at.x), value);
                evaluated = inside = reached = 1u;
            }
        } else if (AA == AA_FILTER && p.ellipse.w < 0.0) {
            // a box of these sides over at most two by two pixels: each gets its share
            vec2 low = center - 0.5 * p.ellipse.xy;
            vec2 first = floor(low);
            vec2 share = clamp((first + 1.0 - low) / max(p.ellipse.xy, vec2(1e-6)), vec2(0.0), vec2(1.0));
            for (uint k = 0u; k < 4u; k++) {
                ivec2 at = ivec2(first) + ivec2(int(k & 1u), int(k >> 1));
                float part = ((k & 1u) == 0u ? share.x : 1.0 - share.x) * ((k >> 1) == 0u ? share.y : 1.0 - share.y);
                if (part > 0.0 && all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size))) {
                    evaluated++;
                    inside++;
                    uint pixel = uint(at.y * size.x + at.x);
                    if (target_accepts(targets[pixel], p.position.xyz, normal, p.density.w)) {
                        reached = 1u;
                        add_pixel(pixel, value * part);
                    }
                }
            }
        } else if (AA == AA_COVERAGE) {
            draw_overlaps(p, value, normal, size, evaluated, inside, reached);
        } else {
            float u00 = p.ellipse.x, u01 = p.ellipse.y, u11 = p.ellipse.z;
            float a = u00 * u00 - w.x * w.x;
            int y = max(int(ceil(center.y - p.ellipse.w - 0.5)), 0);
            int y_end = min(int(floor(center.y + p.ellipse.w - 0.5)), size.y - 1);
            int x = 1, x_end = 0;
            float oy = 0.0, bent = 1.0;
            // One loop over rows and pixels together: lanes with short rows don't wait for those with long ones.
            for (;;) {
                if (x > x_end) {
                    if (y > y_end)
                        break;
                    // a x^2 + 2 b x + c <= 0 in this row
                    oy = float(y) + 0.5 - center.y;
                    bent = 1.0 + w.y * oy;
                    float b = u00 * u01 * oy - w.x * bent;
                    float c = (u01 * u01 + u11 * u11) * oy * oy - bent * bent;
                    float d = b * b - a * c;
                    float root = sqrt(max(d, 0.0));
                    x = max(int(ceil(center.x + (-b - root) / a - 0.5)), 0);
                    x_end = d < 0.0 ? x - 1 : min(int(floor(center.x + (-b + root) / a - 0.5)), size.x - 1);
                    y++;
                }
                if (x <= x_end) {
                    evaluated++;
                    float ox = float(x) + 0.5 - center.x;
                    float depth = bent + w.x * ox;
                    float q0 = u00 * ox + u01 * oy, q1 = u11 * oy;
                    float r2 = (q0 * q0 + q1 * q1) / (depth * depth);
                    uint pixel = uint((y - 1) * size.x + x);
                    if (r2 < 1.0) {
                        inside++;
                        if (target_accepts(targets[pixel], p.position.xyz, normal, p.density.w)) {
                            reached = 1u;
                            add_pixel(pixel, AA == AA_FILTER ? value * (1.0 - r2) : value);
                        }
                    }
                    x++;
                }
            }
        }
    }
    // Two barriers: three group_counts make six, and 15 % of the time at four pixels a photon.
    barrier();
    atomicAdd(totals[0], evaluated);
    atomicAdd(totals[1], inside);
    atomicAdd(totals[2], reached);
    if (overflow != 0u)
        atomicAdd(totals[3], overflow);
    barrier();
    if (gl_LocalInvocationIndex == 0u) {
        atomicAdd(counters.count[COUNT_KERNEL], totals[0]);
        atomicAdd(counters.count[COUNT_KERNEL_INSIDE], totals[1]);
        atomicAdd(counters.count[COUNT_CONTRIBUTING], totals[2]);
        atomicAdd(counters.count[COUNT_GUARD_OVERFLOW], totals[3]);
    }
}
