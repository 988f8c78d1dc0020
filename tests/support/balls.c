#include "balls.h"

#include <string.h>

#include "check.h"
#include "core/scene/shapes.h"

/* A node that is a kilometre below the floor until `seconds`, and then in its place; animations loop after
 * 1,000 s. */
static void appear_at(struct scene_builder *builder, uint32_t node, double seconds)
{
    static const float times[3] = {0, 0, 1000}, values[9] = {0, -1000, 0};
    struct scene_channel channel = {.node = node,
                                    .path = ANIMATION_TRANSLATION,
                                    .interpolation = ANIMATION_STEP,
                                    .key_count = 3,
                                    .times = malloc(sizeof times),
                                    .values = malloc(sizeof values)};
    if (!channel.times || !channel.values)
        fail_msg("out of memory");
    memcpy(channel.times, times, sizeof times);
    memcpy(channel.values, values, sizeof values);
    channel.times[1] = (float)seconds;
    scene_builder_channel(builder, &channel);
}

static void add_ball(struct scene_builder *builder, const struct ball *ball, uint32_t subdivisions)
{
    bool is_mirror = ball->kind == MATERIAL_MIRROR;
    struct scene_material material = scene_material_default("caster");
    material.kind = ball->kind;
    material.metallic = is_mirror ? 1 : 0;
    material.transmission = is_mirror ? 0 : 1;
    material.roughness = 0;
    struct vec3 centre = vec3_make(ball->centre[0], ball->centre[1], ball->centre[2]);
    uint32_t mesh = shape_icosphere(builder, "ball", scene_builder_material(builder, &material), centre,
                                    ball->radius, subdivisions);
    struct scene_node node = scene_node_default("ball", SCENE_NONE);
    uint32_t index = scene_builder_node(builder, &node);
    scene_builder_instance(builder, index, mesh);
    if (ball->appears > 0)
        appear_at(builder, index, ball->appears);
}

static void add_light(struct scene_builder *builder, const struct ball_light *light)
{
    static const double down[3] = {0, -1, 0};
    bool is_aimed = light->direction[0] != 0 || light->direction[1] != 0 || light->direction[2] != 0;
    struct scene_light source = {
        .type = light->type, .inner_cone = (float)light->inner, .outer_cone = (float)light->outer};
    for (int k = 0; k < 3; k++)
        source.intensity[k] = (float)light->intensity[k];
    source.node = truth_aimed_node(builder, "light", light->position, is_aimed ? light->direction : down);
    scene_builder_light(builder, &source);
}

struct scene *balls_scene(const struct balls_params *params, struct error *error)
{
    struct scene_builder builder;
    scene_builder_begin(&builder, "balls");
    struct scene_material white = scene_material_default("floor");
    white.double_sided = true;
    struct scene_node node = scene_node_default("floor", SCENE_NONE);
    uint32_t floor = shape_floor(&builder, "floor", scene_builder_material(&builder, &white),
                                 vec3_make(0, 0, 0), params->floor_side > 0 ? params->floor_side : 16);
    scene_builder_instance(&builder, scene_builder_node(&builder, &node), floor);
    for (uint32_t i = 0; i < params->ball_count; i++)
        add_ball(&builder, &params->balls[i], params->subdivisions ? params->subdivisions : 4);
    for (uint32_t i = 0; i < params->light_count; i++)
        add_light(&builder, &params->lights[i]);
    return scene_builder_finish(&builder, error);
}

void balls_open(struct truth *stage, const struct balls_params *params)
{
    struct error error = {0};
    struct scene *scene = balls_scene(params, &error);
    if (!scene)
        fail_msg("%s", error.message);
    truth_open_scene(stage, scene, &params->camera, params->width, params->height, params->settings);
}

void balls_set_intensity(struct truth *stage, uint32_t light, double intensity)
{
    struct error error = {0};
    float value = (float)intensity;
    struct view_light change = {.overrides = LIGHT_OVERRIDE_INTENSITY, .intensity = {value, value, value}};
    if (!view_set_light(stage->view, light, &change, &error))
        fail_msg("%s", error.message);
}

double balls_floor_flux(const struct truth *stage, const float *values, uint32_t x0, uint32_t x1)
{
    double flux = 0;
    for (uint32_t y = 0; y < stage->height; y++)
        for (uint32_t x = x0; x < x1; x++)
            flux += (double)values[3 * ((size_t)y * stage->width + x)] *
                    truth_pixel_area(stage, x + 0.5, y + 0.5);
    return flux;
}

void balls_light_photons(const struct frame_result *result, uint32_t light_count, double *photons)
{
    uint32_t columns = 1;
    while (columns * columns < light_count)
        columns *= 2;
    const float *density = truth_channel(result, CHANNEL_DENSITY);
    uint32_t width = 0;
    for (uint32_t i = 0; i < result->channel_count; i++)
        if (result->channels[i].channel == CHANNEL_DENSITY)
            width = result->channels[i].width;
    uint32_t side = width / columns;
    for (uint32_t light = 0; light < light_count; light++) {
        photons[light] = 0;
        for (uint32_t i = 0; i < side * side; i++) {
            uint32_t x = light % columns * side + i % side, y = light / columns * side + i / side;
            double value = (double)density[(size_t)y * width + x], root = floor(sqrt(value));
            photons[light] += value > 0 ? fmax(root * root, 1) : 0;
        }
    }
}
