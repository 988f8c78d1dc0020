#include "options.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_KEPT_BYTES (4.0 * 0x1p30) /* of pictures, by paths that need all of them at their end */

const char stability_help[] =
    "caustic-stability: measures how steady the caustics of a causticd are over time.\n"
    "\n"
    "  caustic-stability --scene ring                      every path but drift on a server of its own\n"
    "  caustic-stability --connect unix:/tmp/c.sock --path still,light-step\n"
    "  caustic-stability --scene room.glb --path still --fail-above flicker_p99=0.005\n"
    "  caustic-stability --scene pool --path drift --frames 20000 --size 160x90\n"
    "  caustic-stability --scene sphere --path settings-flicker --flicker target_area=0.1,0.2\n"
    "\n"
    "It drives cameras, lights, time and settings along fixed paths through the socket, like any other\n"
    "client, and writes report.json and report.html (one file, no network) with every measure, its plot\n"
    "and what it means. The same command on the same server measures the same numbers.\n"
    "\n"
    "Server\n"
    "  --connect ADDRESS     tcp:HOST:PORT or unix:PATH of a running one; default tcp:127.0.0.1:7420\n"
    "  --scene SCENE         instead: start one on a built-in scene or a .glb file, and stop it at the end\n"
    "  --wait SECONDS        wait for a server that is still starting; default 0\n"
    "  --timeout SECONDS     give up on a frame after so long; default 600\n"
    "\n"
    "What is driven\n"
    "  --path LIST           of still, orbit, cut, light-step, light-sweep, object, settings-flicker, "
    "drift,\n"
    "                        or all; default all but drift. --list explains them\n"
    "  --frames N            measured frames of every path; default 64 (still, settings-flicker), 48 (what\n"
    "                        moves), 32 (steps), 5000 (drift)\n"
    "  --warmup K            frames before them, in which the task buffers settle; default 16\n"
    "  --size WxH            pixels; default 480x270\n"
    "  --channel NAME        caustics, irradiance or beauty; default caustics\n"
    "  --set NAME=VALUE      a setting of the view; may be repeated\n"
    "  --seed N              of every random choice; the same as --set seed=N\n"
    "  --camera NAME, or --eye X,Y,Z --at X,Y,Z [--up X,Y,Z] [--fov DEGREES]\n"
    "                        where the camera starts; default: the scene's first camera\n"
    "  --light NAME          the light that moves; default: the first\n"
    "  --orbit-step DEG      of orbit, a frame; default 0.25\n"
    "  --cut-angle DEG       of cut; default 30\n"
    "  --light-angle DEG     of light-step; default 40\n"
    "  --sweep-step DEG      of light-sweep, a frame; default 0.5\n"
    "  --fps RATE            of object, where the scene is animated; default 24\n"
    "  --flicker NAME=A,B    the setting that settings-flicker switches; default photons=131072,65536\n"
    "  --flicker-period N    frames it stays with each; default 8\n"
    "\n"
    "References\n"
    "  --pairs N             places along a moving path where two frames are compared with the server's own\n"
    "                        accumulated ones; default 3. 0: no references at all\n"
    "  --accumulate N        jittered frames averaged into a reference; default 16. The report says what "
    "they\n"
    "                        cost, and how noisy they still are\n"
    "\n"
    "What counts\n"
    "  --caustic-share S     a pixel is caustic from this share of the 99th percentile of the lit pixels "
    "on;\n"
    "                        default 0.02\n"
    "  --flicker-limit S     a pixel flickers when its temporal std / mean is above; default 0.005\n"
    "  --settle-band S       a control loop has settled within this share of its end; default 0.02\n"
    "\n"
    "As a gate\n"
    "  --fail-above MEASURE=LIMIT or PATH.MEASURE=LIMIT\n"
    "                        exit 1 and name it when a measure's size is above; may be repeated. --list has\n"
    "                        the measures\n"
    "\n"
    "  --out FOLDER          made if it is missing; default stability\n"
    "  --resume              keep the paths that a report.json in FOLDER already has, when it is of the "
    "same\n"
    "                        server, scene and options\n"
    "  --quiet               no progress and no closing table\n"
    "  --list, --help, --version\n"
    "\n"
    "Exit status: 0 measured and within every limit, 1 something failed or is above a limit, 2 the command\n"
    "line is wrong. When the server goes away, what was measured until then is written.\n";

