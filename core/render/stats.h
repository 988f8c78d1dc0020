/* stats.h: what a frame says about itself, described once.
 *
 * The table STATS is the only place where a statistic is named; the frame's values are an array of doubles in
 * that order (counts below 2^53 are exact).
 */
#ifndef CAUSTIC_STATS_H
#define CAUSTIC_STATS_H

#include <stdint.h>

/* S(name, unit, help). Fluxes are the sum of the R, G and B channels, over all subframes divided by their
 * number; counts are summed over subframes. */
#define STATS(S)                                                                                             \
    S(photons_emitted, "count", "primary photons sent from the lights")                                      \
    S(rays_traced, "count", "photon rays traced, all bounces")                                               \
    S(rays_hit, "count", "photon rays that hit something")                                                   \
    S(photons_split, "count", "interactions where both branches were followed")                              \
    S(photons_stored, "count", "photons that reached a receiver after a specular interaction")               \
    S(photons_splatted, "count", "stored photons drawn into the view")                                       \
    S(photons_contributing, "count", "drawn photons that reached at least one pixel")                        \
    S(culled_visibility, "count", "stored photons the view cannot see: outside, behind or hidden")           \
    S(culled_solid_angle, "count", "photons culled by cull_solid_angle")                                     \
    S(culled_energy, "count", "photons culled by cull_energy")                                               \
    S(flux_emitted, "W", "sent into the cells of the caster mask")                                           \
    S(flux_splatted, "W", "deposited on receivers the view sees")                                            \
    S(flux_culled_visibility, "W", "deposited on receivers the view does not see")                           \
    S(flux_culled_solid_angle, "W", "culled by cull_solid_angle")                                            \
    S(flux_culled_energy, "W", "culled by cull_energy")                                                      \
    S(flux_direct, "W", "met a receiver first: direct light, not caustic")                                   \
    S(flux_absorbed, "W", "absorbed in glass and on metal")                                                  \
    S(flux_escaped, "W", "left the scene")                                                                   \
    S(flux_bounce_limit, "W", "lost to max_bounces")                                                         \
    S(flux_split_once, "W", "branches that split=once and capacity do not follow")                           \
    S(flux_thinned, "W",                                                                                     \
      "weaker branches left to others on the lattice, less what those carry: sampling error, near 0")        \
    S(flux_buffer, "W", "integral of the caustics buffer's irradiance over what the view sees")              \
    S(aa_samples, "count", "samples per pixel that splats were drawn with; 1 where none are taken")          \
    S(kernel_evaluations, "count", "times a splat's kernel was evaluated at a pixel; not counted in quads")  \
    S(kernel_pixels, "count", "evaluations that fell inside the ellipse")                                    \
    S(footprints_limited, "count", "footprints shortened by max_radius or max_anisotropy")                   \
    S(pixels_looked_up, "count", "chain points: receivers that pixels show through glass and mirrors")       \
    S(lookup_cells, "count", "cells of the grid that hold chain points")                                     \
    S(lookup_photons, "count", "stored photons that were offered to chain points")                           \
    S(lookup_photons_seen, "count", "those that reached at least one chain point")                           \
    S(lookup_evaluations, "count", "pairs of a photon and a chain point that were tested")                   \
    S(lookup_inside, "count", "evaluations that fell inside the kernel")                                     \
    S(lookup_limited, "count", "footprints, walks and chain points limited by the lookup grid")              \
    S(density_total, "count", "sum of the density over all cells before rounding")                           \
    S(density_largest, "count", "density of the densest cell")                                               \
    S(tiles, "count",                                                                                        \
      "tiles of all lights, insets around casters that are small in their light's tile included")            \
    S(cells_masked, "count", "cells that can meet a caster")                                                 \
    S(guard_density, "count", "non-finite or out-of-range densities clamped")                                \
    S(guard_differential, "count", "photon differentials clamped at a singular configuration")               \
    S(guard_footprint, "count", "footprints that are not finite: drawn as points")                           \
    S(guard_traversal, "count", "rays ended by the traversal's iteration cap")                               \
    S(guard_overflow, "count", "splat contributions clamped to the accumulator's range")                     \
    S(guard_split, "count", "bounces where capacity turned splitting into roulette")                         \
    S(soft_error, "1", "soft=auto: relative difference that differentials of the emitter made, measured")    \
    S(lights_shrunk, "count", "lights so large that a caster is in or close to them: taken as smaller")      \
    S(governor_photons, "count", "photon budget that budget_ms chose for this frame; 0: budget_ms is off")   \
    S(governor_target_area, "px^2", "target area that budget_ms chose for this frame; 0: budget_ms is off")  \
    S(governor_camera_samples, "count",                                                                      \
      "camera_samples that budget_ms chose for this frame; 0: budget_ms is off")                             \
    S(subframes, "count", "frames averaged into this one")                                                   \
    S(plan_ns, "ns", "CPU time spent on features and plan")                                                  \
    S(upload_ns, "ns", "CPU time spent on pose, tiles and uploads")                                          \
    S(readback_ns, "ns", "CPU time spent on reading the frame back")                                         \
    S(frame_ns, "ns", "wall time of the frame in the renderer")                                              \
    S(gpu_ns, "ns", "device time of the frame, first to last pass")                                          \
    S(device_bytes, "bytes", "device memory in use")

enum stat_id {
#define S(name, unit, help) STAT_##name,
    STATS(S)
#undef S
        STAT_COUNT
};

struct stat_info {
    const char *name, *unit, *help;
};

extern const struct stat_info stat_infos[STAT_COUNT];

#endif
