#version 460
#extension GL_GOOGLE_include_directive : require
// lookup_gather.comp: chain points look into the tree of photons and take light from those whose footprint they are in.
// Eight lanes of a subgroup share a point: they meet the eight boxes below a node, and the photons of a bucket, at once.
//
// Reads   list of chain points, tree, order, photons to be looked up
// Writes  irradiance sums of chain points in units of frame.irradiance_unit; shares of photons: how much of the picture
//         shows them
// Source  design 5 (feedback), 8; rtpm 3.6
#extension GL_KHR_shader_subgroup_ballot : require
#include "frame.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(std430, binding = BINDING_PASS) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer chain_buffer { chain_point chains[]; };
layout(std430, binding = BINDING_PASS + 2) readonly buffer list_buffer { uint point_list[]; };
layout(std430, binding = BINDING_PASS + 3) readonly buffer node_buffer { tree_node nodes[]; };
layout(std430, binding = BINDING_PASS + 4) readonly buffer order_buffer { tree_photon order[]; };
layout(std430, binding = BINDING_PASS + 5) readonly buffer seen_buffer { lookup_photon seen[]; };
layout(std430, binding = BINDING_PASS + 6) buffer sum_buffer { uint sums[]; };
layout(std430, binding = BINDING_PASS + 7) buffer share_buffer { uint shares[]; };
#include "photon_tree.glsl"

// Below a node at most seven siblings wait on every level.
const uint STACK_MAX = 8u * TREE_LEVELS;
uint stack[STACK_MAX]; // level << 24 | node

struct {
    chain_point point;
    uint low[3], high[3]; // sums: 64 bits each
    uint tested, inside, overflow, ended;
} taker;

// As ADD_FIXED does, so that the bits are those of the other way round.
void add_sum(uint channel, float value)
{
    float fixed_value = floor(value + 0.5);
    if (!(fixed_value < 4.6e18)) {
        fixed_value = 4.6e18;
        taker.overflow++;
    }
    uint fixed_high = uint(fixed_value * (1.0 / 4294967296.0));
    uint carry;
    taker.low[channel] = uaddCarry(taker.low[channel], uint(fixed_value - float(fixed_high) * 4294967296.0), carry);
    taker.high[channel] += fixed_high + carry;
}

// Buckets met and not yet visited.
const uint HELD_MAX = 24u;
uint held_buckets[HELD_MAX];
// Photons near the point, which wait until some lane has so many: few are, so what is dear is done for several lanes
// together.
const uint NEAR_MAX = 16u;
uint near_photons[NEAR_MAX];

void take(uint photon)
{
    vec4 position = seen[photon].position, covariance = seen[photon].covariance;
    vec3 normal = unpack_normal(floatBitsToUint(position.w)), t1, t2;
    tangent_frame(normal, t1, t2);
    float k = lookup_kernel(taker.point.position_normal.xyz - position.xyz, normal, t1, t2, covariance,
                            floatBitsToUint(taker.point.position_normal.w), taker.point.axes);
    if (!(k > 0.0))
        return;
    taker.inside++;
    vec4 flux = seen[photon].flux;
    vec3 units = flux.xyz / frame.irradiance_unit;
    if (has(FEATURE_CHROMATIC)) {
        add_sum(0u, units.x * k);
        add_sum(1u, units.y * k);
        add_sum(2u, units.z * k);
    } else
        add_sum(0u, channel_sum(units) / 3.0 * k);
    uint share = lookup_share(k, flux.w, taker.point.axes);
    uint old = atomicAdd(shares[2u * photon], share);
    if (old + share < old)
        atomicAdd(shares[2u * photon + 1u], 1u);
}

shared uint group_took[4];

