/* analyse.h: from what a path left behind to its measures, series and pictures. */
#ifndef CAUSTIC_STABILITY_ANALYSE_H
#define CAUSTIC_STABILITY_ANALYSE_H

#include "drive.h"
#include "measures.h"

#define ANALYSIS_MAX_SERIES 16u

/* One value per frame. */
struct analysis_series {
    const char *name, *unit, *help;
    int64_t first; /* the first value's frame; below 0: warm-up */
    uint32_t count;
    double *values;
};

struct analysis {
    struct measures measures;
    struct analysis_series series[ANALYSIS_MAX_SERIES];
    uint32_t series_count;
    float *flicker_map;      /* std / mean per pixel, or NULL */
    struct snapshot settled; /* steps: where they end */
};

/* Of a path that was driven to its end. */
bool analysis_make(const struct drive *drive, struct analysis *analysis, struct error *error);

/* Of one that was cut short: its series alone. */
bool analysis_make_partial(const struct drive *drive, struct analysis *analysis, struct error *error);

void analysis_free(struct analysis *analysis);

#endif
