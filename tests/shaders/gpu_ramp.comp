// gpu_ramp.comp: target[i] = start + i.
#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) writeonly buffer Target { uint target[]; };
layout(push_constant) uniform Push { uint start; };

void main()
{
    if (gl_GlobalInvocationID.x < target.length()) {
        target[gl_GlobalInvocationID.x] = start + gl_GlobalInvocationID.x;
    }
}
