/* server_process.h: a causticd of one's own, for as long as a program needs it.
 *
 *     struct server_process *server = server_process_start(&(struct server_process_params){.scene =
 * "sphere"}, &error);
 *     ... client_connect(&(struct client_params){.address = server_process_address(server)}, &error) ...
 *     server_process_stop(&server, &error);
 *
 * It listens on a UNIX socket in a folder of its own under $TMPDIR or /tmp, keeps what it writes to standard
 * error there, and never outlives the program: the kernel kills it when the thread that started it ends, and
 * on SIGINT, SIGTERM and SIGHUP it is ended, and the folder removed, before the program dies of the signal.
 * (Signals that the program handles or ignores when the first server starts stay as they are.) It runs in a
 * process group of its own, so that Ctrl-C in a terminal reaches the program alone.
 *
 * Every wait is bounded. Threads: one at a time over all servers.
 */
#ifndef CAUSTIC_SERVER_PROCESS_H
#define CAUSTIC_SERVER_PROCESS_H

#include <stdint.h>

#include "../../core/status.h"

#define SERVER_PROCESS_MAX_ARGUMENTS 64u

struct server_process;

struct server_process_params {
    const char *program;          /* NULL: the causticd beside the running program */
    const char *scene;            /* NULL: the server's default */
    const char *const *arguments; /* further options, up to a NULL; NULL: none */
    uint32_t ready_ms;            /* most time until it listens; 0: 2 minutes */
};

/* Returns when the server can be connected to. NULL on error, with the last error it wrote. */
struct server_process *server_process_start(const struct server_process_params *params, struct error *error);

/* "unix:PATH"; belongs to the process. */
const char *server_process_address(const struct server_process *process);

/* Whether it still runs. When it does not, *error says how it ended and what it wrote last: to be asked when
 * a connection broke. */
bool server_process_is_alive(struct server_process *process, struct error *error);

/* SIGTERM, 10 seconds later SIGKILL; removes the folder. False, with an error, when it had ended before or
 * did not end with status 0; it is gone either way. NULL is accepted. */
bool server_process_stop(struct server_process **process, struct error *error);

#endif
