/* What clients can do wrong, on purpose or not: each gets a clear answer, the server serves everyone else,
 * and nothing leaks. Against the server with the fake renderer. */
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"
#include "tests/support/wire.h"

#include "core/render/renderer.h"

#include <string.h>
#include <sys/socket.h>
#include <time.h>

#define CAUSTICS         (1u << CHANNEL_CAUSTICS)
#define SEED_NO_MEMORY   2147483646
#define SEED_DEVICE_LOST 2147483647

static struct server_process server;
static struct wire *witness; /* a well-behaved client that must be served throughout */
static uint32_t witness_view;
static uint32_t descriptors; /* with the witness alone */

static int start(void **state)
{
    (void)state;
    server_start(&server,
                 &(struct server_params){.arguments = {"--message-timeout", "2", "--stall-timeout", "2",
                                                       "--max-clients", "6", "--max-views", "3",
                                                       "--size-limit", "1024x512", "--output-limit", "4"}});
    witness = wire_open(server.unix_address);
    witness_view = wire_new_view(witness, 16, 16);
    descriptors = server_descriptors(&server);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    wire_close(&witness);
    server_stop(&server);
    return 0;
}

static void everyone_else_is_served(void)
{
    wire_expect_frame(witness, wire_render(witness, witness_view, CAUSTICS));
}

/* After every test: the server has noticed that the test's connections are gone, and kept nothing of them
 * open. */
static int only_the_witness_is_left(void **state)
{
    (void)state;
    double end = seconds_now() + 10;
    while (server_descriptors(&server) != descriptors)
        if (seconds_now() > end) {
            print_error("%u descriptors, not %u\n", server_descriptors(&server), descriptors);
            return -1;
        }
    return 0;
}

static void put_u32(uint8_t *bytes, uint32_t value)
{
    for (unsigned i = 0; i < 4; i++)
        bytes[i] = (uint8_t)(value >> 8 * i);
}

/* A header by hand, as protocol_encode would refuse to write it. */
static void send_header(struct wire *wire, uint32_t length, uint16_t type, uint32_t request,
                        uint32_t sequence)
{
    uint8_t bytes[PROTOCOL_HEADER_BYTES] = {0};
    put_u32(bytes, length);
    bytes[4] = (uint8_t)type;
    bytes[5] = (uint8_t)(type >> 8);
    put_u32(bytes + 8, request);
    put_u32(bytes + 12, sequence);
    wire_send_bytes(wire, bytes, sizeof bytes);
}

static void garbage_ends_only_its_connection(void **state)
{
    (void)state;
    uint8_t garbage[64 * 1024];
    uint64_t random = 88172645463325252u;
    for (int round = 0; round < 20; round++) {
        for (size_t i = 0; i < sizeof garbage; i++) {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            garbage[i] = (uint8_t)(random >> 32);
        }
        struct wire *wire = wire_open(round % 2 ? server.unix_address : server.tcp_address);
        /* A length of gigabytes. */
        garbage[3] = 0xff;
        wire_send_bytes(wire, garbage, round < 10 ? 100 : sizeof garbage);
        assert_non_null(strstr(wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_LIMIT), "framing"));
        wire_expect_end(wire, 5);
        wire_close(&wire);
    }
    everyone_else_is_served();
}

static void a_message_of_the_other_side_is_broken_framing(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.tcp_address);
    send_header(wire, 0, PROTOCOL_FRAME, 7, 7);
    assert_non_null(strstr(wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_INVALID), "FRAME"));
    wire_expect_end(wire, 5);
    wire_close(&wire);
    everyone_else_is_served();
}

static void the_smallest_length_past_its_bound_is_refused(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    send_header(wire, PROTOCOL_MAX_REQUEST_BYTES + 1, PROTOCOL_PING, 2, 2);
    wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_LIMIT);
    wire_expect_end(wire, 5);
    wire_close(&wire);
}

