/* gbuffer.c: the surface every pixel shows (shaders/gbuffer.comp). */
#include "view_state.h"

bool gbuffer_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height;
    return view_buffer(view, BUFFER_SURFACES, pixels * sizeof(struct surface_gpu)) &&
           view_buffer(view, BUFFER_TARGETS, pixels * sizeof(struct target_gpu));
}

void gbuffer_record(struct view *view, struct gpu_frame *frame)
{
    bool has_lookup = view->plan.has_lookup;
    enum view_buffer chains = has_lookup ? BUFFER_CHAINS : BUFFER_TARGETS;
    enum view_buffer weights = has_lookup ? BUFFER_CHAIN_WEIGHTS : BUFFER_TARGETS;
    gpu_pass_begin(frame, "gbuffer");
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "gbuffer.comp",
                                          .traces = true,
                                          .lights = true,
                                          .groups = {(view->width + 7) / 8, (view->height + 7) / 8},
                                          USES({BINDING_PASS, GPU_WRITE, BUFFER_SURFACES},
                                               {BINDING_PASS + 1, GPU_WRITE, BUFFER_TARGETS},
                                               {BINDING_PASS + 2, GPU_WRITE, chains},
                                               {BINDING_PASS + 3, GPU_WRITE, weights})});
    gpu_pass_end(frame);
}
