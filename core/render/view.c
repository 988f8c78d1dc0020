/* view.c: a view's state and its frames. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "../../shaders/shader_table.h"
#include "view_state.h"

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

/* ---- buffers and dispatches ---------------------------------------------------------------------------- */

static const char *const buffer_names[BUFFER_COUNT] = {
    "frame",        "lights",       "counters",      "caster boxes",
    "caster mask",  "density",      "density",       "quadtree",
    "columns",      "aspect",       "costs",         "partials",
    "feedback",     "variance",     "rays",          "rays",
    "spreads",      "spreads",      "queue",         "queue",
    "outcomes",     "groups",       "photons",       "surfaces",
    "targets",      "sums",         "pieces",        "picture",
    "reached",      "irradiance",   "irradiance",    "blended",
    "blended",      "old targets",  "chains",        "chain weights",
    "chain places", "broken",       "lookup",        "lookup cells",
    "lookup marks", "lookup walks", "lookup points", "lookup photons",
    "lookup sums",  "tree nodes",   "tree places",   "tree order",
    "tree points",  "tree shares",  "indirect",      "lookup readback",
    "soft",         "output",       "readback",      "counters readback",
};

bool view_buffer(struct view *view, enum view_buffer id, size_t size)
{
    if (size == 0)
        size = 16;
    view->asked[id] = size;
    if (view->buffers[id] && gpu_buffer_size(view->buffers[id]) >= size)
        return true;
    gpu_buffer_destroy(&view->buffers[id]);
    bool is_readback =
        id == BUFFER_READBACK || id == BUFFER_READBACK_COUNTERS || id == BUFFER_READBACK_LOOKUP;
    view->buffers[id] = gpu_buffer_create(
        view->renderer->gpu,
        &(struct gpu_buffer_params){.name = buffer_names[id],
                                    .size = size,
                                    .memory = is_readback ? GPU_MEMORY_READBACK : GPU_MEMORY_DEVICE},
        &view->error);
    if (!view->buffers[id])
        view->failed = true;
    return view->buffers[id] != NULL;
}

static struct gpu_pipeline *find_pipeline(struct view *view, const struct view_dispatch *dispatch,
                                          uint32_t binding_mask)
{
    struct renderer *r = view->renderer;
    struct renderer_pipeline wanted = {0};
    snprintf(wanted.shader, sizeof wanted.shader, "%s%s", dispatch->shader,
             !dispatch->traces         ? ""
             : r->tracer == TRACER_KHR ? ".khr"
                                       : ".bvh");
    const uint32_t ids[7] = {CONSTANT_FEATURES,
                             CONSTANT_SPLIT,
                             CONSTANT_DENSITY,
                             CONSTANT_AA,
                             CONSTANT_DEPTH,
                             CONSTANT_FIRST_TRIANGLES,
                             8};
    const uint32_t values[7] = {view->features.bits,
                                (uint32_t)view->settings.split,
                                (uint32_t)view->settings.density,
                                (uint32_t)view->settings.aa,
                                (uint32_t)view->settings.depth_test,
                                r->first_triangles,
                                dispatch->phase};
    memcpy(wanted.constants, values, sizeof values);
    for (uint32_t i = 0; i < r->pipeline_count; i++)
        if (strcmp(r->pipelines[i].shader, wanted.shader) == 0 &&
            memcmp(r->pipelines[i].constants, values, sizeof values) == 0) {
            r->pipelines[i].last_used = ++r->pipeline_uses;
            return r->pipelines[i].pipeline;
        }
    size_t bytes;
    const uint32_t *spirv = shader_find(wanted.shader, &bytes);
    if (!spirv) {
        error_set(&view->error, STATUS_UNSUPPORTED, "shader '%s' is not part of this build", wanted.shader);
        return NULL;
    }
    struct gpu_constant constants[7];
    for (int i = 0; i < 7; i++)
        constants[i] = (struct gpu_constant){ids[i], values[i]};
    bool is_khr = dispatch->traces && r->tracer == TRACER_KHR;
    wanted.pipeline = gpu_pipeline_create(r->gpu,
                                          &(struct gpu_pipeline_params){
                                              .name = wanted.shader,
                                              .spirv = spirv,
                                              .spirv_bytes = bytes,
                                              .constants = constants,
                                              .constant_count = 7,
                                              .binding_mask = binding_mask,
                                              .accel_mask = is_khr ? 1u << BINDING_NODES : 0,
                                              .push_bytes = dispatch->has_push ? 4 : 0,
                                          },
                                          &view->error);
    if (!wanted.pipeline)
        return NULL;
    wanted.last_used = ++r->pipeline_uses;
    uint32_t place = r->pipeline_count;
    if (place < RENDERER_MAX_PIPELINES)
        r->pipeline_count++;
    else {
        /* Many settings were tried: what was not used for longest goes, which the frame being recorded does
         * not use. */
        place = 0;
        for (uint32_t i = 1; i < r->pipeline_count; i++)
            if (r->pipelines[i].last_used < r->pipelines[place].last_used)
                place = i;
        gpu_pipeline_destroy(&r->pipelines[place].pipeline);
    }
    r->pipelines[place] = wanted;
    return wanted.pipeline;
}

