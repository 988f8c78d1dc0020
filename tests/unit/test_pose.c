/* The scene at one time: interpolation against closed forms, looping, hierarchy, and what changed. */
#include <math.h>
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

#define PI 3.14159265358979323846

/* Two nodes, a camera under an animated one. The arrays are the test's own: the scene is never destroyed. */
static struct fixture {
    struct scene scene;
    struct scene_node nodes[2];
    struct scene_camera camera;
    struct scene_light light;
    struct scene_channel channels[3];
} fixture;

static struct scene *make_scene(void)
{
    fixture = (struct fixture){0};
    for (int i = 0; i < 2; i++)
        fixture.nodes[i] =
            (struct scene_node){.parent = i ? 0 : SCENE_NONE, .rotation = {0, 0, 0, 1}, .scale = {1, 1, 1}};
    fixture.nodes[1].translation[2] = -1;
    fixture.camera = (struct scene_camera){.node = 1, .yfov = 1};
    fixture.light = (struct scene_light){.node = 1};
    fixture.scene = (struct scene){.nodes = fixture.nodes,
                                   .cameras = &fixture.camera,
                                   .lights = &fixture.light,
                                   .channels = fixture.channels,
                                   .node_count = 2,
                                   .camera_count = 1,
                                   .light_count = 1};
    return &fixture.scene;
}

static void add_channel(enum animation_path path, enum animation_interpolation interpolation, uint32_t keys,
                        float *times, float *values)
{
    struct scene *scene = &fixture.scene;
    scene->channels[scene->channel_count++] = (struct scene_channel){.node = 0,
                                                                     .path = path,
                                                                     .interpolation = interpolation,
                                                                     .key_count = keys,
                                                                     .times = times,
                                                                     .values = values};
    scene->duration = fmaxf(scene->duration, times[keys - 1]);
}

static struct scene_pose *make_pose(const struct scene *scene)
{
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    return pose;
}

static void assert_eye(const struct scene_pose *pose, double x, double y, double z)
{
    assert_close((double)pose->cameras[0].eye[0], x, 1e-6);
    assert_close((double)pose->cameras[0].eye[1], y, 1e-6);
    assert_close((double)pose->cameras[0].eye[2], z, 1e-6);
}

static void test_step_and_linear(void **state)
{
    (void)state;
    static float times[3] = {0.5f, 1, 2}, values[9] = {0, 0, 0, 4, 0, 0, 4, 8, 0};
    for (int is_linear = 0; is_linear < 2; is_linear++) {
        struct scene *scene = make_scene();
        add_channel(ANIMATION_TRANSLATION, is_linear ? ANIMATION_LINEAR : ANIMATION_STEP, 3, times, values);
        struct scene_pose *pose = make_pose(scene);
        assert_eye(pose, 0, 0, -1); /* before the first key: its value */
        scene_pose_set_time(scene, pose, 0.75);
        assert_eye(pose, is_linear ? 2 : 0, 0, -1);
        scene_pose_set_time(scene, pose, 1);
        assert_eye(pose, 4, 0, -1);
        scene_pose_set_time(scene, pose, 1.25);
        assert_eye(pose, 4, is_linear ? 2 : 0, -1);
        scene_pose_destroy(&pose);
    }
}

/* A Hermite spline through the ends of x = t^3 over 2 s, with its exact slopes 0 and 12, is x = t^3. */
static void test_cubic(void **state)
{
    (void)state;
    static float times[2] = {0, 2}, values[18] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 12, 0, 0, 8, 0, 0, 0, 0, 0};
    struct scene *scene = make_scene();
    add_channel(ANIMATION_TRANSLATION, ANIMATION_CUBIC, 2, times, values);
    struct scene_pose *pose = make_pose(scene);
    for (double t = 0; t < 2; t += 0.13) {
        scene_pose_set_time(scene, pose, t);
        assert_eye(pose, t * t * t, 0, -1);
    }
    scene_pose_destroy(&pose);
}

/* From 0 to 120 degrees about y in one second, the second key with its sign turned: even angular speed, the
 * short way. */
static void test_slerp(void **state)
{
    (void)state;
    static float times[2] = {0, 1}, values[8] = {0, 0, 0, 1, 0, -0.86602540378f, 0, -0.5f};
    struct scene *scene = make_scene();
    add_channel(ANIMATION_ROTATION, ANIMATION_LINEAR, 2, times, values);
    struct scene_pose *pose = make_pose(scene);
    for (double t = 0; t < 1; t += 0.1) {
        double angle = t * 2 * PI / 3;
        scene_pose_set_time(scene, pose, t);
        assert_eye(pose, -sin(angle), 0, -cos(angle));
        assert_close((double)pose->cameras[0].forward[0], -sin(angle), 1e-6);
        assert_close((double)pose->lights[0].direction[2], -cos(angle), 1e-6);
    }
    scene_pose_destroy(&pose);
}

