/* test_gpu.c: the Vulkan layer: what shaders see, transfers, timers. */
#include <string.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/layer.h"
#include "tests/support/test_shaders.h"

/* ---- compute ------------------------------------------------------------------------------------------ */

enum { COUNT = 100000, ROUNDS = 7, FRAMES = 5 };

/* Fill, write, read and write, indirect, copy, host read: every kind of dependency, with two frames in
 * flight. */
static void chained_dispatches_see_each_other(void **state)
{
    (void)state;
    struct gpu_buffer *source = layer_buffer("source", COUNT * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *target = layer_buffer("target", COUNT * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *arguments = layer_buffer("arguments", 32, GPU_MEMORY_DEVICE);
    struct gpu_buffer *counts = layer_buffer("counts", 8, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = layer_buffer("read", COUNT * 4 + 8, GPU_MEMORY_READBACK);
    struct gpu_pipeline *ramp = layer_pipeline("gpu_ramp.comp", 1, 4);
    struct gpu_pipeline *add = layer_pipeline("gpu_add.comp", 1 << 3 | 1 << 5, 0);
    struct gpu_pipeline *size = layer_pipeline("gpu_arguments.comp", 3, 0);
    struct gpu_pipeline *count = layer_pipeline("gpu_count.comp", 1, 0);
    const uint32_t groups = (COUNT + 63) / 64;
    struct gpu_frame *frame = NULL;
    for (uint32_t number = 0; number < FRAMES; number++) {
        frame = layer_begin();
        gpu_pass_begin(frame, "fill");
        if (number == 0) {
            gpu_record_fill(frame, target, 0, gpu_buffer_size(target), 5);
        }
        gpu_record_fill(frame, counts, 0, 8, 0);
        gpu_pass_end(frame);
        gpu_pass_begin(frame, "compute");
        for (uint32_t round = 0; round < ROUNDS; round++) {
            const uint32_t start = 10 + round + number;
            const struct gpu_bind ramp_binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = source}};
            const struct gpu_bind add_binds[] = {
                {.binding = 5, .access = GPU_READ_WRITE, .buffer = target},
                {.binding = 3, .access = GPU_READ, .buffer = source},
                {.binding = 17, .access = GPU_READ, .buffer = counts}, /* not used by the pipeline */
            };
            gpu_record_dispatch(frame, &(struct gpu_dispatch){.pipeline = ramp,
                                                              .binds = ramp_binds,
                                                              .bind_count = 1,
                                                              .push = &start,
                                                              .groups = {groups}});
            gpu_record_dispatch(
                frame, &(struct gpu_dispatch){
                           .pipeline = add, .binds = add_binds, .bind_count = 3, .groups = {groups}});
        }
        const struct gpu_bind size_binds[] = {{.binding = 0, .access = GPU_READ, .buffer = source},
                                              {.binding = 1, .access = GPU_WRITE, .buffer = arguments}};
        const struct gpu_bind count_binds[] = {{.binding = 0, .access = GPU_READ_WRITE, .buffer = counts}};
        gpu_record_dispatch(frame,
                            &(struct gpu_dispatch){.pipeline = size, .binds = size_binds, .bind_count = 2});
        gpu_record_dispatch(frame, &(struct gpu_dispatch){.pipeline = count,
                                                          .binds = count_binds,
                                                          .bind_count = 1,
                                                          .indirect = arguments,
                                                          .indirect_offset = 4});
        gpu_pass_end(frame);
        gpu_pass_begin(frame, "copy");
        gpu_record_copy(frame, read, 0, target, 0, COUNT * 4);
        gpu_record_copy(frame, read, COUNT * 4, counts, 0, 8);
        gpu_pass_end(frame);
        if (number + 1 < FRAMES) {
            layer_submit(frame);
        }
    }
    layer_finish(frame);

    const uint32_t *values = gpu_buffer_map(read);
    for (uint32_t i = 0; i < COUNT; i++) {
        uint32_t expected = 5;
        for (uint32_t number = 0; number < FRAMES; number++) {
            for (uint32_t round = 0; round < ROUNDS; round++) {
                expected += 10 + round + number + (COUNT - 1 - i);
            }
        }
        assert_int_equal(values[i], expected);
    }
    const uint32_t indirect_groups = 10 + ROUNDS - 1 + FRAMES - 1;
    assert_int_equal(values[COUNT], indirect_groups);
    assert_int_equal(values[COUNT + 1], indirect_groups * 64);

    gpu_pipeline_destroy(&ramp);
    gpu_pipeline_destroy(&add);
    gpu_pipeline_destroy(&size);
    gpu_pipeline_destroy(&count);
    gpu_buffer_destroy(&source);
    gpu_buffer_destroy(&target);
    gpu_buffer_destroy(&arguments);
    gpu_buffer_destroy(&counts);
    gpu_buffer_destroy(&read);
    assert_null(read);
}

static void shaders_see_the_size_that_was_asked_for(void **state)
{
    (void)state;
    struct gpu_buffer *list = layer_buffer("list", 7 * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = layer_buffer("read", 7 * 4, GPU_MEMORY_READBACK);
    struct gpu_pipeline *ramp = layer_pipeline("gpu_ramp.comp", 1, 4);
    const uint32_t start = 1;
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = read}};
    struct gpu_frame *frame = layer_begin();
    gpu_record_dispatch(
        frame, &(struct gpu_dispatch){.pipeline = ramp, .binds = binds, .bind_count = 1, .push = &start});
    layer_finish(frame);
    const uint32_t *values = gpu_buffer_map(read);
    for (uint32_t i = 0; i < 7; i++) {
        assert_int_equal(values[i], 1 + i);
    }
    assert_int_equal(gpu_buffer_size(read), 28);
    gpu_pipeline_destroy(&ramp);
    gpu_buffer_destroy(&list);
    gpu_buffer_destroy(&read);
}

