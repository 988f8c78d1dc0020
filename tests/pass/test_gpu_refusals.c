/* test_gpu_refusals.c: the Vulkan layer: what it refuses, and what it says then. */
#include <dirent.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/layer.h"
#include "tests/support/test_shaders.h"

/* ---- refusals ----------------------------------------------------------------------------------------- */

static void expect_create_error(const struct gpu_params *params, enum status status, const char *part)
{
    struct error error = {0};
    struct gpu *none = gpu_create(params, &error);
    if (none || error.status != status || !strstr(error.message, part)) {
        print_error("expected '%s', got '%s'\n", part, error.message);
        gpu_destroy(&none);
        fail();
    }
}

static void devices_are_chosen_by_name_or_index(void **state)
{
    (void)state;
    struct gpu_info infos[8];
    struct error error;
    const uint32_t count = gpu_list(infos, 8);
    assert_in_range(count, 1, 8);
    assert_int_equal(gpu_list(NULL, 0), count);
    expect_create_error(&(struct gpu_params){.device = "no such device", .cache_dir = layer_cache},
                        STATUS_NOT_FOUND, "no such device");
    expect_create_error(&(struct gpu_params){.device = "no such device", .cache_dir = layer_cache},
                        STATUS_NOT_FOUND, infos[0].name);
    expect_create_error(&(struct gpu_params){.device = "", .cache_dir = layer_cache}, STATUS_NOT_FOUND,
                        infos[0].name);
    char index[16];
    snprintf(index, sizeof index, "%u", count);
    expect_create_error(&(struct gpu_params){.device = index, .cache_dir = layer_cache}, STATUS_NOT_FOUND,
                        index);

    /* Part of the name, in the other case. */
    char part[6] = {0};
    for (uint32_t i = 0; i < 5; i++) {
        const char c = infos[0].name[i];
        part[i] = (char)(c >= 'a' && c <= 'z' ? c - 32 : c >= 'A' && c <= 'Z' ? c + 32 : c);
    }
    const char *const wishes[] = {"0", part};
    for (uint32_t i = 0; i < 2; i++) {
        struct gpu *chosen =
            gpu_create(&(struct gpu_params){.device = wishes[i], .cache_dir = layer_cache}, &error);
        layer_check(chosen != NULL, &error);
        if (i == 0) {
            assert_string_equal(gpu_info(chosen)->name, infos[0].name);
        }
        gpu_destroy(&chosen);
    }
    const struct gpu_info *info = gpu_info(layer_gpu);
    assert_true(info->max_storage_bytes >= 128u << 20);
    assert_true(info->memory_bytes > 0);
    assert_true(info->max_image_size >= 4096);
    assert_true(info->subgroup_size >= 1);
    assert_true(info->driver[0] != '\0');
}

static void a_machine_without_devices_is_told_what_to_install(void **state)
{
    (void)state;
    const char *const variables[] = {"VK_DRIVER_FILES", "VK_ICD_FILENAMES"};
    char *saved[2] = {NULL, NULL};
    for (uint32_t i = 0; i < 2; i++) {
        const char *value = getenv(variables[i]);
        saved[i] = value ? strdup(value) : NULL;
        setenv(variables[i], "/nonexistent/driver.json", 1);
    }
    struct error error = {0};
    struct gpu *none = gpu_create(&(struct gpu_params){.cache_dir = layer_cache}, &error);
    const uint32_t count = gpu_list(NULL, 0);
    for (uint32_t i = 0; i < 2; i++) {
        if (saved[i]) {
            setenv(variables[i], saved[i], 1);
            free(saved[i]);
        } else {
            unsetenv(variables[i]);
        }
    }
    assert_null(none);
    assert_int_equal(count, 0);
    assert_int_equal(error.status, STATUS_DEVICE);
    assert_non_null(strstr(error.message, "mesa-vulkan-drivers"));
}