/* Equal keys, opposite keys and a zero quaternion: no division by zero, always a rotation. */
static void test_singular_rotations(void **state)
{
    (void)state;
    static float times[2] = {0, 1};
    static float cases[3][8] = {{0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0, 1, 0, 1, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}};
    for (int i = 0; i < 3; i++) {
        struct scene *scene = make_scene();
        add_channel(ANIMATION_ROTATION, ANIMATION_LINEAR, 2, times, cases[i]);
        struct scene_pose *pose = make_pose(scene);
        scene_pose_set_time(scene, pose, 0.5);
        const float *eye = pose->cameras[0].eye;
        assert_close((double)(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2]), 1, 1e-6);
        scene_pose_destroy(&pose);
    }
}

static void test_looping(void **state)
{
    (void)state;
    static float times[2] = {0, 4}, values[6] = {0, 0, 0, 4, 0, 0};
    struct scene *scene = make_scene();
    add_channel(ANIMATION_TRANSLATION, ANIMATION_LINEAR, 2, times, values);
    struct scene_pose *pose = make_pose(scene);
    static const double given[6] = {1, 5, 401, -1, -9, 3.5}, shown[6] = {1, 1, 1, 3, 3, 3.5};
    for (int i = 0; i < 6; i++) {
        scene_pose_set_time(scene, pose, given[i]);
        assert_eye(pose, shown[i], 0, -1);
    }
    /* No time at all is time 0. */
    scene_pose_set_time(scene, pose, (double)NAN);
    assert_eye(pose, 0, 0, -1);
    scene_pose_set_time(scene, pose, (double)INFINITY);
    assert_eye(pose, 0, 0, -1);
    scene_pose_destroy(&pose);
}

static void test_says_what_changed(void **state)
{
    (void)state;
    static float times[3] = {0, 1, 2}, values[9] = {0, 0, 0, 0, 0, 0, 1, 0, 0};
    struct scene *scene = make_scene();
    add_channel(ANIMATION_TRANSLATION, ANIMATION_LINEAR, 3, times, values);
    struct scene_pose *pose = make_pose(scene);
    assert_false(scene_pose_set_time(scene, pose, 0));   /* as created */
    assert_false(scene_pose_set_time(scene, pose, 0.5)); /* another time, the same picture */
    assert_true(scene_pose_set_time(scene, pose, 1.5));
    assert_false(scene_pose_set_time(scene, pose, 3.5)); /* one loop later */
    assert_true(scene_pose_set_time(scene, pose, 0));
    scene_pose_destroy(&pose);

    scene = make_scene(); /* nothing moves */
    pose = make_pose(scene);
    assert_false(scene_pose_set_time(scene, pose, 7));
    scene_pose_destroy(&pose);
}

/* A matrix with shear and mirroring, under a scaled parent: rows of 3x4, column-major as glTF has it. */
static void test_matrices(void **state)
{
    (void)state;
    struct scene *scene = make_scene();
    static struct scene_instance instance = {.node = 1, .mesh = 0};
    scene->instances = &instance;
    scene->instance_count = 1;
    fixture.nodes[0].scale[0] = -2;
    fixture.nodes[0].translation[1] = 10;
    fixture.nodes[1].has_matrix = true;
    static const float matrix[16] = {1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 10, 0, 11, 12, 13, 1};
    memcpy(fixture.nodes[1].matrix, matrix, sizeof matrix);
    struct scene_pose *pose = make_pose(scene);
    static const float expected[12] = {-2, -8, -14, -22, 2, 5, 8, 22, 3, 6, 10, 13};
    for (int i = 0; i < 12; i++)
        assert_close((double)pose->instance_to_world[0][i], (double)expected[i], 1e-6);
    const struct pose_camera *camera = &pose->cameras[0];
    double dot = 0, length = 0;
    for (int i = 0; i < 3; i++) {
        dot += (double)(camera->forward[i] * camera->up[i]);
        length += (double)(camera->up[i] * camera->up[i]);
    }
    assert_close(dot, 0, 1e-6);
    assert_close(length, 1, 1e-6);
    scene_pose_destroy(&pose);
}

/* Scales that overflow when multiplied leave the last finite transform standing. */
static void test_overflow(void **state)
{
    (void)state;
    static float times[2] = {0, 1}, values[6] = {1, 1, 1, 3e38f, 3e38f, 3e38f};
    struct scene *scene = make_scene();
    fixture.nodes[1].translation[2] = -1e30f;
    fixture.nodes[1].scale[0] = 3e38f;
    add_channel(ANIMATION_SCALE, ANIMATION_STEP, 2, times, values);
    struct scene_pose *pose = make_pose(scene);
    for (double t = 0; t < 1; t += 0.25) {
        scene_pose_set_time(scene, pose, t);
        for (int i = 0; i < 3; i++)
            assert_true(isfinite(pose->cameras[0].eye[i]) && isfinite(pose->cameras[0].forward[i]) &&
                        isfinite(pose->cameras[0].up[i]));
    }
    scene_pose_destroy(&pose);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_step_and_linear), cmocka_unit_test(test_cubic),
        cmocka_unit_test(test_slerp),           cmocka_unit_test(test_singular_rotations),
        cmocka_unit_test(test_looping),         cmocka_unit_test(test_says_what_changed),
        cmocka_unit_test(test_matrices),        cmocka_unit_test(test_overflow),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
