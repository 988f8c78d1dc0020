// hand_out.glsl: parts of one list for everybody, with one addition to the list's length per workgroup.
// Writes  lookup.first

shared uint hand_out_part[GROUP_SIZE];

// Where a part of `count` entries starts; every thread of the workgroup calls it.
uint hand_out(uint count)
{
    uint i = gl_LocalInvocationIndex;
    hand_out_part[i] = count;
    barrier();
    uint before = 0u, all = 0u;
    for (uint k = 0u; k < GROUP_SIZE; k++) {
        before += k < i ? hand_out_part[k] : 0u;
        all += hand_out_part[k];
    }
    barrier();
    if (i == 0u)
        hand_out_part[0] = all > 0u ? atomicAdd(lookup.first, all) : 0u;
    barrier();
    return hand_out_part[0] + before;
}
