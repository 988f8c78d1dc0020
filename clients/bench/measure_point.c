#include "measure_point.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t hash_text(uint64_t hash, const char *text)
{
    return bench_hash(hash, text, strlen(text) + 1);
}

static int compare_settings(const void *a, const void *b)
{
    const struct option_setting *x = a, *y = b;
    return strcmp(x->name, y->name);
}

void point_describe(const struct session *session, const struct bench_reference *reference,
                    const struct bench_point *point, struct bench_result *result)
{
    const struct bench_config *config = session->params->config;
    const struct protocol_camera *camera = &session->scene->camera;
    memset(result, 0, sizeof *result);
    snprintf(result->scene, sizeof result->scene, "%s", session->scene->label);
    if (config->method_count)
        snprintf(result->method, sizeof result->method, "%s", config->methods[point->method].name);
    snprintf(result->reference, sizeof result->reference, "%s", reference->note.key);
    result->width = config->width;
    result->height = config->height;
    result->time = session->scene->time;
    result->setting_count = point->setting_count;
    memcpy(result->settings, point->settings, sizeof result->settings);

    struct option_setting sorted[BENCH_MAX_SET];
    memcpy(sorted, point->settings, sizeof sorted);
    qsort(sorted, point->setting_count, sizeof *sorted, compare_settings);
    const char *const texts[] = {
        session->about.version, session->about.build,       session->about.device, session->about.driver,
        session->about.tracer,  session->content,           result->scene,         result->method,
        result->reference,      session->scene->camera_name};
    uint64_t hash = BENCH_HASH_START;
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        hash = hash_text(hash, texts[i]);
    for (uint32_t i = 0; i < point->setting_count; i++)
        hash = hash_text(hash_text(hash, sorted[i].name), sorted[i].value);
    const double numbers[] = {config->width, config->height, config->warmup, config->repeats, result->time};
    hash = bench_hash(hash, numbers, sizeof numbers);
    hash = bench_hash(hash, config->metrics, sizeof config->metrics);
    if (session->scene->camera_kind == BENCH_CAMERA_FREE)
        hash = bench_hash(hash, camera, sizeof *camera);
    bench_hash_text(hash, result->key);
    snprintf(result->image, sizeof result->image, "points/%s.exr", result->key);
}

/* What the repeats said, one array per number. */
struct samples {
    uint32_t count, capacity;
    double *gpu, *wall, *frame, *measures[METRIC_COUNT];
    double *statistics, *passes; /* number i of repeat k at i * capacity + k */
    double *memory;              /* all of the above */
};

static bool samples_begin(struct samples *samples, uint32_t repeats)
{
    size_t arrays = 3 + METRIC_COUNT + PROTOCOL_MAX_STATISTICS + PROTOCOL_MAX_PASSES;
    *samples = (struct samples){.capacity = repeats};
    samples->memory = calloc(arrays * repeats, sizeof *samples->memory);
    if (!samples->memory)
        return false;
    samples->gpu = samples->memory;
    samples->wall = samples->gpu + repeats;
    samples->frame = samples->wall + repeats;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        samples->measures[i] = samples->frame + (1 + (size_t)i) * repeats;
    samples->statistics = samples->frame + (1 + (size_t)METRIC_COUNT) * repeats;
    samples->passes = samples->statistics + (size_t)PROTOCOL_MAX_STATISTICS * repeats;
    return true;
}

/* A pass that a frame did not have took no time in it. */
static void add_passes(struct samples *samples, const struct protocol_frame *info,
                       struct bench_result *result)
{
    for (uint32_t i = 0; i < info->pass_count; i++) {
        uint32_t place = 0;
        while (place < result->pass_count &&
               !protocol_text_equals(info->passes[i].name, result->passes_ns[place].name))
            place++;
        if (place == result->pass_count) {
            if (place == PROTOCOL_MAX_PASSES)
                continue;
            protocol_text_copy(info->passes[i].name, result->passes_ns[place].name, BENCH_TEXT);
            result->pass_count++;
        }
        samples->passes[(size_t)place * samples->capacity + samples->count] +=
            (double)info->passes[i].elapsed_ns;
    }
}

