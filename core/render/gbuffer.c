/* gbuffer.c: the surface every pixel shows (shaders/gbuffer.comp). */
#include <stddef.h>

#include "view_state.h"

bool gbuffer_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height;
    return view_buffer(view, BUFFER_SURFACES, pixels * sizeof(struct surface_gpu)) &&
           view_buffer(view, BUFFER_TARGETS, pixels * sizeof(struct target_gpu));
}

static void record_rays(struct view *view, struct gpu_frame *frame, uint32_t phase, uint32_t columns,
                        uint32_t rows)
{
    bool has_lookup = view->plan.has_lookup;
    enum view_buffer chains = has_lookup ? BUFFER_CHAINS : BUFFER_TARGETS;
    enum view_buffer weights = has_lookup ? BUFFER_CHAIN_WEIGHTS : BUFFER_TARGETS;
    bool has_samples = has_lookup && (view->features.bits & FEATURE_SAMPLES);
    view_dispatch(
        view, frame,
        &(struct view_dispatch){
            .shader = "gbuffer.comp",
            .traces = true,
            .lights = true,
            .phase = phase,
            .groups = {columns, rows},
            .indirect = BUFFER_LOOKUP,
            .indirect_offset = phase ? offsetof(struct lookup_gpu, sample_groups) : 0,
            USES({BINDING_PASS, GPU_WRITE, BUFFER_SURFACES}, {BINDING_PASS + 1, GPU_WRITE, BUFFER_TARGETS},
                 {BINDING_PASS + 2, GPU_WRITE, chains}, {BINDING_PASS + 3, GPU_WRITE, weights},
                 {BINDING_PASS + 4, GPU_READ, has_samples ? BUFFER_LOOKUP : BUFFER_FRAME},
                 {BINDING_PASS + 5, GPU_READ, has_samples ? BUFFER_BROKEN : BUFFER_FRAME})});
}

void gbuffer_record(struct view *view, struct gpu_frame *frame)
{
    gpu_pass_begin(frame, "gbuffer");
    record_rays(view, frame, 0, (view->width + 7) / 8, (view->height + 7) / 8);
    gpu_pass_end(frame);
}

void gbuffer_record_samples(struct view *view, struct gpu_frame *frame)
{
    record_rays(view, frame, 1, 0, 0);
}
