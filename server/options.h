/* options.h: the command line of causticd. */
#ifndef CAUSTICD_OPTIONS_H
#define CAUSTICD_OPTIONS_H

#include "core/render/renderer.h"
#include "listener.h"
#include "log.h"

struct options {
    const char *scene; /* built-in name or path */
    const char *listen[LISTENER_MAX_COUNT];
    uint32_t listen_count;
    bool allow_remote;
    const char *device, *cache_dir; /* NULL: see struct gpu_params */
    enum tracer tracer;
    bool validation;
    bool list_devices;
    uint32_t max_clients;
    uint32_t max_views;       /* of one client */
    uint32_t size_limit;      /* pixels of one view; 0: what the device allows */
    uint64_t output_limit;    /* bytes */
    uint32_t stall_seconds;   /* a client that reads nothing for so long is disconnected */
    uint32_t message_seconds; /* a message, and the handshake, must be complete after so long */
    const char *ready_file;
    enum log_level log_level;
};

enum options_outcome { OPTIONS_RUN, OPTIONS_DONE, OPTIONS_WRONG };

/* Reads the command line. OPTIONS_DONE: --help or --version was answered on stdout. OPTIONS_WRONG: the
 * mistake was named on stderr; exit with 2. Strings are borrowed from argv. */
enum options_outcome options_read(struct options *options, int argc, char **argv);

#endif
