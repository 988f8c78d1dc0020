/* ssim.h: structural similarity, whether the same shapes are there in the same places.
 *
 * Source  Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity", 2004:
 *         Gaussian window of 11x11 with sigma 1.5, K1 = 0.01, K2 = 0.03
 *
 * 1 is the same picture; 0 and below, nothing in common. Works on one value per pixel: an image of 3
 * components is taken by its Rec. 709 luminance, in whatever encoding it comes.
 */
#ifndef CAUSTIC_SSIM_H
#define CAUSTIC_SSIM_H

#include <stdbool.h>

#include "../status.h"
#include "image_measure.h"

#define SSIM_WINDOW 11u

struct ssim_params {
    double dynamic_range; /* L of the paper: 1 for display values in 0..1. 0: the luminance that 99 % of the
                             reference's lit pixels stay below, 1 if none is lit: a few pixels at a cusp would
                             make differences everywhere else look like nothing */
    const uint8_t *mask;  /* width * height: the pixels whose mean counts are not 0; NULL: all */
};

struct ssim_result {
    double mean;          /* over the pixels of the mask whose window lies inside the image */
    double dynamic_range; /* the one used */
};

/* `map` receives width * height values, or is NULL; the outer 5 rows and columns, where no window fits, are
 * 1. Fails when the sizes differ, when a side is below SSIM_WINDOW, when a pixel is not finite, when the mask
 * leaves no pixel or for lack of memory. */
bool ssim_compare(const struct measure_image *image, const struct measure_image *reference,
                  const struct ssim_params *params, float *map, struct ssim_result *result,
                  struct error *error);

#endif
