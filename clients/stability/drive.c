#include "drive.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "../../core/measure/image_measure.h"

#define PROBE_FRAMES 4u  /* enough for photons to have found the caustic */
#define MAX_FLIPS    96u /* of a path: a long one is sampled */

static double seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

static size_t pixel_count(const struct drive *drive)
{
    return (size_t)drive->width * drive->height;
}

/* ---- a view -------------------------------------------------------------------------------------------- */

struct shown {
    uint32_t view;
    bool is_set;
    struct path_state state;
};

static bool create_view(struct drive *drive, struct shown *shown, struct error *error)
{
    const struct stability_options *options = drive->options;
    *shown = (struct shown){0};
    if (!client_view_create(drive->client, drive->width, drive->height, &shown->view, error))
        return false;
    for (uint32_t i = 0; i < options->setting_count; i++)
        if (!client_view_set(drive->client, shown->view, options->settings[i].name,
                             options->settings[i].value, error))
            return false;
    if (options->camera)
        return client_view_follow(drive->client, shown->view, options->camera, error);
    if (options->has_eye)
        return client_view_camera(drive->client, shown->view, &options->free_camera, error);
    return true;
}

/* Sends what differs from what the view shows already. */
static bool show(struct drive *drive, struct shown *shown, const struct path_state *state,
                 struct error *error)
{
    const struct path_state *old = &shown->state;
    bool is_first = !shown->is_set;
    if (state->has_camera && (is_first || memcmp(&state->camera, &old->camera, sizeof state->camera) != 0) &&
        !client_view_camera(drive->client, shown->view, &state->camera, error))
        return false;
    if (state->has_light &&
        (is_first || memcmp(state->position, old->position, sizeof state->position) != 0 ||
         memcmp(state->direction, old->direction, sizeof state->direction) != 0)) {
        struct protocol_view_light change = {.view = shown->view, .light = drive->light_index};
        uint8_t type = drive->base.light.type;
        if (type != PROTOCOL_LIGHT_DIRECTIONAL) {
            change.overrides |= PROTOCOL_LIGHT_POSITION;
            memcpy(change.position, state->position, sizeof change.position);
        }
        if (type != PROTOCOL_LIGHT_POINT) {
            change.overrides |= PROTOCOL_LIGHT_DIRECTION;
            memcpy(change.direction, state->direction, sizeof change.direction);
        }
        if (!client_view_light(drive->client, &change, error))
            return false;
    }
    if ((is_first ? state->time != 0 : state->time != old->time) &&
        !client_view_time(drive->client, shown->view, state->time, error))
        return false;
    if (drive->path == PATH_SETTINGS_FLICKER && (is_first || state->is_second != old->is_second) &&
        !client_view_setting(drive->client, shown->view, drive->flicker_setting,
                             drive->flicker_values[state->is_second], error))
        return false;
    shown->is_set = true;
    shown->state = *state;
    return true;
}

static struct client_frame *render(struct drive *drive, uint32_t view, uint32_t channels, struct error *error)
{
    return client_render(
        drive->client, view,
        &(struct client_render_params){.channels = channels,
                                       .encoding = PROTOCOL_ZSTD,
                                       .timeout_ms = (uint32_t)(drive->options->timeout * 1000)},
        error);
}

/* The measured channel of a frame as a picture; takes the frame's memory. */
static bool take_picture(const struct drive *drive, struct client_frame *frame, struct snapshot *picture,
                         struct error *error)
{
    for (uint32_t i = 0; i < frame->info.channel_count; i++) {
        const struct protocol_channel *channel = &frame->info.channels[i];
        if (channel->channel != drive->channel)
            continue;
        if (channel->width != drive->width || channel->height != drive->height || channel->components != 3)
            return error_set(error, STATUS_UNSUPPORTED, "channel %s is not a picture of 3 components",
                             drive->options->channel);
        size_t wrong =
            measure_non_finite(&(struct measure_image){frame->values[i], channel->width, channel->height, 3});
        if (wrong)
            return error_set(error, STATUS_INVALID, "%zu values of channel %s are NaN or infinite", wrong,
                             drive->options->channel);
        float *rgb = frame->values[i];
        frame->values[i] = NULL;
        return snapshot_make(rgb, channel->width, channel->height, picture, error);
    }
    return error_set(error, STATUS_IO, "the server left out channel %s", drive->options->channel);
}

