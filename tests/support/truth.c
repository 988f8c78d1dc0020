#include "truth.h"

#include <string.h>

#include "check.h"
#include "core/scene/shapes.h"

/* ---- scene --------------------------------------------------------------------------------------------- */

static void place(struct scene_builder *builder, const char *name, uint32_t mesh)
{
    struct scene_node node = scene_node_default(name, SCENE_NONE);
    scene_builder_instance(builder, scene_builder_node(builder, &node), mesh);
}

static uint32_t add_material(struct scene_builder *builder, const struct truth_params *params, bool is_caster)
{
    struct scene_material material = scene_material_default(is_caster ? "caster" : "floor");
    material.double_sided = !is_caster;
    if (is_caster) {
        material.kind = params->caster == TRUTH_RING ? MATERIAL_MIRROR : MATERIAL_DIELECTRIC;
        material.metallic = params->caster == TRUTH_RING ? 1 : 0;
        material.transmission = params->caster == TRUTH_RING ? 0 : 1;
        material.roughness = 0;
        material.ior = params->ior > 0 ? (float)params->ior : 1.5f;
    }
    return scene_builder_material(builder, &material);
}

uint32_t truth_aimed_node(struct scene_builder *builder, const char *name, const double position[3],
                          const double direction[3])
{
    struct scene_node node = scene_node_default(name, SCENE_NONE);
    struct vec3 along = vec3_make(direction[0], direction[1], direction[2]);
    struct vec3 back = vec3_unit(vec3_scale(along, -1), vec3_make(0, 1, 0));
    struct vec3 right = vec3_unit(vec3_cross(vec3_make(0, 1, 0), back), vec3_make(1, 0, 0));
    node.has_matrix = true;
    vec3_store(node.matrix, right);
    vec3_store(node.matrix + 4, vec3_cross(back, right));
    vec3_store(node.matrix + 8, back);
    vec3_store(node.matrix + 12, vec3_make(position[0], position[1], position[2]));
    node.matrix[15] = 1;
    return scene_builder_node(builder, &node);
}

static void add_light(struct scene_builder *builder, const struct truth_params *params)
{
    static const double origin[3] = {0, 0, 0}, down[3] = {0, -1, 0};
    struct scene_light source = {.type = params->is_directional ? LIGHT_DIRECTIONAL : LIGHT_POINT};
    scene_name_copy(source.name, "light");
    vec3_store(source.intensity, vec3_make(params->intensity, params->intensity, params->intensity));
    source.node = params->is_directional ? truth_aimed_node(builder, "light", origin, params->light)
                                         : truth_aimed_node(builder, "light", params->light, down);
    scene_builder_light(builder, &source);
}

static struct scene *make_scene(const struct truth_params *params, struct error *error)
{
    struct scene_builder builder;
    scene_builder_begin(&builder, "truth");
    uint32_t floor = add_material(&builder, params, false), caster = add_material(&builder, params, true);
    double side = params->floor_side > 0 ? params->floor_side : 16;
    place(&builder, "floor", shape_floor(&builder, "floor", floor, vec3_make(0, 0, 0), side));
    struct vec3 centre = vec3_make(0, params->height, 0);
    switch (params->caster) {
    case TRUTH_INTERFACE:
        place(&builder, "sheet", shape_floor(&builder, "sheet", caster, centre, params->size));
        break;
    case TRUTH_SPHERE:
        place(&builder, "ball", shape_icosphere(&builder, "ball", caster, centre, params->size, 6));
        break;
    case TRUTH_RING: /* a hair above the floor: no edge lies in another surface */
        place(&builder, "ring",
              shape_tube(&builder, "ring", caster, vec3_make(0, 1e-4, 0), params->size, params->height - 1e-4,
                         4096, true));
        break;
    }
    add_light(&builder, params);
    return scene_builder_finish(&builder, error);
}

/* ---- rendering ----------------------------------------------------------------------------------------- */

void truth_set(struct truth *truth, const char *text)
{
    struct error error;
    char copy[512], *rest = copy, *word;
    snprintf(copy, sizeof copy, "%s", text ? text : "");
    while ((word = strtok_r(rest, " ", &rest))) {
        char *value = strchr(word, '=');
        if (!value)
            fail_msg("\"%s\" is not name=value", word);
        *value++ = '\0';
        struct settings settings = *view_settings(truth->view);
        if (!settings_set_text(&settings, word, value, &error))
            fail_msg("%s", error.message);
        for (enum setting_id id = 0; id < SETTING_COUNT; id++) {
            double wanted = settings_get(&settings, id);
            if (wanted != settings_get(view_settings(truth->view), id) &&
                !view_set_setting(truth->view, id, wanted, &error))
                fail_msg("%s", error.message);
        }
    }
}

void truth_open(struct truth *truth, const struct truth_params *params)
{
    struct error error = {0};
    struct scene *scene = make_scene(params, &error);
    if (!scene)
        fail_msg("%s", error.message);
    truth_open_scene(truth, scene, &params->camera, params->width, params->height_px, params->settings);
}

