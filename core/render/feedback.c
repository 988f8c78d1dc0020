/* feedback.c: what photons report to their cells (shaders/feedback.comp). */
#include <stddef.h>

#include "view_state.h"

void feedback_record(struct view *view, struct gpu_frame *frame)
{
    enum view_buffer now = splat_irradiance(view);
    enum view_buffer before =
        view->plan.has_variance && now == BUFFER_IRRADIANCE ? BUFFER_IRRADIANCE_OTHER : BUFFER_IRRADIANCE;
    gpu_pass_begin(frame, "feedback");
    gpu_record_fill(frame, view->buffers[BUFFER_FEEDBACK], 0, view->asked[BUFFER_FEEDBACK], 0);
    view_dispatch(
        view, frame,
        &(struct view_dispatch){
            .shader = "feedback.comp",
            .indirect = BUFFER_COUNTERS,
            .indirect_offset = offsetof(struct counters_gpu, photon_groups),
            USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                 {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                 {BINDING_PASS + 2, GPU_READ_WRITE, BUFFER_FEEDBACK}, {BINDING_PASS + 3, GPU_READ, now},
                 {BINDING_PASS + 4, GPU_READ, before}, {BINDING_PASS + 5, GPU_READ, BUFFER_PHOTONS},
                 {BINDING_PASS + 6, GPU_READ, BUFFER_TREE}, {BINDING_PASS + 7, GPU_READ, BUFFER_COLUMNS})});
    gpu_pass_end(frame);
}
