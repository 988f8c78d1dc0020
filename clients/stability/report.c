#include "report.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "../../core/image/image_io.h"
#include "../../core/measure/heat_map.h"
#include "report_page.h"

#ifndef CAUSTIC_VERSION
#error "the build names the version"
#endif

struct report {
    const struct stability_options *options;
    json_t *root, *paths;
};

/* ---- what the numbers depend on ------------------------------------------------------------------------ */

static json_t *json_text(struct protocol_text text)
{
    return json_stringn(text.length ? text.bytes : "", text.length);
}

static json_t *json_vector(const float *values)
{
    return json_pack("[f, f, f]", (double)values[0], (double)values[1], (double)values[2]);
}

static json_t *json_run(const struct stability_options *options, const struct drive *drive)
{
    const struct protocol_hello *hello = drive->hello;
    const struct path_base *base = &drive->base;
    json_t *settings = json_object();
    for (uint32_t i = 0; i < options->setting_count; i++)
        json_object_set_new(settings, options->settings[i].name, json_string(options->settings[i].value));
    return json_pack(
        "{s:{s:o, s:o, s:o, s:o}, s:{s:o, s:i, s:f}, s:{s:i, s:i, s:s, s:o, s:o, s:f, s:o}, s:o, s:{s:s, "
        "s:s},"
        " s:{s:f, s:f, s:f, s:f, s:f, s:i, s:o}, s:{s:i, s:i}, s:{s:f, s:f, s:f}}",
        "server", "version", json_text(hello->version), "device", json_text(hello->device), "driver",
        json_text(hello->driver), "tracer", json_text(hello->tracer), "scene", "name",
        json_text(hello->scene), "triangles", (int)hello->triangles, "duration", hello->duration, "view",
        "width", (int)options->width, "height", (int)options->height, "channel", options->channel, "eye",
        json_vector(base->camera.eye), "at", json_vector(base->camera.at), "fov", (double)base->camera.fov,
        "pivot", json_vector(base->pivot), "settings", settings, "flicker", "setting", options->flicker.name,
        "values", options->flicker.value, "path", "orbit_step", base->orbit_step, "cut_angle",
        base->cut_angle, "light_angle", base->light_angle, "sweep_step", base->sweep_step, "rate", base->rate,
        "flicker_period", (int)base->flicker_period, "light",
        base->has_light ? json_text(base->light.name) : json_null(), "references", "pairs",
        (int)options->pairs, "accumulate", (int)options->accumulate, "thresholds", "caustic_share",
        options->caustic_share, "flicker_limit", options->flicker_limit, "settle_band", options->settle_band);
}

static json_t *json_measures_help(void)
{
    json_t *object = json_object();
    for (int i = 0; i < MEASURE_COUNT; i++)
        json_object_set_new(
            object, measure_infos[i].name,
            json_pack("{s:s, s:s}", "unit", measure_infos[i].unit, "help", measure_infos[i].help));
    return object;
}

/* ---- files
 * -------------------------------------------------------------------------------------------------- */

static void in_folder(const struct report *report, const char *name, char *path, size_t size)
{
    snprintf(path, size, "%s/%s", report->options->folder, name);
}

/* Whole or absent. */
static bool write_json(const struct report *report, struct error *error)
{
    char path[4200], part[4210];
    in_folder(report, "report.json", path, sizeof path);
    snprintf(part, sizeof part, "%s.part", path);
    errno = 0;
    if (json_dump_file(report->root, part, JSON_INDENT(1) | JSON_REAL_PRECISION(9)) == 0 &&
        rename(part, path) == 0)
        return true;
    error_set(error, STATUS_IO, "--out: %.300s: %s", path, errno ? strerror(errno) : "could not be written");
    unlink(part);
    return false;
}

/* A folder that has none, or one of another run, is no fault: everything is measured anew. A file that is no
 * report is. */
static bool take_over(struct report *report, struct error *error)
{
    char path[4200];
    json_error_t fault;
    in_folder(report, "report.json", path, sizeof path);
    if (access(path, F_OK) != 0)
        return true;
    json_t *old = json_load_file(path, 0, &fault), *old_path;
    if (!json_is_array(json_object_get(old, "paths"))) {
        json_decref(old);
        return error_set(error, STATUS_INVALID,
                         "--resume: %.200s is no report of caustic-stability%s%.100s; delete it or choose "
                         "another --out",
                         path, old ? "" : ": ", old ? "" : fault.text);
    }
    size_t i;
    bool is_same = json_equal(json_object_get(old, "run"), json_object_get(report->root, "run"));
    json_array_foreach(json_object_get(old, "paths"), i, old_path)
    {
        bool is_usable = json_string_value(json_object_get(old_path, "path")) &&
                         json_is_object(json_object_get(old_path, "measures")) &&
                         json_is_true(json_object_get(old_path, "is_complete"));
        if (is_same && is_usable)
            json_array_append(report->paths, old_path);
    }
    json_decref(old);
    return true;
}