void gather(uint number, uint lanes, uint lane)
{
    uint first_lane = gl_SubgroupInvocationID - lane;
    taker.point = chains[number];
    vec3 position = taker.point.position_normal.xyz;
    float reach = 1.25 * axes_reach(taker.point.axes), extent = point_extent(taker.point);
    uvec3 low = ordered_words(position - extent), high = ordered_words(position + extent);

    // In turns: nodes, until enough buckets are held; their photons, until a lane has enough near ones; those. Each is a
    // flat loop, for lavapipe skips nothing but loops.
    uint depth = 1u, rounds = 0u;
    stack[0] = uint(TREE_LEVELS) << 24;
    bool goes_on = true;
    while (depth > 0u && goes_on) {
        uint held = 0u;
        while (depth > 0u && held <= HELD_MAX - 8u) {
            uint top = stack[--depth];
            uint level = (top >> 24) - 1u, below = 8u * (top & 0xffffffu), first = tree_first(level);
            for (uint k = 0u; k < 8u; k += lanes) {
                uint child = first + below + k + lane;
                bool meets = nodes[child].high_x >= low.x && nodes[child].high_y >= low.y && nodes[child].high_z >= low.z &&
                             ~nodes[child].low_x <= high.x && ~nodes[child].low_y <= high.y && ~nodes[child].low_z <= high.z;
                uint met = (subgroupBallot(meets)[first_lane >> 5] >> (first_lane & 31u)) & ((1u << lanes) - 1u);
                while (met != 0u) {
                    uint which = below + k + uint(findLSB(met));
                    met &= met - 1u;
                    if (level > 0u)
                        stack[depth++] = (level << 24) | which;
                    else
                        held_buckets[held++] = which;
                    rounds++;
                }
            }
            rounds++;
        }
        uint bucket = 0u, at = 0u, end = 0u;
        bool is_done = false;
        while (!is_done) {
            uint near = 0u;
            while (!is_done && near < NEAR_MAX) {
                if (at < end) {
                    vec3 offset = position - vec3(order[at].x, order[at].y, order[at].z);
                    float far = reach + order[at].radius;
                    taker.tested++;
                    if (dot(offset, offset) < far * far)
                        near_photons[near++] = order[at].number;
                    at += lanes;
                } else if (bucket < held) {
                    uint node = held_buckets[bucket++];
                    at = nodes[node].first + lane;
                    end = nodes[node].first + nodes[node].count;
                } else
                    is_done = true;
                rounds++;
            }
            for (uint n_th = 0u; n_th < near; n_th++)
                take(near_photons[n_th]);
            rounds += near;
        }
        goes_on = ((subgroupBallot(rounds > TREE_ROUNDS_MAX)[first_lane >> 5] >> (first_lane & 31u)) & ((1u << lanes) - 1u)) == 0u;
    }
    taker.ended = depth > 0u && lane == 0u ? 1u : 0u;

    uint channels = has(FEATURE_CHROMATIC) ? 3u : 1u;
    for (uint channel = 0u; channel < channels; channel++) {
        uint at = 2u * (channels * number + channel);
        if ((taker.low[channel] | taker.high[channel]) == 0u)
            continue;
        uint old = atomicAdd(sums[at], taker.low[channel]);
        uint carry = old + taker.low[channel] < old ? 1u : 0u;
        if (taker.high[channel] + carry != 0u)
            atomicAdd(sums[at + 1u], taker.high[channel] + carry);
    }
}

void main()
{
    uint local = gl_LocalInvocationIndex;
    if (local < 4u)
        group_took[local] = 0u;
    barrier();
    uint lanes = min(gl_SubgroupSize, 8u), lane = gl_SubgroupInvocationID % lanes;
    uint place = (gl_WorkGroupID.x * GROUP_SIZE + gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID) / lanes;
    taker.low[0] = taker.low[1] = taker.low[2] = taker.high[0] = taker.high[1] = taker.high[2] = 0u;
    taker.tested = taker.inside = taker.overflow = taker.ended = 0u;
    if (place < lookup.listed) {
        gather(point_list[place], lanes, lane);
        atomicAdd(group_took[0], taker.tested);
        atomicAdd(group_took[1], taker.inside);
        atomicAdd(group_took[2], taker.overflow);
        atomicAdd(group_took[3], taker.ended);
    }
    barrier();
    const uint counts[4] = {LOOKUP_COUNT_KERNEL, LOOKUP_COUNT_INSIDE, LOOKUP_COUNT_OVERFLOW, LOOKUP_COUNT_GUARD};
    if (local < 4u && group_took[local] != 0u)
        atomicAdd(lookup.count[counts[local]], group_took[local]);
}