/* ---- beginning ----------------------------------------------------------------------------------------- */

static bool find_statistic(const struct protocol_hello *hello, const char *name, uint32_t *index,
                           struct error *error)
{
    for (*index = 0; *index < hello->statistic_count; ++*index)
        if (protocol_text_equals(hello->statistics[*index].name, name))
            return true;
    return error_set(error, STATUS_UNSUPPORTED, "the server has no statistic %s", name);
}

static bool find_flicker(struct drive *drive, struct error *error)
{
    const struct option_setting *flicker = &drive->options->flicker;
    const char *comma = strchr(flicker->value, ',');
    char first[64];
    if (!client_find_setting(drive->client, flicker->name, &drive->flicker_setting, error))
        return false;
    const struct protocol_setting *setting = &drive->hello->settings[drive->flicker_setting];
    memcpy(first, flicker->value, (size_t)(comma - flicker->value));
    first[comma - flicker->value] = 0;
    return client_setting_parse(setting, first, &drive->flicker_values[0], error) &&
           client_setting_parse(setting, comma + 1, &drive->flicker_values[1], error);
}

/* The middle of the caustic light in the world, from a picture and its depths. */
static bool find_pivot(struct drive *drive, const struct client_frame *frame, const struct snapshot *picture,
                       const float *depth, struct error *error)
{
    size_t count = pixel_count(drive);
    double threshold = temporal_caustic_threshold(picture->luminance, count, drive->options->caustic_share);
    const float *to_camera = frame->info.world_to_camera, *to_clip = frame->info.camera_to_clip;
    double sum[3] = {0, 0, 0}, weight = 0;
    for (uint32_t y = 0; y < drive->height; y++) {
        for (uint32_t x = 0; x < drive->width; x++) {
            size_t i = (size_t)y * drive->width + x;
            double light = (double)picture->luminance[i], z = (double)depth[i];
            if (!(light >= threshold) || !isfinite(z))
                continue;
            double right = ((x + 0.5) * 2 / drive->width - 1) * z / (double)to_clip[0];
            double up = ((y + 0.5) * 2 / drive->height - 1) * z / (double)to_clip[5];
            for (int k = 0; k < 3; k++)
                sum[k] += light * ((double)to_camera[4 * k] * right + (double)to_camera[4 * k + 1] * up -
                                   (double)to_camera[4 * k + 2] * z);
            weight += light;
        }
    }
    if (!(weight > 0)) {
        char reason[200];
        protocol_text_copy(frame->info.black_reason, reason, sizeof reason);
        return error_set(error, STATUS_INVALID, "the picture has no caustic light to measure: %s",
                         *reason ? reason : "this camera sees none; choose another with --eye and --at");
    }
    for (int k = 0; k < 3; k++)
        drive->base.pivot[k] = (float)((double)frame->info.camera.eye[k] + sum[k] / weight);
    return true;
}

/* A seed that the paths do not use. */
static bool find_other_seed(struct drive *drive, struct error *error)
{
    if (!client_find_setting(drive->client, "seed", &drive->seed, error))
        return false;
    const struct protocol_setting *setting = &drive->hello->settings[drive->seed];
    double used = setting->value;
    for (uint32_t i = 0; i < drive->options->setting_count; i++)
        if (strcmp(drive->options->settings[i].name, "seed") == 0 &&
            !client_setting_parse(setting, drive->options->settings[i].value, &used, error))
            return false;
    drive->other_seed = used + 7919 <= setting->maximum ? used + 7919 : used - 7919;
    return true;
}

