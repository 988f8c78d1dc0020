/* builtin_scenes.h: the built-in scenes, each filling a fresh builder (all but `empty`).
 *
 * They follow aaps-thesis 4.1 and hold its triangle counts where it states them. Each has one light, close to
 * the geometry, and one camera that shows the caustic. Internal to core/scene.
 */
#ifndef CAUSTIC_BUILTIN_SCENES_H
#define CAUSTIC_BUILTIN_SCENES_H

#include "scene_builder.h"

void builtin_sphere(struct scene_builder *builder);
void builtin_ring(struct scene_builder *builder);
void builtin_square(struct scene_builder *builder);
void builtin_cornell(struct scene_builder *builder);
void builtin_pool(struct scene_builder *builder);
void builtin_cube(struct scene_builder *builder);
void builtin_prism(struct scene_builder *builder);
void builtin_no_caster(struct scene_builder *builder);

#endif
