/* compare.h: the measures of two pictures, mask and all. */
#ifndef DIFF_COMPARE_H
#define DIFF_COMPARE_H

#include <stddef.h>

#include "../../core/image/picture.h"
#include "../../core/measure/flip.h"
#include "../../core/measure/ssim.h"
#include "options.h"

struct comparison {
    const struct options *options;
    struct picture image, reference; /* the same size, finite */
    uint8_t *mask;                   /* a byte per pixel; NULL: all count */
    size_t pixel_count;              /* that count */

    /* What compare_all fills in. */
    double values[METRIC_COUNT];
    struct flip_result flip, hdr_flip;
    struct ssim_result ssim;

    /* With options->heat_map: of the first metric, and the value that is shown brightest. */
    float *map;
    double map_top;
};

/* Every metric of the options. False and *error when one has no answer for these pictures. */
bool compare_all(struct comparison *comparison, struct error *error);

/* What a limit is held against: the magnitude, of SSIM what is missing to 1. */
double compare_badness(const struct comparison *comparison, enum metric metric);

#endif