static bool probe(struct drive *drive, struct error *error)
{
    struct shown shown;
    struct client_frame *frame = NULL;
    struct snapshot picture = {0};
    uint32_t depth, channels;
    if (!client_find_channel(drive->client, "depth", &depth, error))
        return false;
    if (!create_view(drive, &shown, error))
        return false;
    channels = 1u << drive->channel | 1u << depth;
    for (uint32_t i = 0; i < PROBE_FRAMES; i++) {
        client_frame_destroy(&frame);
        if (!(frame = render(drive, shown.view, channels, error)))
            return false;
    }
    drive->base.camera = frame->info.camera;
    const float *depths = NULL;
    for (uint32_t i = 0; i < frame->info.channel_count; i++)
        if (frame->info.channels[i].channel == depth)
            depths = frame->values[i];
    bool is_found =
        take_picture(drive, frame, &picture, error) && find_pivot(drive, frame, &picture, depths, error);
    if (is_found)
        drive->exposure = snapshot_exposure(&picture);
    snapshot_free(&picture);
    client_frame_destroy(&frame);
    return is_found && client_view_destroy(drive->client, shown.view, error);
}

bool drive_begin(struct drive *drive, struct error *error)
{
    static const char *const names[STATISTIC_COUNT] = {"photons_emitted", "density_total", "density_largest"};
    const struct stability_options *options = drive->options;
    drive->hello = client_hello(drive->client);
    drive->base = options->base;
    drive->base.duration = drive->hello->duration;
    drive->base.width_over_height = (double)options->width / options->height;
    drive->width = options->width;
    drive->height = options->height;
    for (int i = 0; i < STATISTIC_COUNT; i++)
        if (!find_statistic(drive->hello, names[i], &drive->statistic[i], error))
            return false;
    uint32_t light = 0;
    if (options->light && !client_find_light(drive->client, options->light, &light, error))
        return false;
    drive->base.has_light = drive->hello->light_count > 0;
    if (drive->base.has_light)
        drive->base.light = drive->hello->lights[light];
    drive->light_index = light;
    return client_find_channel(drive->client, options->channel, &drive->channel, error) &&
           client_find_setting(drive->client, "accumulate", &drive->accumulate, error) &&
           find_other_seed(drive, error) && find_flicker(drive, error) && probe(drive, error);
}

/* ---- a path -------------------------------------------------------------------------------------------- */

void drive_clear(struct drive *drive)
{
    for (int i = 0; i < STATISTIC_COUNT; i++) {
        free(drive->series[i]);
        drive->series[i] = NULL;
    }
    free(drive->light);
    free(drive->flip);
    free(drive->successive);
    drive->light = drive->flip = drive->successive = NULL;
    temporal_pixels_destroy(&drive->pixels);
    for (uint32_t i = 0; drive->kept && i <= drive->frames; i++)
        snapshot_free(&drive->kept[i]);
    free(drive->kept);
    drive->kept = NULL;
    for (uint32_t i = 0; i < drive->pair_count; i++) {
        struct drive_pair *pair = &drive->pairs[i];
        snapshot_free(&pair->before);
        snapshot_free(&pair->now);
        snapshot_free(&pair->reference_before);
        snapshot_free(&pair->reference_now);
    }
    free(drive->pairs);
    drive->pairs = NULL;
    snapshot_free(&drive->first);
    snapshot_free(&drive->last);
    snapshot_free(&drive->reference);
    snapshot_free(&drive->reference_other);
    drive->pair_count = drive->done = drive->reference_frames = 0;
    drive->frame_seconds = drive->reference_seconds = 0;
}

static bool keeps_frames(enum path_id path)
{
    return path_infos[path].kind == PATH_STEPS || path_infos[path].kind == PATH_ALTERNATES;
}

