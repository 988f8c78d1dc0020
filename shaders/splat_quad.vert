#version 460
#extension GL_GOOGLE_include_directive : require
// splat_quad.vert: two triangles around each photon's ellipse, along its axes.
//
// Reads   photons
// Source  aaps-thesis 3.1.3, 5.1.1 to 5.1.3
#include "frame.glsl"
#include "ellipse.glsl"
layout(std430, binding = BINDING_PASS + 2) readonly buffer photon_buffer { photon photons[]; };
layout(location = 0) flat out vec4 position_slack;
layout(location = 1) flat out vec4 normal_u00;
layout(location = 2) flat out vec4 density_u01;
layout(location = 3) flat out vec3 middle_u11;
layout(location = 4) flat out uint index;

// Rasterisers snap corners to 1/256 px at worst, which takes away from thin quads. Where every sample tests the ellipse
// itself, a quad may be that much larger; a quad that is only its samples' share may not.
const float SNAP = 1.0 / 128.0;

void main()
{
    const vec2 corners[6] =
        vec2[](vec2(-1, -1), vec2(1, -1), vec2(-1, 1), vec2(-1, 1), vec2(1, -1), vec2(1, 1));
    index = uint(gl_VertexIndex) / 6u;
    photon p = photons[index];
    gl_Position = vec4(-2.0, -2.0, 0.0, 1.0); // all six corners outside: nothing
    position_slack = normal_u00 = density_u01 = vec4(0.0);
    middle_u11 = vec3(0.0);
    if (p.cell == NONE || (AA == AA_MSAA_SMALL && !ellipse_is_small(p)))
        return;
    screen_ellipse e = ellipse_on_screen(p);
    float apart = sqrt(0.25 * (e.xx - e.yy) * (e.xx - e.yy) + e.xy * e.xy);
    float major2 = 0.5 * (e.xx + e.yy) + apart;
    vec2 axis = e.xx > e.yy ? vec2(apart + 0.5 * (e.xx - e.yy), e.xy) : vec2(e.xy, apart + 0.5 * (e.yy - e.xx));
    axis = dot(axis, axis) > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
    vec2 radii = vec2(sqrt(major2), sqrt(e.det / major2));
    if (AA != AA_MSAA)
        radii += SNAP;
    vec2 corner = corners[uint(gl_VertexIndex) % 6u] * radii;
    vec2 pixel = e.middle + corner.x * axis + corner.y * vec2(-axis.y, axis.x);
    gl_Position = vec4(2.0 * pixel / vec2(float(frame.width), float(frame.height)) - 1.0, 0.5, 1.0);

    float u00 = sqrt(e.yy / e.det);
    position_slack = vec4(p.position.xyz, p.density.w);
    normal_u00 = vec4(unpack_normal(floatBitsToUint(p.position.w)), u00);
    density_u01 = vec4(p.density.xyz, -e.xy / (e.det * u00));
    middle_u11 = vec3(e.middle, inversesqrt(e.yy));
}
