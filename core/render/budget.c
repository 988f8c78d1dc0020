/* budget.c: how many photons a view may have: by its settings, and by the time that a frame is given. */
#include <math.h>
#include <string.h>

#include "view_state.h"

static double quality_factor(const struct view *view)
{
    return view->settings.quality == QUALITY_DRAFT ? 0.25 : view->settings.quality == QUALITY_FINAL ? 4 : 1;
}

uint32_t budget_most(const struct view *view)
{
    double photons = (double)view->settings.photons * quality_factor(view);
    photons = fmin(photons, view->renderer->limits.max_photons);
    return (uint32_t)fmax(photons, view->renderer->limits.min_photons);
}

const char *budget_reason_against(const struct view *view, const struct plan *plan)
{
    return view->settings.budget_ms <= 0   ? "budget_ms is 0"
           : view->settings.accumulate > 1 ? "accumulate is above 1: its frames have all photons, "
                                             "budget_ms is not held"
           : !plan->has_photons            ? "no photons are emitted: there is nothing to steer"
                                           : NULL;
}

/* Every cell keeps its samples, whatever the time. */
static double budget_least(const struct view *view)
{
    uint32_t tiles = view->features.lit_count + view->part_count - view->features.light_count;
    double kept = (double)view->min_samples * tiles * view->cells * view->cells;
    return fmin(fmax(kept, view->renderer->limits.min_photons), budget_most(view));
}

static double most_rays(const struct view *view)
{
    return view->features.bits & FEATURE_SAMPLES ? (double)view->settings.camera_samples : 1;
}

static double most_samples(const struct view *view)
{
    return view->plan.has_quads ? gpu_info(view->renderer->gpu)->max_samples : 1;
}

uint32_t budget_samples(struct view *view)
{
    double most = most_samples(view);
    return budget_reason_against(view, &view->plan) ? (uint32_t)most
                                                    : governor_count(&view->governor, GOVERNOR_SAMPLES, most);
}

void budget_fill(struct view *view, struct frame_gpu *data)
{
    data->photon_budget = budget_most(view);
    data->target_area = view->settings.target_area / (float)quality_factor(view);
    data->camera_samples = (uint32_t)most_rays(view);
    if (budget_reason_against(view, &view->plan)) {
        view->governor = (struct governor){0};
        return;
    }
    data->photon_budget = governor_photons(&view->governor, budget_least(view), data->photon_budget);
    data->camera_samples = governor_count(&view->governor, GOVERNOR_RAYS, data->camera_samples);
    /* Small enough that the budget is what limits photons, not the area they are content with. */
    data->target_area *= 1.0f / 64;
}

static double pass_ns(const struct frame_result *result, const char *name)
{
    double sum = 0;
    for (uint32_t i = 0; i < result->pass_count; i++)
        if (strcmp(result->passes[i].name, name) == 0)
            sum += (double)result->passes[i].elapsed_ns;
    return sum;
}

/* What passes took whose work grows with photons, if not all of it does. */
static double photons_ns(const struct frame_result *result)
{
    static const char *const names[] = {"emit", "trace", "compact", "splat", "lookup", "feedback"};
    double sum = 0;
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        sum += pass_ns(result, names[i]);
    return sum;
}

void budget_measure(struct view *view, uint64_t elapsed_ns)
{
    double *stats = view->result.stats;
    if (budget_reason_against(view, &view->plan))
        return;
    stats[STAT_governor_photons] = view->data.photon_budget;
    stats[STAT_governor_target_area] = (double)view->data.target_area;
    stats[STAT_governor_camera_samples] = view->data.camera_samples;
    if (governor_step(&view->governor,
                      &(struct governor_frame){
                          .measured_ns = (double)elapsed_ns,
                          .device_ns = stats[STAT_gpu_ns],
                          .photons_ns = photons_ns(&view->result),
                          .target_ns = 1e6 * (double)view->settings.budget_ms,
                          .emitted = stats[STAT_photons_emitted],
                          .least = budget_least(view),
                          .most = budget_most(view),
                          .knobs[GOVERNOR_RAYS] = {most_rays(view), pass_ns(&view->result, "lookup")},
                          .knobs[GOVERNOR_SAMPLES] = {most_samples(view), pass_ns(&view->result, "splat")},
                          .is_at_rest = (view->data.flags & FLAG_HOLD) != 0,
                      }))
        view->still_frames = 0; /* samples have to follow the new budget before they may rest */
}
