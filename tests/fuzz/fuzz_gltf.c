/* Imports a GLB or glTF text from memory. What is accepted must keep scene.h's promises: every index in
 * range, every position and transform finite, names unique. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/scene/scene.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(bool is_true)
{
    if (!is_true)
        abort();
}

static void check_meshes(const struct scene *scene)
{
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        const struct scene_mesh *mesh = &scene->meshes[m];
        require(mesh->material < scene->material_count && mesh->triangle_count > 0);
        require((uint64_t)mesh->first_vertex + mesh->vertex_count <= scene->vertex_count);
        require((uint64_t)mesh->first_index + 3ull * mesh->triangle_count <= scene->index_count);
        for (uint32_t i = 0; i < 3 * mesh->triangle_count; i++)
            require(scene->indices[mesh->first_index + i] < mesh->vertex_count);
    }
    for (uint32_t i = 0; i < scene->vertex_count; i++) {
        const struct scene_vertex *v = &scene->vertices[i];
        double length = 0;
        for (int axis = 0; axis < 3; axis++) {
            require(isfinite(v->position[axis]));
            length += (double)v->normal[axis] * (double)v->normal[axis];
        }
        require(fabs(length - 1) < 1e-4 && isfinite(v->uv[0]) && isfinite(v->uv[1]));
    }
}

static void check_lists(const struct scene *scene)
{
    for (uint32_t i = 0; i < scene->node_count; i++)
        require(scene->nodes[i].parent == SCENE_NONE || scene->nodes[i].parent < i);
    for (uint32_t i = 0; i < scene->instance_count; i++)
        require(scene->instances[i].node < scene->node_count && scene->instances[i].mesh < scene->mesh_count);
    for (uint32_t i = 0; i < scene->material_count; i++) {
        const struct scene_material *material = &scene->materials[i];
        require(material->ior >= 1 && isfinite(material->ior) && isfinite(material->attenuation_distance));
        require(material->base_color_image == SCENE_NONE || material->base_color_image < scene->image_count);
        require(material->emission_image == SCENE_NONE || material->emission_image < scene->image_count);
        for (int c = 0; c < 3; c++)
            require(isfinite(material->emission[c]) && material->base_color[c] >= 0 &&
                    material->base_color[c] <= 1);
    }
    for (uint32_t i = 0; i < scene->light_count; i++) {
        const struct scene_light *light = &scene->lights[i];
        require(light->node < scene->node_count && *light->name && isfinite(light->intensity[0]));
        require(light->type != LIGHT_SPOT ||
                (light->inner_cone >= 0 && light->inner_cone < light->outer_cone));
        for (uint32_t j = 0; j < i; j++)
            require(strcmp(light->name, scene->lights[j].name) != 0);
    }
    for (uint32_t i = 0; i < scene->camera_count; i++)
        require(scene->cameras[i].node < scene->node_count && scene->cameras[i].yfov > 0);
    for (uint32_t i = 0; i < scene->channel_count; i++)
        require(scene->channels[i].node < scene->node_count && scene->channels[i].key_count > 0);
}

static void check_poses(const struct scene *scene)
{
    struct error error;
    struct scene_pose *pose = scene_pose_create(scene, &error);
    require(pose != NULL);
    for (int step = 0; step < 3; step++) {
        scene_pose_set_time(scene, pose, (double)scene->duration * step / 2.5);
        for (uint32_t i = 0; i < scene->instance_count; i++)
            for (int at = 0; at < 12; at++)
                require(isfinite(pose->instance_to_world[i][at]));
        for (uint32_t i = 0; i < scene->light_count; i++)
            for (int axis = 0; axis < 3; axis++)
                require(isfinite(pose->lights[i].position[axis]) &&
                        isfinite(pose->lights[i].direction[axis]));
        for (uint32_t i = 0; i < scene->camera_count; i++)
            for (int axis = 0; axis < 3; axis++)
                require(isfinite(pose->cameras[i].eye[axis]) && isfinite(pose->cameras[i].up[axis]));
    }
    scene_pose_destroy(&pose);
}

static void import(const uint8_t *data, size_t size)
{
    struct error error = {0};
    struct scene *scene = scene_import_memory(data, size, &error);
    if (!scene) {
        require(error.status != STATUS_OK && *error.message);
        return;
    }
    check_meshes(scene);
    check_lists(scene);
    check_poses(scene);
    scene_destroy(&scene);
}

static void put_u32(uint8_t *bytes, size_t value)
{
    for (int i = 0; i < 4; i++)
        bytes[i] = (uint8_t)(value >> (8 * i));
}

/* Makes the GLB's lengths fit again, so that damage gets past the first check. */
static void repair(uint8_t *glb, size_t size)
{
    size_t binary = 20;
    while (binary + 8 < size && memcmp(glb + binary + 4, "BIN", 4) != 0)
        binary++;
    bool has_binary = binary + 8 < size;
    memcpy(glb, "glTF\2\0\0", 8);
    put_u32(glb + 8, size);
    put_u32(glb + 12, has_binary ? binary - 20 : size - 20);
    memcpy(glb + 16, "JSON", 4);
    if (has_binary)
        put_u32(glb + binary, (size - binary - 8) / 4 * 4);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    import(data, size);
    if (size < 28 || memcmp(data, "glT", 3) != 0)
        return 0;
    uint8_t *copy = malloc(size);
    require(copy != NULL);
    memcpy(copy, data, size);
    repair(copy, size);
    import(copy, size);
    free(copy);
    return 0;
}
