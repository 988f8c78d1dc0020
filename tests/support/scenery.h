/* scenery.h: scenes of a few simple things, made in memory and rendered in this process. Used with truth.h's
 * truth_set, truth_render, truth_channel and truth_close:
 *
 *     scenery_begin -> (scenery_*, shape_*, scenery_place)* -> scenery_open -> truth_render ... truth_close
 */
#ifndef TEST_SCENERY_H
#define TEST_SCENERY_H

#include "core/scene/scene_builder.h"
#include "core/scene/shapes.h"
#include "truth.h"

/* Everything lies under one node, the root, with this scale and translation; 0 as scale means 1. */
struct scenery_params {
    double scale;
    double shift[3];
};

void scenery_begin(struct scene_builder *builder, const struct scenery_params *params);

/* Materials: white and diffuse, clear solid glass, a perfect mirror. */
uint32_t scenery_diffuse(struct scene_builder *builder);
uint32_t scenery_glass(struct scene_builder *builder, double ior);
uint32_t scenery_mirror(struct scene_builder *builder);

/* An instance of the mesh, under the root. */
void scenery_place(struct scene_builder *builder, uint32_t mesh);

/* W/sr; W/m^2 and the way light travels. */
void scenery_lamp(struct scene_builder *builder, struct vec3 position, double intensity);
void scenery_sun(struct scene_builder *builder, struct vec3 direction, double irradiance);

/* A white floor at y = 0 of that side around the origin. */
void scenery_floor(struct scene_builder *builder, double side);

/* A surface of revolution about the y axis, height(radius) up to `radius`, with exact normals that point up
 * (or down). The slope is the height's derivative. */
struct scenery_dish {
    double (*height)(double radius), (*slope)(double radius);
    double radius;
    uint32_t rings, segments;
    bool looks_down;
};
void scenery_dish(struct scene_builder *builder, uint32_t material, const struct scenery_dish *dish);

/* Whether the plan has this line in use; fails the test when it has no such line. */
bool scenery_plan_uses(const struct frame_result *result, const char *name);

/* The camera as a node of the scene, and as the stage's own (unscaled). */
struct view_camera scenery_camera(struct scene_builder *builder, struct vec3 eye, struct vec3 at,
                                  struct vec3 up, double fov_degrees);

/* Finishes the scene and opens it, looking through its first camera; what `camera` says is what
 * truth_floor_point goes by. Fails the test that calls it when something goes wrong; skips the program where
 * there is no Vulkan device. */
void scenery_open(struct truth *stage, struct scene_builder *builder, const struct view_camera *camera,
                  uint32_t width, uint32_t height, const char *settings);
/* The same on a device that takes storage buffers of at most that size. */
void scenery_open_within(struct truth *stage, struct scene_builder *builder, const struct view_camera *camera,
                         uint32_t width, uint32_t height, const char *settings, uint64_t max_storage_bytes);

#endif
