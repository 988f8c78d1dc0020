/* The program caustic-scene, as someone at a terminal meets it. */
#include <limits.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/check.h"

/* Runs it with arguments and collects stdout and stderr together. Returns the exit status. */
static int run(char *output, size_t size, const char *arguments)
{
    char command[PATH_MAX + 512];
    const char *folder = getenv("CAUSTICD_BIN_DIR");
    snprintf(command, sizeof command, "'%s/caustic-scene' %s 2>&1", folder ? folder : "bin", arguments);
    FILE *pipe = popen(command, "r");
    assert_non_null(pipe);
    size_t length = fread(output, 1, size - 1, pipe);
    output[length] = 0;
    int status = pclose(pipe);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

static void assert_says(int status, const char *arguments, const char *said)
{
    char output[16384];
    int got = run(output, sizeof output, arguments);
    if (got != status || !strstr(output, said)) {
        print_error("caustic-scene %s: exit %d, wanted %d and \"%s\"\n%s\n", arguments, got, status, said,
                    output);
        fail();
    }
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
    char path[256], arguments[600], output[4096];
    const char *folder = getenv("TMPDIR");
    snprintf(path, sizeof path, "%s/causticd_%ld.glb", folder ? folder : "/tmp", (long)getpid());
    snprintf(arguments, sizeof arguments, "export cornell '%s'", path);
    assert_int_equal(run(output, sizeof output, arguments), 0);
    assert_string_equal(output, "");
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
