/* session.h: one scene on one server: a server of its own, or one that runs already. */
#ifndef CAUSTIC_BENCH_SESSION_H
#define CAUSTIC_BENCH_SESSION_H

#include "../lib/client.h"
#include "../lib/server_process.h"
#include "results.h"

struct session_params {
    const struct bench_config *config;
    const char *address;                 /* of a running server; NULL: start one */
    const char *program;                 /* NULL: the causticd beside the running program */
    const char *const *server_arguments; /* NULL-terminated */
    uint32_t timeout_ms;                 /* of one frame */
    bool is_quiet;
};

struct session {
    const struct session_params *params;
    const struct bench_scene *scene;
    struct server_process *server;
    struct client *client;
    const struct protocol_hello *hello;
    struct bench_server about;
    uint32_t caustics; /* channel */
    char content[20]; /* hash of the scene's file; of a built-in scene the name and the server's program; of a
                         server that runs already what it says about its scene */
};

/* Also tries every setting of the configuration, so that nothing is measured before an error. */
bool session_open(struct session *session, const struct session_params *params,
                  const struct bench_scene *scene, struct error *error);
void session_close(struct session *session);

/* A new view of the scene, at its time and from its camera. */
bool session_view(struct session *session, uint32_t *view, struct error *error);
bool session_set(struct session *session, uint32_t view, const struct option_setting *settings,
                 uint32_t count, struct error *error);

/* The caustics channel, raw; *elapsed_ns: from the request to the last byte (NULL: not wanted). */
struct client_frame *session_render(struct session *session, uint32_t view, uint64_t *elapsed_ns,
                                    struct error *error);

/* By name; NaN when the server has no such statistic. */
double session_statistic(const struct session *session, const struct client_frame *frame, const char *name);

/* Puts "PREFIX: " in front of an error; when the server died, what it last said instead of the broken
 * connection. Returns false. */
bool session_explain(struct session *session, struct error *error, const char *prefix);

/* FNV-1a over texts, as 16 digits. */
uint64_t bench_hash(uint64_t hash, const void *bytes, size_t size);
#define BENCH_HASH_START 0xcbf29ce484222325u
void bench_hash_text(uint64_t hash, char text[20]);

#endif
