/* bench_lookup.c: caustics seen through glass and mirrors: their error against a converged picture, and what
 * they add to a frame, for the three built-in views that show them.
 *
 * Error: relative L1 of channel `indirect` after some frames of feedback, raw and of 3x3 means, against the
 * mean of two accumulations with moved photons and camera rays. Half of what the two differ by is the
 * reference's own noise.
 * Cost: frames with `caustics` alone and with `indirect` beside it, one of each in turn. Time of the process
 * over all its threads is what a frame takes of a device that is this CPU, whatever else runs on it; on other
 * devices only the wall's time means something.
 */
#include <string.h>
#include <time.h>

#include "bench/measure.h"
#include "core/measure/image_measure.h"
#include "core/render/renderer.h"

#define WARM_UP    6u
#define MAX_ROUNDS 101u
#define MAX_SETS   16

#define REFERENCE_PHOTONS                                                                                    \
    16384 /* of each subframe: many camera rays matter more than many photons at a time */

static const struct scenery {
    const char *scene, *camera;
    uint32_t camera_index;
} sceneries[] = {{"cube", "its own", 0}, {"square", "behind", 1}, {"pool", "above", 1}};
#define SCENERY_COUNT (sizeof sceneries / sizeof *sceneries)

struct options {
    uint32_t width, height, rounds, subframes;
    const char *pictures; /* folder; NULL: none are written */
    const char *sets[MAX_SETS];
    uint32_t set_count;
    const char *scene; /* NULL: all */
};

struct stage {
    struct scene *scene;
    struct renderer *renderer;
};

static void stage_open(struct stage *stage, struct gpu *gpu, const struct scenery *scenery)
{
    struct error error;
    stage->scene = scene_create_builtin(scenery->scene, &error);
    stage->renderer =
        stage->scene ? renderer_create(&(struct renderer_params){.gpu = gpu, .scene = stage->scene}, &error)
                     : NULL;
    if (!stage->renderer)
        measure_die(&error);
}

static void stage_close(struct stage *stage)
{
    renderer_destroy(&stage->renderer);
    scene_destroy(&stage->scene);
}

static void set(struct view *view, enum setting_id id, double value)
{
    struct error error;
    if (!view_set_setting(view, id, value, &error))
        measure_die(&error);
}

static struct view *make_view(struct stage *stage, const struct scenery *scenery,
                              const struct options *options)
{
    struct error error;
    struct view *view = view_create(stage->renderer, options->width, options->height, &error);
    if (!view || !view_follow_camera(view, scenery->camera_index, &error))
        measure_die(&error);
    for (uint32_t i = 0; i < options->set_count; i++) {
        char name[64];
        const char *value = strchr(options->sets[i], '=');
        snprintf(name, sizeof name, "%.*s", (int)(value - options->sets[i]), options->sets[i]);
        struct settings settings = *view_settings(view);
        if (!settings_set_text(&settings, name, value + 1, &error))
            measure_die(&error);
        for (int id = 0; id < SETTING_COUNT; id++)
            set(view, (enum setting_id)id, settings_get(&settings, (enum setting_id)id));
    }
    return view;
}

static const struct frame_result *render(struct view *view, uint32_t channel_mask)
{
    struct error error;
    const struct frame_result *result = view_render(view, channel_mask, &error);
    if (!result)
        measure_die(&error);
    return result;
}

/* ---- error --------------------------------------------------------------------------------------------- */

static void write_picture(const struct options *options, const char *scene, const char *name,
                          const float *values)
{
    char path[512];
    if (!options->pictures)
        return;
    snprintf(path, sizeof path, "%s/%s-%s.pfm", options->pictures, scene, name);
    FILE *file = fopen(path, "wb");
    bool done = file && fprintf(file, "PF\n%u %u\n-1.0\n", options->width, options->height) > 0;
    for (uint32_t y = options->height; done && y-- > 0;)
        done = fwrite(values + (size_t)3 * y * options->width, sizeof *values * 3, options->width, file) ==
               options->width;
    if (!file || fclose(file) != 0 || !done) {
        fprintf(stderr, "bench: cannot write %s\n", path);
        exit(1);
    }
}

static double smooth_l1(const struct measure_image *image, const struct measure_image *reference,
                        float *space)
{
    size_t values = (size_t)image->width * image->height * image->components;
    struct measure_image a = *image, b = *reference;
    measure_box3(image, space);
    measure_box3(reference, space + values);
    a.values = space;
    b.values = space + values;
    return measure_relative_l1(&a, &b);
}

