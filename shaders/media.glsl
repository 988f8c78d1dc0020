// media.glsl: the solids a ray is in, and what it meets where surfaces lie in each other.
//
// Reads   materials
// Source  design 4; core/scene/solids.h (numbers, lists, contacts)
//
// A list holds up to four solid numbers, a byte each; 0 is air. The smallest number counts. Where no solids overlap
// (FEATURE_NESTED is off) it holds one at most.
const uint MEDIA_MAX = 4u;

uint media_number(uint material)
{
    return (scene_materials[material].flags >> 8) & 0xffu;
}

// Material of the number that counts, NONE in air.
uint media_top(uint list)
{
    uint top = list;
    if (has(FEATURE_NESTED)) {
        top = 0x100u;
        for (uint k = 0u; k < MEDIA_MAX; k++) {
            uint number = (list >> (8u * k)) & 0xffu;
            top = number != 0u ? min(top, number) : top;
        }
        top &= 0xffu;
    }
    return top == 0u ? NONE : scene_materials[top - 1u].flags >> 16;
}

// Inverse squared wavelength against that of the d line, 1/um^2: 0 for white light.
float media_wave = 0.0;

float media_ior(uint material)
{
    if (material == NONE)
        return 1.0;
    float ior = scene_materials[material].color_ior.w;
    return has(FEATURE_DISPERSION) ? max(ior + scene_materials[material].emission.w * media_wave, 1.0) : ior;
}

// The list with `number` in place of the first byte that is `old`; as it was when there is none.
uint media_replace(uint list, uint old, uint number, out bool is_found)
{
    is_found = false;
    for (uint k = 0u; k < MEDIA_MAX && !is_found; k++)
        if (((list >> (8u * k)) & 0xffu) == old) {
            list = (list & ~(0xffu << (8u * k))) | (number << (8u * k));
            is_found = true;
        }
    return list;
}

// What is beyond the surface of a solid, seen from its front or its back.
uint media_beyond(uint list, uint material, bool front)
{
    uint number = media_number(material);
    if (!has(FEATURE_NESTED))
        return front ? number : 0u;
    bool is_found;
    return number == 0u ? list : front ? media_replace(list, 0u, number, is_found) : media_replace(list, number, 0u, is_found);
}

// What is on this side of it. Who leaves a solid that is not on the list was in it all the same: too many solids, or
// an open mesh that was entered where it has no surface.
uint media_here(uint list, uint material, bool front)
{
    uint top = media_top(list);
    if (front)
        return top;
    if (!has(FEATURE_NESTED))
        return material;
    bool is_found;
    media_replace(list, media_number(material), 0u, is_found);
    return is_found && media_number(material) != 0u ? top : material;
}

// A dielectric boundary, or two that lie in each other.
struct boundary {
    float eta;   // index of refraction on this side over that on the other
    uint beyond; // list on the other side
};

boundary media_boundary(uint list, uint material, bool front, uint touching, bool touching_front)
{
    boundary b;
    if (!has(FEATURE_NESTED)) {
        float ior = media_ior(material);
        b.eta = front ? 1.0 / ior : ior;
        b.beyond = media_beyond(list, material, front);
        return b;
    }
    float from = media_ior(media_here(list, material, front));
    b.beyond = media_beyond(list, material, front);
    float to = media_ior(media_top(b.beyond));
    if (front && media_number(material) == 0u)
        to = media_ior(material);
    if (has(FEATURE_CONTACT) && touching != NONE) {
        b.beyond = media_beyond(b.beyond, touching, touching_front);
        to = media_ior(media_top(b.beyond));
    }
    b.eta = from / to;
    return b;
}

// The surface of another instance that lies in the dielectric one that was hit at p; its instance is TRACE_MISS where
// there is none.
trace_hit media_contact(vec3 p, vec3 geometric, uint instance)
{
    vec3 start = offset_origin(p, geometric);
    trace_excluded = instance;
    trace_hit other = trace_closest(start, offset_origin(p, -geometric) - start, 1.0);
    trace_excluded = TRACE_MISS;
    return other;
}

// Of two surfaces in one place a receiver or a mirror counts alone, whichever was hit: it is cemented to the glass, without
// a film of air. Two dielectrics part what is before both from what is beyond both. Returns whether `hit` became the other.
bool media_take_contact(trace_hit other, vec3 direction, inout trace_hit hit, out uint touching, out bool touching_front)
{
    touching = NONE;
    touching_front = false;
    if (other.instance == TRACE_MISS)
        return false;
    uint material = scene_instances[other.instance].material;
    uint kind = scene_materials[material].kind;
    if (kind == KIND_DIELECTRIC) {
        touching = material;
        touching_front = dot(direction, surface_fetch(other.instance, other.triangle, other.barycentrics).geometric) < 0.0;
        return false;
    }
    if (kind == KIND_THIN)
        return false;
    hit.instance = other.instance;
    hit.triangle = other.triangle;
    hit.barycentrics = other.barycentrics;
    return true;
}