enum {
    OPTION_CONNECT = 256,
    OPTION_SCENE,
    OPTION_WAIT,
    OPTION_TIMEOUT,
    OPTION_PATH,
    OPTION_FRAMES,
    OPTION_WARMUP,
    OPTION_SIZE,
    OPTION_CHANNEL,
    OPTION_SET,
    OPTION_SEED,
    OPTION_CAMERA,
    OPTION_EYE,
    OPTION_AT,
    OPTION_UP,
    OPTION_FOV,
    OPTION_LIGHT,
    OPTION_ORBIT_STEP,
    OPTION_CUT_ANGLE,
    OPTION_LIGHT_ANGLE,
    OPTION_SWEEP_STEP,
    OPTION_FPS,
    OPTION_FLICKER,
    OPTION_FLICKER_PERIOD,
    OPTION_PAIRS,
    OPTION_ACCUMULATE,
    OPTION_CAUSTIC_SHARE,
    OPTION_FLICKER_LIMIT,
    OPTION_SETTLE_BAND,
    OPTION_FAIL_ABOVE,
    OPTION_OUT,
    OPTION_RESUME,
    OPTION_QUIET,
    OPTION_LIST,
    OPTION_HELP,
    OPTION_VERSION
};

static const struct option long_options[] = {
    {"connect", required_argument, NULL, OPTION_CONNECT},
    {"scene", required_argument, NULL, OPTION_SCENE},
    {"wait", required_argument, NULL, OPTION_WAIT},
    {"timeout", required_argument, NULL, OPTION_TIMEOUT},
    {"path", required_argument, NULL, OPTION_PATH},
    {"frames", required_argument, NULL, OPTION_FRAMES},
    {"warmup", required_argument, NULL, OPTION_WARMUP},
    {"size", required_argument, NULL, OPTION_SIZE},
    {"channel", required_argument, NULL, OPTION_CHANNEL},
    {"set", required_argument, NULL, OPTION_SET},
    {"seed", required_argument, NULL, OPTION_SEED},
    {"camera", required_argument, NULL, OPTION_CAMERA},
    {"eye", required_argument, NULL, OPTION_EYE},
    {"at", required_argument, NULL, OPTION_AT},
    {"up", required_argument, NULL, OPTION_UP},
    {"fov", required_argument, NULL, OPTION_FOV},
    {"light", required_argument, NULL, OPTION_LIGHT},
    {"orbit-step", required_argument, NULL, OPTION_ORBIT_STEP},
    {"cut-angle", required_argument, NULL, OPTION_CUT_ANGLE},
    {"light-angle", required_argument, NULL, OPTION_LIGHT_ANGLE},
    {"sweep-step", required_argument, NULL, OPTION_SWEEP_STEP},
    {"fps", required_argument, NULL, OPTION_FPS},
    {"flicker", required_argument, NULL, OPTION_FLICKER},
    {"flicker-period", required_argument, NULL, OPTION_FLICKER_PERIOD},
    {"pairs", required_argument, NULL, OPTION_PAIRS},
    {"accumulate", required_argument, NULL, OPTION_ACCUMULATE},
    {"caustic-share", required_argument, NULL, OPTION_CAUSTIC_SHARE},
    {"flicker-limit", required_argument, NULL, OPTION_FLICKER_LIMIT},
    {"settle-band", required_argument, NULL, OPTION_SETTLE_BAND},
    {"fail-above", required_argument, NULL, OPTION_FAIL_ABOVE},
    {"out", required_argument, NULL, OPTION_OUT},
    {"resume", no_argument, NULL, OPTION_RESUME},
    {"quiet", no_argument, NULL, OPTION_QUIET},
    {"list", no_argument, NULL, OPTION_LIST},
    {"help", no_argument, NULL, OPTION_HELP},
    {"version", no_argument, NULL, OPTION_VERSION},
    {NULL, 0, NULL, 0},
};

static bool parse_paths(const char *text, bool runs[PATH_COUNT], struct error *error)
{
    memset(runs, 0, PATH_COUNT * sizeof *runs);
    if (strcmp(text, "all") == 0) {
        for (int i = 0; i < PATH_COUNT; i++)
            runs[i] = true;
        return true;
    }
    for (const char *at = text;; at++) {
        char name[64];
        size_t length = strcspn(at, ",");
        enum path_id id;
        if (length == 0 || length >= sizeof name)
            return error_set(error, STATUS_INVALID,
                             "--path %.80s: write names with commas, as in still,orbit", text);
        memcpy(name, at, length);
        name[length] = 0;
        if (!path_find(name, &id, error)) {
            struct error inner = *error;
            return error_set(error, inner.status, "--path: %.400s", inner.message);
        }
        runs[id] = true;
        at += length;
        if (!*at)
            return true;
    }
}

