// trace_bvh.glsl: traverses our own two-level hierarchy (shared/bvh_layout.h).
//
// Reads   bindings 0 (nodes), 1 and 2 (triangles), 3 (instances)
// Source  design 12; Woop, Benthin and Wald 2013 for the triangle test; Ize 2013 for the boxes
//
// Two ways through the same tree with the same arithmetic:
// - Small subgroups (lavapipe: 8) go through it as one packet. A driver that runs a subgroup as the lanes of a CPU
//   vector pays for every word that every lane loads, so the lanes fetch a node once, a part each, and exchange the
//   parts by shuffles; the stack lies across lanes too. Photons come in Morton order and stay together.
// - Wide subgroups, and subgroups of which some lanes take no part, go lane by lane with a stack each.
#include "shared/bvh_layout.h"
#include "scene_instances.glsl"
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(std430, binding = BINDING_NODES) readonly buffer node_buffer { uvec4 bvh_nodes[]; }; // two a node
layout(std430, binding = BINDING_TRIANGLES) readonly buffer triangle_buffer { bvh_triangle bvh_triangles[]; };
layout(std430, binding = BINDING_MORE_TRIANGLES) readonly buffer more_triangle_buffer { bvh_triangle bvh_more_triangles[]; };
// The same memory in pieces, for packets.
layout(std430, binding = BINDING_NODES) readonly buffer node_piece_buffer { uint bvh_node_pieces[]; };
layout(std430, binding = BINDING_TRIANGLES) readonly buffer triangle_piece_buffer { uvec2 bvh_triangle_pieces[]; };
layout(std430, binding = BINDING_MORE_TRIANGLES) readonly buffer more_piece_buffer { uvec2 bvh_more_pieces[]; };
layout(std430, binding = BINDING_INSTANCES) readonly buffer instance_piece_buffer { uvec2 bvh_instance_pieces[]; };

layout(constant_id = CONSTANT_FIRST_TRIANGLES) const uint FIRST_TRIANGLES = 0u;
// Where all triangles are in one buffer, this and what it guards are not compiled.
#define BVH_IS_IN_FIRST(triangle) (FIRST_TRIANGLES == 0u || (triangle) < FIRST_TRIANGLES)

uint trace_guard = 0u;
#ifdef TRACE_EXCLUDES
uint trace_excluded = TRACE_MISS; // an instance that is not there
#define TRACE_IS_EXCLUDED(instance) (has(FEATURE_CONTACT) && (instance) == trace_excluded)
#else
#define TRACE_IS_EXCLUDED(instance) false
#endif

// Five roundings on each side must not lose a box that the ray only grazes.
const float BVH_LEAVE_SLACK = 1.000001;

struct bvh_ray {
    vec3 origin;
    vec3 grid_shift, grid_inverse; // from the origin to the grid's, and 1 / direction, in steps of the tree's grid
    // Rows that shear a point, seen from the origin, so that the ray becomes the z axis: 1 and 0 but for the shear.
    vec3 row_x, row_y, row_z;
};

bvh_ray bvh_prepare(vec3 origin, vec3 direction, vec3 grid_start, vec3 grid_scale)
{
    bvh_ray ray;
    ray.origin = origin;
    vec3 size = abs(direction);
    // Never 0 x infinity in the slabs, yet a direction component of 0 keeps its meaning: 0 / 1e-20 is inside.
    vec3 inverse = 1.0 / mix(direction, mix(vec3(1e-20), vec3(-1e-20), lessThan(direction, vec3(0.0))),
                             lessThan(size, vec3(1e-20)));
    ray.grid_shift = (grid_start - origin) * (1.0 / grid_scale);
    ray.grid_inverse = inverse * grid_scale;
    if (size.z >= size.x && size.z >= size.y) {
        ray.row_z = vec3(0.0, 0.0, inverse.z);
        ray.row_x = vec3(1.0, 0.0, -(direction.x * inverse.z));
        ray.row_y = vec3(0.0, 1.0, -(direction.y * inverse.z));
    } else if (size.y >= size.x) {
        ray.row_z = vec3(0.0, inverse.y, 0.0);
        ray.row_x = vec3(0.0, -(direction.z * inverse.y), 1.0);
        ray.row_y = vec3(1.0, -(direction.x * inverse.y), 0.0);
    } else {
        ray.row_z = vec3(inverse.x, 0.0, 0.0);
        ray.row_x = vec3(-(direction.y * inverse.x), 1.0, 0.0);
        ray.row_y = vec3(-(direction.z * inverse.x), 0.0, 1.0);
    }
    return ray;
}