void view_dispatch(struct view *view, struct gpu_frame *frame, const struct view_dispatch *dispatch)
{
    if (view->failed)
        return;
    struct renderer *r = view->renderer;
    struct gpu_bind binds[32];
    uint32_t count = 0, mask = 0;
    if (dispatch->traces) {
        binds[count++] =
            r->tracer == TRACER_KHR
                ? (struct gpu_bind){.binding = BINDING_NODES, .access = GPU_READ, .accel = r->top}
                : (struct gpu_bind){.binding = BINDING_NODES, .access = GPU_READ, .buffer = r->nodes};
        if (r->tracer != TRACER_KHR) {
            binds[count++] =
                (struct gpu_bind){.binding = BINDING_TRIANGLES, .access = GPU_READ, .buffer = r->triangles};
            binds[count++] =
                (struct gpu_bind){.binding = BINDING_MORE_TRIANGLES,
                                  .access = GPU_READ,
                                  .buffer = r->more_triangles ? r->more_triangles : r->triangles};
        }
        struct gpu_buffer *const scene[] = {r->instances, r->vertices, r->indices, r->materials, r->texels};
        for (uint32_t i = 0; i < 5; i++)
            binds[count++] =
                (struct gpu_bind){.binding = BINDING_INSTANCES + i, .access = GPU_READ, .buffer = scene[i]};
    }
    if (dispatch->lights)
        binds[count++] = (struct gpu_bind){
            .binding = BINDING_LIGHTS, .access = GPU_READ, .buffer = view->buffers[BUFFER_LIGHTS]};
    binds[count++] = (struct gpu_bind){
        .binding = BINDING_FRAME, .access = GPU_READ, .buffer = view->buffers[BUFFER_FRAME]};
    for (uint32_t i = 0; i < dispatch->use_count; i++)
        binds[count++] = (struct gpu_bind){.binding = dispatch->uses[i].binding,
                                           .access = dispatch->uses[i].access,
                                           .buffer = view->buffers[dispatch->uses[i].buffer]};
    for (uint32_t i = 0; i < count; i++)
        mask |= 1u << binds[i].binding;
    struct gpu_pipeline *pipeline = find_pipeline(view, dispatch, mask);
    if (!pipeline) {
        view->failed = true;
        return;
    }
    bool is_indirect = dispatch->indirect_offset != 0;
    gpu_record_dispatch(frame, &(struct gpu_dispatch){
                                   .pipeline = pipeline,
                                   .binds = binds,
                                   .bind_count = count,
                                   .push = dispatch->has_push ? &dispatch->push : NULL,
                                   .groups = {dispatch->groups[0], dispatch->groups[1], 1},
                                   .indirect = is_indirect ? view->buffers[dispatch->indirect] : NULL,
                                   .indirect_offset = dispatch->indirect_offset,
                               });
}

/* ---- state --------------------------------------------------------------------------------------------- */

static bool check_size(const struct renderer *renderer, uint32_t width, uint32_t height, struct error *error)
{
    if (width == 0 || height == 0 || width > VIEW_MAX_SIZE || height > VIEW_MAX_SIZE)
        return error_set(error, STATUS_INVALID, "size %ux%u is not within 1x1 to %ux%u", width, height,
                         VIEW_MAX_SIZE, VIEW_MAX_SIZE);
    if ((uint64_t)width * height > renderer->limits.max_pixels)
        return error_set(error, STATUS_LIMIT, "size %ux%u has %llu pixels; this device's limit is %u", width,
                         height, (unsigned long long)width * height, renderer->limits.max_pixels);
    return true;
}

