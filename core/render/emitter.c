/* emitter.c: lights that are spheres, disks or rectangles: how their rays are parametrised.
 *
 * Source: design 6; docs/aaps.md. The tile of such a light holds the points of a sphere about it, at the
 * pivot distance, and every part of the emitter sends its light through those points. With the pivot at the
 * casters, a move on the emitter turns a ray about the place where it meets them: a footprint that is linear
 * in that turn stays true for large emitters, where rays moved sideways would miss the caster altogether.
 */
#include <math.h>
#include <string.h>

#include "view_state.h"

/* A caster this near, in radii of the emitter, or nearer: rays through it come from nearly all sides. */
#define EMITTER_REACH 0.8f

/* Cells of a tile: how many go into the emitter's radius, and the least there are. With a glass ball 3 m from
 * a light of 0.6 m, 16 x 16 cells gave the error of 128 x 128. */
#define EMITTER_CELLS       10.0f
#define EMITTER_LEAST_CELLS 16u

static float clamped_sine(float radius, float distance)
{
    return asinf(fminf(radius / fmaxf(distance, 1e-30f), 1));
}

/* Distances of the nearest and the farthest point of the casters' boxes; nearest 0: inside one. */
static void caster_range(const struct renderer *renderer, const float p[3], float *nearest, float *farthest)
{
    *nearest = INFINITY;
    *farthest = 0;
    for (uint32_t i = 0; i < renderer->caster_box_count; i++) {
        const struct caster_box *box = &renderer->caster_boxes[i];
        const float low[3] = {box->minimum.x, box->minimum.y, box->minimum.z},
                    high[3] = {box->maximum.x, box->maximum.y, box->maximum.z};
        float near2 = 0, far2 = 0;
        for (int k = 0; k < 3; k++) {
            float below = low[k] - p[k], above = p[k] - high[k];
            float gap = fmaxf(fmaxf(below, above), 0), reach = fmaxf(fabsf(below), fabsf(above));
            near2 += gap * gap;
            far2 += reach * reach;
        }
        *nearest = fminf(*nearest, sqrtf(near2));
        *farthest = fmaxf(*farthest, sqrtf(far2));
    }
}

static float radius_of(enum light_shape shape, const float half_size[2])
{
    return shape == LIGHT_SHAPE_RECTANGLE ? hypotf(half_size[0], half_size[1])
                                          : fmaxf(half_size[0], half_size[1]);
}

uint32_t emitter_cells(const struct view *view)
{
    const struct renderer *renderer = view->renderer;
    const struct scene *scene = renderer->scene;
    uint32_t most = (uint32_t)view->settings.cells, cells = EMITTER_LEAST_CELLS;
    if (!(view->features.bits & FEATURE_SOFT))
        return most;
    for (uint32_t i = 0; i < scene->light_count && cells < most; i++) {
        const struct scene_light *light = &scene->lights[i];
        const struct view_light *change = &view->light_changes[i];
        const float *p = change->overrides & LIGHT_OVERRIDE_POSITION ? change->position
                                                                     : renderer->pose->lights[i].position;
        float nearest, farthest, radius = radius_of(light->shape, light->half_size);
        if (light->shape == LIGHT_SHAPE_POINT)
            return most;
        caster_range(renderer, p, &nearest, &farthest);
        /* a caster as wide as it is deep; finer strata than this share of the emitter's size don't show */
        float wide = 0.5f * (farthest - nearest), blur = fminf(radius, EMITTER_REACH * nearest);
        while (cells < most && !((float)cells * blur > EMITTER_CELLS * wide))
            cells *= 2;
    }
    return cells < most ? cells : most;
}

static uint32_t strata_side(const struct settings *settings)
{
    uint32_t side = 1;
    while (4 * side * side <= (uint32_t)settings->light_samples)
        side *= 2;
    return side;
}

