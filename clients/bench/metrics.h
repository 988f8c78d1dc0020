/* metrics.h: the measures a point is judged by, by name: those of core/measure, each with how it is taken
 * here.
 *
 * rell1, relrmse, rmse, relmse and flux compare the linear pictures as they are. flip compares what a display
 * shows: both pictures with the reference's own exposure, which brings the median of its lit pixels to a
 * middle grey, through 1 - exp(-x). hdrflip chooses its exposures itself; ssim spans what the reference does.
 */
#ifndef CAUSTIC_BENCH_METRICS_H
#define CAUSTIC_BENCH_METRICS_H

#include <stdint.h>

#include "../../core/measure/image_measure.h"
#include "../../core/status.h"

enum metric {
    METRIC_RELL1,
    METRIC_RELRMSE,
    METRIC_RMSE,
    METRIC_RELMSE,
    METRIC_FLIP,
    METRIC_HDRFLIP,
    METRIC_SSIM,
    METRIC_FLUX,
    METRIC_COUNT
};

extern const char *const metric_names[METRIC_COUNT];
extern const char *const metric_titles[METRIC_COUNT];

bool metric_find(const char *name, enum metric *metric, struct error *error);

/* Of 3 components each, of one size. Values of metrics that are not wanted are NaN. `exposure`: the
 * reference's, stops (tone_exposure). `flip_map`: a value per pixel of hdrflip, or of flip when that alone is
 * wanted; NULL: not wanted. Fails when a pixel is not finite, with their number. */
bool metrics_compute(const struct measure_image *image, const struct measure_image *reference,
                     double exposure, const bool wanted[METRIC_COUNT], float *flip_map,
                     double values[METRIC_COUNT], struct error *error);

/* A measure as an error, 0 for equal pictures and larger for worse: 1 - ssim, |flux|, the others as they
 * are. */
double metric_error(enum metric metric, double value);

/* Least error that is told apart from 0 when two runs are compared. */
double metric_floor(enum metric metric);

#endif
