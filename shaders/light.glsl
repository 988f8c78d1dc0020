// light.glsl: lights and the equal-area maps of their tiles.
//
// Reads   binding 7: lights
// Source  design 4; Shirley and Chiu 1997 (concentric map); Clarberg 2008 (equal-area octahedron)
layout(std430, binding = BINDING_LIGHTS) readonly buffer light_buffer { light_gpu lights[]; };

// A point of the unit square to the unit disk, equal area, with its derivatives.
void concentric_map(vec2 uv, out vec2 disk, out vec2 disk_u, out vec2 disk_v)
{
    vec2 o = 2.0 * uv - 1.0;
    if (abs(o.x) < 1e-9 && abs(o.y) < 1e-9) {
        disk = vec2(0.0);
        disk_u = vec2(2.0, 0.0);
        disk_v = vec2(0.0, PI / 2.0);
        return;
    }
    bool swapped = abs(o.y) > abs(o.x);
    float r = swapped ? o.y : o.x;
    float ratio = swapped ? o.x / o.y : o.y / o.x;
    float phi = swapped ? PI / 2.0 - (PI / 4.0) * ratio : (PI / 4.0) * ratio;
    float c = cos(phi), s = sin(phi);
    disk = r * vec2(c, s);
    // with q = the other coordinate: d/dr at fixed q turns phi by -+(pi/4) q/r^2, so r dphi = -+(pi/4) ratio
    vec2 along = swapped ? vec2(c, s) + (PI / 4.0) * ratio * vec2(-s, c) : vec2(c, s) - (PI / 4.0) * ratio * vec2(-s, c);
    vec2 across = (swapped ? -PI / 4.0 : PI / 4.0) * vec2(-s, c);
    disk_u = 2.0 * (swapped ? across : along);
    disk_v = 2.0 * (swapped ? along : across);
}

vec2 concentric_inverse(vec2 disk)
{
    float r = length(disk);
    if (r < 1e-12)
        return vec2(0.5);
    // Which of the four wedges, and the signed radius there.
    vec2 o;
    if (abs(disk.x) >= abs(disk.y)) {
        float signed_r = disk.x >= 0.0 ? r : -r;
        o = vec2(signed_r, signed_r * atan(disk.y / disk.x) * (4.0 / PI));
    } else {
        float signed_r = disk.y >= 0.0 ? r : -r;
        o = vec2(signed_r * atan(disk.x / disk.y) * (4.0 / PI), signed_r);
    }
    return clamp(0.5 * o + 0.5, vec2(0.0), vec2(1.0));
}

// Unit square to a cap of height h = 1 - cos(half angle) about +z, equal area.
void cap_map(vec2 uv, float h, out vec3 d, out vec3 d_u, out vec3 d_v)
{
    vec2 p, p_u, p_v;
    concentric_map(uv, p, p_u, p_v);
    float rho2 = dot(p, p);
    float g = sqrt(max(h * (2.0 - h * rho2), 0.0)); // sin(theta) / rho
    d = vec3(p * g, 1.0 - h * rho2);
    float slope = -h * h / max(g, 1e-12); // dg/d(rho^2) = -h^2 / (2 g)
    float change_u = dot(p, p_u), change_v = dot(p, p_v);
    d_u = vec3(p_u * g + p * (slope * change_u), -2.0 * h * change_u);
    d_v = vec3(p_v * g + p * (slope * change_v), -2.0 * h * change_v);
}

// Unit square to the sphere, equal area, with its derivatives: those of the octahedron's face that holds the point.
void sphere_map_derivatives(vec2 uv, out vec3 d_u, out vec3 d_v)
{
    vec2 o = 2.0 * uv - 1.0;
    vec2 turn = vec2(o.x < 0.0 ? -1.0 : 1.0, o.y < 0.0 ? -1.0 : 1.0);
    vec2 a = abs(o);
    float side = a.x + a.y <= 1.0 ? 1.0 : -1.0;
    float r = 1.0 - abs(1.0 - a.x - a.y);
    float q = r > 1e-9 ? (a.y - a.x) / r : 0.0;
    float phi = (q + 1.0) * (PI / 4.0);
    float c = cos(phi), s = sin(phi);
    float g = sqrt(2.0 - r * r);
    float slope = side * (2.0 - 2.0 * r * r) / g; // of sin(theta) over |o.x| or |o.y|
    vec2 swing = g * (PI / 4.0) * (vec2(-1.0, 1.0) - q * side); // sin(theta) dphi
    d_u = 2.0 * turn.x * vec3(turn.x * (c * slope - s * swing.x), turn.y * (s * slope + c * swing.x), -2.0 * r);
    d_v = 2.0 * turn.y * vec3(turn.x * (c * slope - s * swing.y), turn.y * (s * slope + c * swing.y), -2.0 * r);
}