bool emitter_fit(const struct view *view, enum light_shape shape, const float half_size[2],
                 const float side[3], struct light_gpu *light)
{
    if (shape == LIGHT_SHAPE_POINT || light->type == LIGHT_TYPE_DIRECTIONAL)
        return true;
    const float position[3] = {light->position.x, light->position.y, light->position.z};
    float radius = radius_of(shape, half_size);
    float nearest, farthest;
    caster_range(view->renderer, position, &nearest, &farthest);
    if (!(radius > 0) || !(nearest < INFINITY))
        return true;
    float scale = fminf(1, EMITTER_REACH * nearest / radius);
    radius *= scale;
    if (!(radius > 1e-6f * nearest))
        return scale == 1;
    light->shape = shape == LIGHT_SHAPE_SPHERE ? EMITTER_SPHERE
                   : shape == LIGHT_SHAPE_DISK ? EMITTER_DISK
                                               : EMITTER_RECTANGLE;
    /* where what the emitter sends to the nearest and to the farthest caster is as far off on either side */
    float pivot = radius / sinf(0.5f * (clamped_sine(radius, nearest) + clamped_sine(radius, farthest)));
    const float d[3] = {light->direction.x, light->direction.y, light->direction.z};
    float along = side[0] * d[0] + side[1] * d[1] + side[2] * d[2], x[3], length = 0;
    for (int k = 0; k < 3; k++) {
        x[k] = side[k] - along * d[k];
        length += x[k] * x[k];
    }
    length = sqrtf(length);
    if (!(length > 1e-3f)) { /* a client turned the light into its own side */
        int least = fabsf(d[0]) < fabsf(d[1]) ? (fabsf(d[0]) < fabsf(d[2]) ? 0 : 2)
                                              : (fabsf(d[1]) < fabsf(d[2]) ? 1 : 2);
        for (int k = 0; k < 3; k++)
            x[k] = (k == least ? 1.0f : 0.0f) - d[least] * d[k];
        length = sqrtf(1 - d[least] * d[least]);
    }
    for (int k = 0; k < 3; k++)
        x[k] /= length;
    const float y[3] = {d[1] * x[2] - d[2] * x[1], d[2] * x[0] - d[0] * x[2], d[0] * x[1] - d[1] * x[0]};
    float w = scale * half_size[0], h = scale * half_size[1];
    light->emitter_x = (vec4){w * x[0], w * x[1], w * x[2], pivot};
    light->emitter_y = (vec4){h * y[0], h * y[1], h * y[2], radius};
    light->emitter_side = emitter_uses_samples(view) ? strata_side(&view->settings) : 1;
    return scale == 1;
}

float emitter_angle(const struct light_gpu *light)
{
    return light->shape == EMITTER_POINT ? 0 : clamped_sine(light->emitter_y.w, light->emitter_x.w);
}

float emitter_widening(const struct view *view, const struct light_gpu *light)
{
    if (light->shape == EMITTER_POINT)
        return 0;
    const float position[3] = {light->position.x, light->position.y, light->position.z};
    float nearest, farthest, angle = emitter_angle(light);
    caster_range(view->renderer, position, &nearest, &farthest);
    return fmaxf(fabsf(clamped_sine(light->emitter_y.w, nearest) - angle),
                 fabsf(clamped_sine(light->emitter_y.w, farthest) - angle));
}

/* ---- differentials or samples -------------------------------------------------------------------------- */

/* Differentials that are this far from samples give way to them. */
#define SOFT_ERROR_MAX 0.04
/* Frames until densities have settled enough for their noise not to count. */
#define SOFT_SETTLING 2u
/* A measurement holds for emitters seen under up to this times the angle, or down to its inverse. */
#define SOFT_ANGLE_RATIO 1.5f
/* Smaller emitters, rad, are drawn within a pixel or a few: differentials serve, and samples, whose strata
 * are wider, blur more than the emitter. A glass ball's caustic, radius 1 % of the distance: 0.032 against
 * 0.038. */
#define SOFT_ANGLE_MIN 0.015f
/* While the camera moves nothing can be compared: emitters seen under a larger angle, rad, get samples. */
#define SOFT_ANGLE_MAX 0.1f

