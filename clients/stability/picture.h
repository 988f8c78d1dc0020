/* picture.h: a frame's measured channel, with its luminance. */
#ifndef CAUSTIC_STABILITY_PICTURE_H
#define CAUSTIC_STABILITY_PICTURE_H

#include <stddef.h>
#include <stdint.h>

#include "../../core/status.h"

struct picture {
    uint32_t width, height;
    float *rgb, *luminance; /* NULL: there is none */
};

/* `rgb` (malloc'ed, width * height * 3) becomes the picture's, also when this fails. */
bool picture_make(float *rgb, uint32_t width, uint32_t height, struct picture *picture, struct error *error);
bool picture_copy(const struct picture *source, struct picture *target, struct error *error);
void picture_free(struct picture *picture);

size_t picture_pixels(const struct picture *picture);
bool picture_is_black(const struct picture *picture);

/* sum |luminance - reference| / sum reference. */
double picture_error(const struct picture *picture, const struct picture *reference);

/* Root mean square of the luminance's difference over that of the reference's luminance. */
double picture_rms_difference(const struct picture *picture, const struct picture *reference);

/* The stops that suit it, 0 for a black one. */
double picture_exposure(const struct picture *picture);

/* Mean LDR-FLIP of the two as a display shows them at `exposure` (tone_linear). */
bool picture_flip(const struct picture *picture, const struct picture *reference, double exposure,
                  double *flip, struct error *error);

/* 8-bit sRGB at `exposure`; the caller frees. */
uint8_t *picture_bytes(const struct picture *picture, double exposure, struct error *error);

#endif
