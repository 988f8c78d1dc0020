/* test_pass_temporal.c: the blend with the frames before against a loop in double precision, and what it does
 * to noise, to a picture that moves and to light that moves. */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/pass_device.h"
#include "tests/support/scenery.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

/* ---- the pass alone ------------------------------------------------------------------------------------ */

enum { WIDTH = 24, HEIGHT = 16, PIXELS = WIDTH * HEIGHT, FOCAL = 20 };

struct scenery {
    struct frame_gpu frame;
    struct target_gpu targets[PIXELS], old_targets[PIXELS];
    vec4 now[PIXELS], history[PIXELS], blended[PIXELS];
};

static uint64_t random_state;

static float between(double low, double high)
{
    return (float)(low + (high - low) * pass_random(&random_state));
}

static float float_of(uint32_t word)
{
    float value;
    memcpy(&value, &word, sizeof value);
    return value;
}

/* A wall at z = -5 whose normal is +z (octahedral 0, 0), with a block before it at z = -4, as a camera that
 * looks down -z from (x, y, 0) sees them. A pixel in eleven shows nothing that light may land on. */
static void fill_targets(struct target_gpu *targets, double eye_x, double eye_y)
{
    for (int i = 0; i < PIXELS; i++) {
        double dx = (i % WIDTH + 0.5 - 0.5 * WIDTH) / FOCAL, dy = -(i / WIDTH + 0.5 - 0.5 * HEIGHT) / FOCAL;
        double depth = fabs(eye_x + 4 * dx) < 0.6 && fabs(eye_y + 4 * dy) < 0.6 ? 4 : 5;
        targets[i].position_normal =
            (vec4){(float)(dx * depth), (float)(dy * depth), (float)-depth, float_of(i % 11 ? 0 : NONE)};
    }
}

static struct scenery *scenery_of(double move_x, double move_y)
{
    struct scenery *s = calloc(1, sizeof *s);
    assert_non_null(s);
    random_state = 7;
    s->frame.width = WIDTH;
    s->frame.height = HEIGHT;
    s->frame.eye = (vec4){(float)move_x, (float)move_y, 0, 0};
    s->frame.old_forward = s->frame.forward = (vec4){0, 0, -1, 1.0f / (FOCAL * FOCAL)};
    s->frame.old_right = (vec4){1, 0, 0, 0};
    s->frame.old_up = (vec4){0, 1, 0, 0};
    s->frame.old_scale = (vec4){FOCAL, -FOCAL, 0.5f * WIDTH, 0.5f * HEIGHT};
    fill_targets(s->targets, move_x, move_y);
    fill_targets(s->old_targets, 0, 0);
    for (int i = 0; i < PIXELS; i++) {
        /* uneven on the left, where a blur would show, and less and less so to the right */
        double half = 8 * pow(0.8, i % WIDTH);
        s->now[i] =
            (vec4){between(9 - half, 9 + half), between(9 - half, 9 + half), between(9 - half, 9 + half), 0};
        half *= 1.5;
        s->history[i] = (vec4){between(9 - half, 9 + half), between(9 - half, 9 + half),
                               between(9 - half, 9 + half), (float)(1 + i % 30)};
    }
    return s;
}

static void run(struct pass_device *device, struct scenery *s, float share)
{
    uint32_t push;
    memcpy(&push, &share, sizeof push);
    pass_device_run(
        device,
        &(struct pass_run){.shader = "temporal.comp",
                           .threads = PIXELS,
                           .has_push = true,
                           .push = push,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &s->frame, sizeof s->frame},
                                      {BINDING_PASS + 1, GPU_READ, s->targets, sizeof s->targets},
                                      {BINDING_PASS + 2, GPU_READ, s->now, sizeof s->now},
                                      {BINDING_PASS + 3, GPU_READ, s->history, sizeof s->history},
                                      {BINDING_PASS + 4, GPU_READ, s->old_targets, sizeof s->old_targets},
                                      {BINDING_PASS + 5, GPU_WRITE, s->blended, sizeof s->blended})});
}

static bool is_bare(int pixel)
{
    return pixel % 11 == 0;
}

