/* listener.h: the sockets that clients connect to.
 *
 * An address is "tcp:HOST:PORT" (IPv6 in brackets; port 0 lets the system pick) or "unix:PATH". A TCP address
 * that other machines can reach is refused unless the caller allows it, because the protocol has no
 * authentication. A UNIX socket is made for its owner alone (mode 0600); a stale socket file, which nobody
 * listens on, is replaced.
 */
#ifndef CAUSTICD_LISTENER_H
#define CAUSTICD_LISTENER_H

#include "core/status.h"

#include <sys/types.h>

#define LISTENER_MAX_COUNT 8

struct listener {
    int fd;            /* non-blocking, listening; -1: closed */
    char address[160]; /* as clients write it, with the port in use */
    char path[108];    /* of a UNIX socket; "" for TCP */
    dev_t device;      /* of the socket file, so that only our own file is removed */
    ino_t inode;
    bool is_remote; /* reachable from other machines */
};

/* True when `address` is well formed; the error says what is expected. Opens nothing. */
bool listener_check(const char *address, struct error *error);
/* Binds and listens. The error names the address and the reason: in use, not permitted, not loopback, ... */
bool listener_open(struct listener *listener, const char *address, bool allow_remote, struct error *error);
/* Closes the socket and removes the socket file if it is still this listener's. */
void listener_close(struct listener *listener);

#endif