static void bench_error(struct gpu *gpu, const struct options *options)
{
    size_t count = (size_t)options->width * options->height * 3;
    float *space = measure_allocate(6 * count, sizeof *space);
    float *half[2] = {space, space + count}, *mean = space + 2 * count, *seen = space + 3 * count;
    printf(
        "\nRelative L1 of `indirect`, %ux%u, after %u frames; %u subframes in either half of the "
        "reference\n\n"
        "| scene | camera | relative L1 | 3x3 | flux | reference's noise | 3x3 | pixels | photons emitted |\n"
        "|---|---|---|---|---|---|---|---|---|\n",
        options->width, options->height, WARM_UP, options->subframes);
    for (size_t i = 0; i < SCENERY_COUNT; i++) {
        if (options->scene && strcmp(options->scene, sceneries[i].scene) != 0)
            continue;
        struct stage stage;
        stage_open(&stage, gpu, &sceneries[i]);
        struct view *view = make_view(&stage, &sceneries[i], options);
        const struct frame_result *result = NULL;
        for (uint32_t k = 0; k < WARM_UP; k++)
            result = render(view, 1u << CHANNEL_INDIRECT);
        memcpy(seen, result->channels[0].values, count * sizeof *seen);
        double pixels = result->stats[STAT_pixels_looked_up], emitted = result->stats[STAT_photons_emitted];
        for (int k = 0; k < 2; k++) {
            set(view, SETTING_seed, 1000 + k);
            set(view, SETTING_accumulate, options->subframes);
            set(view, SETTING_photons, REFERENCE_PHOTONS);
            memcpy(half[k], render(view, 1u << CHANNEL_INDIRECT)->channels[0].values, count * sizeof *seen);
        }
        for (size_t k = 0; k < count; k++)
            mean[k] = 0.5f * (half[0][k] + half[1][k]);
        struct measure_image image = {seen, options->width, options->height, 3}, reference = image, a = image,
                             b = image;
        reference.values = mean;
        a.values = half[0];
        b.values = half[1];
        printf("| %s | %s | %.3f | %.3f | %.3f | %.3f | %.3f | %.0f | %.0f |\n", sceneries[i].scene,
               sceneries[i].camera, measure_relative_l1(&image, &reference),
               smooth_l1(&image, &reference, space + 4 * count), 1 + measure_flux(&image, &reference),
               0.5 * measure_relative_l1(&a, &b), 0.5 * smooth_l1(&a, &b, space + 4 * count), pixels,
               emitted);
        fflush(stdout);
        write_picture(options, sceneries[i].scene, "seen", seen);
        write_picture(options, sceneries[i].scene, "reference", mean);
        view_destroy(&view);
        stage_close(&stage);
    }
    free(space);
}

/* ---- cost ---------------------------------------------------------------------------------------------- */

enum subject { DIRECT, INDIRECT, SUBJECTS };

static double process_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static void bench_cost(struct gpu *gpu, const struct options *options)
{
    static const uint32_t masks[SUBJECTS] = {1u << CHANNEL_CAUSTICS,
                                             1u << CHANNEL_CAUSTICS | 1u << CHANNEL_INDIRECT};
    printf("\nTime of a frame, %ux%u, medians of %u rounds: `caustics` alone, and with `indirect`\n\n"
           "| scene | camera | alone: wall, ms | process, ms | photons | with: wall, ms | process, ms | "
           "photons | "
           "pass lookup, ms | others, ms | ratio, wall | ratio, process |\n"
           "|---|---|---|---|---|---|---|---|---|---|---|---|\n",
           options->width, options->height, options->rounds);
    for (size_t i = 0; i < SCENERY_COUNT; i++) {
        if (options->scene && strcmp(options->scene, sceneries[i].scene) != 0)
            continue;
        static double wall[SUBJECTS][MAX_ROUNDS], process[SUBJECTS][MAX_ROUNDS], lookup[MAX_ROUNDS],
            others[MAX_ROUNDS];
        double emitted[SUBJECTS] = {0};
        struct stage stage;
        stage_open(&stage, gpu, &sceneries[i]);
        struct view *views[SUBJECTS];
        for (int k = 0; k < SUBJECTS; k++)
            views[k] = make_view(&stage, &sceneries[i], options);
        for (uint32_t round = 0; round < WARM_UP + options->rounds; round++)
            for (int k = 0; k < SUBJECTS; k++) {
                double begin = process_ms();
                const struct frame_result *result = render(views[k], masks[k]);
                if (round < WARM_UP)
                    continue;
                uint32_t at = round - WARM_UP;
                process[k][at] = process_ms() - begin;
                wall[k][at] = 1e-6 * result->stats[STAT_frame_ns];
                emitted[k] = result->stats[STAT_photons_emitted];
                if (k == DIRECT)
                    continue;
                lookup[at] = others[at] = 0;
                for (uint32_t pass = 0; pass < result->pass_count; pass++) {
                    double *sum = strcmp(result->passes[pass].name, "lookup") == 0 ? lookup : others;
                    sum[at] += 1e-6 * (double)result->passes[pass].elapsed_ns;
                }
            }
        double median[SUBJECTS][2];
        for (int k = 0; k < SUBJECTS; k++) {
            median[k][0] = measure_median(wall[k], options->rounds);
            median[k][1] = measure_median(process[k], options->rounds);
        }
        printf("| %s | %s | %.2f | %.2f | %.0f | %.2f | %.2f | %.0f | %.2f | %.2f | %.2f | **%.2f** |\n",
               sceneries[i].scene, sceneries[i].camera, median[DIRECT][0], median[DIRECT][1], emitted[DIRECT],
               median[INDIRECT][0], median[INDIRECT][1], emitted[INDIRECT],
               measure_median(lookup, options->rounds), measure_median(others, options->rounds),
               median[INDIRECT][0] / median[DIRECT][0], median[INDIRECT][1] / median[DIRECT][1]);
        fflush(stdout);
        for (int k = 0; k < SUBJECTS; k++)
            view_destroy(&views[k]);
        stage_close(&stage);
    }
}

