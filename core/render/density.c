/* density.c: task buffers: caster mask, density, quadtree (shaders/caster_mask, density_*, quadtree.comp). */
#include "view_state.h"

static uint32_t cell_total(const struct view *view)
{
    return view->tile_slots * view->cells * view->cells;
}

static enum view_buffer density_now(const struct view *view)
{
    return view->subframe % 2 ? BUFFER_DENSITY_OTHER : BUFFER_DENSITY;
}

static enum view_buffer density_before(const struct view *view)
{
    return view->subframe % 2 ? BUFFER_DENSITY : BUFFER_DENSITY_OTHER;
}

bool density_prepare(struct view *view)
{
    size_t cells = cell_total(view);
    return view_buffer(view, BUFFER_BOXES, 2 * MAX_CASTER_BOXES * sizeof(struct caster_box)) &&
           view_buffer(view, BUFFER_MASK, cells * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_DENSITY, cells * sizeof(float)) &&
           view_buffer(view, BUFFER_DENSITY_OTHER, cells * sizeof(float)) &&
           view_buffer(view, BUFFER_TREE, (cells * 4 / 3 + 1) * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_COLUMNS, cells * sizeof(uint32_t)) &&
           (view->settings.density != DENSITY_ERROR ||
            (view_buffer(view, BUFFER_ASPECT, cells * sizeof(float)) &&
             view_buffer(view, BUFFER_COSTS, cells * sizeof(uint32_t)))) &&
           view_buffer(view, BUFFER_PARTIALS, 2 * (size_t)groups_of((uint32_t)cells) * sizeof(vec2)) &&
           (!view->plan.has_feedback ||
            view_buffer(view, BUFFER_FEEDBACK, cells * sizeof(struct feedback_gpu))) &&
           (!view->plan.has_variance || view_buffer(view, BUFFER_VARIANCE, cells * sizeof(float)));
}

void density_record(struct view *view, struct gpu_frame *frame)
{
    uint32_t cells = cell_total(view), groups = groups_of(cells);
    struct renderer *renderer = view->renderer;
    bool is_error_rule = view->settings.density == DENSITY_ERROR;
    enum view_buffer aspect = is_error_rule ? BUFFER_ASPECT : BUFFER_PARTIALS; /* any, where it is not used */
    enum view_buffer costs = is_error_rule ? BUFFER_COSTS : BUFFER_MASK;
    gpu_pass_begin(frame, "density");
    /* The last frame's photons report about the last frame's tiles: take that in before tiles change. */
    if (view->has_feedback) {
        if (view->settings.density == DENSITY_SQRT || is_error_rule) {
            view_dispatch(view, frame,
                          &(struct view_dispatch){.shader = "density_measure.comp",
                                                  .lights = true,
                                                  .groups = {groups, 1},
                                                  USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                       {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                                       {BINDING_PASS + 2, GPU_READ, BUFFER_FEEDBACK},
                                                       {BINDING_PASS + 3, GPU_WRITE, BUFFER_PARTIALS},
                                                       {BINDING_PASS + 4, GPU_WRITE, density_now(view)},
                                                       {BINDING_PASS + 5, GPU_READ, BUFFER_TREE},
                                                       {BINDING_PASS + 6, GPU_READ, BUFFER_COLUMNS},
                                                       {BINDING_PASS + 7, GPU_READ_WRITE, aspect},
                                                       {BINDING_PASS + 8, GPU_READ, costs})});
            view_dispatch(view, frame,
                          &(struct view_dispatch){.shader = "density_scale.comp",
                                                  .lights = true,
                                                  .phase = 0,
                                                  .groups = {1, 1},
                                                  USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                       {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                                       {BINDING_PASS + 2, GPU_READ, BUFFER_PARTIALS})});
        }
        view_dispatch(
            view, frame,
            &(struct view_dispatch){.shader = "density_update.comp",
                                    .lights = true,
                                    .groups = {groups, 1},
                                    USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                         {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                         {BINDING_PASS + 2, GPU_READ, BUFFER_FEEDBACK},
                                         {BINDING_PASS + 3, GPU_READ, density_before(view)},
                                         {BINDING_PASS + 4, GPU_READ_WRITE, density_now(view)},
                                         {BINDING_PASS + 5, GPU_WRITE,
                                          view->plan.has_variance ? BUFFER_VARIANCE : BUFFER_PARTIALS})});
    } else {
        if (is_error_rule)
            gpu_record_fill(frame, view->buffers[BUFFER_ASPECT], 0, cells * sizeof(float), 0);
        if (view->plan.has_variance)
            gpu_record_fill(frame, view->buffers[BUFFER_VARIANCE], 0, cells * sizeof(float), 0);
        if (view->has_density)
            gpu_record_copy(frame, view->buffers[density_now(view)], 0, view->buffers[density_before(view)],
                            0, cells * sizeof(float));
    }
    if (view->mask_is_stale) {
        size_t casters = renderer->caster_count * sizeof(struct caster_box);
        gpu_record_upload(frame, view->buffers[BUFFER_BOXES], 0, renderer->casters, casters);
        gpu_record_upload(frame, view->buffers[BUFFER_BOXES], casters, renderer->caster_boxes,
                          renderer->caster_box_count * sizeof(struct caster_box));
        view_dispatch(view, frame,
                      &(struct view_dispatch){.shader = "caster_mask.comp",
                                              .lights = true,
                                              .groups = {groups, 1},
                                              USES({BINDING_PASS, GPU_READ, BUFFER_BOXES},
                                                   {BINDING_PASS + 1, GPU_WRITE, BUFFER_MASK})});
    }
    /* Uniform density has no update that would follow a new budget. */
    if (view->mask_is_stale || view->settings.density == DENSITY_UNIFORM) {
        view_dispatch(view, frame,
                      &(struct view_dispatch){.shader = "density_seed.comp",
                                              .lights = true,
                                              .groups = {groups, 1},
                                              USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                   {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                                   {BINDING_PASS + 2, GPU_READ, density_now(view)},
                                                   {BINDING_PASS + 3, GPU_WRITE, density_before(view)})});
        gpu_record_copy(frame, view->buffers[density_now(view)], 0, view->buffers[density_before(view)], 0,
                        cells * sizeof(float));
    }
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "density_sum.comp",
                                          .lights = true,
                                          .groups = {groups, 1},
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                               {BINDING_PASS + 2, GPU_READ, density_now(view)},
                                               {BINDING_PASS + 3, GPU_WRITE, BUFFER_PARTIALS})});
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "density_scale.comp",
                                          .lights = true,
                                          .phase = 1,
                                          .groups = {1, 1},
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_PARTIALS})});
    uint32_t level = 0;
    for (uint32_t count = cells;; count /= 4, level++) {
        view_dispatch(view, frame,
                      &(struct view_dispatch){.shader = "quadtree.comp",
                                              .lights = true,
                                              .has_push = true,
                                              .push = level,
                                              .groups = {groups_of(count), 1},
                                              USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                   {BINDING_PASS + 1, GPU_READ, BUFFER_MASK},
                                                   {BINDING_PASS + 2, GPU_READ_WRITE, density_now(view)},
                                                   {BINDING_PASS + 3, GPU_READ_WRITE, BUFFER_TREE},
                                                   {BINDING_PASS + 4, GPU_READ_WRITE, BUFFER_COLUMNS},
                                                   {BINDING_PASS + 5, GPU_READ, aspect})});
        if (count == 1)
            break;
    }
    if (is_error_rule)
        gpu_record_fill(frame, view->buffers[BUFFER_COSTS], 0, cells * sizeof(uint32_t), 0);
    gpu_pass_end(frame);
}
