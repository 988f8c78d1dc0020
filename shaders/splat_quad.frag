#version 460
#extension GL_GOOGLE_include_directive : require
// splat_quad.frag: tests ellipse and G-buffer where the device shades: at a pixel's centre, or at each of its samples.
//
// Reads   targets
// Writes  irradiance, W/m^2, blended additively in the order of the photons; which photons reached a pixel
// Source  aaps-thesis 3.1.3, 4.5.2 (contributing photons), 5.1.1, 5.1.2
#include "frame.glsl"
#include "targets.glsl"
layout(std430, binding = BINDING_PASS + 3) writeonly buffer reached_buffer { uint reached[]; };
layout(location = 0) flat in vec4 position_slack;
layout(location = 1) flat in vec4 normal_u00;
layout(location = 2) flat in vec4 density_u01;
layout(location = 3) flat in vec3 middle_u11;
layout(location = 4) flat in uint index;
layout(location = 0) out vec4 color;

void main()
{
    vec2 o = gl_FragCoord.xy - middle_u11.xy;
    vec2 q = vec2(normal_u00.w * o.x + density_u01.w * o.y, middle_u11.z * o.y);
    if (dot(q, q) >= 1.0)
        discard;
    uint pixel = uint(gl_FragCoord.y) * frame.width + uint(gl_FragCoord.x);
    if (!target_accepts(targets[pixel], position_slack.xyz, normal_u00.xyz, position_slack.w))
        discard;
    reached[index] = 1u;
    color = vec4(density_u01.xyz, 0.0);
}
