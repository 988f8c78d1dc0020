/* caustic-record: a camera path in, EXR frames and statistics out. See options.c for what it can do. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../lib/camera_path.h"
#include "../lib/folder.h"
#include "../lib/progress.h"
#include "options.h"
#include "pictures.h"
#include "report.h"

struct recording {
    const struct record_options *options;
    struct client *client;
    const struct protocol_hello *hello;
    struct camera_path *path;
    struct report *report;
    struct pictures pictures;
    struct picture_note notes[PROTOCOL_MAX_SETTINGS];
    double values[PROTOCOL_MAX_SETTINGS];
    uint32_t view, channels;
    double shown_time; /* the view's */
};

/* Puts "PREFIX: " in front of an error. */
static bool explain(struct error *error, const char *prefix)
{
    struct error inner = *error;
    return error_set(error, inner.status, "%.150s: %.350s", prefix, inner.message);
}

static bool choose_channels(struct recording *recording, struct error *error)
{
    const char *at = recording->options->channels;
    if (strcmp(at, "all") == 0) {
        recording->channels = (1u << recording->hello->channel_count) - 1;
        return true;
    }
    while (*at) {
        char name[64];
        size_t length = strcspn(at, ",");
        uint32_t index;
        if (length == 0 || length >= sizeof name)
            return error_set(error, STATUS_INVALID,
                             "--channels %.100s: write names with commas, as in caustics,depth",
                             recording->options->channels);
        memcpy(name, at, length);
        name[length] = 0;
        if (!client_find_channel(recording->client, name, &index, error))
            return explain(error, "--channels");
        recording->channels |= 1u << index;
        at += length + (at[length] == ',');
    }
    return true;
}

static bool choose_settings(struct recording *recording, struct error *error)
{
    const struct protocol_hello *hello = recording->hello;
    for (uint32_t i = 0; i < hello->setting_count; i++)
        recording->values[i] = hello->settings[i].value;
    for (uint32_t i = 0; i < recording->options->setting_count; i++) {
        const struct option_setting *setting = &recording->options->settings[i];
        uint32_t index;
        if (!client_find_setting(recording->client, setting->name, &index, error) ||
            !client_setting_parse(&hello->settings[index], setting->value, &recording->values[index],
                                  error) ||
            !client_view_setting(recording->client, recording->view, index, recording->values[index], error))
            return explain(error, "--set");
    }
    for (uint32_t i = 0; i < hello->setting_count; i++) {
        struct picture_note *note = &recording->notes[i];
        protocol_text_copy(hello->settings[i].name, note->name, sizeof note->name);
        client_setting_print(&hello->settings[i], recording->values[i], note->text, sizeof note->text);
        if (strcmp(note->name, "seed") == 0)
            recording->pictures.seed = recording->values[i];
    }
    return true;
}

static bool change_lights(struct recording *recording, struct error *error)
{
    for (uint32_t i = 0; i < recording->options->light_count; i++) {
        const struct record_light *light = &recording->options->lights[i];
        struct protocol_view_light change = light->change;
        change.view = recording->view;
        if (!client_find_light(recording->client, light->name, &change.light, error) ||
            !client_view_light(recording->client, &change, error))
            return explain(error, "--light");
    }
    return true;
}

/* The server knows all cameras, but the names are here for the error text. */
static bool follow_camera(struct recording *recording, struct error *error)
{
    const struct protocol_hello *hello = recording->hello;
    const char *name = recording->options->camera_name;
    char list[300] = "";
    bool is_listed = false;
    for (uint32_t i = 0; i < hello->camera_count; i++) {
        struct protocol_text camera = hello->cameras[i].name;
        size_t used = strlen(list);
        is_listed |= protocol_text_equals(camera, name);
        if (used + camera.length + 3 < sizeof list)
            snprintf(list + used, sizeof list - used, "%s%.*s", used ? ", " : "", camera.length,
                     camera.bytes);
    }
    if (!is_listed && hello->camera_count == hello->camera_total)
        return error_set(
            error, STATUS_NOT_FOUND, "--camera %.100s: %s%s", name,
            hello->camera_count ? "the scene has " : "the scene has no cameras; use --eye and --at", list);
    return client_view_follow(recording->client, recording->view, name, error) || explain(error, "--camera");
}

static bool place_camera(struct recording *recording, uint32_t frame, double time, struct error *error)
{
    if (!recording->path)
        return true;
    struct protocol_camera camera = camera_path_at(recording->path, frame, recording->options->frames, time);
    return client_view_camera(recording->client, recording->view, &camera, error) || explain(error, "--path");
}