static void malformed_requests_are_answered_and_the_connection_stays(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint8_t zeros[PROTOCOL_MAX_REQUEST_BYTES] = {0};
    uint32_t sequence = wire->sequence;
    /* Unknown types, and every known request with no payload and with far too much of it. */
    static const uint16_t types[] = {0,
                                     3,
                                     15,
                                     36,
                                     99,
                                     127,
                                     PROTOCOL_VIEW_CREATE,
                                     PROTOCOL_VIEW_RESIZE,
                                     PROTOCOL_VIEW_DESTROY,
                                     PROTOCOL_VIEW_SHARE,
                                     PROTOCOL_VIEW_CAMERA,
                                     PROTOCOL_VIEW_FOLLOW,
                                     PROTOCOL_VIEW_TIME,
                                     PROTOCOL_VIEW_LIGHT,
                                     PROTOCOL_VIEW_SETTING,
                                     PROTOCOL_VIEW_RESET,
                                     PROTOCOL_RENDER,
                                     PROTOCOL_SUBSCRIBE,
                                     PROTOCOL_UNSUBSCRIBE,
                                     PROTOCOL_CREDIT};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        for (uint32_t length = 0; length <= sizeof zeros; length += sizeof zeros) {
            sequence++;
            send_header(wire, length, types[i], sequence, sequence);
            wire_send_bytes(wire, zeros, length);
            const struct protocol_message *message = wire_receive(wire);
            assert_int_equal(message->header.type, PROTOCOL_ERROR);
            assert_int_equal(message->header.request, sequence);
        }
    /* Request 0, and a sequence that stands still. */
    send_header(wire, 0, PROTOCOL_PING, 0, sequence + 1);
    wire_expect_error(wire, 0, STATUS_INVALID);
    send_header(wire, 0, PROTOCOL_PING, 77, sequence + 1);
    wire_expect_error(wire, 77, STATUS_INVALID);
    send_header(wire, 0, PROTOCOL_PING, 78, sequence + 2);
    wire_expect_ok(wire, 78);
    wire_close(&wire);
}

static void half_a_message_then_silence_is_ended(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.tcp_address), *mute = wire_connect(server.tcp_address);
    double begin = seconds_now();
    send_header(wire, 12, PROTOCOL_VIEW_CREATE, 2, 2);
    wire_send_bytes(wire, "abc", 3);
    everyone_else_is_served();
    assert_non_null(strstr(wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_IO), "half"));
    wire_expect_end(wire, 5);
    assert_true(seconds_now() - begin > 1.9 && seconds_now() - begin < 6);
    /* One that never says CHOOSE is not kept either. */
    assert_int_equal(wire_receive(mute)->header.type, PROTOCOL_HELLO);
    wire_expect_notice(mute, PROTOCOL_NOTICE_CLOSING, STATUS_IO);
    wire_expect_end(mute, 5);
    wire_close(&wire);
    wire_close(&mute);
    /* The witness said nothing for just as long, between messages: that is no offence. */
    everyone_else_is_served();
}

static void a_message_in_single_bytes_is_understood(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.tcp_address);
    uint8_t bytes[PROTOCOL_HEADER_BYTES + 64];
    struct error error;
    struct protocol_message message = {.header = {.type = PROTOCOL_VIEW_CREATE, .request = 5, .sequence = 5},
                                       .size = {.width = 8, .height = 8}};
    size_t size = protocol_encode(&message, bytes, sizeof bytes, &error);
    for (size_t i = 0; i < size; i++)
        wire_send_bytes(wire, bytes + i, 1);
    assert_true(wire_expect_ok(wire, 5) > 0);
    wire_close(&wire);
}

