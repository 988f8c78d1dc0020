/* Files beside a scene: read from its own folder and below, and from nowhere else. */
#include <limits.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

/* base/outside.bin, base/scene/scene.gltf, base/scene/inner/data.bin, and links between them. */
static char base[PATH_MAX];
static const float points[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};

static void path_of(char *path, const char *name)
{
    assert_true(snprintf(path, PATH_MAX, "%s/%s", base, name) < PATH_MAX);
}

static void write_file(const char *name, const void *bytes, size_t size)
{
    char path[PATH_MAX];
    path_of(path, name);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    fclose(file);
}

static void make_folder(const char *name)
{
    char path[PATH_MAX];
    path_of(path, name);
    assert_int_equal(mkdir(path, 0700), 0);
}

static void make_link(const char *name, const char *target)
{
    char path[PATH_MAX];
    path_of(path, name);
    assert_int_equal(symlink(target, path), 0);
}

static int set_up(void **state)
{
    (void)state;
    const char *folder = getenv("TMPDIR");
    snprintf(base, sizeof base, "%s/causticd_test_XXXXXX", folder ? folder : "/tmp");
    assert_non_null(mkdtemp(base));
    make_folder("scene");
    make_folder("scene/inner");
    make_folder("scene-and-more");
    write_file("outside.bin", points, sizeof points);
    write_file("scene-and-more/data.bin", points, sizeof points);
    write_file("scene/data.bin", points, sizeof points);
    write_file("scene/inner/a file.bin", points, sizeof points);
    write_file("scene/short.bin", points, 35);
    make_link("scene/leaves.bin", "../outside.bin");
    make_link("scene/stays.bin", "inner/a file.bin");
    make_link("scene/up", "..");
    make_link("link.gltf", "scene/scene.gltf");
    char path[PATH_MAX];
    path_of(path, "scene/pipe.bin");
    assert_int_equal(mkfifo(path, 0600), 0);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    static const char *const names[] = {"scene/scene.gltf",
                                        "scene/pipe.bin",
                                        "scene/up",
                                        "scene/stays.bin",
                                        "scene/leaves.bin",
                                        "scene/short.bin",
                                        "scene/inner/a file.bin",
                                        "scene/data.bin",
                                        "outside.bin",
                                        "scene-and-more/data.bin",
                                        "link.gltf",
                                        "scene/inner",
                                        "scene",
                                        "scene-and-more",
                                        ""};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        char path[PATH_MAX];
        path_of(path, names[i]);
        remove(path);
    }
    return 0;
}

static struct scene *import_with(const char *opened, const char *uri, struct error *error)
{
    char text[PATH_MAX + 1024], path[PATH_MAX];
    int length =
        snprintf(text, sizeof text,
                 "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{"
                 "\"attributes\":{\"POSITION\":0}}]}],\"buffers\":[{\"byteLength\":36,\"uri\":\"%s\"}],"
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,"
                 "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]}",
                 uri);
    write_file("scene/scene.gltf", text, (size_t)length);
    path_of(path, opened);
    return scene_import(path, error);
}

static void test_reads_own_folder(void **state)
{
    (void)state;
    static const char *const uris[] = {"data.bin",          "./data.bin", "inner/a%20file.bin",
                                       "inner/../data.bin", "stays.bin",  "up/scene/data.bin"};
    for (size_t i = 0; i < sizeof uris / sizeof *uris; i++) {
        struct error error = {0};
        struct scene *scene = import_with("scene/scene.gltf", uris[i], &error);
        if (!scene)
            print_error("%s: %s\n", uris[i], error.message);
        assert_non_null(scene);
        assert_int_equal(scene->triangle_count, 1);
        scene_destroy(&scene);
    }
}

static void test_refuses_the_rest(void **state)
{
    (void)state;
    char absolute[PATH_MAX];
    path_of(absolute, "scene/data.bin");
    const struct {
        const char *uri, *said;
    } cases[] = {
        {"../outside.bin", "leaves the scene's folder"},
        {"inner/../../outside.bin", "leaves the scene's folder"},
        {"%2e%2e/outside.bin", "leaves the scene's folder"},
        {"..%2foutside.bin", "leaves the scene's folder"},
        {"../scene-and-more/data.bin", "leaves the scene's folder"},
        {"leaves.bin", "leaves the scene's folder"},
        {"up/outside.bin", "leaves the scene's folder"},
        {"/etc/passwd", "no absolute paths"},
        {absolute, "no absolute paths"},
        {"file:///etc/passwd", "no URLs"},
        {"http://localhost/data.bin", "no URLs"},
        {"missing.bin", "missing.bin"},
        {"inner", "not a regular file"},
        {"pipe.bin", "not a regular file"},
        {"data.bin%00.png", "malformed"},
        {"short.bin", "size mismatch"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct error error = {0};
        struct scene *scene = import_with("scene/scene.gltf", cases[i].uri, &error);
        if (scene || !strstr(error.message, cases[i].said)) {
            print_error("%s: %s\n", cases[i].uri, scene ? "imported" : error.message);
            fail();
        }
    }
}

/* A scene opened through a link reads from where it really lies. */
static void test_follows_the_scene_itself(void **state)
{
    (void)state;
    struct error error = {0};
    struct scene *scene = import_with("link.gltf", "data.bin", &error);
    assert_non_null(scene);
    scene_destroy(&scene);
    assert_null(import_with("link.gltf", "outside.bin", &error));
}

static void test_scene_open(void **state)
{
    (void)state;
    struct error error = {0};
    char path[PATH_MAX];
    path_of(path, "scene/none.GLB");
    assert_null(scene_open(path, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    assert_non_null(strstr(error.message, "none.GLB"));
    path_of(path, "scene");
    assert_null(scene_import(path, &error));
    assert_non_null(strstr(error.message, "not a regular file"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reads_own_folder),
        cmocka_unit_test(test_refuses_the_rest),
        cmocka_unit_test(test_follows_the_scene_itself),
        cmocka_unit_test(test_scene_open),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
