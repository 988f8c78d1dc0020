#include "scene_builder.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Names are compared pairwise. */
#define SCENE_MAX_CAMERAS 256u

void scene_name_copy(char target[SCENE_NAME_SIZE], const char *source)
{
    size_t length = strlen(source);
    if (length >= SCENE_NAME_SIZE) {
        length = SCENE_NAME_SIZE - 1;
        while (length > 0 && ((unsigned char)source[length] & 0xc0) == 0x80)
            length--;
    }
    /* A name is shown in terminals and error texts: no escape sequences. */
    for (size_t i = 0; i < length; i++)
        target[i] = (unsigned char)source[i] < 0x20 || source[i] == 0x7f ? '?' : source[i];
    target[length] = 0;
}

void scene_builder_begin(struct scene_builder *builder, const char *name)
{
    *builder = (struct scene_builder){0};
    builder->scene = calloc(1, sizeof *builder->scene);
    if (!builder->scene) {
        scene_builder_fail(builder, STATUS_MEMORY, "out of memory for scene \"%s\"", name);
        return;
    }
    scene_name_copy(builder->scene->name, name);
}

void scene_builder_fail(struct scene_builder *builder, enum status status, const char *format, ...)
{
    if (!scene_builder_ok(builder))
        return;
    builder->error.status = status;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(builder->error.message, sizeof builder->error.message, format, arguments);
    va_end(arguments);
}

/* Room for `more` elements after `*count`; the list grows by half. NULL after a failure. */
static void *grow(struct scene_builder *builder, void *list, size_t element, uint32_t *count,
                  uint32_t *capacity, uint32_t more, uint32_t limit, const char *what)
{
    if (!scene_builder_ok(builder))
        return NULL;
    if (more > limit || *count > limit - more) {
        scene_builder_fail(builder, STATUS_LIMIT, "scene \"%s\" has more than %u %s", builder->scene->name,
                           limit, what);
        return NULL;
    }
    void **storage = list;
    uint32_t needed = *count + more;
    if (needed > *capacity || !*storage) {
        uint64_t wanted = (uint64_t)*capacity + *capacity / 2;
        wanted = wanted < needed ? needed : wanted > limit ? limit : wanted;
        wanted = wanted < 8 ? 8 : wanted;
        void *larger = realloc(*storage, (size_t)wanted * element);
        if (!larger) {
            scene_builder_fail(builder, STATUS_MEMORY, "out of memory for %u %s", needed, what);
            return NULL;
        }
        *storage = larger;
        *capacity = (uint32_t)wanted;
    }
    char *room = (char *)*storage + (size_t)*count * element;
    memset(room, 0, (size_t)more * element);
    *count = needed;
    return room;
}

