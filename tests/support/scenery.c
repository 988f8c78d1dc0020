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

void scenery_dish(struct scene_builder *builder, uint32_t material, const struct scenery_dish *dish)
{
    uint32_t first_vertex = builder->scene->vertex_count, first_index = builder->scene->index_count;
    uint32_t around = dish->segments, count = dish->rings * around;
    struct scene_vertex *vertices = scene_builder_vertices(builder, 1 + count);
    uint32_t *indices = scene_builder_indices(builder, 3 * around + 6 * (dish->rings - 1) * around);
    double side = dish->looks_down ? -1 : 1;
    for (uint32_t i = 0; vertices && i <= count; i++) { /* the middle, then ring after ring */
        double radius = i ? dish->radius * ((i - 1) / around + 1) / dish->rings : 0;
        double angle = 2 * 3.14159265358979323846 * ((i ? i - 1 : 0) % around) / around,
               slope = dish->slope(radius);
        vec3_store(vertices[i].position,
                   vec3_make(radius * cos(angle), dish->height(radius), radius * sin(angle)));
        vec3_store(
            vertices[i].normal,
            vec3_scale(vec3_unit(vec3_make(-slope * cos(angle), 1, -slope * sin(angle)), vec3_make(0, 1, 0)),
                       side));
    }
    for (uint32_t ring = 0; indices && ring < dish->rings; ring++)
        for (uint32_t k = 0; k < around; k++) {
            uint32_t next = (k + 1) % around, outer = 1 + ring * around, inner = outer - around;
            uint32_t corners[6] = {outer + k, inner + k, inner + next, outer + k, inner + next, outer + next};
            if (ring == 0) {
                *indices++ = 0;
                *indices++ = outer + next;
                *indices++ = outer + k;
                continue;
            }
            for (int i = 0; i < 6; i++)
                *indices++ = corners[i];
        }
    scenery_place(builder, scene_builder_mesh(builder, "dish", material, first_vertex, first_index));
}

bool scenery_plan_uses(const struct frame_result *result, const char *name)
{
    for (uint32_t i = 0; i < result->plan_count; i++)
        if (!strcmp(result->plan[i].name, name))
            return result->plan[i].is_used;
    fail_msg("the plan has no line %s", name);
    return false;
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
    scenery_open_within(stage, builder, camera, width, height, settings, 0);
}

void scenery_open_within(struct truth *stage, struct scene_builder *builder, const struct view_camera *camera,
                         uint32_t width, uint32_t height, const char *settings, uint64_t max_storage_bytes)
{
    struct error error = {0};
    *stage = (struct truth){.camera = *camera, .width = width, .height = height};
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    stage->scene = scene_builder_finish(builder, &error);
    if (stage->scene)
        stage->gpu = gpu_create(&(struct gpu_params){.max_storage_bytes = max_storage_bytes}, &error);
    if (stage->gpu)
        stage->renderer =
            renderer_create(&(struct renderer_params){.gpu = stage->gpu, .scene = stage->scene}, &error);
    if (stage->renderer)
        stage->view = view_create(stage->renderer, width, height, &error);
    if (!stage->view)
        fail_msg("%s", error.message);
    truth_set(stage, settings);
}
