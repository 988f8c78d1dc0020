/* plan.c: from features to what a frame consists of, with the reason for everything left out. Source:
 * design 11. */
#include <string.h>

#include "view_state.h"

static void line(struct plan *plan, const char *name, bool is_used, const char *used, const char *unused)
{
    if (plan->line_count < VIEW_MAX_PLAN_LINES)
        plan->lines[plan->line_count++] = (struct plan_line){name, is_used, is_used ? used : unused};
}

void plan_make(const struct view *view, const struct features *features, uint32_t channel_mask,
               struct plan *plan)
{
    const struct settings *settings = &view->settings;
    uint32_t bits = features->bits;
    memset(plan, 0, sizeof *plan);
    uint32_t images = channel_mask & ((1u << CHANNEL_DENSITY) - 1);
    uint32_t geometry =
        (1u << CHANNEL_BEAUTY) | (1u << CHANNEL_DEPTH) | (1u << CHANNEL_NORMAL) | (1u << CHANNEL_ALBEDO);
    bool has_geometry = view->renderer->scene->instance_count > 0;
    plan->has_photons = features->needs_caustics;
    plan->has_gbuffer = has_geometry && (plan->has_photons || (images & geometry) != 0);
    plan->has_output = plan->has_gbuffer && images != 0;
    plan->has_feedback = plan->has_photons && settings->density != DENSITY_UNIFORM;
    plan->has_spreads = plan->has_photons && settings->aa != SPLAT_AA_PIXEL &&
                        (bits & (FEATURE_SOFT | FEATURE_ROUGH | FEATURE_DISPERSION)) != 0;
    plan->has_variance = plan->has_feedback && (bits & FEATURE_VARIANCE) != 0;
    bool is_all_quads = settings->aa == SPLAT_AA_MSAA || settings->aa == SPLAT_AA_MSAA_SAMPLE;
    plan->has_sums = plan->has_photons && !is_all_quads;
    plan->has_quads = plan->has_photons && (is_all_quads || settings->aa == SPLAT_AA_MSAA_SMALL);
    plan->has_lookup = plan->has_photons && (bits & FEATURE_LOOKUP) != 0;

    const uint32_t shows_caustics =
        (1u << CHANNEL_CAUSTICS) | (1u << CHANNEL_IRRADIANCE) | (1u << CHANNEL_BEAUTY);
    plan->has_temporal = plan->has_photons && settings->temporal > 0 && settings->accumulate == 1 &&
                         (images & shows_caustics) != 0;