static void sizes_out_of_range_are_refused(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    static const struct {
        uint32_t width, height;
        enum status status;
    } sizes[] = {{0, 16, STATUS_INVALID},
                 {16, 0, STATUS_INVALID},
                 {0, 0, STATUS_INVALID},
                 {UINT32_MAX, UINT32_MAX, STATUS_INVALID},
                 {1 << 16, 1 << 16, STATUS_INVALID},
                 {VIEW_MAX_SIZE + 1, 1, STATUS_INVALID},
                 {1024, 513, STATUS_LIMIT},
                 {VIEW_MAX_SIZE, VIEW_MAX_SIZE, STATUS_LIMIT}};
    uint32_t view = wire_new_view(wire, 1024, 512);
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        char number[16];
        snprintf(number, sizeof number, "%u", sizes[i].height);
        const char *text =
            wire_expect_error(wire, wire_create(wire, sizes[i].width, sizes[i].height), sizes[i].status);
        assert_non_null(strstr(text, number));
        struct protocol_message resize = {
            .header.type = PROTOCOL_VIEW_RESIZE,
            .size = {.view = view, .width = sizes[i].width, .height = sizes[i].height}};
        wire_expect_error(wire, wire_send(wire, &resize), sizes[i].status);
    }
    /* What was refused changed nothing. */
    assert_int_equal(wire_expect_frame(wire, wire_render(wire, view, CAUSTICS)).bytes, 1024 * 512 * 12);
    wire_close(&wire);
}

static void views_and_clients_have_limits(void **state)
{
    (void)state;
    struct wire *wires[5];
    for (int i = 0; i < 5; i++)
        wires[i] = wire_open(server.tcp_address);
    struct wire *refused = wire_connect(server.unix_address);
    assert_non_null(strstr(wire_expect_notice(refused, PROTOCOL_NOTICE_CLOSING, STATUS_LIMIT), "6 clients"));
    wire_expect_end(refused, 5);
    wire_close(&refused);
    uint32_t views[3];
    for (int i = 0; i < 3; i++)
        views[i] = wire_new_view(wires[0], 4, 4);
    wire_expect_error(wires[0], wire_create(wires[0], 4, 4), STATUS_LIMIT);
    wire_expect_ok(wires[0], wire_view(wires[0], PROTOCOL_VIEW_DESTROY, views[1]));
    assert_true(wire_new_view(wires[0], 4, 4) > views[2]);
    for (int i = 0; i < 5; i++)
        wire_close(&wires[i]);
    /* Places become free again. */
    for (int i = 0; i < 20; i++) {
        struct wire *again = wire_connect(server.unix_address);
        bool is_welcome = wire_receive(again)->header.type == PROTOCOL_HELLO;
        wire_close(&again);
        if (is_welcome)
            return;
        nanosleep(&(struct timespec){.tv_nsec = 50000000}, NULL);
    }
    fail_msg("a closed connection keeps its place");
}

static void unknown_things_are_named(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 8, 8);
    assert_non_null(strstr(wire_expect_error(wire, wire_time(wire, 4711, 0), STATUS_NOT_FOUND), "4711"));
    assert_non_null(strstr(wire_expect_error(wire, wire_render(wire, 0, 1), STATUS_NOT_FOUND), "view 0"));
    assert_non_null(
        strstr(wire_expect_error(wire, wire_setting(wire, view, 4711, 0), STATUS_NOT_FOUND), "4711"));
    assert_non_null(
        strstr(wire_expect_error(wire, wire_render(wire, view, 1u << 12), STATUS_INVALID), "0x1000"));
    struct protocol_message light = {.header.type = PROTOCOL_VIEW_LIGHT,
                                     .light = {.view = view, .light = 64}};
    assert_non_null(strstr(wire_expect_error(wire, wire_send(wire, &light), STATUS_NOT_FOUND), "light 64"));
    struct protocol_message follow = {.header.type = PROTOCOL_VIEW_FOLLOW,
                                      .follow = {.view = view, .camera = 999}};
    assert_non_null(strstr(wire_expect_error(wire, wire_send(wire, &follow), STATUS_NOT_FOUND), "999"));
    follow = (struct protocol_message){
        .header.type = PROTOCOL_VIEW_FOLLOW,
        .follow = {.view = view, .camera = PROTOCOL_BY_NAME, .name = protocol_text_of("nobody")}};
    assert_non_null(strstr(wire_expect_error(wire, wire_send(wire, &follow), STATUS_NOT_FOUND), "nobody"));
    wire_close(&wire);
}

