/* temporal.h: how pictures behave over time: flicker, differences between frames, steps and what they leave.
 *
 * Pictures are rows of one float per pixel (temporal_luminance makes them from RGB), of one size in any one
 * call, finite. Sums are taken in double in a fixed order, so that a measure of the same pixels is the same
 * number. Long sequences are streamed: struct temporal_pixels holds two numbers a pixel whatever their
 * length. No I/O.
 */
#ifndef CAUSTIC_TEMPORAL_H
#define CAUSTIC_TEMPORAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../status.h"

/* Rec. 709 luminance of `count` interleaved RGB pixels. */
void temporal_luminance(const float *rgb, size_t count, float *luminance);

/* ---- which pixels are caustic -------------------------------------------------------------------------- */

/* A pixel is caustic when it is at least this bright: `share` (0: 0.02) of the 99th percentile of the lit
 * pixels, so that neither a firefly nor the empty part of the picture moves the bar. INFINITY for a black
 * picture: then no pixel is. Allocates; NAN when there is no memory. */
double temporal_caustic_threshold(const float *picture, size_t count, double share);

/* ---- static flicker ------------------------------------------------------------------------------------ */

struct temporal_pixels;

struct temporal_pixels *temporal_pixels_create(uint32_t width, uint32_t height, struct error *error);
void temporal_pixels_add(struct temporal_pixels *pixels, const float *picture);
/* The mean picture so far. */
void temporal_pixels_mean(const struct temporal_pixels *pixels, float *picture);
void temporal_pixels_destroy(struct temporal_pixels **pixels);

struct temporal_flicker_params {
    double caustic_share; /* as in temporal_caustic_threshold, of the mean picture; 0: 0.02 */
    double limit;         /* a pixel flickers when its std/mean is above; 0: 0.005 */
};

struct temporal_flicker {
    uint32_t frames;
    uint32_t caustic_pixels, flickering_pixels;
    uint32_t
        largest_patch; /* pixels of the largest group of flickering pixels that touch, corners included */
    double threshold;  /* least temporal mean of a caustic pixel */
    double mean, p95, p99, largest; /* of std/mean over the caustic pixels; 0 when there is none */
};

/* Std is the sample's (n - 1). `map`: std/mean of every caustic pixel and 0 elsewhere, or NULL. Two frames at
 * least. */
bool temporal_flicker(const struct temporal_pixels *pixels, const struct temporal_flicker_params *params,
                      float *map, struct temporal_flicker *flicker, struct error *error);

/* Pixels of the largest group of non-zero pixels that touch by a side or a corner. */
bool temporal_largest_patch(const uint8_t *mask, uint32_t width, uint32_t height, uint32_t *pixels,
                            struct error *error);

/* ---- differences between frames ------------------------------------------------------------------------ */

struct temporal_difference {
    double rmse;             /* of (now - before) against the reference's own (now - before) */
    double reference_change; /* root mean square of the reference's own */
    double relative;         /* rmse over the root mean square of the reference picture now */
    double relative_change;  /* reference_change over the same */
};

void temporal_difference(const float *before, const float *now, const float *reference_before,
                         const float *reference_now, size_t count, struct temporal_difference *difference);

/* ---- steps --------------------------------------------------------------------------------------------- */

/* The share of a change that is still to be made: sum |picture - settled| / sum |old - settled|. NAN when
 * old and settled are the same. */
double temporal_remaining(const float *picture, const float *old, const float *settled, size_t count);

/* The share of the old picture's light that is still where the settled picture has none: over pixels with
 * old >= threshold and settled < threshold, sum max(picture - settled, 0) / sum (old - settled). NAN when
 * there is no such pixel. */
double temporal_ghost(const float *picture, const float *old, const float *settled, size_t count,
                      double threshold);

#endif
