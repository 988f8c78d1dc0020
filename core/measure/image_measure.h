/* image_measure.h: how far one image is from another, and what it sums to.
 *
 * Images are rows of interleaved floats; two that are compared have the same size and components. Sums are
 * taken in double in a fixed order, so that a measure of the same pixels is the same number. A pixel that is
 * not finite makes the measures of its image not finite: count them first with measure_non_finite.
 */
#ifndef CAUSTIC_IMAGE_MEASURE_H
#define CAUSTIC_IMAGE_MEASURE_H

#include <stddef.h>
#include <stdint.h>

struct measure_image {
    const float *values; /* width * height * components, rows from the top */
    uint32_t width, height, components;
};

/* Values that are NaN or infinite. */
size_t measure_non_finite(const struct measure_image *image);

/* Pixels that hold such a value. */
size_t measure_non_finite_pixels(const struct measure_image *image);

/* sum |image - reference| / sum |reference|; 0 when both are black, +infinity when only the reference is. */
double measure_relative_l1(const struct measure_image *image, const struct measure_image *reference);

/* Root of the mean squared difference over all values. */
double measure_rmse(const struct measure_image *image, const struct measure_image *reference);

/* Root of sum (image - reference)^2 / sum reference^2; black images as in measure_relative_l1. */
double measure_relative_rmse(const struct measure_image *image, const struct measure_image *reference);

/* Mean over all values of (image - reference)^2 / (reference^2 + epsilon): every part of the picture counts
 * by its own brightness, so that dark parts are heard, where measure_relative_rmse weighs all by the
 * brightest. `epsilon` > 0 keeps pixels without light from counting without bound; it has the unit of the
 * squared values.
 */
#define MEASURE_RELMSE_EPSILON 0.01
double measure_relmse(const struct measure_image *image, const struct measure_image *reference,
                      double epsilon);

/* (sum image - sum reference) / sum reference over all values: 0.02 when the image has 2 % too much light. 0
 * for two sums of 0, +-infinity when only the reference's is. */
double measure_flux(const struct measure_image *image, const struct measure_image *reference);

/* Rec. 709 luminance of pixel `index`; of 1 component, that component. */
double measure_luminance(const struct measure_image *image, size_t index);

/* Pixels brighter than `factor` times the local median of the reference: of the 7x7 luminances around the
 * pixel, the border's repeated. Where that median is 0 any light counts, so `floor` (luminance, 0: none) can
 * keep faint rims around a caustic out: a firefly is above it too. `map` receives width * height values, 1 at
 * fireflies, or is NULL. Images of 1 or 3 components. SIZE_MAX when there is no memory. */
#define MEASURE_FIREFLY_FACTOR 4.0
size_t measure_fireflies(const struct measure_image *image, const struct measure_image *reference,
                         double factor, double floor, uint8_t *map);

/* Sum of one component over all pixels, each times its weight: the pixel's area on the surface it sees makes
 * an irradiance image's sum its flux in W. `weights` holds width * height values; NULL: 1. */
double measure_sum(const struct measure_image *image, uint32_t component, const double *weights);

/* Mean over the 3x3 neighbourhood, at the border over the part inside the image. `target` holds as many
 * values as the image and does not overlap it. */
void measure_box3(const struct measure_image *image, float *target);

/* The value with `rank` smaller ones, equal ones counted, among those that are above 0; 0 when there are not
 * as many. Takes time proportional to `count`: no sorting. NAN when there is no memory; values are not NaN.
 */
float measure_rank_above_zero(const float *values, size_t count, size_t rank);

/* The value below which `percent` (0 to 100) of the values lie, interpolated linearly between neighbours.
 * Sorts `values`; none may be NaN. 0 values give 0. */
double measure_percentile(double *values, size_t count, double percent);

#endif
