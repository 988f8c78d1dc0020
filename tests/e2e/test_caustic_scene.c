/* The program caustic-scene, as someone at a terminal meets it. */
#include <limits.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/check.h"
#include "tests/support/program.h"

static void assert_says(int status, const char *arguments, const char *said)
{
    program_expect(status, said, NULL, "caustic-scene %s", arguments);
}

static void test_list(void **state)
{
    (void)state;
    static const char *const names[] = {"sphere", "ring",  "square", "cornell",  "pool",
                                        "cube",   "prism", "empty",  "no-caster"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        assert_says(0, "list", names[i]);
}

static void test_info(void **state)
{
    (void)state;
    assert_says(0, "info square", "square: 42668 triangles in 4 instances");
    assert_says(0, "info square", "wine glass           21218 triangles, glass");
    assert_says(0, "info sphere", "lamp                 point, 40 40 40 W/sr, at 1.3 3.6 -0.7");
    assert_says(0, "info empty", "empty: 0 triangles");
}

static void test_export(void **state)
{
    (void)state;
    char path[256], arguments[600];
    const char *folder = getenv("TMPDIR");
    snprintf(path, sizeof path, "%s/causticd_%ld.glb", folder ? folder : "/tmp", (long)getpid());
    snprintf(arguments, sizeof arguments, "export cornell '%s'", path);
    assert_int_equal(program_run(NULL, "caustic-scene %s", arguments), 0);
    assert_string_equal(program_output, "");
    snprintf(arguments, sizeof arguments, "info '%s'", path);
    assert_says(0, arguments, "5130 triangles");
    remove(path);
}

static void test_help_and_mistakes(void **state)
{
    (void)state;
    assert_says(0, "--help", "caustic-scene export SCENE FILE.glb");
    assert_says(2, "", "--help tells more");
    assert_says(2, "paint sphere", "\"paint\"");
    assert_says(2, "info", "\"info\" with 0 arguments");
    assert_says(2, "export sphere out.obj", "must end in .glb");
    assert_says(1, "info spher", "there is no built-in scene \"spher\"; there are sphere, ring");
    assert_says(1, "info /nowhere/at/all.glb", "cannot open \"/nowhere/at/all.glb\": No such file");
    assert_says(1, "export sphere /nowhere/at/all.glb", "cannot write /nowhere/at/all.glb");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_list),
        cmocka_unit_test(test_info),
        cmocka_unit_test(test_export),
        cmocka_unit_test(test_help_and_mistakes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
