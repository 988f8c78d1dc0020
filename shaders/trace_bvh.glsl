// trace_bvh.glsl: traverses our own two-level hierarchy (shared/bvh_layout.h).
//
// Reads   bindings 0 (nodes), 1 (triangles), 2 (instances)
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

layout(std430, binding = BINDING_NODES) readonly buffer node_buffer { bvh_node bvh_nodes[]; };
layout(std430, binding = BINDING_TRIANGLES) readonly buffer triangle_buffer { bvh_triangle bvh_triangles[]; };
// The same memory in pieces of two words, for packets.
layout(std430, binding = BINDING_NODES) readonly buffer node_piece_buffer { uvec2 bvh_node_pieces[]; };
layout(std430, binding = BINDING_TRIANGLES) readonly buffer triangle_piece_buffer { uvec2 bvh_triangle_pieces[]; };
layout(std430, binding = BINDING_INSTANCES) readonly buffer instance_piece_buffer { uvec2 bvh_instance_pieces[]; };

uint trace_guard = 0u;

// Three roundings on each side must not lose a box that the ray only grazes.
const float BVH_LEAVE_SLACK = 1.0000004;
const uint BVH_DONE = 0xffffffffu; // a leaf, so that loops over inner nodes end

struct bvh_ray {
    vec3 origin;
    vec3 inverse;
    // Rows that shear a point, seen from the origin, so that the ray becomes the z axis: 1 and 0 but for the shear.
    vec3 row_x, row_y, row_z;
};

