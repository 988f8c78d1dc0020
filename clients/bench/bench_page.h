/* bench_page.h: report.html. */
#ifndef CAUSTIC_BENCH_PAGE_H
#define CAUSTIC_BENCH_PAGE_H

#include "compare.h"
#include "bench_reference.h"

struct bench_page_params {
    const struct bench_config *config;
    const struct bench_results *results;
    const char *folder;
    const struct bench_results *before; /* NULL: nothing was compared */
    const struct bench_comparison *comparison;
};

/* Writes FOLDER/report.html. Pictures that are missing are told in the page. */
bool bench_page_write(const struct bench_page_params *params, struct error *error);

/* What waiting for a frame took above what the server spent on it, as a share: the tool's own cost. */
double bench_overhead(const struct bench_results *results);

#endif
