/* caustic-stability: how steady caustics are over time. See options.c for what it can do. */
#include <stdio.h>
#include <string.h>

#include "../lib/folder.h"
#include "../lib/progress.h"
#include "../lib/server_process.h"
#include "report.h"

struct run {
    struct stability_options options;
    struct server_process *server;
    struct client *client;
    struct drive drive;
    struct report *report;
    struct progress progress;
};

static void step(void *context, const char *what)
{
    progress_step(context, what);
}

/* Puts "PREFIX: " in front of an error. */
static bool explain(struct error *error, const char *prefix)
{
    struct error inner = *error;
    return error_set(error, inner.status, "%.150s: %.350s", prefix, inner.message);
}

static bool set_up(struct run *run, struct error *error)
{
    const struct stability_options *options = &run->options;
    const char *address = options->address;
    if (!folder_make(options->folder, error))
        return explain(error, "--out");
    if (options->scene) {
        run->server = server_process_start(&(struct server_process_params){.scene = options->scene}, error);
        if (!run->server)
            return explain(error, "--scene");
        address = server_process_address(run->server);
    }
    run->client = client_connect(&(struct client_params){.address = address,
                                                         .name = "caustic-stability " CAUSTIC_VERSION,
                                                         .wait_ms = (uint32_t)(options->wait * 1000)},
                                 error);
    if (!run->client)
        return explain(error, "--connect");
    run->drive.options = options;
    run->drive.client = run->client;
    run->drive.step = step;
    run->drive.context = &run->progress;
    if (!drive_begin(&run->drive, error))
        return false;
    run->report = report_create(options, &run->drive, error);
    return run->report != NULL;
}

/* What a path left when it was cut short, and why; the server's own last words, when it was ours and died. */
static void keep_partial(struct run *run, struct error *error)
{
    struct analysis analysis;
    struct error inner = *error, other;
    const struct drive *drive = &run->drive;
    if (run->server && !server_process_is_alive(run->server, &other))
        inner = other;
    bool is_kept = drive->done > 0 && analysis_make_partial(drive, &analysis, &other) &&
                   report_add(run->report, drive, &analysis, inner.message, &other);
    error_set(error, inner.status, "path %s, after %u of %u frames: %.300s%s", path_infos[drive->path].name,
              drive->done, drive->warmup + drive->frames, inner.message,
              is_kept ? "; what was measured is in the report, and --resume goes on from there" : "");
    if (drive->done > 0)
        analysis_free(&analysis);
}

static bool measure(struct run *run, enum path_id path, struct error *error)
{
    struct analysis analysis = {0};
    if (!drive_path(&run->drive, path, stability_frames(&run->options, path), error)) {
        keep_partial(run, error);
        return false;
    }
    bool is_done = analysis_make(&run->drive, &analysis, error) &&
                   report_add(run->report, &run->drive, &analysis, NULL, error);
    analysis_free(&analysis);
    return is_done;
}

static bool measure_all(struct run *run, struct error *error)
{
    const struct stability_options *options = &run->options;
    bool waits[PATH_COUNT], is_ok = true;
    uint32_t total = 0;
    for (int i = 0; i < PATH_COUNT; i++) {
        uint32_t frames = stability_frames(options, (enum path_id)i);
        waits[i] = options->runs[i] && !report_has(run->report, (enum path_id)i, frames);
        total += waits[i] ? drive_frame_count(options, (enum path_id)i, frames) : 0;
    }
    progress_begin(&run->progress, total, options->quiet);
    for (int i = 0; i < PATH_COUNT && is_ok; i++)
        is_ok = !waits[i] || measure(run, (enum path_id)i, error);
    progress_end(&run->progress);
    return is_ok;
}

static void print_list(void)
{
    printf("Paths\n");
    for (int i = 0; i < PATH_COUNT; i++)
        printf("  %-18s %s; %u frames, at least %u\n", path_infos[i].name, path_infos[i].help,
               path_infos[i].frames, path_infos[i].minimum);
    printf("\nMeasures\n");
    for (int i = 0; i < MEASURE_COUNT; i++)
        printf("  %-24s %-7s %s\n", measure_infos[i].name, measure_infos[i].unit, measure_infos[i].help);
}

/* True when everything was measured and nothing is above its limit. */
static bool run_all(struct run *run, struct error *error)
{
    if (!set_up(run, error))
        return false;
    struct error late;
    bool is_measured = measure_all(run, error);
    bool is_fine = report_finish(run->report, is_measured ? error : &late) && is_measured;
    if (!run->options.quiet) {
        report_print(run->report, stdout);
        printf("%s/report.html\n", run->options.folder);
    }
    return is_fine;
}

int main(int argc, char **argv)
{
    static struct run run;
    struct error error, late;
    if (!stability_options_parse(&run.options, argc, argv, &error)) {
        fprintf(stderr, "caustic-stability: %s\n", error.message);
        return 2;
    }
    if (run.options.help || run.options.version) {
        fputs(run.options.help ? stability_help : "caustic-stability " CAUSTIC_VERSION "\n", stdout);
        return 0;
    }
    if (run.options.list) {
        print_list();
        return 0;
    }
    bool is_fine = run_all(&run, &error);
    if (!is_fine)
        fprintf(stderr, "caustic-stability: %s\n", error.message);
    report_destroy(&run.report);
    drive_clear(&run.drive);
    client_destroy(&run.client);
    if (run.server && !server_process_stop(&run.server, &late) && is_fine) {
        fprintf(stderr, "caustic-stability: %s\n", late.message);
        is_fine = false;
    }
    return is_fine ? 0 : 1;
}
