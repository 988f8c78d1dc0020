/* scene_builder.h: makes a struct scene piece by piece; shared by the importer and the built-in scenes.
 *
 *     scene_builder_begin -> (add ...)* -> scene_builder_finish
 *
 * The first failure (memory, a limit of scene.h) sticks: later calls do nothing and finish reports it. The
 * adders return the new thing's index, and 0 after a failure; scene_builder_vertices and _indices return
 * NULL. Internal to core/scene.
 */
#ifndef CAUSTIC_SCENE_BUILDER_H
#define CAUSTIC_SCENE_BUILDER_H

#include "scene.h"

struct scene_builder {
    struct scene *scene;
    struct error error; /* STATUS_OK until something failed */
    uint32_t vertex_capacity, index_capacity, mesh_capacity, material_capacity, image_capacity, node_capacity,
        instance_capacity, light_capacity, camera_capacity, channel_capacity, warning_capacity;
};

void scene_builder_begin(struct scene_builder *builder, const char *name);

/* Rooms for `count` more, zeroed, to be filled by the caller; valid until the next call. */
struct scene_vertex *scene_builder_vertices(struct scene_builder *builder, uint32_t count);
uint32_t *scene_builder_indices(struct scene_builder *builder, uint32_t count);

/* Makes a mesh of everything in the vertex and index lists from `first_vertex` and `first_index` on, with its
 * bounds. */
uint32_t scene_builder_mesh(struct scene_builder *builder, const char *name, uint32_t material,
                            uint32_t first_vertex, uint32_t first_index);

/* What a material is where nothing is said: white, diffuse, rough, no texture, ior 1.5. */
struct scene_material scene_material_default(const char *name);
uint32_t scene_builder_material(struct scene_builder *builder, const struct scene_material *material);

uint32_t scene_builder_image(struct scene_builder *builder,
                             const struct scene_image *image); /* takes the texels */

/* A node at rest: identity under `parent`. */
struct scene_node scene_node_default(const char *name, uint32_t parent);
uint32_t scene_builder_node(struct scene_builder *builder, const struct scene_node *node);
void scene_builder_instance(struct scene_builder *builder, uint32_t node, uint32_t mesh);

/* Names are made unique: "lamp", "lamp.1", ...; an empty one becomes "light" or "camera". */
uint32_t scene_builder_light(struct scene_builder *builder, const struct scene_light *light);
uint32_t scene_builder_camera(struct scene_builder *builder, const struct scene_camera *camera);

/* Takes times and values. */
void scene_builder_channel(struct scene_builder *builder, const struct scene_channel *channel);

void scene_builder_warn(struct scene_builder *builder, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
void scene_builder_fail(struct scene_builder *builder, enum status status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

static inline bool scene_builder_ok(const struct scene_builder *builder)
{
    return builder->error.status == STATUS_OK;
}

/* Computes totals, checks indices and limits. NULL and *error, everything freed, after a failure.
 */
struct scene *scene_builder_finish(struct scene_builder *builder, struct error *error);
void scene_builder_abandon(struct scene_builder *builder);

/* Copies at most SCENE_NAME_SIZE - 1 bytes, never half a UTF-8 character; control characters become '?'. */
void scene_name_copy(char target[SCENE_NAME_SIZE], const char *source);

#endif
