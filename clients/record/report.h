/* report.h: what the frames say about themselves: stats.json, and a table of medians.
 *
 * stats.json
 *     program, version          this program
 *     server                    version, device, driver, tracer
 *     scene                     name, triangles, duration
 *     view                      width, height, and of the command line: camera, path, frames, warmup, time,
 * fps settings                  every setting of the view by name lights                    those that were
 * changed, by name units                     of every statistic frames[]                  number, frame (the
 * view's own count), file, time, camera, world_to_camera, camera_to_clip, passes_ns, statistics, flux_by_fate
 * (W), guards, plan[], channels[], black_reason, request_ns (from the request to the last byte) Numbers that
 * JSON cannot say are null.
 */
#ifndef CAUSTIC_RECORD_REPORT_H
#define CAUSTIC_RECORD_REPORT_H

#include <stdio.h>

#include "../lib/client.h"
#include "options.h"

struct report;

/* `values`: of the view's settings, in HELLO's order. Borrows hello. */
struct report *report_create(const struct protocol_hello *hello, const struct record_options *options,
                             const double *values, struct error *error);
void report_destroy(struct report **report);

/* `file`: what it was written to; empty: nothing. */
bool report_add(struct report *report, const struct client_frame *frame, uint32_t number, const char *file,
                uint64_t request_ns, struct error *error);

/* Whole or absent. */
bool report_write(const struct report *report, const char *path, struct error *error);

/* Median over the frames of every pass and statistic. */
void report_print(const struct report *report, FILE *stream);

#endif
