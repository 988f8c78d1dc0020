/* replay_main.c: runs a fuzz target over files, and over mutations of them.
 *
 *     replay_NAME [--seconds S] [--mutate N SEED] FILE|FOLDER...
 *
 * Every file is given to LLVMFuzzerTestOneInput as it is and cut short at 64 places; with --mutate, N more
 * inputs are made from the files by a generator that starts from SEED, so that the same command tries the
 * same inputs. --seconds ends the mutations early (after the current input) and says how many were tried. A
 * crash or a sanitizer report ends the program; the input at fault is left in the working folder as
 * crash_NAME, where NAME counts inputs.
 */
#include <dirent.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <fcntl.h>
#include <time.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
void __sanitizer_set_death_callback(void (*callback)(void)) __attribute__((weak));

#define LARGEST_INPUT ((size_t)8 << 20)

struct seed {
    char *path;
    uint8_t *bytes;
    size_t size;
};

static struct seed *seeds;
static size_t seed_count;

static const uint8_t *current;
static size_t current_size;
static unsigned long current_number;

/* Called from a signal handler and from the sanitizer's report: only async-signal-safe functions. */
static void save_current(void)
{
    char name[40] = "crash_", digits[24];
    size_t length = strlen(name), count = 0;
    unsigned long number = current_number;
    do {
        digits[count++] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    while (count)
        name[length++] = digits[--count];
    name[length] = '\0';
    int file = open(name, O_WRONLY | O_CREAT | O_TRUNC, 0644);
    if (file < 0)
        return;
    for (size_t done = 0; done < current_size;) {
        ssize_t written = write(file, current + done, current_size - done);
        if (written <= 0)
            break;
        done += (size_t)written;
    }
    close(file);
    static const char text[] = "replay: the input at fault was saved as ";
    if (write(2, text, sizeof text - 1) < 0 || write(2, name, length) < 0 || write(2, "\n", 1) < 0)
        return;
}

static void on_crash(int number)
{
    save_current();
    signal(number, SIG_DFL);
    raise(number);
}

/* Each input lives in its own allocation of exactly its size, so that a read past its end is seen. */
static void run(const uint8_t *bytes, size_t size)
{
    uint8_t *copy = malloc(size ? size : 1);
    if (!copy) {
        fprintf(stderr, "replay: out of memory for an input of %zu bytes\n", size);
        exit(1);
    }
    if (size)
        memcpy(copy, bytes, size);
    current = copy;
    current_size = size;
    current_number++;
    LLVMFuzzerTestOneInput(copy, size);
    free(copy);
}

static void add_file(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (!file) {
        fprintf(stderr, "replay: cannot open %s\n", path);
        exit(1);
    }
    uint8_t *bytes = malloc(LARGEST_INPUT);
    size_t size = bytes ? fread(bytes, 1, LARGEST_INPUT, file) : 0;
    fclose(file);
    struct seed *grown = realloc(seeds, (seed_count + 1) * sizeof *seeds);
    char *name = strdup(path);
    if (!bytes || !grown || !name) {
        fprintf(stderr, "replay: out of memory for %s\n", path);
        exit(1);
    }
    uint8_t *fitted = realloc(bytes, size ? size : 1);
    seeds = grown;
    seeds[seed_count++] = (struct seed){name, fitted ? fitted : bytes, size};
}

static int compare_seeds(const void *left, const void *right)
{
    return strcmp(((const struct seed *)left)->path, ((const struct seed *)right)->path);
}

static void add_path(const char *path)
{
    struct stat status;
    if (stat(path, &status) != 0) {
        fprintf(stderr, "replay: %s does not exist\n", path);
        exit(1);
    }
    if (!S_ISDIR(status.st_mode)) {
        add_file(path);
        return;
    }
    DIR *folder = opendir(path);
    if (!folder) {
        fprintf(stderr, "replay: cannot list %s\n", path);
        exit(1);
    }
    for (struct dirent *entry; (entry = readdir(folder));) {
        if (entry->d_name[0] == '.')
            continue;
        char child[4096];
        if (snprintf(child, sizeof child, "%s/%s", path, entry->d_name) < (int)sizeof child)
            add_path(child);
    }
    closedir(folder);
}

static uint64_t state;

/* splitmix64: small, seedable, the same on every machine. */
static uint64_t next_random(void)
{
    uint64_t z = (state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static size_t below(size_t limit)
{
    return limit ? (size_t)(next_random() % limit) : 0;
}

/* Bits, bytes, interesting integers, moved and removed spans, text digits, and splices of two seeds. */
static size_t mutate(uint8_t *bytes, size_t size, size_t capacity)
{
    static const uint32_t integers[] = {0,           1,           0x7f,       0x80,       0xff,
                                        0x7fff,      0x8000,      0xffff,     0x7fffffff, 0x80000000u,
                                        0xfffffffeu, 0xffffffffu, 0x7f800000, 0x7fc00000, 0xff800000u};
    size_t edits = 1 + below(8);
    for (size_t i = 0; i < edits && size; i++) {
        size_t at = below(size), span = 1 + below(size - at < 64 ? size - at : 64);
        switch (below(8)) {
        case 0:
            bytes[at] ^= (uint8_t)(1u << below(8));
            break;
        case 1:
            bytes[at] = (uint8_t)next_random();
            break;
        case 2: {
            uint32_t integer = integers[below(sizeof integers / sizeof *integers)];
            if (size - at >= sizeof integer)
                memcpy(bytes + at, &integer, sizeof integer);
            break;
        }
        case 3:
            memmove(bytes + at, bytes + at + span, size - at - span);
            size -= span;
            break;
        case 4:
            if (size + span <= capacity) {
                memmove(bytes + at + span, bytes + at, size - at);
                size += span;
            }
            break;
        case 5:
            memmove(bytes + below(size - span + 1), bytes + at, span);
            break;
        case 6: /* a number in text */
            for (size_t j = 0; j < size && j < 4096; j++) {
                size_t k = (at + j) % size;
                if (bytes[k] >= '0' && bytes[k] <= '9') {
                    bytes[k] = (uint8_t) "0123456789-e."[below(13)];
                    break;
                }
            }
            break;
        default: {
            const struct seed *other = &seeds[below(seed_count)];
            if (other->size) {
                size_t from = below(other->size);
                size_t count = below((other->size - from < size - at ? other->size - from : size - at) + 1);
                memcpy(bytes + at, other->bytes + from, count);
            }
            break;
        }
        }
    }
    return size;
}

static double seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static unsigned long number(const char *text)
{
    char *end;
    unsigned long value = text ? strtoul(text, &end, 10) : 0;
    if (!text || end == text || *end) {
        fprintf(stderr, "usage: replay [--seconds S] [--mutate N SEED] FILE|FOLDER...\n");
        exit(2);
    }
    return value;
}

int main(int count, char **arguments)
{
    unsigned long mutations = 0, seconds = 0;
    for (int i = 1; i < count; i++) {
        if (strcmp(arguments[i], "--mutate") == 0) {
            mutations = number(i + 1 < count ? arguments[i + 1] : NULL);
            state = number(i + 2 < count ? arguments[i + 2] : NULL);
            i += 2;
        } else if (strcmp(arguments[i], "--seconds") == 0) {
            seconds = number(i + 1 < count ? arguments[i + 1] : NULL);
            i++;
        } else {
            add_path(arguments[i]);
        }
    }
    if (!seed_count) {
        fprintf(stderr, "replay: no input files; give files or folders\n");
        return 1;
    }
    qsort(seeds, seed_count, sizeof *seeds, compare_seeds);

    if (__sanitizer_set_death_callback) {
        __sanitizer_set_death_callback(save_current);
    } else {
        signal(SIGSEGV, on_crash);
        signal(SIGBUS, on_crash);
        signal(SIGFPE, on_crash);
        signal(SIGILL, on_crash);
        signal(SIGABRT, on_crash);
    }

    double start = seconds_now();
    for (size_t i = 0; i < seed_count; i++) {
        run(seeds[i].bytes, seeds[i].size);
        for (size_t j = 0; j < 64; j++)
            run(seeds[i].bytes, seeds[i].size * j / 64);
    }
    uint8_t *bytes = malloc(LARGEST_INPUT);
    if (!bytes) {
        fprintf(stderr, "replay: out of memory\n");
        return 1;
    }
    unsigned long tried = 0;
    for (; tried < mutations; tried++) {
        if (seconds && seconds_now() - start > (double)seconds)
            break;
        const struct seed *seed = &seeds[below(seed_count)];
        if (seed->size)
            memcpy(bytes, seed->bytes, seed->size);
        run(bytes, mutate(bytes, seed->size, LARGEST_INPUT));
    }
    printf("replay: %zu seeds, cut short at 64 places each, and %lu of %lu mutations in %.1f s\n", seed_count,
           tried, mutations, seconds_now() - start);
    free(bytes);
    for (size_t i = 0; i < seed_count; i++) {
        free(seeds[i].path);
        free(seeds[i].bytes);
    }
    free(seeds);
    return 0;
}
