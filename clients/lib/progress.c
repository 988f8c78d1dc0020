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

static void tell_time(const struct progress *progress)
{
    if (!progress->done || progress->done >= progress->total)
        return;
    double each = (double)(progress_now_ns() - progress->begin_ns) * 1e-9 / progress->done;
    uint32_t left = (uint32_t)(each * (progress->total - progress->done) + 0.5);
    fprintf(stderr, ", %.3g s each, %u:%02u left", each, left / 60, left % 60);
}

static void draw(const struct progress *progress, const char *what)
{
    char bar[BAR_WIDTH + 1];
    uint32_t full = progress->total ? (uint32_t)((uint64_t)progress->done * BAR_WIDTH / progress->total) : 0;
    for (uint32_t i = 0; i < BAR_WIDTH; i++)
        bar[i] = i < full ? '#' : '-';
    bar[BAR_WIDTH] = 0;
    fprintf(stderr, "\r  [%s] %u/%u %s", bar, progress->done, progress->total, what);
    tell_time(progress);
    fputs("\033[K", stderr);
    fflush(stderr);
}

void progress_begin(struct progress *progress, uint32_t total, bool quiet)
{
    bool is_terminal = isatty(STDERR_FILENO) == 1;
    *progress = (struct progress){.is_shown = !quiet && is_terminal,
                                  .has_lines = !quiet && !is_terminal,
                                  .total = total,
                                  .begin_ns = progress_now_ns()};
    if (progress->is_shown)
        draw(progress, "");
}

void progress_step(struct progress *progress, const char *what)
{
    progress->done++;
    if (progress->is_shown)
        draw(progress, what);
}

void progress_line(const struct progress *progress, const char *what)
{
    if (!progress->has_lines)
        return;
    fprintf(stderr, "  %u/%u %s", progress->done, progress->total, what);
    tell_time(progress);
    fputc('\n', stderr);
}

void progress_end(struct progress *progress)
{
    if (progress->is_shown)
        fputs("\r\033[K", stderr);
    progress->is_shown = false;
}
