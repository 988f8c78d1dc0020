/* Requests and frames over real sockets, against the server with the fake renderer: what a client is
 * promised. */
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"
#include "tests/support/wire.h"

#include "core/render/renderer.h"

#include <string.h>
#include <time.h>

#define CAUSTICS (1u << CHANNEL_CAUSTICS)
#define DEPTH    (1u << CHANNEL_DEPTH)

static struct server_process server;

static int start(void **state)
{
    (void)state;
    server_start(&server, &(struct server_params){0});
    return 0;
}

static int stop(void **state)
{
    (void)state;
    server_stop(&server);
    return 0;
}

static void hello_describes_the_server(void **state)
{
    (void)state;
    const char *const addresses[] = {server.unix_address, server.tcp_address};
    for (int i = 0; i < 2; i++) {
        struct wire *wire = wire_connect(addresses[i]);
        const struct protocol_message *message = wire_receive(wire);
        assert_int_equal(message->header.type, PROTOCOL_HELLO);
        assert_int_equal(message->header.request, 0);
        const struct protocol_hello *hello = &message->hello;
        assert_int_equal(hello->major, PROTOCOL_MAJOR);
        assert_true(protocol_text_equals(hello->scene, "sphere"));
        assert_true(protocol_text_equals(hello->device, "fake"));
        assert_int_equal(hello->limits.max_clients, 32);
        assert_int_equal(hello->setting_count, SETTING_COUNT);
        assert_true(protocol_text_equals(hello->settings[SETTING_aa].choices,
                                         "filter,none,pixel,msaa,msaa_sample,msaa_small,coverage"));
        assert_int_equal(hello->channel_count, CHANNEL_COUNT);
        assert_true(hello->light_count >= 1 && hello->camera_count >= 1);
        wire_close(&wire);
    }
}

static void choose_comes_first_and_once(void **state)
{
    (void)state;
    struct wire *wire = wire_connect(server.unix_address);
    wire_receive(wire);
    assert_non_null(strstr(wire_expect_error(wire, wire_ping(wire), STATUS_INVALID), "CHOOSE"));
    struct protocol_message choose = {.header.type = PROTOCOL_CHOOSE,
                                      .choose = {.major = PROTOCOL_MAJOR + 1}};
    wire_expect_error(wire, wire_send(wire, &choose), STATUS_UNSUPPORTED);
    choose = (struct protocol_message){.header.type = PROTOCOL_CHOOSE,
                                       .choose = {.major = PROTOCOL_MAJOR, .features = 1ull << 40}};
    wire_expect_error(wire, wire_send(wire, &choose), STATUS_UNSUPPORTED);
    choose = (struct protocol_message){.header.type = PROTOCOL_CHOOSE, .choose = {.major = PROTOCOL_MAJOR}};
    wire_expect_ok(wire, wire_send(wire, &choose));
    choose.header.request = 0;
    wire_expect_error(wire, wire_send(wire, &choose), STATUS_INVALID);
    wire_expect_ok(wire, wire_ping(wire));
    /* What was not picked cannot be used. */
    uint32_t view = wire_new_view(wire, 16, 16);
    wire_expect_error(wire, wire_subscribe(wire, view, CAUSTICS, 1), STATUS_UNSUPPORTED);
    wire_expect_error(wire, wire_share(wire, view, true), STATUS_UNSUPPORTED);
    struct protocol_message render = {.header.type = PROTOCOL_RENDER,
                                      .render = {.view = view, .channels = 1, .encoding = PROTOCOL_ZSTD}};
    wire_expect_error(wire, wire_send(wire, &render), STATUS_UNSUPPORTED);
    wire_close(&wire);
}

/* 200 pairs of update and render written before anything is read: more than the server takes at a time, so it
 * has to stop reading and go on. */
