/* flip.h: FLIP, how different two pictures look to someone who switches between them.
 *
 * Source  Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020 (LDR-FLIP), and
 *         "Visualizing Errors in Rendered High Dynamic Range Images", 2021 (HDR-FLIP)
 *
 * Both pictures are blurred as the eye blurs them at the given distance, compared in a perceptually uniform
 * colour space, and a difference counts for more where edges or points appear or vanish. Every pixel's value
 * is 0 (not to be told apart) to 1; black against white is 0.97.
 *
 * Images are linear Rec. 709 of 3 components, or of 1, which stands for grey. Sums are taken in double in a
 * fixed order. Borders repeat the outermost pixel.
 */
#ifndef CAUSTIC_FLIP_H
#define CAUSTIC_FLIP_H

#include <stdbool.h>

#include "../status.h"
#include "image_measure.h"

/* Exposures from `start` to `stop`, in stops, evenly spaced. */
struct flip_exposures {
    double start, stop;
    uint32_t count; /* at least 2 */
};

struct flip_params {
    double
        pixels_per_degree; /* 5 to 500; 0: 67.02, seen from 0.7 m on a display 0.7 m and 3840 pixels wide */
    bool is_hdr; /* false: values are clamped to 0..1, the light of a display whose white is 1. true: both
                    pictures are tone-mapped (ACES) at several exposures, and a pixel's value is its largest;
                    negative values are taken as 0 */
    struct flip_exposures exposures; /* HDR; count 0: flip_exposures_of the reference */
    const uint8_t *mask;             /* width * height: the pixels whose mean counts are not 0; NULL: all */
};

struct flip_result {
    double mean;                     /* over the pixels of the mask */
    double largest;                  /* likewise */
    struct flip_exposures exposures; /* HDR: those used */
};

/* From the exposure at which the brightest pixel comes out at 85 % of white to the one at which the median
 * pixel does, about a stop apart: the HDR paper's rule. Where it has no answer, ours: the median is that of
 * the pixels with light when at least half have none, and a black reference is seen at exposure 0. Allocates;
 * fails for lack of memory. */
bool flip_exposures_of(const struct measure_image *reference, struct flip_exposures *exposures,
                       struct error *error);

/* `map` receives width * height values, or is NULL. Fails when the sizes differ or are 0, when a pixel is not
 * finite, when a parameter is out of its range, when the mask leaves no pixel or for lack of memory. */
bool flip_compare(const struct measure_image *image, const struct measure_image *reference,
                  const struct flip_params *params, float *map, struct flip_result *result,
                  struct error *error);

#endif
