#include "options.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char bench_help[] =
    "caustic-bench: error against run time of a causticd, over scenes, methods and settings.\n"
    "\n"
    "  caustic-bench --scene sphere --set photons=8192,32768,131072\n"
    "        one curve: the error of three budgets, into bench-out/\n"
    "  caustic-bench --scene sphere,ring --set aa=filter,none --set photons=8192,32768,131072 --size "
    "240x135\n"
    "        every combination\n"
    "  caustic-bench --scene pool --method default --method papers:density=area,split=once,aa=none \\\n"
    "                --set photons=16384,65536 --metric hdrflip,rell1\n"
    "        two groups of settings, judged by HDR-FLIP\n"
    "  caustic-bench --config docs/bench-example.json --compare yesterday/results.json --threshold 5\n"
    "        what a file says; exits with 1 when an error grew by more than 5 %\n"
    "  caustic-bench --connect tcp:127.0.0.1:7420 --set kappa=0.5,1,1.5,2\n"
    "        on a server that runs already, with its scene\n"
    "\n"
    "Each point is rendered through the socket from a view of its own: warm-up frames, then repeats, which "
    "are\n"
    "timed and compared with a reference. The folder gets results.json, results.csv, report.html (one file,\n"
    "opens anywhere), the plots a configuration asks for, and each point's picture. An interrupted run goes "
    "on\n"
    "where it stopped when it is started again.\n"
    "\n"
    "What is measured\n"
    "  --config FILE         a JSON file with all of this; docs/measuring.md describes it. Options below "
    "win\n"
    "                        over what it says\n"
    "  --scene LIST          built-in scenes and .gltf or .glb files, with commas\n"
    "  --size WxH            pixels; default 480x270\n"
    "  --set NAME=V1,V2,...  values of a setting; may be repeated: every combination is a point\n"
    "  --method NAME:SETTING=VALUE,...\n"
    "                        a named group of settings; may be repeated\n"
    "  --curve NAME          the setting that runs along a curve; default photons, or else the first with\n"
    "                        several numbers\n"
    "  --metric LIST         of rell1, relrmse, rmse, relmse, flip, hdrflip, ssim, flux; the first judges "
    "fronts\n"
    "                        and budgets. Default: all, by rell1\n"
    "  --warmup N            frames before those that count, so that photons find their places; default 8\n"
    "  --repeats N           frames that count; default 5\n"
    "  --budget LIST         milliseconds to find the best settings for; default: steps over what was "
    "measured\n"
    "\n"
    "The reference\n"
    "  --reference FILE      EXR (layer caustics, or R, G, B), PFM, HDR or PNG, for a single scene; without "
    "it\n"
    "                        the server makes one: aa=pixel, density=uniform, accumulated\n"
    "  --confidence R        relative L1 that it should be within of the truth, told from two halves; "
    "default\n"
    "                        0.02\n"
    "  --reference-photons N most photons spent on it; default 2e8\n"
    "  --cache DIR           where references are kept; default causticd/references in the user's cache "
    "folder\n"
    "\n"
    "The server\n"
    "  --connect ADDRESS     tcp:HOST:PORT or unix:PATH of one that runs; without it one is started per "
    "scene\n"
    "  --server PROGRAM      the causticd to start; default: the one beside this program\n"
    "  --server-option TEXT  passed on to it, as in --server-option=--device=nvidia; may be repeated\n"
    "  --timeout SECONDS     most time for one frame; default 600\n"
    "\n"
    "What comes out\n"
    "  --out FOLDER          made if it is missing; default bench-out\n"
    "  --fresh               forget what FOLDER has of an earlier run\n"
    "  --compare OLD.json    the results.json of another run: says which points got better or worse\n"
    "  --threshold PERCENT   growth of an error past which a point got worse; default 5\n"
    "  --time-threshold PERCENT\n"
    "                        the same for the time on the device; default: times are told, not judged\n"
    "  --quiet               no progress, no summary\n"
    "  --version, --help\n"
    "\n"
    "Exit status: 0 measured, and nothing got worse; 1 something got worse past its threshold; 2 wrong usage "
    "or\n"
    "configuration; 3 the server, a file or the device failed (what was finished is kept).\n";

enum {
    OPTION_CONFIG = 256,
    OPTION_SCENE,
    OPTION_SIZE,
    OPTION_SET,
    OPTION_METHOD,
    OPTION_CURVE,
    OPTION_METRIC,
    OPTION_WARMUP,
    OPTION_REPEATS,
    OPTION_BUDGET,
    OPTION_REFERENCE,
    OPTION_CONFIDENCE,
    OPTION_REFERENCE_PHOTONS,
    OPTION_CACHE,
    OPTION_CONNECT,
    OPTION_SERVER,
    OPTION_SERVER_OPTION,
    OPTION_TIMEOUT,
    OPTION_OUT,
    OPTION_FRESH,
    OPTION_COMPARE,
    OPTION_THRESHOLD,
    OPTION_TIME_THRESHOLD,
    OPTION_QUIET,
    OPTION_VERSION,
    OPTION_HELP
};

