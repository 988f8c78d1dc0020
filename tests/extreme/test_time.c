/* Time and change: long runs, a camera that jumps, time that stands still or runs backward, a view that is
 * resized every frame. */
#include <dirent.h>
#include <malloc.h>
#include <string.h>

#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

static uint32_t open_descriptors(void)
{
    uint32_t count = 0;
    DIR *folder = opendir("/proc/self/fd");
    assert_non_null(folder);
    while (readdir(folder))
        count++;
    closedir(folder);
    return count;
}

/* Bytes that are allocated: what is resident also holds the allocator's own habits. */
static uint64_t memory_in_use(void)
{
    struct mallinfo2 info = mallinfo2();
    return info.uordblks + info.hblkhd;
}

/* A copy of the frame's caustics. */
static float *picture_of(const struct frame_result *result, size_t *count)
{
    const struct frame_channel *channel = &result->channels[0];
    *count = (size_t)channel->width * channel->height * 3;
    float *copy = malloc(*count * sizeof *copy);
    assert_non_null(copy);
    memcpy(copy, truth_channel(result, CHANNEL_CAUSTICS), *count * sizeof *copy);
    return copy;
}

static double difference(const struct frame_result *result, const float *wanted)
{
    const struct frame_channel *channel = &result->channels[0];
    struct measure_image a = {channel->values, channel->width, channel->height, 3},
                         b = {wanted, channel->width, channel->height, 3};
    assert_int_equal(measure_non_finite(&a), 0);
    return measure_relative_l1(&a, &b);
}

/* A glass ball that goes round in a circle, 4 s a turn, over a floor. */
static void open_moving_ball(struct truth *stage)
{
    struct scene_builder builder;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    uint32_t ball =
        shape_icosphere(&builder, "ball", scenery_glass(&builder, 1.5), vec3_make(0, 0.6, 0), 0.4, 4);
    struct scene_node node = scene_node_default("moving", 0);
    struct scene_channel channel = {.node = scene_builder_node(&builder, &node),
                                    .path = ANIMATION_TRANSLATION,
                                    .interpolation = ANIMATION_LINEAR,
                                    .key_count = 5};
    scene_builder_instance(&builder, channel.node, ball);
    channel.times = malloc(5 * sizeof *channel.times);
    channel.values = malloc(15 * sizeof *channel.values);
    assert_true(channel.times && channel.values);
    for (int i = 0; i < 5; i++) {
        static const float places[4][2] = {{0.5f, 0}, {0, 0.5f}, {-0.5f, 0}, {0, -0.5f}};
        channel.times[i] = (float)i;
        channel.values[3 * i] = places[i % 4][0];
        channel.values[3 * i + 1] = 0;
        channel.values[3 * i + 2] = places[i % 4][1];
    }
    scene_builder_channel(&builder, &channel);
    scenery_lamp(&builder, vec3_make(0.5, 3, 0.2), 20);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 2.5, 2.5), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 45);
    scenery_open(stage, &builder, &camera, 48, 36, "photons=2048 cells=32");
}

/* Nothing grows: 20,000 frames in a long run. */
static void a_long_run(void **state)
{
    (void)state;
    const uint32_t frames = getenv("CAUSTICD_LONG") ? 20000 : 300, settled = frames / 4;
    struct truth stage;
    struct error error;
    open_moving_ball(&stage);
    truth_set(&stage, "photons=256 cells=16");
    assert_true(view_set_size(stage.view, 24, 18, &error));
    uint64_t memory = 0;
    uint32_t descriptors = 0;
    double device = 0, most_photons = 0;
    for (uint32_t i = 0; i < frames; i++) {
        assert_true(view_set_time(stage.view, i / 24.0, &error));
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        assert_int_equal(result->frame, i);
        most_photons = fmax(most_photons, result->stats[STAT_photons_emitted]);
        if (i == settled) {
            memory = memory_in_use();
            descriptors = open_descriptors();
            device = result->stats[STAT_device_bytes];
        }
        if (i + 1 == frames) {
            print_message("%u frames: %.3f MB allocated, then %.3f MB; %u descriptors, then %u\n", frames,
                          1e-6 * (double)memory, 1e-6 * (double)memory_in_use(), descriptors,
                          open_descriptors());
            assert_close(result->stats[STAT_device_bytes], device, 0);
        }
    }
    assert_true(memory_in_use() < memory + 65536);
    assert_int_equal(open_descriptors(), descriptors);
    assert_in_bound(most_photons, 256);
    truth_close(&stage);
}

/* The camera jumps to and fro every frame. What a frame shows is no worse than the first frame of a new view
 * is, against the converged picture: jumping costs the adaption, not the light. */
