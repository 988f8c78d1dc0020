/* The client library against a peer that is honest, and against peers that are not. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cmocka.h>

#include "clients/lib/client.h"
#include "tests/support/fake_peer.h"

static struct fake_peer *peer;
static struct error error;

/* NULL and `error` when the connection fails. */
static struct client *open_client(enum fake_fault fault)
{
    int pair[2];
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
    peer = fake_peer_start(pair[1], NULL, fault);
    return client_adopt(pair[0], &(struct client_params){.timeout_ms = 2000, .max_frame_bytes = 1 << 24},
                        &error);
}

static void close_client(struct client **client)
{
    client_destroy(client);
    fake_peer_stop(&peer);
}

static void assert_pixels(const struct client_frame *frame, uint32_t index)
{
    const struct protocol_channel *channel = &frame->info.channels[index];
    for (uint32_t i = 0; i < channel->width * channel->height * channel->components; i++) {
        uint32_t pixel = i / channel->components;
        float expected = fake_peer_value(channel->channel, frame->info.frame, pixel % channel->width,
                                         pixel / channel->width, i % channel->components);
        if (frame->values[index][i] != expected)
            fail_msg("channel %u, pixel %u: %g where %g belongs", channel->channel, pixel,
                     (double)frame->values[index][i], (double)expected);
    }
}

static void lock_step_frames_are_exact(void **state)
{
    (void)state;
    struct client *client = open_client(FAKE_HONEST);
    assert_non_null(client);
    assert_true(protocol_text_equals(client_hello(client)->scene, "fake"));
    uint32_t view;
    assert_true(client_view_create(client, 101, 67, &view, &error));
    assert_int_equal(view, 1);
    assert_true(client_view_set(client, view, "photons", "777", &error));
    struct protocol_camera camera = {.eye = {1, 2, 3}, .at = {0, 0.5f, 0}, .up = {0, 1, 0}, .fov = 33};
    assert_true(client_view_camera(client, view, &camera, &error));
    assert_true(
        client_view_time(client, view, 1.25, &error)); /* the fifth message: after CHOOSE and three more */
    uint64_t number = 0;
    for (int format = 0; format < PROTOCOL_FORMAT_COUNT; format++) {
        for (int encoding = 0; encoding < PROTOCOL_ENCODING_COUNT; encoding++) {
            struct client_frame *frame =
                client_render(client, view,
                              &(struct client_render_params){.channels = 7,
                                                             .format = (enum protocol_format)format,
                                                             .encoding = (enum protocol_encoding)encoding},
                              &error);
            assert_non_null(frame);
            assert_int_equal(frame->info.frame, number++);
            assert_int_equal(frame->info.update_sequence, 5);
            assert_int_equal(frame->info.channel_count, 3);
            for (uint32_t i = 0; i < 3; i++)
                assert_pixels(frame, i);
            assert_int_equal(frame->info.channels[2].width, 20);
            assert_true(frame->info.time == 1.25);
            assert_memory_equal(&frame->info.camera, &camera, sizeof camera);
            assert_true(frame->info.statistics[0] == 777);
            /* The texts live as long as the frame. */
            assert_true(protocol_text_equals(frame->info.passes[1].name, "splat"));
            assert_true(protocol_text_equals(frame->info.plan[0].reason, "no water"));
            client_frame_destroy(&frame);
            assert_null(frame);
        }
    }
    struct client_frame *frame = client_render(client, view, &(struct client_render_params){0}, &error);
    assert_non_null(frame);
    assert_int_equal(frame->info.channel_count, 0);
    client_frame_destroy(&frame);
    close_client(&client);
}