static bool parse_flicker(const char *text, struct option_setting *flicker, struct error *error)
{
    struct error inner;
    if (!option_setting(text, flicker, &inner) || !strchr(flicker->value, ',') || flicker->value[0] == ',' ||
        !strchr(flicker->value, ',')[1])
        return error_set(error, STATUS_INVALID,
                         "--flicker %.100s: write NAME=FIRST,SECOND, as in aa=filter,none", text);
    return true;
}

static bool add_setting(const char *text, struct stability_options *options, struct error *error)
{
    if (options->setting_count == STABILITY_MAX_SETTINGS)
        return error_set(error, STATUS_LIMIT, "--set %.100s: at most %u settings", text,
                         STABILITY_MAX_SETTINGS);
    return option_setting(text, &options->settings[options->setting_count++], error);
}

static bool add_gate(const char *text, struct stability_options *options, struct error *error)
{
    if (options->gate_count == GATE_MAX)
        return error_set(error, STATUS_LIMIT, "--fail-above %.100s: at most %u limits", text, GATE_MAX);
    return gate_parse(text, &options->gates[options->gate_count++], error);
}

static bool parse_one(struct stability_options *options, int option, const char *value, struct error *error)
{
    struct path_base *base = &options->base;
    struct protocol_camera *camera = &options->free_camera;
    char text[160];
    double number;
    switch (option) {
    case OPTION_CONNECT:
        options->address = value;
        return option_address(value, error);
    case OPTION_SCENE:
        options->scene = value;
        return *value || error_set(error, STATUS_INVALID, "--scene: needs the name of a scene");
    case OPTION_WAIT:
        return option_number("wait", value, 0, 3600, &options->wait, error);
    case OPTION_TIMEOUT:
        return option_number("timeout", value, 0.1, 86400, &options->timeout, error);
    case OPTION_PATH:
        return parse_paths(value, options->runs, error);
    case OPTION_FRAMES:
        return option_count("frames", value, 1, &options->frames, error);
    case OPTION_WARMUP:
        return option_count("warmup", value, 0, &options->warmup, error);
    case OPTION_SIZE:
        return option_size(value, &options->width, &options->height, error);
    case OPTION_CHANNEL:
        options->channel = value;
        return true;
    case OPTION_SET:
        return add_setting(value, options, error);
    case OPTION_SEED:
        snprintf(text, sizeof text, "seed=%.100s", value);
        return option_number("seed", value, 0, 2147483647, &number, error) &&
               add_setting(text, options, error);
    case OPTION_CAMERA:
        options->camera = value;
        return *value ||
               error_set(error, STATUS_INVALID, "--camera: needs the name of a camera of the scene");
    case OPTION_EYE:
        return options->has_eye = option_vector("eye", value, camera->eye, error);
    case OPTION_AT:
        return options->has_at = option_vector("at", value, camera->at, error);
    case OPTION_UP:
        return option_vector("up", value, camera->up, error);
    case OPTION_FOV:
        if (!option_number("fov", value, 1e-3, 178.999, &number, error))
            return false;
        camera->fov = (float)number;
        return true;
    case OPTION_LIGHT:
        options->light = value;
        return true;
    case OPTION_ORBIT_STEP:
        return option_number("orbit-step", value, -180, 180, &base->orbit_step, error);
    case OPTION_CUT_ANGLE:
        return option_number("cut-angle", value, -180, 180, &base->cut_angle, error);
    case OPTION_LIGHT_ANGLE:
        return option_number("light-angle", value, -180, 180, &base->light_angle, error);
    case OPTION_SWEEP_STEP:
        return option_number("sweep-step", value, -180, 180, &base->sweep_step, error);
    case OPTION_FPS:
        return option_number("fps", value, 1e-3, 1e6, &base->rate, error);
    case OPTION_FLICKER:
        return parse_flicker(value, &options->flicker, error);
    case OPTION_FLICKER_PERIOD:
        return option_count("flicker-period", value, 1, &base->flicker_period, error);
    case OPTION_PAIRS:
        return option_count("pairs", value, 0, &options->pairs, error);
    case OPTION_ACCUMULATE:
        return option_count("accumulate", value, 1, &options->accumulate, error);
    case OPTION_CAUSTIC_SHARE:
        return option_number("caustic-share", value, 1e-9, 1, &options->caustic_share, error);
    case OPTION_FLICKER_LIMIT:
        return option_number("flicker-limit", value, 1e-12, 1e6, &options->flicker_limit, error);
    case OPTION_SETTLE_BAND:
        return option_number("settle-band", value, 1e-9, 1, &options->settle_band, error);
    case OPTION_FAIL_ABOVE:
        return add_gate(value, options, error);
    case OPTION_OUT:
        options->folder = value;
        return *value || error_set(error, STATUS_INVALID, "--out: needs the name of a folder");
    case OPTION_RESUME:
        return options->resume = true;
    case OPTION_QUIET:
        return options->quiet = true;
    case OPTION_LIST:
        return options->list = true;
    case OPTION_HELP:
        return options->help = true;
    default:
        return options->version = true;
    }
}

