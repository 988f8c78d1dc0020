#include "tone.h"

#include <math.h>
#include <stdlib.h>

#define MIDDLE_GREY 0.22 /* linear; sRGB 128 */

static double shown(float value, double exposure)
{
    return value > 0 ? 1 - exp(-exp2(exposure) * (double)value) : 0;
}

float tone_linear(float value, double exposure)
{
    return (float)shown(value, exposure);
}

uint8_t tone_byte(float value, double exposure)
{
    double linear = shown(value, exposure);
    double encoded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
    return (uint8_t)(encoded * 255 + 0.5);
}

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

double tone_exposure(const float *values, size_t pixel_count)
{
    float *lit = malloc(pixel_count * sizeof *lit);
    size_t count = 0;
    for (size_t i = 0; lit && i < pixel_count; i++) {
        float luminance = 0.2126f * values[i * 3] + 0.7152f * values[i * 3 + 1] + 0.0722f * values[i * 3 + 2];
        if (luminance > 1e-12f && isfinite(luminance))
            lit[count++] = luminance;
    }
    double exposure = 0;
    if (count) {
        qsort(lit, count, sizeof *lit, compare_floats);
        exposure = log2(-log(1 - MIDDLE_GREY) / lit[count / 2]);
    }
    free(lit);
    return exposure;
}
