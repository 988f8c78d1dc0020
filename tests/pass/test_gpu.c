/* test_gpu.c: the Vulkan layer on a real device, under the validation layer.
 *
 * Every test ends with no validation message, no object and no byte of device memory left over.
 */
#include <dirent.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/test_shaders.h"

static char cache_folder[] = "/tmp/caustic-gpu-test-XXXXXX";
static struct gpu *gpu;
static char last_log[2048];
static uint32_t log_count;

static void keep_log(void *user, enum gpu_log_level level, const char *text)
{
    (void)user;
    if (level != GPU_LOG_INFO) {
        print_message("gpu: %s\n", text);
        log_count++;
    }
    snprintf(last_log, sizeof last_log, "%s", text);
}

static struct gpu *open_gpu(bool validation)
{
    struct error error;
    const struct gpu_params params = {.cache_dir = cache_folder, .validation = validation, .log = keep_log};
    struct gpu *opened = gpu_create(&params, &error);
    if (!opened) {
        print_error("%s\n", error.message);
    }
    assert_non_null(opened);
    return opened;
}

static int set_up(void **state)
{
    (void)state;
    log_count = 0;
    gpu = open_gpu(true);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    const bool is_clean = gpu_validation_count(gpu) == 0 && log_count == 0;
    /* A test that failed keeps its objects; then only its own failure counts. */
    gpu_destroy(&gpu);
    return is_clean && log_count == 0 ? 0 : -1;
}

/* ---- shorthands --------------------------------------------------------------------------------------- */

static void check(bool done, const struct error *error)
{
    if (!done) {
        print_error("%s\n", error->message);
    }
    assert_true(done);
}

static struct gpu_buffer *new_buffer(const char *name, size_t size, enum gpu_memory memory)
{
    struct error error;
    const struct gpu_buffer_params params = {.name = name, .size = size, .memory = memory};
    struct gpu_buffer *buffer = gpu_buffer_create(gpu, &params, &error);
    check(buffer != NULL, &error);
    return buffer;
}

static struct gpu_pipeline *new_pipeline(const char *shader, uint32_t binding_mask, uint32_t push_bytes)
{
    struct error error;
    struct gpu_pipeline_params params = {
        .name = shader, .binding_mask = binding_mask, .push_bytes = push_bytes};
    params.spirv = test_shader_find(shader, &params.spirv_bytes);
    struct gpu_pipeline *pipeline = gpu_pipeline_create(gpu, &params, &error);
    check(pipeline != NULL, &error);
    return pipeline;
}

static struct gpu_frame *begin(void)
{
    struct error error;
    struct gpu_frame *frame = gpu_frame_begin(gpu, &error);
    check(frame != NULL, &error);
    return frame;
}

static void submit(struct gpu_frame *frame)
{
    struct error error;
    check(gpu_frame_submit(frame, &error), &error);
}

static void finish(struct gpu_frame *frame)
{
    struct error error;
    submit(frame);
    check(gpu_frame_wait(frame, &error), &error);
}

/* ---- compute ------------------------------------------------------------------------------------------ */

enum { COUNT = 100000, ROUNDS = 7, FRAMES = 5 };

/* Fill, write, read and write, indirect, copy, host read: every kind of dependency, with two frames in
 * flight. */
