/* 2000 frames of one real server, from views that come and go, grow and shrink: no memory, device memory or
 * descriptor more at the end than after the first hundred. */
#include "tests/e2e/server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"
#include "tests/support/wire.h"

#include "core/render/renderer.h"

#define FRAMES       2000
#define FRAMES_FIRST 200 /* until every buffer has had its largest size */

static struct wire_frame frame_of(struct wire *wire, uint32_t view, double *device_bytes)
{
    uint32_t request = wire_render(wire, view, 1u << CHANNEL_CAUSTICS);
    wire_receive(wire);
    assert_int_equal(wire->message.header.type, PROTOCOL_FRAME);
    *device_bytes = wire->message.frame.statistics[STAT_device_bytes];
    struct wire_frame frame = wire_take_frame(wire);
    assert_int_equal(frame.request, request);
    return frame;
}

static void two_thousand_frames_leave_nothing(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){.program = "causticd", .scene = "sphere"});
    struct wire *wire = wire_open(server.unix_address);
    uint64_t memory = 0;
    uint32_t descriptors = 0, view = 0;
    double device_bytes = 0, device_bytes_first = 0, begin = seconds_now();
    for (int i = 0; i < FRAMES; i++) {
        if (i % 100 == 0) {
            if (view)
                wire_expect_ok(wire, wire_view(wire, PROTOCOL_VIEW_DESTROY, view));
            view = wire_new_view(wire, 32, 24);
            wire_expect_ok(wire, wire_setting(wire, view, SETTING_photons, 512));
            wire_expect_ok(wire, wire_setting(wire, view, SETTING_cells, 16));
        }
        if (i % 10 == 5) {
            struct protocol_message resize = {
                .header.type = PROTOCOL_VIEW_RESIZE,
                .size = {.view = view, .width = 16 + (uint32_t)i % 30, .height = 16 + (uint32_t)i % 20}};
            wire_expect_ok(wire, wire_send(wire, &resize));
        }
        wire_expect_ok(wire, wire_time(wire, view, 0.01 * i));
        assert_int_equal(frame_of(wire, view, &device_bytes).number, i % 100);
        if (i == FRAMES_FIRST - 1) {
            memory = server_memory(&server);
            descriptors = server_descriptors(&server);
            device_bytes_first = device_bytes;
        }
    }
    uint64_t after = server_memory(&server);
    print_message("%.1f ms a frame; %.1f MB after %d frames, %.1f MB after %d; device %.1f MB, %.1f MB\n",
                  1e3 * (seconds_now() - begin) / FRAMES, 1e-6 * (double)memory, FRAMES_FIRST,
                  1e-6 * (double)after, FRAMES, 1e-6 * device_bytes_first, 1e-6 * device_bytes);
    /* 1800 frames with a leak of 4 KB each would show. */
    assert_true(after < memory + (6u << 20));
    assert_close(device_bytes, device_bytes_first, 0);
    assert_int_equal(server_descriptors(&server), descriptors);
    wire_close(&wire);
    server_stop(&server);
}

int main(void)
{
    program_needs_device();
    const struct CMUnitTest tests[] = {cmocka_unit_test(two_thousand_frames_leave_nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
