#version 460
#extension GL_GOOGLE_include_directive : require
// lookup_break.comp: finds the pixels within which what glass and mirrors show breaks up: beside a pixel that shows
// another surface, or a place farther away than its own size there tells. One camera ray tells nothing of them. Their
// order depends on who came first; pictures do not, for it only says where their samples are kept.
// PHASE 1, one workgroup: how many samples and points that makes.
//
// Reads   chain points
// Writes  broken: pixels, then for each pixel its number among them or NONE; lookup.broken, lookup.shown; workgroups over
//         samples and points (PHASE 1)
// Source  design 8
#include "frame.glsl"
#include "lookup.glsl"
layout(local_size_x = GROUP_SIZE) in;
layout(constant_id = 8) const uint PHASE = 0u;
layout(std430, binding = BINDING_PASS) buffer lookup_buffer { lookup_gpu lookup; };
layout(std430, binding = BINDING_PASS + 1) readonly buffer chain_buffer { chain_point chains[]; };
layout(std430, binding = BINDING_PASS + 2) buffer broken_buffer { uint broken[]; };

const float APART_MAX = 3.0;  // reaches of a pixel's filter; neighbours on a plane are 1.33 apart

bool is_apart(chain_point a, chain_point b)
{
    if (!chain_exists(a) || !chain_exists(b))
        return chain_exists(a) != chain_exists(b) || a.axes.w != b.axes.w;
    float reach = max(axes_reach(a.axes), axes_reach(b.axes));
    vec3 offset = a.position_normal.xyz - b.position_normal.xyz;
    return dot(offset, offset) > APART_MAX * APART_MAX * reach * reach;
}

bool is_broken(uint pixel)
{
    int x = int(pixel % frame.width), y = int(pixel / frame.width);
    for (uint layer = 0u; layer < frame.camera_branches; layer++) {
        uint first = layer * frame.width * frame.height;
        chain_point here = chains[first + pixel];
        for (int k = 0; k < 4; k++) {
            ivec2 other = ivec2(x, y) + ivec2(k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0);
            if (all(greaterThanEqual(other, ivec2(0))) && other.x < int(frame.width) && other.y < int(frame.height) &&
                is_apart(here, chains[first + uint(other.y) * frame.width + uint(other.x)]))
                return true;
        }
    }
    return false;
}

void count_groups()
{
    uint each = samples_each(lookup.broken, lookup.shown), samples = each > 1u ? each * lookup.broken : 0u;
    uint points = sample_first() + (samples > 0u ? (frame.camera_branches - 1u) * frame.sample_capacity + samples : 0u);
    lookup.sample_groups[0] = (samples + GROUP_SIZE - 1u) / GROUP_SIZE;
    lookup.point_groups[0] = (points + GROUP_SIZE - 1u) / GROUP_SIZE;
    lookup.sample_groups[1] = lookup.sample_groups[2] = lookup.point_groups[1] = lookup.point_groups[2] = 1u;
}

shared uint group_shown;

void count_shown(bool shows)
{
    bool is_first = gl_LocalInvocationIndex == 0u;
    if (is_first)
        group_shown = 0u;
    barrier();
    if (shows)
        atomicAdd(group_shown, 1u);
    barrier();
    if (is_first && group_shown > 0u)
        atomicAdd(lookup.shown, group_shown);
}

void main()
{
    uint pixel = gl_GlobalInvocationID.x, pixels = frame.width * frame.height;
    bool is_pixel = pixel < pixels;
    if (PHASE == 1u) {
        if (pixel == 0u)
            count_groups();
        return;
    }
    uint place = NONE;
    if (is_pixel && is_broken(pixel)) {
        place = atomicAdd(lookup.broken, 1u);
        broken[place] = pixel;
    }
    if (is_pixel)
        broken[pixels + pixel] = place;
    count_shown(is_pixel && (place != NONE || chain_exists(chains[pixel])));
}
