// lookup.glsl: chain points, their grid, and what a photon gives to a chain point.
// Source  design 6 (one covariance), 8; rtpm 3.6 (the other way round: here the grid holds the camera's points)
#include "shared/lookup_layout.h"

const float REACH_MIN = 1e-12;
const float THROUGHPUT_STEP = 1024.0, THROUGHPUT_MAX = 4095.0 / 1024.0;

// Every normal has one tangent frame, so that covariances of a plane's photons can be compared and added.
void tangent_frame(vec3 normal, out vec3 t1, out vec3 t2)
{
    t1 = normalize(abs(normal.y) < 0.9 ? cross(normal, vec3(0.0, 1.0, 0.0)) : cross(normal, vec3(1.0, 0.0, 0.0)));
    t2 = cross(normal, t1);
}

uvec4 pack_axes(vec3 x, vec3 y, float least, float throughput)
{
    // the longest radius of their ellipse, rounded up to what is left of a float: the grid relies on it
    float xx = dot(x, x), yy = dot(y, y), xy = dot(x, y);
    float reach = max(sqrt(0.5 * (xx + yy) + sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)), max(least, REACH_MIN));
    uint bits = (floatBitsToUint(reach) + 0xfffu) & ~0xfffu;
    float scale = 1.0 / uintBitsToFloat(bits);
    x *= scale;
    y *= scale;
    return uvec4(packHalf2x16(x.xy), packHalf2x16(vec2(x.z, y.x)), packHalf2x16(y.yz),
                 bits | uint(clamp(throughput, 0.0, THROUGHPUT_MAX) * THROUGHPUT_STEP + 0.5));
}

float axes_reach(uvec4 axes)
{
    return uintBitsToFloat(axes.w & ~0xfffu);
}

float axes_throughput(uvec4 axes)
{
    return float(axes.w & 0xfffu) * (1.0 / THROUGHPUT_STEP);
}

// Lists of chain points: shared/lookup_layout.h.
uint sample_first()
{
    return frame.width * frame.height * frame.camera_branches;
}

// Samples of each broken pixel: all of them where a third of what is shown breaks up, fewer where less does, since what they
// are worth to the picture is their part of it. 1: none but the one through its middle.
uint samples_each(uint broken_count, uint shown_count)
{
    uint wanted = uint(ceil(float(frame.camera_samples) * min(3.0 * float(broken_count) / float(max(shown_count, 1u)), 1.0)));
    return max(min(wanted, frame.sample_capacity / max(broken_count, 1u)), 1u);
}

bool chain_exists(chain_point point)
{
    return floatBitsToUint(point.position_normal.w) != NONE;
}

float level_size(uint level)
{
    return frame.lookup_base * uintBitsToFloat((level + 127u) << 23);
}

// The finest level whose cells are wide enough for this reach.
uint level_of(float reach)
{
    float ratio = reach * LOOKUP_CELL_REACH / frame.lookup_base;
    if (!(ratio > 1.0))
        return 0u;
    uint bits = floatBitsToUint(ratio);
    uint exponent = (bits >> 23) - 127u + ((bits & 0x7fffffu) != 0u ? 1u : 0u);
    return min(exponent, uint(LOOKUP_LEVELS - 1));
}

ivec3 cell_of(vec3 position, float size)
{
    return ivec3(floor(position / size));
}

// The word of shared/lookup_layout.h.
uint near_code(chain_point point, uint level)
{
    float size = level_size(level);
    uvec3 place = uvec3(ivec3(floor(point.position_normal.xyz * (float(LOOKUP_PLACE_STEPS) / size)))) & LOOKUP_PLACE_MASK;
    float reach = axes_reach(point.axes) * LOOKUP_CELL_REACH / size;
    uint width = uint(clamp(ceil(reach * 32.0), 17.0, 32.0)) - 17u;
    return place.x | (place.y << 9) | (place.z << 18) | (width << 27);
}

// A place on that lattice, which repeats, in NEAR_UNITs of its steps, so that a period is 2^32 of them; less half a step, since
// a code's point is anywhere within its step.
const float NEAR_UNIT = 1.0 / 8388608.0;

uvec3 near_place(vec3 position, float size)
{
    float period = float(LOOKUP_PLACE_MASK + 1u);
    vec3 place = position * (float(LOOKUP_PLACE_STEPS) / size) - 0.5;
    return uvec3(min(place - period * floor(place / period), period - 0.0001) * (1.0 / NEAR_UNIT));
}

// From such a place to the point's, in NEAR_UNITs.
vec3 near_offset(uint code, uvec3 place)
{
    return vec3(ivec3((uvec3(code << 23, code << 14, code << 5) & ~(uint(1.0 / NEAR_UNIT) - 1u)) - place));
}

// At least the point's reach over the most that its cell holds.
float near_width(uint code)
{
    return float(17u + ((code >> 27) & 15u)) * (1.0 / 32.0);
}

uint cell_hash(ivec3 cell, uint level)
{
    uint h = uint(cell.x) * 0x9e3779b1u + uint(cell.y) * 0x85ebca77u + uint(cell.z) * 0xc2b2ae3du + level * 0x27d4eb2fu;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    return h ^ (h >> 13);
}

// The bit that says whether a block of 2^scale cells a side of this level may hold points.
uint block_mark(ivec3 block, uint scale, uint level)
{
    return cell_hash(block, level + 32u * scale) & (8u * frame.lookup_slots - 1u);
}

// What a footprint of covariance `photon` (xx, xy, yy) in the frame t1, t2 gives per watt to a chain point at `offset`
// from it: the photon's ellipse and the pixel's filter add up. 1/m^2; 0 outside.
float lookup_kernel(vec3 offset, vec3 normal, vec3 t1, vec3 t2, vec4 photon, uint point_normal, uvec4 axes)
{
    float reach = axes_reach(axes);
    vec2 xy = unpackHalf2x16(axes.x), zx = unpackHalf2x16(axes.y), yz = unpackHalf2x16(axes.z);
    vec3 x = vec3(xy, zx.x), y = vec3(zx.y, yz);
    vec2 a = reach * vec2(dot(x, t1), dot(x, t2)), b = reach * vec2(dot(y, t1), dot(y, t2));
    float cxx = photon.x + a.x * a.x + b.x * b.x;
    float cxy = photon.y + a.x * a.y + b.x * b.y;
    float cyy = photon.z + a.y * a.y + b.y * b.y;
    float det = cxx * cyy - cxy * cxy;
    if (!(det > 1e-6 * cxx * cyy)) { // thinner than a float tells: never a form that is negative somewhere
        cxy *= 0.9999995 * sqrt(cxx * cyy) / max(abs(cxy), 1e-30);
        det = 1e-6 * cxx * cyy;
    }
    vec2 o = vec2(dot(offset, t1), dot(offset, t2));
    float r2 = (cyy * o.x * o.x - 2.0 * cxy * o.x * o.y + cxx * o.y * o.y) / det;
    bool takes = r2 < 1.0 && abs(dot(offset, normal)) <= photon.w + 0.25 * reach && dot(unpack_normal(point_normal), normal) > 0.5;
    return takes ? 2.0 * (1.0 - r2) / (PI * sqrt(det)) : 0.0;
}

// The part of a pixel that a photon whose stratum's image has this area shows there, from its kernel k, in
// 1/LOOKUP_SHARE_UNITS; never 0.
const float LOOKUP_SHARE_UNITS = 1048576.0;

uint lookup_share(float k, float area, uvec4 axes)
{
    return max(uint(min(k * area * axes_throughput(axes) * LOOKUP_SHARE_UNITS, 4.0e9)), 1u);
}
