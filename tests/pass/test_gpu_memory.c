/* test_gpu_memory.c: the Vulkan layer: memory in use, growth, the pipeline cache on disk. */
#include <dirent.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/layer.h"
#include "tests/support/test_shaders.h"

/* ---- memory ------------------------------------------------------------------------------------------- */

static void memory_in_use_is_exact(void **state)
{
    (void)state;
    struct gpu_buffer *buffers[50];
    uint64_t expected = gpu_memory_in_use(layer_gpu), sizes[50];
    assert_true(expected == 0);
    for (uint32_t i = 0; i < 50; i++) {
        const size_t size = 1 + (size_t)i * i * 1000;
        buffers[i] = layer_buffer("counted", size, (enum gpu_memory)(i % 3));
        assert_true((gpu_buffer_map(buffers[i]) != NULL) == (i % 3 != GPU_MEMORY_DEVICE));
        sizes[i] = gpu_memory_in_use(layer_gpu) - expected;
        assert_true(sizes[i] >= size && sizes[i] <= size + 65536 + size / 8);
        expected += sizes[i];
    }
    for (uint32_t i = 0; i < 50; i++) {
        gpu_buffer_destroy(&buffers[(i * 7) % 50]);
        expected -= sizes[(i * 7) % 50];
        assert_true(gpu_memory_in_use(layer_gpu) == expected);
    }
    assert_true(expected == 0);
}

static uint64_t resident_bytes(void)
{
    unsigned long pages = 0, resident = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    assert_non_null(file);
    assert_int_equal(fscanf(file, "%lu %lu", &pages, &resident), 2);
    fclose(file);
    return (uint64_t)resident * (uint64_t)sysconf(_SC_PAGESIZE);
}

static uint32_t folder_entries(const char *path)
{
    uint32_t count = 0;
    DIR *folder = opendir(path);
    assert_non_null(folder);
    while (readdir(folder)) {
        count++;
    }
    closedir(folder);
    return count;
}

static void devices_open_and_close_without_growth(void **state)
{
    (void)state;
    uint64_t bytes_before = 0;
    uint32_t files_before = 0;
    for (uint32_t i = 0; i < 550; i++) {
        if (i == 50) {
            bytes_before = resident_bytes();
            files_before = folder_entries("/proc/self/fd");
        }
        struct gpu *opened = layer_open(false);
        gpu_destroy(&opened);
        assert_null(opened);
    }
    const uint64_t bytes = resident_bytes();
    print_message("500 devices: %lld bytes, %d files more\n", (long long)(bytes - bytes_before),
                  (int)folder_entries("/proc/self/fd") - (int)files_before);
    assert_int_equal(folder_entries("/proc/self/fd"), files_before);
    assert_true(bytes < bytes_before + (4u << 20));
}

static void frames_do_not_grow(void **state)
{
    (void)state;
    enum { PIECE = 400000 };
    struct gpu_buffer *buffer = layer_buffer("list", PIECE, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *ramp = layer_pipeline("gpu_ramp.comp", 1, 4);
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = buffer}};
    uint8_t *bytes = calloc(1, PIECE);
    assert_non_null(bytes);
    uint64_t in_use = 0;
    for (uint32_t number = 0; number < 2000; number++) {
        struct gpu_frame *frame = layer_begin();
        /* Now and then more descriptor sets than one pool holds, and more bytes than one staging block. */
        const bool is_big = number % 16 < 2;
        for (uint32_t i = 0; i < (is_big ? 80u : 2u); i++) {
            gpu_record_dispatch(
                frame,
                &(struct gpu_dispatch){
                    .pipeline = ramp, .binds = binds, .bind_count = 1, .push = &number, .groups = {16}});
        }
        for (uint32_t i = 0; i < 5; i++) {
            gpu_record_upload(frame, buffer, 0, bytes, is_big ? PIECE : 400);
        }
        layer_submit(frame);
        if (number == 20) {
            in_use = gpu_memory_in_use(layer_gpu);
        } else if (number > 20) {
            assert_true(gpu_memory_in_use(layer_gpu) == in_use);
        }
    }
    free(bytes);
    gpu_pipeline_destroy(&ramp);
    gpu_buffer_destroy(&buffer);
}

/* ---- pipeline cache ----------------------------------------------------------------------------------- */

static size_t read_file(const char *path, uint8_t *bytes, size_t capacity)
{
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    const size_t size = fread(bytes, 1, capacity, file);
    fclose(file);
    return size;
}

static void write_file(const char *path, const uint8_t *bytes, size_t size)
{
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    fclose(file);
}

static void damaged_caches_are_replaced(void **state)
{
    (void)state;
    static uint8_t good[1 << 20], bad[1 << 20];
    char path[512];
    struct gpu_pipeline *ramp = layer_pipeline("gpu_ramp.comp", 1, 4);
    gpu_save_cache(layer_gpu);
    gpu_pipeline_destroy(&ramp);
    assert_true(layer_cache_file(path));
    const size_t size = read_file(path, good, sizeof good);
    assert_in_range(size, 25, sizeof good - 1);

    /* Another device opens it without a word, cut short at every length, and with any byte flipped. */
    for (size_t i = 0; i < 40; i++) {
        memcpy(bad, good, size);
        const size_t place = i * (size - 1) / 39;
        bad[place] ^= 0x40;
        write_file(path, bad, i % 2 ? size : place);
        struct gpu *opened = layer_open(false);
        assert_non_null(strstr(layer_log, "ray query")); /* the last line of opening */
        gpu_destroy(&opened);
        assert_int_equal(read_file(path, bad, sizeof bad), size);
        assert_memory_equal(bad, good, size);
    }
    assert_int_equal(folder_entries(layer_cache), 3);

    /* A folder that cannot be made is a warning. */
    struct error error;
    layer_log_count = 0;
    const struct gpu_params params = {.cache_dir = "/dev/null/cache", .log = layer_keep_log};
    struct gpu *opened = gpu_create(&params, &error);
    layer_check(opened != NULL, &error);
    assert_int_equal(layer_log_count, 1);
    gpu_destroy(&opened);
    layer_log_count = 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {LAYER_TEST(memory_in_use_is_exact), LAYER_TEST(frames_do_not_grow),
                                       LAYER_TEST(damaged_caches_are_replaced),
                                       cmocka_unit_test(devices_open_and_close_without_growth)};
    return layer_run(tests, sizeof tests / sizeof *tests);
}
