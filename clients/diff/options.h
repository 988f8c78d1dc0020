/* options.h: the command line of caustic-diff. */
#ifndef DIFF_OPTIONS_H
#define DIFF_OPTIONS_H

#include <stdint.h>

#include "../../core/status.h"

enum metric {
    METRIC_RMSE,
    METRIC_RELRMSE,
    METRIC_RELMSE,
    METRIC_RELL1,
    METRIC_FLUX,
    METRIC_SSIM,
    METRIC_FLIP,
    METRIC_HDRFLIP,
    METRIC_FIREFLIES,
    METRIC_COUNT
};

extern const char *const metric_names[METRIC_COUNT];

struct options {
    bool is_help;
    const char *image, *reference;
    const char *mask, *layer, *heat_map; /* NULL: none */
    bool is_json, is_integer_linear, has_crop;
    uint32_t crop[4]; /* x, y, width, height */

    enum metric metrics[METRIC_COUNT]; /* in the order asked for; metric_count 0: main.c chooses */
    uint32_t metric_count;
    double limits[METRIC_COUNT]; /* of --fail-above METRIC=VALUE; INFINITY: none */
    double limit;                /* of --fail-above VALUE */

    double pixels_per_degree; /* 0: FLIP's default */
    double ssim_range;        /* 0: chosen by the images */
    double epsilon, firefly_floor;
};

extern const char diff_help[];

/* Points into argv. False and *error for what makes no sense. */
bool options_parse(int argc, char **argv, struct options *options, struct error *error);

/* Adds it unless it is there. */
void options_add_metric(struct options *options, enum metric metric);

#endif
