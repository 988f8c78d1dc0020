/* progress.h: a bar with the time left, on a terminal only. */
#ifndef CAUSTIC_PROGRESS_H
#define CAUSTIC_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

struct progress {
    bool is_shown;
    uint32_t total, done;
    int64_t begin_ns;
};

/* Draws on standard error, and only when that is a terminal and `quiet` is not set. */
void progress_begin(struct progress *progress, uint32_t total, bool quiet);
void progress_step(struct progress *progress, const char *what);
/* Takes the bar away. */
void progress_end(struct progress *progress);

int64_t progress_now_ns(void);

#endif
