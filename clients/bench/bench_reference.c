#include "bench_reference.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "../../core/image/image_io.h"
#include "../../core/image/picture.h"
#include "../lib/folder.h"
#include "../lib/progress.h"
#include "../lib/tone.h"

#define PHOTONS_A_FRAME  1048576.0
#define FIRST_SUBFRAMES  16.0
#define LARGEST_SUBFRAME 65536.0

static const char *const plane_names[3] = {"R", "G", "B"};

/* ---- files -----------------------------------------------------------------------------------------------
 */

static bool write_image(const char *path, const float *values, uint32_t width, uint32_t height,
                        const struct image_attribute *attributes, uint32_t attribute_count,
                        struct error *error)
{
    size_t count = (size_t)width * height;
    struct image_plane planes[3];
    float *separate = malloc(3 * count * sizeof *separate);
    if (!separate)
        return error_set(error, STATUS_MEMORY, "%.300s: no memory for %ux%u pixels", path, width, height);
    for (uint32_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < count; i++)
            separate[c * count + i] = values[3 * i + c];
        snprintf(planes[c].name, sizeof planes[c].name, "%s", plane_names[c]);
        planes[c].values = separate + c * count;
    }
    bool is_written = image_write_exr(path,
                                      &(struct image_write_params){.width = width,
                                                                   .height = height,
                                                                   .planes = planes,
                                                                   .plane_count = 3,
                                                                   .attributes = attributes,
                                                                   .attribute_count = attribute_count},
                                      error);
    free(separate);
    return is_written;
}

bool bench_image_write(const char *path, const float *values, uint32_t width, uint32_t height,
                       struct error *error)
{
    return write_image(path, values, width, height, NULL, 0, error);
}

float *bench_image_read(const char *path, uint32_t *width, uint32_t *height, struct error *error)
{
    struct picture picture;
    struct error ignored;
    /* A recording has its caustics in a layer beside the beauty. */
    if (!picture_read(path, &(struct picture_params){.layer = "caustics"}, &picture, &ignored) &&
        !picture_read(path, &(struct picture_params){0}, &picture, error))
        return NULL;
    *width = picture.width;
    *height = picture.height;
    return picture.values;
}

/* ---- the cache -------------------------------------------------------------------------------------------
 */

static uint64_t hash_line(uint64_t hash, const char *name, const char *value)
{
    hash = bench_hash(hash, name, strlen(name) + 1);
    return bench_hash(hash, value, strlen(value) + 1);
}

/* What any device takes; less when there are few, so that they are spread over some frames. */
static double photons_a_frame(const struct bench_config *config)
{
    return fmin(PHOTONS_A_FRAME, fmax(ceil(config->reference_photons / 16), 64));
}

/* A setting of the reference: the configuration's, or ours, or the server's default. */
static void reference_setting(const struct session *session, const struct protocol_setting *setting,
                              char *text, size_t size)
{
    const struct bench_group *given = &session->params->config->reference;
    double value = setting->value;
    if (protocol_text_equals(setting->name, "photons"))
        value = fmin(photons_a_frame(session->params->config), session->hello->limits.max_photons);
    client_setting_print(setting, value, text, size);
    if (protocol_text_equals(setting->name, "aa"))
        snprintf(text, size, "pixel");
    if (protocol_text_equals(setting->name, "density"))
        snprintf(text, size, "uniform");
    for (uint32_t i = 0; i < given->count; i++)
        if (protocol_text_equals(setting->name, given->settings[i].name))
            snprintf(text, size, "%s", given->settings[i].value);
}

static bool is_own_setting(const struct protocol_setting *setting)
{
    return protocol_text_equals(setting->name, "accumulate") || protocol_text_equals(setting->name, "seed");
}

