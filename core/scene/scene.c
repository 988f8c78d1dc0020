#include "scene.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>

void scene_destroy(struct scene **pointer)
{
    struct scene *scene = *pointer;
    if (!scene)
        return;
    for (uint32_t i = 0; i < scene->image_count; i++)
        free(scene->images[i].texels);
    for (uint32_t i = 0; i < scene->channel_count; i++) {
        free(scene->channels[i].times);
        free(scene->channels[i].values);
    }
    for (uint32_t i = 0; i < scene->warning_count; i++)
        free(scene->warnings[i]);
    free(scene->vertices);
    free(scene->indices);
    free(scene->meshes);
    free(scene->materials);
    free(scene->images);
    free(scene->nodes);
    free(scene->instances);
    free(scene->lights);
    free(scene->cameras);
    free(scene->channels);
    free(scene->warnings);
    free(scene);
    *pointer = NULL;
}

struct scene *scene_open(const char *name_or_path, struct error *error)
{
    const char *ending = strrchr(name_or_path, '.');
    if (ending && (!strcasecmp(ending, ".gltf") || !strcasecmp(ending, ".glb")))
        return scene_import(name_or_path, error);
    return scene_create_builtin(name_or_path, error);
}
