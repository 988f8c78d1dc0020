/* layer.h: the Vulkan layer on a real device, under the validation layer, for its own tests.
 *
 * Every test between layer_set_up and layer_tear_down ends with no validation message, no object and no byte
 * of device memory left over. What fails here fails the running cmocka test.
 */
#ifndef TEST_LAYER_H
#define TEST_LAYER_H

#include "check.h"
#include "core/gpu/gpu.h"

extern struct gpu *layer_gpu;
extern char layer_cache[];       /* the folder of its pipeline cache */
extern char layer_log[2048];     /* the last line it wrote */
extern uint32_t layer_log_count; /* of warnings and errors */

void layer_keep_log(void *user, enum gpu_log_level level, const char *text);
/* Another one, with the same cache folder. */
struct gpu *layer_open(bool validation);
int layer_set_up(void **state);
int layer_tear_down(void **state);

/* Runs tests with a cache folder of their own; what main returns. */
int layer_run(const struct CMUnitTest *tests, size_t count);
#define LAYER_TEST(name) cmocka_unit_test_setup_teardown(name, layer_set_up, layer_tear_down)

/* Whether the pipeline cache has a file; its path. */
bool layer_cache_file(char path[512]);

void layer_check(bool done, const struct error *error);
struct gpu_buffer *layer_buffer(const char *name, size_t size, enum gpu_memory memory);
/* Of a shader of tests/shaders. */
struct gpu_pipeline *layer_pipeline(const char *shader, uint32_t binding_mask, uint32_t push_bytes);
struct gpu_frame *layer_begin(void);
void layer_submit(struct gpu_frame *frame);
void layer_finish(struct gpu_frame *frame);

#endif