// Corners sheared into the ray's frame. A product never rounds past an equal one, so an edge function can only be 0
// where its sign would be in doubt, and 0 counts as inside for both triangles at an edge: no cracks.
bool bvh_triangle_test(bvh_ray ray, vec3 p0, vec3 p1, vec3 p2, inout trace_hit hit)
{
    precise vec3 a = p0 - ray.origin;
    precise vec3 b = p1 - ray.origin;
    precise vec3 c = p2 - ray.origin;
    precise vec3 x = vec3(dot(ray.row_x, a), dot(ray.row_x, b), dot(ray.row_x, c));
    precise vec3 y = vec3(dot(ray.row_y, a), dot(ray.row_y, b), dot(ray.row_y, c));
    precise float w0 = x.z * y.y - y.z * x.y;
    precise float w1 = x.x * y.z - y.x * x.z;
    precise float w2 = x.y * y.x - y.y * x.x;
    precise float determinant = w0 + w1 + w2;
    bool inside = ((w0 >= 0.0 && w1 >= 0.0 && w2 >= 0.0) || (w0 <= 0.0 && w1 <= 0.0 && w2 <= 0.0)) && determinant != 0.0;
    float inverse = 1.0 / determinant;
    vec3 z = vec3(dot(ray.row_z, a), dot(ray.row_z, b), dot(ray.row_z, c));
    float t = (w0 * z.x + w1 * z.y + w2 * z.z) * inverse;
    inside = inside && t > 0.0 && t < hit.t;
    if (inside) {
        hit.t = t;
        hit.barycentrics = vec2(w1, w2) * inverse;
    }
    return inside;
}

// ---- lane by lane ---------------------------------------------------------------------------------------

// (left minimum, left maximum, right minimum, right maximum) on the grid.
vec4 bvh_planes(uvec2 spans)
{
    return vec4(ivec4(spans.x & 0xffffu, spans.x >> 16, spans.y & 0xffffu, spans.y >> 16));
}

// Where the ray enters and leaves the two children of a node: (left enter, left leave, right enter, right leave), as the
// bits of floats. Floats that are not negative are in the order of their bits, and a negative one is below all others
// either way: what counts here is only the order of distances ahead of the origin. Drivers spend three instructions on a
// minimum of floats, for the sake of NaN, and one on integers.
ivec4 bvh_enter_leave(bvh_ray ray, vec4 nx, vec4 ny, vec4 nz, float t_max)
{
    ivec4 x = floatBitsToInt((nx + ray.grid_shift.x) * ray.grid_inverse.x);
    ivec4 y = floatBitsToInt((ny + ray.grid_shift.y) * ray.grid_inverse.y);
    ivec4 z = floatBitsToInt((nz + ray.grid_shift.z) * ray.grid_inverse.z);
    ivec2 enter = max(max(min(x.xz, x.yw), min(y.xz, y.yw)), max(min(z.xz, z.yw), ivec2(0)));
    ivec2 leave = min(min(max(x.xz, x.yw), max(y.xz, y.yw)), max(z.xz, z.yw));
    leave = min(floatBitsToInt(intBitsToFloat(leave) * BVH_LEAVE_SLACK), floatBitsToInt(t_max));
    return ivec4(enter.x, leave.x, enter.y, leave.y);
}

// References still to visit: the top level's, then the bottom level's. Global: drivers copy arrays that are handed to
// functions, which made lavapipe 22.3 three times slower.
uint bvh_stack[2 * BVH_MAX_DEPTH];