static const struct option long_options[] = {
    {"config", required_argument, NULL, OPTION_CONFIG},
    {"scene", required_argument, NULL, OPTION_SCENE},
    {"size", required_argument, NULL, OPTION_SIZE},
    {"set", required_argument, NULL, OPTION_SET},
    {"method", required_argument, NULL, OPTION_METHOD},
    {"curve", required_argument, NULL, OPTION_CURVE},
    {"metric", required_argument, NULL, OPTION_METRIC},
    {"warmup", required_argument, NULL, OPTION_WARMUP},
    {"repeats", required_argument, NULL, OPTION_REPEATS},
    {"budget", required_argument, NULL, OPTION_BUDGET},
    {"reference", required_argument, NULL, OPTION_REFERENCE},
    {"confidence", required_argument, NULL, OPTION_CONFIDENCE},
    {"reference-photons", required_argument, NULL, OPTION_REFERENCE_PHOTONS},
    {"cache", required_argument, NULL, OPTION_CACHE},
    {"connect", required_argument, NULL, OPTION_CONNECT},
    {"server", required_argument, NULL, OPTION_SERVER},
    {"server-option", required_argument, NULL, OPTION_SERVER_OPTION},
    {"timeout", required_argument, NULL, OPTION_TIMEOUT},
    {"out", required_argument, NULL, OPTION_OUT},
    {"fresh", no_argument, NULL, OPTION_FRESH},
    {"compare", required_argument, NULL, OPTION_COMPARE},
    {"threshold", required_argument, NULL, OPTION_THRESHOLD},
    {"time-threshold", required_argument, NULL, OPTION_TIME_THRESHOLD},
    {"quiet", no_argument, NULL, OPTION_QUIET},
    {"version", no_argument, NULL, OPTION_VERSION},
    {"help", no_argument, NULL, OPTION_HELP},
    {0}};

/* Says which option an error is about. */
static bool about(const char *option, struct error *error)
{
    struct error inner = *error;
    return error_set(error, inner.status, "--%s: %.450s", option, inner.message);
}

static bool set_scenes(struct bench_options *options, const char *list, struct error *error)
{
    options->config.scene_count = 0;
    for (const char *at = list; at;) {
        char source[BENCH_PATH];
        size_t length = strcspn(at, ",");
        snprintf(source, sizeof source, "%.*s", (int)length, at);
        if (!bench_config_add_scene(&options->config, source, error))
            return about("scene", error);
        at = at[length] ? at + length + 1 : NULL;
    }
    return true;
}

static bool set_budgets(struct bench_options *options, const char *list, struct error *error)
{
    struct bench_config *config = &options->config;
    config->budget_count = 0;
    for (const char *at = list; at;) {
        char text[64];
        size_t length = strcspn(at, ",");
        if (config->budget_count == BENCH_MAX_BUDGETS)
            return error_set(error, STATUS_LIMIT, "--budget: at most %u times", BENCH_MAX_BUDGETS);
        snprintf(text, sizeof text, "%.*s", (int)length, at);
        if (!option_number("budget", text, 1e-6, 1e9, &config->budgets_ms[config->budget_count++], error))
            return false;
        at = at[length] ? at + length + 1 : NULL;
    }
    return true;
}

static bool set_text(const char *option, const char *text, char *target, size_t size, struct error *error)
{
    if (!*text || strlen(text) >= size)
        return error_set(error, STATUS_INVALID, "--%s: \"%.100s\" %s", option, text,
                         *text ? "is too long" : "is empty");
    memcpy(target, text, strlen(text) + 1);
    return true;
}

/* A whole percentage or a part of one, as a share. */
static bool set_share(const char *option, const char *text, double *share, struct error *error)
{
    if (!option_number(option, text, 0, 1e6, share, error))
        return false;
    *share /= 100;
    return true;
}

