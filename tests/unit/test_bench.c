/* caustic-bench without a server: what a configuration says, which points that makes, the front, what is kept
 * and read again, and what got better or worse. */
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/bench/compare.h"
#include "clients/bench/options.h"
#include "clients/bench/results.h"
#include "tests/support/check.h"

static struct error error;
static struct bench_config config;
static char folder[] = "/tmp/test_bench_XXXXXX", path[128];

static void parse(const char *text)
{
    bench_config_default(&config);
    if (!bench_config_parse(&config, text, "some/where/a.json", &error))
        fail_msg("%s", error.message);
}

/* ---- configuration ---------------------------------------------------------------------------------------
 */

static void a_file_says_what_to_measure(void **state)
{
    (void)state;
    parse(
        "{\"scenes\": [\"sphere\", \"room.glb\", {\"scene\": \"pool\", \"time\": 0.5, \"camera\": \"main\","
        " \"reference\": \"/abs/pool.exr\"}, {\"scene\": \"ring\", \"reference\": \"r.exr\","
        " \"camera\": {\"eye\": [0, 1, 3], \"at\": [0, 0, 0], \"fov\": 40}}],"
        " \"size\": \"96x54\", \"methods\": {\"default\": {}, \"papers\": {\"density\": \"area\", \"jitter\":"
        " true, \"photons\": 7}}, \"settings\": {\"photons\": [8192, 32768], \"kappa\": 1.25},"
        " \"curve\": \"photons\", \"warmup\": 3, \"repeats\": 2, \"metrics\": [\"hdrflip\", \"flux\"],"
        " \"reference\": {\"confidence\": 0.1, \"photons\": 1e6, \"settings\": {\"max_bounces\": 20},"
        " \"cache\": \"refs\"}, \"budgets_ms\": [1, 2.5],"
        " \"plots\": [{\"file\": \"a.svg\", \"x\": \"photons\", \"y\": \"1 - rmse / gpu_ms\", \"log_x\": "
        "true}],"
        " \"bars\": [{\"file\": \"b.svg\", \"scene\": \"pool\", \"is_share\": true}]}");
    assert_int_equal(config.scene_count, 4);
    assert_string_equal(config.scenes[0].source, "sphere");
    /* Files lie beside the configuration; built-in scenes and absolute paths are what they are. */
    assert_string_equal(config.scenes[1].source, "some/where/room.glb");
    assert_string_equal(config.scenes[1].label, "room");
    assert_string_equal(config.scenes[2].reference, "/abs/pool.exr");
    assert_string_equal(config.scenes[2].camera_name, "main");
    assert_true(config.scenes[2].time == 0.5);
    assert_string_equal(config.scenes[3].reference, "some/where/r.exr");
    assert_int_equal(config.scenes[3].camera_kind, BENCH_CAMERA_FREE);
    assert_true(config.scenes[3].camera.eye[2] == 3 && config.scenes[3].camera.up[1] == 1 &&
                config.scenes[3].camera.fov == 40);
    assert_string_equal(config.cache, "some/where/refs");
    assert_int_equal(config.judge, METRIC_HDRFLIP);
    assert_true(config.metrics[METRIC_FLUX] && !config.metrics[METRIC_RELL1]);
    assert_true(config.width == 96 && config.height == 54 && config.warmup == 3 && config.repeats == 2);
    assert_true(config.budget_count == 2 && config.budgets_ms[1] == 2.5);
    assert_int_equal(config.plot_count, 2);
    assert_true(config.plots[0].is_log_x && !config.plots[0].is_bars && config.plots[1].is_share);
    assert_true(bench_config_check(&config, &error));

    /* Scenes x methods x photons; the axis wins over the method's own photons. */
    assert_int_equal(bench_point_count(&config), 16);
    struct bench_point point = bench_point_at(&config, 7);
    assert_true(point.scene == 1 && point.method == 1 && point.setting_count == 4);
    assert_string_equal(point.settings[0].value, "area");
    assert_string_equal(point.settings[1].value, "on");
    assert_string_equal(point.settings[2].value, "32768");
    assert_string_equal(point.settings[3].value, "1.25");
    /* Every point once. */
    for (uint32_t i = 0; i < 16; i++)
        for (uint32_t k = 0; k < i; k++) {
            struct bench_point a = bench_point_at(&config, i), b = bench_point_at(&config, k);
            assert_true(memcmp(&a, &b, sizeof a) != 0);
        }
}

