/* measure_point.h: one combination of settings: rendered, timed, compared. */
#ifndef CAUSTIC_BENCH_MEASURE_POINT_H
#define CAUSTIC_BENCH_MEASURE_POINT_H

#include "../lib/progress.h"
#include "bench_reference.h"

/* Names the point without rendering anything: scene, settings and key of *result. */
void point_describe(const struct session *session, const struct bench_reference *reference,
                    const struct bench_point *point, struct bench_result *result);

/* A new view, warm-up frames, then the repeats; each is measured after it came, while the server waits. The
 * last one's picture is written to FOLDER/points/KEY.exr. Steps `progress` once per frame. */
bool point_measure(struct session *session, const struct bench_reference *reference, const char *folder,
                   struct bench_result *result, struct progress *progress, struct error *error);

#endif
