#include "layer.h"

#include <dirent.h>
#include <string.h>
#include <unistd.h>

#include "test_shaders.h"

char layer_cache[] = "/tmp/caustic-gpu-test-XXXXXX";
struct gpu *layer_gpu;
char layer_log[2048];
uint32_t layer_log_count;

void layer_keep_log(void *user, enum gpu_log_level level, const char *text)
{
    (void)user;
    if (level != GPU_LOG_INFO) {
        print_message("gpu: %s\n", text);
        layer_log_count++;
    }
    snprintf(layer_log, sizeof layer_log, "%s", text);
}

struct gpu *layer_open(bool validation)
{
    struct error error;
    const struct gpu_params params = {
        .cache_dir = layer_cache, .validation = validation, .log = layer_keep_log};
    struct gpu *opened = gpu_create(&params, &error);
    if (!opened) {
        print_error("%s\n", error.message);
    }
    assert_non_null(opened);
    return opened;
}

int layer_set_up(void **state)
{
    (void)state;
    layer_log_count = 0;
    layer_gpu = layer_open(true);
    return 0;
}

int layer_tear_down(void **state)
{
    (void)state;
    const bool is_clean = gpu_validation_count(layer_gpu) == 0 && layer_log_count == 0;
    /* A test that failed keeps its objects; then only its own failure counts. */
    gpu_destroy(&layer_gpu);
    return is_clean && layer_log_count == 0 ? 0 : -1;
}

/* ---- shorthands --------------------------------------------------------------------------------------- */

void layer_check(bool done, const struct error *error)
{
    if (!done) {
        print_error("%s\n", error->message);
    }
    assert_true(done);
}

struct gpu_buffer *layer_buffer(const char *name, size_t size, enum gpu_memory memory)
{
    struct error error;
    const struct gpu_buffer_params params = {.name = name, .size = size, .memory = memory};
    struct gpu_buffer *buffer = gpu_buffer_create(layer_gpu, &params, &error);
    layer_check(buffer != NULL, &error);
    return buffer;
}

struct gpu_pipeline *layer_pipeline(const char *shader, uint32_t binding_mask, uint32_t push_bytes)
{
    struct error error;
    struct gpu_pipeline_params params = {
        .name = shader, .binding_mask = binding_mask, .push_bytes = push_bytes};
    params.spirv = test_shader_find(shader, &params.spirv_bytes);
    struct gpu_pipeline *pipeline = gpu_pipeline_create(layer_gpu, &params, &error);
    layer_check(pipeline != NULL, &error);
    return pipeline;
}

struct gpu_frame *layer_begin(void)
{
    struct error error;
    struct gpu_frame *frame = gpu_frame_begin(layer_gpu, &error);
    layer_check(frame != NULL, &error);
    return frame;
}

void layer_submit(struct gpu_frame *frame)
{
    struct error error;
    layer_check(gpu_frame_submit(frame, &error), &error);
}

void layer_finish(struct gpu_frame *frame)
{
    struct error error;
    layer_submit(frame);
    layer_check(gpu_frame_wait(frame, &error), &error);
}

bool layer_cache_file(char path[512])
{
    struct dirent *entry;
    DIR *folder = opendir(layer_cache);
    bool found = false;
    while (folder && (entry = readdir(folder))) {
        if (strncmp(entry->d_name, "pipelines-", 10) == 0) {
            assert_false(found);
            snprintf(path, 512, "%s/%s", layer_cache, entry->d_name);
            found = true;
        }
    }
    closedir(folder);
    return found;
}

int layer_run(const struct CMUnitTest *tests, size_t count)
{
    if (!mkdtemp(layer_cache))
        return 1;
    const int failures = _cmocka_run_group_tests("tests", tests, count, NULL, NULL);
    char path[512];
    if (layer_cache_file(path)) {
        unlink(path);
    }
    rmdir(layer_cache);
    return failures;
}
