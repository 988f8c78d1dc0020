/* caustic-bench against a real server: what it writes is what was rendered, an interrupted run goes on, a
 * comparison judges; and, against a server that renders nothing, every way to use it wrongly. */
#include <fcntl.h>
#include <jansson.h>
#include <signal.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/bench/bench_reference.h"
#include "core/image/image_io.h"
#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/program.h"

static struct error error;
static char folder[] = "/tmp/test_bench_e2e_XXXXXX";

/* Runs caustic-bench in `folder`, Returns its exit status. */
static int run(const char *arguments)
{
    return program_run(folder, "caustic-bench --cache refs %s", arguments);
}

/* The same on the server without a renderer. */
static int run_fake(const char *arguments)
{
    char whole[2048];
    snprintf(whole, sizeof whole,
             "--server \"$CAUSTICD_BIN_DIR/causticd-fake\" --size 32x18 --warmup 0 --repeats 1 %s",
             arguments);
    return run(whole);
}

static const char *in_folder(const char *name)
{
    static char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static void assert_said(const char *expected)
{
    if (!strstr(program_output, expected))
        fail_msg("it did not say \"%s\" but:\n%s", expected, program_output);
}

static void write_file(const char *name, const char *text)
{
    FILE *file = fopen(in_folder(name), "w");
    assert_non_null(file);
    fputs(text, file);
    fclose(file);
}

static struct bench_results read_results(const char *name)
{
    struct bench_results results;
    if (!bench_results_read(&results, in_folder(name), &error))
        fail_msg("%s", error.message);
    return results;
}

static float *read_picture(const char *name)
{
    uint32_t width, height;
    float *values = bench_image_read(in_folder(name), &width, &height, &error);
    if (!values)
        fail_msg("%s", error.message);
    assert_true(width == 64 && height == 36);
    return values;
}

#define SPHERE                                                                                               \
    "--scene sphere --size 64x36 --warmup 3 --repeats 2 --reference-photons 3e5 --metric "                   \
    "rell1,hdrflip,flux "

/* What is in results.json is what the pictures beside it say, and what the renderer is known to do. */
static void points_are_measured(void **state)
{
    (void)state;
    if (run(SPHERE "--set photons=1024,8192 --out real") != 0)
        fail_msg("%s", program_output);
    assert_said("2 points measured, 0 kept");
    /* No terminal: lines in place of the bar. */
    assert_said(" reference of sphere");
    assert_said("5/10 sphere photons=1024, ");
    assert_said(" left\n");
    assert_said("10/10 sphere photons=8192\n");
    assert_null(strchr(program_output, '\r'));
    struct bench_results results = read_results("real/results.json");
    assert_int_equal(results.count, 2);
    assert_int_equal(results.reference_count, 1);
    const struct bench_reference_note *note = &results.references[0];
    assert_true(note->photons >= 2.5e5 && note->noise > 0 && note->noise < 0.05);
    char reference[BENCH_PATH];
    snprintf(reference, sizeof reference, "%.500s", note->file);
    float *truth = read_picture(reference);
    for (uint32_t i = 0; i < 2; i++) {
        const struct bench_result *result = &results.results[i];
        float *values = read_picture(strcat(strcpy(reference, "real/"), result->image));
        struct measure_image image = {values, 64, 36, 3}, expected = {truth, 64, 36, 3};
        /* The picture is of the last of two repeats: its error is one of the two. */
        double rell1 = measure_relative_l1(&image, &expected);
        const struct bench_spread *spread = &result->measures[METRIC_RELL1];
        double first = 2 * spread->median - rell1;
        assert_true(fmin(first, rell1) >= spread->least * (1 - 1e-6));
        assert_true(fabs(fmin(first, rell1) - spread->least) < 1e-6);
        assert_true(fabs(result->measures[METRIC_FLUX].median) < 0.05);
        assert_true(isnan(result->measures[METRIC_RMSE].median));
        double photons = bench_quantity(result, "photons"), budget = i ? 8192 : 1024;
        assert_true(photons > 0.25 * budget && photons <= budget);
        assert_true(bench_quantity(result, "rays") > photons);
        assert_true(bench_quantity(result, "memory_mib") > 0);
        /* Passes are in the device's time, that in the server's, and that in what was waited. */
        assert_true(bench_quantity(result, "passes_ms") <= 1.01 * bench_quantity(result, "gpu_ms"));
        assert_true(result->gpu_ns.least > 0 && result->gpu_ns.least <= result->gpu_ns.median);
        assert_true(result->frame_ns.least <= result->wall_ns.least);
        free(values);
    }
    assert_true(results.results[1].measures[METRIC_RELL1].median <
                0.8 * results.results[0].measures[METRIC_RELL1].median);
    free(truth);
    bench_results_free(&results);

    char csv[8192];
    FILE *file = fopen(in_folder("real/results.csv"), "r");
    size_t size = fread(csv, 1, sizeof csv - 1, file);
    csv[size] = 0;
    fclose(file);
    assert_true(strncmp(csv, "scene,method,photons,width,", 27) == 0);
    assert_non_null(strstr(csv, "\nsphere,,8192,64,36,"));
    struct stat status;
    assert_int_equal(stat(in_folder("real/report.html"), &status), 0);
    assert_true(status.st_size > 20000);
}

/* The results.json of `real` with `factor` times the errors, as another run's. */
static void doctor(const char *name, double factor)
{
    struct bench_results results = read_results("real/results.json");
    for (uint32_t i = 0; i < results.count; i++)
        results.results[i].measures[METRIC_RELL1].median *= factor;
    assert_true(bench_results_write(&results, in_folder(name), &error));
    bench_results_free(&results);
}

static void a_run_goes_on_and_is_compared(void **state)
{
    (void)state;
    doctor("better.json", 0.5);
    doctor("same.json", 0.97);
    struct bench_results before = read_results("real/results.json");
    /* Nothing is left to do but to compare. */
    assert_int_equal(run(SPHERE "--set photons=1024,8192 --out real --compare better.json"), 1);
    assert_said("0 points measured, 2 kept");
    assert_said("worse  sphere photons=1024");
    assert_said("2 points in both runs: 2 worse, 0 better");
    /* Only the point that is new is measured. */
    assert_int_equal(run(SPHERE "--set photons=1024,8192,2048 --out real --compare same.json"), 0);
    assert_said("1 points measured, 2 kept");
    assert_said("2 points in both runs: 0 worse, 0 better; 0 only in the earlier run, 1 only in this one");
    struct bench_results after = read_results("real/results.json");
    assert_int_equal(after.count, 3);
    for (uint32_t i = 0; i < 2; i++) {
        assert_string_equal(before.results[i].key, after.results[i].key);
        assert_true(before.results[i].gpu_ns.median == after.results[i].gpu_ns.median);
    }
    bench_results_free(&before);
    bench_results_free(&after);
}

/* The fake renderer loses its device at the last seed, which ends the server. */
static void a_server_that_dies_leaves_what_was_finished(void **state)
{
    (void)state;
    assert_int_equal(run_fake("--scene cube --metric rell1 --set seed=1,2147483647,3 --out dies"), 3);
    assert_said("seed=2147483647");
    assert_said("the device is lost");
    assert_said("the same command goes on from there");
    struct bench_results results = read_results("dies/results.json");
    assert_int_equal(results.count, 1);
    bench_results_free(&results);
    assert_int_equal(access(in_folder("dies/report.html"), F_OK), -1);
    assert_int_equal(run_fake("--scene cube --metric rell1 --set seed=1,3 --out dies"), 0);
    assert_said("1 points measured, 1 kept");
}

static void a_server_that_stalls_is_left(void **state)
{
    (void)state;
    char program[4096], arguments[512], pid_path[64];
    snprintf(program, sizeof program, "%s/causticd-fake", getenv("CAUSTICD_BIN_DIR"));
    struct server_process *server =
        server_process_start(&(struct server_process_params){.program = program}, &error);
    if (!server)
        fail_msg("%s", error.message);
    snprintf(pid_path, sizeof pid_path, "/proc/self/task/%d/children", (int)getpid());
    FILE *children = fopen(pid_path, "r");
    int pid = 0;
    if (!children || fscanf(children, "%d", &pid) != 1)
        fail_msg("the server's process is not known");
    fclose(children);
    kill(pid, SIGSTOP);
    snprintf(arguments, sizeof arguments, "--connect %s --timeout 1 --out stalls",
             server_process_address(server));
    int status = run(arguments);
    kill(pid, SIGCONT);
    assert_int_equal(status, 3);
    assert_true(server_process_stop(&server, &error));
}

static void what_is_wrong_is_named(void **state)
{
    (void)state;
    write_file("broken.json", "{\"scenes\": [\"cube\"],\n \"size\" \"12x12\"}");
    write_file("field.json", "{\"scenes\": [\"cube\"], \"settings\": {\"photons\": [[]]}}");
    write_file("text", "no picture");
    mkdir(in_folder("corrupt"), 0777);
    write_file("corrupt/results.json", "{\"program\": \"caustic-bench\", \"format\": 1, \"points\": [");
    float *small = calloc(16 * 9 * 3, sizeof *small);
    assert_true(bench_image_write(in_folder("small.exr"), small, 16, 9, &error));
    free(small);
    static const struct {
        const char *arguments, *expected;
        int status;
    } cases[] = {
        {"", "no scene", 2},
        {"--bogus", "there is no option --bogus", 2},
        {"--scene", "--scene needs a value", 2},
        {"--scene nosuch", "nosuch: causticd ended with status 1; it last said: causticd: error: ", 3},
        {"--scene cube --set photns=3", "no setting is called photns; there are photons,", 2},
        {"--scene cube --set photons=abc", "photons: abc is not a number", 2},
        {"--scene cube --set photons=0", "photons: 0 is not between", 2},
        {"--scene cube --set aa=nosuch", "aa: nosuch is none of", 2},
        {"--scene cube --method m:aa=nosuch", "method m: aa: nosuch is none of", 2},
        {"--scene cube --metric psnr", "--metric: there is no metric \"psnr\"", 2},
        {"--scene cube --repeats 0", "--repeats", 2},
        {"--scene cube --timeout never", "--timeout", 2},
        {"--scene cube --connect nowhere", "--connect nowhere", 2},
        {"--scene cube,ring --reference a.exr", "--reference: is for one scene", 2},
        {"--scene cube --connect unix:/nowhere --server a", "--connect excludes --server", 2},
        {"--config nowhere.json", "nowhere.json: No such file", 2},
        {"--config broken.json", "broken.json: line 2, column", 2},
        {"--config field.json", "field.json: settings.photons[0]: must be a number, a text", 2},
        {"--scene cube --reference nowhere.exr", "nowhere.exr", 2},
        {"--scene cube --reference text", "text", 2},
        {"--scene cube --reference small.exr", "small.exr: is 16x9 pixels, the points are 32x18", 2},
        {"--scene cube --out corrupt", "corrupt/results.json: line 1, column", 2},
        {"--scene cube --out text", "--out: text/points: Not a directory", 3},
        {"--scene cube --compare nowhere.json", "nowhere.json: No such file", 2},
        {"--scene cube --compare broken.json", "broken.json: line 2, column", 2},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int status = run_fake(cases[i].arguments);
        if (status != cases[i].status || !strstr(program_output, cases[i].expected))
            fail_msg("%s ended with %d and said:\n%s", cases[i].arguments, status, program_output);
    }
    /* A disk that is full when the first point is kept. */
    if (access("/dev/full", W_OK) == 0) {
        mkdir(in_folder("full"), 0777);
        assert_int_equal(symlink("/dev/full", in_folder("full/results.json.part")), 0);
        assert_int_equal(run_fake("--scene cube --metric rell1 --out full"), 3);
        assert_said("full/results.json: No space left on device");
    }
    assert_int_equal(run_fake("--scene cube --metric rell1 --out corrupt --fresh --quiet"), 0);
    assert_string_equal(program_output, "");
    assert_int_equal(run("--connect unix:/nowhere/socket --out x"), 3);
    assert_said("/nowhere/socket");
    assert_int_equal(run("--help"), 0);
    assert_said("--time-threshold");
}

int main(void)
{
    if (!getenv("CAUSTICD_BIN_DIR"))
        skip_program("CAUSTICD_BIN_DIR is not set: run the tests through ctest");
    if (!mkdtemp(folder))
        return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_are_measured), cmocka_unit_test(a_run_goes_on_and_is_compared),
        cmocka_unit_test(a_server_that_dies_leaves_what_was_finished),
        cmocka_unit_test(a_server_that_stalls_is_left), cmocka_unit_test(what_is_wrong_is_named)};
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    char command[128];
    snprintf(command, sizeof command, "rm -r %s", folder);
    return system(command) == 0 ? failed : 1;
}
