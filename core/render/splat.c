/* splat.c: draws photons and resolves what they add up to (shaders/splat.comp, splat_quad.*,
 * splat_count.comp, resolve.comp).
 *
 * Splats are computed into fixed-point sums; the thesis' multisampled variants are quads for the rasteriser,
 * blended into floats. Blending keeps the order of the primitives, and photons have a fixed order: the same
 * bits every time either way.
 */
#include <stddef.h>

#include "../../shaders/shader_table.h"
#include "view_state.h"

#define PIECE_GROUPS 1024u /* workgroups that draw pieces of wide footprints, in turn */

static struct gpu_raster_params quad_params(int32_t aa, uint32_t samples)
{
    return (struct gpu_raster_params){.name = "splat_quad",
                                      .binding_mask = 1u << BINDING_FRAME | 14u << BINDING_PASS,
                                      .width = 1,
                                      .height = 1,
                                      .samples = samples,
                                      .per_sample = aa != SPLAT_AA_MSAA,
                                      .writes_buffers = true};
}

bool splat_check_aa(const struct renderer *renderer, int32_t aa, struct error *error)
{
    if (aa != SPLAT_AA_MSAA && aa != SPLAT_AA_MSAA_SAMPLE && aa != SPLAT_AA_MSAA_SMALL)
        return true;
    const struct gpu_info *info = gpu_info(renderer->gpu);
    if (info->max_samples < 2)
        return error_set(
            error, STATUS_UNSUPPORTED,
            "setting 'aa': multisampling needs RGBA32F with several samples, which %s does not have",
            info->name);
    struct gpu_raster_params params = quad_params(aa, info->max_samples);
    params.name = "aa";
    return gpu_raster_check(renderer->gpu, &params, error);
}

uint32_t splat_samples(const struct view *view)
{
    return view->plan.has_quads ? view->quads.samples : 1;
}

static bool prepare_quads(struct view *view)
{
    struct splat_quads *quads = &view->quads;
    const struct settings *settings = &view->settings;
    const uint32_t wanted = budget_samples(view);
    if (quads->raster && quads->width == view->width && quads->height == view->height &&
        quads->aa == settings->aa && quads->depth_test == settings->depth_test && quads->wanted == wanted)
        return true;
    gpu_raster_destroy(&quads->raster);
    struct gpu_raster_params params = quad_params(settings->aa, wanted);
    struct error none_such;
    while (params.samples > 1 && !gpu_raster_check(view->renderer->gpu, &params, &none_such))
        params.samples /= 2; /* devices leave out some numbers below their most */
    const struct gpu_constant constants[] = {{CONSTANT_AA, (uint32_t)settings->aa},
                                             {CONSTANT_DEPTH, (uint32_t)settings->depth_test}};
    params.width = view->width;
    params.height = view->height;
    params.constants = constants;
    params.constant_count = 2;
    params.vertex_spirv = shader_find("splat_quad.vert", &params.vertex_bytes);
    params.fragment_spirv = shader_find("splat_quad.frag", &params.fragment_bytes);
    *quads = (struct splat_quads){gpu_raster_create(view->renderer->gpu, &params, &view->error),
                                  view->width,
                                  view->height,
                                  settings->aa,
                                  settings->depth_test,
                                  wanted,
                                  params.samples};
    return quads->raster != NULL;
}

/* Every footprint but that of aa=pixel may be wide. */
static bool has_pieces(const struct view *view)
{
    return view->settings.aa != SPLAT_AA_PIXEL;
}

bool splat_prepare(struct view *view)
{
    size_t pixels = (size_t)view->width * view->height;
    size_t channels = view->features.bits & FEATURE_CHROMATIC ? 3 : 1;
    return (!view->plan.has_sums ||
            (view_buffer(view, BUFFER_SUMS, pixels * channels * 2 * sizeof(uint32_t)) &&
             (!has_pieces(view) || view_buffer(view, BUFFER_PIECES,
                                               view->asked[BUFFER_PHOTONS] / sizeof(struct photon) *
                                                   sizeof(struct splat_piece))))) &&
           (!view->plan.has_quads ||
            (view_buffer(view, BUFFER_PICTURE, pixels * sizeof(vec4)) &&
             view_buffer(view, BUFFER_REACHED,
                         view->asked[BUFFER_PHOTONS] / sizeof(struct photon) * sizeof(uint32_t)) &&
             prepare_quads(view))) &&
           view_buffer(view, BUFFER_IRRADIANCE, pixels * sizeof(vec4)) &&
           (!view->plan.has_variance || view_buffer(view, BUFFER_IRRADIANCE_OTHER, pixels * sizeof(vec4)));
}

