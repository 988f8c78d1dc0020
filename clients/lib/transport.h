/* transport.h: a stream socket with deadlines. Internal to the client library. */
#ifndef CAUSTIC_CLIENT_TRANSPORT_H
#define CAUSTIC_CLIENT_TRANSPORT_H

#include <stddef.h>
#include <stdint.h>

#include "../../core/status.h"

/* Milliseconds of the monotonic clock. */
int64_t transport_now_ms(void);

/* Connects to "tcp:HOST:PORT" or "unix:PATH" before `deadline_ms`; while nobody listens there, tries again
 * until `wait_until_ms`. The socket, non-blocking, or -1. */
int transport_connect(const char *address, int64_t deadline_ms, int64_t wait_until_ms, struct error *error);

/* Exactly `size` bytes, or false with STATUS_IO. */
bool transport_read(int socket, void *bytes, size_t size, int64_t deadline_ms, struct error *error);
bool transport_write(int socket, const void *bytes, size_t size, int64_t deadline_ms, struct error *error);

/* Whether a byte can be read, or the connection has ended, before the deadline. */
bool transport_wait(int socket, int64_t deadline_ms);

bool transport_set_nonblocking(int socket, struct error *error);

#endif
