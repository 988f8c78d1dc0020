#version 460
#extension GL_GOOGLE_include_directive : require
// splat.comp: one thread per photon draws its footprint: walks the ellipse's own span in every pixel row and adds
// to 64-bit fixed-point sums, exact in any order. Wide ones are handed out in pieces of some rows.
// PHASE 1: a workgroup draws a piece, eight rows by eight pixels at a time, so that no thread walks over the picture alone.
//
// Reads   photons, targets
// Writes  irradiance sums in units of frame.irradiance_unit: low and high word per channel; pieces
// Source  design 6, 7; aaps-thesis 3.1.3, 5.1.3 to 5.1.5
#include "frame.glsl"
#include "ellipse.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "targets.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 2) readonly buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 3) buffer sum_buffer { uint sums[]; };
layout(std430, binding = BINDING_PASS + 4) buffer piece_buffer { splat_piece pieces[]; };
layout(constant_id = 8) const uint PHASE = 0u;

const float ALONE_MAX = 256.0;   // pixels that a thread draws by itself
const uint PIECE_LEAST = 1024u;  // pixels of a piece; more where that would make over 256 of the picture
const uint REACHED = 0x80000000u;

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

// Rows and pixels of a row that a thread walks. What is added must not depend on who walks: `precise` keeps compilers from
// rounding one walk's sums in another way.
struct share_of_walk {
    int y, y_end, y_step;
    int x_first, x_step;
};

// First and last row with a pixel to look at.
ivec2 rows_of(photon p)
{
    float middle = p.center.y - 0.5, extent = p.ellipse.w;
    ivec2 rows = ivec2(int(ceil(middle - extent)), int(floor(middle + extent)));
    if (AA == AA_COVERAGE) {
        screen_ellipse e = ellipse_on_screen(p);
        rows = ivec2(floor(e.middle.y - sqrt(e.yy)), floor(e.middle.y + sqrt(e.yy)));
    }
    return clamp(rows, ivec2(0, -1), ivec2(int(frame.height), int(frame.height) - 1));
}

// Walks the pixels that the ellipse overlaps. Each gets its share exactly, as the difference of areas up to its edges, so
// that the shares add up to the whole ellipse whatever their rounding.
void draw_overlaps(photon p, vec3 value, vec3 normal, share_of_walk walk, inout uint evaluated, inout uint inside,
                   inout uint reached)
{
    screen_ellipse e = ellipse_on_screen(p);
    vec2 extent = sqrt(vec2(e.xx, e.yy));
    precise float across = extent.x * extent.y, cosine = clamp(e.xy / across, -1.0, 1.0);
    precise float sine = clamp(sqrt(e.det) / across, 1e-6, 1.0);
    precise float turn = atan(sine, cosine);
    precise float disk_px2 = sqrt(e.det);
    int width = int(frame.width), y = walk.y, x = 1, x_end = 0;
    precise float low = 0.0, high = 0.0, before = 0.0; // the row's edges, in units of the ellipse; area left of x
    for (;;) {
        if (x > x_end) {
            if (y > walk.y_end)
                break;
            low = clamp((float(y) - e.middle.y) / extent.y, -1.0, 1.0);
            high = clamp((float(y + 1) - e.middle.y) / extent.y, -1.0, 1.0);
            // how far the ellipse reaches in this row: at its extreme point, or at an edge
            precise float low_width = sine * sqrt((1.0 - low) * (1.0 + low)), high_width = sine * sqrt((1.0 - high) * (1.0 + high));
            precise float left = low <= -cosine && -cosine <= high ? -1.0 : min(cosine * low - low_width, cosine * high - high_width);
            precise float right = low <= cosine && cosine <= high ? 1.0 : max(cosine * low + low_width, cosine * high + high_width);
            x = max(int(floor(e.middle.x + extent.x * left)), 0) + walk.x_first;
            x_end = min(int(floor(e.middle.x + extent.x * right)), width - 1);
            precise float edge = clamp((float(x) - e.middle.x) / extent.x, -1.0, 1.0);
            before = disk_wedge(edge, high, turn, cosine, sine) - disk_wedge(edge, low, turn, cosine, sine);
            y += walk.y_step;
        }
        if (x <= x_end) {
            evaluated++;
            precise float edge = clamp((float(x + 1) - e.middle.x) / extent.x, -1.0, 1.0);
            precise float up_to = disk_wedge(edge, high, turn, cosine, sine) - disk_wedge(edge, low, turn, cosine, sine);
            precise float share = (up_to - before) * disk_px2;
            before = up_to;
            if (share > 0.0) {
                inside++;
                uint pixel = uint((y - walk.y_step) * width + x);
                if (target_accepts(targets[pixel], p.position.xyz, normal, p.density.w)) {
                    reached = 1u;
                    add_pixel(pixel, value * share);
                }
            }
            x += walk.x_step;
            if (walk.x_step != 1) {
                edge = clamp((float(x) - e.middle.x) / extent.x, -1.0, 1.0);
                before = disk_wedge(edge, high, turn, cosine, sine) - disk_wedge(edge, low, turn, cosine, sine);
            }
        }
    }
}

