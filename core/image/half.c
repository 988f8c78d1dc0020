#include "image_io.h"

#include <string.h>

uint16_t image_half_from_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    uint32_t sign = bits >> 16 & 0x8000u, magnitude = bits & 0x7fffffffu;
    if (magnitude > 0x7f800000u)
        return (uint16_t)(sign | 0x7e00u | (magnitude >> 13 & 0x3ffu));
    if (magnitude >= 0x477ff000u) /* rounds to 65536 or more */
        return (uint16_t)(sign | 0x7c00u);
    uint32_t rest, half, cut;
    if (magnitude < 0x38800000u) { /* below 2^-14: subnormal */
        if (magnitude < 0x33000000u)
            return (uint16_t)sign;
        uint32_t mantissa = (magnitude & 0x7fffffu) | 0x800000u;
        cut = 126u - (magnitude >> 23);
        half = mantissa >> cut;
        rest = mantissa & ((1u << cut) - 1u);
    } else {
        cut = 13;
        half = (magnitude - 0x38000000u) >> cut;
        rest = magnitude & 0x1fffu;
    }
    uint32_t tie = 1u << (cut - 1u);
    half += rest > tie || (rest == tie && (half & 1u)) ? 1u : 0u;
    return (uint16_t)(sign | half);
}

float image_half_to_float(uint16_t half)
{
    uint32_t sign = (uint32_t)(half & 0x8000u) << 16, exponent = half >> 10 & 0x1fu, mantissa = half & 0x3ffu;
    uint32_t bits;
    if (exponent == 31) {
        bits = sign | 0x7f800000u | mantissa << 13;
    } else if (exponent) {
        bits = sign | (exponent + 112u) << 23 | mantissa << 13;
    } else {
        /* 2^-24 steps; exact in float. */
        float value = (float)mantissa * 5.9604644775390625e-8f;
        memcpy(&bits, &value, sizeof bits);
        bits |= sign;
    }
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
