/* renderer.h: the renderer's public face: a scene on a device, and views of it.
 *
 *     renderer_create -> view_create -> (view_set_*, view_render)* -> view_destroy -> renderer_destroy
 *
 * A renderer owns what views share: geometry, acceleration structures, pipelines. A view owns camera, lights,
 * settings and the temporal state: task buffers, the last frame. Frames are bit-reproducible: the same build,
 * device, scene and sequence of calls on a view gives the same bits, whatever other views do in between.
 *
 * Threads: one thread at a time for a renderer and all its views.
 * Errors: see core/status.h. A refused call changes nothing.
 */
#ifndef CAUSTIC_RENDERER_H
#define CAUSTIC_RENDERER_H

#include "../gpu/gpu.h"
#include "../scene/scene.h"
#include "settings.h"
#include "stats.h"

#define VIEW_MAX_SIZE       8192u           /* pixels along a side */
#define VIEW_MAX_PIXELS     (4096u * 2304u) /* also limited by the device; renderer_limits tells */
#define VIEW_MAX_PASSES     32u
#define VIEW_MAX_PLAN_LINES 48u

enum tracer { TRACER_AUTO, TRACER_BVH, TRACER_KHR };

struct renderer_params {
    struct gpu *gpu;           /* borrowed; outlives the renderer */
    const struct scene *scene; /* borrowed; outlives the renderer */
    enum tracer tracer;        /* TRACER_AUTO: khr on hardware ray tracing, bvh elsewhere */
};

struct renderer_limits {
    uint32_t max_pixels;  /* width * height of a view on this device */
    uint32_t max_photons; /* largest `photons` setting on this device */
    uint32_t min_photons; /* smallest: one for every light of the scene */
};

struct renderer *renderer_create(const struct renderer_params *params, struct error *error);
void renderer_destroy(struct renderer **renderer);
enum tracer renderer_tracer(const struct renderer *renderer); /* the one in use: BVH or KHR */
const struct renderer_limits *renderer_limits(const struct renderer *renderer);

/* ---- channels ----------------------------------------------------------------------------------------- */

enum channel {
    CHANNEL_CAUSTICS,   /* 3: radiance toward the camera from caustic light, W/(m^2 sr), at directly visible
                           receivers; 0 elsewhere */
    CHANNEL_IRRADIANCE, /* 3: caustic irradiance, W/m^2, likewise; with aa=pixel, unlike caustics, nothing
                           where a pixel's middle sees no receiver */
    CHANNEL_BEAUTY,     /* 3: direct light, emission, caustics and indirect, W/(m^2 sr) */
    CHANNEL_DEPTH,    /* 1: distance along the view axis to the first hit, m; +infinity where there is none */
    CHANNEL_NORMAL,   /* 3: unit shading normal of the surface the G-buffer settled on; 0 where none */
    CHANNEL_ALBEDO,   /* 3: its base colour; 0 where none */
    CHANNEL_INDIRECT, /* 3: radiance toward the camera from caustic light seen through glass and mirrors,
                         W/(m^2 sr); 0 where the camera sees the receiver directly */
    CHANNEL_DENSITY,  /* 1: task buffer density, one tile per light: cells*columns x cells*rows */
    CHANNEL_VARIANCE, /* 1: task buffer variance, likewise; 0 when variance_gain is 0 */
    CHANNEL_COUNT
};

struct channel_info {
    const char *name; /* "caustics", ... */
    uint32_t components;
    const char *help;
};
extern const struct channel_info channel_infos[CHANNEL_COUNT];

/* ---- views -------------------------------------------------------------------------------------------- */

struct view_camera {
    float eye[3], at[3], up[3]; /* metres; finite, eye != at, up not along the view axis */
    float fov;                  /* vertical, degrees, above 0 and below 179 */
};

/* What may be changed about a light of the scene, by its index. */
enum { LIGHT_OVERRIDE_INTENSITY = 1, LIGHT_OVERRIDE_POSITION = 2, LIGHT_OVERRIDE_DIRECTION = 4 };
struct view_light {
    uint32_t overrides; /* bits of LIGHT_OVERRIDE_*; 0 returns the light to the scene's own */
    float intensity[3]; /* W/sr or W/m^2; finite, >= 0, <= 1e12 */
    float position[3];  /* finite */
    float direction[3]; /* finite, not 0; need not be unit */
};

struct view;

/* A new view has the scene's first camera (or one that sees the whole scene), its lights, default settings
 * and time 0. */
struct view *view_create(struct renderer *renderer, uint32_t width, uint32_t height, struct error *error);
void view_destroy(struct view **view);

bool view_set_size(struct view *view, uint32_t width, uint32_t height, struct error *error);
bool view_set_camera(struct view *view, const struct view_camera *camera, struct error *error);
/* Follows a scene camera, animated or not, until view_set_camera. */
bool view_follow_camera(struct view *view, uint32_t camera, struct error *error);
bool view_set_light(struct view *view, uint32_t light, const struct view_light *change, struct error *error);
bool view_set_setting(struct view *view, enum setting_id id, double value, struct error *error);
bool view_set_time(struct view *view, double time, struct error *error); /* seconds, finite */
/* Forgets the temporal state: the next frame is like the first. */
void view_reset(struct view *view);
const struct settings *view_settings(const struct view *view);

struct frame_channel {
    enum channel channel;
    uint32_t width, height, components;
    const float *values; /* rows from the top, tight, interleaved components */
};

struct frame_pass {
    const char *name;
    uint64_t elapsed_ns;
};

/* One line of the plan: a pass, buffer or feature that is in use or left out, and why. */
struct plan_line {
    const char *name;
    bool is_used;
    const char *reason;
};

struct frame_result {
    uint64_t frame;                               /* number of the view's frame, from 0 */
    struct frame_channel channels[CHANNEL_COUNT]; /* the requested ones, in enum order */
    uint32_t channel_count;
    struct frame_pass passes[VIEW_MAX_PASSES];
    uint32_t pass_count;
    double stats[STAT_COUNT];
    struct plan_line plan[VIEW_MAX_PLAN_LINES];
    uint32_t plan_count;
    struct view_camera camera;                     /* as rendered */
    float world_to_camera[16], camera_to_clip[16]; /* column-major, Vulkan clip space (y down, z 0..1 reversed
                                                      is not used: near 0, far 1) */
    double time;
    const char *black_reason; /* NULL, or why there is no caustic light at all */
};

/* Renders the view's next frame and reads back the channels of `channel_mask` (bits 1 << enum channel; 0:
 * statistics only). What no requested channel needs is not rendered. The result and its arrays belong to the
 * view and are valid until its next call. */
const struct frame_result *view_render(struct view *view, uint32_t channel_mask, struct error *error);

#endif
