// gpu_constants.comp: writes its specialisation constants.
#version 460
layout(local_size_x = 1) in;
layout(constant_id = 0) const uint number = 7;
layout(constant_id = 1) const float fraction = 0.5;
layout(constant_id = 4) const bool flag = false;
layout(constant_id = 9) const int untouched = -3;
layout(set = 0, binding = 0) writeonly buffer Target { uint target[4]; };

void main()
{
    target[0] = number;
    target[1] = floatBitsToUint(fraction);
    target[2] = flag ? 1 : 0;
    target[3] = uint(untouched);
}
