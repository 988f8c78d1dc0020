/* measure.h: what the benchmarks share: the end on an error, memory that is there, medians of rounds.
 */
#ifndef BENCH_MEASURE_H
#define BENCH_MEASURE_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/status.h"

static inline _Noreturn void measure_die(const struct error *error)
{
    fprintf(stderr, "bench: %s\n", error->message);
    exit(1);
}

/* Zeroed. */
static inline void *measure_allocate(size_t count, size_t size)
{
    void *memory = calloc(count ? count : 1, size);
    if (!memory)
        measure_die(&(struct error){STATUS_MEMORY, "out of memory"});
    return memory;
}

static inline int measure_compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts `values`. */
static inline double measure_median(double *values, uint32_t count)
{
    qsort(values, count, sizeof *values, measure_compare);
    return count % 2 ? values[count / 2] : 0.5 * (values[count / 2 - 1] + values[count / 2]);
}

#endif