static void specialisation_constants_reach_the_shader(void **state)
{
    (void)state;
    struct error error;
    const float fraction = 1.25f;
    struct gpu_constant constants[] = {{.id = 4, .value = 1}, {.id = 0, .value = 123456789u}, {.id = 1}};
    memcpy(&constants[2].value, &fraction, 4);
    struct gpu_pipeline_params params = {.name = "constants", .binding_mask = 1};
    params.spirv = test_shader_find("gpu_constants.comp", &params.spirv_bytes);
    struct gpu_pipeline *plain = gpu_pipeline_create(layer_gpu, &params, &error);
    layer_check(plain != NULL, &error);
    params.constants = constants;
    params.constant_count = 3;
    struct gpu_pipeline *special = gpu_pipeline_create(layer_gpu, &params, &error);
    layer_check(special != NULL, &error);

    struct gpu_buffer *reads[2];
    struct gpu_frame *frame = layer_begin();
    for (uint32_t i = 0; i < 2; i++) {
        reads[i] = layer_buffer("read", 16, GPU_MEMORY_READBACK);
        const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = reads[i]}};
        gpu_record_dispatch(
            frame, &(struct gpu_dispatch){.pipeline = i ? special : plain, .binds = binds, .bind_count = 1});
    }
    layer_finish(frame);
    const uint32_t expected[2][4] = {{7, 0x3f000000, 0, (uint32_t)-3},
                                     {123456789u, 0x3fa00000, 1, (uint32_t)-3}};
    for (uint32_t i = 0; i < 2; i++) {
        assert_memory_equal(gpu_buffer_map(reads[i]), expected[i], 16);
        gpu_buffer_destroy(&reads[i]);
    }
    gpu_pipeline_destroy(&plain);
    gpu_pipeline_destroy(&special);
}

/* ---- transfers ---------------------------------------------------------------------------------------- */

static uint32_t pattern(size_t i)
{
    return (uint32_t)i * 2654435761u ^ (uint32_t)(i >> 13);
}

