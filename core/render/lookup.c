/* lookup.c: caustics seen through glass and mirrors (shaders/lookup*.comp). Source: design 8. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "view_state.h"

#define LONG_WALK_GROUPS 1024u /* workgroups that take eight long walks at a time, in turn */
/* Cells above which a walk is long. On a CPU eight lanes are one thread: nothing waits for a long walk, and
 * sharing it out took half as long again on `square` from behind; so nothing is dispatched for them. */
#define LONG_WALK     64.0f
#define LONG_WALK_CPU 1e9f

/* ---- whether it is needed ------------------------------------------------------------------------------ */

/* Whether a box about `middle` relative to the eye, with these half sizes, is wholly beyond the plane through
 * the eye with this normal. */
static bool is_beyond(const float normal[3], const float middle[3], const float half[3])
{
    float distance = 0, reach = 0;
    for (int k = 0; k < 3; k++) {
        distance += normal[k] * middle[k];
        reach += fabsf(normal[k]) * half[k];
    }
    return distance > reach * 1.0001f;
}

static bool any_caster_in_view(const struct view *view)
{
    const struct renderer *renderer = view->renderer;
    float forward[3], right[3], up[3], planes[5][3];
    if (!view_camera_axes(&view->camera, forward, right, up))
        return true;
    float tangent_y = tanf(view->camera.fov * 0.5f * 0.0174532925f);
    float tangent_x = tangent_y * (float)view->width / (float)view->height;
    for (int k = 0; k < 3; k++) {
        planes[0][k] = right[k] - tangent_x * forward[k];
        planes[1][k] = -right[k] - tangent_x * forward[k];
        planes[2][k] = up[k] - tangent_y * forward[k];
        planes[3][k] = -up[k] - tangent_y * forward[k];
        planes[4][k] = -forward[k];
    }
    for (uint32_t i = 0; i < renderer->caster_box_count; i++) {
        const float *low = &renderer->caster_boxes[i].minimum.x, *high = &renderer->caster_boxes[i].maximum.x;
        float middle[3], half[3];
        for (int k = 0; k < 3; k++) {
            middle[k] = 0.5f * (low[k] + high[k]) - view->camera.eye[k];
            half[k] = 0.5f * (high[k] - low[k]) + 1e-5f * fabsf(view->camera.eye[k]);
        }
        bool is_out = false;
        for (int p = 0; p < 5 && !is_out; p++)
            is_out = is_beyond(planes[p], middle, half);
        if (!is_out)
            return true;
    }
    return false;
}

const char *lookup_reason_against(const struct view *view, uint32_t channel_mask, uint32_t caster_count)
{
    return !(channel_mask & ((1u << CHANNEL_INDIRECT) | (1u << CHANNEL_BEAUTY)))
               ? "neither beauty nor indirect is requested"
           : view->settings.lookup == LOOKUP_OFF ? "lookup is off"
           : caster_count == 0                   ? "nothing refracts or mirrors"
           : view->settings.camera_bounces == 0  ? "camera_bounces is 0"
           : !any_caster_in_view(view)           ? "nothing that refracts or mirrors is in view"
                                                 : NULL;
}

/* ---- a frame ------------------------------------------------------------------------------------------- */

/* Samples of all broken pixels together: 8 of every 16th pixel, of small pictures 8 of 2,048. Beyond it
 * pixels get fewer. */
static size_t sample_capacity(const struct view *view)
{
    size_t half = (size_t)view->width * view->height / 2;
    return !(view->features.bits & FEATURE_SAMPLES) ? 0 : half < 16384 ? 16384 : half;
}

static size_t point_count(const struct view *view)
{
    size_t branches = view->features.bits & FEATURE_BRANCHES ? 2 : 1;
    return ((size_t)view->width * view->height + sample_capacity(view)) * branches;
}

/* A cell mostly holds a dozen points: as many slots as points leave nine of ten free, and there is one for
 * each where every point has a cell of its own. */
static uint32_t slot_count(const struct view *view)
{
    uint32_t slots = 1024;
    while (slots < point_count(view) && slots < 1u << 21)
        slots *= 2;
    return slots;
}