/* A camera that sees the whole scene, for scenes without one. */
static void frame_scene(const struct renderer *renderer, struct view_camera *camera)
{
    float middle[3] = {0, 0, 0}, radius = 0;
    for (int k = 0; k < 3; k++) {
        if (renderer->scene_min[k] <= renderer->scene_max[k]) {
            middle[k] = 0.5f * (renderer->scene_min[k] + renderer->scene_max[k]);
            float half = 0.5f * (renderer->scene_max[k] - renderer->scene_min[k]);
            radius += half * half;
        }
    }
    radius = sqrtf(radius);
    if (!(radius > 0))
        radius = 1;
    const float way[3] = {0.45f, 0.55f, 0.7f};
    *camera = (struct view_camera){.up = {0, 1, 0}, .fov = 40};
    for (int k = 0; k < 3; k++) {
        camera->at[k] = middle[k];
        camera->eye[k] = middle[k] + way[k] * radius * 3;
    }
}

static void camera_of_scene(const struct renderer *renderer, uint32_t index, struct view_camera *camera)
{
    const struct pose_camera *pose = &renderer->pose->cameras[index];
    /* Far from the origin a point 1 m ahead is rounded to a few directions. */
    float ahead = 1;
    for (int k = 0; k < 3; k++)
        while (ahead * 64 < fabsf(pose->eye[k] + (float)renderer->extent.origin[k]))
            ahead *= 2;
    ahead = ahead > 1 ? ahead * 64 : 1;
    for (int k = 0; k < 3; k++) {
        camera->eye[k] = pose->eye[k];
        camera->at[k] = pose->eye[k] + ahead * pose->forward[k];
        camera->up[k] = pose->up[k];
    }
    camera->fov = renderer->scene->cameras[index].yfov * 57.2957795f;
}

struct view *view_create(struct renderer *renderer, uint32_t width, uint32_t height, struct error *error)
{
    if (!check_size(renderer, width, height, error))
        return NULL;
    struct view *view = calloc(1, sizeof *view);
    uint32_t lights = renderer->scene->light_count;
    if (view) {
        view->light_changes = calloc(lights + 1, sizeof *view->light_changes);
        view->tiles = calloc(lights + 1, sizeof *view->tiles);
        view->lights = calloc(TILES_MAX, sizeof *view->lights);
    }
    if (!view || !view->light_changes || !view->tiles || !view->lights) {
        error_set(error, STATUS_MEMORY, "out of memory for a view");
        view_destroy(&view);
        return NULL;
    }
    view->renderer = renderer;
    view->width = width;
    view->height = height;
    settings_default(&view->settings);
    if (view->settings.photons > (int32_t)renderer->limits.max_photons)
        view->settings.photons = (int32_t)renderer->limits.max_photons;
    view->follow_camera = renderer->scene->camera_count > 0 ? 0 : SCENE_NONE;
    if (view->follow_camera == SCENE_NONE)
        frame_scene(renderer, &view->camera);
    return view;
}

void view_destroy(struct view **view)
{
    struct view *v = *view;
    if (!v)
        return;
    for (uint32_t i = 0; i < BUFFER_COUNT; i++)
        gpu_buffer_destroy(&v->buffers[i]);
    gpu_raster_destroy(&v->quads.raster);
    free(v->light_changes);
    free(v->tiles);
    free(v->lights);
    free(v->host_values);
    free(v->atlas_values);
    free(v);
    *view = NULL;
}

void view_reset(struct view *view)
{
    view->subframe = 0;
    view->frame = 0;
    view->still_frames = 0;
    view->has_density = view->has_feedback = view->has_previous = view->has_history = false;
    view->soft = (struct soft_choice){0};
    view->governor = (struct governor){0};
    for (uint32_t i = 0; i < view->renderer->scene->light_count; i++)
        view->tiles[i].is_valid = false;
}

/* A client may send what holds already with every frame: that is no change. */
static void note_change(struct view *view, bool is_change)
{
    if (is_change)
        view->still_frames = 0;
}

bool view_set_size(struct view *view, uint32_t width, uint32_t height, struct error *error)
{
    if (!check_size(view->renderer, width, height, error))
        return false;
    if (view->width != width || view->height != height)
        view->has_previous = view->has_history = false;
    note_change(view, view->width != width || view->height != height);
    view->width = width;
    view->height = height;
    return true;
}