static void uploads_of_any_size_arrive(void **state)
{
    (void)state;
    enum { WORDS = (40 << 20) / 4 + 3, PART = (5 << 20) / 4 + 1, SMALL = 1000 };
    struct error error;
    uint32_t *words = malloc(WORDS * sizeof *words);
    assert_non_null(words);
    for (size_t i = 0; i < WORDS; i++) {
        words[i] = pattern(i);
    }
    /* In three chunks, then read back. */
    struct gpu_buffer *filled =
        gpu_buffer_create_filled(layer_gpu, "filled", words, WORDS * 4, false, &error);
    layer_check(filled != NULL, &error);
    struct gpu_buffer *empty = gpu_buffer_create_filled(layer_gpu, "empty", NULL, 0, false, &error);
    layer_check(empty != NULL, &error);
    struct gpu_buffer *parts = layer_buffer("parts", (PART + 1 + 200 * SMALL) * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = layer_buffer("read", WORDS * 4, GPU_MEMORY_READBACK);
    struct gpu_buffer *parts_read = layer_buffer("parts read", gpu_buffer_size(parts), GPU_MEMORY_READBACK);
    struct gpu_buffer *empty_read = layer_buffer("empty read", 16, GPU_MEMORY_READBACK);
    for (uint32_t round = 0; round < 4; round++) {
        struct gpu_frame *frame = layer_begin();
        /* One piece beyond the staging block, and many that share blocks. */
        gpu_record_upload(frame, parts, 4, words + round, PART * 4);
        for (uint32_t i = 0; i < 200; i++) {
            gpu_record_upload(frame, parts, (PART + 1 + i * SMALL) * 4, words + i + round, SMALL * 4);
        }
        gpu_record_copy(frame, parts_read, 4, parts, 4, gpu_buffer_size(parts) - 4);
        gpu_record_copy(frame, read, 0, filled, 0, WORDS * 4);
        gpu_record_copy(frame, empty_read, 0, empty, 0, 16);
        layer_finish(frame);
        assert_memory_equal(gpu_buffer_map(read), words, WORDS * 4);
        const uint32_t *back = gpu_buffer_map(parts_read);
        assert_memory_equal(back + 1, words + round, PART * 4);
        for (uint32_t i = 0; i < 200; i++) {
            assert_memory_equal(back + 1 + PART + i * SMALL, words + i + round, SMALL * 4);
        }
        const uint32_t zeros[4] = {0};
        assert_int_equal(gpu_buffer_size(empty), 16);
        assert_memory_equal(gpu_buffer_map(empty_read), zeros, 16);
    }
    free(words);
    gpu_buffer_destroy(&filled);
    gpu_buffer_destroy(&empty);
    gpu_buffer_destroy(&parts);
    gpu_buffer_destroy(&read);
    gpu_buffer_destroy(&parts_read);
    gpu_buffer_destroy(&empty_read);
}

static void fills_keep_to_their_range(void **state)
{
    (void)state;
    struct gpu_buffer *buffer = layer_buffer("filled", 21, GPU_MEMORY_READBACK);
    struct gpu_frame *frame = layer_begin();
    gpu_record_fill(frame, buffer, 0, 21, 0x11111111);
    gpu_record_fill(frame, buffer, 4, 8, 0x22222222);
    gpu_record_fill(frame, buffer, 8, 0, 0x33333333);
    layer_finish(frame);
    const uint8_t expected[21] = {0x11, 0x11, 0x11, 0x11, 0x22, 0x22, 0x22, 0x22, 0x22, 0x22, 0x22,
                                  0x22, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11};
    assert_memory_equal(gpu_buffer_map(buffer), expected, 21);
    gpu_buffer_destroy(&buffer);
}

/* ---- timers ------------------------------------------------------------------------------------------- */

static void passes_are_timed(void **state)
{
    (void)state;
    struct gpu_buffer *buffer = layer_buffer("spin", 64 * 1024 * 4, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *spin = layer_pipeline("gpu_spin.comp", 1, 4);
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_READ_WRITE, .buffer = buffer}};
    const uint32_t rounds[] = {1, 2000};
    uint32_t count;
    uint64_t total;
    /* Twice: the first frame also compiles. 150 short passes: more than one query pool holds. */
    for (uint32_t repeat = 0; repeat < 2; repeat++) {
        struct gpu_frame *frame = layer_begin();
        for (uint32_t i = 0; i < 150; i++) {
            gpu_pass_begin(frame, "short");
            gpu_record_dispatch(
                frame,
                &(struct gpu_dispatch){
                    .pipeline = spin, .binds = binds, .bind_count = 1, .push = &rounds[0], .groups = {1}});
            gpu_pass_end(frame);
            if (i == 50 || i == 100) {
                gpu_pass_begin(frame, i == 50 ? "long" : "nothing");
                if (i == 50) {
                    gpu_record_dispatch(frame, &(struct gpu_dispatch){.pipeline = spin,
                                                                      .binds = binds,
                                                                      .bind_count = 1,
                                                                      .push = &rounds[1],
                                                                      .groups = {1024}});
                }
                gpu_pass_end(frame);
            }
        }
        gpu_frame_timings(frame, &count, &total);
        assert_int_equal(count, 0);
        layer_finish(frame);
        const struct gpu_timing *timings = gpu_frame_timings(frame, &count, &total);
        assert_int_equal(count, 3);
        assert_string_equal(timings[0].name, "short");
        assert_string_equal(timings[1].name, "long");
        assert_string_equal(timings[2].name, "nothing");
        if (gpu_info(layer_gpu)->timestamp_period_ns > 0) {
            const uint64_t sum = timings[0].elapsed_ns + timings[1].elapsed_ns + timings[2].elapsed_ns;
            print_message("short %llu, long %llu, nothing %llu, total %llu ns\n",
                          (unsigned long long)timings[0].elapsed_ns,
                          (unsigned long long)timings[1].elapsed_ns,
                          (unsigned long long)timings[2].elapsed_ns, (unsigned long long)total);
            assert_true(timings[0].elapsed_ns > 0);
            /* 1,024 x 2,000 rounds against one; a wide device does the 1,024 beside each other, and starting
             * and ending a dispatch is most of a short one. */
            assert_true(timings[1].elapsed_ns > 2 * (timings[0].elapsed_ns / 150));
            assert_true(timings[2].elapsed_ns < timings[1].elapsed_ns);
            assert_true(sum <= total + 1000);
        } else {
            assert_true(total == 0);
        }
    }
    gpu_pipeline_destroy(&spin);
    gpu_buffer_destroy(&buffer);
}

int main(void)
{
    const struct CMUnitTest tests[] = {LAYER_TEST(chained_dispatches_see_each_other),
                                       LAYER_TEST(shaders_see_the_size_that_was_asked_for),
                                       LAYER_TEST(specialisation_constants_reach_the_shader),
                                       LAYER_TEST(uploads_of_any_size_arrive),
                                       LAYER_TEST(fills_keep_to_their_range),
                                       LAYER_TEST(passes_are_timed)};
    return layer_run(tests, sizeof tests / sizeof *tests);
}