/* As it comes back from a file: what is compared with a file has to be rounded like one. */
static json_t *as_written(json_t *value)
{
    char *text = json_dumps(value, JSON_REAL_PRECISION(9));
    json_t *written = text ? json_loads(text, 0, NULL) : NULL;
    free(text);
    json_decref(value);
    return written;
}

struct report *report_create(const struct stability_options *options, const struct drive *drive,
                             struct error *error)
{
    struct report *report = calloc(1, sizeof *report);
    json_t *run = as_written(json_run(options, drive));
    if (report && run) {
        report->options = options;
        report->paths = json_array();
        report->root =
            json_pack("{s:s, s:s, s:o, s:o, s:O}", "program", "caustic-stability", "version", CAUSTIC_VERSION,
                      "run", run, "measures", json_measures_help(), "paths", report->paths);
    }
    if (!report || !report->root) {
        error_set(error, STATUS_MEMORY, "no memory for a report");
        report_destroy(&report);
        return NULL;
    }
    if ((options->resume && !take_over(report, error)) || !write_json(report, error))
        report_destroy(&report);
    return report;
}

void report_destroy(struct report **report)
{
    if (*report) {
        json_decref((*report)->paths);
        json_decref((*report)->root);
    }
    free(*report);
    *report = NULL;
}

bool report_has(const struct report *report, enum path_id path, uint32_t frames)
{
    size_t i;
    json_t *entry;
    json_array_foreach(report->paths, i, entry)
    {
        if (strcmp(json_string_value(json_object_get(entry, "path")), path_infos[path].name) == 0 &&
            json_integer_value(json_object_get(entry, "frames")) == frames &&
            json_integer_value(json_object_get(entry, "warmup")) == report->options->warmup)
            return true;
    }
    return false;
}

/* ---- pictures
 * ------------------------------------------------------------------------------------------------ */

static bool write_picture(const struct report *report, const char *name, const uint8_t *pixels,
                          const char *caption, json_t *list, struct error *error)
{
    char path[4200];
    in_folder(report, name, path, sizeof path);
    if (!image_write_png(path, report->options->width, report->options->height, 3, pixels, error))
        return error->status == STATUS_UNSUPPORTED; /* a build without image files measures all the same */
    return json_array_append_new(list, json_pack("{s:s, s:s}", "caption", caption, "file", name)) == 0;
}

static bool add_picture(const struct report *report, const struct drive *drive,
                        const struct snapshot *picture, const char *part, const char *caption, json_t *list,
                        struct error *error)
{
    char name[80];
    if (!picture->rgb)
        return true;
    uint8_t *pixels = snapshot_bytes(picture, drive->exposure, error);
    snprintf(name, sizeof name, "%s-%s.png", path_infos[drive->path].name, part);
    bool is_written = pixels && write_picture(report, name, pixels, caption, list, error);
    free(pixels);
    return is_written;
}

static bool add_flicker_map(const struct report *report, const struct drive *drive, const float *map,
                            json_t *list, struct error *error)
{
    size_t count = (size_t)drive->width * drive->height;
    double brightest = 4 * drive->options->flicker_limit;
    char name[80], caption[120];
    if (!map)
        return true;
    uint8_t *pixels = malloc(count * 3);
    if (!pixels)
        return error_set(error, STATUS_MEMORY, "no memory for a picture of %zu pixels", count);
    heat_map_colors(map, count, 0, brightest, pixels);
    snprintf(name, sizeof name, "%s-flicker.png", path_infos[drive->path].name);
    snprintf(caption, sizeof caption, "temporal std / mean: black 0, palest %g and above", brightest);
    bool is_written = write_picture(report, name, pixels, caption, list, error);
    free(pixels);
    return is_written;
}

static bool add_pictures(const struct report *report, const struct drive *drive,
                         const struct analysis *analysis, json_t *list, struct error *error)
{
    bool is_ok = true;
    if (drive->pair_count > 0 && path_infos[drive->path].kind == PATH_MOVES) {
        const struct drive_pair *pair = &drive->pairs[drive->pair_count / 2];
        is_ok =
            add_picture(report, drive, &pair->now, "middle", "in the middle of the path", list, error) &&
            add_picture(report, drive, &pair->reference_now, "reference", "the reference of it", list, error);
    } else if (path_infos[drive->path].kind == PATH_STEPS) {
        is_ok = add_picture(report, drive, &drive->kept[0], "old", "before the change", list, error) &&
                add_picture(report, drive, &drive->kept[1], "frame1", "frame 1 after it", list, error) &&
                add_picture(report, drive, &drive->kept[3], "frame3", "frame 3", list, error) &&
                add_picture(report, drive, &analysis->settled, "settled", "settled", list, error);
    } else
        is_ok = add_picture(report, drive, &drive->last, "last", "the last frame", list, error);
    return is_ok && add_flicker_map(report, drive, analysis->flicker_map, list, error);
}