/* -------------------------------------------------------------------------------------------------------- */

static const struct {
    const char *name;
    void (*run)(struct gpu *gpu, const struct options *options);
} tables[] = {{"error", bench_error}, {"cost", bench_cost}};
#define TABLE_COUNT (sizeof tables / sizeof *tables)

static const char usage[] =
    "usage: bench-lookup [--device NAME] [--rounds N] [--size WxH] [--subframes N] [--set NAME=VALUE]...\n"
    "                    [--scene NAME] [--pictures FOLDER] [TABLE...]\n"
    "Caustics seen through glass and mirrors, in Markdown. TABLE is error or cost; both when none is given.\n"
    "Medians of N rounds (7) of 160x90; references of twice 128 subframes. --pictures writes what is "
    "compared\n"
    "as PFM into a folder that exists.\n";

static bool parse_option(const char *name, const char *value, struct options *options,
                         struct gpu_params *params)
{
    char rest;
    if (strcmp(name, "--device") == 0)
        params->device = value;
    else if (strcmp(name, "--pictures") == 0)
        options->pictures = value;
    else if (strcmp(name, "--scene") == 0)
        options->scene = value;
    else if (strcmp(name, "--rounds") == 0)
        return sscanf(value, "%u%c", &options->rounds, &rest) == 1 && options->rounds >= 1 &&
               options->rounds <= MAX_ROUNDS;
    else if (strcmp(name, "--subframes") == 0)
        return sscanf(value, "%u%c", &options->subframes, &rest) == 1;
    else if (strcmp(name, "--size") == 0)
        return sscanf(value, "%ux%u%c", &options->width, &options->height, &rest) == 2;
    else if (strcmp(name, "--set") == 0 && options->set_count < MAX_SETS && strchr(value, '='))
        options->sets[options->set_count++] = value;
    else
        return false;
    return true;
}

int main(int argc, char **argv)
{
    struct gpu_params params = {0};
    struct options options = {.width = 160, .height = 90, .rounds = 7, .subframes = 128};
    bool is_chosen[TABLE_COUNT] = {false}, is_good = true;
    int first = 1;
    for (; is_good && first + 1 < argc && strncmp(argv[first], "--", 2) == 0; first += 2)
        is_good = parse_option(argv[first], argv[first + 1], &options, &params);
    for (int i = first; i < argc; i++) {
        size_t table = 0;
        while (table < TABLE_COUNT && strcmp(tables[table].name, argv[i]) != 0)
            table++;
        if (table < TABLE_COUNT)
            is_chosen[table] = true;
        is_good = is_good && table < TABLE_COUNT;
    }
    if (!is_good) {
        bool is_help = argc > 1 && strcmp(argv[1], "--help") == 0;
        fputs(usage, is_help ? stdout : stderr);
        return is_help ? 0 : 2;
    }
    struct error error;
    struct gpu *gpu = gpu_create(&params, &error);
    if (!gpu)
        measure_die(&error);
    printf("%s, %s\n", gpu_info(gpu)->name, gpu_info(gpu)->driver);
    for (size_t i = 0; i < TABLE_COUNT; i++)
        if (first == argc || is_chosen[i])
            tables[i].run(gpu, &options);
    gpu_destroy(&gpu);
    return 0;
}
