// gpu_rectangles.frag: adds the rectangle's value and counts shader runs.
#version 460
layout(constant_id = 0) const float gain = 1;
layout(set = 0, binding = 4) buffer Counts { uint runs; };
layout(location = 0) flat in vec4 value;
layout(location = 0) out vec4 color;

void main()
{
    atomicAdd(runs, 1);
    color = value * gain;
}