static void reference_key(const struct session *session, char key[20])
{
    const struct bench_config *config = session->params->config;
    const struct bench_scene *scene = session->scene;
    const struct protocol_camera *camera = &scene->camera;
    char text[256];
    uint64_t hash = hash_line(BENCH_HASH_START, "scene", session->content);
    hash = hash_line(hash, "version", session->about.version);
    snprintf(text, sizeof text, "%ux%u %.17g", config->width, config->height, scene->time);
    hash = hash_line(hash, "view", text);
    if (scene->camera_kind == BENCH_CAMERA_FREE)
        snprintf(text, sizeof text, "%.9g %.9g %.9g  %.9g %.9g %.9g  %.9g %.9g %.9g  %.9g",
                 (double)camera->eye[0], (double)camera->eye[1], (double)camera->eye[2],
                 (double)camera->at[0], (double)camera->at[1], (double)camera->at[2], (double)camera->up[0],
                 (double)camera->up[1], (double)camera->up[2], (double)camera->fov);
    else
        snprintf(text, sizeof text, "%s", scene->camera_name);
    hash = hash_line(hash, "camera", text);
    for (uint32_t i = 0; i < session->hello->setting_count; i++) {
        const struct protocol_setting *setting = &session->hello->settings[i];
        char name[PROTOCOL_MAX_TEXT_BYTES + 1];
        if (is_own_setting(setting))
            continue;
        protocol_text_copy(setting->name, name, sizeof name);
        reference_setting(session, setting, text, sizeof text);
        hash = hash_line(hash, name, text);
    }
    bench_hash_text(hash, key);
}

static bool cache_path(const struct session *session, const char *key, char *path, size_t size,
                       struct error *error)
{
    const char *given = session->params->config->cache, *home = getenv("HOME");
    const char *user = getenv("XDG_CACHE_HOME");
    char folder[BENCH_PATH];
    if (*given)
        snprintf(folder, sizeof folder, "%s", given);
    else if (user && *user)
        snprintf(folder, sizeof folder, "%.900s/causticd/references", user);
    else
        snprintf(folder, sizeof folder, "%.900s/.cache/causticd/references", home ? home : "/tmp");
    if (!folder_make(folder, error)) {
        struct error inner = *error;
        return error_set(error, inner.status, "the references' cache %.400s; --cache names another",
                         inner.message);
    }
    snprintf(path, size, "%.900s/%s-%ux%u-%s.exr", folder, session->scene->label,
             session->params->config->width, session->params->config->height, key);
    return true;
}

static double number_attribute(const char *path, const char *name)
{
    char text[64];
    struct error ignored;
    return image_read_exr_string(path, name, text, sizeof text, &ignored) ? strtod(text, NULL) : NAN;
}

/* A kept one that is damaged, or that was made with less patience than is asked for now, is made again. */
static bool cache_read(const struct session *session, const char *path, struct bench_reference *reference)
{
    const struct bench_config *config = session->params->config;
    uint32_t width, height;
    struct error ignored;
    if (access(path, R_OK) != 0)
        return false;
    reference->note.noise = number_attribute(path, "reference.noise");
    reference->note.photons = number_attribute(path, "reference.photons");
    reference->note.has_confidence = reference->note.noise <= config->confidence;
    if (!reference->note.has_confidence && !(reference->note.photons >= config->reference_photons))
        return false;
    reference->values = bench_image_read(path, &width, &height, &ignored);
    if (reference->values && width == config->width && height == config->height)
        return true;
    bench_reference_free(reference);
    return false;
}

static bool cache_write(const struct session *session, const char *path,
                        const struct bench_reference *reference, struct error *error)
{
    const struct bench_config *config = session->params->config;
    char noise[32], photons[32];
    snprintf(noise, sizeof noise, "%.9g", reference->note.noise);
    snprintf(photons, sizeof photons, "%.0f", reference->note.photons);
    const struct image_attribute attributes[] = {
        {.name = "reference.noise", .type = IMAGE_ATTRIBUTE_STRING, .string = noise},
        {.name = "reference.photons", .type = IMAGE_ATTRIBUTE_STRING, .string = photons},
        {.name = "caustic.scene", .type = IMAGE_ATTRIBUTE_STRING, .string = session->scene->label},
        {.name = "caustic.version", .type = IMAGE_ATTRIBUTE_STRING, .string = session->about.version}};
    return write_image(path, reference->values, config->width, config->height, attributes,
                       sizeof attributes / sizeof *attributes, error);
}