static void lock_step_keeps_every_frame_and_order(void **state)
{
    (void)state;
    enum { PAIRS = 200 };
    struct wire *wire = wire_open(server.tcp_address);
    uint32_t view = wire_new_view(wire, 40, 30), requests[PAIRS], updates[PAIRS];
    for (int i = 0; i < PAIRS; i++) {
        updates[i] = wire_time(wire, view, i);
        requests[i] = wire_render(wire, view, CAUSTICS | DEPTH);
    }
    int frames = 0, replies = 0;
    while (frames < PAIRS || replies < PAIRS) {
        const struct protocol_message *message = wire_receive(wire);
        if (message->header.type == PROTOCOL_OK) {
            assert_int_equal(message->header.request, updates[replies++]);
            continue;
        }
        assert_int_equal(message->header.type, PROTOCOL_FRAME);
        assert_true(message->frame.time == frames);
        struct wire_frame frame = wire_take_frame(wire);
        assert_int_equal(frame.request, requests[frames]);
        assert_int_equal(frame.number, frames);
        assert_int_equal(frame.update_sequence, updates[frames]);
        assert_int_equal(frame.bytes, 40 * 30 * (3 + 1) * 4);
        frames++;
    }
    wire_expect_ok(wire, wire_ping(wire));
    wire_close(&wire);
}

static void replies_come_in_order_behind_slow_frames(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 8, 8);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_accumulate, 100));
    uint32_t render = wire_render(wire, view, 0);
    uint32_t time = wire_time(wire, view, 1);
    uint32_t wrong = wire_setting(wire, view, 100000, 1);
    uint32_t ping = wire_ping(wire);
    wire_expect_frame(wire, render);
    wire_expect_ok(wire, time);
    wire_expect_error(wire, wrong, STATUS_NOT_FOUND);
    wire_expect_ok(wire, ping);
    wire_close(&wire);
}

/* The frames of one view, with whatever another client does meanwhile. */
static void record(const char *address, uint64_t hashes[20])
{
    struct wire *wire = wire_open(address);
    uint32_t view = wire_new_view(wire, 64, 48);
    wire_expect_ok(wire, wire_share(wire, view, true));
    for (int i = 0; i < 20; i++) {
        wire_expect_ok(wire, wire_time(wire, view, 0.1 * i));
        if (i == 7)
            wire_expect_ok(wire, wire_view(wire, PROTOCOL_VIEW_RESET, view));
        hashes[i] = wire_expect_frame(wire, wire_render(wire, view, CAUSTICS)).hash;
    }
    wire_close(&wire);
}

static void lock_step_frames_do_not_depend_on_other_clients(void **state)
{
    (void)state;
    uint64_t alone[20], together[20];
    record(server.unix_address, alone);
    assert_true(alone[0] != alone[1]); /* else equal hashes would say nothing */
    struct wire *other = wire_open(server.tcp_address);
    uint32_t view = wire_new_view(other, 320, 240);
    wire_expect_ok(other, wire_subscribe(other, view, CAUSTICS, 1000));
    record(server.unix_address, together);
    assert_memory_equal(alone, together, sizeof alone);
    /* The other one got its share. */
    assert_int_equal(wire_receive(other)->header.type, PROTOCOL_FRAME);
    assert_int_equal(wire_take_frame(other).number, 0);
    wire_close(&other);
}

static void watchers_do_not_change_a_lock_step_view(void **state)
{
    (void)state;
    uint64_t alone[4];
    struct wire *owner = wire_open(server.unix_address), *watcher = wire_open(server.tcp_address);
    for (int round = 0; round < 2; round++) {
        uint32_t view = wire_new_view(owner, 32, 32);
        if (round == 1) {
            wire_expect_ok(owner, wire_share(owner, view, true));
            wire_expect_ok(watcher, wire_subscribe(watcher, view, CAUSTICS, 100));
            assert_true(wire_is_silent(watcher, 0.2));
        }
        for (uint64_t i = 0; i < 4; i++) {
            struct wire_frame frame = wire_expect_frame(owner, wire_render(owner, view, CAUSTICS));
            if (round == 0) {
                alone[i] = frame.hash;
                continue;
            }
            assert_true(frame.hash == alone[i]);
            assert_int_equal(wire_receive(watcher)->header.type, PROTOCOL_FRAME);
            struct wire_frame seen = wire_take_frame(watcher);
            assert_int_equal(seen.number, i);
            assert_true(seen.hash == alone[i]);
        }
    }
    wire_close(&owner);
    wire_close(&watcher);
}