/* What the pixel should hold; false where rounding decides on which side of a limit it lies. */
static bool model(const struct scenery *s, int pixel, double share, double value[4])
{
    static const double channel_weights[3] = {0.2126, 0.7152, 0.0722}; /* ITU-R BT.709 */
    double before[3] = {0}, weight = 0, frames = 1e9;
    bool is_between = false;
    const float *now = &s->now[pixel].x;
    if (!is_bare(pixel) && share > 0) {
        vec4 p = s->targets[pixel].position_normal;
        double depth = -(double)p.z;
        double x = 0.5 * WIDTH + FOCAL * ((double)p.x + (double)s->frame.eye.x) / depth;
        double y = 0.5 * HEIGHT - FOCAL * ((double)p.y + (double)s->frame.eye.y) / depth;
        double sub_x = x * 256 - floor(x * 256), sub_y = y * 256 - floor(y * 256);
        if (fabs(sub_x - 0.5) < 0.02 || fabs(sub_y - 0.5) < 0.02)
            return false;
        x = round(x * 256) / 256, y = round(y * 256) / 256;
        is_between = x - floor(x) != 0.5 || y - floor(y) != 0.5;
        for (int v = 0; v < HEIGHT; v++)
            for (int u = 0; u < WIDTH; u++) {
                double w = fmax(0, 1 - fabs(u + 0.5 - x)) * fmax(0, 1 - fabs(v + 0.5 - y));
                int other = v * WIDTH + u;
                /* another depth is another surface: a pixel is 0.25 m wide at most here */
                if (!(w > 0) || is_bare(other) ||
                    fabs((double)s->old_targets[other].position_normal.z - (double)p.z) > 0.5)
                    continue;
                weight += w;
                for (int k = 0; k < 3; k++)
                    before[k] += w * (double)(&s->history[other].x)[k];
                frames = fmin(frames, (double)s->history[other].w);
            }
        if (fabs(weight - 0.25) < 1e-6)
            return false;
    }
    bool has_history = weight >= 0.25;
    double sums[2] = {0}; /* luminance of the box's size, and of its ends */
    double past[3];
    double kept = has_history ? fmin(share, frames / (frames + 1)) : 0;
    value[3] = has_history ? frames + 1 : 1;
    for (int k = 0; k < 3; k++) {
        double least = (double)now[k], largest = least;
        for (int v = -1; v <= 1; v++)
            for (int u = -1; u <= 1; u++) {
                int column = pixel % WIDTH + u, row = pixel / WIDTH + v, other = row * WIDTH + column;
                if (column < 0 || row < 0 || column >= WIDTH || row >= HEIGHT || is_bare(other))
                    continue;
                least = fmin(least, (double)(&s->now[other].x)[k]);
                largest = fmax(largest, (double)(&s->now[other].x)[k]);
            }
        double size = largest - least, margin = is_between ? 0 : 0.5 * size;
        sums[0] += channel_weights[k] * size;
        sums[1] += channel_weights[k] * (largest + least);
        past[k] = has_history ? fmin(fmax(before[k] / weight, least - margin), largest + margin) : 0;
    }
    /* blurred by bilinear weights it counts for less, by how uneven the picture is */
    if (is_between)
        kept *= fmax(0, 1 - 1.5 * sums[0] / sums[1]);
    for (int k = 0; k < 3; k++)
        value[k] = (1 - kept) * (double)now[k] + kept * past[k];
    return true;
}

static void pixels_follow_the_model(void **state)
{
    struct pass_device *device = *state;
    static const double moves[][2] = {{0, 0}, {0.13, 0.07}, {-0.9, 0.4}, {0.3, -1.7}};
    for (size_t m = 0; m < sizeof moves / sizeof *moves; m++) {
        struct scenery *s = scenery_of(moves[m][0], moves[m][1]);
        run(device, s, 0.9f);
        int compared = 0, blended = 0;
        double worst = 0;
        for (int i = 0; i < PIXELS; i++) {
            double expected[4];
            if (!model(s, i, (double)0.9f, expected))
                continue;
            compared++;
            blended += expected[3] > 1;
            for (int k = 0; k < 4; k++)
                worst = fmax(worst, fabs((double)(&s->blended[i].x)[k] - expected[k]));
        }
        print_message("camera moved by %g, %g m: %d pixels, %d with a history, agree within %.1e\n",
                      moves[m][0], moves[m][1], compared, blended, worst);
        assert_true(compared > PIXELS / 2 && blended > PIXELS / 8 && blended < PIXELS);
        assert_in_bound(worst, 1e-4);
        free(s);
    }
}

