#include "scenery.h"

#include <string.h>

#include "check.h"

void scenery_begin(struct scene_builder *builder, const struct scenery_params *params)
{
    scene_builder_begin(builder, "scenery");
    struct scene_node root = scene_node_default("root", SCENE_NONE);
    for (int k = 0; params && k < 3; k++) {
        root.scale[k] = params->scale > 0 ? (float)params->scale : 1.0f;
        root.translation[k] = (float)params->shift[k];
    }
    scene_builder_node(builder, &root);
}

uint32_t scenery_diffuse(struct scene_builder *builder)
{
    struct scene_material material = scene_material_default("white");
    material.double_sided = true;
    return scene_builder_material(builder, &material);
}

uint32_t scenery_glass(struct scene_builder *builder, double ior)
{
    struct scene_material material = scene_material_default("glass");
    material.kind = MATERIAL_DIELECTRIC;
    material.transmission = 1;
    material.roughness = 0;
    material.ior = (float)ior;
    return scene_builder_material(builder, &material);
}

uint32_t scenery_mirror(struct scene_builder *builder)
{
    struct scene_material material = scene_material_default("mirror");
    material.kind = MATERIAL_MIRROR;
    material.metallic = 1;
    material.roughness = 0;
    return scene_builder_material(builder, &material);
}

void scenery_place(struct scene_builder *builder, uint32_t mesh)
{
    struct scene_node node = scene_node_default("thing", 0);
    scene_builder_instance(builder, scene_builder_node(builder, &node), mesh);
}

/* A node at `eye` whose -Z looks along `forward`. */
static uint32_t add_looking(struct scene_builder *builder, struct vec3 eye, struct vec3 forward,
                            struct vec3 up)
{
    struct scene_node node = scene_node_default("looking", 0);
    struct vec3 back = vec3_unit(vec3_scale(forward, -1), vec3_make(0, 1, 0));
    struct vec3 right = vec3_unit(vec3_cross(up, back), vec3_make(1, 0, 0));
    node.has_matrix = true;
    vec3_store(node.matrix, right);
    vec3_store(node.matrix + 4, vec3_cross(back, right));
    vec3_store(node.matrix + 8, back);
    vec3_store(node.matrix + 12, eye);
    node.matrix[15] = 1;
    return scene_builder_node(builder, &node);
}

static void add_light(struct scene_builder *builder, enum light_type type, uint32_t node, double intensity)
{
    struct scene_light light = {.type = type, .node = node};
    scene_name_copy(light.name, "light");
    vec3_store(light.intensity, vec3_make(intensity, intensity, intensity));
    scene_builder_light(builder, &light);
}

void scenery_lamp(struct scene_builder *builder, struct vec3 position, double intensity)
{
    struct scene_node node = scene_node_default("lamp", 0);
    vec3_store(node.translation, position);
    add_light(builder, LIGHT_POINT, scene_builder_node(builder, &node), intensity);
}

void scenery_sun(struct scene_builder *builder, struct vec3 direction, double irradiance)
{
    struct vec3 up =
        fabs(direction.y) < 0.9 * vec3_length(direction) ? vec3_make(0, 1, 0) : vec3_make(0, 0, 1);
    add_light(builder, LIGHT_DIRECTIONAL, add_looking(builder, vec3_make(0, 0, 0), direction, up),
              irradiance);
}

void scenery_floor(struct scene_builder *builder, double side)
{
    scenery_place(builder, shape_floor(builder, "floor", scenery_diffuse(builder), vec3_make(0, 0, 0), side));
}

struct view_camera scenery_camera(struct scene_builder *builder, struct vec3 eye, struct vec3 at,
                                  struct vec3 up, double fov_degrees)
{
    struct scene_camera camera = {.yfov = (float)(fov_degrees * 3.14159265358979323846 / 180)};
    scene_name_copy(camera.name, "camera");
    camera.node = add_looking(builder, eye, vec3_sub(at, eye), up);
    scene_builder_camera(builder, &camera);
    struct view_camera own = {.fov = (float)fov_degrees};
    vec3_store(own.eye, eye);
    vec3_store(own.at, at);
    vec3_store(own.up, up);
    return own;
}

void scenery_open(struct truth *stage, struct scene_builder *builder, const struct view_camera *camera,
                  uint32_t width, uint32_t height, const char *settings)
{
    struct error error = {0};
    *stage = (struct truth){.camera = *camera, .width = width, .height = height};
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    stage->scene = scene_builder_finish(builder, &error);
    if (stage->scene)
        stage->gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (stage->gpu)
        stage->renderer =
            renderer_create(&(struct renderer_params){.gpu = stage->gpu, .scene = stage->scene}, &error);
    if (stage->renderer)
        stage->view = view_create(stage->renderer, width, height, &error);
    if (!stage->view)
        fail_msg("%s", error.message);
    truth_set(stage, settings);
}