static bool add_sample(struct session *session, const struct bench_reference *reference,
                       const struct client_frame *frame, uint64_t wall_ns, struct samples *samples,
                       struct bench_result *result, struct error *error)
{
    const struct bench_config *config = session->params->config;
    uint32_t k = samples->count;
    samples->gpu[k] = session_statistic(session, frame, "gpu_ns");
    samples->frame[k] = session_statistic(session, frame, "frame_ns");
    samples->wall[k] = (double)wall_ns;
    result->statistic_count = session->hello->statistic_count;
    for (uint32_t i = 0; i < result->statistic_count; i++) {
        protocol_text_copy(session->hello->statistics[i].name, result->statistics[i].name, BENCH_TEXT);
        samples->statistics[(size_t)i * samples->capacity + k] =
            i < frame->info.statistic_count ? frame->info.statistics[i] : NAN;
    }
    add_passes(samples, &frame->info, result);
    struct measure_image image = {frame->values[0], config->width, config->height, 3};
    struct measure_image truth = {reference->values, config->width, config->height, 3};
    double values[METRIC_COUNT];
    if (!metrics_compute(&image, &truth, reference->exposure, config->metrics, NULL, values, error))
        return false;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        samples->measures[i][k] = values[i];
    samples->count++;
    return true;
}

static void conclude(struct samples *samples, struct bench_result *result)
{
    uint32_t count = samples->count;
    result->gpu_ns = bench_spread_of(samples->gpu, count);
    result->wall_ns = bench_spread_of(samples->wall, count);
    result->frame_ns = bench_spread_of(samples->frame, count);
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        result->measures[i] = bench_spread_of(samples->measures[i], count);
    for (uint32_t i = 0; i < result->statistic_count; i++)
        result->statistics[i].value =
            bench_spread_of(samples->statistics + (size_t)i * samples->capacity, count).median;
    for (uint32_t i = 0; i < result->pass_count; i++)
        result->passes_ns[i].value =
            bench_spread_of(samples->passes + (size_t)i * samples->capacity, count).median;
}

bool point_measure(struct session *session, const struct bench_reference *reference, const char *folder,
                   struct bench_result *result, struct progress *progress, struct error *error)
{
    const struct bench_config *config = session->params->config;
    struct samples samples;
    uint32_t view = 0;
    char name[600], prefix[192], path[BENCH_PATH + 128];
    bench_result_name(result, NULL, name, sizeof name);
    snprintf(prefix, sizeof prefix, "%s %.100s", result->scene, name);
    if (!samples_begin(&samples, config->repeats))
        return error_set(error, STATUS_MEMORY, "%s: no memory for %u repeats", prefix, config->repeats);
    snprintf(path, sizeof path, "%s/%s", folder, result->image);
    bool is_done = session_view(session, &view, error) &&
                   session_set(session, view, result->settings, result->setting_count, error);
    for (uint32_t i = 0; is_done && i < config->warmup + config->repeats; i++) {
        uint64_t wall_ns;
        struct client_frame *frame = session_render(session, view, &wall_ns, error);
        is_done = frame && (i < config->warmup ||
                            add_sample(session, reference, frame, wall_ns, &samples, result, error));
        if (is_done && i + 1 == config->warmup + config->repeats)
            is_done = bench_image_write(path, frame->values[0], config->width, config->height, error);
        client_frame_destroy(&frame);
        progress_step(progress, prefix);
    }
    if (is_done)
        is_done = client_view_destroy(session->client, view, error);
    if (is_done) {
        conclude(&samples, result);
        progress_line(progress, prefix);
    }
    free(samples.memory);
    return is_done || session_explain(session, error, prefix);
}