/* Without a history, and where the history says the same, no bit changes. */
static void nothing_changes_without_a_change(void **state)
{
    struct pass_device *device = *state;
    struct scenery *s = scenery_of(0, 0);
    run(device, s, 0);
    for (int i = 0; i < PIXELS; i++)
        assert_memory_equal(&s->blended[i], &s->now[i], 3 * sizeof(float));
    for (int i = 0; i < PIXELS; i++)
        s->history[i] = (vec4){s->now[i].x, s->now[i].y, s->now[i].z, 5};
    run(device, s, 0.98f);
    for (int i = 0; i < PIXELS; i++)
        assert_memory_equal(&s->blended[i], &s->now[i], 3 * sizeof(float));
    free(s);
}

/* ---- whole frames -------------------------------------------------------------------------------------- */

enum { COLUMNS = 96, ROWS = 54, VALUES = 3 * COLUMNS * ROWS };
#define CAUSTICS (1u << CHANNEL_CAUSTICS)
#define NOISY    "photons=4096 cells=32 jitter=on"

static float *picture(struct truth *stage, uint32_t frames)
{
    float *copy = malloc(VALUES * sizeof *copy);
    assert_non_null(copy);
    memcpy(copy, truth_channel(truth_render(stage, frames, CAUSTICS), CHANNEL_CAUSTICS),
           VALUES * sizeof *copy);
    return copy;
}

/* Root mean square of the difference over that of the truth. */
static double error_of(const float *values, const float *truth)
{
    double difference = 0, sum = 0;
    for (int i = 0; i < VALUES; i++) {
        difference += pow((double)values[i] - (double)truth[i], 2);
        sum += pow((double)truth[i], 2);
    }
    return sqrt(difference / sum);
}

/* Mean over the pixels with a ten-thousandth of the brightest's light or more, of |difference| over the
 * truth: the even part of the caustic counts as much as the spot. */
static double even_error_of(const float *values, const float *truth)
{
    double largest = 0, sum = 0;
    int count = 0;
    for (int i = 0; i < VALUES; i++)
        largest = fmax(largest, (double)truth[i]);
    for (int i = 0; i < VALUES; i++)
        if ((double)truth[i] >= 1e-4 * largest) {
            sum += fabs((double)values[i] - (double)truth[i]) / (double)truth[i];
            count++;
        }
    return sum / count;
}

static double sum_of(const float *values)
{
    double sum = 0;
    for (int i = 0; i < VALUES; i++)
        sum += (double)values[i];
    return sum;
}

static void set_camera(struct truth *stage, double pan)
{
    struct error error = {0};
    const struct view_camera camera = {.eye = {-2 + (float)pan, 2.6f, 2.7f},
                                       .at = {-0.15f + (float)pan, 0.2f, 0.1f},
                                       .up = {0, 1, 0},
                                       .fov = 32};
    assert_true(view_set_camera(stage->view, &camera, &error));
}

/* The mean of many jittered frames at one place of the camera. */
static float *mean_picture(double pan)
{
    struct truth stage;
    stage_open(&stage, "sphere", COLUMNS, ROWS, NOISY " seed=77");
    set_camera(&stage, pan);
    truth_render(&stage, 6, CAUSTICS);
    float *mean = calloc(VALUES, sizeof *mean);
    assert_non_null(mean);
    enum { FRAMES = 48 };
    for (int f = 0; f < FRAMES; f++) {
        const float *values = truth_channel(truth_render(&stage, 1, CAUSTICS), CHANNEL_CAUSTICS);
        for (int i = 0; i < VALUES; i++)
            mean[i] += values[i] / FRAMES;
    }
    truth_close(&stage);
    return mean;
}

