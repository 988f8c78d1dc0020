// branches.glsl: dim branches are followed by fewer strata: along each side of a cell by one in about two or four, the middle
// one of its group, for all of the group. What they carry adds up exactly, cell by cell.
// Source  design 5

// Of `count` strata along a side, those that follow a branch of spacing 1, 2 or 4.
uint branch_strata(uint count, uint spacing)
{
    if (spacing > 1u)
        count = max(count / 2u, 1u);
    return spacing > 2u ? max(count / 2u, 1u) : count;
}

bool is_middle(uint i, uint count, uint groups)
{
    uint group = i * groups / count;
    return i == (2u * group + 1u) * count / (2u * groups);
}

// Whether stratum i of `count` follows branches of spacing 2; and, given that, of spacing 4.
bool follows_2(uint i, uint count)
{
    return is_middle(i, count, branch_strata(count, 2u));
}

bool follows_4(uint i, uint count)
{
    uint half_count = branch_strata(count, 2u);
    return is_middle(i * half_count / count, half_count, branch_strata(count, 4u));
}

// How many times wider than a stratum of the cell the footprints of such a branch are.
vec2 branch_width(uint columns, uint strata, uint spacing)
{
    uvec2 count = uvec2(columns, strata / columns);
    return vec2(count) / vec2(branch_strata(count.x, spacing), branch_strata(count.y, spacing));
}