static bool is_finite3(const float v[3])
{
    return isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]);
}

static void cross3(const float a[3], const float b[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

static float normalise3(float v[3])
{
    float largest = fmaxf(fabsf(v[0]), fmaxf(fabsf(v[1]), fabsf(v[2])));
    if (!(largest > 0) || !isfinite(largest))
        return 0;
    float sum = 0;
    for (int k = 0; k < 3; k++) {
        v[k] /= largest;
        sum += v[k] * v[k];
    }
    float length = sqrtf(sum);
    for (int k = 0; k < 3; k++)
        v[k] /= length;
    return length * largest;
}

bool view_camera_axes(const struct view_camera *camera, float forward[3], float right[3], float up[3])
{
    float towards[3] = {camera->up[0], camera->up[1], camera->up[2]};
    for (int k = 0; k < 3; k++)
        forward[k] = camera->at[k] - camera->eye[k];
    if (!(normalise3(forward) > 0) || !(normalise3(towards) > 0))
        return false;
    cross3(forward, towards, right);
    if (!(normalise3(right) > 1e-5f))
        return false;
    cross3(right, forward, up);
    return true;
}

/* Moves a point of the world to where the renderer has its origin (sign -1), or back (1). */
static void to_origin(const struct view *view, float point[3], double sign)
{
    for (int k = 0; k < 3; k++)
        point[k] = (float)((double)point[k] + sign * view->renderer->extent.origin[k]);
}

bool view_set_camera(struct view *view, const struct view_camera *camera, struct error *error)
{
    float forward[3], right[3], up[3];
    if (!is_finite3(camera->eye) || !is_finite3(camera->at) || !is_finite3(camera->up))
        return error_set(error, STATUS_INVALID, "camera eye, at and up must be finite");
    if (!(camera->fov > 0 && camera->fov < 179))
        return error_set(error, STATUS_INVALID, "camera fov must be above 0 and below 179 degrees, not %g",
                         (double)camera->fov);
    if (camera->eye[0] == camera->at[0] && camera->eye[1] == camera->at[1] && camera->eye[2] == camera->at[2])
        return error_set(error, STATUS_INVALID, "camera eye and at are the same point");
    if (!view_camera_axes(camera, forward, right, up))
        return error_set(error, STATUS_INVALID, "camera up is zero or along the view axis");
    struct view_camera old = view->camera;
    view->camera = *camera;
    to_origin(view, view->camera.eye, -1);
    to_origin(view, view->camera.at, -1);
    note_change(view, view->follow_camera != SCENE_NONE || memcmp(&old, &view->camera, sizeof old) != 0);
    view->follow_camera = SCENE_NONE;
    return true;
}

bool view_follow_camera(struct view *view, uint32_t camera, struct error *error)
{
    if (camera >= view->renderer->scene->camera_count)
        return error_set(error, STATUS_NOT_FOUND, "camera %u does not exist; the scene has %u", camera,
                         view->renderer->scene->camera_count);
    note_change(view, view->follow_camera != camera);
    view->follow_camera = camera;
    return true;
}

bool view_set_light(struct view *view, uint32_t light, const struct view_light *change, struct error *error)
{
    if (light >= view->renderer->scene->light_count)
        return error_set(error, STATUS_NOT_FOUND, "light %u does not exist; the scene has %u", light,
                         view->renderer->scene->light_count);
    const char *name = view->renderer->scene->lights[light].name;
    const uint32_t known = LIGHT_OVERRIDE_INTENSITY | LIGHT_OVERRIDE_POSITION | LIGHT_OVERRIDE_DIRECTION;
    if (change->overrides & ~known)
        return error_set(error, STATUS_INVALID, "light '%s': unknown override bits %#x", name,
                         change->overrides & ~known);
    if (change->overrides & LIGHT_OVERRIDE_INTENSITY)
        for (int k = 0; k < 3; k++)
            if (!(change->intensity[k] >= 0 && change->intensity[k] <= 1e12f))
                return error_set(error, STATUS_INVALID,
                                 "light '%s': intensity must be from 0 to 1e12, not %g", name,
                                 (double)change->intensity[k]);
    if ((change->overrides & LIGHT_OVERRIDE_POSITION) && !is_finite3(change->position))
        return error_set(error, STATUS_INVALID, "light '%s': position must be finite", name);
    float direction[3] = {change->direction[0], change->direction[1], change->direction[2]};
    if ((change->overrides & LIGHT_OVERRIDE_DIRECTION) &&
        !(is_finite3(direction) && normalise3(direction) > 0))
        return error_set(error, STATUS_INVALID, "light '%s': direction must be finite and not zero", name);
    struct view_light old = view->light_changes[light];
    view->light_changes[light] = *change;
    to_origin(view, view->light_changes[light].position, -1);
    bool is_change = memcmp(&old, &view->light_changes[light], sizeof old) != 0;
    note_change(view, is_change);
    view->has_history &= !is_change;
    return true;
}

bool view_set_setting(struct view *view, enum setting_id id, double value, struct error *error)
{
    if (id == SETTING_photons && value > view->renderer->limits.max_photons &&
        value <= setting_infos[SETTING_photons].maximum)
        return error_set(error, STATUS_LIMIT, "setting 'photons' is at most %u on this device, not %.0f",
                         view->renderer->limits.max_photons, value);
    if (id == SETTING_photons && value >= 1 && value < view->renderer->limits.min_photons)
        return error_set(
            error, STATUS_LIMIT,
            "setting 'photons' is at least %u in this scene, one for each of its lights, not %.0f",
            view->renderer->limits.min_photons, value);
    if (id == SETTING_aa && !splat_check_aa(view->renderer, (int32_t)value, error))
        return false;
    double old = settings_get(&view->settings, id);
    if (!settings_set(&view->settings, id, value, error))
        return false;
    bool is_change = settings_get(&view->settings, id) != old;
    note_change(view, is_change);
    view->has_history &= !(is_change && id == SETTING_aa);
    return true;
}

bool view_set_time(struct view *view, double time, struct error *error)
{
    if (!isfinite(time))
        return error_set(error, STATUS_INVALID, "time must be finite");
    note_change(view, view->time != time);
    view->time = time;
    return true;
}

const struct settings *view_settings(const struct view *view)
{
    return &view->settings;
}

/* ---- a frame ------------------------------------------------------------------------------------------- */

static vec4 vec4_of(const float v[3], float w)
{
    return (vec4){v[0], v[1], v[2], w};
}

static float radical_inverse(uint32_t base, uint32_t index)
{
    float value = 0, digit = 1.0f / (float)base;
    for (; index > 0; index /= base, digit /= (float)base)
        value += digit * (float)(index % base);
    return value;
}

static void fill_camera(struct view *view, struct frame_gpu *data, uint32_t subframe)
{
    float forward[3], right[3], up[3];
    const struct view_camera *camera = &view->camera;
    view_camera_axes(camera, forward, right, up);
    float tangent = tanf(camera->fov * 0.5f * 0.0174532925f);
    float focal = 0.5f * (float)view->height / tangent; /* px per unit of tangent */
    float shift[2] = {0, 0};
    if (view->settings.accumulate > 1) {
        shift[0] = radical_inverse(2, subframe + 1) - 0.5f;
        shift[1] = radical_inverse(3, subframe + 1) - 0.5f;
    }
    /* The G-buffer's rays move within their pixels, and splats that are sampled at points with them. Those
     * that carry a pixel filter already would be filtered twice. */
    float middle[2] = {0.5f * (float)view->width, 0.5f * (float)view->height};
    bool is_sampled = view->settings.aa == SPLAT_AA_NONE || view->plan.has_quads;
    float splat_shift = is_sampled ? 1.0f : 0.0f;
    data->eye = vec4_of(camera->eye, (float)view->time);
    data->forward = vec4_of(forward, 1 / (focal * focal));
    data->right = vec4_of(right, 0);
    data->up = vec4_of(up, 0);
    data->center =
        (vec4){focal, -focal, middle[0] - splat_shift * shift[0], middle[1] - splat_shift * shift[1]};
    float origin[3], x[3], y[3];
    for (int k = 0; k < 3; k++) {
        x[k] = right[k] / focal;
        y[k] = -up[k] / focal;
        origin[k] = forward[k] - (middle[0] - shift[0]) * x[k] - (middle[1] - shift[1]) * y[k];
    }
    data->ray_origin = vec4_of(origin, 0);
    data->ray_x = vec4_of(x, 0);
    data->ray_y = vec4_of(y, 0);

    float *w = view->result.world_to_camera, *c = view->result.camera_to_clip;
    for (int k = 0; k < 3; k++) {
        w[4 * k] = right[k];
        w[4 * k + 1] = up[k];
        w[4 * k + 2] = -forward[k];
        w[4 * k + 3] = 0;
    }
    double relative[3] = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        double eye = (double)camera->eye[k] + view->renderer->extent.origin[k];
        relative[0] -= (double)right[k] * eye;
        relative[1] -= (double)up[k] * eye;
        relative[2] += (double)forward[k] * eye;
    }
    for (int k = 0; k < 3; k++)
        w[12 + k] = (float)relative[k];
    w[15] = 1;
    const float near = 0.01f, far = 1e4f;
    memset(c, 0, 16 * sizeof *c);
    c[0] = (float)view->height / ((float)view->width * tangent);
    c[5] = -1 / tangent;
    c[10] = far / (near - far);
    c[11] = -1;
    c[14] = near * far / (near - far);
}

/* Which samples of the last frame, still in the quadtree, the cells keep: those that serve from the fourth
 * frame on in which nothing changes, when task buffers have followed the change; all of them once these have
 * had the time to settle, four time constants of their update. */
static uint32_t kept_samples(const struct view *view)
{
    if (!view->has_density || view->mask_is_stale || view->still_frames < 3)
        return 0;
    return (float)view->still_frames * view->settings.temporal_weight >= 4 ? FLAG_HOLD : FLAG_SETTLE;
}

static void fill_frame(struct view *view, uint32_t subframe, uint32_t subframe_count)
{
    struct frame_gpu *data = &view->data;
    const struct settings *s = &view->settings;
    view->last_data = *data;
    fill_camera(view, data, subframe);
    data->old_eye = view->last_data.eye;
    data->old_forward = view->last_data.forward;
    data->old_right = view->last_data.right;
    data->old_up = view->last_data.up;
    data->old_scale = view->last_data.center;
    data->width = view->width;
    data->height = view->height;
    data->light_count = view->features.light_count;
    data->cells = view->cells;
    data->tile_levels = 0;
    while ((1u << data->tile_levels) < view->cells)
        data->tile_levels++;
    data->tile_slots = view->tile_slots;
    data->part_count = view->part_count;
    data->old_part_count = view->old_part_count;
    data->seed = (uint32_t)s->seed;
    data->subframe = subframe;
    budget_fill(view, data);
    data->ray_capacity = (uint32_t)(view->asked[BUFFER_RAYS] / sizeof(struct photon_ray));
    data->photon_capacity = (uint32_t)(view->asked[BUFFER_PHOTONS] / sizeof(struct photon));
    data->max_bounces = (uint32_t)s->max_bounces;
    data->camera_bounces = (uint32_t)s->camera_bounces;
    bool jitters = s->jitter || s->accumulate > 1;
    data->flags = (jitters ? FLAG_JITTER : 0) | (s->caster_mask ? FLAG_CASTER_MASK : 0) |
                  (s->radiance_scaling ? FLAG_RADIANCE_SCALING : 0) |
                  (view->has_previous ? FLAG_HAS_PREVIOUS : 0) | (jitters ? 0 : kept_samples(view));
    if (s->jitter)
        data->seed ^= (uint32_t)view->frame * 0x9e3779b9u;
    data->caster_count = view->renderer->caster_count;
    data->min_samples = view->min_samples;
    data->variance_gain = s->variance_gain;
    data->temporal_weight = s->temporal_weight;
    data->cull_energy = s->cull_energy;
    data->cull_magnification = s->cull_solid_angle / 12.5663706f;
    data->kappa = s->kappa;
    data->max_anisotropy = s->max_anisotropy;
    data->max_radius = s->max_radius;
    data->filter_radius = s->filter_radius;
    data->msaa_threshold = s->msaa_threshold;
    data->subframe_weight = 1.0f / (float)subframe_count;
    data->offset_scale = (float)view->renderer->extent.scale;
    data->offset_steps = (float)view->renderer->extent.steps;
    if (view->eye_pose != view->renderer->pose_version ||
        memcmp(&data->eye, &view->last_data.eye, 3 * sizeof(float)) != 0)
        data->eye_medium = solids_at(&view->renderer->solids, view->renderer->scene, view->renderer->pose,
                                     view->renderer->trees, view->camera.eye);
    view->eye_pose = view->renderer->pose_version;
    lookup_fill(view, subframe_count, data);
    data->tint = (vec4){1, 1, 1, 0};
    for (uint32_t i = 0; i < view->features.light_count; i++) {
        vec4 intensity = view->lights[i].intensity;
        if (intensity.w > 0) {
            float scale = 3 / intensity.w;
            data->tint = (vec4){intensity.x * scale, intensity.y * scale, intensity.z * scale, 0};
            break;
        }
    }
}

/* Of the list of lights on the device: one per part, now or in the last frame. */
static uint32_t light_entries(const struct view *view)
{
    uint32_t parts = view->part_count > view->old_part_count ? view->part_count : view->old_part_count;
    return parts > view->features.light_count ? parts : view->features.light_count;
}

static bool prepare(struct view *view)
{
    memset(view->asked, 0, sizeof view->asked);
    const struct plan *plan = &view->plan;
    bool ok = view_buffer(view, BUFFER_FRAME, sizeof(struct frame_gpu)) &&
              view_buffer(view, BUFFER_LIGHTS, (light_entries(view) + 1) * sizeof(struct light_gpu));
    if (ok && plan->has_gbuffer)
        ok = gbuffer_prepare(view);
    if (ok && plan->has_photons)
        ok = view_buffer(view, BUFFER_COUNTERS, sizeof(struct counters_gpu)) &&
             view_buffer(view, BUFFER_READBACK_COUNTERS, sizeof(struct counters_gpu)) &&
             density_prepare(view) && photons_prepare(view) && splat_prepare(view) && emitter_prepare(view) &&
             (!plan->has_lookup || lookup_prepare(view));
    if (ok && plan->has_temporal)
        ok = temporal_prepare(view);
    if (ok && plan->has_output)
        ok = compose_prepare(view);
    size_t readback = view->asked[BUFFER_OUTPUT];
    size_t cells = (size_t)view->tile_slots * view->cells * view->cells * sizeof(float);
    if (plan->has_photons && (view->channel_mask & ((1u << CHANNEL_DENSITY) | (1u << CHANNEL_VARIANCE))))
        readback += 2 * cells;
    if (ok && readback > 0)
        ok = view_buffer(view, BUFFER_READBACK, readback);
    if (!plan->has_quads)
        gpu_raster_destroy(&view->quads.raster);
    for (uint32_t i = 0; i < BUFFER_COUNT; i++)
        if (view->asked[i] == 0)
            gpu_buffer_destroy(&view->buffers[i]);
    return ok;
}

static void record(struct view *view, struct gpu_frame *frame, bool is_last)
{
    const struct plan *plan = &view->plan;
    gpu_record_upload(frame, view->buffers[BUFFER_FRAME], 0, &view->data, sizeof view->data);
    if (light_entries(view) > 0)
        gpu_record_upload(frame, view->buffers[BUFFER_LIGHTS], 0, view->lights,
                          light_entries(view) * sizeof *view->lights);
    if (plan->has_gbuffer)
        gbuffer_record(view, frame);
    if (plan->has_photons) {
        gpu_record_fill(frame, view->buffers[BUFFER_COUNTERS], 0, sizeof(struct counters_gpu), 0);
        density_record(view, frame);
        photons_record(view, frame);
        splat_record(view, frame);
        emitter_record(view, frame);
        if (plan->has_lookup)
            lookup_record(view, frame);
        if (plan->has_feedback)
            feedback_record(view, frame);
        if (plan->has_temporal)
            temporal_record(view, frame);
        gpu_record_copy(frame, view->buffers[BUFFER_READBACK_COUNTERS], 0, view->buffers[BUFFER_COUNTERS], 0,
                        sizeof(struct counters_gpu));
    }
    if (plan->has_output)
        compose_record(view, frame);
    if (!is_last)
        return;
    size_t output = view->asked[BUFFER_OUTPUT];
    if (output > 0)
        gpu_record_copy(frame, view->buffers[BUFFER_READBACK], 0, view->buffers[BUFFER_OUTPUT], 0, output);
    if (view->asked[BUFFER_READBACK] > output) {
        size_t cells = (size_t)view->tile_slots * view->cells * view->cells * sizeof(float);
        enum view_buffer density = view->subframe % 2 ? BUFFER_DENSITY_OTHER : BUFFER_DENSITY;
        gpu_record_copy(frame, view->buffers[BUFFER_READBACK], output, view->buffers[density], 0, cells);
        if (view->plan.has_variance)
            gpu_record_copy(frame, view->buffers[BUFFER_READBACK], output + cells,
                            view->buffers[BUFFER_VARIANCE], 0, cells);
    }
}

const struct frame_result *view_render(struct view *view, uint32_t channel_mask, struct error *error)
{
    struct renderer *renderer = view->renderer;
    struct frame_result *result = &view->result;
    uint64_t begin = now_ns();
    if (channel_mask >> CHANNEL_COUNT) {
        error_set(error, STATUS_INVALID, "channel bits %#x do not exist", channel_mask);
        return NULL;
    }
    memset(result->stats, 0, sizeof result->stats);
    result->pass_count = 0;
    result->frame = view->frame;
    result->time = view->time;
    view->failed = false;

    /* plan */
    if (!renderer_set_time(renderer, view->time, error))
        return NULL;
    if (view->follow_camera != SCENE_NONE)
        camera_of_scene(renderer, view->follow_camera, &view->camera);
    view->channel_mask = channel_mask;
    features_find(view, channel_mask, &view->features);
    tiles_update(view);
    plan_make(view, &view->features, channel_mask, &view->plan);
    bool works = view->plan.has_gbuffer || view->plan.has_photons;
    if (works && !prepare(view)) {
        view->has_density = view->has_feedback = false;
        *error = view->error;
        return NULL;
    }
    if (!view->plan.has_photons)
        view->has_density = view->has_feedback = view->has_previous = view->has_history = false;
    memcpy(result->plan, view->plan.lines, sizeof result->plan);
    result->plan_count = view->plan.line_count;
    result->black_reason = view->features.black_reason;
    uint64_t planned = now_ns();

    uint64_t uploading = 0;
    uint32_t subframes = works ? (uint32_t)view->settings.accumulate : 1;
    result->stats[STAT_subframes] = subframes;
    result->camera = view->camera;
    to_origin(view, result->camera.eye, 1);
    to_origin(view, result->camera.at, 1);
    if (!works)
        fill_camera(view, &view->data, 0);
    for (uint32_t subframe = 0; works && subframe < subframes; subframe++) {
        uint64_t start = now_ns();
        if (subframe > 0)
            tiles_update(view);
        fill_frame(view, subframe, subframes);
        struct gpu_frame *frame = gpu_frame_begin(renderer->gpu, error);
        if (!frame)
            return NULL;
        if (renderer->uploaded_version != renderer->pose_version &&
            !renderer_upload_pose(renderer, frame, error))
            return NULL;
        record(view, frame, subframe + 1 == subframes);
        uploading += now_ns() - start;
        if (view->failed) {
            *error = view->error;
            return NULL;
        }
        if (!gpu_frame_submit(frame, error) || !gpu_frame_wait(frame, error))
            return NULL;
        renderer->uploaded_version = renderer->pose_version;
        if (view->plan.has_photons) {
            result_add_counters(view, 1.0 / subframes);
            emitter_measure(view, gpu_buffer_map(view->buffers[BUFFER_READBACK_COUNTERS]));
            result->stats[STAT_aa_samples] = splat_samples(view);
            if (view->plan.has_lookup)
                lookup_add_counters(view);
            view->has_density = true;
            view->has_feedback = view->plan.has_feedback;
            view->has_previous = view->plan.has_variance;
            view->has_history = view->plan.has_temporal;
            view->history_pose = renderer->pose_version;
            view->subframe++;
            view->still_frames += view->still_frames < UINT32_MAX;
        }
        result_add_timings(view, frame);
    }
    uint64_t reading = now_ns();
    if (!result_collect_channels(view, error))
        return NULL;
    view->frame++;
    uint64_t end = now_ns();
    budget_measure(view, end - begin);
    result->stats[STAT_soft_error] = view->soft.error;
    result->stats[STAT_lights_shrunk] = view->lights_shrunk;
    result->stats[STAT_plan_ns] = (double)(planned - begin);
    result->stats[STAT_upload_ns] = (double)uploading;
    result->stats[STAT_readback_ns] = (double)(end - reading);
    result->stats[STAT_frame_ns] = (double)(end - begin);
    result->stats[STAT_device_bytes] = (double)gpu_memory_in_use(renderer->gpu);
    return result;
}
