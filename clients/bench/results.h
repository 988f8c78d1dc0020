/* results.h: what was measured, as results.json and results.csv.
 *
 * results.json
 *     program, version, format    "caustic-bench", of this program, 1
 *     server                      version, device, driver, tracer, build (hash of its program; "" when it was
 *                                 not started here)
 *     references[]                scene, file, photons, noise (relative L1 expected against the truth; null
 *                                 for a given file), has_confidence
 *     points[]                    key, scene, method, settings (those that were set), width, height, time,
 *                                 reference (its key), image (a file beside), gpu_ns, wall_ns, frame_ns and
 *                                 each of measures: {median, low, high, least}; statistics and passes_ns:
 *                                 medians by name
 * low and high are the quartiles over the repeats. Numbers that JSON cannot say are null. The file is
 * rewritten whole and renamed after every point, so an interrupted run has all points that it finished.
 */
#ifndef CAUSTIC_BENCH_RESULTS_H
#define CAUSTIC_BENCH_RESULTS_H

#include "../lib/client.h"
#include "config.h"

#define BENCH_MAX_SET (BENCH_MAX_VALUES + BENCH_MAX_AXES)

struct bench_spread {
    double median, low, high, least; /* NaN: not measured */
};

/* Of `count` values; reorders them. */
struct bench_spread bench_spread_of(double *values, uint32_t count);

struct bench_number {
    char name[BENCH_TEXT];
    double value;
};

struct bench_result {
    char key[20]; /* hash of everything the point depends on */
    char scene[BENCH_TEXT], method[BENCH_TEXT], image[BENCH_TEXT], reference[20];
    uint32_t width, height, setting_count, statistic_count, pass_count;
    double time;
    struct option_setting settings[BENCH_MAX_SET];
    struct bench_spread gpu_ns, wall_ns, frame_ns, measures[METRIC_COUNT];
    struct bench_number statistics[PROTOCOL_MAX_STATISTICS], passes_ns[PROTOCOL_MAX_PASSES];
};

struct bench_server {
    char version[BENCH_TEXT], device[256], driver[256], tracer[BENCH_TEXT], build[20];
};

struct bench_reference_note {
    char key[20], scene[BENCH_TEXT], file[BENCH_PATH];
    double photons, noise;
    bool has_confidence;
};

struct bench_results {
    struct bench_server server;
    struct bench_reference_note references[BENCH_MAX_SCENES];
    struct bench_result *results;
    uint32_t reference_count, count, capacity;
};

/* Empty; bench_results_free frees what it holds. */
void bench_results_begin(struct bench_results *results);
void bench_results_free(struct bench_results *results);
bool bench_results_add(struct bench_results *results, const struct bench_result *result, struct error *error);
const struct bench_result *bench_results_find(const struct bench_results *results, const char *key);

/* Whole or absent. */
bool bench_results_write(const struct bench_results *results, const char *path, struct error *error);
/* STATUS_NOT_FOUND when there is no such file; STATUS_INVALID, with file and field, when it is damaged or
 * another program's. */
bool bench_results_read(struct bench_results *results, const char *path, struct error *error);
/* One row per point, a column per setting that varies or is set, per measure, per pass, per statistic. */
bool bench_results_write_csv(const struct bench_results *results, const char *path, struct error *error);

/* A setting's value as text; NULL when the point did not set it. */
const char *bench_result_setting(const struct bench_result *result, const char *name);
/* "method aa=none photons=8192"; leaves out the setting `without` (NULL: none), and methods called "". */
void bench_result_name(const struct bench_result *result, const char *without, char *text, size_t size);

/* ---- quantities: what can be plotted ---------------------------------------------------------------------
 *
 *     term, a / b, 1 - a, or 1 - a / b, where a term is one of
 *         gpu_ms, wall_ms, frame_ms, photons (emitted), rays (traced), memory_mib, passes_ms (their sum)
 *         the name of a metric (ssim and flux as errors), of a statistic, or of a setting with numbers
 *         pass.NAME in ms; pass.A+B the sum of two
 */

/* NaN where the point has no such number. */
double bench_quantity(const struct bench_result *result, const char *expression);

/* ---- fronts ----------------------------------------------------------------------------------------------
 */

/* Marks the points that no other beats in both: smaller `cost` and smaller `error`. Of equal points the first
 * is on the front. Points that are not finite are not. Returns their number; `order`, of `count`, receives
 * their places by rising cost. */
uint32_t bench_front(const double *costs, const double *errors, uint32_t count, uint32_t *order);

/* The place of the least error among those whose cost is within `budget`; UINT32_MAX: none. */
uint32_t bench_best_within(const double *costs, const double *errors, uint32_t count, double budget);

#endif