    const char *no_photons =
        features->black_reason ? features->black_reason : "no requested channel shows caustics";
    line(plan, "gbuffer", plan->has_gbuffer, "photons or channels need the surface of every pixel",
         has_geometry ? no_photons : "the scene has no geometry");
    line(plan, "direct light", plan->has_gbuffer && (bits & FEATURE_BEAUTY), "beauty is requested",
         "beauty is not requested");
    line(plan, "camera chains", plan->has_gbuffer && (bits & FEATURE_CHAINS) && features->caster_count > 0,
         "beauty, indirect, normal and albedo look through glass and mirrors",
         features->caster_count == 0 ? "nothing refracts or mirrors"
                                     : "neither beauty, indirect, normal nor albedo is requested");
    line(plan, "density", plan->has_photons, "photons are emitted by the task buffers", no_photons);
    line(plan, "insets", plan->has_photons && (bits & FEATURE_INSETS),
         "a caster is small in its light's tile: around it are cells of its own",
         !plan->has_photons                   ? no_photons
         : view->insets_are_full              ? "the budget has no room for more tiles"
         : settings->tile != TILE_FIT_CASTERS ? "tile=full"
         : view->renderer->caster_count < 2   ? "there is one caster: tiles are fitted to it"
                                              : "every caster has enough cells of its light's tile");
    line(plan, "photons", plan->has_photons, "the scene has lights, casters and receivers", no_photons);
    line(plan, "splat", plan->has_photons, "photons are drawn into the view", no_photons);
    line(plan, "multisampled quads", plan->has_quads,
         is_all_quads ? "aa=msaa and aa=msaa_sample rasterise every splat"
                      : "aa=msaa_small rasterises splats below msaa_threshold",
         plan->has_photons ? "this anti-aliasing takes no samples: splats are computed" : no_photons);
    line(plan, "splat sums", plan->has_sums, "splats are computed and add up in fixed point",
         plan->has_photons ? "aa=msaa and aa=msaa_sample blend all splats as quads" : no_photons);
    line(plan, "lookup", plan->has_lookup, "caustics are looked up where the camera sees glass or mirrors",
         !plan->has_photons ? no_photons : features->no_lookup_reason);
    line(plan, "camera branches", plan->has_lookup && (bits & FEATURE_BRANCHES), "camera_branches is 2",
         !plan->has_photons ? no_photons
         : plan->has_lookup ? "camera_branches is 1"
                            : features->no_lookup_reason);
    line(plan, "camera samples", plan->has_lookup && (bits & FEATURE_SAMPLES), "camera_samples is above 1",
         !plan->has_photons         ? no_photons
         : !plan->has_lookup        ? features->no_lookup_reason
         : settings->accumulate > 1 ? "accumulate moves camera rays"
                                    : "camera_samples is 1");
    line(plan, "feedback", plan->has_feedback, "density follows what photons did",
         plan->has_photons ? "density=uniform does not adapt" : no_photons);
    line(plan, "variance", plan->has_variance, "variance_gain is above 0",
         !plan->has_photons   ? no_photons
         : plan->has_feedback ? "variance_gain is 0"
                              : "density=uniform does not adapt");
    line(plan, "three channels", plan->has_photons && (bits & FEATURE_CHROMATIC), "photons differ in colour",
         plan->has_photons ? "all photons have one tint: one channel is accumulated" : no_photons);
    line(plan, "refraction", (bits & FEATURE_DIELECTRIC) != 0, "there is solid glass",
         "there is no solid glass");
    line(plan, "nested solids", (bits & FEATURE_NESTED) != 0,
         "solids overlap: rays keep a list of those they are in",
         bits & FEATURE_DIELECTRIC ? "no solid lies in another" : "there is no solid glass");
    line(plan, "contacts", (bits & FEATURE_CONTACT) != 0, "surfaces of solids lie in other surfaces",
         bits & FEATURE_DIELECTRIC ? "no solid touches another surface" : "there is no solid glass");
    line(plan, "full precision", !(view->renderer->extent.coarseness > EXTENT_COARSE),
         "every caster is large enough where it lies",
         "a caster is too small for its distance from the scene's middle, or its vertices too far from their "
         "own "
         "origin: the server's log and caustic-scene info name it");
    line(plan, "second triangle buffer", view->renderer->first_triangles > 0,
         "the triangles are more than this device takes in one buffer",
         view->renderer->tracer == TRACER_KHR ? "the device keeps the triangles itself"
                                              : "one buffer takes all triangles");
    line(plan, "thin walls", (bits & FEATURE_THIN) != 0, "there are thin walls", "there are no thin walls");
    line(plan, "mirrors", (bits & FEATURE_MIRROR) != 0, "there are mirrors", "there are no mirrors");
    line(plan, "absorption", (bits & FEATURE_ABSORPTION) != 0, "some glass is coloured", "no glass absorbs");
    line(plan, "textures", (bits & FEATURE_TEXTURE) != 0, "some material has an image",
         "no material has an image");
    line(plan, "emission", (bits & FEATURE_EMISSION) != 0, "something glows and beauty is requested",
         "nothing glows, or beauty is not requested");
    line(plan, "directional light", (bits & FEATURE_DIRECTIONAL) != 0, "there is one", "there is none");
    line(plan, "spot light", (bits & FEATURE_SPOT) != 0, "there is one", "there is none");
    line(plan, "soft light", (bits & FEATURE_SOFT) != 0, "some light is a sphere, disk or rectangle",
         plan->has_photons ? "every light is a point or a beam" : no_photons);
    line(plan, "rough casters", (bits & FEATURE_ROUGH) != 0, "some glass or metal is not polished",
         plan->has_photons ? "every caster is polished" : no_photons);
    line(plan, "dispersion", (bits & FEATURE_DISPERSION) != 0, "some glass refracts colours differently",
         plan->has_photons ? "no glass disperses" : no_photons);
    line(plan, "tinted glass", (bits & FEATURE_TINT) != 0, "some solid glass has a base colour",
         "no solid glass has one");
    line(plan, "spreads", plan->has_spreads, "a soft light, a rough caster or dispersion spreads photons",
         !plan->has_photons               ? no_photons
         : settings->aa == SPLAT_AA_PIXEL ? "aa=pixel has no footprints"
                                          : "nothing spreads a photon beyond its stratum");
    bool is_measured = view->soft.stage == SOFT_MEASURED;
    line(plan, "emitter samples", plan->has_photons && (bits & FEATURE_SOFT) && emitter_uses_samples(view),
         settings->soft == SOFT_SAMPLES   ? "soft=samples"
         : settings->aa == SPLAT_AA_PIXEL ? "aa=pixel has no footprints"
         : is_measured                    ? "soft=auto measured that differentials err"
                                          : "soft=auto has not measured yet",
         !plan->has_photons                     ? no_photons
         : !(bits & FEATURE_SOFT)               ? "no light has a size"
         : settings->soft == SOFT_DIFFERENTIALS ? "soft=differentials"
         : is_measured                          ? "soft=auto measured that differentials serve"
                                                : "soft=auto has not measured yet");
    line(plan, "visibility rays", plan->has_photons && settings->aa == SPLAT_AA_PIXEL,
         "aa=pixel asks whether the camera sees each photon", "only aa=pixel needs them");
    const char *no_governor = budget_reason_against(view, plan);
    line(plan, "governor", !no_governor,
         "budget_ms is above 0: photons up to the budget, then camera_samples and multisampling, hold it; "
         "target_area is no limit, and "
         "frames depend on how fast the machine was",
         no_governor);
    line(plan, "draft or final", settings->quality != QUALITY_GOOD,
         settings->quality == QUALITY_DRAFT ? "quality=draft: photons / 4, target_area x 4"
                                            : "quality=final: photons x 4 within the limit, target_area / 4",
         "quality=good: settings as they are");
    line(plan, "accumulation", settings->accumulate > 1, "accumulate is above 1", "accumulate is 1");
    line(plan, "temporal", plan->has_temporal, "temporal is above 0",
         !plan->has_photons          ? no_photons
         : !(settings->temporal > 0) ? "temporal is 0"
         : settings->accumulate > 1  ? "accumulate averages frames of its own"
                                     : "no requested channel shows directly visible caustics");
    line(plan, "output", plan->has_output, "channels are read back",
         images == 0 ? "no image channel is requested" : "every requested channel is black");
}