/* ---- a path
 * ---------------------------------------------------------------------------------------------------- */

static json_t *json_series(const struct analysis_series *series)
{
    json_t *values = json_array();
    for (uint32_t i = 0; i < series->count; i++)
        json_array_append_new(values,
                              isfinite(series->values[i]) ? json_real(series->values[i]) : json_null());
    return json_pack("{s:s, s:s, s:s, s:I, s:o}", "name", series->name, "unit", series->unit, "help",
                     series->help, "first", (json_int_t)series->first, "values", values);
}

static json_t *json_cost(const struct drive *drive)
{
    uint32_t frames = drive->done > drive->warmup ? drive->done - drive->warmup : 0;
    double frame = frames ? drive->frame_seconds / frames : 0;
    double reference = drive->reference_frames ? drive->reference_seconds / drive->reference_frames : 0;
    return json_pack("{s:f, s:f, s:i, s:f}", "frame_seconds", frame, "reference_seconds", reference,
                     "references", (int)drive->reference_frames, "reference_frames",
                     frame > 0 ? reference / frame : 0.0);
}

bool report_add(struct report *report, const struct drive *drive, const struct analysis *analysis,
                const char *reason, struct error *error)
{
    char what[200];
    json_t *series = json_array(), *pictures = json_array();
    path_describe(drive->path, &drive->base, what, sizeof what);
    for (uint32_t i = 0; i < analysis->series_count; i++)
        json_array_append_new(series, json_series(&analysis->series[i]));
    bool is_ok = reason || add_pictures(report, drive, analysis, pictures, error);
    json_t *path = json_pack(
        "{s:s, s:s, s:i, s:i, s:b, s:o, s:o, s:o, s:o}", "path", path_infos[drive->path].name, "what", what,
        "frames", (int)drive->frames, "warmup", (int)drive->warmup, "is_complete", !reason, "measures",
        measures_json(&analysis->measures), "series", series, "pictures", pictures, "cost", json_cost(drive));
    if (reason)
        json_object_set_new(path, "reason", json_string(reason));
    json_array_append_new(report->paths, as_written(path));
    return is_ok && write_json(report, error);
}

/* ---- the end
 * ----------------------------------------------------------------------------------------------------- */

static bool judge(struct report *report, json_t *limits, struct error *error)
{
    bool all_passed = true;
    for (uint32_t i = 0; i < report->options->gate_count; i++) {
        const struct gate *gate = &report->options->gates[i];
        const char *name = measure_infos[gate->measure].name;
        json_t *results = gate_results(gate, report->paths), *result;
        size_t k;
        if (json_array_size(results) == 0 && all_passed)
            all_passed = error_set(error, STATUS_INVALID,
                                   "%s could not be measured: the path was too short or cut short", name);
        json_array_foreach(results, k, result)
        {
            char value[40];
            measure_print(json_object_get(result, "value"), value, sizeof value);
            if (!json_is_true(json_object_get(result, "passed")) && all_passed)
                all_passed =
                    error_set(error, STATUS_LIMIT, "%s.%s is %s, above the limit of %g",
                              json_string_value(json_object_get(result, "path")), name, value, gate->limit);
        }
        json_array_extend(limits, results);
        json_decref(results);
    }
    return all_passed;
}

bool report_finish(struct report *report, struct error *error)
{
    struct error verdict;
    char path[4200];
    json_t *limits = json_array();
    bool passed = judge(report, limits, &verdict);
    json_object_set_new(report->root, "limits", limits);
    in_folder(report, "report.html", path, sizeof path);
    if (!write_json(report, error) || !report_page_write(report->root, report->options->folder, path, error))
        return false;
    if (!passed)
        *error = verdict;
    return passed;
}

void report_print(const struct report *report, FILE *stream)
{
    size_t i;
    json_t *path;
    fprintf(stream, "%-24s", "");
    json_array_foreach(report->paths, i, path)
        fprintf(stream, " %16s", json_string_value(json_object_get(path, "path")));
    fputc('\n', stream);
    for (int m = 0; m < MEASURE_COUNT; m++) {
        bool is_measured = false;
        json_array_foreach(report->paths, i, path) is_measured |=
            json_object_get(json_object_get(path, "measures"), measure_infos[m].name) != NULL;
        if (!is_measured)
            continue;
        fprintf(stream, "%-24s", measure_infos[m].name);
        json_array_foreach(report->paths, i, path)
        {
            json_t *value = json_object_get(json_object_get(path, "measures"), measure_infos[m].name);
            char text[40] = "";
            if (value)
                measure_print(value, text, sizeof text);
            fprintf(stream, " %16s", text);
        }
        fprintf(stream, "  %s\n", measure_infos[m].unit);
    }
}
