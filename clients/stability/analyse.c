#include "analyse.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/measure/series.h"

#define CONTROL(part)                                                                                        \
    {                                                                                                        \
        MEASURE_photons_##part, MEASURE_density_##part, MEASURE_densest_##part                               \
    }

/* ---- series -------------------------------------------------------------------------------------------- */

static double *add_series(struct analysis *analysis, const char *name, const char *unit, const char *help,
                          int64_t first, uint32_t count, struct error *error)
{
    double *values = calloc(count ? count : 1, sizeof *values);
    if (!values) {
        error_set(error, STATUS_MEMORY, "no memory for a series of %u frames", count);
        return NULL;
    }
    analysis->series[analysis->series_count++] =
        (struct analysis_series){name, unit, help, first, count, values};
    return values;
}

static bool copy_series(struct analysis *analysis, const char *name, const char *unit, const char *help,
                        const struct drive *drive, const double *values, struct error *error)
{
    double *copy = add_series(analysis, name, unit, help, -(int64_t)drive->warmup, drive->done, error);
    if (copy)
        memcpy(copy, values, drive->done * sizeof *copy);
    return copy != NULL;
}

bool analysis_make_partial(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    *analysis = (struct analysis){0};
    return copy_series(analysis, "photons", "count", "photons emitted", drive,
                       drive->series[STATISTIC_PHOTONS], error) &&
           copy_series(analysis, "density", "count", "density of all cells together", drive,
                       drive->series[STATISTIC_DENSITY], error) &&
           copy_series(analysis, "densest", "count", "density of the densest cell", drive,
                       drive->series[STATISTIC_DENSEST], error) &&
           copy_series(analysis, "light", "W/(m^2 sr)", "mean luminance of the picture", drive, drive->light,
                       error) &&
           copy_series(analysis, "successive", "share", "RMS of the difference from the frame before", drive,
                       drive->successive, error);
}

/* ---- the task buffers as a control loop ---------------------------------------------------------------- */

static void measure_drift(const double *values, uint32_t count, enum measure_id id, enum measure_id interval,
                          struct measures *measures)
{
    struct series_drift drift;
    struct error ignored; /* too short: it is not measured */
    if (!series_drift(values, count, &drift, &ignored) || drift.mean == 0)
        return;
    measures_set(measures, id, 1000 * drift.slope / fabs(drift.mean));
    measures_set(measures, interval, 1000 * drift.confidence / fabs(drift.mean));
}

static void measure_loop(const struct drive *drive, enum statistic which, struct measures *measures)
{
    static const enum measure_id settling_ids[] = CONTROL(settling), overshoot_ids[] = CONTROL(overshoot),
                                 oscillation_ids[] = CONTROL(oscillation), period_ids[] = CONTROL(period),
                                 share_ids[] = CONTROL(period_share), drift_ids[] = CONTROL(drift),
                                 interval_ids[] = CONTROL(drift_interval);
    enum path_kind kind = path_infos[drive->path].kind;
    struct error ignored; /* too short: it is not measured */
    uint32_t from = drive->warmup, all = drive->warmup + drive->frames;
    const double *values = drive->series[which];
    if (kind == PATH_RESTS || kind == PATH_STEPS) {
        /* From the last value before the step, or from the cold start: the first density is only what the
         * loop was seeded with. */
        uint32_t begin = kind == PATH_STEPS ? from - 1 : which == STATISTIC_PHOTONS ? 0 : 1;
        struct series_settling settling;
        if (series_settling(values + begin, all - begin, drive->options->settle_band, &settling, &ignored)) {
            measures_set(measures, settling_ids[which],
                         kind == PATH_STEPS ? settling.frames : settling.frames + begin);
            measures_set(measures, overshoot_ids[which], settling.overshoot);
            uint32_t settled =
                isinf(settling.frames) ? all - (all - begin) / 2 : begin + (uint32_t)settling.frames;
            from = settled > from ? settled : from;
        }
    }
    struct series_oscillation oscillation;
    if (series_oscillation(values + from, all - from, &oscillation, &ignored)) {
        measures_set(measures, oscillation_ids[which], oscillation.swing);
        measures_set(measures, period_ids[which], oscillation.period);
        measures_set(measures, share_ids[which], oscillation.share);
    }
    if (kind == PATH_RESTS)
        measure_drift(values + from, all - from, drift_ids[which], interval_ids[which], measures);
}

