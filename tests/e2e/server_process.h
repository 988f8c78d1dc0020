/* server_process.h: a server of its own for a test.
 *
 * It runs in a fresh folder under /tmp, listens on a UNIX socket and on a free TCP port, and dies with the
 * test. Every wait is bounded. What fails here fails the running cmocka test, with what the server wrote to
 * stderr.
 */
#ifndef TEST_SERVER_PROCESS_H
#define TEST_SERVER_PROCESS_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

#define SERVER_MAX_ARGUMENTS 32

struct server_params {
    const char *program;                         /* in CAUSTICD_BIN_DIR; NULL: "causticd-fake" */
    const char *scene;                           /* NULL: the program's default */
    const char *arguments[SERVER_MAX_ARGUMENTS]; /* more options, up to the first NULL */
};

struct server_process {
    pid_t pid; /* 0: ended */
    char folder[64];
    char unix_address[128]; /* "unix:..." */
    char tcp_address[64];   /* "tcp:127.0.0.1:..." */
    char socket_path[112], log_path[112];
};

/* Returns when the server is ready. */
void server_start(struct server_process *server, const struct server_params *params);
/* Sends `signal` (0: none) and waits; returns the exit status, or 128 + the signal that killed it. Keeps the
 * folder. */
int server_wait(struct server_process *server, int signal, double seconds);
/* Ends what still runs and removes the folder. */
void server_clean(struct server_process *server);
/* SIGTERM; asserts that it exits with 0 within 10 s and leaves no socket file; cleans. */
void server_stop(struct server_process *server);
/* What it wrote to stderr so far; free() it. */
char *server_log(const struct server_process *server);

/* Resident bytes; 0 under AddressSanitizer, which keeps freed memory. */
uint64_t server_memory(const struct server_process *server);
/* Open descriptors. */
uint32_t server_descriptors(const struct server_process *server);

#endif