void lookup_fill(const struct view *view, uint32_t subframe_count, struct frame_gpu *data)
{
    /* Level 0 is 2^12 times finer than a pixel at the far end of the scene. */
    const struct renderer *renderer = view->renderer;
    float distance2 = 0;
    for (int k = 0; k < 3; k++) {
        float low = renderer->scene_min[k] - view->camera.eye[k],
              high = renderer->scene_max[k] - view->camera.eye[k];
        distance2 += fmaxf(low * low, high * high);
    }
    float pixel = sqrtf(distance2 * data->forward.w);
    int exponent = 0;
    if (isfinite(pixel) && pixel > 0)
        frexpf(pixel, &exponent);
    data->lookup_base = ldexpf(1, exponent - 12);
    /* Camera rays that move within their pixels filter by themselves. */
    data->lookup_filter = view->settings.filter_radius * (subframe_count > 1 ? 0.25f : 1);
    data->lookup_slots = slot_count(view);
    data->camera_branches = view->features.bits & FEATURE_BRANCHES ? 2 : 1;
    data->walk_alone = gpu_info(renderer->gpu)->type == GPU_DEVICE_CPU ? LONG_WALK_CPU : LONG_WALK;
    data->sample_capacity = (uint32_t)sample_capacity(view);
}

/* lookup=auto is the grid: the tree was slower on every view measured (docs/aaps.md). */
static bool uses_tree(const struct view *view)
{
    return view->settings.lookup == LOOKUP_AS;
}

bool lookup_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height, points = point_count(view);
    size_t channels = view->features.bits & FEATURE_CHROMATIC ? 3 : 1;
    size_t photons = view->asked[BUFFER_PHOTONS] / sizeof(struct photon);
    return view_buffer(view, BUFFER_CHAINS, points * sizeof(struct chain_point)) &&
           view_buffer(view, BUFFER_CHAIN_WEIGHTS, points * sizeof(vec4)) &&
           view_buffer(view, BUFFER_CHAIN_PLACES, points * 2 * sizeof(uint32_t)) &&
           (!(view->features.bits & FEATURE_SAMPLES) ||
            view_buffer(view, BUFFER_BROKEN, pixels * 2 * sizeof(uint32_t))) &&
           view_buffer(view, BUFFER_LOOKUP, sizeof(struct lookup_gpu)) &&
           view_buffer(view, BUFFER_READBACK_LOOKUP, sizeof(struct lookup_gpu)) &&
           (uses_tree(view)
                ? view_buffer(view, BUFFER_TREE_NODES, TREE_NODES * sizeof(struct tree_node)) &&
                      view_buffer(view, BUFFER_TREE_PLACES, photons * 2 * sizeof(uint32_t)) &&
                      view_buffer(view, BUFFER_TREE_ORDER, photons * sizeof(struct tree_photon)) &&
                      view_buffer(view, BUFFER_TREE_POINTS, points * sizeof(uint32_t)) &&
                      view_buffer(view, BUFFER_TREE_SHARES, photons * 2 * sizeof(uint32_t))
                : view_buffer(view, BUFFER_LOOKUP_CELLS, slot_count(view) * sizeof(struct lookup_cell)) &&
                      view_buffer(view, BUFFER_LOOKUP_MARKS, slot_count(view) / 4 * sizeof(uint32_t)) &&
                      view_buffer(view, BUFFER_LOOKUP_WALKS, photons * sizeof(uint32_t)) &&
                      view_buffer(view, BUFFER_LOOKUP_POINTS, points * sizeof(struct chain_point)) &&
                      view_buffer(view, BUFFER_LOOKUP_CODES, (points + 3) / 4 * 4 * sizeof(uint32_t))) &&
           view_buffer(view, BUFFER_LOOKUP_PHOTONS, photons * sizeof(struct lookup_photon)) &&
           view_buffer(view, BUFFER_LOOKUP_SUMS, points * channels * 2 * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_INDIRECT, pixels * sizeof(vec4));
}

static void record_samples(struct view *view, struct gpu_frame *frame)
{
    if (!(view->features.bits & FEATURE_SAMPLES))
        return;
    for (uint32_t phase = 0; phase < 2; phase++)
        view_dispatch(
            view, frame,
            &(struct view_dispatch){.shader = "lookup_break.comp",
                                    .phase = phase,
                                    .groups = {phase ? 1 : groups_of(view->width * view->height), 1},
                                    USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_LOOKUP},
                                         {BINDING_PASS + 1, GPU_READ, BUFFER_CHAINS},
                                         {BINDING_PASS + 2, GPU_READ_WRITE, BUFFER_BROKEN})});
    gbuffer_record_samples(view, frame);
}

static void zero(struct view *view, struct gpu_frame *frame, enum view_buffer buffer)
{
    gpu_record_fill(frame, view->buffers[buffer], 0, view->asked[buffer], 0);
}