static bool set_up(struct recording *recording, struct error *error)
{
    const struct record_options *options = recording->options;
    if (options->path_file && !(recording->path = camera_path_read(options->path_file, options->fov, error)))
        return explain(error, "--path");
    recording->client = client_connect(&(struct client_params){.address = options->address,
                                                               .name = "caustic-record " CAUSTIC_VERSION,
                                                               .wait_ms = (uint32_t)(options->wait * 1000)},
                                       error);
    if (!recording->client)
        return explain(error, "--connect");
    recording->hello = client_hello(recording->client);
    if (!choose_channels(recording, error))
        return false;
    if (!client_view_create(recording->client, options->width, options->height, &recording->view, error))
        return explain(error, "--size");
    if (!choose_settings(recording, error) || !change_lights(recording, error))
        return false;
    if (options->has_eye && !client_view_camera(recording->client, recording->view, &options->camera, error))
        return explain(error, "--eye, --at, --up");
    if (options->camera_name && !follow_camera(recording, error))
        return false;
    if (!folder_make(options->folder, error))
        return explain(error, "--out");
    recording->pictures.hello = recording->hello;
    recording->pictures.folder = options->folder;
    recording->pictures.notes = recording->notes;
    recording->pictures.note_count = recording->hello->setting_count;
    recording->pictures.png = options->png;
    recording->pictures.has_exposure = options->has_exposure;
    recording->pictures.exposure = options->exposure;
    recording->report = report_create(recording->hello, options, recording->values, error);
    return recording->report != NULL;
}

static struct client_frame *render(struct recording *recording, uint32_t number, struct error *error)
{
    const struct record_options *options = recording->options;
    double time = options->time + (options->rate > 0 ? number / options->rate : 0);
    /* A still scene stays at time 0 unless another time was asked for. */
    bool is_moving = recording->hello->duration > 0 || options->has_time;
    if (is_moving && time != recording->shown_time) {
        if (!client_view_time(recording->client, recording->view, time, error)) {
            explain(error, "--time");
            return NULL;
        }
        recording->shown_time = time;
    }
    if (!place_camera(recording, number, time, error))
        return NULL;
    return client_render(recording->client, recording->view,
                         &(struct client_render_params){.channels = recording->channels,
                                                        .format = options->format,
                                                        .encoding = options->encoding,
                                                        .timeout_ms = 3600u * 1000},
                         error);
}

static bool record(struct recording *recording, struct error *error)
{
    const struct record_options *options = recording->options;
    struct progress progress;
    char prefix[32];
    progress_begin(&progress, options->warmup + options->frames, options->quiet);
    for (uint32_t i = 0; i < options->warmup + options->frames; i++) {
        bool is_warm = i >= options->warmup;
        uint32_t number = is_warm ? i - options->warmup : 0;
        int64_t begin = progress_now_ns();
        struct client_frame *frame = render(recording, number, error);
        uint64_t elapsed = (uint64_t)(progress_now_ns() - begin);
        bool is_done = frame && (!is_warm || (pictures_write(&recording->pictures, frame, number, error) &&
                                              report_add(recording->report, frame, number,
                                                         recording->pictures.file, elapsed, error)));
        client_frame_destroy(&frame);
        if (!is_done) {
            progress_end(&progress);
            snprintf(prefix, sizeof prefix, "%s %u", is_warm ? "frame" : "warm-up frame",
                     is_warm ? number : i);
            return explain(error, prefix);
        }
        progress_step(&progress, is_warm ? "recording" : "warming up");
    }
    progress_end(&progress);
    char path[4200];
    snprintf(path, sizeof path, "%s/stats.json", options->folder);
    return report_write(recording->report, path, error);
}

int main(int argc, char **argv)
{
    static struct record_options options;
    static struct recording recording;
    struct error error;
    if (!record_options_parse(&options, argc, argv, &error)) {
        fprintf(stderr, "caustic-record: %s\n", error.message);
        return 2;
    }
    if (options.help || options.version) {
        fputs(options.help ? record_help : "caustic-record " CAUSTIC_VERSION "\n", stdout);
        return 0;
    }
    recording.options = &options;
    bool is_done = set_up(&recording, &error) && record(&recording, &error);
    if (!is_done)
        fprintf(stderr, "caustic-record: %s\n", error.message);
    else if (!options.quiet)
        report_print(recording.report, stdout);
    report_destroy(&recording.report);
    camera_path_destroy(&recording.path);
    client_destroy(&recording.client);
    return is_done ? 0 : 1;
}
