#version 460
#extension GL_GOOGLE_include_directive : require
// splat_quad.frag: the kernel of splat.comp with its G-buffer test, for additive blending.
//
// Reads   targets
// Writes  irradiance, W/m^2, and the number of photons in alpha
// Source  design 6, 7; aaps-thesis 3.1.3
#include "frame.glsl"
#include "targets.glsl"
layout(location = 0) in vec2 kernel_position;
layout(location = 1) flat in vec4 position_slack;
layout(location = 2) flat in vec3 normal;
layout(location = 3) flat in vec3 density;
layout(location = 0) out vec4 color;

void main()
{
    float r2 = dot(kernel_position, kernel_position);
    if (r2 >= 1.0)
        discard;
    uint pixel = uint(gl_FragCoord.y) * frame.width + uint(gl_FragCoord.x);
    if (!target_accepts(targets[pixel], position_slack.xyz, normal, position_slack.w))
        discard;
    color = vec4(density * (1.0 - r2), 1.0);
}