/* ---- making one ------------------------------------------------------------------------------------------
 */

/* Sums of subframes; a mean of means, weighted, because a longer run of one seed is better spread than
 * several short ones. */
struct half {
    double *sums, weight;
};

struct making {
    struct session *session;
    struct bench_reference *reference;
    struct half halves[2];
    uint32_t view, seed;
    size_t count;
    double seconds, subframes; /* so far */
};

static bool render_batch(struct making *making, struct half *half, double subframes, struct error *error)
{
    struct session *session = making->session;
    char accumulate[32], seed[32];
    snprintf(accumulate, sizeof accumulate, "%.0f", subframes);
    snprintf(seed, sizeof seed, "%u", ++making->seed);
    const struct option_setting settings[] = {{.name = "accumulate"}, {.name = "seed"}};
    struct option_setting batch[2];
    memcpy(batch, settings, sizeof batch);
    memcpy(batch[0].value, accumulate, sizeof accumulate);
    memcpy(batch[1].value, seed, sizeof seed);
    if (!session_set(session, making->view, batch, 2, error))
        return false;
    uint64_t elapsed = 0;
    struct client_frame *frame = session_render(session, making->view, &elapsed, error);
    if (!frame)
        return false;
    double emitted = session_statistic(session, frame, "photons_emitted");
    for (size_t i = 0; i < making->count; i++)
        half->sums[i] += subframes * (double)frame->values[0][i];
    half->weight += subframes;
    making->reference->note.photons += isfinite(emitted) ? emitted : 0;
    making->seconds += (double)elapsed * 1e-9;
    making->subframes += subframes;
    client_frame_destroy(&frame);
    return true;
}

/* The mean into the reference; its noise from the halves: the mean has half the deviation of their
 * difference. */
static bool measure_halves(struct making *making, struct error *error)
{
    double difference = 0, total = 0;
    for (size_t i = 0; i < making->count; i++) {
        double a = making->halves[0].sums[i] / making->halves[0].weight;
        double b = making->halves[1].sums[i] / making->halves[1].weight;
        if (!isfinite(a) || !isfinite(b))
            return error_set(error, STATUS_INVALID, "a pixel of the reference is not finite");
        difference += fabs(a - b);
        total += fabs(a + b) / 2;
        making->reference->values[i] = (float)((a + b) / 2);
    }
    making->reference->note.noise = total > 0 ? difference / total / 2 : 0;
    return true;
}

/* Subframes of the next batch of each half: as many as the confidence is likely to take, at most twice what
 * is there, within the photons and a quarter of a frame's time. */
static double next_subframes(const struct making *making)
{
    const struct bench_config *config = making->session->params->config;
    const struct bench_reference_note *note = &making->reference->note;
    if (making->subframes == 0) {
        double allowed = ceil(config->reference_photons / (2 * photons_a_frame(config)));
        return fmin(FIRST_SUBFRAMES, fmax(allowed, 2));
    }
    double there = making->subframes / 2, ratio = note->noise / config->confidence;
    double wanted = fmin(there * (ratio * ratio * 1.1 - 1), 2 * there);
    double left = (config->reference_photons - note->photons) / note->photons * there;
    double patience = 0.25e-3 * making->session->params->timeout_ms / (making->seconds / making->subframes);
    wanted = fmin(fmin(wanted, left), fmin(patience, LARGEST_SUBFRAME));
    return fmax(ceil(wanted), 2);
}

static bool grow(struct making *making, struct error *error)
{
    const struct bench_config *config = making->session->params->config;
    struct bench_reference_note *note = &making->reference->note;
    struct progress progress;
    char text[96];
    progress_begin(&progress, 100, making->session->params->is_quiet);
    snprintf(text, sizeof text, "reference of %s", making->session->scene->label);
    bool is_good = true;
    do {
        double subframes = next_subframes(making);
        is_good = render_batch(making, &making->halves[0], subframes, error) &&
                  render_batch(making, &making->halves[1], subframes, error) && measure_halves(making, error);
        note->has_confidence = note->noise <= config->confidence;
        double share = note->noise > 0 ? pow(config->confidence / note->noise, 2) : 1;
        share = fmax(share, note->photons / config->reference_photons);
        while (is_good && progress.done < 99 && progress.done < 100 * share)
            progress_step(&progress, text);
        progress_line(&progress, text);
    } while (is_good && !note->has_confidence && note->photons > 0 &&
             note->photons < config->reference_photons);
    progress_end(&progress);
    return is_good;
}

