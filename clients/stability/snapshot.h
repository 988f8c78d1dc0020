/* snapshot.h: a frame's measured channel, with its luminance. */
#ifndef CAUSTIC_STABILITY_SNAPSHOT_H
#define CAUSTIC_STABILITY_SNAPSHOT_H

#include <stddef.h>
#include <stdint.h>

#include "../../core/status.h"

struct snapshot {
    uint32_t width, height;
    float *rgb, *luminance; /* NULL: there is none */
};

/* `rgb` (malloc'ed, width * height * 3) becomes the picture's, also when this fails. */
bool snapshot_make(float *rgb, uint32_t width, uint32_t height, struct snapshot *picture,
                   struct error *error);
bool snapshot_copy(const struct snapshot *source, struct snapshot *target, struct error *error);
void snapshot_free(struct snapshot *picture);

size_t snapshot_pixels(const struct snapshot *picture);
bool snapshot_is_black(const struct snapshot *picture);

/* sum |luminance - reference| / sum reference. */
double snapshot_error(const struct snapshot *picture, const struct snapshot *reference);

/* Root mean square of the luminance's difference over that of the reference's luminance. */
double snapshot_rms_difference(const struct snapshot *picture, const struct snapshot *reference);

/* The stops that suit it, 0 for a black one. */
double snapshot_exposure(const struct snapshot *picture);

/* Mean LDR-FLIP of the two as a display shows them at `exposure` (tone_linear). */
bool snapshot_flip(const struct snapshot *picture, const struct snapshot *reference, double exposure,
                   double *flip, struct error *error);

/* 8-bit sRGB at `exposure`; the caller frees. */
uint8_t *snapshot_bytes(const struct snapshot *picture, double exposure, struct error *error);

#endif