// Goes from inner node `reference` to the next leaf, BVH_DONE when the stack is down to `stack_base`.
void bvh_lane_descend(bvh_ray ray, uint root, float t_max, inout uint reference, uint stack_base,
                      inout uint stack_size, inout uint steps)
{
    while ((reference & BVH_LEAF) == 0u) {
        uvec4 low = bvh_nodes[2u * (root + reference)]; // left x, right x, left y, right y
        uvec4 high = bvh_nodes[2u * (root + reference) + 1u]; // left z, right z, references
        ivec4 span = bvh_enter_leave(ray, bvh_planes(low.xy), bvh_planes(low.zw), bvh_planes(high.xy), t_max);
        bool left = span.x <= span.y;
        bool right = span.z <= span.w;
        bool right_first = right && (!left || span.z < span.x);
        uint near = right_first ? high.w : high.z;
        if (left && right) {
            bvh_stack[min(stack_size, uint(2 * BVH_MAX_DEPTH - 1))] = right_first ? high.z : high.w;
            stack_size++;
        } else if (!(left || right)) {
            near = BVH_DONE;
            if (stack_size > stack_base)
                near = bvh_stack[--stack_size];
        }
        reference = near;
        if (++steps > BVH_MAX_STEPS) {
            trace_guard = 1u;
            stack_size = stack_base;
            reference = BVH_DONE;
        }
    }
}

void bvh_lane_trace(vec3 origin, vec3 direction, bool any, inout trace_hit hit)
{
    uvec4 header = bvh_nodes[0];
    uvec4 header_end = bvh_nodes[1];
    bvh_ray world = bvh_prepare(origin, direction, uintBitsToFloat(header.xyz),
                                uintBitsToFloat(uvec3(header.w, header_end.xy)));
    uint steps = 0u;
    uint top_size = 0u;
    uint top = header_end.z;
    while (true) {
        bvh_lane_descend(world, 0u, hit.t, top, 0u, top_size, steps);
        if (top == BVH_DONE)
            break;
        uint instance = top & BVH_INDEX_MASK;
        scene_instance_gpu data = scene_instances[instance];
        vec4 point = vec4(origin, 1.0);
        header = bvh_nodes[2u * data.bvh_root];
        header_end = bvh_nodes[2u * data.bvh_root + 1u];
        bvh_ray ray = bvh_prepare(
            vec3(dot(data.to_object[0], point), dot(data.to_object[1], point), dot(data.to_object[2], point)),
            vec3(dot(data.to_object[0].xyz, direction), dot(data.to_object[1].xyz, direction),
                 dot(data.to_object[2].xyz, direction)),
            uintBitsToFloat(header.xyz), uintBitsToFloat(uvec3(header.w, header_end.xy)));
        uint stack_size = top_size;
        uint reference = header_end.z;
        while (true) {
            bvh_lane_descend(ray, data.bvh_root, hit.t, reference, top_size, stack_size, steps);
            if (reference == BVH_DONE)
                break;
            uint first = data.bvh_triangle + (reference & BVH_INDEX_MASK);
            uint last = first + ((reference >> BVH_COUNT_SHIFT) & BVH_COUNT_MASK);
            steps += last - first + 1u;
            for (uint i = first; i <= last; i++) {
                bvh_triangle triangle;
                if (BVH_IS_IN_FIRST(i))
                    triangle = bvh_triangles[i];
                else
                    triangle = bvh_more_triangles[i - FIRST_TRIANGLES];
                if (!TRACE_IS_EXCLUDED(instance) &&
                    bvh_triangle_test(ray, uintBitsToFloat(triangle.vertex[0].xyz),
                                      uintBitsToFloat(triangle.vertex[1].xyz), uintBitsToFloat(triangle.vertex[2].xyz),
                                      hit)) {
                    hit.instance = instance;
                    hit.triangle = triangle.vertex[0].w;
                }
            }
            bool finished = any && hit.instance != TRACE_MISS;
            reference = BVH_DONE;
            if (stack_size > top_size && !finished)
                reference = bvh_stack[--stack_size];
        }
        bool finished = any && hit.instance != TRACE_MISS;
        top = BVH_DONE;
        if (top_size > 0u && !finished)
            top = bvh_stack[--top_size];
    }
}

// ---- as a packet ----------------------------------------------------------------------------------------

// All lanes of the subgroup are active and in step here; what steers the loops is the same in all of them.
const uint PACKET_LANES = 8u;
uint packet_lane()
{
    return gl_SubgroupInvocationID & (PACKET_LANES - 1u);
}

