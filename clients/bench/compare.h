/* compare.h: what got better or worse since an earlier run.
 *
 * Points of the two runs belong together when scene, picture size, time and every setting are the same; a
 * method's name does not matter. A measure is compared as an error (metrics.h): 5 % worse is a 1.05 times
 * larger error, of at least metric_floor.
 */
#ifndef CAUSTIC_BENCH_COMPARE_H
#define CAUSTIC_BENCH_COMPARE_H

#include <stdio.h>

#include "results.h"

struct bench_change {
    uint32_t before, after;      /* places in the two results */
    double gpu;                  /* time after / before */
    double errors[METRIC_COUNT]; /* likewise; NaN: not in both */
    bool is_worse, is_better;    /* past a threshold in anything; a point can be both */
    bool is_error_worse[METRIC_COUNT], is_gpu_worse;
    bool has_other_reference;
};

struct bench_comparison {
    struct bench_change *changes;
    uint32_t count, worse, better;
    uint32_t only_before, only_after; /* points without a partner */
};

struct bench_thresholds {
    double error; /* a share: 0.05 */
    double time;  /* likewise; infinity: time is not judged */
};

/* False without memory. Free changes with free(). */
bool bench_compare(const struct bench_results *before, const struct bench_results *after,
                   const struct bench_thresholds *thresholds, struct bench_comparison *comparison,
                   struct error *error);

/* One line per point that changed, and a sum. */
void bench_comparison_print(const struct bench_comparison *comparison, const struct bench_results *before,
                            const struct bench_results *after, FILE *stream);

#endif
