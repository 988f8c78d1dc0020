#version 460
#extension GL_GOOGLE_include_directive : require
// lookup.comp: one thread per photon: walks the cells of the grid that its footprint covers, gives light to the chain
// points there and counts how much of the picture shows it.
// Long walks are put on a list. PHASE 1: those, eight threads each, so that none walks for long alone. The list's order depends
// on who came first; what is summed does not: those sums are integers.
//
// Reads   photons to look up, grid of chain points
// Writes  irradiance sums of chain points in units of frame.irradiance_unit; area and root of photons that are seen so; long walks
// Source  design 5 (feedback), 8; aaps-thesis 5.2
#include "frame.glsl"
#include "optics.glsl"
#include "photons.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS + 1) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer seen_buffer { lookup_photon seen[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer cell_buffer { lookup_cell cells[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer mark_buffer { uint marks[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer sorted_buffer { chain_point sorted[]; };
layout(std430, binding = BINDING_PASS + 6) buffer sum_buffer { uint sums[]; };
layout(std430, binding = BINDING_PASS + 7) buffer photon_buffer { photon photons[]; };
layout(std430, binding = BINDING_PASS + 8) buffer walk_buffer { uint long_walks[]; };
layout(std430, binding = BINDING_PASS + 9) readonly buffer code_buffer { uvec4 codes[]; }; // of four points each
layout(constant_id = 8) const uint PHASE = 0u;
#include "lookup_give.glsl"

bool is_block_marked(ivec3 block, uint scale, uint level)
{
    uint mark = block_mark(block, scale, level);
    return (marks[mark >> 5] & (1u << (mark & 31u))) != 0u;
}

// May there be points of this level in the box? Asks for the at most eight blocks of the smallest fitting size.
bool is_marked(vec3 low, vec3 high, uint level)
{
    float size = level_size(level);
    ivec3 first = cell_of(low, size), last = cell_of(high, size);
    uint scale = 1u;
    while (scale <= LOOKUP_BLOCK_MAX && any(greaterThan((last >> scale) - (first >> scale), ivec3(1))))
        scale += 2u;
    if (scale > LOOKUP_BLOCK_MAX)
        return true;
    first >>= scale;
    last >>= scale;
    ivec3 block = first;
    for (;;) {
        if (is_block_marked(block, scale, level))
            return true;
        if (++block.x > last.x) {
            block.x = first.x;
            if (++block.y > last.y) {
                block.y = first.y;
                if (++block.z > last.z)
                    return false;
            }
        }
    }
}

uint find_cell(ivec3 cell, uint level)
{
    uint slot = cell_hash(cell, level);
    for (uint k = 0u; k < LOOKUP_PROBES; k++, slot++) {
        slot &= frame.lookup_slots - 1u;
        uint owner = cells[slot].owner;
        if (owner == 0u)
            return NONE;
        if (int(cells[slot].x) == cell.x && int(cells[slot].y) == cell.y && int(cells[slot].z) == cell.z &&
            owner >> 27 == level)
            return slot;
    }
    return NONE;
}

// Cells of one level that may hold points, as packed steps from the photon's; then where the points of those found start.
// Global: arrays that are handed to functions are copied (docs/drivers.md).
const uint HELD_MAX = 16u;
uint held_cells[HELD_MAX];
const int HELD_STEPS = 512; // most from the photon's cell that are told apart
// Of four points those that passed is_near, four bits below their place: few do, so what is dear is done for several lanes
// together; and on lavapipe a store into an array takes as long as telling four points apart.
const uint NEAR_MAX = 32u;
uint near_points[NEAR_MAX];

// May the photon, at this place, reach the point of this code? As if the pixel's filter were as wide as its reach all round, and
// both together, nowhere narrower than that reach, wider by what the code leaves open: half the diagonal of its steps.
const float NEAR_OPEN = 0.5 * 1.7321 * LOOKUP_CELL_REACH / float(LOOKUP_PLACE_STEPS) + 1e-4;

// In steps of the codes' lattice.
struct {
    uvec3 place;
    vec3 t1, t2, covariance;
} nearby;