static void a_camera_that_teleports(void **state)
{
    (void)state;
    static const struct view_camera cameras[2] = {
        {.eye = {-2, 2.6f, 2.7f}, .at = {-0.15f, 0.2f, 0.1f}, .up = {0, 1, 0}, .fov = 32},
        {.eye = {1.5f, 0.8f, -2.5f}, .at = {-0.3f, 0, 0.1f}, .up = {0, 1, 0}, .fov = 50},
    };
    struct truth stage;
    struct error error;
    stage_open(&stage, "sphere", 64, 36, "photons=8192 cells=32");
    float *converged[2];
    double first[2], flux[2];
    size_t count;
    for (int i = 0; i < 2; i++) {
        truth_set(&stage, "accumulate=6 aa=pixel density=uniform photons=32768");
        view_reset(stage.view);
        assert_true(view_set_camera(stage.view, &cameras[i], &error));
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        converged[i] = picture_of(result, &count);
        truth_set(&stage, "accumulate=1 aa=filter density=sqrt photons=8192");
        view_reset(stage.view);
        result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        first[i] = difference(result, converged[i]);
        flux[i] = result->stats[STAT_flux_splatted];
    }
    double worst[2] = {0};
    for (int frame = 0; frame < 12; frame++) {
        int i = frame % 2;
        assert_true(view_set_camera(stage.view, &cameras[i], &error));
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        worst[i] = fmax(worst[i], difference(result, converged[i]));
        assert_in_bound(result->stats[STAT_photons_emitted], 8192);
        assert_close(result->stats[STAT_flux_splatted], flux[i], 0.02 * flux[i]);
    }
    for (int i = 0; i < 2; i++) {
        print_message("camera %d: error of a first frame %.3f, at worst %.3f while the camera jumps\n", i,
                      first[i], worst[i]);
        assert_in_bound(worst[i], 1.2 * first[i]);
        free(converged[i]);
    }
    truth_close(&stage);
}

/* Steps of no time change nothing that stood still would not; steps back lead to where time was. */
static void time_stands_still_and_runs_backward(void **state)
{
    (void)state;
    struct truth stage;
    struct error error;
    size_t count;
    open_moving_ball(&stage);
    static const double times[] = {0.5, 3.5, -0.5, -8.5, 1e6 + 0.5, 0.5};
    static const double same_as[] = {0.5, 3.5, 3.5, 3.5, 0.5, 0.5};
    float *pictures[6];
    for (int i = 0; i < 6; i++) {
        view_reset(stage.view);
        assert_true(view_set_time(stage.view, times[i], &error));
        pictures[i] = picture_of(truth_render(&stage, 2, 1u << CHANNEL_CAUSTICS), &count);
        for (int k = 0; k < i; k++) {
            bool are_equal = memcmp(pictures[i], pictures[k], count * sizeof(float)) == 0;
            assert_true(are_equal == (same_as[i] == same_as[k]));
        }
    }
    /* still: 0.5 s again and again, told or not told */
    float *last[2];
    for (int told = 0; told < 2; told++) {
        view_reset(stage.view);
        for (int frame = 0; frame < 4; frame++) {
            if (frame == 0 || told)
                assert_true(view_set_time(stage.view, 0.5, &error));
            const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
            if (frame == 3)
                last[told] = picture_of(result, &count);
        }
    }
    assert_memory_equal(last[0], last[1], count * sizeof(float));
    /* backward through the loop's start: every frame is as near to the still picture as forward */
    double worst[2] = {0};
    for (int way = 0; way < 2; way++)
        for (int i = 0; i < 12; i++) {
            double time = (way ? -1 : 1) * 0.1 * i;
            truth_set(&stage, "density=uniform");
            assert_true(view_set_time(stage.view, time, &error));
            const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
            float *moving = picture_of(result, &count);
            view_reset(stage.view);
            worst[way] =
                fmax(worst[way], difference(truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS), moving));
            free(moving);
        }
    print_message("forward off by %.1e, backward by %.1e\n", worst[0], worst[1]);
    assert_in_bound(worst[1], 1.5 * worst[0] + 1e-6);
    assert_false(view_set_time(stage.view, (double)NAN, &error));
    for (int i = 0; i < 6; i++)
        free(pictures[i]);
    free(last[0]);
    free(last[1]);
    truth_close(&stage);
}

/* A new size every frame: the light stays, no memory is left behind. */
static void a_size_that_changes_every_frame(void **state)
{
    (void)state;
    struct truth stage;
    struct error error;
    stage_open(&stage, "sphere", 64, 36, "photons=8192 cells=32");
    double flux = truth_render(&stage, 2, 1u << CHANNEL_CAUSTICS)->stats[STAT_flux_splatted], device = 0;
    for (uint32_t i = 0; i < 36; i++) {
        uint32_t height = 1 + 36 * (1 + i % 12) / 4, width = i % 12 == 0 ? 1 : 16 * height / 9;
        assert_true(view_set_size(stage.view, width, height, &error));
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        assert_int_equal(result->channels[0].width, width);
        assert_int_equal(result->channels[0].height, height);
        struct measure_image image = {result->channels[0].values, width, height, 3};
        assert_int_equal(measure_non_finite(&image), 0);
        if (i % 12 > 2) /* below that a pixel is larger than the caustic's edge */
            assert_close(result->stats[STAT_flux_splatted], flux, 0.05 * flux);
        if (i % 12 == 11) {
            if (i > 12)
                assert_close(result->stats[STAT_device_bytes], device, 0);
            device = result->stats[STAT_device_bytes];
        }
    }
    truth_close(&stage);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_long_run),
        cmocka_unit_test(a_camera_that_teleports),
        cmocka_unit_test(time_stands_still_and_runs_backward),
        cmocka_unit_test(a_size_that_changes_every_frame),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
