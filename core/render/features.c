/* features.c: what scene, lights and settings amount to. Source: design 11. */
#include <math.h>
#include <string.h>

#include "view_state.h"

static bool is_grey(const float c[3])
{
    return c[0] == c[1] && c[1] == c[2];
}

static bool is_caster(const struct scene_material *material)
{
    return material->kind != MATERIAL_DIFFUSE;
}

/* A material's features as a bit set; `grey` is cleared when it colours photons. */
static uint32_t material_features(const struct scene_material *material, bool *grey)
{
    uint32_t bits = 0;
    if (material->kind == MATERIAL_DIELECTRIC)
        bits |= FEATURE_DIELECTRIC;
    if (material->kind == MATERIAL_THIN)
        bits |= FEATURE_THIN;
    if (material->kind == MATERIAL_MIRROR)
        bits |= FEATURE_MIRROR;
    if (material->kind == MATERIAL_DIELECTRIC && material->attenuation_distance > 0 &&
        (material->attenuation_color[0] < 1 || material->attenuation_color[1] < 1 ||
         material->attenuation_color[2] < 1)) {
        bits |= FEATURE_ABSORPTION;
        *grey = *grey && is_grey(material->attenuation_color);
    }
    if (material->kind == MATERIAL_DIELECTRIC) {
        const float *c = material->base_color;
        if (c[0] < 1 || c[1] < 1 || c[2] < 1 || material->base_color_image != SCENE_NONE) {
            bits |= FEATURE_TINT;
            *grey = *grey && is_grey(c) && material->base_color_image == SCENE_NONE;
        }
        if (material->dispersion > 0) {
            bits |= FEATURE_DISPERSION;
            *grey = false;
        }
    }
    if (material->kind != MATERIAL_DIFFUSE && material->roughness > ROUGHNESS_MIN)
        bits |= FEATURE_ROUGH;
    if (material->base_color_image != SCENE_NONE || material->emission_image != SCENE_NONE)
        bits |= FEATURE_TEXTURE;
    if (material->emission[0] > 0 || material->emission[1] > 0 || material->emission[2] > 0)
        bits |= FEATURE_EMISSION;
    if (material->kind == MATERIAL_THIN || material->kind == MATERIAL_MIRROR)
        *grey = *grey && is_grey(material->base_color) && material->base_color_image == SCENE_NONE;
    return bits;
}

void features_find(const struct view *view, uint32_t channel_mask, struct features *features)
{
    const struct renderer *renderer = view->renderer;
    const struct scene *scene = renderer->scene;
    memset(features, 0, sizeof *features);
    bool grey = true;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_material *material =
            &scene->materials[scene->meshes[scene->instances[i].mesh].material];
        features->bits |= material_features(material, &grey);
        if (is_caster(material))
            features->caster_count++;
        else
            features->receiver_count++;
        if (view->settings.aa == SPLAT_AA_PIXEL && !is_caster(material))
            grey = grey && is_grey(material->base_color) && material->base_color_image == SCENE_NONE;
    }
    const float *first = NULL;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        const struct scene_light *light = &scene->lights[i];
        const struct view_light *change = &view->light_changes[i];
        const float *intensity =
            change->overrides & LIGHT_OVERRIDE_INTENSITY ? change->intensity : light->intensity;
        features->bits |= light->type == LIGHT_DIRECTIONAL ? FEATURE_DIRECTIONAL
                          : light->type == LIGHT_SPOT      ? FEATURE_SPOT
                                                           : FEATURE_POINT;
        if (!(intensity[0] + intensity[1] + intensity[2] > 0))
            continue;
        features->lit_count++;
        if (light->shape != LIGHT_SHAPE_POINT)
            features->bits |= FEATURE_SOFT;
        /* lights of one tint differ by a factor only */
        if (first && (intensity[0] * first[1] != intensity[1] * first[0] ||
                      intensity[1] * first[2] != intensity[2] * first[1] ||
                      intensity[0] * first[2] != intensity[2] * first[0]))
            grey = false;
        if (!first)
            first = intensity;
    }
    if (features->bits & FEATURE_DIELECTRIC)
        features->bits |= (renderer->solids.is_nested ? FEATURE_NESTED : 0) |
                          (renderer->solids.has_contact ? FEATURE_CONTACT : 0);
    features->light_count = scene->light_count;
    if (!grey)
        features->bits |= FEATURE_CHROMATIC;
    if (view->settings.aa == SPLAT_AA_PIXEL)
        features->bits |= FEATURE_TEXTURED_FLUX;
    if (view->settings.variance_gain > 0 && view->settings.density != DENSITY_UNIFORM)
        features->bits |= FEATURE_VARIANCE;
    if (channel_mask & (1u << CHANNEL_BEAUTY))
        features->bits |= FEATURE_BEAUTY;
    else
        features->bits &= ~FEATURE_EMISSION;
    if (channel_mask & ((1u << CHANNEL_BEAUTY) | (1u << CHANNEL_NORMAL) | (1u << CHANNEL_ALBEDO)))
        features->bits |= FEATURE_CHAINS;

    features->no_lookup_reason = lookup_reason_against(view, channel_mask, features->caster_count);
    if ((channel_mask & (1u << CHANNEL_INDIRECT)) && !features->no_lookup_reason)
        features->bits |= FEATURE_CHAINS;
    features->black_reason =
        scene->instance_count == 0      ? "the scene has no geometry"
        : scene->light_count == 0       ? "the scene has no light"
        : features->lit_count == 0      ? "every light is black"
        : features->caster_count == 0   ? "no material refracts or mirrors: there is no caster"
        : features->receiver_count == 0 ? "no surface receives light: there is no diffuse material"
                                        : NULL;
    uint32_t other =
        (1u << CHANNEL_BEAUTY) | (1u << CHANNEL_DEPTH) | (1u << CHANNEL_NORMAL) | (1u << CHANNEL_ALBEDO);
    uint32_t shown = channel_mask & ~(other & ~(1u << CHANNEL_BEAUTY));
    if (features->no_lookup_reason)
        shown &= ~(1u << CHANNEL_INDIRECT);
    features->needs_caustics = channel_mask == 0 || shown != 0;
    if (features->black_reason)
        features->needs_caustics = false;
    if (features->needs_caustics) {
        features->bits |= FEATURE_CAUSTICS;
        if (!features->no_lookup_reason)
            features->bits |=
                FEATURE_LOOKUP | (view->settings.camera_branches > 1 ? FEATURE_BRANCHES : 0) |
                (view->settings.camera_samples > 1 && view->settings.accumulate == 1 ? FEATURE_SAMPLES : 0);
    } else
        features->bits &= ~(FEATURE_VARIANCE | FEATURE_TEXTURED_FLUX | FEATURE_CHROMATIC | FEATURE_SOFT |
                            FEATURE_ROUGH | FEATURE_DISPERSION);
}