bvh_ray bvh_prepare(vec3 origin, vec3 direction)
{
    bvh_ray ray;
    ray.origin = origin;
    vec3 size = abs(direction);
    // Never 0 x infinity in the slabs, yet a direction component of 0 keeps its meaning: 0 / 1e-20 is inside.
    ray.inverse = 1.0 / mix(direction, mix(vec3(1e-20), vec3(-1e-20), lessThan(direction, vec3(0.0))),
                            lessThan(size, vec3(1e-20)));
    if (size.z >= size.x && size.z >= size.y) {
        ray.row_z = vec3(0.0, 0.0, ray.inverse.z);
        ray.row_x = vec3(1.0, 0.0, -(direction.x * ray.inverse.z));
        ray.row_y = vec3(0.0, 1.0, -(direction.y * ray.inverse.z));
    } else if (size.y >= size.x) {
        ray.row_z = vec3(0.0, ray.inverse.y, 0.0);
        ray.row_x = vec3(0.0, -(direction.z * ray.inverse.y), 1.0);
        ray.row_y = vec3(1.0, -(direction.x * ray.inverse.y), 0.0);
    } else {
        ray.row_z = vec3(ray.inverse.x, 0.0, 0.0);
        ray.row_x = vec3(-(direction.y * ray.inverse.x), 1.0, 0.0);
        ray.row_y = vec3(-(direction.z * ray.inverse.x), 0.0, 1.0);
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

// Where the ray enters and leaves the two children of a node: (left enter, left leave, right enter, right leave), as the
// bits of floats. Floats that are not negative are in the order of their bits, and a negative one is below all others
// either way: what counts here is only the order of distances ahead of the origin. Drivers spend three instructions on a
// minimum of floats, for the sake of NaN, and one on integers.
ivec4 bvh_enter_leave(bvh_ray ray, vec4 nx, vec4 ny, vec4 nz, float t_max)
{
    ivec4 x = floatBitsToInt((nx - ray.origin.x) * ray.inverse.x);
    ivec4 y = floatBitsToInt((ny - ray.origin.y) * ray.inverse.y);
    ivec4 z = floatBitsToInt((nz - ray.origin.z) * ray.inverse.z);
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
        bvh_node node = bvh_nodes[root + reference];
        ivec4 span = bvh_enter_leave(ray, node.x, node.y, node.z, t_max);
        bool left = span.x <= span.y;
        bool right = span.z <= span.w;
        bool right_first = right && (!left || span.z < span.x);
        uint near = right_first ? node.child.y : node.child.x;
        if (left && right) {
            bvh_stack[min(stack_size, uint(2 * BVH_MAX_DEPTH - 1))] = right_first ? node.child.x : node.child.y;
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
    bvh_ray world = bvh_prepare(origin, direction);
    uint steps = 0u;
    uint top_size = 0u;
    uint top = 0u;
    while (true) {
        bvh_lane_descend(world, 0u, hit.t, top, 0u, top_size, steps);
        if (top == BVH_DONE)
            break;
        uint instance = top & BVH_INDEX_MASK;
        scene_instance_gpu data = scene_instances[instance];
        vec4 point = vec4(origin, 1.0);
        bvh_ray ray = bvh_prepare(
            vec3(dot(data.to_object[0], point), dot(data.to_object[1], point), dot(data.to_object[2], point)),
            vec3(dot(data.to_object[0].xyz, direction), dot(data.to_object[1].xyz, direction),
                 dot(data.to_object[2].xyz, direction)));
        uint stack_size = top_size;
        uint reference = 0u;
        while (true) {
            bvh_lane_descend(ray, data.bvh_root, hit.t, reference, top_size, stack_size, steps);
            if (reference == BVH_DONE)
                break;
            uint first = data.bvh_triangle + (reference & BVH_INDEX_MASK);
            uint last = first + ((reference >> BVH_COUNT_SHIFT) & BVH_COUNT_MASK);
            for (uint i = first; i <= last; i++) {
                bvh_triangle triangle = bvh_triangles[i];
                if (bvh_triangle_test(ray, uintBitsToFloat(triangle.vertex[0].xyz),
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

// Sum over the packet; callers keep counts in separate bits of one word.
uint packet_sum(uint value)
{
    value += subgroupShuffleXor(value, 1u);
    value += subgroupShuffleXor(value, 2u);
    value += subgroupShuffleXor(value, 4u);
    return value;
}

// A stack of references laid across the lanes: entry i lies in lane i % 8 of word i / 8.
struct packet_stack {
    uvec4 words;
    uint size;
};

void packet_push(inout packet_stack stack, uint reference, bool is_wanted)
{
    uint slot = packet_lane();
    stack.words = mix(stack.words, uvec4(reference),
                      equal(uvec4(is_wanted ? stack.size : 0xffffffffu), slot + uvec4(0u, 8u, 16u, 24u)));
    stack.size += is_wanted ? 1u : 0u;
}

uint packet_top(packet_stack stack)
{
    uint last = stack.size - 1u;
    uint word = last < 16u ? (last < 8u ? stack.words.x : stack.words.y) : (last < 24u ? stack.words.z : stack.words.w);
    return stack.size > 0u ? subgroupShuffle(word, last & 7u) : BVH_DONE;
}

void bvh_packet_descend(bvh_ray ray, uint root, float t_max, inout uint reference, inout packet_stack stack,
                        inout uint steps)
{
    while ((reference & BVH_LEAF) == 0u) {
        uvec2 piece = bvh_node_pieces[(root + reference) * 8u + packet_lane()];
        vec4 nx = vec4(packet_float(piece.x, 0u), packet_float(piece.y, 0u), packet_float(piece.x, 1u), packet_float(piece.y, 1u));
        vec4 ny = vec4(packet_float(piece.x, 2u), packet_float(piece.y, 2u), packet_float(piece.x, 3u), packet_float(piece.y, 3u));
        vec4 nz = vec4(packet_float(piece.x, 4u), packet_float(piece.y, 4u), packet_float(piece.x, 5u), packet_float(piece.y, 5u));
        uint left_child = subgroupShuffle(piece.x, 6u);
        uint right_child = subgroupShuffle(piece.y, 6u);
        ivec4 span = bvh_enter_leave(ray, nx, ny, nz, t_max);
        bool left = span.x <= span.y;
        bool right = span.z <= span.w;
        bool right_first = right && (!left || span.z < span.x);
        // lanes that want left, right, and right before left
        uint votes = packet_sum((left ? 1u : 0u) + (right ? 0x100u : 0u) + (right_first ? 0x10000u : 0u));
        bool any_left = (votes & 0xffu) != 0u;
        bool any_right = (votes & 0xff00u) != 0u;
        uint first_right = votes >> 16;
        // lanes that want none have no say
        bool turn = any_right && (!any_left || 2u * first_right > max(votes & 0xffu, (votes >> 8) & 0xffu));
        packet_push(stack, turn ? left_child : right_child, any_left && any_right);
        uint near = turn ? right_child : left_child;
        bool is_dry = !(any_left || any_right);
        reference = is_dry ? packet_top(stack) : near;
        stack.size -= is_dry && stack.size > 0u ? 1u : 0u;
        if (++steps > BVH_MAX_STEPS) {
            trace_guard = 1u;
            stack.size = 0u;
            reference = BVH_DONE;
        }
    }
}

void bvh_packet_trace(vec3 origin, vec3 direction, bool any, inout trace_hit hit)
{
    bvh_ray world = bvh_prepare(origin, direction);
    uint steps = 0u;
    packet_stack top_stack;
    top_stack.words = uvec4(0u);
    top_stack.size = 0u;
    uint top = 0u;
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
        bvh_ray ray = bvh_prepare(vec3(dot(row0, point), dot(row1, point), dot(row2, point)),
                                  vec3(dot(row0.xyz, direction), dot(row1.xyz, direction), dot(row2.xyz, direction)));
        packet_stack stack;
        stack.words = uvec4(0u);
        stack.size = 0u;
        uint reference = 0u;
        while (true) {
            bvh_packet_descend(ray, root, hit.t, reference, stack, steps);
            if (reference == BVH_DONE)
                break;
            uint first = first_triangle + (reference & BVH_INDEX_MASK);
            uint last = first + ((reference >> BVH_COUNT_SHIFT) & BVH_COUNT_MASK);
            for (uint i = first; i <= last; i++) {
                uvec2 piece = bvh_triangle_pieces[i * 6u + min(packet_lane(), 5u)];
                vec3 p0 = vec3(packet_float(piece.x, 0u), packet_float(piece.y, 0u), packet_float(piece.x, 1u));
                vec3 p1 = vec3(packet_float(piece.x, 2u), packet_float(piece.y, 2u), packet_float(piece.x, 3u));
                vec3 p2 = vec3(packet_float(piece.x, 4u), packet_float(piece.y, 4u), packet_float(piece.x, 5u));
                uint triangle = subgroupShuffle(piece.y, 1u);
                if (bvh_triangle_test(ray, p0, p1, p2, hit)) {
                    hit.instance = instance;
                    hit.triangle = triangle;
                    if (any)
                        hit.t = 0.0; // enters nothing any more
                }
            }
            reference = packet_top(stack);
            stack.size -= stack.size > 0u ? 1u : 0u;
        }
        top = packet_top(top_stack);
        top_stack.size -= top_stack.size > 0u ? 1u : 0u;
    }
}

// ---- the interface --------------------------------------------------------------------------------------

trace_hit bvh_trace(vec3 origin, vec3 direction, float t_max, bool any)
{
    trace_hit hit;
    hit.t = min(t_max, BVH_FAR_T);
    hit.instance = TRACE_MISS;
    hit.triangle = 0u;
    hit.barycentrics = vec2(0.0);
    bool is_packet = gl_SubgroupSize == PACKET_LANES && bitCount(subgroupBallot(true).x) == gl_SubgroupSize;
    if (is_packet)
        bvh_packet_trace(origin, direction, any, hit);
    else
        bvh_lane_trace(origin, direction, any, hit);
    return hit;
}

trace_hit trace_closest(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, false);
}

bool trace_any(vec3 origin, vec3 direction, float t_max)
{
    return bvh_trace(origin, direction, t_max, true).instance != TRACE_MISS;
}
