// gpu_arguments.comp: an indirect dispatch, and an indirect draw, sized by the first element of a list.
#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1) writeonly buffer Arguments { uint arguments[]; };

void main()
{
    arguments[0] = 0xffffffffu; // before the offset: never read
    arguments[1] = source[0];
    arguments[2] = 1;
    arguments[3] = 1;
    arguments[4] = 6;
    arguments[5] = source[0];
    arguments[6] = 0;
    arguments[7] = 0;
}
