// gpu_rectangles.vert: one rectangle per instance, in pixels, from a storage buffer.
#version 460
struct rectangle {
    vec4 corners; // x0, y0, x1, y1
    vec4 value;
};
layout(set = 0, binding = 2) readonly buffer Rectangles { rectangle rectangles[]; };
layout(push_constant) uniform Push { vec2 size; };
layout(location = 0) flat out vec4 value;

void main()
{
    const vec2 unit[6] = vec2[](vec2(0, 0), vec2(1, 0), vec2(0, 1), vec2(0, 1), vec2(1, 0), vec2(1, 1));
    rectangle r = rectangles[gl_InstanceIndex];
    vec2 pixel = mix(r.corners.xy, r.corners.zw, unit[gl_VertexIndex]);
    gl_Position = vec4(pixel / size * 2.0 - 1.0, 0.5, 1);
    value = r.value;
}