static void a_view_belongs_to_its_connection(void **state)
{
    (void)state;
    struct wire *owner = wire_open(server.unix_address), *other = wire_open(server.unix_address);
    uint32_t view = wire_new_view(owner, 16, 16);
    wire_expect_error(other, wire_time(other, view, 1), STATUS_NOT_FOUND);
    wire_expect_error(other, wire_render(other, view, CAUSTICS), STATUS_NOT_FOUND);
    wire_expect_error(other, wire_subscribe(other, view, CAUSTICS, 1), STATUS_NOT_FOUND);
    wire_expect_ok(owner, wire_share(owner, view, true));
    wire_expect_ok(other, wire_subscribe(other, view, CAUSTICS, 1));
    wire_expect_error(other, wire_time(other, view, 1), STATUS_NOT_FOUND);
    wire_expect_ok(owner, wire_share(owner, view, false));
    wire_expect_notice(other, PROTOCOL_NOTICE_VIEW_GONE, STATUS_NOT_FOUND);
    wire_expect_ok(owner, wire_share(owner, view, true));
    wire_expect_ok(other, wire_subscribe(other, view, CAUSTICS, 1));
    wire_expect_ok(owner, wire_view(owner, PROTOCOL_VIEW_DESTROY, view));
    wire_expect_notice(other, PROTOCOL_NOTICE_VIEW_GONE, STATUS_NOT_FOUND);
    wire_expect_error(owner, wire_render(owner, view, CAUSTICS), STATUS_NOT_FOUND);
    view = wire_new_view(owner, 16, 16);
    wire_expect_ok(owner, wire_share(owner, view, true));
    wire_expect_ok(other, wire_subscribe(other, view, CAUSTICS, 1));
    wire_close(&owner);
    wire_expect_notice(other, PROTOCOL_NOTICE_VIEW_GONE, STATUS_NOT_FOUND);
    wire_expect_ok(other, wire_ping(other));
    wire_close(&other);
}

static void live_takes_no_more_than_its_credit(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 16, 16);
    uint32_t request = wire_subscribe(wire, view, CAUSTICS, 3);
    wire_expect_ok(wire, request);
    for (uint64_t i = 0; i < 3; i++) {
        struct wire_frame frame = wire_expect_frame(wire, request);
        assert_int_equal(frame.number, i);
        assert_int_equal(frame.dropped, 0);
    }
    assert_true(wire_is_silent(wire, 0.3));
    /* The frame of the new credit may overtake nothing: OK first. */
    wire_expect_ok(wire, wire_credit(wire, view, 1));
    assert_int_equal(wire_expect_frame(wire, request).number, 3);
    assert_true(wire_is_silent(wire, 0.3));
    wire_expect_ok(wire, wire_view(wire, PROTOCOL_UNSUBSCRIBE, view));
    wire_expect_error(wire, wire_credit(wire, view, 1), STATUS_NOT_FOUND);
    wire_expect_error(wire, wire_view(wire, PROTOCOL_UNSUBSCRIBE, view), STATUS_NOT_FOUND);
    assert_int_equal(wire_expect_frame(wire, wire_render(wire, view, 0)).number, 4);
    wire_close(&wire);
}

/* Frames of 3 MB are not read for a second: two or three fill the socket, all later ones must fall to the
 * newest. */
static void live_drops_what_a_slow_client_misses(void **state)
{
    (void)state;
    struct wire *owner = wire_open(server.unix_address), *slow = wire_open(server.unix_address);
    uint32_t view = wire_new_view(owner, 512, 512);
    wire_expect_ok(owner, wire_share(owner, view, true));
    uint32_t slow_request = wire_subscribe(slow, view, CAUSTICS, 1000);
    wire_expect_ok(slow, slow_request);
    uint32_t request = wire_subscribe(owner, view, 0, 40);
    wire_expect_ok(owner, request);
    for (uint64_t i = 0; i < 40; i++)
        assert_int_equal(wire_expect_frame(owner, request).number, i);
    uint32_t dropped = 0;
    uint64_t last = 0;
    for (bool is_first = true; last < 39; is_first = false) {
        struct wire_frame frame = wire_expect_frame(slow, slow_request);
        assert_int_equal(frame.bytes, 512 * 512 * 3 * 4);
        /* Every frame is either received or counted. */
        if (!is_first)
            assert_int_equal(frame.number, last + 1 + frame.dropped);
        last = frame.number;
        dropped += frame.dropped;
    }
    assert_in_range(dropped, 30, 39);
    wire_close(&owner);
    wire_close(&slow);
}

/* Frames take 50 ms; the camera moves every 5 ms. Each frame must carry the newest update there was when it
 * began. */