uint32_t stability_frames(const struct stability_options *options, enum path_id path)
{
    return options->frames ? options->frames : path_infos[path].frames;
}

static bool check_paths(const struct stability_options *options, struct error *error)
{
    for (int i = 0; i < PATH_COUNT; i++) {
        const struct path_info *info = &path_infos[i];
        uint32_t frames = stability_frames(options, (enum path_id)i);
        if (!options->runs[i])
            continue;
        if (frames < info->minimum)
            return error_set(error, STATUS_INVALID,
                             "--frames %u: too few to measure path %s, which takes at least %u", frames,
                             info->name, info->minimum);
        if ((info->kind == PATH_STEPS || info->kind == PATH_MOVES) && options->warmup == 0)
            return error_set(error, STATUS_INVALID,
                             "--warmup 0: path %s needs a picture from before it; give it 1 at least",
                             info->name);
        double kept = 16.0 * options->width * options->height * frames;
        if ((info->kind == PATH_STEPS || info->kind == PATH_ALTERNATES) && kept > MAX_KEPT_BYTES)
            return error_set(
                error, STATUS_LIMIT,
                "--frames %u: path %s keeps its frames, and at %ux%u they take %.3g GiB of at most "
                "%.3g; choose fewer or a smaller --size",
                frames, info->name, options->width, options->height, kept * 0x1p-30,
                MAX_KEPT_BYTES * 0x1p-30);
        if (info->kind == PATH_ALTERNATES && frames < 4 * options->base.flicker_period)
            return error_set(
                error, STATUS_INVALID,
                "--flicker-period %u: %u frames are too few for path %s, which takes four periods",
                options->base.flicker_period, frames, info->name);
    }
    return true;
}

static bool check_gates(const struct stability_options *options, struct error *error)
{
    uint32_t all = 0;
    for (int i = 0; i < PATH_COUNT; i++)
        all |= options->runs[i] ? 1u << path_infos[i].kind : 0;
    for (uint32_t i = 0; i < options->gate_count; i++) {
        const struct gate *gate = &options->gates[i];
        enum path_id id;
        if (*gate->path && (!path_find(gate->path, &id, error) || !options->runs[id]))
            return error_set(error, STATUS_INVALID, "--fail-above %s.%s: path %s is not run", gate->path,
                             measure_infos[gate->measure].name, gate->path);
        if (!gate_check(gate, *gate->path ? 1u << path_infos[id].kind : all, options->pairs > 0, error))
            return false;
    }
    return true;
}

static bool check_together(const struct stability_options *options, struct error *error)
{
    if (options->address && options->scene)
        return error_set(error, STATUS_INVALID, "--connect and --scene exclude each other");
    if (options->has_eye != options->has_at)
        return error_set(error, STATUS_INVALID, "--%s is missing: a camera needs --eye and --at",
                         options->has_eye ? "at" : "eye");
    if (options->camera && options->has_eye)
        return error_set(error, STATUS_INVALID, "--camera and --eye exclude each other");
    return check_paths(options, error) && check_gates(options, error);
}

bool stability_options_parse(struct stability_options *options, int argc, char **argv, struct error *error)
{
    *options = (struct stability_options){
        .timeout = 600,
        .warmup = 16,
        .width = 480,
        .height = 270,
        .channel = "caustics",
        .free_camera = {.up = {0, 1, 0}, .fov = 45},
        .flicker = {"photons", "131072,65536"},
        .base = {.orbit_step = 0.25,
                 .cut_angle = 30,
                 .light_angle = 40,
                 .sweep_step = 0.5,
                 .rate = 24,
                 .flicker_period = 8},
        .pairs = 3,
        .accumulate = 16,
        .caustic_share = 0.02,
        .flicker_limit = 0.005,
        .settle_band = 0.02,
        .folder = "stability",
    };
    for (int i = 0; i < PATH_COUNT; i++)
        options->runs[i] = i != PATH_DRIFT;
    const char *value;
    option_begin();
    for (int option; (option = option_next(argc, argv, long_options, &value, error)) != OPTION_END;) {
        if (option == OPTION_WRONG || !parse_one(options, option, value, error))
            return false;
        if (options->help || options->list || options->version)
            return true;
    }
    return check_together(options, error);
}
