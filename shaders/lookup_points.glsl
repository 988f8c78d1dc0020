// lookup_points.glsl: which numbers of the lists of chain points (shared/lookup_layout.h) are in use.
// Reads   lookup.broken, lookup.shown

// Is there a chain point of this number, if only an empty one?
bool point_is_used(uint number)
{
    uint first = sample_first();
    if (!has(FEATURE_SAMPLES) || number < first)
        return number < first;
    uint each = samples_each(lookup.broken, lookup.shown);
    return number < first + frame.camera_branches * frame.sample_capacity && each > 1u &&
           (number - first) % frame.sample_capacity < each * lookup.broken;
}
