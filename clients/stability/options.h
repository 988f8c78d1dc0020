/* options.h: the command line of caustic-stability. */
#ifndef CAUSTIC_STABILITY_OPTIONS_H
#define CAUSTIC_STABILITY_OPTIONS_H

#include "../lib/option_value.h"
#include "measures.h"
#include "path.h"

#define STABILITY_MAX_SETTINGS 128u

struct stability_options {
    const char *address,
        *scene;             /* of a running server; or what an own one shows. Neither: the default port */
    double wait;            /* seconds to wait for a server that does not listen yet */
    double timeout;         /* seconds to wait for one frame; 600 */
    bool runs[PATH_COUNT];  /* all but drift */
    uint32_t frames;        /* 0: each path's own number */
    uint32_t warmup;        /* 16 */
    uint32_t width, height; /* 480x270 */
    const char *channel;    /* caustics */
    const char *camera;     /* NULL: the scene's first */
    bool has_eye, has_at;
    struct protocol_camera free_camera;
    const char *light; /* NULL: the first */
    struct option_setting settings[STABILITY_MAX_SETTINGS];
    uint32_t setting_count;
    struct option_setting flicker; /* name, and "first,second" */
    struct path_base base;         /* the steps and angles of paths */
    uint32_t pairs, accumulate;    /* of references: 3 per moving path, 16; pairs 0: no references */
    double caustic_share, flicker_limit, settle_band; /* 0.02, 0.005, 0.02 */
    struct gate gates[GATE_MAX];
    uint32_t gate_count;
    const char *folder; /* stability */
    bool resume, quiet;
    bool help, list, version; /* asked for; nothing else is checked then */
};

/* The texts point into argv. False with an error that names the option. */
bool stability_options_parse(struct stability_options *options, int argc, char **argv, struct error *error);

uint32_t stability_frames(const struct stability_options *options, enum path_id path);

extern const char stability_help[];

#endif
