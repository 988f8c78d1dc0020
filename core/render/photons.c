/* photons.c: emission and the bounce loop (shaders/photon_*.comp). */
#include <stddef.h>

#include "view_state.h"

/* Of the columns beside a ray, see shaders/spread.glsl. */
static size_t spread_bytes(const struct view *view)
{
    uint32_t bits = view->features.bits;
    size_t columns = bits & FEATURE_ROUGH ? 4u : bits & FEATURE_SOFT ? 2u : 0u;
    columns += bits & FEATURE_DISPERSION ? 1u : 0u;
    return columns * 6 * sizeof(float);
}

bool photons_prepare(struct view *view)
{
    size_t rays = renderer_rays_per_photon(view->renderer->scene) * (size_t)budget_most(view);
    size_t stored = renderer_stored_per_photon(view->renderer->scene) * (size_t)budget_most(view);
    /* a small budget still has a ray per cell of the smallest tiles */
    size_t least = GROUP_SIZE * 4;
    rays = rays < least ? least : rays;
    stored = stored < least ? least : stored;
    return view_buffer(view, BUFFER_RAYS, rays * sizeof(struct photon_ray)) &&
           view_buffer(view, BUFFER_RAYS_OTHER, rays * sizeof(struct photon_ray)) &&
           (!view->plan.has_spreads ||
            (view_buffer(view, BUFFER_SPREADS, rays * spread_bytes(view)) &&
             view_buffer(view, BUFFER_SPREADS_OTHER, rays * spread_bytes(view)))) &&
           view_buffer(view, BUFFER_QUEUE, rays * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_QUEUE_OTHER, rays * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_OUTCOMES, rays * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_GROUPS, (rays / GROUP_SIZE + 1) * 2 * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_PHOTONS, stored * sizeof(struct photon));
}

void photons_record(struct view *view, struct gpu_frame *frame)
{
    gpu_pass_begin(frame, "emit");
    view_dispatch(
        view, frame,
        &(struct view_dispatch){
            .shader = "photon_emit.comp",
            .lights = true,
            .indirect = BUFFER_COUNTERS,
            .indirect_offset = offsetof(struct counters_gpu, queue),
            USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS}, {BINDING_PASS + 1, GPU_READ, BUFFER_TREE},
                 {BINDING_PASS + 2, GPU_WRITE, BUFFER_RAYS}, {BINDING_PASS + 3, GPU_WRITE, BUFFER_QUEUE},
                 {BINDING_PASS + 4, GPU_WRITE, view->plan.has_spreads ? BUFFER_SPREADS : BUFFER_QUEUE},
                 {BINDING_PASS + 5, GPU_READ, BUFFER_COLUMNS})});
    gpu_pass_end(frame);
    /* a photon that becomes three bands is traced once more */
    uint32_t bounces =
        (uint32_t)view->settings.max_bounces + 1 + (view->features.bits & FEATURE_DISPERSION ? 1 : 0);
    for (uint32_t bounce = 0; bounce < bounces; bounce++) {
        uint32_t parity = bounce % 2;
        enum view_buffer rays = parity ? BUFFER_RAYS_OTHER : BUFFER_RAYS;
        enum view_buffer children = parity ? BUFFER_RAYS : BUFFER_RAYS_OTHER;
        enum view_buffer queue = parity ? BUFFER_QUEUE_OTHER : BUFFER_QUEUE;
        enum view_buffer next_queue = parity ? BUFFER_QUEUE : BUFFER_QUEUE_OTHER;
        /* without them the bindings are there but nobody looks */
        bool spreads = view->plan.has_spreads;
        enum view_buffer spread = !spreads ? rays : parity ? BUFFER_SPREADS_OTHER : BUFFER_SPREADS;
        enum view_buffer child_spread = !spreads ? children : parity ? BUFFER_SPREADS : BUFFER_SPREADS_OTHER;
        size_t groups = offsetof(struct counters_gpu, queue) + parity * 4 * sizeof(uint32_t);
        gpu_pass_begin(frame, "trace");
        view_dispatch(
            view, frame,
            &(struct view_dispatch){
                .shader = "photon_trace.comp",
                .traces = true,
                .has_push = true,
                .push = parity,
                .indirect = BUFFER_COUNTERS,
                .indirect_offset = groups,
                USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                     {BINDING_PASS + 1, GPU_READ_WRITE, rays}, {BINDING_PASS + 2, GPU_WRITE, children},
                     {BINDING_PASS + 3, GPU_READ, queue}, {BINDING_PASS + 4, GPU_WRITE, BUFFER_OUTCOMES},
                     {BINDING_PASS + 5, GPU_WRITE, BUFFER_GROUPS}, {BINDING_PASS + 6, GPU_READ_WRITE, spread},
                     {BINDING_PASS + 7, GPU_WRITE, child_spread},
                     {BINDING_PASS + 8, GPU_READ_WRITE,
                      view->settings.density == DENSITY_ERROR ? BUFFER_COSTS : BUFFER_OUTCOMES},
                     {BINDING_PASS + 9, GPU_READ, BUFFER_TREE},
                     {BINDING_PASS + 10, GPU_READ, BUFFER_COLUMNS})});
        gpu_pass_end(frame);
        gpu_pass_begin(frame, "compact");
        view_dispatch(view, frame,
                      &(struct view_dispatch){.shader = "photon_scan.comp",
                                              .has_push = true,
                                              .push = parity,
                                              .groups = {1, 1},
                                              USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                                   {BINDING_PASS + 1, GPU_READ_WRITE, BUFFER_GROUPS})});
        view_dispatch(
            view, frame,
            &(struct view_dispatch){
                .shader = "photon_compact.comp",
                .has_push = true,
                .push = parity,
                .indirect = BUFFER_COUNTERS,
                .indirect_offset = groups,
                USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                     {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS}, {BINDING_PASS + 2, GPU_READ, rays},
                     {BINDING_PASS + 3, GPU_READ, queue}, {BINDING_PASS + 4, GPU_READ, BUFFER_OUTCOMES},
                     {BINDING_PASS + 5, GPU_READ, BUFFER_GROUPS}, {BINDING_PASS + 6, GPU_WRITE, next_queue},
                     {BINDING_PASS + 7, GPU_WRITE, BUFFER_PHOTONS}, {BINDING_PASS + 8, GPU_READ, BUFFER_TREE},
                     {BINDING_PASS + 9, GPU_WRITE,
                      view->plan.has_lookup ? BUFFER_LOOKUP_PHOTONS : BUFFER_PHOTONS},
                     {BINDING_PASS + 10, GPU_READ, spread})});
        gpu_pass_end(frame);
    }
}