static void live_frames_carry_the_newest_update(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 16, 16);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_accumulate, 51));
    uint32_t request = wire_subscribe(wire, view, 0, 1000), last_update = 0, replies = 0, frames = 0,
             first = 0;
    wire_expect_ok(wire, request);
    for (int i = 0; i < 100; i++) {
        last_update = wire_time(wire, view, i);
        first = first ? first : last_update;
        nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
    }
    uint32_t included = 0;
    while (included != last_update) {
        const struct protocol_message *message = wire_receive(wire);
        if (message->header.type == PROTOCOL_OK) {
            assert_int_equal(message->header.request, first + replies++);
            continue;
        }
        struct wire_frame frame = wire_take_frame(wire);
        assert_true(frame.update_sequence >= included);
        included = frame.update_sequence;
        frames++;
    }
    /* 100 updates were taken in batches: a frame per update would be 100 frames and five seconds. */
    assert_int_equal(replies, 100);
    assert_in_range(frames, 5, 30);
    wire_close(&wire);
}

static void views_take_turns(void **state)
{
    (void)state;
    struct wire *greedy = wire_open(server.unix_address), *modest = wire_open(server.unix_address);
    uint32_t greedy_view = wire_new_view(greedy, 16, 16), modest_view = wire_new_view(modest, 16, 16);
    wire_expect_ok(greedy, wire_setting(greedy, greedy_view, SETTING_accumulate, 21));
    wire_expect_ok(modest, wire_setting(modest, modest_view, SETTING_accumulate, 21));
    for (int i = 0; i < 60; i++) /* 1.2 s of work */
        wire_render(greedy, greedy_view, 0);
    assert_false(wire_is_silent(greedy, 5));
    double begin = seconds_now();
    for (int i = 0; i < 10; i++)
        wire_expect_frame(modest, wire_render(modest, modest_view, 0));
    double elapsed = seconds_now() - begin;
    /* In turns each of the ten waits for one frame of the other; behind the queue they would wait for all of
     * it. */
    assert_true(elapsed > 0.2 && elapsed < 0.9);
    for (uint64_t i = 0; i < 60; i++) {
        wire_receive(greedy);
        assert_int_equal(wire_take_frame(greedy).number, i);
    }
    wire_close(&greedy);
    wire_close(&modest);
}

static void formats_and_encodings_reach_the_client(void **state)
{
    (void)state;
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 33, 17);
    for (int format = 0; format < PROTOCOL_FORMAT_COUNT; format++)
        for (int encoding = 0; encoding < PROTOCOL_ENCODING_COUNT; encoding++) {
            struct protocol_message render = {.header.type = PROTOCOL_RENDER,
                                              .render = {.view = view,
                                                         .channels = DEPTH,
                                                         .format = (uint8_t)format,
                                                         .encoding = (uint8_t)encoding}};
            uint32_t request = wire_send(wire, &render);
            const struct protocol_message *message = wire_receive(wire);
            assert_int_equal(message->header.type, PROTOCOL_FRAME);
            assert_int_equal(message->frame.channels[0].channel, CHANNEL_DEPTH);
            assert_int_equal(message->frame.channels[0].format, format);
            assert_int_equal(message->frame.channels[0].encoding, encoding);
            struct wire_frame frame = wire_take_frame(wire);
            assert_int_equal(frame.request, request);
            if (encoding == PROTOCOL_RAW)
                assert_int_equal(frame.bytes, 33 * 17 * (format == PROTOCOL_F32 ? 4 : 2));
        }
    wire_close(&wire);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hello_describes_the_server),
        cmocka_unit_test(choose_comes_first_and_once),
        cmocka_unit_test(lock_step_keeps_every_frame_and_order),
        cmocka_unit_test(replies_come_in_order_behind_slow_frames),
        cmocka_unit_test(lock_step_frames_do_not_depend_on_other_clients),
        cmocka_unit_test(watchers_do_not_change_a_lock_step_view),
        cmocka_unit_test(a_view_belongs_to_its_connection),
        cmocka_unit_test(live_takes_no_more_than_its_credit),
        cmocka_unit_test(live_drops_what_a_slow_client_misses),
        cmocka_unit_test(live_frames_carry_the_newest_update),
        cmocka_unit_test(views_take_turns),
        cmocka_unit_test(formats_and_encodings_reach_the_client),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
