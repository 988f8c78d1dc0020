#version 460
#extension GL_GOOGLE_include_directive : require
// splat_quad.vert: the plain way to draw photons: an instanced quad of two triangles around each ellipse.
//
// Reads   photons
// Source  aaps-thesis 3.1.3
#include "frame.glsl"
layout(std430, binding = BINDING_PASS + 2) readonly buffer photon_buffer { photon photons[]; };
layout(location = 0) out vec2 kernel_position;
layout(location = 1) flat out vec4 position_slack;
layout(location = 2) flat out vec3 normal;
layout(location = 3) flat out vec3 density;

void main()
{
    const vec2 corners[6] =
        vec2[](vec2(-1, -1), vec2(1, -1), vec2(-1, 1), vec2(-1, 1), vec2(1, -1), vec2(1, 1));
    photon p = photons[gl_InstanceIndex];
    kernel_position = corners[gl_VertexIndex];
    // U s = q; the pixel offset o with U o / (1 + w.o) = q is s / (1 - w.s), the perspective division itself.
    float s_y = kernel_position.y / p.ellipse.z;
    vec2 s = vec2((kernel_position.x - p.ellipse.y * s_y) / p.ellipse.x, s_y);
    float depth = 1.0 - dot(p.center.zw, s);
    vec2 pixel = p.center.xy * depth + s;
    vec2 size = vec2(float(frame.width), float(frame.height));
    gl_Position = vec4(2.0 * pixel / size - depth, 0.5 * depth, depth);
    position_slack = vec4(p.position.xyz, p.density.w);
    normal = unpack_normal(floatBitsToUint(p.position.w));
    density = p.density.xyz;
}