static uint32_t pairs_of(const struct stability_options *options, enum path_id path)
{
    if (options->pairs == 0)
        return 0;
    return path_infos[path].kind == PATH_MOVES ? options->pairs : path_infos[path].kind == PATH_STEPS ? 1 : 0;
}

/* Two for every pair, and of the last state one more with another seed; what rests has no pair, and one for
 * its last state. */
static uint32_t references_of(const struct stability_options *options, enum path_id path)
{
    uint32_t pairs = pairs_of(options, path);
    return options->pairs == 0 ? 0 : pairs > 0 ? 2 * pairs + 1 : 2;
}

uint32_t drive_frame_count(const struct stability_options *options, enum path_id path, uint32_t frames)
{
    return options->warmup + frames + references_of(options, path) * options->accumulate;
}

static bool prepare(struct drive *drive, enum path_id path, uint32_t frames, struct error *error)
{
    const struct stability_options *options = drive->options;
    drive_clear(drive);
    drive->path = path;
    drive->warmup = options->warmup;
    drive->frames = frames;
    uint32_t all = drive->warmup + frames, pairs = pairs_of(options, path);
    bool is_ok = true;
    for (int i = 0; i < STATISTIC_COUNT; i++)
        is_ok &= (drive->series[i] = calloc(all, sizeof(double))) != NULL;
    is_ok &= (drive->light = calloc(all, sizeof(double))) != NULL;
    is_ok &= (drive->flip = calloc(all, sizeof(double))) != NULL;
    is_ok &= (drive->successive = calloc(all, sizeof(double))) != NULL;
    if (keeps_frames(path))
        is_ok &= (drive->kept = calloc((size_t)frames + 1, sizeof *drive->kept)) != NULL;
    if (pairs > 0) {
        is_ok &= (drive->pairs = calloc(pairs, sizeof *drive->pairs)) != NULL;
        drive->pair_count = drive->pairs ? pairs : 0;
    }
    if (!is_ok)
        return error_set(error, STATUS_MEMORY, "no memory for %u frames", all);
    for (uint32_t i = 0; i < drive->pair_count; i++) /* evenly over the path; a step has its own frame 0 */
        drive->pairs[i].frame = keeps_frames(path) ? 0 : 1 + (int64_t)((i + 0.5) / pairs * (frames - 1));
    if (path_infos[path].kind == PATH_MOVES || path_infos[path].kind == PATH_STEPS)
        return true;
    return (drive->pixels = temporal_pixels_create(drive->width, drive->height, error)) != NULL;
}

/* Keeps of a frame what is needed of it later; the picture stays the caller's. */
static bool keep(struct drive *drive, int64_t frame, const struct snapshot *picture,
                 const struct snapshot *before, struct error *error)
{
    uint32_t at = (uint32_t)(frame + drive->warmup), flips = drive->frames / MAX_FLIPS + 1;
    size_t count = snapshot_pixels(picture);
    drive->light[at] = 0;
    for (size_t i = 0; i < count; i++)
        drive->light[at] += (double)picture->luminance[i];
    drive->light[at] /= (double)count;
    drive->flip[at] = drive->successive[at] = NAN;
    if (before->rgb) {
        drive->successive[at] = snapshot_rms_difference(before, picture);
        if (drive->pixels && frame >= 0 && frame % flips == 0 &&
            !snapshot_flip(picture, before, drive->exposure, &drive->flip[at], error))
            return false;
    }
    if (drive->kept && frame >= -1 && !snapshot_copy(picture, &drive->kept[frame + 1], error))
        return false;
    if (frame < 0)
        return true;
    if (drive->pixels)
        temporal_pixels_add(drive->pixels, picture->luminance);
    if (frame == 0 && !snapshot_copy(picture, &drive->first, error))
        return false;
    for (uint32_t i = 0; i < drive->pair_count; i++) {
        struct drive_pair *pair = &drive->pairs[i];
        if (frame == pair->frame &&
            (!snapshot_copy(before, &pair->before, error) || !snapshot_copy(picture, &pair->now, error)))
            return false;
    }
    return true;
}

