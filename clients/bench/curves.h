/* curves.h: results as plots: which points make a curve, and what it is called. */
#ifndef CAUSTIC_BENCH_CURVES_H
#define CAUSTIC_BENCH_CURVES_H

#include "../report/plot.h"
#include "results.h"

/* What is drawn. Scene and method empty: all of them. */
struct curves_params {
    const struct bench_config *config;
    const struct bench_results *results;
    const char *scene, *method, *x, *y; /* x, y: bench_quantity */
};

/* A plot's series with the memory behind them; empty when no point has both numbers. */
struct curves {
    struct plot_series *series;
    uint32_t count;
    void *memory;
};

bool curves_make(const struct curves_params *params, struct curves *curves, struct error *error);
void curves_free(struct curves *curves);

/* The axis that runs along curves; "" when no setting has several numbers. */
const char *curve_axis(const struct bench_config *config);

/* "papers aa=none": the method and the settings that vary, without the one named `without` (NULL: none). */
void point_name(const struct bench_config *config, const struct bench_result *result, const char *without,
                char *text, size_t size);

/* The configuration's plot or bars into FOLDER/plots/FILE. */
bool curves_write_plot(const struct bench_config *config, const struct bench_results *results,
                       const struct bench_plot *plot, const char *folder, struct error *error);

#endif
