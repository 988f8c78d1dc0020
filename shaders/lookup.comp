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
        if (cells[slot].count == 0u)
            return NONE;
        if (int(cells[slot].x) == cell.x && int(cells[slot].y) == cell.y && int(cells[slot].z) == cell.z &&
            cells[slot].level == level)
            return slot;
    }
    return NONE;
}

// Cells found and not yet visited. Global: arrays that are handed to functions are copied (docs/drivers.md).
const uint HELD_MAX = 16u;
uvec2 held_cells[HELD_MAX];
// Points that passed is_near: few do, so what is dear is done for several lanes together.
const uint NEAR_MAX = 16u;
uint near_points[NEAR_MAX];

// May the photon reach the point? As if the pixel's filter were as wide as its reach all round.
bool is_near(uint point)
{
    vec3 offset = sorted[point].position_normal.xyz - giver.position;
    float reach2 = axes_reach(sorted[point].axes);
    reach2 *= reach2 * 1.0001;
    vec2 o = vec2(dot(offset, giver.t1), dot(offset, giver.t2));
    float cxx = giver.covariance.x + reach2, cxy = giver.covariance.y, cyy = giver.covariance.z + reach2;
    gave.tested++;
    return cyy * o.x * o.x - 2.0 * cxy * o.x * o.y + cxx * o.y * o.y < cxx * cyy - cxy * cxy;
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

// The walk of `lanes` threads, which share out the cells.
void walk(uint wanted, uint lane, uint lanes)
{
    vec4 c = giver.covariance;
    vec3 across = span.across;
    uint i = span.i, j = span.j, k = span.k;
    float dii = span.ii, dij = span.ij, djj = span.jj;
    float slope_i = -giver.normal[i] / giver.normal[k], slope_j = -giver.normal[j] / giver.normal[k];
    float finest = level_size(uint(findLSB(wanted)));
    float box = 4.0 * sqrt(dii * djj) / (finest * finest) * (2.0 + 2.0 * c.w / (across[k] * finest));
    if (box > float(LOOKUP_WALK_MAX)) {
        float shrink = float(LOOKUP_WALK_MAX) / box;
        c *= vec4(vec3(shrink), sqrt(shrink));
        giver.covariance = c;
        dii *= shrink;
        dij *= shrink;
        djj *= shrink;
        gave.guard++;
    }

    // In turns: collect cells that hold points, then meet the points of all of them, each as one flat loop: lanes with
    // short walks don't wait at every cell for those with long ones.
    uint level = 0u, rounds = 0u, turn_of = 0u;
    float size = 1.0, xx = 1.0, xy = 0.0, yy = 1.0, root = 0.0, slack = 0.0, off = 0.0;
    ivec3 cell = ivec3(0);
    int row_end = -1, column_end = -1, depth_end = -1;
    bool goes_on = true;
    while (goes_on) {
        uint held = 0u;
        while (goes_on && held < HELD_MAX) {
            if (++cell[k] > depth_end) {
                if (++cell[i] > column_end) {
                    if (++cell[j] > row_end) {
                        if (wanted == 0u) {
                            goes_on = false;
                            break;
                        }
                        level = uint(findLSB(wanted));
                        wanted &= wanted - 1u;
                        size = level_size(level);
                        float reach = size * (1.0 / LOOKUP_CELL_REACH);
                        xx = dii + reach * reach;
                        xy = dij;
                        yy = djj + reach * reach;
                        off = c.w + 0.25 * reach;
                        slack = off / across[k];
                        root = sqrt(max(xx - xy * xy / yy, 0.0)); // half width of the row through the middle
                        float reach_j = sqrt(yy);
                        cell[j] = int(floor((giver.position[j] - reach_j - off * across[j]) / size));
                        row_end = int(floor((giver.position[j] + reach_j + off * across[j]) / size));
                    }
                    // The ellipse's span over the row's height: its leftmost and rightmost points, or where it is cut.
                    // A point off the plane is seen beside its place there.
                    float low = float(cell[j]) * size - giver.position[j] - off * across[j];
                    float high = low + size + 2.0 * off * across[j];
                    float reach_j = sqrt(yy), turn = xy * inversesqrt(xx);
                    float y_right = clamp(turn, clamp(low, -reach_j, reach_j), clamp(high, -reach_j, reach_j));
                    float y_left = clamp(-turn, clamp(low, -reach_j, reach_j), clamp(high, -reach_j, reach_j));
                    float right = xy / yy * y_right + root * sqrt(max(1.0 - y_right * y_right / yy, 0.0));
                    float left = xy / yy * y_left - root * sqrt(max(1.0 - y_left * y_left / yy, 0.0));
                    cell[i] = int(floor((giver.position[i] + left - off * across[i]) / size - 1e-3));
                    column_end = int(floor((giver.position[i] + right + off * across[i]) / size + 1e-3));
                }
                // The plane's depth over the cell.
                float at_i = (float(cell[i]) + 0.5) * size - giver.position[i];
                float at_j = (float(cell[j]) + 0.5) * size - giver.position[j];
                float middle = giver.position[k] + slope_i * at_i + slope_j * at_j;
                float spread = 0.5 * size * (abs(slope_i) + abs(slope_j)) + slack;
                cell[k] = int(floor((middle - spread) / size));
                depth_end = int(floor((middle + spread) / size));
            }
            bool is_mine = turn_of == lane;
            turn_of = turn_of + 1u == lanes ? 0u : turn_of + 1u;
            uint slot = is_mine && is_block_marked(cell, 0u, level) ? find_cell(cell, level) : NONE;
            if (slot != NONE)
                held_cells[held++] = uvec2(cells[slot].first, cells[slot].count);
            rounds++;
        }
        uint at = 0u, point = 0u, point_end = 0u;
        do {
            uint near = 0u;
            while (near < NEAR_MAX) {
                if (point == point_end) {
                    if (at == held)
                        break;
                    point = held_cells[at].x;
                    point_end = point + held_cells[at].y;
                    at++;
                }
                if (is_near(point))
                    near_points[near++] = point;
                point++;
                rounds++;
            }
            for (uint n_th = 0u; n_th < near; n_th++)
                give(sorted[near_points[n_th]], near_points[n_th]);
        } while (point != point_end || at != held);
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
        uint index = gl_GlobalInvocationID.x;
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