static void record_quads(struct view *view, struct gpu_frame *frame)
{
    struct gpu_buffer **buffers = view->buffers;
    const struct gpu_bind binds[] = {
        {.binding = BINDING_FRAME, .access = GPU_READ, .buffer = buffers[BUFFER_FRAME]},
        {.binding = BINDING_PASS + 1, .access = GPU_READ, .buffer = buffers[BUFFER_TARGETS]},
        {.binding = BINDING_PASS + 2, .access = GPU_READ, .buffer = buffers[BUFFER_PHOTONS]},
        {.binding = BINDING_PASS + 3, .access = GPU_WRITE, .buffer = buffers[BUFFER_REACHED]}};
    gpu_record_fill(frame, buffers[BUFFER_REACHED], 0, view->asked[BUFFER_REACHED], 0);
    gpu_record_draw(frame,
                    &(struct gpu_draw){.raster = view->quads.raster,
                                       .binds = binds,
                                       .bind_count = sizeof binds / sizeof *binds,
                                       .indirect = buffers[BUFFER_COUNTERS],
                                       .indirect_offset = offsetof(struct counters_gpu, photon_quads)});
    gpu_record_raster_read(frame, view->quads.raster, buffers[BUFFER_PICTURE]);
    view_dispatch(view, frame,
                  &(struct view_dispatch){.shader = "splat_count.comp",
                                          .indirect = BUFFER_COUNTERS,
                                          .indirect_offset = offsetof(struct counters_gpu, photon_groups),
                                          USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                               {BINDING_PASS + 1, GPU_READ, BUFFER_REACHED})});
}

enum view_buffer splat_irradiance(const struct view *view)
{
    return view->plan.has_variance && view->subframe % 2 ? BUFFER_IRRADIANCE_OTHER : BUFFER_IRRADIANCE;
}

void splat_record(struct view *view, struct gpu_frame *frame)
{
    const struct plan *plan = &view->plan;
    gpu_pass_begin(frame, "splat");
    if (plan->has_sums) {
        gpu_record_fill(frame, view->buffers[BUFFER_SUMS], 0, view->asked[BUFFER_SUMS], 0);
        for (uint32_t phase = 0; phase < (has_pieces(view) ? 2u : 1u); phase++)
            view_dispatch(view, frame,
                          &(struct view_dispatch){
                              .shader = "splat.comp",
                              .phase = phase,
                              .groups = {phase ? PIECE_GROUPS : 0, phase ? 1 : 0},
                              .indirect = BUFFER_COUNTERS,
                              .indirect_offset = phase ? 0 : offsetof(struct counters_gpu, photon_groups),
                              USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                                   {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                                   {BINDING_PASS + 2, GPU_READ, BUFFER_PHOTONS},
                                   {BINDING_PASS + 3, GPU_READ_WRITE, BUFFER_SUMS},
                                   {BINDING_PASS + 4, has_pieces(view) ? GPU_READ_WRITE : GPU_READ,
                                    has_pieces(view) ? BUFFER_PIECES : BUFFER_TARGETS})});
    }
    if (plan->has_quads)
        record_quads(view, frame);
    gpu_pass_end(frame);
    /* what this anti-aliasing does not have stands for itself by the targets: the shader has no code that
     * reads it */
    gpu_pass_begin(frame, "resolve");
    view_dispatch(view, frame,
                  &(struct view_dispatch){
                      .shader = "resolve.comp",
                      .lights = true,
                      .groups = {groups_of(view->width * view->height), 1},
                      USES({BINDING_PASS, GPU_READ_WRITE, BUFFER_COUNTERS},
                           {BINDING_PASS + 1, GPU_READ, BUFFER_TARGETS},
                           {BINDING_PASS + 2, GPU_READ, plan->has_sums ? BUFFER_SUMS : BUFFER_TARGETS},
                           {BINDING_PASS + 3, GPU_WRITE, splat_irradiance(view)},
                           {BINDING_PASS + 4, GPU_READ, BUFFER_SURFACES},
                           {BINDING_PASS + 5, GPU_READ, plan->has_quads ? BUFFER_PICTURE : BUFFER_TARGETS})});
    gpu_pass_end(frame);
}