float packet_float(uint piece, uint lane)
{
    return uintBitsToFloat(subgroupShuffle(piece, lane));
}

vec3 packet_vector(uint piece, uint lane)
{
    return vec3(packet_float(piece, lane), packet_float(piece, lane + 1u), packet_float(piece, lane + 2u));
}

// Two children's spans, from lane `lane` and the next.
vec4 packet_planes(vec2 planes, uint lane)
{
    return vec4(subgroupShuffle(planes.x, lane), subgroupShuffle(planes.y, lane), subgroupShuffle(planes.x, lane + 1u),
                subgroupShuffle(planes.y, lane + 1u));
}

// Sum over the packet; callers keep counts in separate bits of one word.
uint packet_sum(uint value)
{
    value += subgroupShuffleXor(value, 1u);
    value += subgroupShuffleXor(value, 2u);
    value += subgroupShuffleXor(value, 4u);
    return value;
}

// A stack of references laid across the lanes: entry i lies in lane i % 8 of word i / 8. Entry 0 is BVH_DONE.
struct packet_stack {
    uvec4 words;
    uint size;
};

packet_stack packet_stack_empty()
{
    return packet_stack(uvec4(BVH_DONE), 1u);
}

void packet_push(inout packet_stack stack, uint reference, bool is_wanted)
{
    stack.words = mix(stack.words, uvec4(reference),
                      equal(uvec4(is_wanted ? stack.size : 0xffffffffu), packet_lane() + uvec4(0u, 8u, 16u, 24u)));
    stack.size += is_wanted ? 1u : 0u;
}

uint packet_pop(inout packet_stack stack, bool is_wanted)
{
    uint last = stack.size - 1u;
    uint word = last < 16u ? (last < 8u ? stack.words.x : stack.words.y) : (last < 24u ? stack.words.z : stack.words.w);
    stack.size = is_wanted ? last : stack.size;
    return subgroupShuffle(word, last & 7u);
}

// Goes from `reference` to the next leaf, BVH_DONE when none is left.
void bvh_packet_descend(bvh_ray ray, uint root, float t_max, inout uint reference, inout packet_stack stack,
                        inout uint steps)
{
    // Kept from round to round: as one value it is spilled once for the lanes' loads, not part by part.
    uint piece_index = (root + reference) * 8u + packet_lane();
    while ((reference & BVH_LEAF) == 0u && steps < BVH_MAX_STEPS) {
        steps++;
        uint piece = bvh_node_pieces[piece_index];
        vec2 planes = vec2(ivec2(piece & 0xffffu, piece >> 16));
        ivec4 span = bvh_enter_leave(ray, packet_planes(planes, 0u), packet_planes(planes, 2u),
                                     packet_planes(planes, 4u), t_max);
        uint left_child = subgroupShuffle(piece, 6u);
        uint right_child = subgroupShuffle(piece, 7u);
        bool left = span.x <= span.y;
        bool right = span.z <= span.w;
        bool right_first = right && (!left || span.z < span.x);
        // lanes that want left, lanes that want right, and how many more want right first than left first
        uint votes = packet_sum((left ? 1u : 0u) + (right ? 0x100u : 0u) +
                                (right_first ? 0x10000u : left ? 0xffff0000u : 0u));
        bool turn = int(votes) >= 0x10000;
        packet_push(stack, turn ? left_child : right_child, (votes & 0xffu) != 0u && (votes & 0xff00u) != 0u);
        bool is_dry = (votes & 0xffffu) == 0u;
        uint popped = packet_pop(stack, is_dry);
        reference = is_dry ? popped : turn ? right_child : left_child;
        piece_index = (root + reference) * 8u + packet_lane();
    }
    if (steps >= BVH_MAX_STEPS) {
        trace_guard = 1u;
        reference = BVH_DONE;
    }
}