static void values_out_of_range_are_refused_and_change_nothing(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 8, 8), twin = wire_new_view(wire, 8, 8);
    for (uint32_t i = 0; i < SETTING_COUNT; i++) {
        wire_expect_error(wire, wire_setting(wire, view, i, 1e300), STATUS_INVALID);
        wire_expect_error(wire, wire_setting(wire, view, i, -1e300), STATUS_INVALID);
    }
    assert_non_null(strstr(
        wire_expect_error(wire, wire_setting(wire, view, SETTING_photons, 0), STATUS_INVALID), "photons"));
    wire_expect_error(wire, wire_setting(wire, view, SETTING_photons, 2.5), STATUS_INVALID);
    struct protocol_message camera = {
        .header.type = PROTOCOL_VIEW_CAMERA,
        .camera = {.view = view, .camera = {.eye = {1, 2, 3}, .at = {1, 2, 3}, .up = {0, 1, 0}, .fov = 40}}};
    wire_expect_error(wire, wire_send(wire, &camera), STATUS_INVALID);
    camera.header.request = 0;
    camera.camera.camera.at[0] = 0;
    camera.camera.camera.fov = 180;
    wire_expect_error(wire, wire_send(wire, &camera), STATUS_INVALID);
    struct wire_frame frame = wire_expect_frame(wire, wire_render(wire, view, CAUSTICS));
    assert_int_equal(frame.update_sequence, 0);
    assert_true(frame.hash == wire_expect_frame(wire, wire_render(wire, twin, CAUSTICS)).hash);
    /* Not a number: a message that cannot be made with the encoder. */
    uint8_t bytes[12] = {0};
    put_u32(bytes, view);
    memcpy(bytes + 4, &(double){NAN}, 8);
    send_header(wire, sizeof bytes, PROTOCOL_VIEW_TIME, 5000, 5000);
    wire_send_bytes(wire, bytes, sizeof bytes);
    assert_non_null(strstr(wire_expect_error(wire, 5000, STATUS_INVALID), "time"));
    wire_close(&wire);
}

static void disconnecting_in_the_middle_of_a_frame_leaks_nothing(void **state)
{
    (void)state;
    everyone_else_is_served();
    uint64_t memory = 0;
    for (int i = 0; i < 60; i++) {
        struct wire *wire = wire_open(i % 2 ? server.unix_address : server.tcp_address);
        uint32_t view = wire_new_view(wire, 1024, 512);
        wire_setting(wire, view, SETTING_accumulate, 11);
        wire_subscribe(wire, view, 0xff, 100);
        for (int j = 0; j < 3; j++)
            wire_render(wire, view, 0xff);
        if (i % 3 == 0) /* some while a frame is made, some while one is sent */
            nanosleep(&(struct timespec){.tv_nsec = 30000000}, NULL);
        wire_close(&wire);
        everyone_else_is_served();
        if (i == 20)
            memory = server_memory(&server);
    }
    everyone_else_is_served();
    assert_int_equal(only_the_witness_is_left(NULL), 0);
    /* A frame of all channels is some 38 MB: one kept in forty would show. */
    assert_true(server_memory(&server) < memory + (32u << 20));
}

static void a_client_that_does_not_read_is_paused_then_ended(void **state)
{
    (void)state;
    uint64_t memory = server_memory(&server);
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 512, 512);
    double begin = seconds_now();
    /* 3 MB each, 150 MB in all; the limit is 4. */
    for (int i = 0; i < 50; i++)
        wire_render(wire, view, CAUSTICS);
    nanosleep(&(struct timespec){.tv_nsec = 500000000}, NULL);
    everyone_else_is_served();
    assert_true(server_memory(&server) < memory + (64u << 20));
    uint64_t received = 0;
    /* Nothing was taken for the stall timeout: the server has given up on it. */
    while (seconds_now() - begin < 5)
        everyone_else_is_served();
    uint8_t bytes[65536];
    for (ssize_t got; (got = recv(wire->fd, bytes, sizeof bytes, 0)) > 0;)
        received += (uint64_t)got;
    assert_true(received < 8u << 20);
    wire_close(&wire);
    everyone_else_is_served();
}

