/* render_thread.h: the thread that owns device, renderer and views.
 *
 * The network thread hands over a batch of jobs, in order, and gets each back when it is done; it keeps at
 * most one batch there (RENDER_BATCH_SIZE jobs), so nothing piles up on this side and every choice of what to
 * do next is made on the network thread. A job is owned by whoever has it; nothing else is shared.
 */
#ifndef CAUSTICD_RENDER_THREAD_H
#define CAUSTICD_RENDER_THREAD_H

#include "frame.h"

#define RENDER_BATCH_SIZE 64u

enum job_kind {
    JOB_VIEW_CREATE,
    JOB_VIEW_DESTROY,
    JOB_RESIZE,
    JOB_CAMERA,
    JOB_FOLLOW,
    JOB_TIME,
    JOB_LIGHT,
    JOB_SETTING,
    JOB_RESET,
    JOB_RENDER
};

/* A view as the render thread knows it; filled by JOB_VIEW_CREATE, used by that thread alone. */
struct render_view {
    struct render_view *previous, *next;
    struct view *view;
    uint32_t update_sequence; /* of the last update that succeeded */
};

struct job_output {
    struct frame_request request;
    struct frame *frame; /* result */
};

struct job {
    struct job *next;
    enum job_kind kind;
    uint32_t view;              /* id, for the frame */
    struct render_view *target; /* outlives the job */
    uint32_t sequence;          /* of the request; becomes the view's update_sequence */
    union {
        struct {
            uint32_t width, height;
        } size; /* JOB_VIEW_CREATE, JOB_RESIZE */
        struct view_camera camera;
        uint32_t follow;
        double time;
        struct {
            uint32_t index;
            struct view_light change;
        } light;
        struct {
            enum setting_id id;
            double value;
        } setting;
    };
    struct job_output *outputs; /* JOB_RENDER: output_count of them, owned */
    uint32_t output_count;
    /* results */
    bool is_ok;
    bool is_device_lost; /* the renderer cannot be used any more */
    struct error error;
    /* not touched by the render thread */
    void *entry;      /* the network thread's side of the view */
    uint64_t session; /* id of the session that asked; 0: the server itself */
    uint32_t reply;   /* number of its reply; 0: JOB_RENDER, which is answered by its frame */
    uint32_t request; /* JOB_RENDER: what its frame answers */
};

struct job *job_create(enum job_kind kind, uint32_t output_count);
void job_destroy(struct job **job); /* with its outputs and their frames */

struct render_thread;

struct render_thread_params {
    struct gpu_params gpu;
    const struct scene *scene; /* borrowed; outlives the thread */
    enum tracer tracer;
    void (*finished)(void *user); /* a job can be collected; called on the render thread */
    void *user;
};

struct render_info {
    struct gpu_info gpu;
    struct renderer_limits limits;
    enum tracer tracer; /* TRACER_BVH or TRACER_KHR */
};

/* Starts the thread and returns when every pipeline of a default view is compiled, or with the error that
 * made it end. `finished` may be called only after the first submit. */
struct render_thread *render_thread_start(const struct render_thread_params *params, struct error *error);
const struct render_info *render_thread_info(const struct render_thread *thread);
/* Waits for the job at work, drops the rest, destroys what is left of the views, and joins. */
void render_thread_stop(struct render_thread **thread);

/* Hands over a list of jobs (by `next`). Only when everything handed over before was collected. */
void render_thread_submit(struct render_thread *thread, struct job *jobs);
/* The jobs done so far, in order; NULL: none. */
struct job *render_thread_collect(struct render_thread *thread);

#endif
