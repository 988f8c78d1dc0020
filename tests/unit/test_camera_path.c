/* Keyframe files: interpolation against closed forms, and what is refused. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "clients/lib/camera_path.h"

static struct error error;

static struct camera_path *parse(const char *text)
{
    struct camera_path *path = camera_path_parse(text, "keys.json", 0, &error);
    if (!path)
        fail_msg("%s", error.message);
    return path;
}

static void assert_near(float value, double expected)
{
    if (!(fabs((double)value - expected) < 1e-5 * (1 + fabs(expected))))
        fail_msg("%.9g where %.9g belongs", (double)value, expected);
}

static void keys_are_met_and_ends_stand_still(void **state)
{
    (void)state;
    static const char *const kinds[] = {"linear", "catmull-rom"};
    for (int kind = 0; kind < 2; kind++) {
        char text[400];
        snprintf(text, sizeof text,
                 "{\"interpolation\": \"%s\", \"keys\": ["
                 "{\"time\": 1, \"eye\": [0,1,4], \"at\": [0,0,0], \"fov\": 30},"
                 "{\"time\": 2, \"eye\": [2,1,3], \"at\": [0,0.5,0], \"up\": [0,0,1]},"
                 "{\"time\": 5, \"eye\": [3,2,-1], \"at\": [1,0,0]}]}",
                 kinds[kind]);
        struct camera_path *path = parse(text);
        struct protocol_camera camera = camera_path_at(path, 0, 1, 1);
        assert_true(camera.eye[0] == 0 && camera.eye[1] == 1 && camera.eye[2] == 4 && camera.fov == 30);
        assert_true(camera.up[0] == 0 && camera.up[1] == 1 && camera.up[2] == 0);
        camera = camera_path_at(path, 0, 1, 2);
        assert_true(camera.eye[0] == 2 && camera.at[1] == 0.5f && camera.up[2] == 1 && camera.fov == 45);
        camera = camera_path_at(path, 0, 1, 5);
        assert_true(camera.eye[0] == 3 && camera.eye[2] == -1);
        camera = camera_path_at(path, 0, 1, -7);
        assert_true(camera.eye[2] == 4);
        camera = camera_path_at(path, 0, 1, 100);
        assert_true(camera.eye[2] == -1);
        camera_path_destroy(&path);
        assert_null(path);
    }
}

/* Both kinds reproduce a straight line at constant speed, whatever the distance of the keys. The cubic also
 * reproduces t^2 between inner keys at equal distance, where its slopes are those of the parabola. */
static void polynomials_are_reproduced(void **state)
{
    (void)state;
    static const char *const kinds[] = {"linear", "catmull-rom"};
    for (int kind = 0; kind < 2; kind++) {
        char text[500];
        snprintf(text, sizeof text,
                 "{\"interpolation\": \"%s\", \"keys\": ["
                 "{\"time\": 0, \"eye\": [0,0,0], \"at\": [9,9,9]}, {\"time\": 0.5, \"eye\": [1,-1.5,2], "
                 "\"at\": [9,9,9]},"
                 "{\"time\": 3, \"eye\": [6,-9,12], \"at\": [9,9,9]}, {\"time\": 4, \"eye\": [8,-12,16], "
                 "\"at\": [9,9,9]}]}",
                 kinds[kind]);
        struct camera_path *path = parse(text);
        for (double t = 0; t <= 4; t += 0.0625) {
            struct protocol_camera camera = camera_path_at(path, 0, 1, t);
            assert_near(camera.eye[0], 2 * t);
            assert_near(camera.eye[1], -3 * t);
            assert_near(camera.eye[2], 4 * t);
        }
        camera_path_destroy(&path);
    }
    struct camera_path *path = parse(
        "{\"keys\": ["
        "{\"time\": 0, \"eye\": [0,0,9], \"at\": [0,0,0]}, {\"time\": 1, \"eye\": [1,0,9], \"at\": [0,0,0]},"
        "{\"time\": 2, \"eye\": [4,0,9], \"at\": [0,0,0]}, {\"time\": 3, \"eye\": [9,0,9], \"at\": "
        "[0,0,0]}]}");
    for (double t = 1; t <= 2; t += 0.0625)
        assert_near(camera_path_at(path, 0, 1, t).eye[0], t * t);
    /* No kink at a key: the slopes of both sides agree. */
    for (double key = 1; key <= 2; key++) {
        double left =
            (double)(camera_path_at(path, 0, 1, key).eye[0] - camera_path_at(path, 0, 1, key - 1e-3).eye[0]);
        double right =
            (double)(camera_path_at(path, 0, 1, key + 1e-3).eye[0] - camera_path_at(path, 0, 1, key).eye[0]);
        assert_true(fabs(left - right) < 1e-5 && fabs(left - 2e-3 * key) < 1e-5);
    }
    camera_path_destroy(&path);
}