void truth_open_scene(struct truth *truth, struct scene *scene, const struct view_camera *camera,
                      uint32_t width, uint32_t height, const char *settings)
{
    struct error error = {0};
    *truth = (struct truth){.scene = scene, .camera = *camera, .width = width, .height = height};
    truth->gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (truth->gpu)
        truth->renderer =
            renderer_create(&(struct renderer_params){.gpu = truth->gpu, .scene = truth->scene}, &error);
    if (truth->renderer)
        truth->view = view_create(truth->renderer, width, height, &error);
    if (!truth->view || !view_set_camera(truth->view, &truth->camera, &error))
        fail_msg("%s", error.message);
    truth_set(truth, settings);
}

void truth_close(struct truth *truth)
{
    view_destroy(&truth->view);
    renderer_destroy(&truth->renderer);
    gpu_destroy(&truth->gpu);
    scene_destroy(&truth->scene);
}

const struct frame_result *truth_render(struct truth *truth, uint32_t frames, uint32_t channel_mask)
{
    struct error error = {0};
    const struct frame_result *result = NULL;
    for (uint32_t i = 0; i < frames; i++) {
        result = view_render(truth->view, channel_mask, &error);
        if (!result)
            fail_msg("%s", error.message);
    }
    return result;
}

const float *truth_channel(const struct frame_result *result, enum channel channel)
{
    for (uint32_t i = 0; i < result->channel_count; i++)
        if (result->channels[i].channel == channel)
            return result->channels[i].values;
    fail_msg("the frame has no channel %s", channel_infos[channel].name);
    return NULL;
}

/* ---- image and floor ----------------------------------------------------------------------------------- */

struct camera_frame {
    struct vec3 eye, right, up, forward;
    double scale; /* tangent of half the vertical angle, per half height in pixels */
};

static struct camera_frame frame_of(const struct truth *truth)
{
    struct vec3 eye = vec3_load(truth->camera.eye), none = vec3_make(0, 0, 0);
    struct vec3 forward = vec3_unit(vec3_sub(vec3_load(truth->camera.at), eye), none);
    struct vec3 right = vec3_unit(vec3_cross(forward, vec3_load(truth->camera.up)), none);
    double half = tan((double)truth->camera.fov * 3.14159265358979323846 / 360);
    return (struct camera_frame){eye, right, vec3_cross(right, forward), forward,
                                 half / (0.5 * truth->height)};
}

bool truth_floor_point(const struct truth *truth, double x, double y, double floor[2])
{
    struct camera_frame camera = frame_of(truth);
    struct vec3 way =
        vec3_add(camera.forward, vec3_add(vec3_scale(camera.right, (x - 0.5 * truth->width) * camera.scale),
                                          vec3_scale(camera.up, (0.5 * truth->height - y) * camera.scale)));
    if (way.y >= 0)
        return false;
    double t = camera.eye.y / -way.y;
    floor[0] = camera.eye.x + t * way.x;
    floor[1] = camera.eye.z + t * way.z;
    return true;
}

void truth_image_point(const struct truth *truth, const double floor[2], double image[2])
{
    struct camera_frame camera = frame_of(truth);
    struct vec3 way = vec3_sub(vec3_make(floor[0], 0, floor[1]), camera.eye);
    double depth = vec3_dot(way, camera.forward) * camera.scale;
    image[0] = 0.5 * truth->width + vec3_dot(way, camera.right) / depth;
    image[1] = 0.5 * truth->height - vec3_dot(way, camera.up) / depth;
}

double truth_pixel_area(const struct truth *truth, double x, double y)
{
    double corner[4][2];
    for (int i = 0; i < 4; i++)
        if (!truth_floor_point(truth, x + (i == 1 || i == 2 ? 0.5 : -0.5), y + (i >= 2 ? 0.5 : -0.5),
                               corner[i]))
            return 0;
    double diagonal[2][2];
    for (int k = 0; k < 2; k++) {
        diagonal[0][k] = corner[2][k] - corner[0][k];
        diagonal[1][k] = corner[3][k] - corner[1][k];
    }
    return 0.5 * fabs(diagonal[0][0] * diagonal[1][1] - diagonal[0][1] * diagonal[1][0]);
}

bool truth_shows_floor(const struct truth *truth, const float *depth, uint32_t x, uint32_t y)
{
    struct camera_frame camera = frame_of(truth);
    for (uint32_t j = y ? y - 1 : 0; j <= y + 1 && j < truth->height; j++) {
        for (uint32_t i = x ? x - 1 : 0; i <= x + 1 && i < truth->width; i++) {
            double floor[2];
            if (!truth_floor_point(truth, i + 0.5, j + 0.5, floor))
                return false;
            struct vec3 way = vec3_sub(vec3_make(floor[0], 0, floor[1]), camera.eye);
            double expected = vec3_dot(way, camera.forward),
                   seen = (double)depth[(size_t)j * truth->width + i];
            if (!(fabs(seen - expected) < 1e-3 * expected))
                return false;
        }
    }
    return true;
}