// Walks the pixels whose middle the ellipse holds.
void draw_middles(photon p, vec3 value, vec3 normal, share_of_walk walk, inout uint evaluated, inout uint inside,
                  inout uint reached)
{
    vec2 center = p.center.xy, w = p.center.zw;
    float u00 = p.ellipse.x, u01 = p.ellipse.y, u11 = p.ellipse.z;
    precise float a = u00 * u00 - w.x * w.x;
    int width = int(frame.width), y = walk.y, x = 1, x_end = 0;
    precise float oy = 0.0, bent = 1.0;
    // One loop over rows and pixels together: lanes with short rows don't wait for those with long ones.
    for (;;) {
        if (x > x_end) {
            if (y > walk.y_end)
                break;
            // a x^2 + 2 b x + c <= 0 in this row
            oy = float(y) + 0.5 - center.y;
            bent = 1.0 + w.y * oy;
            precise float b = u00 * u01 * oy - w.x * bent;
            precise float c = (u01 * u01 + u11 * u11) * oy * oy - bent * bent;
            precise float d = b * b - a * c;
            precise float root = sqrt(max(d, 0.0));
            x = max(int(ceil(center.x + (-b - root) / a - 0.5)), 0) + walk.x_first;
            x_end = d < 0.0 ? x - 1 : min(int(floor(center.x + (-b + root) / a - 0.5)), width - 1);
            y += walk.y_step;
        }
        if (x <= x_end) {
            evaluated++;
            precise float ox = float(x) + 0.5 - center.x;
            precise float depth = bent + w.x * ox;
            precise float q0 = u00 * ox + u01 * oy, q1 = u11 * oy;
            precise float r2 = (q0 * q0 + q1 * q1) / (depth * depth);
            uint pixel = uint((y - walk.y_step) * width + x);
            if (r2 < 1.0) {
                inside++;
                if (target_accepts(targets[pixel], p.position.xyz, normal, p.density.w)) {
                    reached = 1u;
                    add_pixel(pixel, AA == AA_FILTER ? value * (1.0 - r2) : value);
                }
            }
            x += walk.x_step;
        }
    }
}

// A piece of its own for every so many pixels; false: there is no room left for them.
bool hand_out(uint index, ivec2 rows, float pixels)
{
    uint piece_px = max(PIECE_LEAST, frame.width * frame.height / 256u);
    uint parts = min(1u + uint(pixels) / piece_px, uint(rows.y - rows.x) / 8u + 1u);
    uint first = atomicAdd(counters.splat_pieces, parts);
    if (first + parts > uint(pieces.length())) {
        for (uint k = first; k < uint(pieces.length()); k++)
            pieces[k] = splat_piece(NONE, 0u);
        return false;
    }
    for (uint k = 0u; k < parts; k++)
        pieces[first + k] = splat_piece(index, k | parts << 16);
    return true;
}

vec3 value_of(photon p)
{
    vec3 value = p.density.xyz / frame.irradiance_unit;
    return has(FEATURE_CHROMATIC) ? value : vec3(channel_sum(value) / 3.0); // all photons have the tint of frame.tint
}

