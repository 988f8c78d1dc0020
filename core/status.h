/* status.h: how every module of causticd says that something failed.
 *
 * A function that can fail returns bool or a pointer, takes a `struct error *` as its last argument (never
 * NULL), and on failure fills it with a status and one sentence that names the thing and says what to do.
 * Values that come from outside (files, sockets, command lines) are checked where they enter.
 */
#ifndef CAUSTIC_STATUS_H
#define CAUSTIC_STATUS_H

#include <stdbool.h>

enum status {
    STATUS_OK,
    STATUS_INVALID,     /* a value is malformed or out of its range */
    STATUS_NOT_FOUND,   /* a file, name or id does not exist */
    STATUS_UNSUPPORTED, /* well formed, but this build, device or version cannot do it */
    STATUS_LIMIT,       /* a stated limit would be passed */
    STATUS_IO,          /* reading, writing or the connection failed */
    STATUS_DEVICE,      /* Vulkan: none found, lost, or out of device memory */
    STATUS_MEMORY       /* out of host memory */
};

struct error {
    enum status status;
    char message[512]; /* UTF-8, zero-terminated, without a trailing newline or full stop */
};

/* Fills *error and returns false, so that a check can be `return error_set(...)`. */
bool error_set(struct error *error, enum status status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* "invalid", "not found", ... */
const char *status_name(enum status status);

#endif
