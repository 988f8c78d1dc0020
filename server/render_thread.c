#include "render_thread.h"

#include "log.h"
#include "network.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

/* Enough to take every default pass through its pipelines, too small to cost anything. */
#define WARM_UP_SIZE    64u
#define WARM_UP_PHOTONS 1024

struct render_thread {
    struct render_thread_params params;
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct job *submitted, *finished, **finished_end;
    bool has_started, is_stopping;
    bool is_usable; /* with has_started: started without an error */
    struct error error;
    struct render_info info;
    /* the thread's own */
    struct gpu *gpu;
    struct renderer *renderer;
    struct frame_encoder *encoder;
    struct render_view *views; /* those that exist */
};

struct job *job_create(enum job_kind kind, uint32_t output_count)
{
    struct job *job = calloc(1, sizeof *job);
    if (job && output_count) {
        job->outputs = calloc(output_count, sizeof *job->outputs);
        job->output_count = output_count;
        if (!job->outputs) {
            free(job);
            return NULL;
        }
    }
    if (job)
        job->kind = kind;
    return job;
}

void job_destroy(struct job **job)
{
    if (!*job)
        return;
    for (uint32_t i = 0; i < (*job)->output_count; i++)
        frame_release(&(*job)->outputs[i].frame);
    free((*job)->outputs);
    free(*job);
    *job = NULL;
}

/* ---- on the render thread ----------------------------------------------------------------------------- */

/* STATUS_DEVICE also says that device memory ran out, which concerns one view. Whether the device itself is
 * gone shows when it is asked to do nothing. */
static bool is_device_lost(struct gpu *gpu)
{
    struct error error;
    struct gpu_frame *frame = gpu_frame_begin(gpu, &error);
    return !frame || !gpu_frame_submit(frame, &error) || !gpu_frame_wait(frame, &error);
}

static bool render(struct render_thread *thread, struct job *job)
{
    uint32_t channels = 0;
    for (uint32_t i = 0; i < job->output_count; i++)
        channels |= job->outputs[i].request.channels;
    const struct frame_result *result = view_render(job->target->view, channels, &job->error);
    if (!result)
        return false;
    for (uint32_t i = 0; i < job->output_count; i++) {
        struct job_output *output = &job->outputs[i];
        output->frame = frame_encode(thread->encoder, result, job->view, job->target->update_sequence,
                                     &output->request, &job->error);
        if (!output->frame)
            return false;
    }
    return true;
}

static bool create_view(struct render_thread *thread, struct job *job)
{
    struct render_view *target = job->target;
    target->view = view_create(thread->renderer, job->size.width, job->size.height, &job->error);
    if (!target->view)
        return false;
    target->next = thread->views;
    if (target->next)
        target->next->previous = target;
    thread->views = target;
    return true;
}

static void destroy_view(struct render_thread *thread, struct render_view *target)
{
    if (target->previous)
        target->previous->next = target->next;
    else
        thread->views = target->next;
    if (target->next)
        target->next->previous = target->previous;
    target->previous = target->next = NULL;
    view_destroy(&target->view);
}

static bool run(struct render_thread *thread, struct job *job)
{
    struct view *view = job->target->view;
    switch (job->kind) {
    case JOB_VIEW_CREATE:
        return create_view(thread, job);
    case JOB_VIEW_DESTROY:
        destroy_view(thread, job->target);
        return true;
    case JOB_RESIZE:
        return view_set_size(view, job->size.width, job->size.height, &job->error);
    case JOB_CAMERA:
        return view_set_camera(view, &job->camera, &job->error);
    case JOB_FOLLOW:
        return view_follow_camera(view, job->follow, &job->error);
    case JOB_TIME:
        return view_set_time(view, job->time, &job->error);
    case JOB_LIGHT:
        return view_set_light(view, job->light.index, &job->light.change, &job->error);
    case JOB_SETTING:
        return view_set_setting(view, job->setting.id, job->setting.value, &job->error);
    case JOB_RESET:
        view_reset(view);
        return true;
    case JOB_RENDER:
        return render(thread, job);
    }
    return error_set(&job->error, STATUS_UNSUPPORTED, "unknown job");
}

/* A frame for each way in which the channels alone change what is compiled; other settings compile what they
 * add when they are first used. */
static bool warm_up(struct render_thread *thread, struct error *error)
{
    static const uint32_t channels[] = {
        (1u << CHANNEL_COUNT) - 1,
        (1u << CHANNEL_COUNT) - 1, /* again: a second frame takes the path that has a last frame */
        1u << CHANNEL_CAUSTICS,
        1u << CHANNEL_CAUSTICS | 1u << CHANNEL_NORMAL,
        1u << CHANNEL_NORMAL,
        1u << CHANNEL_DEPTH,
    };
    struct view *view = view_create(thread->renderer, WARM_UP_SIZE, WARM_UP_SIZE, error);
    bool ok = view && view_set_setting(view, SETTING_photons, WARM_UP_PHOTONS, error);
    for (size_t i = 0; ok && i < sizeof channels / sizeof *channels; i++)
        ok = view_render(view, channels[i], error) != NULL;
    view_destroy(&view);
    if (ok)
        gpu_save_cache(thread->gpu);
    return ok;
}

/* Says how long a step of the start took, and begins the next. */
static void log_step(const char *step, uint64_t *begin_ns)
{
    uint64_t now = network_now_ns();
    log_line(LOG_LEVEL_DEBUG, "%s: %.0f ms", step, 1e-6 * (double)(now - *begin_ns));
    *begin_ns = now;
}

