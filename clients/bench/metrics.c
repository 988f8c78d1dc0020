#include "metrics.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/measure/flip.h"
#include "../../core/measure/ssim.h"

const char *const metric_names[METRIC_COUNT] = {"rell1", "relrmse", "rmse", "relmse",
                                                "flip",  "hdrflip", "ssim", "flux"};
const char *const metric_titles[METRIC_COUNT] = {"relative L1", "relative RMSE", "RMSE",     "relMSE",
                                                 "FLIP",        "HDR-FLIP",      "1 - SSIM", "flux error"};

bool metric_find(const char *name, enum metric *metric, struct error *error)
{
    char list[128] = "";
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        if (strcmp(name, metric_names[i]) == 0) {
            *metric = (enum metric)i;
            return true;
        }
        size_t used = strlen(list);
        snprintf(list + used, sizeof list - used, "%s%s", i ? ", " : "", metric_names[i]);
    }
    return error_set(error, STATUS_NOT_FOUND, "there is no metric \"%.60s\"; there are %s", name, list);
}

static bool compute_flip(const struct measure_image *image, const struct measure_image *reference,
                         double exposure, float *map, double *value, struct error *error)
{
    size_t count = (size_t)image->width * image->height * image->components;
    float *shown = malloc(2 * count * sizeof *shown);
    if (!shown)
        return error_set(error, STATUS_MEMORY, "no memory for FLIP of %ux%u pixels", image->width,
                         image->height);
    double scale = exp2(exposure);
    for (size_t i = 0; i < count; i++) {
        shown[i] = (float)(1 - exp(-scale * fmax((double)image->values[i], 0)));
        shown[count + i] = (float)(1 - exp(-scale * fmax((double)reference->values[i], 0)));
    }
    struct measure_image a = *image, b = *reference;
    a.values = shown;
    b.values = shown + count;
    struct flip_result result = {0};
    bool is_done = flip_compare(&a, &b, &(struct flip_params){0}, map, &result, error);
    *value = result.mean;
    free(shown);
    return is_done;
}

bool metrics_compute(const struct measure_image *image, const struct measure_image *reference,
                     double exposure, const bool wanted[METRIC_COUNT], float *flip_map,
                     double values[METRIC_COUNT], struct error *error)
{
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        values[i] = NAN;
    size_t broken = measure_non_finite_pixels(image);
    if (broken)
        return error_set(error, STATUS_INVALID, "%zu pixels of the frame are not finite", broken);
    if (wanted[METRIC_RELL1])
        values[METRIC_RELL1] = measure_relative_l1(image, reference);
    if (wanted[METRIC_RELRMSE])
        values[METRIC_RELRMSE] = measure_relative_rmse(image, reference);
    if (wanted[METRIC_RMSE])
        values[METRIC_RMSE] = measure_rmse(image, reference);
    if (wanted[METRIC_RELMSE])
        values[METRIC_RELMSE] = measure_relmse(image, reference, MEASURE_RELMSE_EPSILON);
    if (wanted[METRIC_FLUX])
        values[METRIC_FLUX] = measure_flux(image, reference);
    if (wanted[METRIC_FLIP] &&
        !compute_flip(image, reference, exposure, wanted[METRIC_HDRFLIP] ? NULL : flip_map,
                      &values[METRIC_FLIP], error))
        return false;
    if (wanted[METRIC_HDRFLIP]) {
        struct flip_result result = {0};
        if (!flip_compare(image, reference, &(struct flip_params){.is_hdr = true}, flip_map, &result, error))
            return false;
        values[METRIC_HDRFLIP] = result.mean;
    }
    if (wanted[METRIC_SSIM]) {
        struct ssim_result result = {0};
        if (!ssim_compare(image, reference, &(struct ssim_params){0}, NULL, &result, error))
            return false;
        values[METRIC_SSIM] = result.mean;
    }
    return true;
}

double metric_error(enum metric metric, double value)
{
    return metric == METRIC_SSIM ? 1 - value : metric == METRIC_FLUX ? fabs(value) : value;
}

double metric_floor(enum metric metric)
{
    return metric == METRIC_RMSE ? 0 : 5e-4;
}