/* ---- what flickers ------------------------------------------------------------------------------------- */

static bool measure_flicker(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    struct measures *measures = &analysis->measures;
    struct temporal_flicker flicker;
    size_t count = (size_t)drive->width * drive->height;
    if (!(analysis->flicker_map = malloc(count * sizeof(float))))
        return error_set(error, STATUS_MEMORY, "no memory for a map of %zu pixels", count);
    if (!temporal_flicker(
            drive->pixels,
            &(struct temporal_flicker_params){drive->options->caustic_share, drive->options->flicker_limit},
            analysis->flicker_map, &flicker, error))
        return false;
    measures_set(measures, MEASURE_caustic_pixels, flicker.caustic_pixels);
    measures_set(measures, MEASURE_flicker_mean, flicker.mean);
    measures_set(measures, MEASURE_flicker_p95, flicker.p95);
    measures_set(measures, MEASURE_flicker_p99, flicker.p99);
    measures_set(measures, MEASURE_flicker_largest, flicker.largest);
    measures_set(measures, MEASURE_flicker_pixels, flicker.flickering_pixels);
    measures_set(measures, MEASURE_flicker_patch, flicker.largest_patch);
    return true;
}

/* Mean and largest of what is a number among the measured frames. */
static void measure_mean(const struct drive *drive, const double *values, enum measure_id mean,
                         enum measure_id largest, struct measures *measures)
{
    double sum = 0, most = 0;
    uint32_t count = 0;
    for (uint32_t i = drive->warmup; i < drive->warmup + drive->frames; i++) {
        if (isnan(values[i]))
            continue;
        sum += values[i];
        most = fmax(most, values[i]);
        count++;
    }
    if (!count)
        return;
    measures_set(measures, mean, sum / count);
    measures_set(measures, largest, most);
}

/* Nothing should change: the reference's own differences are 0, and every difference is an error. */
static void measure_restlessness(const struct drive *drive, struct measures *measures)
{
    double squares = 0, largest = 0;
    for (uint32_t i = drive->warmup; i < drive->warmup + drive->frames; i++) {
        double change = isnan(drive->successive[i]) ? 0 : drive->successive[i];
        squares += change * change;
        largest = fmax(largest, change);
    }
    measures_set(measures, MEASURE_difference_rmse, sqrt(squares / drive->frames));
    measures_set(measures, MEASURE_difference_largest, largest);
    measures_set(measures, MEASURE_reference_change, 0);
}

/* ---- references
 * -------------------------------------------------------------------------------------------- */

static void measure_noise(const struct snapshot *reference, const struct snapshot *other,
                          struct measures *measures)
{
    if (reference->rgb && other->rgb)
        measures_set(measures, MEASURE_reference_noise, snapshot_rms_difference(other, reference) / sqrt(2));
}

static bool measure_against(const struct drive *drive, const struct snapshot *picture,
                            const struct snapshot *reference, struct measures *measures, struct error *error)
{
    double flip;
    if (!reference->rgb || snapshot_is_black(reference))
        return true;
    if (!snapshot_flip(picture, reference, drive->exposure, &flip, error))
        return false;
    measures_set(measures, MEASURE_reference_error, snapshot_error(picture, reference));
    measures_set(measures, MEASURE_reference_flip, flip);
    return true;
}

static bool measure_pairs(const struct drive *drive, struct measures *measures, struct error *error)
{
    double squares = 0, changes = 0, largest = 0, errors = 0, flips = 0;
    uint32_t seen = 0;
    for (uint32_t i = 0; i < drive->pair_count; i++) {
        const struct drive_pair *pair = &drive->pairs[i];
        struct temporal_difference difference;
        size_t count = snapshot_pixels(&pair->now);
        temporal_difference(pair->before.luminance, pair->now.luminance, pair->reference_before.luminance,
                            pair->reference_now.luminance, count, &difference);
        double flip;
        if (snapshot_is_black(&pair->reference_now))
            continue; /* the caustic is out of the picture */
        if (!snapshot_flip(&pair->now, &pair->reference_now, drive->exposure, &flip, error))
            return false;
        squares += difference.relative * difference.relative;
        changes += difference.relative_change * difference.relative_change;
        largest = fmax(largest, difference.relative);
        errors += snapshot_error(&pair->now, &pair->reference_now);
        flips += flip;
        seen++;
    }
    if (!seen)
        return true;
    measures_set(measures, MEASURE_difference_rmse, sqrt(squares / seen));
    measures_set(measures, MEASURE_difference_largest, largest);
    measures_set(measures, MEASURE_reference_change, sqrt(changes / seen));
    if (path_infos[drive->path].kind == PATH_MOVES) {
        measures_set(measures, MEASURE_reference_error, errors / seen);
        measures_set(measures, MEASURE_reference_flip, flips / seen);
    }
    return true;
}