static void chained_dispatches_see_each_other(void **state)
{
    (void)state;
    struct gpu_buffer *source = new_buffer("source", COUNT * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *target = new_buffer("target", COUNT * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *arguments = new_buffer("arguments", 32, GPU_MEMORY_DEVICE);
    struct gpu_buffer *counts = new_buffer("counts", 8, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = new_buffer("read", COUNT * 4 + 8, GPU_MEMORY_READBACK);
    struct gpu_pipeline *ramp = new_pipeline("gpu_ramp.comp", 1, 4);
    struct gpu_pipeline *add = new_pipeline("gpu_add.comp", 1 << 3 | 1 << 5, 0);
    struct gpu_pipeline *size = new_pipeline("gpu_arguments.comp", 3, 0);
    struct gpu_pipeline *count = new_pipeline("gpu_count.comp", 1, 0);
    const uint32_t groups = (COUNT + 63) / 64;
    struct gpu_frame *frame = NULL;
    for (uint32_t number = 0; number < FRAMES; number++) {
        frame = begin();
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
            submit(frame);
        }
    }
    finish(frame);

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
    struct gpu_buffer *list = new_buffer("list", 7 * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = new_buffer("read", 7 * 4, GPU_MEMORY_READBACK);
    struct gpu_pipeline *ramp = new_pipeline("gpu_ramp.comp", 1, 4);
    const uint32_t start = 1;
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = read}};
    struct gpu_frame *frame = begin();
    gpu_record_dispatch(
        frame, &(struct gpu_dispatch){.pipeline = ramp, .binds = binds, .bind_count = 1, .push = &start});
    finish(frame);
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
    struct gpu_pipeline *plain = gpu_pipeline_create(gpu, &params, &error);
    check(plain != NULL, &error);
    params.constants = constants;
    params.constant_count = 3;
    struct gpu_pipeline *special = gpu_pipeline_create(gpu, &params, &error);
    check(special != NULL, &error);

    struct gpu_buffer *reads[2];
    struct gpu_frame *frame = begin();
    for (uint32_t i = 0; i < 2; i++) {
        reads[i] = new_buffer("read", 16, GPU_MEMORY_READBACK);
        const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = reads[i]}};
        gpu_record_dispatch(
            frame, &(struct gpu_dispatch){.pipeline = i ? special : plain, .binds = binds, .bind_count = 1});
    }
    finish(frame);
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
    struct gpu_buffer *filled = gpu_buffer_create_filled(gpu, "filled", words, WORDS * 4, false, &error);
    check(filled != NULL, &error);
    struct gpu_buffer *empty = gpu_buffer_create_filled(gpu, "empty", NULL, 0, false, &error);
    check(empty != NULL, &error);
    struct gpu_buffer *parts = new_buffer("parts", (PART + 1 + 200 * SMALL) * 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *read = new_buffer("read", WORDS * 4, GPU_MEMORY_READBACK);
    struct gpu_buffer *parts_read = new_buffer("parts read", gpu_buffer_size(parts), GPU_MEMORY_READBACK);
    struct gpu_buffer *empty_read = new_buffer("empty read", 16, GPU_MEMORY_READBACK);
    for (uint32_t round = 0; round < 4; round++) {
        struct gpu_frame *frame = begin();
        /* One piece beyond the staging block, and many that share blocks. */
        gpu_record_upload(frame, parts, 4, words + round, PART * 4);
        for (uint32_t i = 0; i < 200; i++) {
            gpu_record_upload(frame, parts, (PART + 1 + i * SMALL) * 4, words + i + round, SMALL * 4);
        }
        gpu_record_copy(frame, parts_read, 4, parts, 4, gpu_buffer_size(parts) - 4);
        gpu_record_copy(frame, read, 0, filled, 0, WORDS * 4);
        gpu_record_copy(frame, empty_read, 0, empty, 0, 16);
        finish(frame);
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
    struct gpu_buffer *buffer = new_buffer("filled", 21, GPU_MEMORY_READBACK);
    struct gpu_frame *frame = begin();
    gpu_record_fill(frame, buffer, 0, 21, 0x11111111);
    gpu_record_fill(frame, buffer, 4, 8, 0x22222222);
    gpu_record_fill(frame, buffer, 8, 0, 0x33333333);
    finish(frame);
    const uint8_t expected[21] = {0x11, 0x11, 0x11, 0x11, 0x22, 0x22, 0x22, 0x22, 0x22, 0x22, 0x22,
                                  0x22, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x11};
    assert_memory_equal(gpu_buffer_map(buffer), expected, 21);
    gpu_buffer_destroy(&buffer);
}

/* ---- timers ------------------------------------------------------------------------------------------- */

static void passes_are_timed(void **state)
{
    (void)state;
    struct gpu_buffer *buffer = new_buffer("spin", 64 * 1024 * 4, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *spin = new_pipeline("gpu_spin.comp", 1, 4);
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_READ_WRITE, .buffer = buffer}};
    const uint32_t rounds[] = {1, 2000};
    uint32_t count;
    uint64_t total;
    /* Twice: the first frame also compiles. 150 short passes: more than one query pool holds. */
    for (uint32_t repeat = 0; repeat < 2; repeat++) {
        struct gpu_frame *frame = begin();
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
        finish(frame);
        const struct gpu_timing *timings = gpu_frame_timings(frame, &count, &total);
        assert_int_equal(count, 3);
        assert_string_equal(timings[0].name, "short");
        assert_string_equal(timings[1].name, "long");
        assert_string_equal(timings[2].name, "nothing");
        if (gpu_info(gpu)->timestamp_period_ns > 0) {
            const uint64_t sum = timings[0].elapsed_ns + timings[1].elapsed_ns + timings[2].elapsed_ns;
            print_message("short %llu, long %llu, nothing %llu, total %llu ns\n",
                          (unsigned long long)timings[0].elapsed_ns,
                          (unsigned long long)timings[1].elapsed_ns,
                          (unsigned long long)timings[2].elapsed_ns, (unsigned long long)total);
            assert_true(timings[0].elapsed_ns > 0);
            /* 1,024 x 2,000 rounds against one. */
            assert_true(timings[1].elapsed_ns > 20 * (timings[0].elapsed_ns / 150));
            assert_true(timings[2].elapsed_ns < timings[1].elapsed_ns);
            assert_true(sum <= total + 1000);
        } else {
            assert_true(total == 0);
        }
    }
    gpu_pipeline_destroy(&spin);
    gpu_buffer_destroy(&buffer);
}

