/* solids.h: which solids of a scene lie in each other or touch, and what a point lies in.
 *
 * A solid is everything made of one dielectric material. Where solids overlap, the smaller one counts, by the
 * mean volume of its instances' boxes at rest: a glass ball in water is glass, and water that reaches a
 * little into the glass around it, as modellers let it, is water there. Numbers say the order: 1 counts
 * before 2; 0 is air. What surrounds a point is a list of up to four numbers, a byte each, lowest byte first.
 *
 * A surface that lies in another, nearer than rays can tell apart, is a contact: glass on glass without a
 * gap, glass on the floor.
 */
#ifndef CAUSTIC_SOLIDS_H
#define CAUSTIC_SOLIDS_H

#include "bvh.h"
#include "scene.h"

#define SOLIDS_MAX       255u /* more are not told apart: leaving them leads to air */
#define SOLIDS_MAX_DEPTH 4u

struct solids {
    uint8_t *number;    /* per material of the scene; 0: no solid, or one too many */
    uint32_t *material; /* of number k + 1 */
    uint32_t count;
    double step_min;  /* m, of extent.h: surfaces nearer to each other are not told apart */
    bool is_nested;   /* boxes of solids overlap, or may once they move */
    bool has_contact; /* at rest, somewhere */
};

/* At the pose given, which is that at rest. `trees` per mesh; those of meshes that are not dielectric may be
 * NULL. `scale` as in struct scene_extent. False and *error when out of memory. */
bool solids_find(struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                 struct bvh *const *trees, double scale, struct error *error);
void solids_free(struct solids *solids);

/* The list of what `point` (world) lies in at this pose. Only closed meshes have an inside. */
uint32_t solids_at(const struct solids *solids, const struct scene *scene, const struct scene_pose *pose,
                   struct bvh *const *trees, const float point[3]);

#endif
