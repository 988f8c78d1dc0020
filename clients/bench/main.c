/* caustic-bench: error against run time. See options.c for what it can do, config.h for its file. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../lib/folder.h"
#include "bench_page.h"
#include "curves.h"
#include "measure_point.h"
#include "options.h"

enum { EXIT_WORSE = 1, EXIT_USAGE = 2, EXIT_FAILED = 3 };

struct run {
    struct bench_options options;
    struct session_params session;
    struct bench_results results, ordered, before;
    char results_path[BENCH_PATH];
    uint32_t measured, kept;
    bool is_usage; /* what failed is the configuration's fault */
};

/* ---- measuring -------------------------------------------------------------------------------------------
 */

/* What an interrupted run in the same folder has finished. */
static bool load_earlier(struct run *run, struct error *error)
{
    struct error reason;
    if (run->options.is_fresh || bench_results_read(&run->results, run->results_path, &reason) ||
        reason.status == STATUS_NOT_FOUND)
        return true;
    return error_set(error, reason.status, "%.400s; --fresh begins anew", reason.message);
}

static void note_reference(struct run *run, const struct bench_reference *reference)
{
    struct bench_results *results = &run->results;
    uint32_t i = 0;
    while (i < results->reference_count && strcmp(results->references[i].scene, reference->note.scene) != 0)
        i++;
    if (i == BENCH_MAX_SCENES)
        return;
    results->references[i] = reference->note;
    results->reference_count += i == results->reference_count;
}

/* The scene's points: those that are there are taken over, the others measured, each kept at once. */
static bool measure_points(struct run *run, struct session *session, const struct bench_reference *reference,
                           uint32_t scene, struct error *error)
{
    const struct bench_config *config = &run->options.config;
    uint32_t count = bench_point_count(config), missing = 0;
    static struct bench_result result;
    for (uint32_t i = 0; i < count; i++) {
        struct bench_point point = bench_point_at(config, i);
        if (point.scene != scene)
            continue;
        point_describe(session, reference, &point, &result);
        missing += bench_results_find(&run->results, result.key) == NULL;
    }
    struct progress progress;
    progress_begin(&progress, missing * (config->warmup + config->repeats), run->options.quiet);
    bool is_good = true;
    for (uint32_t i = 0; i < count && is_good; i++) {
        struct bench_point point = bench_point_at(config, i);
        if (point.scene != scene)
            continue;
        point_describe(session, reference, &point, &result);
        const struct bench_result *there = bench_results_find(&run->results, result.key);
        if (there) {
            run->kept++;
            is_good = bench_results_add(&run->ordered, there, error);
            continue;
        }
        is_good = point_measure(session, reference, run->options.folder, &result, &progress, error) &&
                  bench_results_add(&run->results, &result, error) &&
                  bench_results_add(&run->ordered, &result, error) &&
                  bench_results_write(&run->results, run->results_path, error);
        run->measured += is_good;
    }
    progress_end(&progress);
    return is_good;
}

static bool measure_scene(struct run *run, uint32_t index, struct error *error)
{
    struct bench_scene *scene = &run->options.config.scenes[index];
    struct session session;
    struct bench_reference reference = {0};
    bool is_open = session_open(&session, &run->session, scene, error);
    if (!is_open) {
        run->is_usage = error->status == STATUS_NOT_FOUND || error->status == STATUS_INVALID;
        session_explain(&session, error, scene->label);
    } else if (run->options.address) {
        protocol_text_copy(session.hello->scene, scene->label, sizeof scene->label);
    }
    bool is_good = is_open && bench_reference_get(&session, &reference, error);
    if (is_open && !is_good && *scene->reference)
        run->is_usage = true;
    if (is_good) {
        run->results.server = session.about;
        note_reference(run, &reference);
        is_good = measure_points(run, &session, &reference, index, error);
    }
    bench_reference_free(&reference);
    session_close(&session);
    return is_good;
}

/* ---- what comes out --------------------------------------------------------------------------------------
 */

/* Only what the configuration has, in its order; of points that were kept and no longer belong, no trace. */
static void put_in_order(struct run *run)
{
    struct bench_results *ordered = &run->ordered;
    ordered->server = run->results.server;
    for (uint32_t i = 0; i < run->options.config.scene_count; i++)
        for (uint32_t k = 0; k < run->results.reference_count; k++)
            if (strcmp(run->results.references[k].scene, run->options.config.scenes[i].label) == 0)
                ordered->references[ordered->reference_count++] = run->results.references[k];
}

