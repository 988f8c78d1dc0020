// targets.glsl: what splats may land on: the G-buffer's directly visible receivers.
// Source  design 7
layout(std430, binding = BINDING_PASS + 1) readonly buffer target_buffer { target_gpu targets[]; };

bool target_exists(target_gpu target)
{
    return floatBitsToUint(target.position_normal.w) != NONE;
}

// Does the surface in this pixel belong to the photon at `position` (relative to the eye) with this normal?
bool target_accepts(target_gpu target, vec3 position, vec3 normal, float slack)
{
    if (!target_exists(target))
        return false;
    vec3 offset = target.position_normal.xyz - position;
    if (DEPTH == DEPTH_MARGIN) {
        // distance along the pixel's ray: |x| against |x| moved into the photon's plane
        float along = dot(target.position_normal.xyz, normal);
        float miss = dot(offset, normal);
        return abs(miss) <= 0.01 * abs(along);
    }
    return abs(dot(offset, normal)) <= slack && dot(unpack_normal(floatBitsToUint(target.position_normal.w)), normal) > 0.5;
}