void near_find(float size)
{
    float per_step = float(LOOKUP_PLACE_STEPS) / size;
    nearby.place = near_place(giver.position, size);
    nearby.t1 = giver.t1 * NEAR_UNIT;
    nearby.t2 = giver.t2 * NEAR_UNIT;
    nearby.covariance = giver.covariance.xyz * (per_step * per_step);
}

bool is_near(uint code)
{
    vec3 offset = near_offset(code, nearby.place);
    float width = near_width(code), reach = width * (float(LOOKUP_PLACE_STEPS) / LOOKUP_CELL_REACH);
    vec2 o = vec2(dot(offset, nearby.t1), dot(offset, nearby.t2));
    float cxx = nearby.covariance.x + reach * reach, cxy = nearby.covariance.y, cyy = nearby.covariance.z + reach * reach;
    float open = width + NEAR_OPEN;
    return (cyy * o.x * o.x - 2.0 * cxy * o.x * o.y + cxx * o.y * o.y) * width * width < (cxx * cyy - cxy * cxy) * open * open;
}

uint bits(bvec4 of)
{
    return (of.x ? 1u : 0u) | (of.y ? 2u : 0u) | (of.z ? 4u : 0u) | (of.w ? 8u : 0u);
}

// The footprint along the axes: cells are walked in the plane of the two, i and j, that the normal is least along.
struct {
    uint i, j, k;
    vec3 across;
    float ii, ij, jj, kk; // covariance, m^2
} span;

void span_find()
{
    vec3 n = giver.normal;
    span.across = abs(n);
    span.k = span.across.x > span.across.y ? (span.across.x > span.across.z ? 0u : 2u) : (span.across.y > span.across.z ? 1u : 2u);
    span.i = (span.k + 1u) % 3u;
    span.j = (span.k + 2u) % 3u;
    vec4 c = giver.covariance;
    vec3 t1 = vec3(giver.t1[span.i], giver.t1[span.j], giver.t1[span.k]);
    vec3 t2 = vec3(giver.t2[span.i], giver.t2[span.j], giver.t2[span.k]);
    vec3 along = c.x * t1 * t1 + 2.0 * c.y * t1 * t2 + c.z * t2 * t2;
    span.ii = along.x;
    span.jj = along.y;
    span.kk = along.z;
    span.ij = c.x * t1.x * t1.y + c.y * (t1.x * t2.y + t2.x * t1.y) + c.z * t2.x * t2.y;
}

// Levels with points nearby, and about how many cells that makes.
uint levels_near(out float cells_near)
{
    uint levels = lookup.levels, wanted = 0u;
    vec3 along;
    along[span.i] = span.ii;
    along[span.j] = span.jj;
    along[span.k] = span.kk;
    cells_near = 0.0;
    while (levels != 0u) {
        uint level = uint(findLSB(levels));
        levels &= levels - 1u;
        float size = level_size(level), reach = size * (1.0 / LOOKUP_CELL_REACH);
        vec3 extent = sqrt(along + reach * reach) + (giver.covariance.w + 0.25 * reach) * span.across;
        if (is_marked(giver.position - extent, giver.position + extent, level)) {
            wanted |= 1u << level;
            cells_near += (1.0 + 2.0 * extent[span.i] / size) * (1.0 + 2.0 * extent[span.j] / size);
        }
    }
    return wanted;
}

// From i, j, k to x, y, z.
ivec3 cell_along_axes(ivec3 cell)
{
    return span.k == 2u ? cell : span.k == 0u ? cell.zxy : cell.yzx;
}

