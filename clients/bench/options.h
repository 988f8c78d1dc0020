/* options.h: the command line of caustic-bench. */
#ifndef CAUSTIC_BENCH_OPTIONS_H
#define CAUSTIC_BENCH_OPTIONS_H

#include "compare.h"
#include "config.h"

#define BENCH_MAX_SERVER_OPTIONS 32u

struct bench_options {
    struct bench_config config;
    const char *address, *program;
    const char *server_arguments[BENCH_MAX_SERVER_OPTIONS + 1]; /* up to a NULL */
    const char *folder;                                         /* bench-out */
    const char *compare;                                        /* NULL: nothing to compare with */
    struct bench_thresholds thresholds;
    double timeout; /* seconds of one frame */
    bool is_fresh, quiet;
    bool help, version; /* asked for; nothing else is checked then */
};

/* The texts point into argv. Reads the file of --config first, wherever it stands. */
bool bench_options_parse(struct bench_options *options, int argc, char **argv, struct error *error);

extern const char bench_help[];

#endif