static void nonsense_names_file_and_field(void **state)
{
    (void)state;
    static const struct {
        const char *text, *expected;
    } cases[] = {
        {"{\"scenes\": [\"a\"], ", "a.json: line 1, column"},
        {"[]", "a.json: must be an object"},
        {"{\"scene\": \"a\"}", "a.json: there is no field \"scene\"; there are scenes,"},
        {"{\"scenes\": \"a\"}", "a.json: scenes: must be a list"},
        {"{\"scenes\": [\"a\", 3]}", "a.json: scenes[1]: must be the name"},
        {"{\"scenes\": [\"a\", \"a\"]}", "a.json: scenes[1]: scene \"a\" is given twice"},
        {"{\"scenes\": [{\"scene\": \"a\", \"camera\": {\"eye\": [0, 1]}}]}",
         "a.json: scenes[0].camera.eye: must be [x, y, z]"},
        {"{\"scenes\": [{\"scene\": \"a\", \"camera\": {\"eye\": [0, 1, 2]}}]}",
         "a.json: scenes[0].camera: needs \"eye\" and \"at\""},
        {"{\"scenes\": [{\"scene\": \"a\", \"time\": \"now\"}]}", "a.json: scenes[0].time: must be a number"},
        {"{\"size\": \"12\"}", "a.json: size: must be \"WIDTHxHEIGHT\""},
        {"{\"settings\": {\"photons\": [1, null]}}", "a.json: settings.photons[1]: must be a number, a text"},
        {"{\"settings\": {\"photons\": []}}", "a.json: settings.photons: needs a value"},
        {"{\"settings\": {\"photons\": [1, 1]}}", "a.json: settings.photons[1]: photons: 1 is given twice"},
        {"{\"settings\": {\"accumulate\": 4}}", "a.json: settings.accumulate: accumulate: is how references"},
        {"{\"settings\": {\"photons\": 1, \"photons\": 2}}", "duplicate"},
        {"{\"methods\": {\"m\": 3}}", "a.json: methods.m: must be an object"},
        {"{\"methods\": {\"\": {}}}", "is empty"},
        {"{\"metrics\": [\"rmse\", \"psnr\"]}",
         "a.json: metrics[1]: there is no metric \"psnr\"; there are rell1"},
        {"{\"warmup\": 1.5}", "a.json: warmup: must be a whole number"},
        {"{\"repeats\": 0}", "a.json: repeats: must be a number from 1"},
        {"{\"reference\": {\"confidence\": 0}}", "a.json: reference.confidence: must be a number from"},
        {"{\"reference\": {\"photons\": -1}}", "a.json: reference.photons: must be a number from"},
        {"{\"budgets_ms\": [1, \"x\"]}", "a.json: budgets_ms[1]: must be a number"},
        {"{\"plots\": [{\"file\": \"a.png\", \"x\": \"a\", \"y\": \"b\"}]}",
         "a.json: plots[0].file: must be the name"},
        {"{\"plots\": [{\"file\": \"../a.svg\", \"x\": \"a\", \"y\": \"b\"}]}",
         "plots[0].file: must be the name"},
        {"{\"plots\": [{\"file\": \"a.svg\", \"x\": \"a\"}]}",
         "a.json: plots[0]: needs \"file\", \"x\" and \"y\""},
        {"{\"plots\": [{\"file\": \"a.svg\", \"x\": \"a\", \"y\": \"b\", \"log_x\": 1}]}",
         "a.json: plots[0].log_x: must be true or false"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        bench_config_default(&config);
        if (bench_config_parse(&config, cases[i].text, "a.json", &error))
            fail_msg("%s is accepted", cases[i].text);
        if (!strstr(error.message, cases[i].expected))
            fail_msg("%s gives \"%s\"", cases[i].text, error.message);
    }
    assert_false(bench_config_read(&config, "/nowhere/a.json", &error));
    assert_non_null(strstr(error.message, "/nowhere/a.json"));
    bench_config_default(&config);
    assert_false(bench_config_check(&config, &error));
    assert_true(bench_config_parse(&config, "{\"scenes\": [\"a\"], \"curve\": \"kappa\"}", "a", &error));
    assert_false(bench_config_check(&config, &error));
    assert_non_null(strstr(error.message, "kappa"));
}

static void the_files_in_docs_are_valid(void **state)
{
    (void)state;
    static const char *const files[] = {"docs/bench-example.json", "docs/study/target-area.json",
                                        "docs/study/culling.json", "docs/study/curves.json"};
    const char *source = getenv("CAUSTICD_SOURCE_DIR");
    for (size_t i = 0; source && i < sizeof files / sizeof *files; i++) {
        char file[4096];
        snprintf(file, sizeof file, "%s/%s", source, files[i]);
        bench_config_default(&config);
        if (!bench_config_read(&config, file, &error) || !bench_config_check(&config, &error))
            fail_msg("%s", error.message);
        assert_true(bench_point_count(&config) > 10);
    }
}

static void the_command_line_wins_over_the_file(void **state)
{
    (void)state;
    static struct bench_options options;
    FILE *file = fopen(path, "w");
    fputs(
        "{\"scenes\": [\"sphere\", \"ring\"], \"size\": \"96x54\", \"warmup\": 3,"
        " \"settings\": {\"photons\": [1, 2], \"kappa\": [1, 2]}, \"methods\": {\"m\": {\"aa\": \"none\"}}}",
        file);
    fclose(file);
    char *arguments[] = {
        "caustic-bench", "--scene", "cube",     "--set", "photons=5,6,7", "--method", "m:aa=pixel,split=once",
        "--config",      path,      "--warmup", "1",     "--threshold",   "12.5",     NULL};
    assert_true(bench_options_parse(&options, 13, arguments, &error));
    const struct bench_config *given = &options.config;
    assert_int_equal(given->scene_count, 1);
    assert_string_equal(given->scenes[0].source, "cube");
    assert_true(given->width == 96 && given->warmup == 1 && given->repeats == 5);
    assert_int_equal(bench_point_count(given), 3 * 2);
    struct bench_point point = bench_point_at(given, 5);
    assert_int_equal(point.setting_count, 4);
    assert_string_equal(point.settings[0].value, "pixel");
    assert_string_equal(point.settings[2].value, "7");
    assert_string_equal(point.settings[3].value, "2");
    assert_close(options.thresholds.error, 0.125, 1e-12);
    assert_true(isinf(options.thresholds.time));
    unlink(path);
}

/* ---- fronts ----------------------------------------------------------------------------------------------
 */

static double random_step(uint32_t *seed) /* few values, so that there are ties */
{
    *seed = *seed * 1664525u + 1013904223u;
    return (double)(*seed >> 28);
}

/* Against the definition, on random points with ties and holes. */
static void the_front_is_what_nothing_beats(void **state)
{
    (void)state;
    uint32_t seed = 7;
    for (uint32_t round = 0; round < 500; round++) {
        double costs[12], errors[12];
        uint32_t order[12], count = round % 13;
        for (uint32_t i = 0; i < count; i++) {
            costs[i] = random_step(&seed);
            errors[i] = random_step(&seed) > 13 ? NAN : random_step(&seed);
        }
        uint32_t found = bench_front(costs, errors, count, order);
        bool is_listed[12] = {false};
        for (uint32_t i = 0; i < found; i++) {
            is_listed[order[i]] = true;
            if (i > 0) /* rising cost, falling error */
                assert_true(costs[order[i]] > costs[order[i - 1]] && errors[order[i]] < errors[order[i - 1]]);
        }
        for (uint32_t i = 0; i < count; i++) {
            bool is_beaten = isnan(errors[i]);
            for (uint32_t k = 0; k < count; k++)
                is_beaten |= costs[k] <= costs[i] && errors[k] <= errors[i] &&
                             (costs[k] < costs[i] || errors[k] < errors[i] || k < i);
            assert_int_equal(is_listed[i], !is_beaten);
        }
        for (double budget = 0; budget < 16; budget += 3) {
            uint32_t best = bench_best_within(costs, errors, count, budget);
            for (uint32_t i = 0; i < count; i++)
                if (costs[i] <= budget && !isnan(errors[i]))
                    assert_true(best < count && costs[best] <= budget && errors[best] <= errors[i]);
            if (best < count)
                assert_true(costs[best] <= budget);
        }
    }
}

/* ---- results ---------------------------------------------------------------------------------------------
 */

static struct bench_result made_up(const char *scene, double gpu_ms, double rell1, const char *photons)
{
    struct bench_result result = {
        .width = 64, .height = 36, .setting_count = 2, .statistic_count = 3, .pass_count = 2};
    snprintf(result.key, sizeof result.key, "k%.6s%.6s", scene, photons);
    snprintf(result.scene, sizeof result.scene, "%s", scene);
    snprintf(result.method, sizeof result.method, "a \"method\", named so");
    strcpy(result.image, "points/x.exr");
    strcpy(result.reference, "ref");
    result.settings[0] = (struct option_setting){"aa", "filter"};
    strcpy(result.settings[1].name, "photons");
    strcpy(result.settings[1].value, photons);
    result.gpu_ns = (struct bench_spread){gpu_ms * 1e6, gpu_ms * 0.9e6, gpu_ms * 1.1e6, gpu_ms * 0.8e6};
    result.wall_ns = result.frame_ns = result.gpu_ns;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        result.measures[i] = (struct bench_spread){NAN, NAN, NAN, NAN};
    result.measures[METRIC_RELL1] = (struct bench_spread){rell1, rell1, rell1, rell1};
    result.measures[METRIC_SSIM] = (struct bench_spread){0.75, 0.7, 0.8, 0.7};
    result.measures[METRIC_FLUX] = (struct bench_spread){-0.02, -0.03, -0.01, -0.03};
    result.statistics[0] = (struct bench_number){"photons_splatted", 200};
    result.statistics[1] = (struct bench_number){"photons_contributing", 150};
    result.statistics[2] = (struct bench_number){"photons_emitted", 1e6};
    result.passes_ns[0] = (struct bench_number){"trace", 3e6};
    result.passes_ns[1] = (struct bench_number){"splat", 1e6};
    return result;
}

static void quantities_are_read_off_points(void **state)
{
    (void)state;
    struct bench_result result = made_up("sphere", 8, 0.125, "4096");
    static const struct {
        const char *expression;
        double expected;
    } cases[] = {{"gpu_ms", 8},
                 {"rell1", 0.125},
                 {"ssim", 0.25},
                 {"flux", 0.02},
                 {"photons", 1e6},
                 {"1 - photons_contributing / photons_splatted", 0.25},
                 {"pass.trace / passes_ms", 0.75},
                 {"pass.trace+splat", 4},
                 {"1-pass.trace+splat/passes_ms", 0},
                 {"pass.nothing", NAN},
                 {"rmse", NAN},
                 {"aa", NAN},
                 {"nonsense", NAN}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        double value = bench_quantity(&result, cases[i].expression);
        if (isnan(cases[i].expected) ? !isnan(value) : !(fabs(value - cases[i].expected) < 1e-12))
            fail_msg("%s is %g", cases[i].expression, value);
    }
}

static void same_number(double a, double b)
{
    assert_true((isnan(a) && isnan(b)) || fabs(a - b) <= 1e-9 * fabs(a));
}

static void what_is_written_is_read_again(void **state)
{
    (void)state;
    struct bench_results written, read;
    bench_results_begin(&written);
    strcpy(written.server.device, "llvmpipe");
    written.reference_count = 1;
    written.references[0] = (struct bench_reference_note){.scene = "sphere", .noise = NAN, .photons = 1e8};
    struct bench_result results[] = {made_up("sphere", 8, 0.1, "1024"), made_up("ring", 4, 0.3, "2048")};
    for (uint32_t i = 0; i < 2; i++)
        assert_true(bench_results_add(&written, &results[i], &error));
    assert_true(bench_results_write(&written, path, &error));
    assert_true(bench_results_read(&read, path, &error));
    assert_int_equal(read.count, 2);
    assert_string_equal(read.server.device, "llvmpipe");
    assert_true(isnan(read.references[0].noise) && read.references[0].photons == 1e8);
    for (uint32_t i = 0; i < 2; i++) {
        const struct bench_result *a = &results[i], *b = bench_results_find(&read, results[i].key);
        assert_non_null(b);
        assert_string_equal(a->scene, b->scene);
        assert_string_equal(a->method, b->method);
        assert_string_equal(a->image, b->image);
        assert_string_equal(bench_result_setting(b, "photons"), a->settings[1].value);
        assert_true(a->width == b->width && a->height == b->height);
        same_number(a->gpu_ns.low, b->gpu_ns.low);
        for (uint32_t k = 0; k < METRIC_COUNT; k++) {
            same_number(a->measures[k].median, b->measures[k].median);
            same_number(a->measures[k].least, b->measures[k].least);
        }
        same_number(bench_quantity(a, "photons_contributing"), bench_quantity(b, "photons_contributing"));
        same_number(bench_quantity(a, "pass.trace"), bench_quantity(b, "pass.trace"));
    }
    assert_null(bench_results_find(&read, "nothing"));

    char csv[160], line[4096];
    snprintf(csv, sizeof csv, "%s.csv", path);
    assert_true(bench_results_write_csv(&written, csv, &error));
    FILE *file = fopen(csv, "r");
    uint32_t lines = 0, commas = 0;
    for (; fgets(line, sizeof line, file); lines++) {
        uint32_t here = 0;
        bool is_quoted = false;
        for (const char *at = line; *at; at++) {
            is_quoted ^= *at == '"';
            here += *at == ',' && !is_quoted;
        }
        assert_true(lines == 0 || here == commas); /* every row has every column */
        commas = here;
    }
    fclose(file);
    assert_int_equal(lines, 3);
    unlink(csv);

    assert_false(bench_results_write(&written, "/nowhere/results.json", &error));
    assert_non_null(strstr(error.message, "/nowhere/results.json: No such file"));
    bench_results_free(&written);
    bench_results_free(&read);
}

/* Cut at every length, and with every field broken in turn: refused with the file's name, or, where a value
 * was only changed, read. */
static void damaged_results_are_named(void **state)
{
    (void)state;
    struct bench_results results;
    bench_results_begin(&results);
    struct bench_result result = made_up("sphere", 8, 0.1, "1024");
    assert_true(bench_results_add(&results, &result, &error));
    assert_true(bench_results_write(&results, path, &error));
    bench_results_free(&results);
    static char text[65536], damaged[65536];
    FILE *file = fopen(path, "r");
    size_t size = fread(text, 1, sizeof text - 1, file);
    fclose(file);
    for (size_t length = 0; length + 2 < size; length += 13) {
        file = fopen(path, "w");
        fwrite(text, 1, length, file);
        fclose(file);
        assert_false(bench_results_read(&results, path, &error));
        assert_non_null(strstr(error.message, path));
    }
    uint32_t refused = 0, fields = 0;
    for (const char *at = text; (at = strstr(at, "\": ")); at++) {
        fields++;
        size_t place = (size_t)(at - text) - 1; /* the name's last letter */
        memcpy(damaged, text, size + 1);
        damaged[place] = damaged[place] == '_' ? '-' : '_';
        file = fopen(path, "w");
        fwrite(damaged, 1, size, file);
        fclose(file);
        bool is_read = bench_results_read(&results, path, &error);
        refused += !is_read;
        if (!is_read)
            assert_non_null(strstr(error.message, path));
        bench_results_free(&results);
    }
    /* Only names inside settings, measures, statistics and passes are free. */
    assert_int_equal(fields - refused, 2 + 3 + 3 + 2 + 1 /* version of the program */);
    assert_false(bench_results_read(&results, "/nowhere/old.json", &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    file = fopen(path, "w");
    fputs("{\"program\": \"caustic-record\"}", file);
    fclose(file);
    assert_false(bench_results_read(&results, path, &error));
    assert_non_null(strstr(error.message, "holds no results of caustic-bench"));
    unlink(path);
}

/* ---- comparison ------------------------------------------------------------------------------------------
 */

static void worse_and_better_are_told_apart(void **state)
{
    (void)state;
    struct bench_results before, after;
    bench_results_begin(&before);
    bench_results_begin(&after);
    struct bench_result old[] = {made_up("sphere", 8, 0.1, "1"),  made_up("sphere", 8, 0.1, "2"),
                                 made_up("sphere", 8, 0.1, "3"),  made_up("sphere", 8, 0.1, "4"),
                                 made_up("sphere", 8, 1e-5, "5"), made_up("gone", 8, 0.1, "1")};
    struct bench_result new[] = {made_up("sphere", 8, 0.104, "1"), /* within 5 % */
                                 made_up("sphere", 8, 0.106, "2"), /* worse */
                                 made_up("sphere", 8, 0.09, "3"),  /* better */
                                 made_up("sphere", 16, 0.1, "4"),  /* slower */
                                 made_up("sphere", 8, 4e-4, "5"),  /* 40 times what is next to nothing */
                                 made_up("new", 8, 0.1, "1")};
    strcpy(new[0].method, "a method of another name");
    strcpy(new[2].settings[0].name, "photons"); /* the same settings in another order */
    strcpy(new[2].settings[0].value, "3");
    new[2].settings[1] = (struct option_setting){"aa", "filter"};
    for (uint32_t i = 0; i < 6; i++)
        assert_true(bench_results_add(&before, &old[i], &error) &&
                    bench_results_add(&after, &new[i], &error));
    struct bench_comparison comparison;
    struct bench_thresholds thresholds = {.error = 0.05, .time = INFINITY};
    assert_true(bench_compare(&before, &after, &thresholds, &comparison, &error));
    assert_int_equal(comparison.count, 5);
    assert_int_equal(comparison.worse, 1);
    assert_int_equal(comparison.better, 1);
    assert_true(comparison.only_before == 1 && comparison.only_after == 1);
    assert_true(comparison.changes[1].is_worse && comparison.changes[2].is_better);
    assert_close(comparison.changes[1].errors[METRIC_RELL1], 1.06, 1e-9);
    assert_close(comparison.changes[3].gpu, 2, 1e-9);
    free(comparison.changes);
    thresholds.time = 0.5;
    assert_true(bench_compare(&before, &after, &thresholds, &comparison, &error));
    assert_int_equal(comparison.worse, 2);
    assert_true(comparison.changes[3].is_gpu_worse);
    free(comparison.changes);
    /* SSIM falls when it gets worse, flux moves away from 0 to either side. */
    before.count = after.count = 1;
    after.results[0].measures[METRIC_SSIM].median = 0.7;
    after.results[0].measures[METRIC_FLUX].median = 0.03;
    assert_true(bench_compare(&before, &after, &thresholds, &comparison, &error));
    assert_close(comparison.changes[0].errors[METRIC_SSIM], 1.2, 1e-9);
    assert_close(comparison.changes[0].errors[METRIC_FLUX], 1.5, 1e-9);
    assert_int_equal(comparison.worse, 1);
    char *text = NULL;
    size_t size = 0;
    FILE *stream = open_memstream(&text, &size);
    bench_comparison_print(&comparison, &before, &after, stream);
    fclose(stream);
    assert_non_null(strstr(text, "worse  sphere a method of another name aa=filter photons=1"));
    assert_non_null(strstr(text, "ssim"));
    assert_non_null(strstr(text, "1 points in both runs: 1 worse, 0 better"));
    free(text);
    free(comparison.changes);
    bench_results_free(&before);
    bench_results_free(&after);
}

int main(void)
{
    if (!mkdtemp(folder))
        return 1;
    snprintf(path, sizeof path, "%s/file.json", folder);
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_file_says_what_to_measure),
                                       cmocka_unit_test(nonsense_names_file_and_field),
                                       cmocka_unit_test(the_files_in_docs_are_valid),
                                       cmocka_unit_test(the_command_line_wins_over_the_file),
                                       cmocka_unit_test(the_front_is_what_nothing_beats),
                                       cmocka_unit_test(quantities_are_read_off_points),
                                       cmocka_unit_test(what_is_written_is_read_again),
                                       cmocka_unit_test(damaged_results_are_named),
                                       cmocka_unit_test(worse_and_better_are_told_apart)};
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    unlink(path);
    rmdir(folder);
    return failed;
}