/* ---- steps
 * -------------------------------------------------------------------------------------------------- */

/* The mean of `count` pictures. */
static bool mean_picture(const struct snapshot *pictures, uint32_t count, struct snapshot *mean,
                         struct error *error)
{
    size_t values = snapshot_pixels(pictures) * 3;
    float *rgb = malloc(values * sizeof *rgb);
    if (!rgb)
        return error_set(error, STATUS_MEMORY, "no memory for a picture of %zu values", values);
    for (size_t i = 0; i < values; i++) {
        double sum = 0;
        for (uint32_t k = 0; k < count; k++)
            sum += (double)pictures[k].rgb[i];
        rgb[i] = (float)(sum / count);
    }
    return snapshot_make(rgb, pictures->width, pictures->height, mean, error);
}

static void measure_response(const double *remaining, uint32_t count, double worst[3])
{
    static const double limits[3] = {0.1, 0.05, 0.01};
    for (int i = 0; i < 3; i++)
        worst[i] = fmax(worst[i], series_frames_to(remaining, count, limits[i]));
}

static void set_response(const double worst[3], struct measures *measures)
{
    measures_set(measures, MEASURE_frames_to_90, worst[0]);
    measures_set(measures, MEASURE_frames_to_95, worst[1]);
    measures_set(measures, MEASURE_frames_to_99, worst[2]);
}

/* How far the frames are from a reference of where they should end. */
static bool measure_step_error(const struct drive *drive, uint32_t tail, struct analysis *analysis,
                               struct error *error)
{
    if (drive->pair_count == 0 || snapshot_is_black(&drive->pairs[0].reference_now))
        return true;
    uint32_t count = drive->frames + 1;
    double *errors =
        add_series(analysis, "error", "share", "relative L1 against the reference", 0, count, error);
    if (!errors)
        return false;
    for (uint32_t k = 0; k < count; k++)
        errors[k] = snapshot_error(&drive->kept[k], &drive->pairs[0].reference_now);
    double settled = 0;
    for (uint32_t k = count - tail; k < count; k++)
        settled += errors[k] / tail;
    measures_set(&analysis->measures, MEASURE_step_error_3, errors[3] / settled);
    measures_set(&analysis->measures, MEASURE_frames_to_error,
                 series_frames_to(errors, count, 1.15 * settled));
    return true;
}

/* kept[0] is the old picture, kept[k] the k-th after the change. */
static bool measure_step(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    struct measures *measures = &analysis->measures;
    uint32_t count = drive->frames + 1, tail = drive->frames / 4;
    const struct snapshot *old = &drive->kept[0];
    size_t pixels = snapshot_pixels(old);
    if (!mean_picture(drive->kept + count - tail, tail, &analysis->settled, error))
        return false;
    const float *settled = analysis->settled.luminance;
    double *remaining =
        add_series(analysis, "remaining", "share", "of the change still to be made", 0, count, error);
    double *ghost =
        add_series(analysis, "ghost", "share", "of the old light where none should be", 0, count, error);
    double *flip = add_series(analysis, "flip", "FLIP", "against the settled picture", 0, count, error);
    double threshold = temporal_caustic_threshold(old->luminance, pixels, drive->options->caustic_share);
    if (!remaining || !ghost || !flip)
        return false;
    for (uint32_t k = 0; k < count; k++) {
        remaining[k] = temporal_remaining(drive->kept[k].luminance, old->luminance, settled, pixels);
        ghost[k] = temporal_ghost(drive->kept[k].luminance, old->luminance, settled, pixels, threshold);
        if (!snapshot_flip(&drive->kept[k], &analysis->settled, drive->exposure, &flip[k], error))
            return false;
    }
    double worst[3] = {0, 0, 0};
    measure_response(remaining, count, worst);
    set_response(worst, measures);
    measures_set(measures, MEASURE_step_flip_1, flip[1]);
    measures_set(measures, MEASURE_step_flip_3, flip[3]);
    measures_set(measures, MEASURE_ghost_1, ghost[1]);
    measures_set(measures, MEASURE_ghost_3, ghost[3]);
    measures_set(measures, MEASURE_ghost_end, ghost[count - 1]);
    return measure_step_error(drive, tail, analysis, error) && measure_pairs(drive, measures, error) &&
           (drive->pair_count == 0 ||
            measure_against(drive, &analysis->settled, &drive->pairs[0].reference_now, measures, error));
}

