/* scene_rest.h: what an imported scene needs once all its parts stand at their places. Internal to
 * core/scene. */
#ifndef CAUSTIC_SCENE_REST_H
#define CAUSTIC_SCENE_REST_H

#include "scene_builder.h"

/* Removes instances that cannot be traced at time 0, because their transform has no volume or takes them
 * further than 1e9 m away, with a warning each. Those whose scale is animated stay: they may open up. */
void scene_drop_collapsed(struct scene_builder *builder);

/* Warns of the coarsest caster, where floats cannot follow light well (extent.h). */
void scene_warn_coarse(struct scene_builder *builder);

/* Gives every instance of an emissive material a light that stands in for it, with a warning that says so:
 * an open surface a rectangle or disk of its area just before it, a closed one a sphere of its area in its
 * middle (the surface itself, which would shut the light in, is left out). Intensities are those of the
 * surface at rest. */
void scene_add_emissive_lights(struct scene_builder *builder);

#endif