static void jitter_becomes_quiet(void **state)
{
    (void)state;
    float *mean = mean_picture(0);
    struct truth plain, blended;
    stage_open(&plain, "sphere", COLUMNS, ROWS, NOISY);
    stage_open(&blended, "sphere", COLUMNS, ROWS, NOISY " temporal=0.9");
    set_camera(&plain, 0);
    set_camera(&blended, 0);
    static const uint32_t steps[] = {1, 3, 4, 8, 16};
    double first = 0, without = 0, with = 0;
    uint32_t frame = 0;
    for (size_t i = 0; i < sizeof steps / sizeof *steps; i++) {
        float *a = picture(&plain, steps[i]), *b = picture(&blended, steps[i]);
        frame += steps[i];
        without = error_of(a, mean), with = error_of(b, mean);
        print_message("frame %2u: error %.4f without, %.4f with; light %.4f\n", frame, without, with,
                      sum_of(b) / sum_of(mean));
        /* the first frame has no history: the very same bits */
        if (i == 0) {
            assert_memory_equal(a, b, VALUES * sizeof *a);
            first = with;
        }
        assert_close(sum_of(b) / sum_of(mean), 1, 0.01);
        free(a);
        free(b);
    }
    assert_in_bound(with, 0.6 * without);
    assert_in_bound(with, 0.6 * first);
    truth_close(&plain);
    truth_close(&blended);
    free(mean);
}

static void a_moving_camera_keeps_its_history(void **state)
{
    (void)state;
    enum { FRAMES = 14 };
    const double step = 0.011;
    float *mean = mean_picture(step * (FRAMES - 1));
    double error[2], even_error[2];
    for (int way = 0; way < 2; way++) {
        struct truth stage;
        stage_open(&stage, "sphere", COLUMNS, ROWS, way ? NOISY " temporal=0.9" : NOISY);
        float *last = NULL;
        for (int f = 0; f < FRAMES; f++) {
            free(last);
            set_camera(&stage, step * f);
            last = picture(&stage, 1);
        }
        error[way] = error_of(last, mean);
        even_error[way] = even_error_of(last, mean);
        free(last);
        truth_close(&stage);
    }
    print_message("camera in motion: error %.4f without, %.4f with; mean relative %.4f and %.4f\n", error[0],
                  error[1], even_error[0], even_error[1]);
    assert_in_bound(error[1], 1.01 * error[0]);
    assert_in_bound(even_error[1], 0.9 * even_error[0]);
    free(mean);
}

static void a_still_picture_stays_the_same(void **state)
{
    (void)state;
    struct truth plain, blended;
    stage_open(&plain, "sphere", COLUMNS, ROWS, "photons=4096 cells=32");
    stage_open(&blended, "sphere", COLUMNS, ROWS, "photons=4096 cells=32 temporal=0.9");
    float *a = picture(&plain, 40), *b = picture(&blended, 40);
    double error = error_of(b, a);
    print_message("a still picture without jitter: %.2e from that without\n", error);
    assert_in_bound(error, 0.01);
    free(a);
    free(b);
    truth_close(&plain);
    truth_close(&blended);
}

static void moved_light_leaves_no_ghost(void **state)
{
    (void)state;
    struct error error = {0};
    struct truth plain, blended;
    stage_open(&plain, "sphere", COLUMNS, ROWS, "photons=4096 cells=32");
    stage_open(&blended, "sphere", COLUMNS, ROWS, "photons=4096 cells=32 temporal=0.9");
    float *before = picture(&blended, 12);
    free(picture(&plain, 12));
    const struct view_light moved = {.overrides = LIGHT_OVERRIDE_POSITION, .position = {1.2f, 2.6f, -0.4f}};
    assert_true(view_set_light(plain.view, 0, &moved, &error));
    assert_true(view_set_light(blended.view, 0, &moved, &error));
    for (int f = 1; f <= 4; f++) {
        float *a = picture(&plain, 1), *b = picture(&blended, 1);
        double ghost = 0, was = 0;
        for (int i = 0; i < VALUES; i++)
            if (a[i] < 0.25f * before[i]) {
                ghost += fabs((double)b[i] - (double)a[i]);
                was += (double)before[i] - (double)a[i];
            }
        print_message(
            "frame %d after the step: %.4f from the picture without; ghost %.2e of what was there\n", f,
            error_of(b, a), ghost / was);
        assert_true(was > 0.1 * sum_of(before));
        if (f == 1)
            assert_memory_equal(a, b, VALUES * sizeof *a);
        assert_in_bound(error_of(b, a), 0.05);
        assert_in_bound(ghost, 0.02 * was);
        free(a);
        free(b);
    }
    free(before);
    truth_close(&plain);
    truth_close(&blended);
}

