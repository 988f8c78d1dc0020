/* temporal.c: keeps a share of the frames before in the caustics that are shown (shaders/temporal.comp).
 *
 * What photons report, and with it the task buffers, come from the unblended irradiance. The history ends
 * where light may have moved: a frame in which a light, the scene's pose, the size or the anti-aliasing
 * changed shows what it would show without.
 */
#include <string.h>

#include "view_state.h"

enum view_buffer temporal_output(const struct view *view)
{
    return view->subframe % 2 ? BUFFER_BLENDED_OTHER : BUFFER_BLENDED;
}

bool temporal_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height;
    return view_buffer(view, BUFFER_BLENDED, pixels * sizeof(vec4)) &&
           view_buffer(view, BUFFER_BLENDED_OTHER, pixels * sizeof(vec4)) &&
           view_buffer(view, BUFFER_OLD_TARGETS, pixels * sizeof(struct target_gpu));
}

void temporal_record(struct view *view, struct gpu_frame *frame)
{
    enum view_buffer output = temporal_output(view);
    bool has_history = view->has_history && view->history_pose == view->renderer->pose_version;
    float share = has_history ? view->settings.temporal : 0;
    uint32_t push;
    memcpy(&push, &share, sizeof push);
    gpu_pass_begin(frame, "temporal");
    view_dispatch(
        view, frame,
        &(struct view_dispatch){.shader = "temporal.comp",
                                .has_push = true,
                                .push = push,
                                .groups = {groups_of(view->width * view->height), 1},
                                USES({BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                                     {BINDING_PASS + 2, GPU_READ, splat_irradiance(view)},
                                     {BINDING_PASS + 3, GPU_READ,
                                      output == BUFFER_BLENDED ? BUFFER_BLENDED_OTHER : BUFFER_BLENDED},
                                     {BINDING_PASS + 4, GPU_READ, BUFFER_OLD_TARGETS},
                                     {BINDING_PASS + 5, GPU_WRITE, output})});
    gpu_record_copy(frame, view->buffers[BUFFER_OLD_TARGETS], 0, view->buffers[BUFFER_TARGETS], 0,
                    view->asked[BUFFER_TARGETS]);
    gpu_pass_end(frame);
    view->has_history = false; /* until the frame is there */
}
