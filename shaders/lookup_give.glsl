// lookup_give.glsl: one photon's side of the lookup: gives light to chain points, sums what of it is seen, and reports.
//
// Reads   seen[]; Writes  sums[], photons[], lookup.count[]
// Source  design 5 (feedback), 8
#include "lookup_report.glsl"

struct {
    uint photon;
    vec3 position, normal, t1, t2;
    vec4 covariance;
    vec3 units;     // flux in units of the sums times m^2
    float area;     // of its stratum's image, m^2
} giver;

struct {
    uint photons, tested, inside, overflow, guard, seen; // of all photons so far
    uint inside_this; // of this one
    uint share_low, share_high; // sum of kernel times area times throughput, 2^-20: the pixels that see its stratum
} gave;

shared uint group_gave[6], group_share_low[GROUP_SIZE / 8u], group_share_high[GROUP_SIZE / 8u], group_inside[GROUP_SIZE / 8u];

void giver_find(uint index)
{
    giver.photon = index;
    giver.position = seen[index].position.xyz;
    giver.normal = unpack_normal(floatBitsToUint(seen[index].position.w));
    tangent_frame(giver.normal, giver.t1, giver.t2);
    giver.covariance = seen[index].covariance;
    giver.units = seen[index].flux.xyz / frame.irradiance_unit;
    if (!has(FEATURE_CHROMATIC))
        giver.units = vec3(channel_sum(giver.units) / 3.0); // all photons have the tint of frame.tint
    giver.area = seen[index].flux.w;
}

void give_begin()
{
    uint i = gl_LocalInvocationIndex;
    if (i < 6u)
        group_gave[i] = 0u;
    if (i < GROUP_SIZE / 8u)
        group_share_low[i] = group_share_high[i] = group_inside[i] = 0u;
    gave.photons = gave.tested = gave.inside = gave.overflow = gave.guard = gave.seen = gave.inside_this = gave.share_low = gave.share_high = 0u;
    barrier();
}

void give(chain_point point, uint place)
{
    float k = lookup_kernel(point.position_normal.xyz - giver.position, giver.normal, giver.t1, giver.t2, giver.covariance,
                            floatBitsToUint(point.position_normal.w), point.axes);
    if (k > 0.0) {
        gave.inside_this++;
        bool is_exact;
        vec3 value = giver.units * k;
        if (has(FEATURE_CHROMATIC)) {
            ADD_FIXED(sums[6u * place], sums[6u * place + 1u], value.x, is_exact);
            gave.overflow += is_exact ? 0u : 1u;
            ADD_FIXED(sums[6u * place + 2u], sums[6u * place + 3u], value.y, is_exact);
            gave.overflow += is_exact ? 0u : 1u;
            ADD_FIXED(sums[6u * place + 4u], sums[6u * place + 5u], value.z, is_exact);
            gave.overflow += is_exact ? 0u : 1u;
        } else {
            ADD_FIXED(sums[2u * place], sums[2u * place + 1u], value.x, is_exact);
            gave.overflow += is_exact ? 0u : 1u;
        }
        uint carry;
        gave.share_low = uaddCarry(gave.share_low, lookup_share(k, giver.area, point.axes), carry);
        gave.share_high += carry;
    }
}

void give_next()
{
    gave.inside += gave.inside_this;
    gave.inside_this = gave.share_low = gave.share_high = 0u;
}

void give_end()
{
    report(giver.photon, uvec2(gave.share_low, gave.share_high));
    gave.seen += gave.inside_this != 0u ? 1u : 0u;
    give_next();
}

// Of eight threads with one photon; every thread of the workgroup calls it.
void give_end_together(bool has_walk)
{
    uint lane = gl_LocalInvocationIndex % 8u, which = gl_LocalInvocationIndex / 8u;
    if (has_walk && gave.inside_this != 0u) {
        atomicAdd(group_inside[which], gave.inside_this);
        uint old = atomicAdd(group_share_low[which], gave.share_low);
        atomicAdd(group_share_high[which], gave.share_high + (old + gave.share_low < old ? 1u : 0u));
    }
    barrier();
    if (lane == 0u) {
        if (has_walk && group_inside[which] != 0u) {
            report(giver.photon, uvec2(group_share_low[which], group_share_high[which]));
            gave.seen++;
        }
        group_inside[which] = group_share_low[which] = group_share_high[which] = 0u;
    }
    barrier();
    give_next();
}

void give_count()
{
    if ((gave.photons | gave.tested | gave.inside | gave.seen) != 0u) {
        atomicAdd(group_gave[0], gave.photons);
        atomicAdd(group_gave[1], gave.tested);
        atomicAdd(group_gave[2], gave.inside);
        atomicAdd(group_gave[3], gave.seen);
    }
    if ((gave.guard | gave.overflow) != 0u) {
        atomicAdd(group_gave[4], gave.guard);
        atomicAdd(group_gave[5], gave.overflow);
    }
    barrier();
    const uint counts[6] = {LOOKUP_COUNT_PHOTONS, LOOKUP_COUNT_KERNEL, LOOKUP_COUNT_INSIDE, LOOKUP_COUNT_SEEN, LOOKUP_COUNT_GUARD,
                            LOOKUP_COUNT_OVERFLOW};
    uint i = gl_LocalInvocationIndex;
    if (i < 6u && group_gave[i] != 0u)
        atomicAdd(lookup.count[counts[i]], group_gave[i]);
}
