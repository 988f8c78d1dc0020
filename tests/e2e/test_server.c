/* The real causticd on a real Vulkan device (lavapipe will do), through the C client library. */
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"

#include "clients/lib/client.h"
#include "core/render/renderer.h"

#include <signal.h>
#include <string.h>
#include <time.h>

#define WIDTH  96u
#define HEIGHT 54u
#define FRAMES 4

static struct server_process server;

static struct client *open_client(const char *address)
{
    struct error error = {0};
    struct client *client =
        client_connect(&(struct client_params){.address = address, .timeout_ms = 120000}, &error);
    if (!client)
        fail_msg("%s", error.message);
    return client;
}

#define CHECK(call)                                                                                          \
    do {                                                                                                     \
        struct error error = {0};                                                                            \
        if (!(call))                                                                                         \
            fail_msg("%s: %s", #call, error.message);                                                        \
    } while (0)

/* The call must be refused, with a text that names `part`. */
#define REFUSED(call, expected, part)                                                                        \
    do {                                                                                                     \
        struct error error = {0};                                                                            \
        assert_false(call);                                                                                  \
        if (error.status != (expected) || !strstr(error.message, part))                                      \
            fail_msg("%s: status %d: %s", #call, (int)error.status, error.message);                          \
    } while (0)

static uint32_t new_view(struct client *client, uint32_t width, uint32_t height)
{
    uint32_t view = 0;
    CHECK(client_view_create(client, width, height, &view, &error));
    CHECK(client_view_set(client, view, "photons", "16384", &error));
    return view;
}

static struct client_frame *render(struct client *client, uint32_t view, uint32_t channels)
{
    struct client_frame *frame = NULL;
    CHECK(frame = client_render(client, view, &(struct client_render_params){.channels = channels}, &error));
    return frame;
}

static uint64_t hash_of(const struct client_frame *frame)
{
    uint64_t hash = 0xcbf29ce484222325u;
    for (uint32_t i = 0; i < frame->info.channel_count; i++) {
        const struct protocol_channel *channel = &frame->info.channels[i];
        const uint8_t *bytes = (const uint8_t *)frame->values[i];
        for (size_t j = 0; j < (size_t)channel->width * channel->height * channel->components * 4; j++)
            hash = (hash ^ bytes[j]) * 0x100000001b3u;
    }
    return hash;
}

static double sum_of(const struct client_frame *frame)
{
    double sum = 0;
    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT * 3; i++) {
        assert_true(isfinite(frame->values[0][i]) && frame->values[0][i] >= 0);
        sum += (double)frame->values[0][i];
    }
    return sum;
}

/* A short recording: a camera that moves, a light that changes, every channel. */
static void record(const char *address, uint64_t hashes[FRAMES])
{
    struct client *client = open_client(address);
    uint32_t view = new_view(client, WIDTH, HEIGHT);
    struct client_frame *first = render(client, view, 1u << CHANNEL_CAUSTICS);
    assert_true(sum_of(first) > 0);
    struct protocol_camera camera = first->info.camera;
    client_frame_destroy(&first);
    for (int i = 0; i < FRAMES; i++) {
        camera.eye[0] += 0.05f;
        CHECK(client_view_camera(client, view, &camera, &error));
        if (i == 2)
            CHECK(client_view_light(client,
                                    &(struct protocol_view_light){.view = view,
                                                                  .overrides = PROTOCOL_LIGHT_INTENSITY,
                                                                  .intensity = {10, 20, 30}},
                                    &error));
        struct client_frame *frame = render(client, view, (1u << CHANNEL_COUNT) - 1);
        assert_int_equal(frame->info.frame, i + 1);
        assert_int_equal(frame->info.channel_count, CHANNEL_COUNT);
        assert_close((double)frame->info.camera.eye[0], (double)camera.eye[0], 1e-6);
        hashes[i] = hash_of(frame);
        client_frame_destroy(&frame);
    }
    client_destroy(&client);
}

static int start(void **state)
{
    (void)state;
    double begin = seconds_now();
    server_start(&server, &(struct server_params){.program = "causticd", .scene = "sphere"});
    print_message("ready after %.2f s\n", seconds_now() - begin);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    server_stop(&server);
    return 0;
}

static void recordings_are_bit_identical(void **state)
{
    (void)state;
    uint64_t alone[FRAMES], busy[FRAMES], again[FRAMES];
    record(server.unix_address, alone);
    for (int i = 0; i + 1 < FRAMES; i++)
        assert_true(alone[i] != alone[i + 1]); /* else equality below would say nothing */
    struct client *other = open_client(server.tcp_address);
    uint32_t view = new_view(other, 64, 64);
    CHECK(
        client_subscribe(other, view, &(struct client_render_params){.channels = 1, .credit = 1000}, &error));
    record(server.tcp_address, busy);
    assert_memory_equal(alone, busy, sizeof alone);
    struct client_frame *frame = NULL;
    CHECK(frame = client_next_frame(other, 60000, &error));
    client_frame_destroy(&frame);
    client_destroy(&other);
    server_stop(&server);
    start(NULL);
    record(server.unix_address, again);
    assert_memory_equal(alone, again, sizeof alone);
}

static void a_frame_explains_itself(void **state)
{
    (void)state;
    struct client *client = open_client(server.unix_address);
    uint32_t view = new_view(client, WIDTH, HEIGHT);
    struct client_frame *frame = render(client, view, 1u << CHANNEL_BEAUTY);
    assert_true(frame->info.pass_count > 3 && frame->info.plan_count > 3);
    assert_int_equal(frame->info.statistic_count, STAT_COUNT);
    uint64_t passes_ns = 0;
    for (uint32_t i = 0; i < frame->info.pass_count; i++)
        passes_ns += frame->info.passes[i].elapsed_ns;
    assert_true(passes_ns > 0);
    assert_true(frame->info.statistics[STAT_photons_emitted] > 0);
    assert_true(frame->info.statistics[STAT_photons_emitted] <= 16384);
    assert_true(frame->info.statistics[STAT_frame_ns] > 0);
    assert_int_equal(frame->info.black_reason.length, 0);
    client_frame_destroy(&frame);
    CHECK(client_view_resize(client, view, 31, 17, &error));
    frame = render(client, view, 1u << CHANNEL_DEPTH);
    assert_int_equal(frame->info.channels[0].width, 31);
    assert_int_equal(frame->info.channels[0].height, 17);
    assert_int_equal(frame->info.channels[0].components, 1);
    client_frame_destroy(&frame);
    client_destroy(&client);
}

static void live_follows_the_camera(void **state)
{
    (void)state;
    struct client *client = open_client(server.tcp_address);
    uint32_t view = new_view(client, WIDTH, HEIGHT);
    CHECK(client_subscribe(client, view, &(struct client_render_params){.channels = 1, .credit = 2}, &error));
    struct client_frame *frame = NULL;
    CHECK(frame = client_next_frame(client, 60000, &error));
    struct protocol_camera camera = frame->info.camera;
    client_frame_destroy(&frame);
    camera.eye[1] += 0.25f;
    CHECK(client_view_camera(client, view, &camera, &error));
    bool has_followed = false;
    for (int i = 0; i < 4 && !has_followed; i++) {
        CHECK(frame = client_next_frame(client, 60000, &error));
        has_followed = fabsf(frame->info.camera.eye[1] - camera.eye[1]) < 1e-6f;
        client_frame_destroy(&frame);
    }
    assert_true(has_followed);
    client_destroy(&client);
}

static void what_the_renderer_refuses_reaches_the_client(void **state)
{
    (void)state;
    struct client *client = open_client(server.unix_address);
    uint32_t view = new_view(client, WIDTH, HEIGHT), other;
    struct client_frame *before = render(client, view, 1u << CHANNEL_CAUSTICS);
    struct protocol_camera camera = before->info.camera;
    memcpy(camera.at, camera.eye, sizeof camera.at);
    REFUSED(client_view_camera(client, view, &camera, &error), STATUS_INVALID, "eye");
    camera = before->info.camera;
    camera.fov = 179;
    REFUSED(client_view_camera(client, view, &camera, &error), STATUS_INVALID, "fov");
    camera = before->info.camera;
    for (int i = 0; i < 3; i++)
        camera.up[i] = camera.at[i] - camera.eye[i];
    REFUSED(client_view_camera(client, view, &camera, &error), STATUS_INVALID, "up");
    REFUSED(client_view_setting(client, view, SETTING_photons, 0, &error), STATUS_INVALID, "photons");
    REFUSED(client_view_setting(client, view, SETTING_cells, 100, &error), STATUS_INVALID, "cells");
    REFUSED(client_view_light(client,
                              &(struct protocol_view_light){.view = view,
                                                            .overrides = PROTOCOL_LIGHT_INTENSITY,
                                                            .intensity = {-1, 0, 0}},
                              &error),
            STATUS_INVALID, "intensity");
    REFUSED(client_view_create(client, 0, 16, &other, &error), STATUS_INVALID, "0x16");
    REFUSED(client_view_create(client, VIEW_MAX_SIZE, VIEW_MAX_SIZE, &other, &error), STATUS_LIMIT, "pixels");
    client_frame_destroy(&before);
    before = render(client, view, 1u << CHANNEL_CAUSTICS);
    assert_int_equal(before->info.frame, 1);
    client_frame_destroy(&before);
    client_destroy(&client);
}

static void sigterm_in_the_middle_of_a_frame_ends_well(void **state)
{
    (void)state;
    struct server_process own;
    server_start(&own, &(struct server_params){.program = "causticd", .scene = "sphere"});
    struct client *client = open_client(own.unix_address);
    uint32_t view = new_view(client, WIDTH, HEIGHT);
    CHECK(client_subscribe(client, view, &(struct client_render_params){.channels = 255, .credit = 1000},
                           &error));
    struct client_frame *frame = NULL;
    CHECK(frame = client_next_frame(client, 60000, &error));
    client_frame_destroy(&frame);
    assert_int_equal(server_wait(&own, SIGTERM, 30), 0);
    client_destroy(&client);
    char *log = server_log(&own);
    assert_null(strstr(log, "error"));
    free(log);
    server_clean(&own);
}

/* Nothing to see is not an error: the frame is black and says why. */
static void scenes_without_caustics_say_so(void **state)
{
    (void)state;
    static const char *const scenes[] = {"empty", "no-caster"};
    for (int i = 0; i < 2; i++) {
        struct server_process own;
        server_start(&own, &(struct server_params){.program = "causticd", .scene = scenes[i]});
        struct client *client = open_client(own.unix_address);
        uint32_t view = new_view(client, WIDTH, HEIGHT);
        struct client_frame *frame = render(client, view, 1u << CHANNEL_CAUSTICS);
        assert_true(frame->info.black_reason.length > 0);
        assert_close(sum_of(frame), 0, 0);
        client_frame_destroy(&frame);
        client_destroy(&client);
        server_stop(&own);
    }
}

int main(void)
{
    program_needs_device();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(recordings_are_bit_identical),
        cmocka_unit_test(a_frame_explains_itself),
        cmocka_unit_test(live_follows_the_camera),
        cmocka_unit_test(what_the_renderer_refuses_reaches_the_client),
        cmocka_unit_test(sigterm_in_the_middle_of_a_frame_ends_well),
        cmocka_unit_test(scenes_without_caustics_say_so),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
