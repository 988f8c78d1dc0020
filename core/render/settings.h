/* settings.h: everything about a view that can be turned, described once.
 *
 * The table SETTINGS is the only place where a setting is named. From it come struct settings, the checks,
 * the description a server sends to its clients, and docs. All are numbers: a bool is 0 or 1, a choice is the
 * index into its list.
 */
#ifndef CAUSTIC_SETTINGS_H
#define CAUSTIC_SETTINGS_H

#include <stddef.h>
#include <stdint.h>

#include "../status.h"

enum setting_type { SETTING_BOOL, SETTING_INT, SETTING_FLOAT, SETTING_CHOICE };

enum density_rule { DENSITY_SQRT, DENSITY_AREA, DENSITY_UNIFORM, DENSITY_ERROR };
enum split_rule { SPLIT_ENERGY, SPLIT_ONCE, SPLIT_ROULETTE };
enum splat_aa {
    SPLAT_AA_FILTER,
    SPLAT_AA_NONE,
    SPLAT_AA_PIXEL,
    SPLAT_AA_MSAA,
    SPLAT_AA_MSAA_SAMPLE,
    SPLAT_AA_MSAA_SMALL,
    SPLAT_AA_COVERAGE
};
enum depth_test { DEPTH_TEST_PLANE, DEPTH_TEST_MARGIN };
enum lookup_rule { LOOKUP_AUTO, LOOKUP_OFF, LOOKUP_HASH, LOOKUP_AS };
enum soft_rule { SOFT_AUTO, SOFT_DIFFERENTIALS, SOFT_SAMPLES };
enum quality { QUALITY_GOOD, QUALITY_DRAFT, QUALITY_FINAL };
enum tile_fit { TILE_FIT_CASTERS, TILE_FIT_FULL };