static void places_are_times_frames_or_even(void **state)
{
    (void)state;
    struct camera_path *path = parse("{\"interpolation\": \"linear\", \"keys\": ["
                                     "{\"frame\": 10, \"eye\": [0,0,1], \"at\": [0,0,0]},"
                                     "{\"frame\": 20, \"eye\": [10,0,1], \"at\": [0,0,0]}]}");
    assert_near(camera_path_at(path, 0, 30, 99).eye[0], 0);
    assert_near(camera_path_at(path, 13, 30, 99).eye[0], 3);
    assert_near(camera_path_at(path, 29, 30, 99).eye[0], 10);
    camera_path_destroy(&path);
    path = parse("{\"interpolation\": \"linear\", \"keys\": ["
                 "{\"eye\": [0,0,1], \"at\": [0,0,0]}, {\"eye\": [1,0,1], \"at\": [0,0,0]},"
                 "{\"eye\": [3,0,1], \"at\": [0,0,0]}]}");
    assert_near(camera_path_at(path, 0, 9, 0).eye[0], 0);
    assert_near(camera_path_at(path, 2, 9, 0).eye[0], 0.5);
    assert_near(camera_path_at(path, 4, 9, 0).eye[0], 1);
    assert_near(camera_path_at(path, 8, 9, 0).eye[0], 3);
    assert_near(camera_path_at(path, 0, 1, 0).eye[0], 0);
    camera_path_destroy(&path);
    path = parse("{\"keys\": [{\"eye\": [5,0,1], \"at\": [0,0,0]}]}");
    assert_near(camera_path_at(path, 7, 9, 3).eye[0], 5);
    camera_path_destroy(&path);
}

static void bad_files_are_refused_by_name(void **state)
{
    (void)state;
    static const struct {
        const char *text, *named;
    } cases[] = {
        {"{\"keys\": [", "line 1"},
        {"[]", "needs \"keys\""},
        {"{}", "needs \"keys\""},
        {"{\"keys\": []}", "needs \"keys\""},
        {"{\"keys\": 3}", "needs \"keys\""},
        {"{\"keys\": [3]}", "keys[0] must be an object"},
        {"{\"interpolation\": \"cubic\", \"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0]}]}", "catmull-rom"},
        {"{\"interpolation\": 3, \"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0]}]}", "catmull-rom"},
        {"{\"keys\": [{\"at\": [0,0,0]}]}", "keys[0].eye is missing"},
        {"{\"keys\": [{\"eye\": [0,0,1]}]}", "keys[0].at is missing"},
        {"{\"keys\": [{\"eye\": [0,0], \"at\": [0,0,0]}]}", "keys[0].eye must be three numbers"},
        {"{\"keys\": [{\"eye\": [0,0,1,1], \"at\": [0,0,0]}]}", "keys[0].eye must be three numbers"},
        {"{\"keys\": [{\"eye\": [0,0,1e99], \"at\": [0,0,0]}]}", "keys[0].eye must be three numbers"},
        {"{\"keys\": [{\"eye\": [0,0,\"1\"], \"at\": [0,0,0]}]}", "keys[0].eye must be three numbers"},
        {"{\"keys\": [{\"eye\": [1,2,3], \"at\": [1,2,3]}]}", "must differ"},
        {"{\"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0], \"fov\": 0}]}", "keys[0].fov"},
        {"{\"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0], \"fov\": 179}]}", "keys[0].fov"},
        {"{\"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0], \"fov\": null}]}", "keys[0].fov"},
        {"{\"keys\": [{\"eye\": [0,0,1], \"at\": [0,0,0], \"tome\": 1}]}", "tome"},
        {"{\"keys\": [{\"time\": 0, \"frame\": 0, \"eye\": [0,0,1], \"at\": [0,0,0]}]}", "exclude"},
        {"{\"keys\": [{\"time\": 1, \"eye\": [0,0,1], \"at\": [0,0,0]}, {\"time\": 1, \"eye\": [0,0,1], "
         "\"at\": [0,0,0]}]}",
         "keys[1].time must be later"},
        {"{\"keys\": [{\"time\": 1, \"eye\": [0,0,1], \"at\": [0,0,0]}, {\"eye\": [0,0,1], \"at\": "
         "[0,0,0]}]}",
         "keys[1]"},
        {"{\"keys\": [{\"time\": \"1\", \"eye\": [0,0,1], \"at\": [0,0,0]}]}",
         "keys[0].time must be a number"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct camera_path *path = camera_path_parse(cases[i].text, "keys.json", 0, &error);
        if (path)
            fail_msg("accepted: %s", cases[i].text);
        if (!strstr(error.message, cases[i].named) || strncmp(error.message, "keys.json: ", 11) != 0)
            fail_msg("\"%s\" does not name %s", error.message, cases[i].named);
    }
    assert_null(camera_path_read("/nonexistent/keys.json", 0, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    /* Nesting without end is refused, not followed. */
    char *deep = malloc(1000001);
    assert_non_null(deep);
    memset(deep, '[', 1000000);
    deep[1000000] = 0;
    assert_null(camera_path_parse(deep, "keys.json", 0, &error));
    free(deep);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(keys_are_met_and_ends_stand_still),
        cmocka_unit_test(polynomials_are_reproduced),
        cmocka_unit_test(places_are_times_frames_or_even),
        cmocka_unit_test(bad_files_are_refused_by_name),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