// The walk of `lanes` threads, which share out the cells. Vectors are along i, j, k.
void walk(uint wanted, uint lane, uint lanes)
{
    vec4 c = giver.covariance;
    vec3 position = vec3(giver.position[span.i], giver.position[span.j], giver.position[span.k]);
    vec3 across = vec3(span.across[span.i], span.across[span.j], span.across[span.k]);
    float dii = span.ii, dij = span.ij, djj = span.jj, dkk = span.kk;
    float slope_i = -giver.normal[span.i] / giver.normal[span.k], slope_j = -giver.normal[span.j] / giver.normal[span.k];
    float finest = level_size(uint(findLSB(wanted)));
    // Of the box around the ellipse, so less of a needle across the axes is left: whole ones took `square` from behind 1.18 times
    // the time, at the same error.
    float box = 4.0 * sqrt(dii * djj) / (finest * finest) * (2.0 + 2.0 * c.w / (across.z * finest));
    // No cell may be HELD_STEPS away: the plane's slack moves rows sideways, and cells with them into its depth.
    float longest = (sqrt(dii + djj + dkk) + 4.0 * c.w) / (float(HELD_STEPS - 12) * finest);
    if (box > float(LOOKUP_WALK_MAX) || longest > 1.0) {
        float shrink = min(float(LOOKUP_WALK_MAX) / box, 1.0 / (longest * longest));
        c *= vec4(vec3(shrink), sqrt(shrink));
        giver.covariance = c;
        dii *= shrink;
        dij *= shrink;
        djj *= shrink;
        dkk *= shrink;
        gave.guard += lane == 0u ? 1u : 0u;
    }

    // In turns: collect cells that may hold points, find them, meet the points of all of them, each as one flat loop: lanes
    // with short walks don't wait at every cell for those with long ones, and what a loop's every round would do for few is not in it.
    uint level = 0u, rounds = 0u, turn_of = 0u;
    float size = 1.0, per_size = 1.0, off = 0.0, spread = 0.0;
    float reach_j = 0.0, per_yy = 0.0, shear = 0.0, turn = 0.0, root = 0.0; // of the ellipse: rows are cuts through it
    ivec3 cell = ivec3(0), home = ivec3(0);
    int row_end = -1, column_end = -1, depth_end = -1;
    bool goes_on = true, is_wide = false;
    while (goes_on) {
        uint held = 0u;
        while (goes_on && held < HELD_MAX) {
            if (++cell.z > depth_end) {
                if (++cell.x > column_end) {
                    if (++cell.y > row_end) {
                        if (held != 0u)
                            break; // the next level's cells have another size
                        if (wanted == 0u) {
                            goes_on = false;
                            break;
                        }
                        level = uint(findLSB(wanted));
                        wanted &= wanted - 1u;
                        size = level_size(level);
                        per_size = 1.0 / size;
                        home = cell_of(position, size);
                        near_find(size);
                        float reach = size * (1.0 / LOOKUP_CELL_REACH);
                        float xx = dii + reach * reach, yy = djj + reach * reach;
                        off = c.w + 0.25 * reach;
                        per_yy = 1.0 / yy;
                        shear = dij * per_yy;
                        root = sqrt(max(xx - dij * shear, 0.0)); // half width of the row through the middle
                        reach_j = sqrt(yy);
                        turn = dij * inversesqrt(xx);
                        spread = (0.5 * size * (abs(slope_i) + abs(slope_j)) + off / across.z) * per_size;
                        is_wide = sqrt(dii + djj + dkk) + reach + 2.0 * off > LOOKUP_WIDE * size;
                        cell.y = int(floor((position.y - reach_j - off * across.y) * per_size));
                        row_end = int(floor((position.y + reach_j + off * across.y) * per_size));
                    }
                    // The ellipse's span over the row's height: its leftmost and rightmost points, or where it is cut.
                    // A point off the plane is seen beside its place there.
                    float low = float(cell.y) * size - position.y - off * across.y;
                    float high = clamp(low + size + 2.0 * off * across.y, -reach_j, reach_j);
                    low = clamp(low, -reach_j, reach_j);
                    float y_right = clamp(turn, low, high), y_left = clamp(-turn, low, high);
                    float right = shear * y_right + root * sqrt(max(1.0 - y_right * y_right * per_yy, 0.0));
                    float left = shear * y_left - root * sqrt(max(1.0 - y_left * y_left * per_yy, 0.0));
                    cell.x = int(floor((position.x + left - off * across.x) * per_size - 1e-3));
                    column_end = int(floor((position.x + right + off * across.x) * per_size + 1e-3));
                }
                // The plane's depth over the cell.
                float at_i = (float(cell.x) + 0.5) * size - position.x;
                float at_j = (float(cell.y) + 0.5) * size - position.y;
                float middle = (position.z + slope_i * at_i + slope_j * at_j) * per_size;
                cell.z = int(floor(middle - spread));
                depth_end = int(floor(middle + spread));
            }
            bool is_mine = turn_of == lane;
            turn_of = turn_of + 1u == lanes ? 0u : turn_of + 1u;
            if (is_mine && is_block_marked(cell_along_axes(cell), 0u, level)) {
                uvec3 steps = uvec3(cell - home + HELD_STEPS);
                held_cells[held++] = steps.x | (steps.y << 10) | (steps.z << 20);
            }
            rounds++;
        }
        uint found = 0u;
        for (uint n_th = 0u; n_th < held; n_th++) {
            uint steps = held_cells[n_th];
            uint slot = find_cell(cell_along_axes(home + ivec3(uvec3(steps, steps >> 10, steps >> 20) & 1023u) - HELD_STEPS), level);
            if (slot != NONE)
                held_cells[found++] = cells[slot].first;
            rounds++;
        }
        uint at = 0u, point = 0u;
        bool is_last = true;
        do {
            uint near = 0u;
            while (near < NEAR_MAX) {
                if (is_last) {
                    if (at == found)
                        break;
                    point = held_cells[at++];
                }
                uvec4 four = codes[point >> 2];
                uint met = 15u << (point & 3u), lasts = bits(greaterThanEqual(four, uvec4(LOOKUP_LAST))) & met;
                is_last = lasts != 0u;
                met &= (lasts ^ (lasts - 1u)) & 15u; // up to the last point of the cell
                gave.tested += bitCount(met);
                if (!is_wide)
                    met &= bits(bvec4(is_near(four.x), is_near(four.y), is_near(four.z), is_near(four.w)));
                if (met != 0u)
                    near_points[near++] = ((point >> 2) << 4) | met;
                point = (point & ~3u) + 4u;
                rounds++;
            }
            uint n_th = 0u, four = 0u;
            for (;;) {
                if ((four & 15u) == 0u) {
                    if (n_th == near)
                        break;
                    four = near_points[n_th++];
                }
                uint place = (four >> 4) * 4u + uint(findLSB(four));
                four &= four - 1u;
                give(sorted[place], place);
            }
        } while (!is_last || at != found);
        if (rounds > LOOKUP_ROUNDS_MAX && goes_on) {
            goes_on = false;
            gave.guard++;
        }
    }
}

