/* network.h: connections as streams of bytes, on one libwebsockets event loop.
 *
 * Knows sockets and time, not the protocol. It accepts, reads and writes; what the bytes mean is told by the
 * callbacks. Output is pulled: when a connection can take bytes, `next_output` is asked for them, so nothing
 * is copied into queues here.
 *
 * Threads: everything runs on the thread that calls network_run, except network_wake.
 */
#ifndef CAUSTICD_NETWORK_H
#define CAUSTICD_NETWORK_H

#include "listener.h"

#include <stddef.h>
#include <stdint.h>

#define NETWORK_MAX_WRITE (256u * 1024u + 4096u) /* most bytes next_output may offer at a time */

struct network;
struct connection;

struct network_callbacks {
    /* A connection was accepted. NULL: out of memory. */
    void *(*opened)(void *user, struct connection *connection, const char *peer);
    /* Writes what a connection that cannot be accepted is sent before it is closed. */
    size_t (*refusal)(void *user, const char *reason, uint8_t *bytes, size_t capacity);
    void (*received)(void *session, const uint8_t *bytes, size_t size);
    /* The next bytes to send, at most NETWORK_MAX_WRITE; they count as sent when this returns them and stay
     * valid until the next call. 0: nothing to send for now. */
    size_t (*next_output)(void *session, const uint8_t **bytes);
    void (*closed)(
        void *session);         /* the connection is gone; called once, also when the network is destroyed */
    void (*woken)(void *user);  /* after network_wake */
    void (*ticked)(void *user); /* every NETWORK_TICK_MS */
};

#define NETWORK_TICK_MS 100

struct network_params {
    struct network_callbacks callbacks;
    void *user;
    uint32_t max_connections;
    uint32_t stall_seconds; /* a connection that has output and takes none of it for so long is closed */
};

struct network *network_create(const struct network_params *params, struct error *error);
void network_destroy(struct network **network);

/* Takes over the listener's descriptor; the socket file stays the caller's to remove. */
bool network_listen(struct network *network, struct listener *listener, struct error *error);
void network_stop_listening(struct network *network);

/* Serves until network_stop. */
void network_run(struct network *network);
void network_stop(struct network *network);

/* Has `woken` called on the network's thread. Any thread; safe in a signal handler. */
void network_wake(struct network *network);

/* Monotonic time. */
uint64_t network_now_ns(void);

/* There is output: next_output will be called. */
void connection_want_output(struct connection *connection);
/* Stops or resumes reading; a paused client notices when the system's buffers are full. */
void connection_pause(struct connection *connection, bool is_paused);
/* Sends what next_output still gives, then closes so that the client can read all of it. Nothing is received
 * any more. `closed` follows. */
void connection_finish(struct connection *connection);
/* Closes without sending more. `closed` follows. */
void connection_abort(struct connection *connection);

#endif
