// gpu_spin.comp: work that takes a while, in proportion to `rounds`.
#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) buffer Target { uint target[]; };
layout(push_constant) uniform Push { uint rounds; };

void main()
{
    uint value = target[gl_GlobalInvocationID.x];
    for (uint i = 0; i < rounds; i++) {
        value = value * 1664525u + 1013904223u;
    }
    target[gl_GlobalInvocationID.x] = value;
}
