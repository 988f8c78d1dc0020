/* causticd: a render server for caustics. See options.c for its command line, docs/server.md for how it
 * works. */
#include "server.h"

#include <stdio.h>

static int list_devices(void)
{
    struct gpu_info infos[32];
    uint32_t count = gpu_list(infos, 32);
    if (!count) {
        fprintf(stderr, "causticd: error: there is no Vulkan 1.3 device; on Debian and Ubuntu install "
                        "mesa-vulkan-drivers\n");
        return 1;
    }
    static const char *const types[] = {"other", "integrated", "discrete", "virtual", "CPU"};
    for (uint32_t i = 0; i < count && i < 32; i++)
        printf("%u  %s  (%s, %s%s)\n", i, infos[i].name, types[infos[i].type], infos[i].driver,
               infos[i].has_ray_query ? ", ray queries" : "");
    return 0;
}

int main(int argc, char **argv)
{
    struct options options;
    enum options_outcome outcome = options_read(&options, argc, argv);
    if (outcome != OPTIONS_RUN)
        return outcome == OPTIONS_DONE ? 0 : 2;
    log_set_level(options.log_level);
    if (options.list_devices)
        return list_devices();
    struct error error;
    struct scene *scene = scene_open(options.scene, &error);
    if (!scene) {
        log_line(LOG_LEVEL_ERROR, "%s", error.message);
        return 1;
    }
    for (uint32_t i = 0; i < scene->warning_count; i++)
        log_line(LOG_LEVEL_WARNING, "%s: %s", scene->name, scene->warnings[i]);
    int status = server_run(&options, scene);
    scene_destroy(&scene);
    return status;
}