/* Photons look for points. */
static void record_grid(struct view *view, struct gpu_frame *frame)
{
    zero(view, frame, BUFFER_LOOKUP_CELLS);
    zero(view, frame, BUFFER_LOOKUP_MARKS);
    uint32_t points = (uint32_t)point_count(view), slots = slot_count(view);
    bool has_samples = view->features.bits & FEATURE_SAMPLES;
    for (uint32_t phase = 0; phase < 3; phase++) /* over points, cells, points */
        view_dispatch(
            view, frame,
            &(struct view_dispatch){
                .shader = "lookup_grid.comp",
                .phase = phase,
                .groups = {groups_of(phase == 1 && slots < points ? slots : points), 1},
                .indirect = BUFFER_LOOKUP,
                .indirect_offset = phase != 1 && has_samples ? offsetof(struct lookup_gpu, point_groups) : 0,
                USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_LOOKUP},
                     {BINDING_PASS + 1, GPU_READ, BUFFER_CHAINS},
                     {BINDING_PASS + 2, GPU_READ_WRITE, BUFFER_LOOKUP_CELLS},
                     {BINDING_PASS + 3, GPU_READ_WRITE, BUFFER_LOOKUP_MARKS},
                     {BINDING_PASS + 4, GPU_READ_WRITE, BUFFER_CHAIN_PLACES},
                     {BINDING_PASS + 5, GPU_WRITE, BUFFER_LOOKUP_POINTS},
                     {BINDING_PASS + 6, GPU_READ_WRITE, BUFFER_LOOKUP_CODES})});
    const uint32_t phases = view->data.walk_alone < LONG_WALK_CPU ? 2 : 1;
    for (uint32_t phase = 0; phase < phases; phase++)
        view_dispatch(view, frame,
                      &(struct view_dispatch){.shader = "lookup.comp",
                                              .phase = phase,
                                              .groups = {LONG_WALK_GROUPS, 1},
                                              .indirect = BUFFER_COUNTERS,
                                              .indirect_offset =
                                                  phase ? 0 : offsetof(struct counters_gpu, photon_groups),
                                              USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                   {BINDING_PASS + 1, GPU_READ_WRITE, BUFFER_LOOKUP},
                                                   {BINDING_PASS + 2, GPU_READ, BUFFER_LOOKUP_PHOTONS},
                                                   {BINDING_PASS + 3, GPU_READ, BUFFER_LOOKUP_CELLS},
                                                   {BINDING_PASS + 4, GPU_READ, BUFFER_LOOKUP_MARKS},
                                                   {BINDING_PASS + 5, GPU_READ, BUFFER_LOOKUP_POINTS},
                                                   {BINDING_PASS + 6, GPU_READ_WRITE, BUFFER_LOOKUP_SUMS},
                                                   {BINDING_PASS + 7, GPU_READ_WRITE, BUFFER_PHOTONS},
                                                   {BINDING_PASS + 8, GPU_READ_WRITE, BUFFER_LOOKUP_WALKS},
                                                   {BINDING_PASS + 9, GPU_READ, BUFFER_LOOKUP_CODES})});
}

/* A phase of photon_tree.comp; `groups` 0: over all photons. */
static void record_tree_phase(struct view *view, struct gpu_frame *frame, uint32_t phase, uint32_t level,
                              uint32_t groups)
{
    view_dispatch(
        view, frame,
        &(struct view_dispatch){.shader = "photon_tree.comp",
                                .phase = phase,
                                .has_push = true,
                                .push = level,
                                .groups = {groups, 1},
                                .indirect = BUFFER_COUNTERS,
                                .indirect_offset = groups ? 0 : offsetof(struct counters_gpu, photon_groups),
                                USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                     {BINDING_PASS + 1, GPU_READ_WRITE, BUFFER_LOOKUP},
                                     {BINDING_PASS + 2, GPU_READ, BUFFER_CHAINS},
                                     {BINDING_PASS + 3, GPU_READ, BUFFER_LOOKUP_PHOTONS},
                                     {BINDING_PASS + 4, GPU_READ_WRITE, BUFFER_TREE_NODES},
                                     {BINDING_PASS + 5, GPU_READ_WRITE, BUFFER_TREE_PLACES},
                                     {BINDING_PASS + 6, GPU_WRITE, BUFFER_TREE_ORDER},
                                     {BINDING_PASS + 7, GPU_READ_WRITE, BUFFER_TREE_POINTS},
                                     {BINDING_PASS + 8, GPU_WRITE, BUFFER_CHAIN_PLACES})});
}