/* ---- raster ------------------------------------------------------------------------------------------- */

static double half_to_double(uint16_t half)
{
    const int exponent = half >> 10 & 31;
    const double mantissa = half & 1023;
    const double value = exponent ? ldexp(1024 + mantissa, exponent - 25) : ldexp(mantissa, -24);
    return half & 0x8000 ? -value : value;
}

/* Rectangles in pixels and their values; the sum over the picture has a closed form, sample by sample. */
static void draw_rectangles(uint32_t samples, bool per_sample, bool half, bool indirect)
{
    enum { WIDTH = 37, HEIGHT = 23, RECTANGLES = 3 };
    struct error error;
    /* The first two overlap; the third ends a quarter pixel past a pixel's edge, off every sample's place. */
    const float rectangles[RECTANGLES][8] = {
        {2, 3, 12, 9, 1, 2, 3, 0.5f},
        {8, 5, 20, 20, 10, 20, 30, 40},
        {30, 0, 33, 23, 0.25f, 0, 0, 0},
    };
    const float gain = 0.5f;
    const float size[2] = {WIDTH, HEIGHT};
    struct gpu_constant constant = {.id = 0};
    memcpy(&constant.value, &gain, 4);
    struct gpu_raster_params params = {
        .name = "rectangles",
        .constants = &constant,
        .constant_count = 1,
        .binding_mask = 1 << 2 | 1 << 4,
        .push_bytes = 8,
        .width = WIDTH,
        .height = HEIGHT,
        .samples = samples,
        .per_sample = per_sample,
        .half = half,
    };
    params.vertex_spirv = test_shader_find("gpu_rectangles.vert", &params.vertex_bytes);
    params.fragment_spirv = test_shader_find("gpu_rectangles.frag", &params.fragment_bytes);
    struct gpu_raster *raster = gpu_raster_create(gpu, &params, &error);
    check(raster != NULL, &error);
    struct gpu_buffer *list =
        gpu_buffer_create_filled(gpu, "rectangles", rectangles, sizeof rectangles, false, &error);
    check(list != NULL, &error);
    struct gpu_buffer *runs = new_buffer("runs", 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *runs_read = new_buffer("runs read", 4, GPU_MEMORY_READBACK);
    struct gpu_buffer *read = new_buffer("picture", WIDTH * HEIGHT * (half ? 8 : 16), GPU_MEMORY_READBACK);
    struct gpu_buffer *arguments = new_buffer("arguments", 32, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *set_arguments = new_pipeline("gpu_arguments.comp", 3, 0);
    struct gpu_frame *frame = NULL;
    for (uint32_t repeat = 0; repeat < 3; repeat++) {
        frame = begin();
        const struct gpu_bind binds[] = {{.binding = 2, .access = GPU_READ, .buffer = list},
                                         {.binding = 4, .access = GPU_READ_WRITE, .buffer = runs}};
        struct gpu_draw draw = {.raster = raster,
                                .binds = binds,
                                .bind_count = 2,
                                .push = size,
                                .vertex_count = 6,
                                .instance_count = RECTANGLES};
        gpu_pass_begin(frame, "draw");
        gpu_record_fill(frame, runs, 0, 4, indirect ? RECTANGLES : 0);
        if (indirect) {
            /* The counter holds the number of rectangles for a moment: the draw's arguments come from it. */
            const struct gpu_bind argument_binds[] = {
                {.binding = 0, .access = GPU_READ, .buffer = runs},
                {.binding = 1, .access = GPU_WRITE, .buffer = arguments}};
            gpu_record_dispatch(
                frame,
                &(struct gpu_dispatch){.pipeline = set_arguments, .binds = argument_binds, .bind_count = 2});
            gpu_record_fill(frame, runs, 0, 4, 0);
            draw.indirect = arguments;
            draw.indirect_offset = 16;
        }
        gpu_record_draw(frame, &draw);
        gpu_record_raster_read(frame, raster, read);
        gpu_record_copy(frame, runs_read, 0, runs, 0, 4);
        gpu_pass_end(frame);
        submit(frame);
    }
    check(gpu_frame_wait(frame, &error), &error);

    uint32_t covered = 0;
    for (uint32_t y = 0; y < HEIGHT; y++) {
        for (uint32_t x = 0; x < WIDTH; x++) {
            for (uint32_t channel = 0; channel < 4; channel++) {
                double expected = 0;
                for (uint32_t i = 0; i < RECTANGLES; i++) {
                    const float *r = rectangles[i];
                    const float center_x = (float)x + 0.5f, center_y = (float)y + 0.5f;
                    if (center_x > r[0] && center_x < r[2] && center_y > r[1] && center_y < r[3]) {
                        expected += (double)(r[4 + channel] * gain);
                        covered += channel == 0 ? 1 : 0;
                    }
                }
                const size_t i = ((size_t)y * WIDTH + x) * 4 + channel;
                const double value = half ? half_to_double(((const uint16_t *)gpu_buffer_map(read))[i])
                                          : (double)((const float *)gpu_buffer_map(read))[i];
                assert_close(value, expected, 0);
            }
        }
    }
    assert_int_equal(covered, 10 * 6 + 12 * 15 + 3 * 23);
    const uint32_t shaded = *(const uint32_t *)gpu_buffer_map(runs_read);
    /* Helper invocations do not count; drivers may shade once or several times per pixel without sample
     * shading. */
    if (samples <= 1) {
        assert_int_equal(shaded, covered);
    } else if (per_sample) {
        assert_int_equal(shaded, covered * samples);
    } else {
        assert_in_range(shaded, covered, covered * samples);
    }
    gpu_pipeline_destroy(&set_arguments);
    gpu_raster_destroy(&raster);
    gpu_buffer_destroy(&list);
    gpu_buffer_destroy(&runs);
    gpu_buffer_destroy(&runs_read);
    gpu_buffer_destroy(&read);
    gpu_buffer_destroy(&arguments);
}

static void rectangles_add_up(void **state)
{
    (void)state;
    draw_rectangles(0, false, false, false);
    draw_rectangles(1, false, true, true);
}

static void rectangles_add_up_multisampled(void **state)
{
    (void)state;
    const uint32_t samples = gpu_info(gpu)->max_samples;
    print_message("%u samples\n", samples);
    assert_true(samples >= 4);
    draw_rectangles(samples, false, false, true);
    draw_rectangles(samples, true, false, false);
    draw_rectangles(4, true, true, false);
}

/* Half a pixel covered is half the value: the resolve averages over samples. */
static void multisampling_measures_coverage(void **state)
{
    (void)state;
    struct error error;
    const float rectangle[8] = {0, 0, 3.5f, 4, 8, 8, 8, 8}, size[2] = {8, 4};
    struct gpu_raster_params params = {.name = "coverage",
                                       .binding_mask = 1 << 2 | 1 << 4,
                                       .push_bytes = 8,
                                       .width = 8,
                                       .height = 4,
                                       .samples = 4};
    params.vertex_spirv = test_shader_find("gpu_rectangles.vert", &params.vertex_bytes);
    params.fragment_spirv = test_shader_find("gpu_rectangles.frag", &params.fragment_bytes);
    struct gpu_raster *raster = gpu_raster_create(gpu, &params, &error);
    check(raster != NULL, &error);
    struct gpu_buffer *list = gpu_buffer_create_filled(gpu, "rectangle", rectangle, 32, false, &error);
    check(list != NULL, &error);
    struct gpu_buffer *runs = gpu_buffer_create_filled(gpu, "runs", NULL, 0, false, &error);
    check(runs != NULL, &error);
    struct gpu_buffer *read = new_buffer("picture", 8 * 4 * 16, GPU_MEMORY_READBACK);
    const struct gpu_bind binds[] = {{.binding = 2, .access = GPU_READ, .buffer = list},
                                     {.binding = 4, .access = GPU_READ_WRITE, .buffer = runs}};
    struct gpu_frame *frame = begin();
    gpu_record_draw(frame, &(struct gpu_draw){.raster = raster,
                                              .binds = binds,
                                              .bind_count = 2,
                                              .push = size,
                                              .vertex_count = 6,
                                              .instance_count = 1});
    gpu_record_raster_read(frame, raster, read);
    finish(frame);
    const float *picture = gpu_buffer_map(read);
    for (uint32_t i = 0; i < 32; i++) {
        /* The standard places of four samples put two on either side of a pixel's middle. */
        assert_close((double)picture[i * 4], i % 8 < 3 ? 8 : i % 8 == 3 ? 4 : 0, 0);
    }
    gpu_raster_destroy(&raster);
    gpu_buffer_destroy(&list);
    gpu_buffer_destroy(&runs);
    gpu_buffer_destroy(&read);
}

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
    expect_create_error(&(struct gpu_params){.device = "no such device", .cache_dir = cache_folder},
                        STATUS_NOT_FOUND, "no such device");
    expect_create_error(&(struct gpu_params){.device = "no such device", .cache_dir = cache_folder},
                        STATUS_NOT_FOUND, infos[0].name);
    expect_create_error(&(struct gpu_params){.device = "", .cache_dir = cache_folder}, STATUS_NOT_FOUND,
                        infos[0].name);
    char index[16];
    snprintf(index, sizeof index, "%u", count);
    expect_create_error(&(struct gpu_params){.device = index, .cache_dir = cache_folder}, STATUS_NOT_FOUND,
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
            gpu_create(&(struct gpu_params){.device = wishes[i], .cache_dir = cache_folder}, &error);
        check(chosen != NULL, &error);
        if (i == 0) {
            assert_string_equal(gpu_info(chosen)->name, infos[0].name);
        }
        gpu_destroy(&chosen);
    }
    const struct gpu_info *info = gpu_info(gpu);
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
    struct gpu *none = gpu_create(&(struct gpu_params){.cache_dir = cache_folder}, &error);
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
    const struct gpu_info *info = gpu_info(gpu);
    const uint64_t before = gpu_memory_in_use(gpu);
    assert_null(gpu_buffer_create(gpu, &(struct gpu_buffer_params){.name = "nothing"}, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, "nothing"));
    assert_null(gpu_buffer_create(
        gpu, &(struct gpu_buffer_params){.name = "giant", .size = (size_t)info->max_storage_bytes + 1},
        &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "giant"));
    assert_null(
        gpu_buffer_create(gpu, &(struct gpu_buffer_params){.name = "giant", .size = SIZE_MAX}, &error));
    assert_int_equal(error.status, STATUS_LIMIT);

    struct gpu_pipeline_params params = {.name = "bad pipeline", .binding_mask = 1, .push_bytes = 4};
    params.spirv = test_shader_find("gpu_ramp.comp", &params.spirv_bytes);
    struct gpu_pipeline_params bad = params;
    bad.push_bytes = 132;
    assert_null(gpu_pipeline_create(gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    bad = params;
    bad.spirv_bytes = 12;
    assert_null(gpu_pipeline_create(gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, "bad pipeline"));
    const uint32_t words[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    bad.spirv = words;
    bad.spirv_bytes = sizeof words;
    assert_null(gpu_pipeline_create(gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    bad = params;
    bad.accel_mask = 2;
    assert_null(gpu_pipeline_create(gpu, &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);

    struct gpu_raster_params raster = {.name = "bad raster", .width = 16, .height = 16, .samples = 3};
    assert_null(gpu_raster_create(gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    raster.samples = 1;
    raster.width = 0;
    assert_null(gpu_raster_create(gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    raster.width = info->max_image_size + 1;
    assert_null(gpu_raster_create(gpu, &raster, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    raster.width = 16;
    assert_null(gpu_raster_create(gpu, &raster, &error)); /* no shaders */
    assert_int_equal(error.status, STATUS_INVALID);
    assert_true(gpu_memory_in_use(gpu) == before);
}

/* What is wrong in a frame is reported by its submission, and the next frame works. */
static void bad_commands_are_reported_at_submission(void **state)
{
    (void)state;
    struct error error;
    struct gpu_buffer *a = new_buffer("first", 64, GPU_MEMORY_DEVICE);
    struct gpu_buffer *b = new_buffer("second", 64, GPU_MEMORY_READBACK);
    struct gpu_buffer *doomed = new_buffer("doomed", 64, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *ramp = new_pipeline("gpu_ramp.comp", 1, 4);
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
        struct gpu_frame *frame = begin();
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
    struct gpu_frame *forgotten = begin();
    gpu_record_dispatch(forgotten, &(struct gpu_dispatch){
                                       .pipeline = ramp, .binds = &right, .bind_count = 1, .push = &start});
    struct gpu_frame *frame = begin();
    gpu_record_dispatch(
        frame, &(struct gpu_dispatch){.pipeline = ramp, .binds = &right, .bind_count = 1, .push = &start});
    finish(frame);
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
    if (gpu_info(gpu)->has_ray_query) {
        print_message("the device has ray queries\n");
        return;
    }
    struct gpu_pipeline_params params = {.name = "tracer", .binding_mask = 7};
    params.spirv = test_shader_find("gpu_trace.comp", &params.spirv_bytes);
    assert_null(gpu_pipeline_create(gpu, &params, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_non_null(strstr(error.message, "ray queries"));
    params.accel_mask = 1;
    assert_null(gpu_pipeline_create(gpu, &params, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_null(gpu_accel_create_top(gpu, "top", 1, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    assert_null(gpu_accel_create_bottom(gpu, "bottom", &(struct gpu_triangles){0}, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
}

/* ---- memory ------------------------------------------------------------------------------------------- */

static void memory_in_use_is_exact(void **state)
{
    (void)state;
    struct gpu_buffer *buffers[50];
    uint64_t expected = gpu_memory_in_use(gpu), sizes[50];
    assert_true(expected == 0);
    for (uint32_t i = 0; i < 50; i++) {
        const size_t size = 1 + (size_t)i * i * 1000;
        buffers[i] = new_buffer("counted", size, (enum gpu_memory)(i % 3));
        assert_true((gpu_buffer_map(buffers[i]) != NULL) == (i % 3 != GPU_MEMORY_DEVICE));
        sizes[i] = gpu_memory_in_use(gpu) - expected;
        assert_true(sizes[i] >= size && sizes[i] <= size + 65536 + size / 8);
        expected += sizes[i];
    }
    for (uint32_t i = 0; i < 50; i++) {
        gpu_buffer_destroy(&buffers[(i * 7) % 50]);
        expected -= sizes[(i * 7) % 50];
        assert_true(gpu_memory_in_use(gpu) == expected);
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
        struct gpu *opened = open_gpu(false);
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
    struct gpu_buffer *buffer = new_buffer("list", PIECE, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *ramp = new_pipeline("gpu_ramp.comp", 1, 4);
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = buffer}};
    uint8_t *bytes = calloc(1, PIECE);
    assert_non_null(bytes);
    uint64_t in_use = 0;
    for (uint32_t number = 0; number < 2000; number++) {
        struct gpu_frame *frame = begin();
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
        submit(frame);
        if (number == 20) {
            in_use = gpu_memory_in_use(gpu);
        } else if (number > 20) {
            assert_true(gpu_memory_in_use(gpu) == in_use);
        }
    }
    free(bytes);
    gpu_pipeline_destroy(&ramp);
    gpu_buffer_destroy(&buffer);
}

/* ---- pipeline cache ----------------------------------------------------------------------------------- */

static bool find_cache_file(char path[512])
{
    struct dirent *entry;
    DIR *folder = opendir(cache_folder);
    bool found = false;
    while (folder && (entry = readdir(folder))) {
        if (strncmp(entry->d_name, "pipelines-", 10) == 0) {
            assert_false(found);
            snprintf(path, 512, "%s/%s", cache_folder, entry->d_name);
            found = true;
        }
    }
    closedir(folder);
    return found;
}

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
    struct gpu_pipeline *ramp = new_pipeline("gpu_ramp.comp", 1, 4);
    gpu_save_cache(gpu);
    gpu_pipeline_destroy(&ramp);
    assert_true(find_cache_file(path));
    const size_t size = read_file(path, good, sizeof good);
    assert_in_range(size, 25, sizeof good - 1);

    /* Another device opens it without a word, cut short at every length, and with any byte flipped. */
    for (size_t i = 0; i < 40; i++) {
        memcpy(bad, good, size);
        const size_t place = i * (size - 1) / 39;
        bad[place] ^= 0x40;
        write_file(path, bad, i % 2 ? size : place);
        struct gpu *opened = open_gpu(false);
        assert_non_null(strstr(last_log, "ray query")); /* the last line of opening */
        gpu_destroy(&opened);
        assert_int_equal(read_file(path, bad, sizeof bad), size);
        assert_memory_equal(bad, good, size);
    }
    assert_int_equal(folder_entries(cache_folder), 3);

    /* A folder that cannot be made is a warning. */
    struct error error;
    log_count = 0;
    const struct gpu_params params = {.cache_dir = "/dev/null/cache", .log = keep_log};
    struct gpu *opened = gpu_create(&params, &error);
    check(opened != NULL, &error);
    assert_int_equal(log_count, 1);
    gpu_destroy(&opened);
    log_count = 0;
}

int main(void)
{
    if (!mkdtemp(cache_folder)) {
        return 1;
    }
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        TEST(chained_dispatches_see_each_other),
        TEST(shaders_see_the_size_that_was_asked_for),
        TEST(specialisation_constants_reach_the_shader),
        TEST(uploads_of_any_size_arrive),
        TEST(fills_keep_to_their_range),
        TEST(passes_are_timed),
        TEST(rectangles_add_up),
        TEST(rectangles_add_up_multisampled),
        TEST(multisampling_measures_coverage),
        TEST(devices_are_chosen_by_name_or_index),
        TEST(a_machine_without_devices_is_told_what_to_install),
        TEST(bad_objects_are_refused),
        TEST(bad_commands_are_reported_at_submission),
        TEST(ray_queries_are_refused_where_there_are_none),
        TEST(memory_in_use_is_exact),
        TEST(frames_do_not_grow),
        TEST(damaged_caches_are_replaced),
        cmocka_unit_test(devices_open_and_close_without_growth),
    };
    const int failures = cmocka_run_group_tests(tests, NULL, NULL);
    char path[512];
    if (find_cache_file(path)) {
        unlink(path);
    }
    rmdir(cache_folder);
    return failures;
}
