/* drive.h: drives one path against a server and keeps what the measures need of it.
 *
 * Every path has a view of its own, made for it and destroyed after it: no path inherits another's temporal
 * state. References are frames of further views with `accumulate`.
 */
#ifndef CAUSTIC_STABILITY_DRIVE_H
#define CAUSTIC_STABILITY_DRIVE_H

#include "../../core/measure/temporal.h"
#include "../lib/client.h"
#include "options.h"
#include "path.h"
#include "snapshot.h"

/* What a path was told about itself, one value per frame. */
enum statistic { STATISTIC_PHOTONS, STATISTIC_DENSITY, STATISTIC_DENSEST, STATISTIC_COUNT };

/* Two frames that follow one another, and the reference's of the same two states. */
struct drive_pair {
    int64_t frame; /* the later one's number */
    struct snapshot before, now, reference_before, reference_now;
};

struct drive {
    /* what it works with */
    const struct stability_options *options;
    struct client *client;
    const struct protocol_hello *hello;
    struct path_base base;
    uint32_t channel, width, height;
    uint32_t statistic[STATISTIC_COUNT], accumulate, seed; /* indices in HELLO's lists */
    uint32_t light_index;                                  /* of the one that moves */
    double other_seed;                                     /* for a second reference */
    uint32_t flicker_setting;
    double flicker_values[2]; /* of settings-flicker */
    double exposure; /* stops, of pictures for FLIP and for people: one for all, so that they compare */
    void (*step)(void *context, const char *what); /* after every frame */
    void *context;

    /* what the last path left */
    enum path_id path;
    uint32_t warmup, frames;                 /* as asked for */
    uint32_t done;                           /* frames rendered, warm-up included */
    double *series[STATISTIC_COUNT], *light; /* per frame; light: mean luminance */
    double *flip;       /* of a frame against the one before; NAN where it was not measured */
    double *successive; /* RMS of the difference from the frame before, of this one's RMS; NAN likewise */
    struct temporal_pixels *pixels; /* of the measured frames; NULL for paths that move or step */
    struct snapshot first, last;    /* measured frames */
    struct snapshot *kept;          /* steps and alternations: the old picture, then every measured frame */
    struct drive_pair *pairs;
    uint32_t pair_count;
    struct snapshot reference;       /* paths without pairs: of the last state; alternations: of the first */
    struct snapshot reference_other; /* the last reference once more, with another seed */
    double frame_seconds, reference_seconds; /* measured frames and all references, as the client saw them */
    uint32_t reference_frames;
};

/* Connects names to numbers, finds the middle of the caustic. The client is borrowed. */
bool drive_begin(struct drive *drive, struct error *error);

/* Runs a path. On failure what was measured so far stays in *drive. */
bool drive_path(struct drive *drive, enum path_id path, uint32_t frames, struct error *error);

/* Frames and references that drive_path will render. */
uint32_t drive_frame_count(const struct stability_options *options, enum path_id path, uint32_t frames);

/* Forgets the last path. */
void drive_clear(struct drive *drive);

#endif