/* What ends a history: the very same bits as a view that has none. */
static void changes_drop_the_history(void **state)
{
    (void)state;
    static const char *const settings[] = {"aa=none", "aa=filter", "temporal=0"};
    struct truth plain, blended;
    stage_open(&plain, "sphere", COLUMNS, ROWS, NOISY);
    stage_open(&blended, "sphere", COLUMNS, ROWS, NOISY " temporal=0.9");
    for (size_t i = 0; i < sizeof settings / sizeof *settings; i++) {
        float *a = picture(&plain, 3), *b = picture(&blended, 3);
        assert_true(memcmp(a, b, VALUES * sizeof *a) != 0);
        free(a);
        free(b);
        truth_set(&plain, settings[i]);
        truth_set(&blended, settings[i]);
        a = picture(&plain, 1), b = picture(&blended, 1);
        assert_memory_equal(a, b, VALUES * sizeof *a);
        free(a);
        free(b);
    }
    truth_set(&blended, "temporal=0.9");
    truth_render(&plain, 3, CAUSTICS);
    truth_render(&blended, 3, CAUSTICS);
    view_reset(plain.view);
    view_reset(blended.view);
    float *a = picture(&plain, 1), *b = picture(&blended, 1);
    assert_memory_equal(a, b, VALUES * sizeof *a);
    free(a);
    free(b);
    struct error error = {0};
    for (int k = 0; k < 2; k++) { /* there and back: the old buffers are still large enough */
        assert_true(view_set_size(plain.view, k ? COLUMNS : 64, k ? ROWS : 36, &error));
        assert_true(view_set_size(blended.view, k ? COLUMNS : 64, k ? ROWS : 36, &error));
        size_t count = k ? VALUES : 3 * 64 * 36;
        const float *values = truth_channel(truth_render(&plain, 1, CAUSTICS), CHANNEL_CAUSTICS);
        assert_memory_equal(truth_channel(truth_render(&blended, 1, CAUSTICS), CHANNEL_CAUSTICS), values,
                            count * sizeof *values);
    }
    truth_close(&plain);
    truth_close(&blended);
}

static void open_moving(struct truth *stage, const char *settings)
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
                                    .key_count = 2};
    scene_builder_instance(&builder, channel.node, ball);
    channel.times = calloc(2, sizeof *channel.times);
    channel.values = calloc(6, sizeof *channel.values);
    assert_true(channel.times && channel.values);
    channel.times[1] = 1;
    channel.values[3] = 0.5f; /* half a metre along x in a second */
    scene_builder_channel(&builder, &channel);
    scenery_lamp(&builder, vec3_make(0.5, 3, 0.2), 20);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 2.5, 2.5), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 45);
    scenery_open(stage, &builder, &camera, COLUMNS, ROWS, settings);
}

static void moved_objects_drop_the_history(void **state)
{
    (void)state;
    struct error error = {0};
    struct truth plain, blended;
    open_moving(&plain, NOISY);
    open_moving(&blended, NOISY " temporal=0.9");
    for (int f = 0; f < 4; f++) { /* moves before every other frame */
        assert_true(view_set_time(plain.view, 0.2 * (f / 2), &error));
        assert_true(view_set_time(blended.view, 0.2 * (f / 2), &error));
        float *a = picture(&plain, 1), *b = picture(&blended, 1);
        assert_true((memcmp(a, b, VALUES * sizeof *a) == 0) == (f % 2 == 0));
        free(a);
        free(b);
    }
    truth_close(&plain);
    truth_close(&blended);
}

static int set_up(void **state)
{
    *state = pass_device_create();
    return 0;
}

static int tear_down(void **state)
{
    struct pass_device *device = *state;
    pass_device_destroy(&device);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(pixels_follow_the_model, set_up, tear_down),
        cmocka_unit_test_setup_teardown(nothing_changes_without_a_change, set_up, tear_down),
        cmocka_unit_test(jitter_becomes_quiet),
        cmocka_unit_test(a_moving_camera_keeps_its_history),
        cmocka_unit_test(a_still_picture_stays_the_same),
        cmocka_unit_test(moved_light_leaves_no_ghost),
        cmocka_unit_test(moved_objects_drop_the_history),
        cmocka_unit_test(changes_drop_the_history),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
