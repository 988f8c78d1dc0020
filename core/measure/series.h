/* series.h: how a number behaves over time: one value per frame.
 *
 * For control loops (how it settles, overshoots, oscillates, drifts) and for responses (how long until the
 * rest of a change is small). Series are finite values, oldest first; time is counted in frames from the
 * first value, which is frame 0. What never happens within the series is INFINITY, what cannot be told from
 * it is NAN. No I/O, no state, no allocation except where a function says so.
 */
#ifndef CAUSTIC_SERIES_H
#define CAUSTIC_SERIES_H

#include <stdbool.h>
#include <stdint.h>

#include "../status.h"

/* Fewer values say nothing: such a series is refused with STATUS_INVALID. */
#define SERIES_MIN_SETTLING    8u
#define SERIES_MIN_OSCILLATION 16u
#define SERIES_MIN_DRIFT       32u

/* First frame from which every later value is at most `limit`; INFINITY when the last one is above it. */
double series_frames_to(const double *values, uint32_t count, double limit);

/* How it comes to rest. The end is the mean of the last quarter. */
struct series_settling {
    double initial, end;
    double frames;    /* until it stays within `band` of the end, as a share of the end; INFINITY: never */
    double overshoot; /* largest excursion past the end, in the direction of the change, as a share of that
                         change; 0 when it never passes the end. NAN when the change is within the band */
};

/* `band` 0: 0.02. An end of 0 takes the band as absolute. */
bool series_settling(const double *values, uint32_t count, double band, struct series_settling *settling,
                     struct error *error);

/* How it swings about the straight line through it. */
struct series_oscillation {
    double mean;
    double swing;     /* half of the way from the lowest to the highest, of any shape, as a share of |mean| */
    double amplitude; /* of the sinusoid that fits best, as a share of |mean| */
    double period;    /* of that sinusoid, frames, 2 to half the series; NAN when nothing swings */
    double share;     /* of the variance that this sinusoid explains, 0 to 1: near 1 it is a regular swing,
                         near 0 it is noise and the period means nothing */
};

/* Searches every period by least squares, at four times the resolution of the series' length and then by
 * golden section: O(count^2). A mean of 0 leaves swing and amplitude absolute. */
bool series_oscillation(const double *values, uint32_t count, struct series_oscillation *oscillation,
                        struct error *error);

/* Where it is going. */
struct series_drift {
    double mean;
    double slope;        /* per frame, of the least-squares line */
    double confidence;   /* half of the 95 % interval of the slope: it lies within slope -+ confidence. Takes
                            into account that neighbours in time resemble each other (AR(1)) */
    bool is_significant; /* 0 is outside the interval, and the slope is more than rounding */
};

bool series_drift(const double *values, uint32_t count, struct series_drift *drift, struct error *error);

#endif
