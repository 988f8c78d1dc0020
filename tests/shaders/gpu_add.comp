// gpu_add.comp: target[i] += source[n - 1 - i], so that no thread can rely on the thread that wrote its own element.
#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 3) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 5) buffer Target { uint target[]; };

void main()
{
    uint i = gl_GlobalInvocationID.x;
    if (i < target.length()) {
        target[i] += source[target.length() - 1 - i];
    }
}
