#include "stage.h"

#include <string.h>
#include <unistd.h>

#include "check.h"

void stage_open(struct truth *stage, const char *scene, uint32_t width, uint32_t height, const char *settings)
{
    struct error error = {0};
    struct scene *opened = scene_open(scene, &error);
    if (!opened)
        fail_msg("%s: %s", scene, error.message);
    stage_open_scene(stage, opened, width, height, settings);
}

void stage_open_scene(struct truth *stage, struct scene *scene, uint32_t width, uint32_t height,
                      const char *settings)
{
    struct error error = {0};
    *stage = (struct truth){.width = width, .height = height, .scene = scene};
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    stage->gpu = gpu_create(&(struct gpu_params){0}, &error);
    if (stage->gpu)
        stage->renderer =
            renderer_create(&(struct renderer_params){.gpu = stage->gpu, .scene = stage->scene}, &error);
    if (stage->renderer)
        stage->view = view_create(stage->renderer, width, height, &error);
    if (!stage->view)
        fail_msg("%s: %s", scene->name, error.message);
    truth_set(stage, settings);
}

bool stage_stat(const struct frame_result *result, const char *name, double *value)
{
    for (uint32_t i = 0; i < STAT_COUNT; i++)
        if (!strcmp(stat_infos[i].name, name)) {
            *value = result->stats[i];
            return true;
        }
    return false;
}

bool stage_shared_file(const char *name, char *path, size_t size)
{
    const char *shared = getenv("CAUSTICD_SHARED"), *source = getenv("CAUSTICD_SOURCE_DIR");
    if (shared)
        snprintf(path, size, "%s/%s", shared, name);
    else
        snprintf(path, size, "%s/../shared/%s", source ? source : ".", name);
    return access(path, R_OK) == 0;
}