vec3 sphere_map(vec2 uv)
{
    vec2 o = 2.0 * uv - 1.0;
    vec2 a = abs(o);
    float signed_distance = 1.0 - (a.x + a.y);
    float distance = abs(signed_distance);
    float r = 1.0 - distance;
    float phi = (r == 0.0 ? 1.0 : (a.y - a.x) / r + 1.0) * (PI / 4.0);
    float z = (signed_distance < 0.0 ? -1.0 : 1.0) * (1.0 - r * r);
    float s = r * sqrt(max(2.0 - r * r, 0.0));
    return vec3((o.x < 0.0 ? -1.0 : 1.0) * cos(phi) * s, (o.y < 0.0 ? -1.0 : 1.0) * sin(phi) * s, z);
}

vec2 sphere_inverse(vec3 d)
{
    vec3 a = abs(d);
    float r = sqrt(max(1.0 - a.z, 0.0));
    float phi = a.x == 0.0 && a.y == 0.0 ? 0.0 : atan(min(a.x, a.y), max(a.x, a.y)) * (2.0 / PI);
    if (a.x < a.y)
        phi = 1.0 - phi;
    vec2 o = vec2(r - phi * r, phi * r);
    if (d.z < 0.0)
        o = 1.0 - o.yx;
    return 0.5 * vec2(d.x < 0.0 ? -o.x : o.x, d.y < 0.0 ? -o.y : o.y) + 0.5;
}

// What leaves a light at a point of its tile: origin, unit direction, and their derivatives over the whole tile.
struct emission {
    vec3 origin, direction;
    vec3 origin_u, origin_v, direction_u, direction_v;
};

vec3 tile_frame(vec3 x, vec3 y, vec3 z, vec3 local)
{
    return x * local.x + y * local.y + z * local.z;
}

// Direction only, for tiles of directions.
vec3 tile_direction(uint map, vec4 x, vec4 y, vec4 z, vec2 uv)
{
    if (map == TILE_CAP) {
        vec3 d, d_u, d_v;
        cap_map(uv, z.w, d, d_u, d_v);
        return normalize(tile_frame(x.xyz, y.xyz, z.xyz, d));
    }
    return normalize(tile_frame(x.xyz, y.xyz, z.xyz, sphere_map(uv)));
}

emission light_emit(light_gpu light, vec2 uv)
{
    emission e;
    e.origin = light.position.xyz;
    e.origin_u = e.origin_v = vec3(0.0);
    e.direction_u = e.direction_v = vec3(0.0);
    if (has(FEATURE_DIRECTIONAL) && light.map == TILE_RECT) {
        vec2 o = 2.0 * uv - 1.0;
        e.origin = light.tile_origin.xyz + light.tile_x.xyz * (light.tile_x.w * o.x) + light.tile_y.xyz * (light.tile_y.w * o.y);
        e.origin_u = light.tile_x.xyz * (2.0 * light.tile_x.w);
        e.origin_v = light.tile_y.xyz * (2.0 * light.tile_y.w);
        e.direction = light.direction.xyz;
    } else if (light.map == TILE_CAP) {
        vec3 d, d_u, d_v;
        cap_map(uv, light.tile_z.w, d, d_u, d_v);
        e.direction = normalize(tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d));
        e.direction_u = tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d_u);
        e.direction_v = tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d_v);
    } else {
        vec3 d = sphere_map(uv), d_u, d_v;
        sphere_map_derivatives(uv, d_u, d_v);
        e.direction = normalize(tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d));
        e.direction_u = tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d_u);
        e.direction_v = tile_frame(light.tile_x.xyz, light.tile_y.xyz, light.tile_z.xyz, d_v);
    }
    return e;
}

// 1 - cosine of the angle between unit vectors, and the angle itself. The cosine of a small angle has no digits left:
// 0.02 degrees are its last bit.
float one_minus_cosine(vec3 a, vec3 b)
{
    vec3 chord = a - b;
    return 0.5 * dot(chord, chord);
}

float angle_between(vec3 a, vec3 b)
{
    return 2.0 * asin(min(sqrt(0.5 * one_minus_cosine(a, b)), 1.0));
}

// Share of the intensity that goes this way (unit, away from the light): 1, the spot's fall-off (glTF
// KHR_lights_punctual, but without its least width of 0.001 in the cosine, which blackens beams under a degree), or the
// cosine of a patch.
float light_falloff(light_gpu light, vec3 direction)
{
    if (!has(FEATURE_SPOT) || light.type == LIGHT_TYPE_POINT || light.type == LIGHT_TYPE_DIRECTIONAL)
        return 1.0;
    if (light.type == LIGHT_TYPE_COSINE)
        return max(dot(direction, light.direction.xyz), 0.0);
    float outer = light.position.w, inner = light.direction.w;
    float t = clamp((outer - one_minus_cosine(direction, light.direction.xyz)) / max(outer - inner, 1e-3 * outer), 0.0, 1.0);
    return t * t;
}

