#include "server.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(SETTING_COUNT <= PROTOCOL_MAX_SETTINGS, "every setting fits HELLO");
_Static_assert(SCENE_MAX_LIGHTS <= PROTOCOL_MAX_LIGHTS, "every light fits HELLO");
_Static_assert((int)PROTOCOL_BOOL == (int)SETTING_BOOL && (int)PROTOCOL_INT == (int)SETTING_INT &&
                   (int)PROTOCOL_FLOAT == (int)SETTING_FLOAT && (int)PROTOCOL_CHOICE == (int)SETTING_CHOICE &&
                   (int)PROTOCOL_LIGHT_POINT == (int)LIGHT_POINT &&
                   (int)PROTOCOL_LIGHT_SPOT == (int)LIGHT_SPOT &&
                   (int)PROTOCOL_LIGHT_DIRECTIONAL == (int)LIGHT_DIRECTIONAL,
               "the renderer's numbers are those of the protocol");

static void describe_scene(struct protocol_hello *hello, const struct scene *scene,
                           const struct scene_pose *pose)
{
    hello->scene = protocol_text_of(scene->name);
    hello->triangles = scene->triangle_count;
    hello->duration = (double)scene->duration;
    hello->light_count = (uint16_t)scene->light_count;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        struct protocol_light *light = &hello->lights[i];
        light->name = protocol_text_of(scene->lights[i].name);
        light->type = (uint8_t)scene->lights[i].type;
        memcpy(light->intensity, scene->lights[i].intensity, sizeof light->intensity);
        memcpy(light->position, pose->lights[i].position, sizeof light->position);
        memcpy(light->direction, pose->lights[i].direction, sizeof light->direction);
    }
    hello->camera_total = scene->camera_count;
    hello->camera_count =
        (uint16_t)(scene->camera_count < PROTOCOL_MAX_CAMERAS ? scene->camera_count : PROTOCOL_MAX_CAMERAS);
    for (uint32_t i = 0; i < hello->camera_count; i++) {
        hello->cameras[i].name = protocol_text_of(scene->cameras[i].name);
        hello->cameras[i].fov = scene->cameras[i].yfov * (float)(180 / M_PI);
    }
}

static void describe_renderer(struct protocol_hello *hello)
{
    hello->setting_count = SETTING_COUNT;
    for (int i = 0; i < SETTING_COUNT; i++) {
        const struct setting_info *info = &setting_infos[i];
        hello->settings[i] = (struct protocol_setting){.name = protocol_text_of(info->name),
                                                       .choices = protocol_text_of(info->choices),
                                                       .help = protocol_text_of(info->help),
                                                       .type = (uint8_t)info->type,
                                                       .minimum = info->minimum,
                                                       .maximum = info->maximum,
                                                       .value = info->value};
    }
    hello->statistic_count = STAT_COUNT;
    for (int i = 0; i < STAT_COUNT; i++)
        hello->statistics[i] = (struct protocol_statistic){.name = protocol_text_of(stat_infos[i].name),
                                                           .unit = protocol_text_of(stat_infos[i].unit),
                                                           .help = protocol_text_of(stat_infos[i].help)};
    hello->channel_count = CHANNEL_COUNT;
    for (int i = 0; i < CHANNEL_COUNT; i++)
        hello->channels[i] =
            (struct protocol_channel_name){.name = protocol_text_of(channel_infos[i].name),
                                           .help = protocol_text_of(channel_infos[i].help),
                                           .components = (uint8_t)channel_infos[i].components};
}

bool hello_make(struct server *server, struct error *error)
{
    struct scene_pose *pose = scene_pose_create(server->scene, error);
    if (!pose)
        return false;
    scene_pose_set_time(server->scene, pose, 0);
    const struct render_info *render = render_thread_info(server->render);
    struct protocol_message *message = &server->outgoing;
    struct protocol_hello *hello = &message->hello;
    message->header = (struct protocol_header){.type = PROTOCOL_HELLO};
    hello->major = PROTOCOL_MAJOR;
    hello->minor = PROTOCOL_MINOR;
    hello->features =
        PROTOCOL_FEATURE_ZSTD | PROTOCOL_FEATURE_F16 | PROTOCOL_FEATURE_LIVE | PROTOCOL_FEATURE_SHARE;
    hello->version = protocol_text_of("causticd " CAUSTICD_VERSION);
    hello->device = protocol_text_of(render->gpu.name);
    hello->driver = protocol_text_of(render->gpu.driver);
    hello->tracer = protocol_text_of(render->tracer == TRACER_KHR ? "khr" : "bvh");
    hello->limits = (struct protocol_limits){.max_clients = server->options->max_clients,
                                             .max_views = server->options->max_views,
                                             .max_size = VIEW_MAX_SIZE,
                                             .max_pixels = server->max_pixels,
                                             .max_photons = render->limits.max_photons,
                                             .max_request_bytes = PROTOCOL_MAX_REQUEST_BYTES,
                                             .max_output_bytes = server->options->output_limit};
    describe_scene(hello, server->scene, pose);
    describe_renderer(hello);
    size_t size = protocol_encode(message, NULL, 0, error);
    server->hello = size ? malloc(size) : NULL;
    if (server->hello)
        server->hello_bytes = protocol_encode(message, server->hello, size, error);
    else if (size)
        error_set(error, STATUS_MEMORY, "out of memory for HELLO");
    scene_pose_destroy(&pose);
    return server->hello_bytes != 0;
}