static bool take_frame(struct drive *drive, int64_t frame, struct shown *shown, struct error *error)
{
    struct path_state state;
    struct snapshot picture;
    if (!path_at(drive->path, &drive->base, frame, drive->frames, &state, error) ||
        !show(drive, shown, &state, error))
        return false;
    double begin = seconds_now();
    struct client_frame *rendered = render(drive, shown->view, 1u << drive->channel, error);
    if (!rendered)
        return false;
    if (frame >= 0)
        drive->frame_seconds += seconds_now() - begin;
    uint32_t at = (uint32_t)(frame + drive->warmup);
    for (int i = 0; i < STATISTIC_COUNT; i++)
        drive->series[i][at] = rendered->info.statistics[drive->statistic[i]];
    bool is_kept = take_picture(drive, rendered, &picture, error);
    client_frame_destroy(&rendered);
    if (!is_kept)
        return false;
    is_kept = keep(drive, frame, &picture, &drive->last, error);
    snapshot_free(&drive->last);
    drive->last = picture;
    if (is_kept) {
        drive->done++;
        drive->step(drive->context, path_infos[drive->path].name);
    }
    return is_kept;
}

/* The state of `frame`, converged: in a view of its own, so that it does not depend on what went before. */
static bool take_reference(struct drive *drive, int64_t frame, bool is_other, struct snapshot *picture,
                           struct error *error)
{
    const struct stability_options *options = drive->options;
    struct path_state state;
    struct shown shown;
    if (!path_at(drive->path, &drive->base, frame, drive->frames, &state, error) ||
        !create_view(drive, &shown, error) ||
        !client_view_setting(drive->client, shown.view, drive->accumulate, options->accumulate, error) ||
        (is_other &&
         !client_view_setting(drive->client, shown.view, drive->seed, drive->other_seed, error)) ||
        !show(drive, &shown, &state, error))
        return false;
    double begin = seconds_now();
    struct client_frame *frame_of = render(drive, shown.view, 1u << drive->channel, error);
    if (!frame_of)
        return false;
    drive->reference_seconds += seconds_now() - begin;
    drive->reference_frames++;
    bool is_taken = take_picture(drive, frame_of, picture, error);
    client_frame_destroy(&frame_of);
    for (uint32_t i = 0; i < options->accumulate; i++)
        drive->step(drive->context, "references");
    return is_taken && client_view_destroy(drive->client, shown.view, error);
}

static bool take_references(struct drive *drive, struct error *error)
{
    if (drive->options->pairs == 0)
        return true;
    int64_t last = (int64_t)drive->frames - 1;
    for (uint32_t i = 0; i < drive->pair_count; i++) {
        struct drive_pair *pair = &drive->pairs[i];
        last = pair->frame;
        if (!take_reference(drive, pair->frame - 1, false, &pair->reference_before, error) ||
            !take_reference(drive, pair->frame, false, &pair->reference_now, error))
            return false;
    }
    if (drive->path == PATH_SETTINGS_FLICKER)
        last = 0; /* with the first setting */
    if (drive->pair_count == 0 && !take_reference(drive, last, false, &drive->reference, error))
        return false;
    return take_reference(drive, last, true, &drive->reference_other, error);
}

bool drive_path(struct drive *drive, enum path_id path, uint32_t frames, struct error *error)
{
    struct shown shown;
    if (!prepare(drive, path, frames, error) || !create_view(drive, &shown, error))
        return false;
    for (int64_t frame = -(int64_t)drive->warmup; frame < frames; frame++)
        if (!take_frame(drive, frame, &shown, error))
            return false;
    return client_view_destroy(drive->client, shown.view, error) && take_references(drive, error);
}
