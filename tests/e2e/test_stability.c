/* caustic-stability as a program: one short run against the real renderer, everything else against the fake
 * one, which is quick and loses its device on request. */
#include <fcntl.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/stability/measures.h"
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"

static struct server_process server;
static char folder[] = "/tmp/test_stability_XXXXXX";

/* Runs caustic-stability with `name` in the test's folder as its --out, against the running server unless
 * `scene` is given. */
static int run(const char *name, const char *scene, const char *arguments)
{
    return program_run(NULL, "caustic-stability --out %s/%s %s %s %s", folder, name,
                       scene ? "--scene" : "--connect", scene ? scene : server.unix_address, arguments);
}

static json_t *report(const char *name)
{
    char path[256];
    json_error_t fault;
    snprintf(path, sizeof path, "%s/%s/report.json", folder, name);
    json_t *root = json_load_file(path, 0, &fault);
    if (!root)
        fail_msg("%s: %s", path, fault.text);
    return root;
}

static json_t *path_of(json_t *root, size_t index)
{
    return json_array_get(json_object_get(root, "paths"), index);
}

static double measure(json_t *path, const char *name)
{
    json_t *value = json_object_get(json_object_get(path, "measures"), name);
    if (!json_is_number(value))
        fail_msg("%s is no number", name);
    return json_number_value(value);
}

static void expect(int status, int wanted, const char *text)
{
    if (status != wanted || !strstr(program_output, text))
        fail_msg("exit %d, not %d with \"%s\": %s", status, wanted, text, program_output);
}

/* Enough of every kind of measure on the glass ball, on a server of its own: nothing moves, so once the task
 * buffers have settled a frame is the one before, bit by bit, and a light that moved is followed within three
 * frames. */
static void a_still_sphere_stands_still(void **state)
{
    (void)state;
    int status = run("still", "sphere",
                     "--path still,light-step --frames 16 --warmup 20 --size 64x36 --set photons=4096 "
                     "--accumulate 2 --fail-above flicker_p99=0.005 --fail-above light-step.frames_to_95=3");
    expect(status, 0, "flicker_p99");
    json_t *root = report("still"), *still = path_of(root, 0), *step = path_of(root, 1);
    assert_true(measure(still, "caustic_pixels") > 20);
    assert_close(measure(still, "flicker_largest"), 0, 0);
    assert_close(measure(still, "difference_largest"), 0, 0);
    assert_close(measure(still, "flip_largest"), 0, 0);
    assert_close(measure(still, "photons_oscillation"), 0, 0);
    assert_close(measure(still, "picture_drift"), 0, 0);
    assert_true(json_is_null(json_object_get(json_object_get(still, "measures"), "photons_period")));
    assert_in_bound(measure(still, "reference_error"), 0.5);
    assert_close(measure(step, "ghost_end"), 0, 1e-6); /* at rest again, nothing of it is left */
    /* At rest cells keep their samples; when the light moves they follow it. */
    json_t *photons = json_object_get(json_array_get(json_object_get(step, "series"), 0), "values");
    bool follows = false;
    for (size_t i = 16; i < json_array_size(photons); i++) {
        bool is_same = json_number_value(json_array_get(photons, i)) ==
                       json_number_value(json_array_get(photons, i - 1));
        assert_true(is_same || i >= 20);
        follows |= !is_same;
    }
    assert_true(follows);
    assert_in_bound(0.2, measure(step, "reference_change"));
    assert_in_bound(measure(step, "difference_rmse"), 0.5 * measure(step, "reference_change"));
    assert_int_equal(json_array_size(json_object_get(root, "limits")), 2);
    json_decref(root);
    struct stat page;
    char path[256];
    snprintf(path, sizeof path, "%s/still/report.html", folder);
    assert_int_equal(stat(path, &page), 0);
    assert_true(page.st_size > 20000);
}

/* Water's light is detail all over, so that every cell that moves to another number of strata shows. While
 * the view settles cells keep those that serve: three frames after a step 95 % of the way to rest are done.
 */
static void water_follows_a_light_step_in_three_frames(void **state)
{
    (void)state;
    int status = run("water", "pool",
                     "--path light-step --frames 16 --warmup 12 --size 240x135 --pairs 1 --accumulate 1 "
                     "--fail-above light-step.frames_to_95=3 --fail-above step_error_3=1.15");
    expect(status, 0, "frames_to_95");
    json_t *root = report("water");
    assert_true(measure(path_of(root, 0), "step_error_3") > 0.8); /* it compares with what has settled */
    json_decref(root);
}

#define SHORT "--size 32x18 --frames 16 --warmup 1 --pairs 1 --accumulate 2 --flicker-period 4 "

static void a_limit_is_a_gate(void **state)
{
    (void)state;
    /* The fake's pixels are noise: each channel has the deviation of a uniform distribution, 1/sqrt(3) of its
     * mean, and luminance that times the root of its weights' squares. */
    expect(run("gate", NULL, SHORT "--path still --fail-above flicker_p95=0.8 --fail-above flicker_mean=0.3"),
           1, "still.flicker_mean is 0.4");
    expect(run("gate", NULL, SHORT "--path still --fail-above still.flicker_mean=0.6"), 0, "report.html");
    json_t *root = report("gate");
    assert_close(measure(path_of(root, 0), "flicker_mean"), 0.7496 / sqrt(3), 0.02);
    json_decref(root);
}

/* The second setting loses the device after four frames: they are kept, and a second run with a working
 * server goes on where the first one stopped. */