// ---- emitters with a size: the tile's point T at pivot distance and a point e of the emitter make a ray ----

// A point of the emitter at `place` in the unit square, relative to the light, and its derivatives. A sphere shows T
// the disk that its tangent cone cuts out of the plane across the way to T.
vec3 emitter_point(light_gpu light, vec3 to_pivot, vec2 place, out vec3 e_s, out vec3 e_t)
{
    vec3 x = light.emitter_x.xyz, y = light.emitter_y.xyz;
    if (light.shape == EMITTER_SPHERE) {
        float sine = light.emitter_y.w / light.emitter_x.w;
        float radius = light.emitter_y.w * inversesqrt(1.0 - sine * sine);
        x = radius * normalize(abs(to_pivot.y) < 0.9 ? cross(to_pivot, vec3(0.0, 1.0, 0.0)) : cross(to_pivot, vec3(1.0, 0.0, 0.0)));
        y = cross(to_pivot, x);
    }
    vec2 q = 2.0 * place - 1.0, q_s = vec2(2.0, 0.0), q_t = vec2(0.0, 2.0);
    if (light.shape != EMITTER_RECTANGLE)
        concentric_map(place, q, q_s, q_t);
    e_s = x * q_s.x + y * q_s.y;
    e_t = x * q_t.x + y * q_t.y;
    return x * q.x + y * q.y;
}

// Flux through the pivot sphere at T from around e, against that of the light as a point.
float emitter_weight(light_gpu light, vec3 to_pivot, vec3 e)
{
    float pivot = light.emitter_x.w;
    vec3 way = pivot * to_pivot - e;
    float distance2 = dot(way, way);
    float nearness = pivot * pivot / distance2;
    if (light.shape == EMITTER_SPHERE) {
        float sine = light.emitter_y.w / pivot;
        return nearness * nearness / (1.0 - sine * sine);
    }
    vec3 direction = way * inversesqrt(distance2);
    return light_falloff(light, direction) * nearness * dot(direction, to_pivot);
}

// The same over the whole emitter, exact for a weight that is quadratic there.
float emitter_mean_weight(light_gpu light, vec3 to_pivot)
{
    if (light.shape == EMITTER_SPHERE)
        return 1.0;
    float sum = 0.0;
    for (uint k = 0u; k < 4u; k++) {
        vec2 q = light.shape == EMITTER_RECTANGLE ? vec2(k & 1u, k >> 1) * 2.0 - 1.0
                                                  : vec2(k < 2u ? 1.0 : 0.0, k < 2u ? 0.0 : 1.0) * ((k & 1u) == 0u ? 1.0 : -1.0);
        q *= inversesqrt(light.shape == EMITTER_RECTANGLE ? 3.0 : 2.0);
        sum += emitter_weight(light, to_pivot, light.emitter_x.xyz * q.x + light.emitter_y.xyz * q.y);
    }
    return 0.25 * sum;
}

// How far apart, as seen from the light, a ray from the emitter may meet the pivot sphere and distance `d`.
float emitter_widening(light_gpu light, float d)
{
    float radius = light.emitter_y.w;
    return abs(asin(min(radius / max(d, 1e-30), 1.0)) - asin(radius / light.emitter_x.w));
}

// ---- tiles and their cells ----

// How much of a rectangle of the light's unit square belongs to insets of this tile.
float inset_share(light_gpu light, uint tile, vec2 corner, vec2 size)
{
    float share = 0.0;
    for (uint i = frame.light_count, left = light.part_insets; i < frame.part_count && left > 0u; i++) {
        if (lights[i].part_parent != tile)
            continue;
        vec4 part = lights[i].part;
        vec2 covered = clamp((part.xy + part.zw - corner) / size, 0.0, 1.0) - clamp((part.xy - corner) / size, 0.0, 1.0);
        share += covered.x * covered.y;
        left--;
    }
    return share;
}

// Cells are numbered along a Morton curve, tile after tile.
uint morton_encode(uvec2 p)
{
    p = (p | (p << 8)) & 0x00ff00ffu;
    p = (p | (p << 4)) & 0x0f0f0f0fu;
    p = (p | (p << 2)) & 0x33333333u;
    p = (p | (p << 1)) & 0x55555555u;
    return p.x | (p.y << 1);
}

uvec2 morton_decode(uint code)
{
    uvec2 p = uvec2(code, code >> 1) & 0x55555555u;
    p = (p | (p >> 1)) & 0x33333333u;
    p = (p | (p >> 2)) & 0x0f0f0f0fu;
    p = (p | (p >> 4)) & 0x00ff00ffu;
    p = (p | (p >> 8)) & 0x0000ffffu;
    return p;
}

uint cell_light(uint cell)
{
    return cell >> (2u * frame.tile_levels);
}

uvec2 cell_place(uint cell)
{
    return morton_decode(cell & ((1u << (2u * frame.tile_levels)) - 1u));
}
