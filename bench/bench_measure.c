/* bench_measure.c: how long the image measures take, by pixels, on one thread.
 *
 * Two pictures like recordings of a caustic: a dim floor, a bright ring and noise. Every measure runs on four
 * sizes in turn, several rounds, and the median of the rounds counts; nanoseconds per pixel show whether it
 * grows with the pixels alone. HDR-FLIP runs at the exposures that its reference asks for, and is given per
 * exposure as well.
 */
#include <math.h>
#include <string.h>
#include <time.h>

#include "bench/measure.h"
#include "core/measure/flip.h"
#include "core/measure/image_measure.h"
#include "core/measure/ssim.h"

#define MAX_ROUNDS 101u

static const uint32_t sizes[][2] = {{480, 270}, {960, 540}, {1920, 1080}, {3840, 2160}};
enum { SIZES = sizeof sizes / sizeof *sizes };

struct pictures {
    struct measure_image image, reference;
    float *map;
    uint32_t exposures; /* of the last HDR-FLIP */
};

typedef double measure_run(struct pictures *pictures);

static double run_rmse(struct pictures *pictures)
{
    return measure_rmse(&pictures->image, &pictures->reference);
}

static double run_relative_rmse(struct pictures *pictures)
{
    return measure_relative_rmse(&pictures->image, &pictures->reference);
}

static double run_relmse(struct pictures *pictures)
{
    return measure_relmse(&pictures->image, &pictures->reference, MEASURE_RELMSE_EPSILON);
}

static double run_relative_l1(struct pictures *pictures)
{
    return measure_relative_l1(&pictures->image, &pictures->reference);
}

static double run_flux(struct pictures *pictures)
{
    return measure_flux(&pictures->image, &pictures->reference);
}

static double run_fireflies(struct pictures *pictures)
{
    return (double)measure_fireflies(&pictures->image, &pictures->reference, MEASURE_FIREFLY_FACTOR, 0, NULL);
}

static double run_ssim(struct pictures *pictures)
{
    struct ssim_result result;
    struct error error;
    if (!ssim_compare(&pictures->image, &pictures->reference, &(struct ssim_params){0}, pictures->map,
                      &result, &error))
        measure_die(&error);
    return result.mean;
}

static double run_flip_as(struct pictures *pictures, bool is_hdr)
{
    struct flip_result result;
    struct error error;
    if (!flip_compare(&pictures->image, &pictures->reference, &(struct flip_params){.is_hdr = is_hdr},
                      pictures->map, &result, &error))
        measure_die(&error);
    pictures->exposures = result.exposures.count;
    return result.mean;
}

static double run_flip(struct pictures *pictures)
{
    return run_flip_as(pictures, false);
}

static double run_hdr_flip(struct pictures *pictures)
{
    return run_flip_as(pictures, true);
}

static const struct {
    const char *name;
    measure_run *run;
} measures[] = {
    {"rmse", run_rmse},        {"relrmse", run_relative_rmse},
    {"relmse", run_relmse},    {"rell1", run_relative_l1},
    {"flux", run_flux},        {"fireflies", run_fireflies},
    {"ssim", run_ssim},        {"flip", run_flip},
    {"hdrflip", run_hdr_flip},
};
enum { MEASURES = sizeof measures / sizeof *measures };

static double random_unit(void)
{
    static uint32_t state = 1;
    state = state * 747796405u + 2891336453u;
    uint32_t word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737u;
    return (double)((word >> 22) ^ word) / 4294967296.0;
}

static struct pictures make_pictures(uint32_t width, uint32_t height)
{
    size_t count = (size_t)width * height * 3;
    float *image = measure_allocate(count, sizeof *image),
          *reference = measure_allocate(count, sizeof *reference);
    for (size_t i = 0; i < count; i++) {
        static const double tint[3] = {1, 0.9, 0.8};
        double x = (double)(i / 3 % width) / width, y = (double)(i / 3 / width) / width;
        double ring = exp(-pow((hypot(x - 0.47, y - 0.26) - 0.16) / 0.003, 2));
        double value = (0.05 + 40 * ring + 0.3 * x) * tint[i % 3];
        reference[i] = (float)value;
        image[i] = (float)(value * (1 + 0.4 * (random_unit() - 0.5)));
    }
    return (struct pictures){.image = {image, width, height, 3},
                             .reference = {reference, width, height, 3},
                             .map = measure_allocate((size_t)width * height, sizeof(float))};
}

/* Of this thread alone: what else runs on the machine takes none of it. */
static double now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec * 1e3 + (double)now.tv_nsec * 1e-6;
}

int main(int argc, char **argv)
{
    uint32_t rounds = 5;
    if (argc == 3 && strcmp(argv[1], "--rounds") == 0)
        rounds = (uint32_t)strtoul(argv[2], NULL, 10);
    if ((argc != 1 && argc != 3) || rounds < 1 || rounds > MAX_ROUNDS) {
        fprintf(stderr, "bench measure [--rounds 1..%u]\n", MAX_ROUNDS);
        return 2;
    }
    static double times[MEASURES][SIZES][MAX_ROUNDS];
    uint32_t exposures[SIZES] = {0};
    for (uint32_t s = 0; s < SIZES; s++) {
        struct pictures pictures = make_pictures(sizes[s][0], sizes[s][1]);
        for (uint32_t round = 0; round < rounds; round++)
            for (uint32_t m = 0; m < MEASURES; m++) {
                double start = now_ms(), value = measures[m].run(&pictures);
                times[m][s][round] = now_ms() - start;
                if (!isfinite(value))
                    measure_die(&(struct error){STATUS_INVALID, "a measure is not finite"});
                exposures[s] = measures[m].run == run_hdr_flip ? pictures.exposures : exposures[s];
            }
        free((float *)pictures.image.values);
        free((float *)pictures.reference.values);
        free(pictures.map);
    }

    printf("| measure, ms on one core");
    for (uint32_t s = 0; s < SIZES; s++)
        printf(" | %ux%u", sizes[s][0], sizes[s][1]);
    printf(" | ns per pixel, smallest to largest |\n|---|---|---|---|---|---|\n");
    for (uint32_t m = 0; m <= MEASURES; m++) {
        uint32_t from = m < MEASURES ? m : MEASURES - 1; /* the last row: HDR-FLIP over its exposures */
        bool is_last = m == MEASURES;
        printf("| %s%s", measures[from].name, is_last ? " per exposure" : "");
        if (measures[from].run == run_hdr_flip && !is_last)
            printf(" (%u exposures)", exposures[SIZES - 1]);
        for (uint32_t s = 0; s < SIZES; s++)
            printf(" | %.1f", measure_median(times[from][s], rounds) / (is_last ? exposures[s] : 1));
        printf(" |");
        for (uint32_t s = 0; s < SIZES; s++)
            printf(" %.1f", measure_median(times[from][s], rounds) * 1e6 /
                                ((double)sizes[s][0] * sizes[s][1]) / (is_last ? exposures[s] : 1));
        printf(" |\n");
    }
    return 0;
}
