/* caustic-record against a peer whose pixels are known: every file it writes, and every way to call it
 * wrongly. */
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

#include "clients/lib/camera_path.h"
#include "core/image/image_io.h"
#include "tests/support/fake_peer.h"
#include "tests/support/program.h"

static struct error error;
static char folder[] = "/tmp/test_record_XXXXXX", server_address[64];

/* Runs caustic-record in `folder`, Returns its exit status. */
static int run(const char *arguments)
{
    return program_run(folder, "caustic-record %s", arguments);
}

/* The same with a server of its own, which has no caustics. Returns the exit status; *requests what the
 * server took. */
static int run_served(const char *arguments, enum fake_fault fault, uint32_t *requests)
{
    char path[96], whole[2048];
    snprintf(path, sizeof path, "%s/socket", folder);
    unlink(path);
    struct fake_peer *peer = fake_peer_start(-1, path, fault);
    snprintf(whole, sizeof whole, "--connect %s --channels beauty %s", server_address, arguments);
    int status = run(whole);
    *requests = fake_peer_stop(&peer);
    return status;
}

static const char *in_folder(const char *name)
{
    static char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static void assert_plane(const struct image_file *file, const char *name, uint32_t channel, uint64_t frame,
                         uint32_t c)
{
    const float *values = image_file_plane(file, name);
    if (!values)
        fail_msg("no plane %s", name);
    for (uint32_t y = 0; y < file->height; y++)
        for (uint32_t x = 0; x < file->width; x++)
            if (values[y * file->width + x] != fake_peer_value(channel, frame, x, y, c))
                fail_msg("%s at %u, %u", name, x, y);
}

static void frames_become_files(void **state)
{
    (void)state;
    uint32_t requests;
    int status =
        run_served("--size 70x41 --frames 3 --warmup 2 --eye 1,2,3 --at 0,0.5,0 --fov 33 --time 0.5 --fps 4 "
                   "--set photons=777 --set aa=pixel --set seed=42 --light lamp.one.intensity=4,5,6 "
                   "--channels all --png --out made/by/record",
                   FAKE_HONEST, &requests);
    if (status != 0)
        fail_msg("%s", program_output);
    /* CHOOSE, VIEW_CREATE, three settings, light, camera, three times, five frames. */
    assert_int_equal(requests, 15);
    for (uint32_t i = 0; i < 3; i++) {
        char name[64];
        snprintf(name, sizeof name, "made/by/record/frame_%04u.exr", i);
        struct image_file *file = image_read_exr(in_folder(name), &error);
        if (!file)
            fail_msg("%s", error.message);
        assert_int_equal(file->width, 70);
        assert_int_equal(file->height, 41);
        assert_int_equal(file->plane_count, 4);
        assert_plane(file, "R", 0, i + 2, 0);
        assert_plane(file, "G", 0, i + 2, 1);
        assert_plane(file, "B", 0, i + 2, 2);
        assert_plane(file, "Z", 1, i + 2, 0);
        image_file_destroy(&file);
        snprintf(name, sizeof name, "made/by/record/density_%04u.exr", i);
        file = image_read_exr(in_folder(name), &error);
        assert_non_null(file);
        assert_int_equal(file->width, 20);
        assert_int_equal(file->height, 12);
        assert_plane(file, "density", 2, i + 2, 0);
        image_file_destroy(&file);
        snprintf(name, sizeof name, "made/by/record/frame_%04u.png", i);
        assert_int_equal(access(in_folder(name), R_OK), 0);
    }
    const char *exr = in_folder("made/by/record/frame_0001.exr");
    char text[64];
    float matrix[16];
    assert_true(image_read_exr_matrix(exr, "worldToCamera", matrix, &error));
    assert_true(matrix[1] == 1 && matrix[15] == 15);
    assert_true(image_read_exr_matrix(exr, "cameraToClip", matrix, &error));
    assert_true(matrix[0] == 100);
    assert_true(image_read_exr_string(exr, "caustic.photons", text, sizeof text, &error));
    assert_string_equal(text, "777");
    assert_true(image_read_exr_string(exr, "caustic.aa", text, sizeof text, &error));
    assert_string_equal(text, "pixel");
    assert_true(image_read_exr_string(exr, "caustic.version", text, sizeof text, &error));
    assert_string_equal(text, "fake 1.2.3");
    /* The closing table: the median of 1.000002, 1.000003 and 1.000004 ms. */
    assert_non_null(strstr(program_output, "trace"));
    assert_non_null(strstr(program_output, "photons_emitted"));
    assert_non_null(strstr(program_output, "1 of 1 guards"));
}

static void statistics_are_written(void **state)
{
    (void)state;
    uint32_t requests;
    int status =
        run_served("--size 32x16 --frames 2 --camera main --light lamp.one.position=1,2,3 --set gain=2.5 "
                   "--set jitter=on --channels beauty --quiet --out stats",
                   FAKE_HONEST, &requests);
    assert_int_equal(status, 0);
    assert_string_equal(program_output, "");
    json_error_t fault;
    json_t *root = json_load_file(in_folder("stats/stats.json"), 0, &fault);
    if (!root)
        fail_msg("%s", fault.text);
    const char *version, *scene, *unit, *aa, *reason, *file;
    json_int_t frames, trace, emitted, guard, number;
    double gain, flux, time;
    int jitter, used;
    assert_int_equal(json_unpack_ex(root, &fault, 0, "{s:{s:s}, s:{s:s}, s:{s:s}, s:{s:s, s:F, s:b}}",
                                    "server", "version", &version, "scene", "name", &scene, "units",
                                    "flux_emitted", &unit, "settings", "aa", &aa, "gain", &gain, "jitter",
                                    &jitter),
                     0);
    assert_string_equal(version, "fake 1.2.3");
    assert_string_equal(scene, "fake");
    assert_string_equal(unit, "W");
    assert_string_equal(aa, "filter");
    assert_true(gain == 2.5 && jitter);
    json_t *lamp = json_object_get(json_object_get(root, "lights"), "lamp.one");
    assert_int_equal(json_object_size(lamp), 1);
    for (size_t axis = 0; axis < 3; axis++)
        assert_int_equal(json_integer_value(json_array_get(json_object_get(lamp, "position"), axis)),
                         axis + 1);
    json_t *list = json_object_get(root, "frames");
    assert_int_equal(json_array_size(list), 2);
    if (json_unpack_ex(json_array_get(list, 1), &fault, 0,
                       "{s:I, s:I, s:s, s:F, s:{s:I}, s:{s:I}, s:{s:F}, s:{s:I}, s:[{s:b, s:s}]}", "number",
                       &number, "frame", &frames, "file", &file, "time", &time, "passes_ns", "trace", &trace,
                       "statistics", "photons_emitted", &emitted, "flux_by_fate", "emitted", &flux, "guards",
                       "density", &guard, "plan", "used", &used, "reason", &reason) != 0)
        fail_msg("%s", fault.text);
    assert_int_equal(number, 1);
    assert_int_equal(frames, 1);
    assert_string_equal(file, "frame_0001.exr");
    assert_true(time == 1 / 24.0);
    assert_int_equal(trace, 1000001);
    assert_int_equal(emitted, 100);
    assert_true(flux == 0.5);
    assert_int_equal(guard, 0);
    assert_false(used);
    assert_string_equal(reason, "no water");
    json_decref(root);
}

static void paths_move_the_camera(void **state)
{
    (void)state;
    uint32_t requests;
    FILE *keys = fopen(in_folder("keys.json"), "w");
    assert_non_null(keys);
    fputs("{\"interpolation\": \"linear\", \"keys\": [{\"eye\": [0,0,4], \"at\": [0,0,0]},"
          "{\"eye\": [8,0,4], \"at\": [0,0,0]}]}",
          keys);
    fclose(keys);
    int status = run_served("--size 16x16 --frames 5 --fps 0 --path keys.json --channels depth --out path",
                            FAKE_HONEST, &requests);
    if (status != 0)
        fail_msg("%s", program_output);
    struct camera_path *path = camera_path_read(in_folder("keys.json"), 0, &error);
    json_t *root = json_load_file(in_folder("path/stats.json"), 0, NULL);
    assert_true(path && root);
    for (uint32_t i = 0; i < 5; i++) {
        json_t *frame = json_array_get(json_object_get(root, "frames"), i);
        json_t *eye = json_object_get(json_object_get(frame, "camera"), "eye");
        struct protocol_camera camera = camera_path_at(path, i, 5, 0);
        for (size_t axis = 0; axis < 3; axis++)
            assert_true(json_number_value(json_array_get(eye, axis)) == (double)camera.eye[axis]);
        assert_true(camera.eye[0] == 2.0f * (float)i);
    }
    json_decref(root);
    camera_path_destroy(&path);
}

static void two_recordings_are_the_same(void **state)
{
    (void)state;
    uint32_t requests;
    static const char *const ways[] = {"--out a", "--out b --format f16 --tile-encoding raw"};
    for (int i = 0; i < 2; i++) {
        char arguments[200];
        snprintf(arguments, sizeof arguments, "--size 50x30 --channels beauty,depth --png %s", ways[i]);
        assert_int_equal(run_served(arguments, FAKE_HONEST, &requests), 0);
        usleep(1100000); /* a time of day in a file would differ now */
    }
    /* The peer's values are exact in both formats: the files may differ in nothing. */
    static uint8_t bytes[2][1 << 16];
    static const char *const names[][2] = {{"a/frame_0000.exr", "b/frame_0000.exr"},
                                           {"a/frame_0000.png", "b/frame_0000.png"}};
    for (int n = 0; n < 2; n++) {
        size_t sizes[2];
        for (int i = 0; i < 2; i++) {
            FILE *file = fopen(in_folder(names[n][i]), "rb");
            assert_non_null(file);
            sizes[i] = fread(bytes[i], 1, sizeof bytes[i], file);
            fclose(file);
        }
        assert_true(sizes[0] > 0 && sizes[0] < sizeof bytes[0]);
        assert_int_equal(sizes[0], sizes[1]);
        assert_memory_equal(bytes[0], bytes[1], sizes[0]);
    }
}

static void wrong_commands_exit_2(void **state)
{
    (void)state;
    static const struct {
        const char *arguments, *named;
    } cases[] = {
        {"--frobnicate", "--frobnicate"},
        {"--set", "--set needs a value"},
        {"--set photons", "NAME=VALUE"},
        {"--light x.y=1,2,3", "intensity, position and direction"},
        {"--light intensity=1,2,3", "NAME.intensity"},
        {"--light a.intensity=1,2", "three numbers"},
        {"--eye 0,1,4", "--at is missing"},
        {"--at 0,1,4", "--eye is missing"},
        {"--eye 0,1 --at 0,0,0", "--eye 0,1"},
        {"--eye 0,1,inf --at 0,0,0", "--eye"},
        {"--size 0x5", "--size 0x5"},
        {"--size 5", "--size 5"},
        {"--size 5x5x5", "--size"},
        {"--size -5x5", "--size"},
        {"--frames 0", "--frames 0"},
        {"--frames 1.5", "whole"},
        {"--fov 45", "--fov"},
        {"--eye 0,0,1 --at 0,0,0 --fov 180", "--fov 180"},
        {"--time nan", "--time nan"},
        {"--fps -1", "--fps -1"},
        {"--format f8", "f32 or f16"},
        {"--tile-encoding lz4", "zstd or raw"},
        {"--connect localhost", "tcp:HOST:PORT"},
        {"--camera a --path b", "exclude"},
        {"--camera a --eye 0,0,1 --at 0,0,0", "exclude"},
        {"stray", "stray"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int status = run(cases[i].arguments);
        if (status != 2 || !strstr(program_output, cases[i].named))
            fail_msg("%s: %d, \"%s\"", cases[i].arguments, status, program_output);
    }
    assert_int_equal(run("--help"), 0);
    assert_non_null(strstr(program_output, "--tile-encoding"));
    assert_int_equal(run("--version"), 0);
}

static void failures_exit_1_and_name_the_option(void **state)
{
    (void)state;
    uint32_t requests;
    static const struct {
        const char *arguments, *named;
        enum fake_fault fault;
    } cases[] = {
        {"--size 9000x10", "--size: width", FAKE_HONEST},
        {"--set photon=1", "--set: no setting is called photon", FAKE_HONEST},
        {"--set photons=0.5", "--set: photons: 0.5 is not a whole number", FAKE_HONEST},
        {"--set aa=blur", "filter,none,pixel", FAKE_HONEST},
        {"--light sun.intensity=1,2,3", "--light: no light is called sun; there are lamp.one", FAKE_HONEST},
        {"--camera side", "--camera side: the scene has main", FAKE_HONEST},
        {"--channels beauty,,depth", "--channels", FAKE_HONEST},
        {"--channels colour", "beauty, depth, density", FAKE_HONEST},
        {"--path missing.json", "missing.json", FAKE_HONEST},
        {"--channels beauty --out socket", "--out: socket", FAKE_HONEST},
        {"--channels depth --png", "--png needs beauty", FAKE_HONEST},
        {"--channels beauty", "frame 0: the server closed", FAKE_CLOSES_IN_FRAME},
        {"--channels beauty", "enough clients", FAKE_REFUSES},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        if (strstr(cases[i].arguments, "missing.json")) {
            assert_int_equal(run(cases[i].arguments), 1); /* it never connects */
            assert_non_null(strstr(program_output, cases[i].named));
            continue;
        }
        int status = run_served(cases[i].arguments, cases[i].fault, &requests);
        if (status != 1 || !strstr(program_output, cases[i].named))
            fail_msg("%s: %d, \"%s\"", cases[i].arguments, status, program_output);
    }
    assert_int_equal(run("--connect unix:nobody"), 1);
    assert_non_null(strstr(program_output, "is causticd running?"));
}

static int set_up(void **state)
{
    (void)state;
    if (!mkdtemp(folder))
        return -1;
    snprintf(server_address, sizeof server_address, "unix:%s/socket", folder);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    char command[128];
    snprintf(command, sizeof command, "rm -r %s", folder);
    return system(command);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(frames_become_files),   cmocka_unit_test(statistics_are_written),
        cmocka_unit_test(paths_move_the_camera), cmocka_unit_test(two_recordings_are_the_same),
        cmocka_unit_test(wrong_commands_exit_2), cmocka_unit_test(failures_exit_1_and_name_the_option),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
