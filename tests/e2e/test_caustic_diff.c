/* The program caustic-diff on files, good and bad, as someone at a terminal or a CI script meets it. */
#include <limits.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/image/image_io.h"
#include "tests/support/check.h"
#include "tests/support/program.h"

static char folder[200];

static int run(const char *arguments)
{
    return program_run(folder, "caustic-diff %s", arguments);
}

static void assert_says(int status, const char *arguments, const char *said)
{
    program_expect(status, said, folder, "caustic-diff %s", arguments);
}

/* Runs it with --json; number_of looks at what it printed. Starting it takes a quarter of a second, most of
 * it for OpenImageIO's libraries, so one run answers what it can. */
static void run_json(const char *arguments)
{
    char with_json[400];
    snprintf(with_json, sizeof with_json, "%s --json", arguments);
    if (run(with_json) == 2)
        fail_msg("caustic-diff %s\n%s", with_json, program_output);
}

/* The number after `"name": `. */
static double number_of(const char *name)
{
    char key[64];
    snprintf(key, sizeof key, "\"%s\": ", name);
    const char *at = strstr(program_output, key);
    if (!at)
        fail_msg("no %s in\n%s", name, program_output);
    return strtod(at + strlen(key), NULL);
}

static void path_of(char path[256], const char *name)
{
    snprintf(path, 256, "%s/%s", folder, name);
}

/* ---- the files ------------------------------------------------------------------------------------------
 */

enum { WIDTH = 24, HEIGHT = 16, COUNT = WIDTH * HEIGHT };

static void write_exr(const char *name, const char *const *channels, uint32_t count, float values[][COUNT],
                      uint32_t width, uint32_t height)
{
    char path[256];
    struct image_plane planes[8];
    struct error error;
    path_of(path, name);
    for (uint32_t i = 0; i < count; i++) {
        snprintf(planes[i].name, sizeof planes[i].name, "%s", channels[i]);
        planes[i].values = values[i];
    }
    const struct image_write_params params = {
        .width = width, .height = height, .planes = planes, .plane_count = count};
    if (!image_write_exr(path, &params, &error))
        fail_msg("%s", error.message);
}

static void write_png(const char *name, uint32_t components, const uint8_t *pixels)
{
    char path[256];
    struct error error;
    path_of(path, name);
    if (!image_write_png(path, WIDTH, HEIGHT, components, pixels, &error))
        fail_msg("%s", error.message);
}

static int write_files(void **state)
{
    (void)state;
    static const char *const rgb[] = {"R", "G", "B"};
    static const char *const layers[] = {"caustics.R", "caustics.G", "caustics.B", "Z", "R", "G", "B"};
    static float flat[7][COUNT], brighter[7][COUNT], broken[3][COUNT], black[3][COUNT], layered[7][COUNT];
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < COUNT; i++) {
            flat[c][i] = 2;
            brighter[c][i] = i % WIDTH < WIDTH / 2 ? 3 : 2; /* the left half is half as bright again */
            broken[c][i] = 2;
            layered[c][i] = brighter[c][i];
            layered[3][i] = 9;
            layered[4 + c][i] = 2;
        }
    broken[1][5] = NAN;
    broken[2][5] = INFINITY;
    broken[0][WIDTH + 7] = -INFINITY;
    write_exr("flat.exr", rgb, 3, flat, WIDTH, HEIGHT);
    write_exr("brighter.exr", rgb, 3, brighter, WIDTH, HEIGHT);
    write_exr("broken.exr", rgb, 3, broken, WIDTH, HEIGHT);
    write_exr("black.exr", rgb, 3, black, WIDTH, HEIGHT);
    write_exr("turned.exr", rgb, 3, flat, HEIGHT, WIDTH);
    write_exr("tiny.exr", rgb, 3, flat, 4, 3);
    write_exr("layered.exr", layers, 7, layered, WIDTH, HEIGHT);

    uint8_t dark[3 * COUNT] = {0}, light[3 * COUNT], mask[COUNT], half[3 * COUNT];
    for (int i = 0; i < COUNT; i++) {
        mask[i] = i % WIDTH < WIDTH / 2 ? 255 : 0;
        for (int c = 0; c < 3; c++) {
            light[3 * i + c] = 255;
            half[3 * i + c] = 128;
        }
    }
    write_png("dark.png", 3, dark);
    write_png("light.png", 3, light);
    write_png("half.png", 3, half);
    write_png("left.png", 1, mask);

    return 0;
}

/* ---- tests ----------------------------------------------------------------------------------------------
 */