static float widest_angle(const struct view *view)
{
    float widest = 0;
    for (uint32_t i = 0; i < view->features.light_count; i++)
        widest = fmaxf(widest, emitter_angle(&view->lights[i]));
    return widest;
}

/* Whether this frame shows what the last one showed, so that their pictures may be compared. */
static bool has_same_camera(const struct view *view)
{
    const struct frame_gpu *now = &view->data, *before = &view->last_data;
    return memcmp(&now->eye, &before->eye, 3 * sizeof(float)) == 0 &&
           memcmp(&now->forward, &before->forward, sizeof now->forward) == 0 &&
           memcmp(&now->right, &before->right, sizeof now->right) == 0 &&
           memcmp(&now->center, &before->center, sizeof now->center) == 0 && now->width == before->width &&
           now->height == before->height;
}

bool emitter_uses_samples(const struct view *view)
{
    const struct soft_choice *soft = &view->soft;
    return view->settings.soft == SOFT_SAMPLES || view->settings.aa == SPLAT_AA_PIXEL ||
           (view->settings.soft == SOFT_AUTO &&
            (soft->stage == SOFT_COMPARING || (soft->stage != SOFT_UNMEASURED && soft->errs)));
}

bool emitter_prepare(struct view *view)
{
    return !view->plan.has_spreads || view->settings.soft != SOFT_AUTO || view->soft.stage == SOFT_MEASURED ||
           view_buffer(view, BUFFER_SOFT, (size_t)view->width * view->height * sizeof(vec4));
}

void emitter_record(struct view *view, struct gpu_frame *frame)
{
    if (!view->asked[BUFFER_SOFT] || view->soft.stage >= SOFT_GUESSED)
        return;
    enum view_buffer irradiance = splat_irradiance(view);
    size_t pixels = (size_t)view->width * view->height;
    if (view->soft.stage == SOFT_UNMEASURED) {
        gpu_record_copy(frame, view->buffers[BUFFER_SOFT], 0, view->buffers[irradiance], 0,
                        pixels * sizeof(vec4));
        return;
    }
    gpu_pass_begin(frame, "soft");
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "soft_compare.comp",
                                          .groups = {groups_of(view->width * view->height), 1},
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, irradiance},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_SOFT})});
    gpu_pass_end(frame);
}

void emitter_measure(struct view *view, const struct counters_gpu *counters)
{
    struct soft_choice *soft = &view->soft;
    float angle = widest_angle(view);
    if (!view->plan.has_spreads || view->settings.soft != SOFT_AUTO) {
        *soft = (struct soft_choice){0};
        return;
    }
    if (soft->stage >= SOFT_GUESSED) {
        bool has_turned = angle > SOFT_ANGLE_RATIO * soft->angle || soft->angle > SOFT_ANGLE_RATIO * angle;
        if (has_turned || (soft->stage == SOFT_GUESSED && has_same_camera(view)))
            soft->stage = SOFT_UNMEASURED;
        return;
    }
    if (!view->asked[BUFFER_SOFT])
        return;
    if (soft->stage == SOFT_UNMEASURED) {
        if (angle < SOFT_ANGLE_MIN)
            *soft = (struct soft_choice){.stage = SOFT_MEASURED, .angle = angle};
        else
            soft->stage = view->subframe < SOFT_SETTLING ? SOFT_UNMEASURED : SOFT_COMPARING;
        return;
    }
    soft->angle = angle;
    if (!has_same_camera(view)) {
        soft->stage = SOFT_GUESSED;
        soft->errs = angle > SOFT_ANGLE_MAX;
        return;
    }
    double sums[2];
    for (int i = 0; i < 2; i++) {
        int at = i ? SUM_SOFT_TOTAL : SUM_SOFT_DIFFERENCE;
        sums[i] = (double)counters->flux_high[at] * 4294967296.0 + (double)counters->flux_low[at];
    }
    soft->error = sums[1] > 0 ? sums[0] / sums[1] : 0;
    soft->errs = soft->error > SOFT_ERROR_MAX;
    soft->stage = SOFT_MEASURED;
}