static bool make_reference(struct session *session, struct bench_reference *reference, struct error *error)
{
    const struct bench_config *config = session->params->config;
    struct making making = {
        .session = session, .reference = reference, .count = (size_t)config->width * config->height * 3};
    reference->values = calloc(making.count, sizeof *reference->values);
    making.halves[0].sums = calloc(making.count, sizeof(double));
    making.halves[1].sums = calloc(making.count, sizeof(double));
    reference->note.photons = 0;
    bool is_made = reference->values && making.halves[0].sums && making.halves[1].sums;
    if (!is_made)
        error_set(error, STATUS_MEMORY, "no memory for a reference of %ux%u pixels", config->width,
                  config->height);
    is_made = is_made && session_view(session, &making.view, error);
    for (uint32_t i = 0; is_made && i < session->hello->setting_count; i++) {
        const struct protocol_setting *setting = &session->hello->settings[i];
        char name[PROTOCOL_MAX_TEXT_BYTES + 1], text[BENCH_TEXT];
        if (is_own_setting(setting))
            continue;
        protocol_text_copy(setting->name, name, sizeof name);
        reference_setting(session, setting, text, sizeof text);
        is_made = client_view_set(session->client, making.view, name, text, error);
    }
    is_made = is_made && grow(&making, error) && client_view_destroy(session->client, making.view, error);
    free(making.halves[0].sums);
    free(making.halves[1].sums);
    return is_made;
}

static bool read_given(const struct session *session, struct bench_reference *reference, struct error *error)
{
    const struct bench_config *config = session->params->config;
    const char *path = session->scene->reference;
    uint32_t width, height;
    reference->values = bench_image_read(path, &width, &height, error);
    if (!reference->values)
        return false;
    if (width != config->width || height != config->height)
        return error_set(error, STATUS_INVALID, "%.300s: is %ux%u pixels, the points are %ux%u", path, width,
                         height, config->width, config->height);
    struct measure_image image = {reference->values, width, height, 3};
    size_t broken = measure_non_finite_pixels(&image);
    if (broken)
        return error_set(error, STATUS_INVALID, "%.300s: %zu pixels are not finite", path, broken);
    reference->note.photons = reference->note.noise = NAN;
    reference->note.has_confidence = true;
    snprintf(reference->note.file, sizeof reference->note.file, "%s", path);
    bench_hash_text(bench_hash(BENCH_HASH_START, reference->values,
                               (size_t)width * height * 3 * sizeof *reference->values),
                    reference->note.key);
    return true;
}

bool bench_reference_get(struct session *session, struct bench_reference *reference, struct error *error)
{
    memset(reference, 0, sizeof *reference);
    struct bench_reference_note *note = &reference->note;
    snprintf(note->scene, sizeof note->scene, "%s", session->scene->label);
    bool is_there;
    if (*session->scene->reference) {
        is_there = read_given(session, reference, error);
    } else {
        reference_key(session, note->key);
        is_there =
            cache_path(session, note->key, note->file, sizeof note->file, error) &&
            (cache_read(session, note->file, reference) ||
             (make_reference(session, reference, error) ? cache_write(session, note->file, reference, error)
                                                        : session_explain(session, error, "the reference")));
    }
    if (!is_there) {
        bench_reference_free(reference);
        return false;
    }
    const struct bench_config *config = session->params->config;
    reference->exposure = tone_exposure(reference->values, (size_t)config->width * config->height);
    return true;
}

void bench_reference_free(struct bench_reference *reference)
{
    free(reference->values);
    reference->values = NULL;
}
