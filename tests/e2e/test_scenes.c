/* Every built-in scene through the real server under the validation layer: frames arrive, and nobody
 * complains. */
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"
#include "tests/support/wire.h"

#include "core/render/renderer.h"

#include <signal.h>
#include <string.h>

#define ALL_CHANNELS ((1u << CHANNEL_COUNT) - 1)

static void serve(const char *scene)
{
    struct server_process server;
    server_start(&server, &(struct server_params){
                              .program = "causticd", .scene = scene, .arguments = {"--validation"}});
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 64, 36);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_photons, 4096));
    wire_expect_frame(wire, wire_render(wire, view, ALL_CHANNELS));
    /* What changes buffers between frames, and each way to splat and to split; in all more pipelines than a
     * renderer keeps. */
    static const struct {
        uint32_t setting;
        double value;
    } changes[] = {{SETTING_aa, SPLAT_AA_NONE},
                   {SETTING_aa, SPLAT_AA_PIXEL},
                   {SETTING_aa, SPLAT_AA_MSAA_SMALL},
                   {SETTING_split, SPLIT_ONCE},
                   {SETTING_split, SPLIT_ROULETTE},
                   {SETTING_density, DENSITY_AREA},
                   {SETTING_density, DENSITY_UNIFORM},
                   {SETTING_cells, 64},
                   {SETTING_photons, 20000},
                   {SETTING_tile, TILE_FIT_FULL},
                   {SETTING_accumulate, 2}};
    for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
        wire_expect_ok(wire, wire_setting(wire, view, changes[i].setting, changes[i].value));
        wire_expect_frame(wire, wire_render(wire, view, i % 2 ? ALL_CHANNELS : 1u << CHANNEL_CAUSTICS));
    }
    struct protocol_message resize = {.header.type = PROTOCOL_VIEW_RESIZE,
                                      .size = {.view = view, .width = 33, .height = 47}};
    wire_expect_ok(wire, wire_send(wire, &resize));
    wire_expect_ok(wire, wire_time(wire, view, 0.5));
    wire_expect_frame(wire, wire_render(wire, view, ALL_CHANNELS));
    wire_close(&wire);
    assert_int_equal(server_wait(&server, SIGTERM, 60), 0);
    char *log = server_log(&server);
    bool is_clean = !strstr(log, "warning: ") && !strstr(log, "error: ");
    if (!is_clean)
        print_error("%s: %s\n", scene, log);
    free(log);
    server_clean(&server);
    assert_true(is_clean);
}

static void every_builtin_scene_is_clean(void **state)
{
    (void)state;
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        double begin = seconds_now();
        serve(builtin_scenes[i].name);
        print_message("%s: %.1f s\n", builtin_scenes[i].name, seconds_now() - begin);
    }
}

int main(void)
{
    program_needs_device();
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_builtin_scene_is_clean)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
