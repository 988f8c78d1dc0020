// photon_tree.glsl: boxes of the tree of photons. Its buckets are cells of a k-d tree whose splits nobody stores: the first
// two bits of a bucket's number are the size of the footprint, each further one halves the longest side of the box
// around all chain points. Eight buckets whose numbers differ in the last three bits lie in one node of the level above.
// Source  design 8; rtpm 3.6 (an acceleration structure of photons that points look into)

// A word that has the order of the float.
uint ordered_word(float x)
{
    uint bits = floatBitsToUint(x);
    return bits ^ ((bits >> 31) != 0u ? 0xffffffffu : 0x80000000u);
}

uvec3 ordered_words(vec3 x)
{
    return uvec3(ordered_word(x.x), ordered_word(x.y), ordered_word(x.z));
}

float float_of_word(uint word)
{
    return uintBitsToFloat(word ^ ((word >> 31) != 0u ? 0x80000000u : 0xffffffffu));
}

vec3 bounds_low()
{
    return vec3(float_of_word(~lookup.low_x), float_of_word(~lookup.low_y), float_of_word(~lookup.low_z));
}

vec3 bounds_high()
{
    return vec3(float_of_word(lookup.high_x), float_of_word(lookup.high_y), float_of_word(lookup.high_z));
}

// How far from it a point can be reached, along any axis: its ellipse turned onto any photon's plane, and the slack.
float point_extent(chain_point point)
{
    return 1.2501 * axes_reach(point.axes);
}

// First node of a level; buckets are level 0.
uint tree_first(uint level)
{
    return (8u * uint(TREE_BUCKETS) - ((8u * uint(TREE_BUCKETS)) >> (3u * level))) / 7u;
}
