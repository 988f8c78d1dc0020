#include "progress.h"

#include <stdio.h>
#include <time.h>
#include <unistd.h>

#define BAR_WIDTH 30u

int64_t progress_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void draw(const struct progress *progress, const char *what)
{
    char bar[BAR_WIDTH + 1];
    uint32_t full = progress->total ? (uint32_t)((uint64_t)progress->done * BAR_WIDTH / progress->total) : 0;
    for (uint32_t i = 0; i < BAR_WIDTH; i++)
        bar[i] = i < full ? '#' : '-';
    bar[BAR_WIDTH] = 0;
    fprintf(stderr, "\r  [%s] %u/%u %s", bar, progress->done, progress->total, what);
    if (progress->done && progress->done < progress->total) {
        double each = (double)(progress_now_ns() - progress->begin_ns) * 1e-9 / progress->done;
        uint32_t left = (uint32_t)(each * (progress->total - progress->done) + 0.5);
        fprintf(stderr, ", %.3g s each, %u:%02u left", each, left / 60, left % 60);
    }
    fputs("\033[K", stderr);
    fflush(stderr);
}

void progress_begin(struct progress *progress, uint32_t total, bool quiet)
{
    *progress = (struct progress){
        .is_shown = !quiet && isatty(STDERR_FILENO) == 1, .total = total, .begin_ns = progress_now_ns()};
    if (progress->is_shown)
        draw(progress, "");
}

void progress_step(struct progress *progress, const char *what)
{
    progress->done++;
    if (progress->is_shown)
        draw(progress, what);
}

void progress_end(struct progress *progress)
{
    if (progress->is_shown)
        fputs("\r\033[K", stderr);
    progress->is_shown = false;
}