#define GROW(list, name, more, limit, what)                                                                  \
    (scene_builder_ok(builder)                                                                               \
         ? grow(builder, &builder->scene->list, sizeof *builder->scene->list, &builder->scene->name##_count, \
                &builder->name##_capacity, more, limit, what)                                                \
         : NULL)

struct scene_vertex *scene_builder_vertices(struct scene_builder *builder, uint32_t count)
{
    return GROW(vertices, vertex, count, SCENE_MAX_VERTICES, "vertices");
}

uint32_t *scene_builder_indices(struct scene_builder *builder, uint32_t count)
{
    return GROW(indices, index, count, SCENE_MAX_TRIANGLES * 3u, "triangle corners");
}

static void set_bounds(const struct scene *scene, struct scene_mesh *mesh)
{
    for (uint32_t i = 0; i < mesh->vertex_count; i++)
        for (int axis = 0; axis < 3; axis++) {
            float value = scene->vertices[mesh->first_vertex + i].position[axis];
            if (i == 0 || value < mesh->bounds_min[axis])
                mesh->bounds_min[axis] = value;
            if (i == 0 || value > mesh->bounds_max[axis])
                mesh->bounds_max[axis] = value;
        }
}

uint32_t scene_builder_mesh(struct scene_builder *builder, const char *name, uint32_t material,
                            uint32_t first_vertex, uint32_t first_index)
{
    struct scene_mesh *mesh = GROW(meshes, mesh, 1, SCENE_MAX_INSTANCES, "meshes");
    if (!mesh)
        return 0;
    scene_name_copy(mesh->name, name);
    mesh->first_vertex = first_vertex;
    mesh->vertex_count = builder->scene->vertex_count - first_vertex;
    mesh->first_index = first_index;
    mesh->triangle_count = (builder->scene->index_count - first_index) / 3;
    mesh->material = material;
    set_bounds(builder->scene, mesh);
    return builder->scene->mesh_count - 1;
}

struct scene_material scene_material_default(const char *name)
{
    struct scene_material material = {
        .kind = MATERIAL_DIFFUSE,
        .base_color = {1, 1, 1},
        .base_color_image = SCENE_NONE,
        .roughness = 1,
        .ior = 1.5f,
        .attenuation_color = {1, 1, 1},
        .emission_image = SCENE_NONE,
    };
    scene_name_copy(material.name, name);
    return material;
}

uint32_t scene_builder_material(struct scene_builder *builder, const struct scene_material *material)
{
    struct scene_material *room = GROW(materials, material, 1, SCENE_MAX_MATERIALS, "materials");
    if (!room)
        return 0;
    *room = *material;
    return builder->scene->material_count - 1;
}

uint32_t scene_builder_image(struct scene_builder *builder, const struct scene_image *image)
{
    struct scene_image *room = GROW(images, image, 1, SCENE_MAX_MATERIALS, "images");
    if (!room) {
        free(image->texels);
        return 0;
    }
    *room = *image;
    return builder->scene->image_count - 1;
}

struct scene_node scene_node_default(const char *name, uint32_t parent)
{
    struct scene_node node = {.parent = parent, .rotation = {0, 0, 0, 1}, .scale = {1, 1, 1}};
    scene_name_copy(node.name, name);
    return node;
}

uint32_t scene_builder_node(struct scene_builder *builder, const struct scene_node *node)
{
    struct scene_node *room = GROW(nodes, node, 1, SCENE_MAX_NODES, "nodes");
    if (!room)
        return 0;
    *room = *node;
    return builder->scene->node_count - 1;
}

void scene_builder_instance(struct scene_builder *builder, uint32_t node, uint32_t mesh)
{
    struct scene_instance *room = GROW(instances, instance, 1, SCENE_MAX_INSTANCES, "instances");
    if (room)
        *room = (struct scene_instance){.node = node, .mesh = mesh};
}

/* Makes names[at] (elements of `stride` bytes that begin with their name) unlike all before it. */
static void make_unique(char *first, size_t stride, uint32_t at, const char *fallback)
{
    char *name = first + at * stride;
    if (!*name)
        scene_name_copy(name, fallback);
    char base[SCENE_NAME_SIZE];
    scene_name_copy(base, name);
    for (uint32_t number = 1;; number++) {
        bool is_taken = false;
        for (uint32_t i = 0; i < at && !is_taken; i++)
            is_taken = !strcmp(first + i * stride, name);
        if (!is_taken)
            return;
        snprintf(name, SCENE_NAME_SIZE, "%.50s.%u", base, number);
    }
}

uint32_t scene_builder_light(struct scene_builder *builder, const struct scene_light *light)
{
    struct scene_light *room = GROW(lights, light, 1, SCENE_MAX_LIGHTS, "lights");
    if (!room)
        return 0;
    *room = *light;
    make_unique(builder->scene->lights->name, sizeof *room, builder->scene->light_count - 1, "light");
    return builder->scene->light_count - 1;
}

uint32_t scene_builder_camera(struct scene_builder *builder, const struct scene_camera *camera)
{
    struct scene_camera *room = GROW(cameras, camera, 1, SCENE_MAX_CAMERAS, "cameras");
    if (!room)
        return 0;
    *room = *camera;
    make_unique(builder->scene->cameras->name, sizeof *room, builder->scene->camera_count - 1, "camera");
    return builder->scene->camera_count - 1;
}

void scene_builder_channel(struct scene_builder *builder, const struct scene_channel *channel)
{
    struct scene_channel *room = GROW(channels, channel, 1, SCENE_MAX_NODES, "animation channels");
    if (!room) {
        free(channel->times);
        free(channel->values);
        return;
    }
    *room = *channel;
}

/* More than this says nothing new; the last line says that there were more. */
#define MAX_WARNINGS 64u

void scene_builder_warn(struct scene_builder *builder, const char *format, ...)
{
    if (!scene_builder_ok(builder) || builder->scene->warning_count >= MAX_WARNINGS)
        return;
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (builder->scene->warning_count == MAX_WARNINGS - 1)
        snprintf(text, sizeof text, "further warnings are left out");
    char **room = GROW(warnings, warning, 1, MAX_WARNINGS, "warnings");
    if (!room)
        return;
    *room = strdup(text);
    if (!*room)
        scene_builder_fail(builder, STATUS_MEMORY, "out of memory for a warning");
}

void scene_builder_abandon(struct scene_builder *builder)
{
    scene_destroy(&builder->scene);
}

static void check_mesh(struct scene_builder *builder, const struct scene_mesh *mesh)
{
    const struct scene *scene = builder->scene;
    if (mesh->material >= scene->material_count)
        scene_builder_fail(builder, STATUS_INVALID, "mesh \"%s\" has no material %u", mesh->name,
                           mesh->material);
    const uint32_t *indices = scene->indices + mesh->first_index;
    for (uint32_t i = 0; i < mesh->triangle_count * 3 && scene_builder_ok(builder); i++)
        if (indices[i] >= mesh->vertex_count)
            scene_builder_fail(builder, STATUS_INVALID, "mesh \"%s\", triangle %u: vertex %u of %u",
                               mesh->name, i / 3, indices[i], mesh->vertex_count);
}

struct scene *scene_builder_finish(struct scene_builder *builder, struct error *error)
{
    struct scene *scene = builder->scene;
    for (uint32_t i = 0; scene_builder_ok(builder) && i < scene->mesh_count; i++)
        check_mesh(builder, &scene->meshes[i]);
    if (scene_builder_ok(builder)) {
        uint64_t triangles = 0;
        for (uint32_t i = 0; i < scene->instance_count; i++)
            triangles += scene->meshes[scene->instances[i].mesh].triangle_count;
        if (triangles > UINT32_MAX)
            scene_builder_fail(builder, STATUS_LIMIT,
                               "scene \"%s\" has %llu triangles over its instances; the most is %u",
                               scene->name, (unsigned long long)triangles, UINT32_MAX);
        scene->triangle_count = (uint32_t)triangles;
        for (uint32_t i = 0; i < scene->channel_count; i++) {
            float end = scene->channels[i].times[scene->channels[i].key_count - 1];
            scene->duration = end > scene->duration ? end : scene->duration;
        }
    }
    if (!scene_builder_ok(builder)) {
        *error = builder->error;
        scene_builder_abandon(builder);
        return NULL;
    }
    builder->scene = NULL;
    return scene;
}
