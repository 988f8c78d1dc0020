#include "scene.h"

#include <stdio.h>
#include <string.h>

#include "builtin_scenes.h"

const struct builtin_scene builtin_scenes[] = {
    {"sphere", "a glass ball over a floor"},
    {"ring", "a polished metal ring on a floor: the nephroid"},
    {"square", "glass ball, wine glass and a faceted glass solid on a square floor"},
    {"cornell", "a glass ball in a five-sided white box"},
    {"pool", "a pool under rippled water, seen from under water"},
    {"cube", "a yellow torus inside a glass cube"},
    {"prism", "a glass prism in sunlight"},
    {"empty", "nothing at all"},
    {"no-caster", "diffuse boxes and a lamp, no glass and no mirror"},
};
const uint32_t builtin_scene_count = sizeof builtin_scenes / sizeof *builtin_scenes;

static void build_empty(struct scene_builder *builder)
{
    (void)builder; /* a scene is empty when it begins */
}

static void (*const builders[])(struct scene_builder *) = {
    builtin_sphere, builtin_ring,  builtin_square, builtin_cornell,   builtin_pool,
    builtin_cube,   builtin_prism, build_empty,    builtin_no_caster,
};
_Static_assert(sizeof builders / sizeof *builders == sizeof builtin_scenes / sizeof *builtin_scenes,
               "every built-in scene has a builder, in the same order");

struct scene *scene_create_builtin(const char *name, struct error *error)
{
    for (uint32_t i = 0; i < builtin_scene_count; i++)
        if (!strcmp(name, builtin_scenes[i].name)) {
            struct scene_builder builder;
            scene_builder_begin(&builder, name);
            if (scene_builder_ok(&builder))
                builders[i](&builder);
            return scene_builder_finish(&builder, error);
        }
    char known[256] = "";
    for (uint32_t i = 0; i < builtin_scene_count; i++)
        snprintf(known + strlen(known), sizeof known - strlen(known), "%s%s", i ? ", " : "",
                 builtin_scenes[i].name);
    error_set(error, STATUS_NOT_FOUND,
              "there is no built-in scene \"%.100s\"; there are %s; a file's name ends in .gltf or .glb",
              name, known);
    return NULL;
}
