/* progress.h: how far a program is and the time left: a bar on a terminal, elsewhere lines of what takes
 * long. */
#ifndef CAUSTIC_PROGRESS_H
#define CAUSTIC_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

struct progress {
    bool is_shown, has_lines;
    uint32_t total, done;
    int64_t begin_ns;
};

/* Writes to standard error; nothing with `quiet`. */
void progress_begin(struct progress *progress, uint32_t total, bool quiet);
void progress_step(struct progress *progress, const char *what);
/* A line of its own, where there is no bar: after every step that took long, not after each. */
void progress_line(const struct progress *progress, const char *what);
/* Takes the bar away. */
void progress_end(struct progress *progress);

int64_t progress_now_ns(void);

#endif