void bvh_packet_trace(vec3 origin, vec3 direction, bool any, inout trace_hit hit)
{
    uint header = bvh_node_pieces[packet_lane()];
    bvh_ray world = bvh_prepare(origin, direction, packet_vector(header, 0u), packet_vector(header, 3u));
    uint steps = 0u;
    packet_stack top_stack = packet_stack_empty();
    uint top = subgroupShuffle(header, 6u);
    while (true) {
        bvh_packet_descend(world, 0u, hit.t, top, top_stack, steps);
        if (top == BVH_DONE)
            break;
        uint instance = top & BVH_INDEX_MASK;
        // the words from to_object on, sixteen in all
        uvec2 part = bvh_instance_pieces[instance * 14u + 6u + packet_lane()];
        vec4 row0 = vec4(packet_float(part.x, 0u), packet_float(part.y, 0u), packet_float(part.x, 1u), packet_float(part.y, 1u));
        vec4 row1 = vec4(packet_float(part.x, 2u), packet_float(part.y, 2u), packet_float(part.x, 3u), packet_float(part.y, 3u));
        vec4 row2 = vec4(packet_float(part.x, 4u), packet_float(part.y, 4u), packet_float(part.x, 5u), packet_float(part.y, 5u));
        uint root = subgroupShuffle(part.x, 7u);
        uint first_triangle = subgroupShuffle(part.y, 7u);
        vec4 point = vec4(origin, 1.0);
        header = bvh_node_pieces[root * 8u + packet_lane()];
        bvh_ray ray = bvh_prepare(vec3(dot(row0, point), dot(row1, point), dot(row2, point)),
                                  vec3(dot(row0.xyz, direction), dot(row1.xyz, direction), dot(row2.xyz, direction)),
                                  packet_vector(header, 0u), packet_vector(header, 3u));
        packet_stack stack = packet_stack_empty();
        uint reference = subgroupShuffle(header, 6u);
        while (true) {
            bvh_packet_descend(ray, root, hit.t, reference, stack, steps);
            if (reference == BVH_DONE)
                break;
            uint first = first_triangle + (reference & BVH_INDEX_MASK);
            uint last = first + ((reference >> BVH_COUNT_SHIFT) & BVH_COUNT_MASK);
            steps += last - first + 1u;
            for (uint i = first; i <= last; i++) {
                uvec2 piece;
                if (BVH_IS_IN_FIRST(i))
                    piece = bvh_triangle_pieces[i * 6u + min(packet_lane(), 5u)];
                else
                    piece = bvh_more_pieces[(i - FIRST_TRIANGLES) * 6u + min(packet_lane(), 5u)];
                vec3 p0 = vec3(packet_float(piece.x, 0u), packet_float(piece.y, 0u), packet_float(piece.x, 1u));
                vec3 p1 = vec3(packet_float(piece.x, 2u), packet_float(piece.y, 2u), packet_float(piece.x, 3u));
                vec3 p2 = vec3(packet_float(piece.x, 4u), packet_float(piece.y, 4u), packet_float(piece.x, 5u));
                uint triangle = subgroupShuffle(piece.y, 1u);
                if (!TRACE_IS_EXCLUDED(instance) && bvh_triangle_test(ray, p0, p1, p2, hit)) {
                    hit.instance = instance;
                    hit.triangle = triangle;
                    if (any)
                        hit.t = 0.0; // enters nothing any more
                }
            }
            reference = packet_pop(stack, true);
        }
        top = packet_pop(top_stack, true);
    }
}

// ---- the interface --------------------------------------------------------------------------------------

trace_hit bvh_trace(vec3 origin, vec3 direction, float t_max, bool any, bool all_lanes)
{
    trace_hit hit;
    hit.t = min(t_max, BVH_FAR_T);
    hit.instance = TRACE_MISS;
    hit.triangle = 0u;
    hit.barycentrics = vec2(0.0);
    // Mesa 22.3 masks branches, it never skips them: where all lanes are known to be here, the other way is not compiled.
    if (gl_SubgroupSize == PACKET_LANES && (all_lanes || bitCount(subgroupBallot(true).x) == PACKET_LANES))
        bvh_packet_trace(origin, direction, any, hit);
    else
        bvh_lane_trace(origin, direction, any, hit);
    return hit;
}

trace_hit trace_closest(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, false, false);
}

trace_hit trace_closest_all(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, false, true);
}

bool trace_any(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, true, false).instance != TRACE_MISS;
}

bool trace_any_all(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, true, true).instance != TRACE_MISS;
}
