/* splat.c: draws photons and resolves the sums (shaders/splat.comp, resolve.comp). */
#include <stddef.h>

#include "view_state.h"

bool splat_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height;
    size_t channels = view->features.bits & FEATURE_CHROMATIC ? 3 : 1;
    return view_buffer(view, BUFFER_SUMS, pixels * channels * 2 * sizeof(uint32_t)) &&
           view_buffer(view, BUFFER_IRRADIANCE, pixels * sizeof(vec4)) &&
           (!view->plan.has_variance || view_buffer(view, BUFFER_IRRADIANCE_OTHER, pixels * sizeof(vec4)));
}

void splat_record(struct view *view, struct gpu_frame *frame)
{
    enum view_buffer irradiance =
        view->plan.has_variance && view->subframe % 2 ? BUFFER_IRRADIANCE_OTHER : BUFFER_IRRADIANCE;
    gpu_pass_begin(frame, "splat");
    gpu_record_fill(frame, view->buffers[BUFFER_SUMS], 0, view->asked[BUFFER_SUMS], 0);
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "splat.comp",
                                          .indirect = BUFFER_COUNTERS,
                                          .indirect_offset = offsetof(struct counters_gpu, photon_groups),
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_PHOTONS},
                                               {BINDING_PASS + 3, GPU_READ_WRITE, BUFFER_SUMS})});
    gpu_pass_end(frame);
    gpu_pass_begin(frame, "resolve");
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "resolve.comp",
                                          .lights = true,
                                          .groups = {groups_of(view->width * view->height), 1},
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                                               {BINDING_PASS + 2, GPU_READ, BUFFER_SUMS},
                                               {BINDING_PASS + 3, GPU_WRITE, irradiance},
                                               {BINDING_PASS + 4, GPU_READ, BUFFER_SURFACES})});
    gpu_pass_end(frame);
}