static bool parse_one(struct bench_options *options, int option, const char *value, const char **reference,
                      struct error *error)
{
    struct bench_config *config = &options->config;
    switch (option) {
    case OPTION_CONFIG:
        return true;
    case OPTION_SCENE:
        return set_scenes(options, value, error);
    case OPTION_SIZE:
        return option_size(value, &config->width, &config->height, error);
    case OPTION_SET:
        return bench_config_set_axis(config, value, error) || about("set", error);
    case OPTION_METHOD:
        return bench_config_set_method(config, value, error) || about("method", error);
    case OPTION_CURVE:
        return set_text("curve", value, config->curve, sizeof config->curve, error);
    case OPTION_METRIC:
        return bench_config_set_metrics(config, value, error) || about("metric", error);
    case OPTION_WARMUP:
        return option_count("warmup", value, 0, &config->warmup, error);
    case OPTION_REPEATS:
        return option_count("repeats", value, 1, &config->repeats, error);
    case OPTION_BUDGET:
        return set_budgets(options, value, error);
    case OPTION_REFERENCE:
        *reference = value;
        return true;
    case OPTION_CONFIDENCE:
        return option_number("confidence", value, 1e-6, 1, &config->confidence, error);
    case OPTION_REFERENCE_PHOTONS:
        return option_number("reference-photons", value, 1, 1e15, &config->reference_photons, error);
    case OPTION_CACHE:
        return set_text("cache", value, config->cache, sizeof config->cache, error);
    case OPTION_CONNECT:
        options->address = value;
        return option_address(value, error);
    case OPTION_SERVER:
        options->program = value;
        return true;
    case OPTION_SERVER_OPTION:
        for (uint32_t i = 0; i < BENCH_MAX_SERVER_OPTIONS; i++)
            if (!options->server_arguments[i]) {
                options->server_arguments[i] = value;
                return true;
            }
        return error_set(error, STATUS_LIMIT, "--server-option: at most %u", BENCH_MAX_SERVER_OPTIONS);
    case OPTION_TIMEOUT:
        return option_number("timeout", value, 0.001, 86400, &options->timeout, error);
    case OPTION_OUT:
        options->folder = value;
        return true;
    case OPTION_FRESH:
        return options->is_fresh = true;
    case OPTION_COMPARE:
        options->compare = value;
        return true;
    case OPTION_THRESHOLD:
        return set_share("threshold", value, &options->thresholds.error, error);
    case OPTION_TIME_THRESHOLD:
        return set_share("time-threshold", value, &options->thresholds.time, error);
    case OPTION_QUIET:
        return options->quiet = true;
    case OPTION_HELP:
        return options->help = true;
    default:
        return options->version = true;
    }
}

static bool apply_reference(struct bench_config *config, const char *reference, struct error *error)
{
    if (!reference)
        return true;
    if (config->scene_count != 1)
        return error_set(error, STATUS_INVALID,
                         "--reference: is for one scene; a configuration file gives "
                         "each scene its own");
    return set_text("reference", reference, config->scenes[0].reference, sizeof config->scenes[0].reference,
                    error);
}

/* A running server has one scene, which it names itself. */
static bool apply_address(struct bench_options *options, struct error *error)
{
    struct bench_config *config = &options->config;
    if (!options->address)
        return true;
    if (options->program || options->server_arguments[0])
        return error_set(error, STATUS_INVALID, "--connect excludes --server and --server-option");
    if (config->scene_count > 1)
        return error_set(error, STATUS_INVALID, "--connect: that server has one scene, not %u",
                         config->scene_count);
    return config->scene_count == 1 || bench_config_add_scene(config, "scene", error);
}

/* Takes the options one after another; with `file`, only that of --config. */
static bool parse_all(struct bench_options *options, int argc, char **argv, const char **file,
                      const char **reference, struct error *error)
{
    const char *value;
    option_begin();
    for (int option; (option = option_next(argc, argv, long_options, &value, error)) != OPTION_END;) {
        if (option == OPTION_WRONG || (!file && !parse_one(options, option, value, reference, error)))
            return false;
        if (file && option == OPTION_CONFIG)
            *file = value;
        if (options->help || options->version)
            return true;
    }
    return true;
}

bool bench_options_parse(struct bench_options *options, int argc, char **argv, struct error *error)
{
    const char *file = NULL, *reference = NULL;
    memset(options, 0, sizeof *options);
    bench_config_default(&options->config);
    options->folder = "bench-out";
    options->timeout = 600;
    options->thresholds = (struct bench_thresholds){.error = 0.05, .time = INFINITY};
    if (!parse_all(options, argc, argv, &file, &reference, error))
        return false;
    if (file && !bench_config_read(&options->config, file, error))
        return false;
    if (!parse_all(options, argc, argv, NULL, &reference, error))
        return false;
    if (options->help || options->version)
        return true;
    if (!*options->folder || strlen(options->folder) > 900)
        return error_set(error, STATUS_INVALID, "--out: needs the name of a folder");
    return apply_address(options, error) && apply_reference(&options->config, reference, error) &&
           bench_config_check(&options->config, error);
}
