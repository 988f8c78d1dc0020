/* caustic-scene: lists, describes and exports scenes. Needs no device. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/scene/scene.h"

static const char usage[] =
    "caustic-scene - what scenes there are, and what is in them\n"
    "\n"
    "  caustic-scene list                    the built-in scenes, one per line\n"
    "  caustic-scene info SCENE              what a scene holds, and what was imported differently than its "
    "file asks\n"
    "  caustic-scene export SCENE FILE.glb   writes a scene as glTF 2.0, for other programs or as a start "
    "for your own\n"
    "\n"
    "SCENE is a built-in scene's name or a path ending in .gltf or .glb. Lights and cameras are shown under "
    "the names\n"
    "that causticd and caustic-record know them by, such as --camera camera and --light "
    "lamp.intensity=10,10,10.\n"
    "\n"
    "What becomes of a glTF material:\n"
    "  KHR_materials_transmission and KHR_materials_volume with a thickness above 0   solid glass\n"
    "  KHR_materials_transmission alone                                               a thin wall\n"
    "  metallic 0.5 or more, roughness 0.25 or less                                   a mirror\n"
    "  anything else                                                                  a diffuse receiver\n"
    "\n"
    "Try\n"
    "  caustic-scene info sphere\n"
    "  caustic-scene export pool pool.glb && caustic-scene info pool.glb\n"
    "\n"
    "Exits 0 when it did what was asked, 1 when the scene could not be read or written, 2 when it was asked "
    "wrongly.\n";

static int complain(const struct error *error)
{
    fprintf(stderr, "caustic-scene: %s\n", error->message);
    return 1;
}

static int list_scenes(void)
{
    for (uint32_t i = 0; i < builtin_scene_count; i++)
        printf("%-12s %s\n", builtin_scenes[i].name, builtin_scenes[i].summary);
    return 0;
}

static void print_material(const struct scene_material *material)
{
    static const char *const kinds[] = {"diffuse", "solid glass", "thin wall", "mirror"};
    printf("  material  %-20s %s, colour %.3g %.3g %.3g", material->name, kinds[material->kind],
           (double)material->base_color[0], (double)material->base_color[1], (double)material->base_color[2]);
    if (material->kind == MATERIAL_DIELECTRIC)
        printf(", ior %.3g", (double)material->ior);
    if (material->dispersion > 0)
        printf(", Abbe number %.3g", 20 / (double)material->dispersion);
    if (material->roughness > 0 && material->kind != MATERIAL_DIFFUSE)
        printf(", roughness %.3g", (double)material->roughness);
    if (material->attenuation_distance > 0)
        printf(", colour %.3g %.3g %.3g after %.3g m", (double)material->attenuation_color[0],
               (double)material->attenuation_color[1], (double)material->attenuation_color[2],
               (double)material->attenuation_distance);
    if (material->base_color_image != SCENE_NONE)
        printf(", textured");
    if (material->emission[0] > 0 || material->emission[1] > 0 || material->emission[2] > 0)
        printf(", emits %.4g %.4g %.4g W/(m^2 sr)", (double)material->emission[0],
               (double)material->emission[1], (double)material->emission[2]);
    printf("\n");
}

static void print_light(const struct scene_light *light, const struct pose_light *place)
{
    static const char *const types[] = {"point", "spot", "directional"};
    printf("  light     %-20s %s, %.4g %.4g %.4g %s", light->name,
           light->is_emissive_mesh ? "emissive mesh" : types[light->type], (double)light->intensity[0],
           (double)light->intensity[1], (double)light->intensity[2],
           light->type == LIGHT_DIRECTIONAL ? "W/m^2" : "W/sr");
    if (light->shape == LIGHT_SHAPE_SPHERE)
        printf(", a sphere of radius %.4g m", (double)light->half_size[0]);
    else if (light->shape != LIGHT_SHAPE_POINT)
        printf(", a %s of %.4g x %.4g m", light->shape == LIGHT_SHAPE_DISK ? "disk" : "rectangle",
               2 * (double)light->half_size[0], 2 * (double)light->half_size[1]);
    if (light->type != LIGHT_DIRECTIONAL)
        printf(", at %.4g %.4g %.4g", (double)place->position[0], (double)place->position[1],
               (double)place->position[2]);
    if (light->type != LIGHT_POINT)
        printf(", towards %.4g %.4g %.4g", (double)place->direction[0] + 0.0, (double)place->direction[1],
               (double)place->direction[2] + 0.0);
    printf("\n");
}

static void print_camera(const struct scene_camera *camera, const struct pose_camera *place)
{
    printf("  camera    %-20s at %.4g %.4g %.4g, towards %.4g %.4g %.4g, %.4g degrees high\n", camera->name,
           (double)place->eye[0], (double)place->eye[1], (double)place->eye[2],
           (double)place->forward[0] + 0.0, (double)place->forward[1] + 0.0, (double)place->forward[2],
           (double)camera->yfov * 57.29577951308232);
}

static int describe(const char *name)
{
    struct error error = {0};
    struct scene *scene = scene_open(name, &error);
    if (!scene)
        return complain(&error);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    if (!pose) {
        scene_destroy(&scene);
        return complain(&error);
    }
    printf("%s: %u triangles in %u instances of %u meshes, %u vertices, %u nodes, %u images\n", scene->name,
           scene->triangle_count, scene->instance_count, scene->mesh_count, scene->vertex_count,
           scene->node_count, scene->image_count);
    if (scene->duration > 0)
        printf("  animated  %.4g s, %u channels\n", (double)scene->duration, scene->channel_count);
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        printf("  instance  %-20s %u triangles, %s\n", scene->nodes[scene->instances[i].node].name,
               mesh->triangle_count, scene->materials[mesh->material].name);
    }
    for (uint32_t i = 0; i < scene->material_count; i++)
        print_material(&scene->materials[i]);
    for (uint32_t i = 0; i < scene->light_count; i++)
        print_light(&scene->lights[i], &pose->lights[i]);
    for (uint32_t i = 0; i < scene->camera_count; i++)
        print_camera(&scene->cameras[i], &pose->cameras[i]);
    for (uint32_t i = 0; i < scene->warning_count; i++)
        printf("  warning   %s\n", scene->warnings[i]);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
    return 0;
}

static int export_scene(const char *name, const char *path)
{
    struct error error = {0};
    struct scene *scene = scene_open(name, &error);
    if (!scene)
        return complain(&error);
    bool is_written = scene_export(scene, path, &error);
    if (is_written && scene->image_count)
        fprintf(stderr, "caustic-scene: %u textures are left out of %s\n", scene->image_count, path);
    scene_destroy(&scene);
    return is_written ? 0 : complain(&error);
}

int main(int count, char **arguments)
{
    const char *command = count > 1 ? arguments[1] : "";
    for (int i = 1; i < count; i++)
        if (!strcmp(arguments[i], "--help") || !strcmp(arguments[i], "-h") || !strcmp(arguments[i], "help")) {
            fputs(usage, stdout);
            return 0;
        }
    if (!strcmp(command, "list") && count == 2)
        return list_scenes();
    if (!strcmp(command, "info") && count == 3)
        return describe(arguments[2]);
    if (!strcmp(command, "export") && count == 4) {
        size_t length = strlen(arguments[3]);
        if (length > 4 && !strcmp(arguments[3] + length - 4, ".glb"))
            return export_scene(arguments[2], arguments[3]);
        fprintf(stderr, "caustic-scene: the file to write, \"%s\", must end in .glb\n", arguments[3]);
        return 2;
    }
    if (!*command)
        fprintf(stderr, "caustic-scene: say list, info or export; caustic-scene --help tells more\n");
    else
        fprintf(
            stderr,
            "caustic-scene: \"%s\" with %d arguments is not understood; caustic-scene --help tells more\n",
            command, count - 2);
    return 2;
}