/* Half the picture is 3 where the reference is 2. */
static void test_values(void **state)
{
    (void)state;
    run_json("brighter.exr flat.exr --metric all --epsilon 1");
    assert_close(number_of("rmse"), sqrt(0.5), 1e-7);
    assert_close(number_of("relrmse"), sqrt(0.5) / 2, 1e-7);
    assert_close(number_of("relmse"), 0.5 / 5, 1e-7);
    assert_close(number_of("rell1"), 0.25, 1e-7);
    assert_close(number_of("flux"), 0.25, 1e-7);
    assert_close(number_of("fireflies"), 0, 0);
    assert_close(number_of("width"), WIDTH, 0);
    run_json("dark.png light.png --metric flip");
    assert_close(number_of("flip"), 0.9674, 1e-3);

    /* A PNG is decoded to linear light unless told otherwise; SSIM takes the stored values. */
    double stored = 128 / 255.0, linear = pow((stored + 0.055) / 1.055, 2.4), c1 = 1e-4;
    run_json("half.png light.png --metric rmse,ssim");
    assert_close(number_of("rmse"), 1 - linear, 1e-6);
    assert_close(number_of("ssim"), (2 * stored + c1) / (stored * stored + 1 + c1), 1e-6);
    run_json("half.png light.png --metric rmse --transfer linear");
    assert_close(number_of("rmse"), 127 / 255.0, 1e-6);
}

static void test_defaults(void **state)
{
    (void)state;
    assert_int_equal(run("flat.exr flat.exr"), 0);
    assert_non_null(strstr(program_output, "flat.exr against flat.exr: 24x16 pixels\n  rmse       0"));
    assert_non_null(strstr(program_output, "hdrflip    0"));
    assert_int_equal(run("half.png half.png"), 0);
    assert_non_null(strstr(program_output, "flip       0"));
    assert_null(strstr(program_output, "hdrflip"));
}

static void test_crop_and_mask(void **state)
{
    (void)state;
    run_json("brighter.exr flat.exr --metric rmse,hdrflip");
    double whole = number_of("hdrflip");
    run_json("brighter.exr flat.exr --metric rmse,hdrflip --mask left.png");
    assert_close(number_of("rmse"), 1, 1e-7);
    assert_close(number_of("pixels"), COUNT / 2, 0);
    assert_true(number_of("hdrflip") > 1.5 * whole);
    run_json("brighter.exr flat.exr --metric rmse --crop 0,0,12,16");
    assert_close(number_of("rmse"), 1, 1e-7);
    run_json("brighter.exr flat.exr --metric rmse --mask left.png --crop 11,0,4,2");
    assert_close(number_of("rmse"), 1, 1e-7);
    assert_close(number_of("pixels"), 2, 0);
    /* What is cut away may hold what it likes. */
    assert_says(0, "broken.exr flat.exr --crop 8,2,16,14", "rmse       0");
}

static void test_layers(void **state)
{
    (void)state;
    run_json("layered.exr flat.exr --layer caustics --metric rell1");
    assert_close(number_of("rell1"), 0.25, 1e-7);
    run_json("layered.exr flat.exr --metric rell1");
    assert_close(number_of("rell1"), 0, 0);
    assert_says(2, "layered.exr flat.exr --layer smoke",
                "layered.exr has no layer \"smoke\"; it has R, G, B, Z, caustics");
}

static void test_limits(void **state)
{
    (void)state;
    assert_says(0, "brighter.exr flat.exr --metric rell1 --fail-above 0.26", "rell1      0.25");
    assert_says(1, "brighter.exr flat.exr --metric rell1,flux --fail-above flux=0.1 --fail-above rell1=1",
                "flux       0.25         above 0.1");
    /* Too little light counts as much as too much; a metric that has a limit is measured. */
    assert_says(1, "flat.exr brighter.exr --metric rmse --fail-above flux=0.1", "flux       -0.2");
    assert_says(0, "flat.exr flat.exr --metric ssim,rmse --fail-above 0", "ssim       1");
    assert_says(1, "dark.png light.png --metric ssim --fail-above ssim=0.5 --json",
                "\"above\": [\n    \"ssim\"");
    assert_says(1, "flat.exr black.exr --metric rell1 --fail-above 1000", "the reference is black");
    assert_says(0, "flat.exr black.exr --metric rell1 --json", "\"rell1\": null");
}