/* S(name, type, minimum, maximum, default, choices, help) */
#define SETTINGS(S)                                                                                          \
    S(photons, INT, 1, 4194304, 131072, "", "budget: most photons emitted per frame")                        \
    S(target_area, FLOAT, 1e-3, 1e5, 0.1, "",                                                                \
      "wanted mean projected area of a photon, px^2; smaller: more photons")                                 \
    S(density, CHOICE, 0, 3, DENSITY_ERROR, "sqrt,area,uniform,error",                                       \
      "how density follows what photons did: the error their size makes in the picture, sqrt of area times " \
      "flux, area alone (the papers), or not at all")                                                        \
    S(variance_gain, FLOAT, 0, 1e6, 2, "", "extra photons per cell where the picture changes over time")     \
    S(temporal_weight, FLOAT, 0, 1, 0.5, "",                                                                 \
      "w_t: share of the newly suggested density; the rest is the neighbourhood's last")                     \
    S(min_samples, INT, 1, 64, 1, "",                                                                        \
      "photons kept in every cell that can meet a caster, as far as a quarter of the budget goes")           \
    S(cells, INT, 16, 512, 128, "", "cells along a side of a light's tile, a power of two")                  \
    S(tile, CHOICE, 0, 1, TILE_FIT_CASTERS, "casters,full",                                                  \
      "directions a tile covers: the cap that holds the casters, or all the light's emission")               \
    S(caster_mask, BOOL, 0, 1, 1, "", "emit only into cells that can meet a caster")                         \
    S(split, CHOICE, 0, 2, SPLIT_ENERGY, "energy,once,roulette",                                             \
      "at glass: follow both branches while they carry energy, once (the thesis), or one at random")         \
    S(soft, CHOICE, 0, 2, SOFT_AUTO, "auto,differentials,samples",                                           \
      "lights with a size: their extent widens footprints, or photons start all over them; auto: by error")  \
    S(light_samples, INT, 1, 64, 16, "", "strata of an emitter with soft=samples; 1, 4, 16 or 64 are used")  \
    S(max_bounces, INT, 1, 64, 12, "", "specular interactions a photon may have")                            \
    S(cull_energy, FLOAT, 0, 1, 1e-5, "", "drop photons below this share of their emitted flux")             \
    S(cull_solid_angle, FLOAT, 0, 100, 0, "",                                                                \
      "drop photons whose unscaled footprint exceeds this solid angle from the light, sr; 0: never")         \
    S(kappa, FLOAT, 0.05, 16, 1.2, "", "footprint scale: covariance of the photon spacing times this")       \
    S(max_anisotropy, FLOAT, 1, 1e4, 64, "", "most a footprint may be longer than wide")                     \
    S(max_radius, FLOAT, 1, 4096, 64, "", "longest footprint radius on screen, px; energy is kept")          \
    S(aa, CHOICE, 0, 6, SPLAT_AA_FILTER, "filter,none,pixel,msaa,msaa_sample,msaa_small,coverage",           \
      "splats: pixel-filtered footprint; ellipse at pixel centres; all energy in one pixel; multisampled "   \
      "quads shaded once per pixel (it dims), per sample, or per sample only when small; exact overlap of "  \
      "ellipse and pixel")                                                                                   \
    S(msaa_threshold, FLOAT, 0, 1e6, 4, "",                                                                  \
      "with aa=msaa_small: area below which a splat is multisampled, px^2")                                  \
    S(filter_radius, FLOAT, 0.25, 4, 0.75, "", "support radius of the pixel filter, px")                     \
    S(depth_test, CHOICE, 0, 1, DEPTH_TEST_PLANE, "plane,margin",                                            \
      "where a splat may land: near its own plane, or within 1 % of the camera distance (the thesis)")       \
    S(camera_bounces, INT, 0, 32, 8, "", "specular interactions between the camera and the surface it sees") \
    S(camera_branches, INT, 1, 2, 1, "",                                                                     \
      "branches that are followed at the first glass the camera sees: the stronger, or both")                \
    S(camera_samples, INT, 1, 16, 12, "",                                                                    \
      "most camera rays in a pixel where what glass and mirrors show breaks up within it: as many where a "  \
      "third of what they show does, fewer where less of it does; 1: one everywhere")                        \
    S(lookup, CHOICE, 0, 3, LOOKUP_AUTO, "auto,off,hash,as",                                                 \
      "how caustics seen through glass and mirrors are found: the faster way, not at all, by photons in a "  \
      "hash grid of what is seen, or from what is seen in an acceleration structure of photons")             \
    S(radiance_scaling, BOOL, 0, 1, 1, "",                                                                   \
      "radiance changes by (n_to/n_from)^2 across an interface seen by the camera")                          \
    S(jitter, BOOL, 0, 1, 0, "",                                                                             \
      "move photons within their strata every frame; off: fixed places, a still scene stays still")          \
    S(temporal, FLOAT, 0, 0.98, 0, "",                                                                       \
      "share of the frames before that is kept in the caustics shown, while no light and no object moves")   \
    S(seed, INT, 0, 2147483647, 1, "", "of every random choice")                                             \
    S(accumulate, INT, 1, 65536, 1, "",                                                                      \
      "frames averaged into one, with jittered photons, camera rays and splats of aa=none, aa=msaa* when "   \
      "above 1")                                                                                             \
    S(budget_ms, FLOAT, 0, 3.6e6, 0, "",                                                                     \
      "time a frame is given, ms: photons up to the budget, camera_samples and samples of aa=msaa* are "     \
      "chosen "                                                                                              \
      "to hold it and target_area is no limit, so that pictures depend on how fast the machine was; 0: off") \
    S(quality, CHOICE, 0, 2, QUALITY_GOOD, "good,draft,final",                                               \
      "good: settings as they are; draft, final: photons times 1/4 or 4, within the device's limit, and "    \
      "target_area times 4 or 1/4")

#define SETTING_FIELD_BOOL   bool
#define SETTING_FIELD_INT    int32_t
#define SETTING_FIELD_FLOAT  float
#define SETTING_FIELD_CHOICE int32_t

struct settings {
#define S(name, type, minimum, maximum, value, choices, help) SETTING_FIELD_##type name;
    SETTINGS(S)
#undef S
};

enum setting_id {
#define S(name, type, minimum, maximum, value, choices, help) SETTING_##name,
    SETTINGS(S)
#undef S
        SETTING_COUNT
};

struct setting_info {
    const char *name, *choices, *help; /* choices: comma-separated, "" for numbers */
    enum setting_type type;
    double minimum, maximum, value; /* value: the default */
};

extern const struct setting_info setting_infos[SETTING_COUNT];

void settings_default(struct settings *settings);
double settings_get(const struct settings *settings, enum setting_id id);
/* Checks type, range and finiteness; the error names the setting, the value and what is allowed. */
bool settings_set(struct settings *settings, enum setting_id id, double value, struct error *error);
/* By name and text: numbers, on/off/true/false, or a choice's name. Unknown names are answered with the
 * nearest. */
bool settings_set_text(struct settings *settings, const char *name, const char *text, struct error *error);
/* Writes a value as settings_set_text reads it. */
void settings_print(enum setting_id id, double value, char *text, size_t size);

#endif