/* Points look for photons. */
static void record_tree(struct view *view, struct gpu_frame *frame)
{
    uint32_t points = (uint32_t)point_count(view);
    zero(view, frame, BUFFER_TREE_NODES);
    zero(view, frame, BUFFER_TREE_SHARES);
    record_tree_phase(view, frame, 0, 0, groups_of(points));
    record_tree_phase(view, frame, 1, 0, 0);
    record_tree_phase(view, frame, 2, 0, groups_of(TREE_BUCKETS));
    record_tree_phase(view, frame, 3, 0, 0);
    for (uint32_t level = 1; level < TREE_LEVELS; level++)
        record_tree_phase(view, frame, 4, level, groups_of(TREE_BUCKETS >> 3 * level));
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "lookup_gather.comp",
                                          .groups = {(points + GROUP_SIZE / 8 - 1) / (GROUP_SIZE / 8), 1},
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_LOOKUP},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_CHAINS},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_TREE_POINTS},
                                               {BINDING_PASS + 3, GPU_READ, BUFFER_TREE_NODES},
                                               {BINDING_PASS + 4, GPU_READ, BUFFER_TREE_ORDER},
                                               {BINDING_PASS + 5, GPU_READ, BUFFER_LOOKUP_PHOTONS},
                                               {BINDING_PASS + 6, GPU_READ_WRITE, BUFFER_LOOKUP_SUMS},
                                               {BINDING_PASS + 7, GPU_READ_WRITE, BUFFER_TREE_SHARES})});
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "lookup_report.comp",
                                          .indirect = BUFFER_COUNTERS,
                                          .indirect_offset = offsetof(struct counters_gpu, photon_groups),
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ_WRITE, BUFFER_LOOKUP},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_LOOKUP_PHOTONS},
                                               {BINDING_PASS + 3, GPU_READ, BUFFER_TREE_SHARES},
                                               {BINDING_PASS + 7, GPU_READ_WRITE, BUFFER_PHOTONS})});
}

void lookup_record(struct view *view, struct gpu_frame *frame)
{
    gpu_pass_begin(frame, "lookup");
    zero(view, frame, BUFFER_LOOKUP);
    zero(view, frame, BUFFER_LOOKUP_SUMS);
    record_samples(view, frame);
    if (uses_tree(view))
        record_tree(view, frame);
    else
        record_grid(view, frame);
    view_dispatch(
        view, frame,
        &(struct view_dispatch){
            .shader = "lookup_resolve.comp",
            .groups = {groups_of(view->width * view->height), 1},
            USES({BINDING_PASS, GPU_READ, BUFFER_CHAIN_PLACES},
                 {BINDING_PASS + 1, GPU_READ, BUFFER_LOOKUP_SUMS},
                 {BINDING_PASS + 2, GPU_READ, BUFFER_CHAIN_WEIGHTS},
                 {BINDING_PASS + 3, GPU_WRITE, BUFFER_INDIRECT}, {BINDING_PASS + 4, GPU_READ, BUFFER_LOOKUP},
                 {BINDING_PASS + 5, GPU_READ,
                  view->features.bits & FEATURE_SAMPLES ? BUFFER_BROKEN : BUFFER_LOOKUP})});
    gpu_record_copy(frame, view->buffers[BUFFER_READBACK_LOOKUP], 0, view->buffers[BUFFER_LOOKUP], 0,
                    sizeof(struct lookup_gpu));
    gpu_pass_end(frame);
}

void lookup_add_counters(struct view *view)
{
    static const struct {
        enum stat_id stat;
        int count;
    } counts[] = {
        {STAT_pixels_looked_up, LOOKUP_COUNT_POINTS},   {STAT_lookup_cells, LOOKUP_COUNT_CELLS},
        {STAT_lookup_photons, LOOKUP_COUNT_PHOTONS},    {STAT_lookup_photons_seen, LOOKUP_COUNT_SEEN},
        {STAT_lookup_evaluations, LOOKUP_COUNT_KERNEL}, {STAT_lookup_inside, LOOKUP_COUNT_INSIDE},
        {STAT_guard_overflow, LOOKUP_COUNT_OVERFLOW},   {STAT_lookup_limited, LOOKUP_COUNT_GUARD},
    };
    const struct lookup_gpu *lookup = gpu_buffer_map(view->buffers[BUFFER_READBACK_LOOKUP]);
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
        view->result.stats[counts[i].stat] += lookup->count[counts[i].count];
}