void draw(photon p, share_of_walk walk, inout uint evaluated, inout uint inside, inout uint reached)
{
    vec3 normal = unpack_normal(floatBitsToUint(p.position.w));
    if (AA == AA_COVERAGE)
        draw_overlaps(p, value_of(p), normal, walk, evaluated, inside, reached);
    else
        draw_middles(p, value_of(p), normal, walk, evaluated, inside, reached);
}

void draw_photon(uint index, inout uint evaluated, inout uint inside, inout uint reached)
{
    photon p = photons[index];
    if (p.cell == NONE || (AA == AA_MSAA_SMALL && ellipse_is_small(p))) // those are quads
        return;
    vec2 center = p.center.xy;
    ivec2 size = ivec2(int(frame.width), int(frame.height));
    if (AA == AA_PIXEL) {
        ivec2 at = ivec2(floor(center));
        if (all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size))) {
            add_pixel(uint(at.y * size.x + at.x), value_of(p));
            evaluated = inside = reached = 1u;
        }
    } else if (AA == AA_FILTER && p.ellipse.w < 0.0) {
        // a box of these sides over at most two by two pixels: each gets its share
        vec3 normal = unpack_normal(floatBitsToUint(p.position.w)), value = value_of(p);
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
    } else {
        ivec2 rows = rows_of(p);
        float count = float(rows.y - rows.x + 1), area = PI / (p.ellipse.x * p.ellipse.z);
        float pixels = count * (1.0 + min(area / max(2.0 * p.ellipse.w, 1.0), float(size.x)));
        if (!(pixels > ALONE_MAX && rows.y >= rows.x && hand_out(index, rows, pixels)))
            draw(p, share_of_walk(rows.x, rows.y, 1, 0, 1), evaluated, inside, reached);
    }
}

void draw_piece(uint at, inout uint evaluated, inout uint inside, inout uint reached)
{
    splat_piece piece = pieces[at];
    if (piece.photon == NONE)
        return;
    photon p = photons[piece.photon];
    int k = int(piece.part & 0xffffu), parts = int((piece.part & ~REACHED) >> 16), lane = int(gl_LocalInvocationIndex);
    ivec2 rows = rows_of(p);
    int each = (rows.y - rows.x + parts) / parts, y = rows.x + k * each;
    uint has_reached = 0u;
    draw(p, share_of_walk(y + lane / 8, min(y + each - 1, rows.y), 8, lane % 8, 8), evaluated, inside, has_reached);
    // its photon counts once
    if (has_reached != 0u && (atomicOr(pieces[at - uint(k)].part, REACHED) & REACHED) == 0u)
        reached++;
}

void main()
{
    if (gl_LocalInvocationIndex < 4u)
        totals[gl_LocalInvocationIndex] = 0u;
    uint evaluated = 0u, inside = 0u, reached = 0u;
    if (PHASE == 0u) {
        if (gl_GlobalInvocationID.x < counters.photon_count)
            draw_photon(gl_GlobalInvocationID.x, evaluated, inside, reached);
    } else {
        uint count = min(counters.splat_pieces, uint(pieces.length()));
        for (uint at = gl_WorkGroupID.x; at < count; at += gl_NumWorkGroups.x)
            draw_piece(at, evaluated, inside, reached);
    }
    // Two barriers: three group_counts make six, and 15 % of the time at four pixels a photon.
    barrier();
    if (evaluated != 0u) {
        atomicAdd(totals[0], evaluated);
        atomicAdd(totals[1], inside);
        atomicAdd(totals[2], reached);
    }
    if (overflow != 0u)
        atomicAdd(totals[3], overflow);
    barrier();
    if (gl_LocalInvocationIndex == 0u && totals[0] != 0u) {
        atomicAdd(counters.count[COUNT_KERNEL], totals[0]);
        atomicAdd(counters.count[COUNT_KERNEL_INSIDE], totals[1]);
        atomicAdd(counters.count[COUNT_CONTRIBUTING], totals[2]);
        atomicAdd(counters.count[COUNT_GUARD_OVERFLOW], totals[3]);
    }
}