static void a_lost_server_leaves_what_was_measured(void **state)
{
    (void)state;
    const char *arguments = SHORT "--path still,settings-flicker --flicker seed=1,2147483647 --resume";
    expect(run("lost", NULL, arguments), 1, "path settings-flicker, after 5 of 17 frames");
    assert_non_null(strstr(program_output, "--resume goes on from there"));
    json_t *root = report("lost"), *flicker = path_of(root, 1);
    assert_true(json_is_true(json_object_get(path_of(root, 0), "is_complete")));
    assert_true(json_is_false(json_object_get(flicker, "is_complete")));
    assert_non_null(json_string_value(json_object_get(flicker, "reason")));
    assert_int_equal(
        json_array_size(json_object_get(json_array_get(json_object_get(flicker, "series"), 0), "values")), 5);
    json_decref(root);
    server_clean(&server);
    expect(run("lost", NULL, arguments), 1, "--connect: ");
    server_start(&server, &(struct server_params){0});
    /* What was complete is kept, what was not is gone, and cut is new. */
    arguments = SHORT "--path still,cut --flicker seed=1,2147483647 --resume";
    expect(run("lost", NULL, arguments), 0, "frames_to_90");
    root = report("lost");
    assert_int_equal(json_array_size(json_object_get(root, "paths")), 2);
    assert_string_equal(json_string_value(json_object_get(path_of(root, 1), "path")), "cut");
    json_decref(root);
}

static void wrong_commands_exit_2(void **state)
{
    (void)state;
    static const char *const cases[][2] = {
        {"--path stil", "no path is called stil; there are still, orbit"},
        {"--path still,,cut", "write names with commas"},
        {"--frames 0", "--frames 0: must be between 1"},
        {"--frames 8 --path still", "--frames 8: too few to measure path still, which takes at least 16"},
        {"--frames 40 --path drift", "drift, which takes at least 64"},
        {"--frames many", "--frames many: not a number"},
        {"--warmup 0 --path cut", "path cut needs a picture from before it"},
        {"--size 0x9", "--size 0x9"},
        {"--set photons", "--set photons: write NAME=VALUE"},
        {"--frames 900000 --path cut --size 64x36",
         "path cut keeps its frames, and at 64x36 they take 30.9 GiB"},
        {"--seed -1", "--seed -1: must be between"},
        {"--flicker aa=filter", "write NAME=FIRST,SECOND"},
        {"--frames 16 --path settings-flicker --flicker-period 5", "four periods"},
        {"--fail-above flicker=1", "no measure is called flicker"},
        {"--path cut --fail-above flicker_p99=1", "no path that is run measures it; it takes still or drift"},
        {"--path cut --fail-above still.flicker_p99=1", "path still is not run"},
        {"--path orbit --pairs 0 --fail-above difference_rmse=1", "it takes references"},
        {"--connect nowhere", "write tcp:HOST:PORT or unix:PATH"},
        {"--scene sphere", "--connect and --scene exclude each other"},
        {"--eye 0,1,2", "--at is missing"},
        {"--bogus", "there is no option --bogus"},
        {"more", "more is no option"},
        {"--path", "--path needs a value"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect(run("wrong", NULL, cases[i][0]), 2, cases[i][1]);
}

static void what_the_server_refuses_exits_1(void **state)
{
    (void)state;
    static const char *const cases[][2] = {
        {SHORT "--path still --set phtons=1", "phtons"},
        {SHORT "--path still --set photons=-1", "photons"},
        {SHORT "--path still --channel causics", "no channel is called causics"},
        {SHORT "--path still --channel depth", "depth"},
        {SHORT "--path still --light moon", "no light is called moon"},
        {SHORT "--path still --camera nobody", "nobody"},
        {SHORT "--path settings-flicker --flicker aa=filter,sharp", "sharp"},
        {"--frames 16 --path still --size 60000x60000", "60000"},
        {SHORT "--path still --timeout 0.3 --set accumulate=1500", "no answer from the server in time"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect(run("refused", NULL, cases[i][0]), 1, cases[i][1]);
    expect(run("refused", "no-such-scene", SHORT "--path still"), 1, "no-such-scene");
    expect(run("refused", "no-caster", SHORT "--path still"), 1, "no caustic light to measure: no material");
    expect(run("../../../proc/nothing", NULL, SHORT "--path still"), 1, "--out");
}

static void a_file_that_is_no_report_is_not_overwritten(void **state)
{
    (void)state;
    char path[256];
    expect(run("odd", NULL, SHORT "--path still"), 0, "report.html");
    snprintf(path, sizeof path, "%s/odd/report.json", folder);
    int file = open(path, O_WRONLY | O_TRUNC);
    assert_int_equal(write(file, "{\"pa", 4), 4);
    close(file);
    expect(run("odd", NULL, SHORT "--path still --resume"), 1,
           "report.json is no report of caustic-stability");
}

static int set_up(void **state)
{
    (void)state;
    if (!mkdtemp(folder))
        return -1;
    server_start(&server, &(struct server_params){0});
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    char command[128];
    server_stop(&server);
    snprintf(command, sizeof command, "rm -r %s", folder);
    return system(command);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_still_sphere_stands_still),
        cmocka_unit_test(water_follows_a_light_step_in_three_frames),
        cmocka_unit_test(a_limit_is_a_gate),
        cmocka_unit_test(a_lost_server_leaves_what_was_measured),
        cmocka_unit_test(wrong_commands_exit_2),
        cmocka_unit_test(what_the_server_refuses_exits_1),
        cmocka_unit_test(a_file_that_is_no_report_is_not_overwritten),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
