/* program.h: programs of the house, run to their end as from a terminal. What fails here fails the running
 * cmocka test. */
#ifndef TEST_PROGRAM_H
#define TEST_PROGRAM_H

#include <stddef.h>
#include <sys/types.h>

/* What the last one wrote to stdout and stderr together. */
extern char program_output[1 << 16];

/* Runs a line of sh, with CAUSTICD_BIN_DIR first in PATH, in `folder` (NULL: this one). Returns its exit
 * status, or 128 + the signal that ended it; the test fails when it takes more than four minutes. */
int program_run(const char *folder, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* The same; it must end with that status and have said `part`. */
void program_expect(int status, const char *part, const char *folder, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* Skips the program where no Vulkan device is found. */
void program_needs_device(void);

/* Below: for servers, which go on running. */

/* The path of a program of CAUSTICD_BIN_DIR. */
void program_path(const char *program, char *path, size_t size);
/* Runs `path` with its outputs going to these descriptors; it dies with the test. */
pid_t program_spawn(const char *path, char *const *arguments, int out, int err);
/* Its exit status, or 128 + signal; -1 when it goes on for longer than that. */
int program_wait(pid_t pid, double seconds);
/* A file's first 64 KiB; free() it. */
char *program_read(const char *path);

/* Seconds, monotonic. */
double seconds_now(void);

#endif
