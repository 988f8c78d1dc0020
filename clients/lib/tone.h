/* tone.h: HDR pictures for the eye. */
#ifndef CAUSTIC_TONE_H
#define CAUSTIC_TONE_H

#include <stddef.h>
#include <stdint.h>

/* The stops that bring the median of the lit pixels to a middle grey; 0 for a black picture. RGB. */
double tone_exposure(const float *values, size_t pixel_count);

/* 1 - exp(-2^exposure * value), 0 to 1, linear; NaN and negative values are 0. */
float tone_linear(float value, double exposure);

/* 8-bit sRGB of 1 - exp(-2^exposure * value); NaN and negative values are black. */
uint8_t tone_byte(float value, double exposure);

#endif
