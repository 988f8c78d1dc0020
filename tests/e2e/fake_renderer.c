/* fake_renderer.c: gpu.h and renderer.h without Vulkan, so that tests of the server are quick and can ask for
 * slow frames and failures on purpose.
 *
 * A pixel is a hash of its place, the camera, time, settings, the frame's number and the view's history, so
 * two frames are equal exactly when the calls that led to them were. What a setting does here:
 *
 *   accumulate = N   a frame takes N - 1 milliseconds
 *   seed = 2147483646  the next frames fail for want of device memory; other views do not
 *   seed = 2147483647  the next frame loses the device
 */
#include "core/render/renderer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SEED_NO_MEMORY   2147483646
#define SEED_DEVICE_LOST 2147483647

struct gpu {
    struct gpu_info info;
    bool is_lost;
};

struct renderer {
    struct gpu *gpu;
    const struct scene *scene;
    struct renderer_limits limits;
};

struct view {
    struct renderer *renderer;
    uint32_t width, height;
    struct settings settings;
    struct view_camera camera;
    double time;
    uint64_t frame, history;
    float *pixels[CHANNEL_COUNT];
    struct frame_result result;
};

/* ---- gpu.h -------------------------------------------------------------------------------------------- */

struct gpu *gpu_create(const struct gpu_params *params, struct error *error)
{
    struct gpu *gpu = calloc(1, sizeof *gpu);
    if (params->device && strcmp(params->device, "none") == 0) {
        free(gpu);
        error_set(error, STATUS_DEVICE, "no Vulkan device is named \"none\"");
        return NULL;
    }
    strcpy(gpu->info.name, "fake");
    strcpy(gpu->info.driver, "analytic");
    return gpu;
}

void gpu_destroy(struct gpu **gpu)
{
    free(*gpu);
    *gpu = NULL;
}

const struct gpu_info *gpu_info(const struct gpu *gpu)
{
    return &gpu->info;
}

uint32_t gpu_list(struct gpu_info *infos, uint32_t capacity)
{
    if (capacity)
        infos[0] = (struct gpu_info){.name = "fake", .driver = "analytic"};
    return 1;
}

void gpu_save_cache(struct gpu *gpu)
{
    (void)gpu;
}

struct gpu_frame *gpu_frame_begin(struct gpu *gpu, struct error *error)
{
    if (gpu->is_lost)
        error_set(error, STATUS_DEVICE, "the device is lost");
    return gpu->is_lost ? NULL : (struct gpu_frame *)gpu;
}

bool gpu_frame_submit(struct gpu_frame *frame, struct error *error)
{
    (void)error;
    return frame != NULL;
}

bool gpu_frame_wait(struct gpu_frame *frame, struct error *error)
{
    (void)error;
    return frame != NULL;
}

/* ---- renderer.h --------------------------------------------------------------------------------------- */

const struct channel_info channel_infos[CHANNEL_COUNT] = {
    {"caustics", 3, "fake"}, {"irradiance", 3, "fake"}, {"beauty", 3, "fake"},
    {"depth", 1, "fake"},    {"normal", 3, "fake"},     {"albedo", 3, "fake"},
    {"indirect", 3, "fake"}, {"density", 1, "fake"},    {"variance", 1, "fake"}};

struct renderer *renderer_create(const struct renderer_params *params, struct error *error)
{
    (void)error;
    struct renderer *renderer = calloc(1, sizeof *renderer);
    renderer->gpu = params->gpu;
    renderer->scene = params->scene;
    renderer->limits = (struct renderer_limits){.max_pixels = VIEW_MAX_PIXELS, .max_photons = 1u << 20};
    return renderer;
}

void renderer_destroy(struct renderer **renderer)
{
    free(*renderer);
    *renderer = NULL;
}

enum tracer renderer_tracer(const struct renderer *renderer)
{
    (void)renderer;
    return TRACER_BVH;
}

const struct renderer_limits *renderer_limits(const struct renderer *renderer)
{
    return &renderer->limits;
}

struct view *view_create(struct renderer *renderer, uint32_t width, uint32_t height, struct error *error)
{
    (void)error;
    struct view *view = calloc(1, sizeof *view);
    view->renderer = renderer;
    view->width = width;
    view->height = height;
    view->camera = (struct view_camera){.eye = {0, 1, 5}, .up = {0, 1, 0}, .fov = 45};
    settings_default(&view->settings);
    return view;
}