void main()
{
    give_begin();
    if (PHASE == 0u) {
        // Far photons in turn: devices that give each of their threads one run of workgroups would have some idle else.
        // A stride without a factor in common with their number meets each once.
        uint groups = gl_NumWorkGroups.x, stride = groups % 61u != 0u ? 61u : groups % 59u != 0u ? 59u : 1u;
        uint index = gl_WorkGroupID.x * stride % groups * GROUP_SIZE + gl_LocalInvocationIndex;
        if (index < counters.photon_count && seen[index].cell != NONE) {
            gave.photons++;
            giver_find(index);
            span_find();
            float cells_near;
            uint wanted = levels_near(cells_near);
            if (cells_near > frame.walk_alone)
                long_walks[atomicAdd(lookup.long_walks, 1u)] = index;
            else if (wanted != 0u) {
                walk(wanted, 0u, 1u);
                give_end();
            }
        }
    } else {
        uint each = GROUP_SIZE / 8u;
        for (uint first = gl_WorkGroupID.x * each; first < lookup.long_walks; first += gl_NumWorkGroups.x * each) {
            uint number = first + gl_LocalInvocationIndex / 8u;
            bool has_walk = number < lookup.long_walks;
            if (has_walk) {
                giver_find(long_walks[number]);
                span_find();
                float cells_near;
                walk(levels_near(cells_near), gl_LocalInvocationIndex % 8u, 8u);
            }
            give_end_together(has_walk);
        }
    }
    give_count();
}