/* The same client reading late, but reading: nothing is lost. */
static void a_client_that_reads_late_gets_everything(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 512, 512), requests[10];
    for (int i = 0; i < 10; i++)
        requests[i] = wire_render(wire, view, CAUSTICS);
    nanosleep(&(struct timespec){.tv_sec = 1}, NULL);
    for (int i = 0; i < 10; i++)
        assert_int_equal(wire_expect_frame(wire, requests[i]).number, i);
    wire_close(&wire);
}

/* Requests without end and no reading: replies must not pile up either. */
static void a_flood_of_requests_is_held_back(void **state)
{
    (void)state;
    uint64_t memory = server_memory(&server);
    struct wire *wire = wire_open(server.unix_address);
    uint8_t ping[PROTOCOL_HEADER_BYTES] = {0};
    ping[4] = PROTOCOL_PING;
    ping[8] = 1;
    struct timeval limit = {.tv_usec = 500000};
    setsockopt(wire->fd, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
    uint64_t sent = 0;
    for (uint32_t i = 2; sent < 64u << 20; i++) {
        put_u32(ping + 12, i);
        ssize_t got = send(wire->fd, ping, sizeof ping, MSG_NOSIGNAL);
        if (got <= 0)
            break;
        sent += (uint64_t)got;
    }
    assert_true(sent < 16u << 20);
    assert_true(server_memory(&server) < memory + (32u << 20));
    everyone_else_is_served();
    wire_close(&wire);
}

static void a_view_that_cannot_be_rendered_ends_alone(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 8, 8);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_seed, SEED_NO_MEMORY));
    wire_expect_error(wire, wire_render(wire, view, CAUSTICS), STATUS_DEVICE);
    uint32_t request = wire_subscribe(wire, view, CAUSTICS, 10);
    wire_expect_ok(wire, request);
    assert_non_null(strstr(wire_expect_notice(wire, PROTOCOL_NOTICE_LIVE_ENDED, STATUS_DEVICE), "memory"));
    wire_expect_error(wire, wire_credit(wire, view, 1), STATUS_NOT_FOUND);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_seed, 1));
    wire_expect_frame(wire, wire_render(wire, view, CAUSTICS));
    wire_close(&wire);
    everyone_else_is_served();
}

/* On a server of its own, which it ends. */
static void a_lost_device_is_told_to_everyone(void **state)
{
    (void)state;
    struct server_process doomed;
    server_start(&doomed, &(struct server_params){0});
    struct wire *wire = wire_open(doomed.unix_address), *other = wire_open(doomed.tcp_address);
    uint32_t view = wire_new_view(wire, 8, 8);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_seed, SEED_DEVICE_LOST));
    wire_expect_error(wire, wire_render(wire, view, CAUSTICS), STATUS_DEVICE);
    wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_DEVICE);
    wire_expect_notice(other, PROTOCOL_NOTICE_CLOSING, STATUS_DEVICE);
    wire_expect_end(other, 5);
    wire_close(&wire);
    wire_close(&other);
    assert_int_equal(server_wait(&doomed, 0, 10), 1);
    char *log = server_log(&doomed);
    assert_non_null(strstr(log, "device is lost"));
    free(log);
    server_clean(&doomed);
}

#define TEST(name) cmocka_unit_test_teardown(name, only_the_witness_is_left)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(garbage_ends_only_its_connection),
        TEST(a_message_of_the_other_side_is_broken_framing),
        TEST(the_smallest_length_past_its_bound_is_refused),
        TEST(malformed_requests_are_answered_and_the_connection_stays),
        TEST(half_a_message_then_silence_is_ended),
        TEST(a_message_in_single_bytes_is_understood),
        TEST(sizes_out_of_range_are_refused),
        TEST(views_and_clients_have_limits),
        TEST(unknown_things_are_named),
        TEST(values_out_of_range_are_refused_and_change_nothing),
        TEST(disconnecting_in_the_middle_of_a_frame_leaks_nothing),
        TEST(a_client_that_does_not_read_is_paused_then_ended),
        TEST(a_client_that_reads_late_gets_everything),
        TEST(a_flood_of_requests_is_held_back),
        TEST(a_view_that_cannot_be_rendered_ends_alone),
        TEST(a_lost_device_is_told_to_everyone),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