void view_destroy(struct view **view)
{
    if (!*view)
        return;
    for (int i = 0; i < CHANNEL_COUNT; i++)
        free((*view)->pixels[i]);
    free(*view);
    *view = NULL;
}

bool view_set_size(struct view *view, uint32_t width, uint32_t height, struct error *error)
{
    (void)error;
    view->width = width;
    view->height = height;
    return true;
}

bool view_set_camera(struct view *view, const struct view_camera *camera, struct error *error)
{
    if (!(camera->fov > 0 && camera->fov < 179))
        return error_set(error, STATUS_INVALID, "fov must be above 0 and below 179, not %g",
                         (double)camera->fov);
    if (memcmp(camera->eye, camera->at, sizeof camera->eye) == 0)
        return error_set(error, STATUS_INVALID, "eye and at are the same point");
    view->camera = *camera;
    return true;
}

bool view_follow_camera(struct view *view, uint32_t camera, struct error *error)
{
    (void)error;
    view->camera.fov = 30 + (float)camera;
    return true;
}

bool view_set_light(struct view *view, uint32_t light, const struct view_light *change, struct error *error)
{
    (void)light;
    if (change->overrides & LIGHT_OVERRIDE_INTENSITY && !(change->intensity[0] >= 0))
        return error_set(error, STATUS_INVALID, "intensity must not be negative");
    view->history ^= (uint64_t)change->overrides + (uint64_t)change->intensity[0];
    return true;
}

bool view_set_setting(struct view *view, enum setting_id id, double value, struct error *error)
{
    return settings_set(&view->settings, id, value, error);
}

bool view_set_time(struct view *view, double time, struct error *error)
{
    (void)error;
    view->time = time;
    return true;
}

void view_reset(struct view *view)
{
    view->history = 0;
}

const struct settings *view_settings(const struct view *view)
{
    return &view->settings;
}

static uint64_t mix(uint64_t hash, const void *bytes, size_t size)
{
    const uint8_t *byte = bytes;
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ byte[i]) * 0x100000001b3u;
    return hash;
}

static void fill(struct view *view, enum channel channel)
{
    uint32_t components = channel_infos[channel].components;
    size_t count = (size_t)view->width * view->height * components;
    view->pixels[channel] = realloc(view->pixels[channel], count * sizeof(float));
    uint64_t state = view->history + (uint64_t)channel * 0x9e3779b97f4a7c15u + 1;
    for (size_t i = 0; i < count; i++) {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        view->pixels[channel][i] = (float)(state >> 40) / 65536.0f;
    }
    view->result.channels[view->result.channel_count++] =
        (struct frame_channel){.channel = channel,
                               .width = view->width,
                               .height = view->height,
                               .components = components,
                               .values = view->pixels[channel]};
}

const struct frame_result *view_render(struct view *view, uint32_t channel_mask, struct error *error)
{
    struct gpu *gpu = view->renderer->gpu;
    if (view->settings.seed == SEED_DEVICE_LOST)
        gpu->is_lost = true;
    if (gpu->is_lost || view->settings.seed == SEED_NO_MEMORY) {
        error_set(error, STATUS_DEVICE, gpu->is_lost ? "the device is lost" : "out of device memory");
        return NULL;
    }
    long wait_ns = (view->settings.accumulate - 1) * 1000000l;
    nanosleep(&(struct timespec){.tv_sec = wait_ns / 1000000000l, .tv_nsec = wait_ns % 1000000000l}, NULL);
    view->history = mix(view->history, &view->camera, sizeof view->camera);
    view->history = mix(view->history, &view->time, sizeof view->time);
    view->history = mix(view->history, &view->settings, sizeof view->settings);
    struct frame_result *result = &view->result;
    *result =
        (struct frame_result){.frame = view->frame++,
                              .camera = view->camera,
                              .time = view->time,
                              .pass_count = 1,
                              .passes = {{.name = "hash", .elapsed_ns = (uint64_t)wait_ns}},
                              .plan_count = 1,
                              .plan = {{.name = "hash", .is_used = true, .reason = "it is all there is"}}};
    for (int i = 0; i < 16; i += 5)
        result->world_to_camera[i] = result->camera_to_clip[i] = 1;
    for (enum channel channel = 0; channel < CHANNEL_COUNT; channel++)
        if (channel_mask >> channel & 1)
            fill(view, channel);
    return result;
}
