/* report.h: what was measured: report.json, report.html, a table.
 *
 * report.json
 *     program, version          this program
 *     run                       what the numbers depend on: server, scene, view, settings, paths' angles
 *     measures                  of every name: unit, help
 *     paths[]                   path, what, frames, warmup, is_complete, reason (when it is not), measures
 *                               (a number, null where it cannot be told, "never" where it does not happen
 *                               within the run), series (name, unit, help, first frame, values), pictures
 *                               (caption, file), cost (seconds of a frame, of a reference and how many frames
 *                               one takes)
 *     limits[]                  of --fail-above: measure, path, value, limit, passed
 * The page is made from report.json and the pictures beside it alone.
 */
#ifndef CAUSTIC_STABILITY_REPORT_H
#define CAUSTIC_STABILITY_REPORT_H

#include <stdio.h>

#include "analyse.h"

struct report;

/* Made once the server is known; with options->resume the complete paths of an earlier report are taken over,
 * when it is there and of the same run. Writes the report, so that a folder that cannot be written is known
 * at once. Borrows all. */
struct report *report_create(const struct stability_options *options, const struct drive *drive,
                             struct error *error);
void report_destroy(struct report **report);

/* Whether a complete path with so many frames was taken over. */
bool report_has(const struct report *report, enum path_id path, uint32_t frames);

/* Adds what *drive left and writes report.json. `reason`: why the path is not complete; NULL when it is. */
bool report_add(struct report *report, const struct drive *drive, const struct analysis *analysis,
                const char *reason, struct error *error);

/* Judges the limits and writes report.json and report.html. Returns false and the first measure past its
 * limit in *error when there is one, and on failure. */
bool report_finish(struct report *report, struct error *error);

/* Measures by path. */
void report_print(const struct report *report, FILE *stream);

#endif
