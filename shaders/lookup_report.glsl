// lookup_report.glsl: a photon that is seen through glass or mirrors counts in the feedback, beside, or instead of, being
// seen directly.
// Reads   seen[]; Writes  photons[]

// `share`: lookup_share() over the chain points that took it, 64 bits.
void report(uint index, uvec2 share)
{
    // Chain points see nothing smaller than their pixel's filter: photons of target_area would be finer than it takes. On
    // `pool` from above at 480x270 a sixteenth sends 50,000 of them and a quarter 95,000, at errors of 0.068 and 0.064.
    float area = fixed_value_of(share.x, share.y) * (0.0625 / LOOKUP_SHARE_UNITS);
    if (DENSITY == DENSITY_UNIFORM_RULE || !(area > 0.0))
        return;
    bool is_drawn = photons[index].cell != NONE;
    photons[index].area = photon_area((is_drawn ? photons[index].area : 0.0) + area);
    photons[index].root = photon_root(photons[index].area, channel_sum(seen[index].flux.xyz));
    if (!is_drawn) {
        photons[index].cell = seen[index].cell;
        photons[index].center = vec4(-1.0); // no pixel of its own to compare with the last frame's
    }
}
