// gpu_count.comp: counts workgroups and their threads.
#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) buffer Counts { uint groups; uint threads; };

void main()
{
    if (gl_LocalInvocationIndex == 0) {
        atomicAdd(groups, 1);
    }
    atomicAdd(threads, 1);
}
