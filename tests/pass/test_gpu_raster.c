/* test_gpu_raster.c: the Vulkan layer: rectangles drawn, single and multisampled, against their closed form.
 */
#include <string.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/layer.h"
#include "tests/support/test_shaders.h"

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
    struct gpu_raster *raster = gpu_raster_create(layer_gpu, &params, &error);
    layer_check(raster != NULL, &error);
    struct gpu_buffer *list =
        gpu_buffer_create_filled(layer_gpu, "rectangles", rectangles, sizeof rectangles, false, &error);
    layer_check(list != NULL, &error);
    struct gpu_buffer *runs = layer_buffer("runs", 4, GPU_MEMORY_DEVICE);
    struct gpu_buffer *runs_read = layer_buffer("runs read", 4, GPU_MEMORY_READBACK);
    struct gpu_buffer *read = layer_buffer("picture", WIDTH * HEIGHT * (half ? 8 : 16), GPU_MEMORY_READBACK);
    struct gpu_buffer *arguments = layer_buffer("arguments", 32, GPU_MEMORY_DEVICE);
    struct gpu_pipeline *set_arguments = layer_pipeline("gpu_arguments.comp", 3, 0);
    struct gpu_frame *frame = NULL;
    for (uint32_t repeat = 0; repeat < 3; repeat++) {
        frame = layer_begin();
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
        layer_submit(frame);
    }
    layer_check(gpu_frame_wait(frame, &error), &error);

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
    const uint32_t samples = gpu_info(layer_gpu)->max_samples;
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
    struct gpu_raster *raster = gpu_raster_create(layer_gpu, &params, &error);
    layer_check(raster != NULL, &error);
    struct gpu_buffer *list = gpu_buffer_create_filled(layer_gpu, "rectangle", rectangle, 32, false, &error);
    layer_check(list != NULL, &error);
    struct gpu_buffer *runs = gpu_buffer_create_filled(layer_gpu, "runs", NULL, 0, false, &error);
    layer_check(runs != NULL, &error);
    struct gpu_buffer *read = layer_buffer("picture", 8 * 4 * 16, GPU_MEMORY_READBACK);
    const struct gpu_bind binds[] = {{.binding = 2, .access = GPU_READ, .buffer = list},
                                     {.binding = 4, .access = GPU_READ_WRITE, .buffer = runs}};
    struct gpu_frame *frame = layer_begin();
    gpu_record_draw(frame, &(struct gpu_draw){.raster = raster,
                                              .binds = binds,
                                              .bind_count = 2,
                                              .push = size,
                                              .vertex_count = 6,
                                              .instance_count = 1});
    gpu_record_raster_read(frame, raster, read);
    layer_finish(frame);
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

int main(void)
{
    const struct CMUnitTest tests[] = {LAYER_TEST(rectangles_add_up),
                                       LAYER_TEST(rectangles_add_up_multisampled),
                                       LAYER_TEST(multisampling_measures_coverage)};
    return layer_run(tests, sizeof tests / sizeof *tests);
}
