/* reference.h: converged pictures of directly visible caustics to compare frames with: many jittered frames,
 * every photon in the one pixel that sees it, uniform density. Unbiased; its own noise is known from two
 * halves.
 *
 * With the environment variable CAUSTICD_REFERENCE_CACHE set to a folder, references are kept there between
 * runs of the same program: the program's own bytes, which hold renderer and shaders, are part of their
 * names.
 */
#ifndef TEST_REFERENCE_H
#define TEST_REFERENCE_H

#include "core/measure/image_measure.h"
#include "truth.h"

struct reference {
    uint32_t width, height;
    float *values; /* caustics, 3 components; the mean of both halves */
    double photons;
    /* Relative L1 of the reference against the truth, expected: half of what its halves differ by (the mean
     * has half the deviation of their difference). Raw, and after a 3x3 box filter. */
    double noise, filtered_noise;
};

/* Of `scene` (as stage_open takes it) with at least `photons` emitted. `split`, the setting, is unbiased
 * either way: "roulette" halves the time for a given number of photons (a third on `square`), "energy" has
 * the least noise for a given time. Fails the test that calls it when something goes wrong. */
struct reference reference_make(const char *scene, uint32_t width, uint32_t height, double photons,
                                const char *split);
void reference_free(struct reference *reference);

/* Relative L1 of a caustics channel against the reference; the second one after a 3x3 box filter of both. */
double reference_error(const struct reference *reference, const float *caustics);
double reference_filtered_error(const struct reference *reference, const float *caustics);

#endif
