/* compose.c: the requested channels, ready for reading back (shaders/compose.comp). */
#include "view_state.h"

/* Channels with a value per pixel, in the order the shader writes them. */
#define IMAGE_CHANNELS ((1u << CHANNEL_DENSITY) - 1)

bool compose_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height, components = 0;
    for (uint32_t i = 0; i < CHANNEL_COUNT; i++)
        if (view->channel_mask & IMAGE_CHANNELS & (1u << i))
            components += channel_infos[i].components;
    return view_buffer(view, BUFFER_OUTPUT, pixels * components * sizeof(float));
}

void compose_record(struct view *view, struct gpu_frame *frame)
{
    gpu_pass_begin(frame, "compose");
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "compose.comp",
                                          .has_push = true,
                                          .push = view->channel_mask & IMAGE_CHANNELS,
                                          .groups = {groups_of(view->width * view->height), 1},
                                          USES({BINDING_PASS, GPU_READ, BUFFER_SURFACES},
                                               {BINDING_PASS + 1, GPU_READ,
                                                !view->plan.has_photons   ? BUFFER_SURFACES
                                                : view->plan.has_temporal ? temporal_output(view)
                                                                          : splat_irradiance(view)},
                                               {BINDING_PASS + 2, GPU_READ_WRITE, BUFFER_OUTPUT},
                                               {BINDING_PASS + 3, GPU_READ,
                                                view->plan.has_lookup ? BUFFER_INDIRECT : BUFFER_SURFACES})});
    gpu_pass_end(frame);
}