static void test_heat_map(void **state)
{
    (void)state;
    char path[256];
    struct error error;
    path_of(path, "heat.png");
    assert_says(0, "brighter.exr flat.exr --metric rmse,flux --heatmap heat.png", "shows rmse from 0 to 1");
    struct image_file *file = image_read_planes(path, &error);
    assert_non_null(file);
    assert_true(file->width == WIDTH && file->height == HEIGHT && file->plane_count == 3 && file->is_integer);
    assert_close(file->planes[0].values[3], 252 / 255.0, 1e-6); /* left: most */
    assert_close(file->planes[1].values[3], 253 / 255.0, 1e-6);
    assert_close(file->planes[0].values[WIDTH - 1], 0, 1e-6); /* right: none */
    image_file_destroy(&file);
    assert_says(0, "brighter.exr flat.exr --metric flip --heatmap heat.png --mask left.png",
                "shows flip from 0 to 1");
    file = image_read_planes(path, &error);
    assert_non_null(file);
    assert_close(file->planes[0].values[WIDTH - 1], 0, 0);
    assert_close(file->planes[1].values[WIDTH - 1], 1, 0); /* cyan: masked */
    image_file_destroy(&file);
    remove(path);
    assert_says(2, "flat.exr flat.exr --heatmap /nowhere/at/all.png", "cannot write /nowhere/at/all.png");
}

static void test_bad_files(void **state)
{
    (void)state;
    assert_says(2, "flat.exr missing.exr", "caustic-diff: cannot open missing.exr: No such file");
    assert_says(2, "flat.exr turned.exr", "flat.exr has 24x16 pixels and turned.exr has 16x24");
    assert_says(2, "flat.exr broken.exr --metric rmse --json",
                "\"error\": \"broken.exr: 2 of 384 pixels are NaN or infinite, the first at 5,0; nothing is "
                "measured\"");
    assert_says(2, "broken.exr flat.exr", "broken.exr: 2 of 384 pixels");
    assert_says(2, "flat.exr flat.exr --mask turned.exr", "the mask turned.exr has 16x24 pixels");
    assert_says(2, "flat.exr flat.exr --mask dark.png", "leaves no pixel: none is above half");
    assert_says(2, "flat.exr flat.exr --mask broken.exr", "broken.exr: 2 of 384 pixels are NaN");
    assert_says(2, "tiny.exr tiny.exr --metric hdrflip,ssim",
                "SSIM needs 11x11 pixels at least; these have 4x3");
    assert_says(2, "flat.exr flat.exr > /dev/full", ""); /* a full disk */
}

static void test_bad_use(void **state)
{
    (void)state;
    assert_says(0, "--help", "caustic-diff IMAGE REFERENCE [OPTIONS]");
    assert_says(2, "flat.exr",
                "it takes an image and a reference; 1 files are named\ncaustic-diff --help tells");
    assert_says(2, "flat.exr flat.exr --metric rmse,psnr",
                "--metric: there is no metric \"psnr\"; there are rmse, relrmse, relmse, rell1, flux");
    assert_says(2, "flat.exr flat.exr --metric", "--metric needs a value");
    assert_says(2, "flat.exr flat.exr --frobnicate", "there is no option --frobnicate");
    assert_says(2, "flat.exr flat.exr --fail-above rmse=nan", "it takes a number of 0 or more");
    assert_says(2, "flat.exr flat.exr --fail-above speed=1", "there is no metric \"speed\"");
    assert_says(2, "flat.exr flat.exr --crop -1,2,3,4",
                "--crop -1,2,3,4: it takes X,Y,WIDTH,HEIGHT in pixels");
    assert_says(2, "flat.exr flat.exr --crop 20,0,5,5", "--crop: 5x5 pixels from 20,0 are not within 24x16");
    assert_says(2, "flat.exr flat.exr --ppd 9999 --metric flip",
                "FLIP at 9999 pixels per degree; 5 to 500 can be");
    assert_says(2, "flat.exr flat.exr --transfer log", "--transfer log: it takes srgb or linear");
}

static int remove_files(void **state)
{
    (void)state;
    char command[300];
    snprintf(command, sizeof command, "rm -rf '%s'", folder);
    return system(command);
}

int main(void)
{
    struct error error = {0};
    const char *parent = getenv("TMPDIR");
    if (!image_read_exr("/nowhere/at/all.exr", &error) && error.status == STATUS_UNSUPPORTED)
        skip_program("this build reads and writes no images (CAUSTICD_IMAGES is off)");
    snprintf(folder, sizeof folder, "%s/causticd_diff_%ld", parent ? parent : "/tmp", (long)getpid());
    if (mkdir(folder, 0700) != 0)
        return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values),        cmocka_unit_test(test_defaults),
        cmocka_unit_test(test_crop_and_mask), cmocka_unit_test(test_layers),
        cmocka_unit_test(test_limits),        cmocka_unit_test(test_heat_map),
        cmocka_unit_test(test_bad_files),     cmocka_unit_test(test_bad_use),
    };
    return cmocka_run_group_tests(tests, write_files, remove_files);
}