static bool start(struct render_thread *thread, struct error *error)
{
    uint64_t begin_ns = network_now_ns();
    thread->encoder = frame_encoder_create(error);
    thread->gpu = thread->encoder ? gpu_create(&thread->params.gpu, error) : NULL;
    if (!thread->gpu)
        return false;
    thread->info.gpu = *gpu_info(thread->gpu);
    log_step("device", &begin_ns);
    thread->renderer = renderer_create(&(struct renderer_params){.gpu = thread->gpu,
                                                                 .scene = thread->params.scene,
                                                                 .tracer = thread->params.tracer},
                                       error);
    if (!thread->renderer)
        return false;
    thread->info.limits = *renderer_limits(thread->renderer);
    thread->info.tracer = renderer_tracer(thread->renderer);
    log_step("renderer", &begin_ns);
    if (!warm_up(thread, error))
        return false;
    log_step("warm-up", &begin_ns);
    return true;
}

static void finish_job(struct render_thread *thread, struct job *job)
{
    job->next = NULL;
    pthread_mutex_lock(&thread->lock);
    *thread->finished_end = job;
    thread->finished_end = &job->next;
    pthread_mutex_unlock(&thread->lock);
    thread->params.finished(thread->params.user);
}

static void *render_main(void *argument)
{
    struct render_thread *thread = argument;
    struct error error;
    bool ok = start(thread, &error);
    pthread_mutex_lock(&thread->lock);
    if (!ok)
        thread->error = error;
    thread->is_usable = ok;
    thread->has_started = true;
    pthread_cond_broadcast(&thread->changed);
    while (ok) {
        while (!thread->is_stopping && !thread->submitted)
            pthread_cond_wait(&thread->changed, &thread->lock);
        if (thread->is_stopping)
            break;
        struct job *job = thread->submitted;
        thread->submitted = job->next;
        pthread_mutex_unlock(&thread->lock);
        job->is_ok = run(thread, job);
        if (job->is_ok && job->kind >= JOB_RESIZE && job->kind <= JOB_RESET)
            job->target->update_sequence = job->sequence;
        job->is_device_lost =
            !job->is_ok && job->error.status == STATUS_DEVICE && is_device_lost(thread->gpu);
        finish_job(thread, job);
        pthread_mutex_lock(&thread->lock);
    }
    pthread_mutex_unlock(&thread->lock);
    while (thread->views)
        destroy_view(thread, thread->views);
    renderer_destroy(&thread->renderer);
    gpu_destroy(&thread->gpu);
    frame_encoder_destroy(&thread->encoder);
    return NULL;
}

/* ---- on the other ---------------------------------------------------------------------------------------
 */

struct render_thread *render_thread_start(const struct render_thread_params *params, struct error *error)
{
    struct render_thread *thread = calloc(1, sizeof *thread);
    if (!thread) {
        error_set(error, STATUS_MEMORY, "out of memory for the render thread");
        return NULL;
    }
    thread->params = *params;
    thread->finished_end = &thread->finished;
    pthread_mutex_init(&thread->lock, NULL);
    pthread_cond_init(&thread->changed, NULL);
    int code = pthread_create(&thread->thread, NULL, render_main, thread);
    if (code) {
        error_set(error, STATUS_MEMORY, "cannot start the render thread: %s", strerror(code));
        pthread_cond_destroy(&thread->changed);
        pthread_mutex_destroy(&thread->lock);
        free(thread);
        return NULL;
    }
    pthread_mutex_lock(&thread->lock);
    while (!thread->has_started)
        pthread_cond_wait(&thread->changed, &thread->lock);
    bool ok = thread->is_usable;
    if (!ok)
        *error = thread->error;
    pthread_mutex_unlock(&thread->lock);
    if (!ok)
        render_thread_stop(&thread);
    return thread;
}

const struct render_info *render_thread_info(const struct render_thread *thread)
{
    return &thread->info;
}

static void destroy_list(struct job *jobs)
{
    while (jobs) {
        struct job *job = jobs;
        jobs = job->next;
        job_destroy(&job);
    }
}

void render_thread_stop(struct render_thread **thread)
{
    if (!*thread)
        return;
    pthread_mutex_lock(&(*thread)->lock);
    (*thread)->is_stopping = true;
    pthread_cond_broadcast(&(*thread)->changed);
    pthread_mutex_unlock(&(*thread)->lock);
    pthread_join((*thread)->thread, NULL);
    destroy_list((*thread)->submitted);
    destroy_list((*thread)->finished);
    pthread_cond_destroy(&(*thread)->changed);
    pthread_mutex_destroy(&(*thread)->lock);
    free(*thread);
    *thread = NULL;
}

void render_thread_submit(struct render_thread *thread, struct job *jobs)
{
    pthread_mutex_lock(&thread->lock);
    thread->submitted = jobs;
    pthread_cond_broadcast(&thread->changed);
    pthread_mutex_unlock(&thread->lock);
}

struct job *render_thread_collect(struct render_thread *thread)
{
    pthread_mutex_lock(&thread->lock);
    struct job *jobs = thread->finished;
    thread->finished = NULL;
    thread->finished_end = &thread->finished;
    pthread_mutex_unlock(&thread->lock);
    return jobs;
}
