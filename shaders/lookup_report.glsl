// lookup_report.glsl: a photon that is seen through glass or mirrors counts in the feedback, beside, or instead of, being
// seen directly.
// Reads   seen[]; Writes  photons[]

// `share`: lookup_share() over the chain points that took it, 64 bits.
void report(uint index, uvec2 share)
{
    float area = fixed_value_of(share.x, share.y) * (LOOKUP_AREA_PART / LOOKUP_SHARE_UNITS);
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
