#version 460
#extension GL_GOOGLE_include_directive : require
// lookup_grid.comp: sorts the frame's chain points into a hash grid of several levels.
// PHASE 0: every point finds or claims its cell and its rank there, and cells get on a list; PHASE 1: they are marked and get
// their part of the sorted points; PHASE 2: points go to their places. Which slot, rank and part they get depends on who came first; what is summed over
// them does not: those sums are integers.
//
// Reads   chain points
// Writes  cells, marks of blocks that hold points, places (slot and rank, then place among the sorted), sorted points and
//         their codes (before that the list of cells)
// Source  design 8
#include "frame.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(constant_id = 8) const uint PHASE = 0u;
layout(std430, binding = BINDING_PASS) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer chain_buffer { chain_point chains[]; };
layout(std430, binding = BINDING_PASS + 2) buffer cell_buffer { lookup_cell cells[]; };
layout(std430, binding = BINDING_PASS + 3) buffer mark_buffer { uint marks[]; };
layout(std430, binding = BINDING_PASS + 4) buffer place_buffer { uvec2 places[]; };
layout(std430, binding = BINDING_PASS + 5) writeonly buffer sorted_buffer { chain_point sorted[]; };
layout(std430, binding = BINDING_PASS + 6) buffer code_buffer { uint codes[]; };

#include "lookup_points.glsl"
#include "hand_out.glsl"

// Finds the slot of the point's cell at this level, claiming a free one; NONE when LOOKUP_PROBES slots are others'.
uint claim(uint number, vec3 position, uint level)
{
    float size = level_size(level);
    ivec3 cell = cell_of(position, size);
    uint slot = cell_hash(cell, level);
    uint mine = (level << 27) | (number + 1u);
    for (uint k = 0u; k < LOOKUP_PROBES; k++, slot++) {
        slot &= frame.lookup_slots - 1u;
        uint owner = atomicCompSwap(cells[slot].owner, 0u, mine);
        if (owner == 0u) {
            cells[slot].x = uint(cell.x);
            cells[slot].y = uint(cell.y);
            cells[slot].z = uint(cell.z);
            return slot;
        }
        if (owner >> 27 == level &&
            cell_of(chains[(owner & 0x7ffffffu) - 1u].position_normal.xyz, size) == cell)
            return slot;
    }
    return NONE;
}

void insert(uint number)
{
    chain_point point = chains[number];
    uvec2 place = uvec2(NONE, 0u);
    if (chain_exists(point)) {
        atomicAdd(lookup.count[LOOKUP_COUNT_POINTS], 1u);
        uint level = level_of(axes_reach(point.axes));
        place.x = claim(number, point.position_normal.xyz, level);
        // a crowded table: coarser cells hold more points each
        for (uint k = 0u; k < 8u && place.x == NONE && level + 1u < LOOKUP_LEVELS; k++)
            place.x = claim(number, point.position_normal.xyz, ++level);
        if (place.x != NONE) {
            place.y = atomicAdd(cells[place.x].count, 1u);
            if (place.y == 0u) {
                codes[atomicAdd(lookup.count[LOOKUP_COUNT_CELLS], 1u)] = place.x;
                atomicOr(lookup.levels, 1u << level);
            }
        } else
            atomicAdd(lookup.count[LOOKUP_COUNT_GUARD], 1u);
    }
    places[number] = place;
}

void mark_cell(ivec3 cell, uint level)
{
    for (uint scale = 0u; scale <= LOOKUP_BLOCK_MAX; scale += scale == 0u ? 1u : 2u) {
        uint mark = block_mark(cell >> scale, scale, level);
        atomicOr(marks[mark >> 5], 1u << (mark & 31u));
    }
}

void main()
{
    uint index = gl_GlobalInvocationID.x;
    if (PHASE == 1u) {
        uint cell_count = lookup.count[LOOKUP_COUNT_CELLS];
        if (gl_WorkGroupID.x * GROUP_SIZE >= cell_count)
            return;
        uint slot = index < cell_count ? codes[index] : NONE;
        uint first = hand_out(slot != NONE ? cells[slot].count : 0u);
        if (slot != NONE) {
            cells[slot].first = first;
            mark_cell(ivec3(cells[slot].x, cells[slot].y, cells[slot].z), cells[slot].owner >> 27);
        }
        return;
    }
    if (!point_is_used(index))
        return;
    if (PHASE == 0u) {
        insert(index);
        return;
    }
    uvec2 place = places[index];
    if (place.x == NONE)
        return;
    uint at = cells[place.x].first + place.y;
    chain_point point = chains[index];
    sorted[at] = point;
    bool is_last = place.y + 1u == cells[place.x].count;
    codes[at] = near_code(point, cells[place.x].owner >> 27) | (is_last ? LOOKUP_LAST : 0u);
    places[index] = uvec2(at, 0u);
}