static bool write_outputs(struct run *run, const struct bench_comparison *comparison, struct error *error)
{
    const struct bench_config *config = &run->options.config;
    char path[BENCH_PATH + 32];
    snprintf(path, sizeof path, "%s/results.csv", run->options.folder);
    if (!bench_results_write(&run->ordered, run->results_path, error) ||
        !bench_results_write_csv(&run->ordered, path, error))
        return false;
    snprintf(path, sizeof path, "%s/plots", run->options.folder);
    if (config->plot_count > 0 && !folder_make(path, error))
        return false;
    for (uint32_t i = 0; i < config->plot_count; i++)
        if (!curves_write_plot(config, &run->ordered, &config->plots[i], run->options.folder, error))
            return false;
    return bench_page_write(&(struct bench_page_params){.config = config,
                                                        .results = &run->ordered,
                                                        .folder = run->options.folder,
                                                        .before = comparison ? &run->before : NULL,
                                                        .comparison = comparison},
                            error);
}

static void print_summary(const struct run *run)
{
    const struct bench_config *config = &run->options.config;
    enum metric judge = config->judge;
    printf("  %-12s %-44s %10s %9s %10s %10s\n", "scene", "settings", "gpu ms", "spread", "photons",
           metric_names[judge]);
    for (uint32_t i = 0; i < run->ordered.count; i++) {
        const struct bench_result *result = &run->ordered.results[i];
        char name[600];
        bench_result_name(result, NULL, name, sizeof name);
        printf("  %-12s %-44s %10.3f %7.1f %% %10.0f %10.5f\n", result->scene, *name ? name : "defaults",
               result->gpu_ns.median * 1e-6,
               100 * (result->gpu_ns.high - result->gpu_ns.low) / fmax(result->gpu_ns.median, 1),
               bench_quantity(result, "photons"), bench_quantity(result, metric_names[judge]));
    }
    for (uint32_t i = 0; i < run->ordered.reference_count; i++) {
        const struct bench_reference_note *note = &run->ordered.references[i];
        if (!note->has_confidence)
            printf("  the reference of %s is within %.2g of the truth, not %.2g: --reference-photons\n",
                   note->scene, note->noise, config->confidence);
    }
    printf("  %u points measured, %u kept from before; waiting took %.2f %% above the server's frame time\n"
           "  %s/report.html\n",
           run->measured, run->kept, 100 * bench_overhead(&run->ordered), run->options.folder);
}

static bool prepare(struct run *run, struct error *error)
{
    struct bench_options *options = &run->options;
    char path[BENCH_PATH];
    snprintf(path, sizeof path, "%s/points", options->folder);
    snprintf(run->results_path, sizeof run->results_path, "%s/results.json", options->folder);
    if (!folder_make(path, error)) {
        struct error inner = *error;
        return error_set(error, inner.status, "--out: %.450s", inner.message);
    }
    run->session = (struct session_params){.config = &options->config,
                                           .address = options->address,
                                           .program = options->program,
                                           .server_arguments = options->server_arguments,
                                           .timeout_ms = (uint32_t)(options->timeout * 1000),
                                           .is_quiet = options->quiet};
    return (!options->compare || bench_results_read(&run->before, options->compare, error)) &&
           load_earlier(run, error);
}

static int execute(struct run *run, struct error *error)
{
    struct bench_comparison comparison = {0};
    if (!prepare(run, error))
        return error->status == STATUS_IO ? EXIT_FAILED : EXIT_USAGE;
    for (uint32_t i = 0; i < run->options.config.scene_count; i++)
        if (!measure_scene(run, i, error))
            return run->is_usage ? EXIT_USAGE : EXIT_FAILED;
    put_in_order(run);
    bool has_comparison = run->options.compare != NULL;
    bool is_good = !has_comparison ||
                   bench_compare(&run->before, &run->ordered, &run->options.thresholds, &comparison, error);
    is_good = is_good && write_outputs(run, has_comparison ? &comparison : NULL, error);
    if (is_good && !run->options.quiet)
        print_summary(run);
    if (is_good && has_comparison)
        bench_comparison_print(&comparison, &run->before, &run->ordered, stdout);
    free(comparison.changes);
    return !is_good ? EXIT_FAILED : comparison.worse > 0 ? EXIT_WORSE : 0;
}

int main(int argc, char **argv)
{
    static struct run run;
    struct error error;
    if (!bench_options_parse(&run.options, argc, argv, &error)) {
        fprintf(stderr, "caustic-bench: %s\n", error.message);
        return EXIT_USAGE;
    }
    if (run.options.help || run.options.version) {
        fputs(run.options.help ? bench_help : "caustic-bench " CAUSTIC_VERSION "\n", stdout);
        return 0;
    }
    int status = execute(&run, &error);
    if (status > EXIT_WORSE)
        fprintf(stderr, "caustic-bench: %s\n%s", error.message,
                run.measured + run.kept > 0 && status == EXIT_FAILED
                    ? "caustic-bench: finished points are kept; the same command goes on from there\n"
                    : "");
    bench_results_free(&run.results);
    bench_results_free(&run.ordered);
    bench_results_free(&run.before);
    return status;
}
