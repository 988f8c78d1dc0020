/* stage.h: a whole scene, built-in or from a file, rendered in this process with its own camera. Used with
 * truth.h's truth_set, truth_render, truth_channel and truth_close. */
#ifndef TEST_STAGE_H
#define TEST_STAGE_H

#include "truth.h"

/* The built-in scene of that name or the file at that path; `settings` as in truth_params. Fails the test
 * that calls it when something goes wrong; skips the program where there is no Vulkan device. */
void stage_open(struct truth *stage, const char *scene, uint32_t width, uint32_t height,
                const char *settings);

/* The same of a scene made by hand, which the stage takes. */
void stage_open_scene(struct truth *stage, struct scene *scene, uint32_t width, uint32_t height,
                      const char *settings);

/* The value of a statistic by its name; false when there is none of that name. */
bool stage_stat(const struct frame_result *result, const char *name, double *value);

/* The path of a file of the project's data that does not lie in the checkout: `name` below CAUSTICD_SHARED or
 * ../shared beside CAUSTICD_SOURCE_DIR. False when it is not there. */
bool stage_shared_file(const char *name, char *path, size_t size);

#endif