static void bad_objects_are_refused(void **state)
{
    (void)state;
    struct error error;
    const struct gpu_info *info = gpu_info(layer_gpu);
    const uint64_t before = gpu_memory_in_use(layer_gpu);
    assert_null(gpu_buffer_create(layer_gpu, &(struct gpu_buffer_params){.name = "nothing"}, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, "nothing"));
    assert_null(gpu_buffer_create(
        layer_gpu, &(struct gpu_buffer_params){.name = "giant", .size = (size_t)info->max_storage_bytes + 1},
        &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "giant"));
    assert_null(
        gpu_buffer_create(layer_gpu, &(struct gpu_buffer_params){.name = "giant", .size = SIZE_MAX}, &error));
    assert_int_equal(error.status, STATUS_LIMIT);

    struct gpu_pipeline_params params = {.name = "bad pipeline", .binding_mask = 1, .push_bytes = 4};
    params.spirv = test_shader_find("gpu_ramp.comp", &params.spirv_bytes);
    struct gpu_pipeline_params bad = params;
    bad.push_bytes = 132;
    assert_null(gpu_pipeline_create(layer_gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    bad = params;
    bad.spirv_bytes = 12;
    assert_null(gpu_pipeline_create(layer_gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, "bad pipeline"));
    const uint32_t words[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    bad.spirv = words;
    bad.spirv_bytes = sizeof words;
    assert_null(gpu_pipeline_create(layer_gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    bad = params;
    bad.accel_mask = 2;
    assert_null(gpu_pipeline_create(layer_gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);

    struct gpu_raster_params raster = {.name = "bad raster", .width = 16, .height = 16, .samples = 3};
    assert_null(gpu_raster_create(layer_gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    raster.samples = 1;
    raster.width = 0;
    assert_null(gpu_raster_create(layer_gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    raster.width = info->max_image_size + 1;
    assert_null(gpu_raster_create(layer_gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    raster.width = 16;
    assert_null(gpu_raster_create(layer_gpu, &raster, &error)); /* no shaders */
    assert_int_equal(error.status, STATUS_INVALID);
    assert_true(gpu_memory_in_use(layer_gpu) == before);
}

/* What is wrong in a frame is reported by its submission, and the next frame works. */
static void bad_commands_are_reported_at_submission(void **state)
{
    (void)state;
    struct error error;
    struct gpu_buffer *a = layer_buffer("first", 64, GPU_MEMORY_DEVICE);
    struct gpu_buffer *b = layer_buffer("second", 64, GPU_MEMORY_READBACK);
    struct gpu_buffer *doomed = layer_buffer("doomed", 64, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *ramp = layer_pipeline("gpu_ramp.comp", 1, 4);
    const uint32_t start = 1;
    const struct gpu_bind right = {.binding = 0, .access = GPU_WRITE, .buffer = b};
    const struct gpu_bind wrong_binding = {.binding = 1, .access = GPU_WRITE, .buffer = b};
    const struct gpu_bind no_access = {.binding = 0, .buffer = b};
    const struct gpu_bind no_buffer = {.binding = 0, .access = GPU_WRITE};
    const struct gpu_bind twice[] = {right, right};
    const struct {
        const char *part;
    } expected[] = {
        {"binding 0"}, {"binding 0"}, {"binding 0"}, {"twice"},    {"push constants"}, {"groups"},
        {"first"},     {"second"},    {"multiple"},  {"overlaps"}, {"not ended"},      {"inside"},
        {"not begun"}, {"doomed"},    {"first"},     {"multiple"},
    };
    for (uint32_t i = 0; i < sizeof expected / sizeof *expected; i++) {
        struct gpu_frame *frame = layer_begin();
        struct gpu_dispatch dispatch = {.pipeline = ramp, .binds = &right, .bind_count = 1, .push = &start};
        switch (i) {
        case 0:
            dispatch.binds = &wrong_binding;
            break;
        case 1:
            dispatch.binds = &no_access;
            break;
        case 2:
            dispatch.binds = &no_buffer;
            break;
        case 3:
            dispatch.binds = twice;
            dispatch.bind_count = 2;
            break;
        case 4:
            dispatch.push = NULL;
            break;
        case 5:
            dispatch.groups[1] = UINT32_MAX;
            break;
        case 6:
            gpu_record_fill(frame, a, 32, 36, 0);
            break;
        case 7:
            gpu_record_copy(frame, b, SIZE_MAX - 3, a, 0, 8);
            break;
        case 8:
            gpu_record_fill(frame, a, 2, 4, 0);
            break;
        case 9:
            gpu_record_copy(frame, a, 0, a, 8, 16);
            break;
        case 10:
            gpu_pass_begin(frame, "endless");
            break;
        case 11:
            gpu_pass_begin(frame, "outer");
            gpu_pass_begin(frame, "inner");
            break;
        case 12:
            gpu_pass_end(frame);
            break;
        case 13:
            gpu_record_fill(frame, doomed, 0, 64, 0);
            gpu_buffer_destroy(&doomed);
            break;
        case 14:
            dispatch.indirect = a;
            dispatch.indirect_offset = 56;
            break;
        default:
            dispatch.indirect = a;
            dispatch.indirect_offset = 2;
            break;
        }
        gpu_record_dispatch(frame, &dispatch);
        assert_false(gpu_frame_submit(frame, &error));
        if (!strstr(error.message, expected[i].part)) {
            print_error("case %u: expected '%s', got '%s'\n", i, expected[i].part, error.message);
            fail();
        }
        assert_false(gpu_frame_submit(frame, &error));
        assert_false(gpu_frame_wait(frame, &error));
    }
    /* A frame that is forgotten is dropped. */
    struct gpu_frame *forgotten = layer_begin();
    gpu_record_dispatch(forgotten, &(struct gpu_dispatch){
                                       .pipeline = ramp, .binds = &right, .bind_count = 1, .push = &start});
    struct gpu_frame *frame = layer_begin();
    gpu_record_dispatch(
        frame, &(struct gpu_dispatch){.pipeline = ramp, .binds = &right, .bind_count = 1, .push = &start});
    layer_finish(frame);
    assert_false(gpu_frame_submit(forgotten, &error));
    for (uint32_t i = 0; i < 16; i++) {
        assert_int_equal(((const uint32_t *)gpu_buffer_map(b))[i], 1 + i);
    }
    gpu_buffer_destroy(&a);
    gpu_buffer_destroy(&b);
    gpu_pipeline_destroy(&ramp);
}

static void ray_queries_are_refused_where_there_are_none(void **state)
{
    (void)state;
    struct error error;
    if (gpu_info(layer_gpu)->has_ray_query) {
        print_message("the device has ray queries\n");
        return;
    }
    struct gpu_pipeline_params params = {.name = "tracer", .binding_mask = 7};
    params.spirv = test_shader_find("gpu_trace.comp", &params.spirv_bytes);
    assert_null(gpu_pipeline_create(layer_gpu, &params, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_non_null(strstr(error.message, "ray queries"));
    params.accel_mask = 1;
    assert_null(gpu_pipeline_create(layer_gpu, &params, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_null(gpu_accel_create_top(layer_gpu, "top", 1, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_null(gpu_accel_create_bottom(layer_gpu, "bottom", &(struct gpu_triangles){0}, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
}

int main(void)
{
    const struct CMUnitTest tests[] = {LAYER_TEST(devices_are_chosen_by_name_or_index),
                                       LAYER_TEST(a_machine_without_devices_is_told_what_to_install),
                                       LAYER_TEST(bad_objects_are_refused),
                                       LAYER_TEST(bad_commands_are_reported_at_submission),
                                       LAYER_TEST(ray_queries_are_refused_where_there_are_none)};
    return layer_run(tests, sizeof tests / sizeof *tests);
}
