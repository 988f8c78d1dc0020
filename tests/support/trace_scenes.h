/* trace_scenes.h: scenes of many instances and rays that are hard on tracers, the same on every run. */
#ifndef TRACE_SCENES_H
#define TRACE_SCENES_H

#include "core/scene/scene.h"
#include "shaders/shared/trace_rays_layout.h"

/* A scene without materials or lights: meshes and instances, enough to trace. */
struct trace_scene {
    struct scene scene;
    struct scene_pose pose;
};

/* Three meshes (a bumpy grid, loose triangles, a single triangle), `instance_count` times in all, moved,
 * turned, unevenly scaled and mirrored. */
struct trace_scene *trace_scenes_create(uint32_t instance_count);
void trace_scenes_destroy(struct trace_scene **made);

/* From around and within the scene toward its triangles: points of faces, vertices, along axes; directions of
 * any length. */
void trace_scenes_rays(const struct scene *scene, const struct scene_pose *pose, uint32_t seed,
                       struct trace_ray_gpu *rays, uint32_t count);

/* How far a hit is from what it says, relative to the size of the numbers involved: the larger of the
 * distance of origin + t direction from the triangle's plane, and of the barycentrics' point from the ray.
 * Both stay small where the ray grazes the triangle and t itself is uncertain. In double. */
double trace_scenes_hit_error(const struct scene *scene, const struct scene_pose *pose,
                              const struct trace_ray_gpu *ray, const struct trace_hit_gpu *hit);

/* How near the ray passes by an edge of the triangle it hit, relative to the size of the numbers involved:
 * within a few roundings of 0 the hit may as well be the neighbour's, or a miss where there is none. */
double trace_scenes_border(const struct scene *scene, const struct scene_pose *pose,
                           const struct trace_ray_gpu *ray, const struct trace_hit_gpu *hit);

/* From near the middle of an instance's box to its vertices, points of its edges, and anywhere. */
void trace_scenes_rays_inside(const struct scene *scene, const struct scene_pose *pose, uint32_t instance,
                              struct trace_ray_gpu *rays, uint32_t count);

#endif