static void refusals_leave_the_connection_open(void **state)
{
    (void)state;
    struct client *client = open_client(FAKE_HONEST);
    uint32_t view, index;
    assert_false(client_view_create(client, 0, 10, &view, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_non_null(strstr(error.message, "width"));
    assert_false(client_view_setting(client, 1, 99, 0, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    /* Refused before anything is sent. */
    assert_false(client_view_time(client, 1, NAN, &error));
    assert_non_null(strstr(error.message, "time"));
    assert_false(client_find_setting(client, "photon", &index, &error));
    assert_non_null(strstr(error.message, "photons, gain, aa"));
    assert_false(client_find_light(client, "lamp", &index, &error));
    assert_non_null(strstr(error.message, "lamp.one"));
    assert_false(client_find_channel(client, "colour", &index, &error));
    assert_non_null(strstr(error.message, "beauty, depth, density"));
    assert_true(client_ping(client, &error));
    close_client(&client);
}

static void settings_are_read_by_type(void **state)
{
    (void)state;
    struct client *client = open_client(FAKE_HONEST);
    const struct protocol_setting *settings = client_hello(client)->settings;
    static const struct {
        uint32_t setting;
        const char *text;
        bool is_good;
        double value;
    } cases[] = {
        {0, "500000", true, 500000}, {0, "5e5", true, 500000}, {0, "1.5", false, 0},   {0, "-1", false, 0},
        {0, "nan", false, 0},        {0, "", false, 0},        {0, "12x", false, 0},   {1, "2.5", true, 2.5},
        {1, "10.01", false, 0},      {2, "pixel", true, 2},    {2, "filter", true, 0}, {2, "pix", false, 0},
        {2, "", false, 0},           {3, "on", true, 1},       {3, "false", true, 0},  {3, "Yes", true, 1},
        {3, "2", false, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        double value = -1;
        bool is_good = client_setting_parse(&settings[cases[i].setting], cases[i].text, &value, &error);
        if (is_good != cases[i].is_good || (is_good && value != cases[i].value))
            fail_msg("setting %u = \"%s\": %d, %g", cases[i].setting, cases[i].text, is_good, value);
        char text[64];
        double again;
        if (!is_good)
            continue;
        client_setting_print(&settings[cases[i].setting], value, text, sizeof text);
        assert_true(client_setting_parse(&settings[cases[i].setting], text, &again, &error) &&
                    again == value);
    }
    close_client(&client);
}

static void live_frames_come_with_credit(void **state)
{
    (void)state;
    struct client *client = open_client(FAKE_HONEST);
    uint32_t view;
    assert_true(client_view_create(client, 40, 30, &view, &error));
    assert_true(
        client_subscribe(client, view, &(struct client_render_params){.channels = 1, .credit = 3}, &error));
    /* Frames that arrive while another request waits for its reply are kept. */
    assert_true(client_ping(client, &error));
    for (uint64_t i = 0; i < 20; i++) {
        struct client_frame *frame = client_next_frame(client, 2000, &error);
        assert_non_null(frame);
        assert_int_equal(frame->info.frame, i);
        assert_pixels(frame, 0);
        client_frame_destroy(&frame);
    }
    assert_true(client_unsubscribe(client, view, &error));
    assert_null(client_next_frame(client, 50, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_true(client_ping(client, &error));
    close_client(&client);
}

static void a_subscription_that_ends_says_why(void **state)
{
    (void)state;
    struct client *client = open_client(FAKE_LIVE_ENDS);
    uint32_t view;
    assert_true(client_view_create(client, 40, 30, &view, &error));
    assert_true(client_subscribe(client, view, &(struct client_render_params){.channels = 1}, &error));
    struct client_frame *frame = client_next_frame(client, 2000, &error);
    assert_non_null(frame);
    client_frame_destroy(&frame);
    assert_null(client_next_frame(client, 2000, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    assert_non_null(strstr(error.message, "device lost"));
    assert_true(client_ping(client, &error));
    close_client(&client);
}

static void bad_openings_are_named(void **state)
{
    (void)state;
    static const struct {
        enum fake_fault fault;
        enum status status;
        const char *text;
    } cases[] = {{FAKE_WRONG_MAGIC, STATUS_IO, "magic"},
                 {FAKE_WRONG_VERSION, STATUS_UNSUPPORTED, "2.0"},
                 {FAKE_REFUSES, STATUS_IO, "enough clients"},
                 {FAKE_SILENT, STATUS_IO, "in time"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct client *client = open_client(cases[i].fault);
        assert_null(client);
        if (error.status != cases[i].status || !strstr(error.message, cases[i].text))
            fail_msg("%s: \"%s\"", cases[i].text, error.message);
        fake_peer_stop(&peer);
    }
}

static void bad_frames_end_the_connection(void **state)
{
    (void)state;
    static const struct {
        enum fake_fault fault;
        const char *text;
    } cases[] = {{FAKE_CLOSES_IN_FRAME, "closed"},
                 {FAKE_PART_OUT_OF_ORDER, "does not continue"},
                 {FAKE_PART_TOO_LONG, "more bytes"},
                 {FAKE_HUGE_FRAME, "more than the 16777216"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct client *client = open_client(cases[i].fault);
        uint32_t view;
        assert_non_null(client);
        assert_true(client_view_create(client, 200, 100, &view, &error));
        assert_null(client_render(client, view, &(struct client_render_params){.channels = 1}, &error));
        if (!strstr(error.message, cases[i].text))
            fail_msg("%s: \"%s\"", cases[i].text, error.message);
        assert_false(client_ping(client, &error));
        assert_int_equal(error.status, STATUS_IO);
        close_client(&client);
    }
    struct client *client = open_client(FAKE_REPLIES_TWICE);
    assert_true(client_ping(client, &error));
    assert_false(client_ping(client, &error));
    assert_non_null(strstr(error.message, "answered request"));
    close_client(&client);
}

static void bad_addresses_are_named(void **state)
{
    (void)state;
    static const struct {
        const char *address, *text;
    } cases[] = {{"udp:1", "tcp: or unix:"},
                 {"tcp:7420", "tcp:HOST:PORT"},
                 {"tcp:127.0.0.1:", "tcp:HOST:PORT"},
                 {"unix:/nonexistent/socket", "/nonexistent/socket"},
                 {"unix:", "path"},
                 {"tcp:127.0.0.1:1", "127.0.0.1:1"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        assert_null(client_connect(&(struct client_params){.address = cases[i].address}, &error));
        if (!strstr(error.message, cases[i].text))
            fail_msg("%s: \"%s\"", cases[i].address, error.message);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lock_step_frames_are_exact),
        cmocka_unit_test(refusals_leave_the_connection_open),
        cmocka_unit_test(settings_are_read_by_type),
        cmocka_unit_test(live_frames_come_with_credit),
        cmocka_unit_test(a_subscription_that_ends_says_why),
        cmocka_unit_test(bad_openings_are_named),
        cmocka_unit_test(bad_frames_end_the_connection),
        cmocka_unit_test(bad_addresses_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
