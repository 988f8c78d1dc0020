// lookup_give.glsl: one photon's side of the lookup: gives light to chain points, sums what of it is seen, and reports.
//
// Reads   seen[]; Writes  sums[], photons[], lookup.count[]
// Source  design 5 (feedback), 8
#include "lookup_report.glsl"

struct {
    vec3 position, normal, t1, t2;
    vec4 covariance;
    vec3 units;     // flux in units of the sums times m^2
    float area;     // of its stratum's image, m^2
} giver;

struct {
    uint tested, inside, overflow, guard;
    uint share_low, share_high; // sum of kernel times area times throughput, 2^-20: the pixels that see its stratum
} gave;

shared uint group_gave[5];

void give_begin(bool is_looked_up, uint index)
{
    if (gl_LocalInvocationIndex < 5u)
        group_gave[gl_LocalInvocationIndex] = 0u;
    gave.tested = gave.inside = gave.overflow = gave.guard = gave.share_low = gave.share_high = 0u;
    if (is_looked_up) {
        giver.position = seen[index].position.xyz;
        giver.normal = unpack_normal(floatBitsToUint(seen[index].position.w));
        tangent_frame(giver.normal, giver.t1, giver.t2);
        giver.covariance = seen[index].covariance;
        giver.units = seen[index].flux.xyz / frame.irradiance_unit;
        if (!has(FEATURE_CHROMATIC))
            giver.units = vec3(channel_sum(giver.units) / 3.0); // all photons have the tint of frame.tint
        giver.area = seen[index].flux.w;
    }
}

void give(chain_point point, uint place)
{
    float k = lookup_kernel(point.position_normal.xyz - giver.position, giver.normal, giver.t1, giver.t2, giver.covariance,
                            floatBitsToUint(point.position_normal.w), point.axes);
    if (k > 0.0) {
        gave.inside++;
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

void give_end(bool is_looked_up, uint index)
{
    barrier();
    if (is_looked_up) {
        atomicAdd(group_gave[0], 1u);
        atomicAdd(group_gave[1], gave.tested);
        atomicAdd(group_gave[2], gave.inside);
        if (gave.inside != 0u)
            atomicAdd(group_gave[3], 1u);
        if (gave.guard != 0u)
            atomicAdd(group_gave[4], gave.guard);
        if (gave.overflow != 0u)
            atomicAdd(lookup.count[LOOKUP_COUNT_OVERFLOW], gave.overflow);
        report(index, uvec2(gave.share_low, gave.share_high));
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u && group_gave[0] != 0u) {
        atomicAdd(lookup.count[LOOKUP_COUNT_PHOTONS], group_gave[0]);
        atomicAdd(lookup.count[LOOKUP_COUNT_KERNEL], group_gave[1]);
        atomicAdd(lookup.count[LOOKUP_COUNT_INSIDE], group_gave[2]);
        atomicAdd(lookup.count[LOOKUP_COUNT_SEEN], group_gave[3]);
        if (group_gave[4] != 0u)
            atomicAdd(lookup.count[LOOKUP_COUNT_GUARD], group_gave[4]);
    }
}
