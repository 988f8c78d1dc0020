/* measures.h: what caustic-stability measures, described once.
 *
 * The table MEASURES is the only place where a measure is named: report, help and --fail-above come from it.
 * A value is finite, INFINITY for "never within this run", or NAN for "cannot be told" (the period of what
 * does not swing); what a path does not measure is not set at all.
 */
#ifndef CAUSTIC_STABILITY_MEASURES_H
#define CAUSTIC_STABILITY_MEASURES_H

#include <jansson.h>
#include <stdint.h>

#include "../../core/status.h"

/* Where a measure is taken: kinds of path, and whether it takes references. */
#define MEASURED_RESTING     1u
#define MEASURED_MOVING      2u
#define MEASURED_STEPPING    4u
#define MEASURED_ALTERNATING 8u
#define MEASURED_ANYWHERE    15u
#define MEASURED_STANDING    (MEASURED_RESTING | MEASURED_ALTERNATING)  /* the scene stands still */
#define MEASURED_CHANGING    (MEASURED_STEPPING | MEASURED_ALTERNATING) /* one change and its response */
#define MEASURED_SETTLING    (MEASURED_RESTING | MEASURED_STEPPING)     /* a loop comes to rest */
#define MEASURED_BY_PAIRS    (MEASURED_MOVING | MEASURED_STEPPING)      /* against a reference that changes */

/* A number followed as a control loop: C(prefix, what) */
#define CONTROLLED(C)                                                                                        \
    C(photons, "photons emitted")                                                                            \
    C(density, "the density of all cells together")                                                          \
    C(densest, "the density of the densest cell")

#define CONTROL_MEASURES(M, name, what)                                                                      \
    M(name##_settling, "frames", SETTLING, 0, "until " what " stays within 2 % of where it ends")            \
    M(name##_overshoot, "share", SETTLING, 0, "how far " what " went past its end, of the whole change")     \
    M(name##_oscillation, "share", ANYWHERE, 0, "half of the range of " what " once settled, of the mean")   \
    M(name##_period, "frames", ANYWHERE, 0, "of the sinusoid that fits that best")                           \
    M(name##_period_share, "share", ANYWHERE, 0, "of the variance which that sinusoid explains; 0: noise")   \
    M(name##_drift, "share", RESTING, 0, "change of " what " per 1,000 frames, of the mean")                 \
    M(name##_drift_interval, "share", RESTING, 0, "half of the 95 % interval of that drift")

/* M(name, unit, where, references, help): `where` it is measured and for which of these it takes references;
 * a MEASURED_ name or 0. */
#define MEASURES(M)                                                                                          \
    M(caustic_pixels, "px", STANDING, 0, "pixels of at least 2 % of the 99th percentile of the lit ones")    \
    M(flicker_mean, "share", STANDING, 0, "temporal std / mean of a caustic pixel, mean over them")          \
    M(flicker_p95, "share", STANDING, 0, "the same, 95th percentile")                                        \
    M(flicker_p99, "share", STANDING, 0, "the same, 99th percentile")                                        \
    M(flicker_largest, "share", STANDING, 0, "the same, largest")                                            \
    M(flicker_pixels, "px", STANDING, 0, "caustic pixels whose std / mean is above 0.5 %")                   \
    M(flicker_patch, "px", STANDING, 0, "the largest group of them that touch")                              \
    M(difference_rmse, "share", ANYWHERE, BY_PAIRS,                                                          \
      "RMSE of frame differences against the reference's own, of its RMS; over all pairs")                   \
    M(difference_largest, "share", ANYWHERE, BY_PAIRS, "the same, of the worst pair")                        \
    M(reference_change, "share", ANYWHERE, BY_PAIRS, "RMS of the reference's own differences, of its RMS")   \
    M(reference_noise, "share", ANYWHERE, ANYWHERE, "the reference's own noise: less cannot be told apart")  \
    M(reference_error, "share", ANYWHERE, ANYWHERE, "relative L1 of frames against the reference")           \
    M(reference_flip, "FLIP", ANYWHERE, ANYWHERE, "mean FLIP of frames against the reference")               \
    M(flip_mean, "FLIP", STANDING, 0, "mean FLIP between one frame and the next")                            \
    M(flip_largest, "FLIP", STANDING, 0, "the same, largest")                                                \
    M(frames_to_90, "frames", CHANGING, 0, "after a change, until 90 % of it are made; 1: at once")          \
    M(frames_to_95, "frames", CHANGING, 0, "until 95 %")                                                     \
    M(frames_to_99, "frames", CHANGING, 0, "until 99 %")                                                     \
    M(step_flip_1, "FLIP", STEPPING, 0, "of the first frame after the change against the settled picture")   \
    M(step_flip_3, "FLIP", STEPPING, 0, "of the third")                                                      \
    M(ghost_1, "share", STEPPING, 0, "of the old light that is still where none should be, frame 1")         \
    M(ghost_3, "share", STEPPING, 0, "the same, frame 3")                                                    \
    M(ghost_end, "share", STEPPING, 0, "the same, last frame")                                               \
    M(step_error_3, "ratio", STEPPING, STEPPING, "error of frame 3 over that of the settled frames")         \
    M(frames_to_error, "frames", STEPPING, STEPPING, "until the error is within 15 % of the settled one")    \
    M(return_difference, "share", ALTERNATING, 0, "relative L1 of the picture after there and back")         \
    CONTROLLED(CONTROLLED_##M)                                                                               \
    M(light_drift, "share", RESTING, 0, "change of the picture's light per 1,000 frames, of the mean")       \
    M(light_drift_interval, "share", RESTING, 0, "half of the 95 % interval of that drift")                  \
    M(picture_drift, "share", RESTING, 0, "relative L1 between the first picture measured and the last")

#define CONTROLLED_MEASURE_ID(name, what)               CONTROL_MEASURES(MEASURE_ID, name, what)
#define CONTROLLED_MEASURE_INFO(name, what)             CONTROL_MEASURES(MEASURE_INFO, name, what)
#define MEASURE_ID(name, unit, where, references, help) MEASURE_##name,

enum measure_id { MEASURES(MEASURE_ID) MEASURE_COUNT };

struct measure_info {
    const char *name, *unit, *help;
    uint32_t where, references; /* MEASURED_ bits */
};
extern const struct measure_info measure_infos[MEASURE_COUNT];

struct measures {
    bool is_set[MEASURE_COUNT];
    double values[MEASURE_COUNT];
};

void measures_set(struct measures *measures, enum measure_id id, double value);

/* An object by name, in the table's order; null for NAN, "never" for INFINITY. */
json_t *measures_json(const struct measures *measures);

/* ---- thresholds ---------------------------------------------------------------------------------------- */

#define GATE_MAX 64u

/* Fails when a measure's absolute value is above `limit`; "never" is above everything. */
struct gate {
    char path[32]; /* empty: every path that measures it */
    enum measure_id measure;
    double limit;
};

/* Reads "flicker_p99=0.005" or "still.flicker_p99=0.005". */
bool gate_parse(const char *text, struct gate *gate, struct error *error);

/* Whether a gate can say anything: `kinds` has the MEASURED_ bits of the paths it is about. The error says
 * why not. */
bool gate_check(const struct gate *gate, uint32_t kinds, bool has_references, struct error *error);

/* What came of a gate over the paths of a report: an array of {gate, path, value, limit, passed}. Empty when
 * no path measured it. */
json_t *gate_results(const struct gate *gate, json_t *paths);

/* A value of a report as people read it. */
void measure_print(json_t *value, char *text, size_t size);

#endif