/* Every change between the two settings is a step of its own; the worst one counts. */
static bool measure_alternation(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    uint32_t period = drive->base.flicker_period, turns = drive->frames / period;
    uint32_t tail = period / 4 ? period / 4 : 1;
    struct snapshot first = {0}, settled = {0};
    size_t pixels = snapshot_pixels(&drive->kept[1]);
    double worst[3] = {0, 0, 0};
    double *remaining = add_series(analysis, "remaining", "share", "of the last change, still to be made", 0,
                                   turns * period, error);
    if (!remaining || !mean_picture(drive->kept + 1 + period - tail, tail, &first, error))
        return false;
    for (uint32_t turn = 1; turn < turns; turn++) {
        const struct snapshot *old = &drive->kept[turn * period], *new_pictures = old + 1;
        snapshot_free(&settled);
        if (!mean_picture(new_pictures + period - tail, tail, &settled, error)) {
            snapshot_free(&first);
            return false;
        }
        double response[1 + 1024] = {1};
        for (uint32_t k = 0; k < period; k++) {
            double rest =
                temporal_remaining(new_pictures[k].luminance, old->luminance, settled.luminance, pixels);
            response[k + 1] = remaining[turn * period + k] = isnan(rest) ? 0 : rest;
        }
        measure_response(response, period + 1, worst);
        if (turn % 2 == 0)
            measures_set(&analysis->measures, MEASURE_return_difference, snapshot_error(&settled, &first));
    }
    set_response(worst, &analysis->measures);
    bool is_done = measure_against(drive, &first, &drive->reference, &analysis->measures, error);
    snapshot_free(&first);
    snapshot_free(&settled);
    return is_done;
}

/* ---- all of it
 * ------------------------------------------------------------------------------------------------ */

static bool measure_rest(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    struct measures *measures = &analysis->measures;
    measures_set(measures, MEASURE_picture_drift, snapshot_error(&drive->last, &drive->first));
    measure_drift(drive->light + drive->warmup, drive->frames, MEASURE_light_drift,
                  MEASURE_light_drift_interval, measures);
    return measure_against(drive, &drive->last, &drive->reference, measures, error);
}

bool analysis_make(const struct drive *drive, struct analysis *analysis, struct error *error)
{
    struct measures *measures = &analysis->measures;
    enum path_kind kind = path_infos[drive->path].kind;
    if (!analysis_make_partial(drive, analysis, error))
        return false;
    for (int i = 0; i < STATISTIC_COUNT; i++)
        measure_loop(drive, (enum statistic)i, measures);
    measure_noise(drive->pair_count ? &drive->pairs[drive->pair_count - 1].reference_now : &drive->reference,
                  &drive->reference_other, measures);
    if (drive->pixels) {
        measure_restlessness(drive, measures);
        measure_mean(drive, drive->flip, MEASURE_flip_mean, MEASURE_flip_largest, measures);
        if (!measure_flicker(drive, analysis, error) ||
            !copy_series(analysis, "flip", "FLIP", "against the frame before", drive, drive->flip, error))
            return false;
    }
    switch (kind) {
    case PATH_RESTS:
        return measure_rest(drive, analysis, error);
    case PATH_MOVES:
        return measure_pairs(drive, measures, error);
    case PATH_STEPS:
        return measure_step(drive, analysis, error);
    case PATH_ALTERNATES:
        return measure_alternation(drive, analysis, error);
    }
    return true;
}

void analysis_free(struct analysis *analysis)
{
    for (uint32_t i = 0; i < analysis->series_count; i++)
        free(analysis->series[i].values);
    free(analysis->flicker_map);
    snapshot_free(&analysis->settled);
    *analysis = (struct analysis){0};
}
