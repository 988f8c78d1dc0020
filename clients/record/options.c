#include "options.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char record_help[] =
    "caustic-record: records frames of a running causticd as EXR and PNG files.\n"
    "\n"
    "  caustic-record                                     one frame of the scene's own camera into out/\n"
    "  caustic-record --frames 48 --camera orbit --fps 24 two seconds of a camera that the glTF file "
    "animates\n"
    "  caustic-record --eye 0,1,4 --at 0,0.3,0 --fov 40 --warmup 8 --png --out shot\n"
    "  caustic-record --path keys.json --frames 100 --set photons=500000 --light lamp.intensity=40,38,30\n"
    "  caustic-record --set accumulate=256 --set aa=pixel --channels caustics    a reference without bias\n"
    "\n"
    "Every frame is rendered once and in order; the same command on the same server gives the same bits.\n"
    "\n"
    "Server\n"
    "  --connect ADDRESS     tcp:HOST:PORT or unix:PATH; default tcp:127.0.0.1:7420\n"
    "  --wait SECONDS        wait for a server that is still starting; default 0\n"
    "  --format f32|f16      how pixels travel; f16 halves the traffic and rounds; default f32\n"
    "  --tile-encoding zstd|raw\n"
    "                        compressed without the empty tiles, or plain rows; the same pixels; default "
    "zstd\n"
    "\n"
    "What is seen\n"
    "  --size WxH            pixels; default 480x270\n"
    "  --eye X,Y,Z --at X,Y,Z [--up X,Y,Z] [--fov DEGREES]\n"
    "                        a camera at eye that looks at at; metres, Y is up, fov is vertical; default up\n"
    "                        0,1,0 and fov 45\n"
    "  --camera NAME         a camera of the scene, with its animation\n"
    "  --path FILE           a camera that moves through keyframes:\n"
    "                          {\"interpolation\": \"catmull-rom\" or \"linear\",\n"
    "                           \"keys\": [{\"time\": 0, \"eye\": [0,1,4], \"at\": [0,0,0], \"up\": [0,1,0], "
    "\"fov\": 45},\n"
    "                                    ...]}\n"
    "                        \"time\" is in seconds; \"frame\" counts this recording's frames instead; keys "
    "with neither\n"
    "                        are spread evenly over it. up and fov may be left out\n"
    "                        Without any of these: the scene's first camera\n"
    "  --light NAME.intensity=R,G,B, NAME.position=X,Y,Z, NAME.direction=X,Y,Z\n"
    "                        changes a light of the scene; may be repeated\n"
    "  --set NAME=VALUE      a setting of the view; may be repeated. A name that does not exist is answered "
    "with\n"
    "                        those that do\n"
    "\n"
    "When\n"
    "  --frames N            frames to record; default 1\n"
    "  --warmup K            frames rendered and thrown away first, so that photons have found their places; "
    "default 0\n"
    "  --time SECONDS        the first frame's place in the scene's animation; default 0\n"
    "  --fps RATE            frames per second of that animation and of a path's \"time\"; 0: time stands "
    "still;\n"
    "                        default 24\n"
    "\n"
    "What is written\n"
    "  --out FOLDER          made if it is missing; default out\n"
    "  --channels LIST       of caustics, irradiance, beauty, depth, normal, albedo, indirect, density, "
    "variance, or "
    "all; what\n"
    "                        is not listed is not rendered either; default caustics,irradiance,beauty\n"
    "                          frame_0000.exr    32-bit float: caustics.R/G/B, irradiance.R/G/B, R/G/B "
    "(beauty), Z,\n"
    "                                            N.X/Y/Z, albedo.R/G/B; camera matrices, settings, seed and "
    "version\n"
    "                                            as attributes\n"
    "                          density_0000.exr  and variance_0000.exr: the lights' task buffers, at their "
    "own size\n"
    "                          stats.json        per frame: pass times in ns, statistics, flux by fate, "
    "guards, plan\n"
    "  --png                 also frame_0000.png: beauty if it is recorded, else caustics, else irradiance, "
    "as\n"
    "                        sRGB(1 - exp(-2^exposure * value)), which bends highlights instead of cutting "
    "them off\n"
    "  --exposure STOPS      of the PNG; without it the first frame's is chosen (its median lit pixel "
    "becomes a middle\n"
    "                        grey) and kept\n"
    "\n"
    "  --quiet               no progress and no closing table\n"
    "  --help, --version\n"
    "\n"
    "Exit status: 0 recorded, 1 something failed, 2 the command line is wrong.\n";

enum {
    OPTION_CONNECT = 256,
    OPTION_WAIT,
    OPTION_FORMAT,
    OPTION_ENCODING,
    OPTION_SIZE,
    OPTION_EYE,
    OPTION_AT,
    OPTION_UP,
    OPTION_FOV,
    OPTION_CAMERA,
    OPTION_PATH,
    OPTION_LIGHT,
    OPTION_SET,
    OPTION_FRAMES,
    OPTION_WARMUP,
    OPTION_TIME,
    OPTION_FPS,
    OPTION_OUT,
    OPTION_CHANNELS,
    OPTION_PNG,
    OPTION_EXPOSURE,
    OPTION_QUIET,
    OPTION_HELP,
    OPTION_VERSION
};

static const struct option long_options[] = {
    {"connect", required_argument, NULL, OPTION_CONNECT},
    {"wait", required_argument, NULL, OPTION_WAIT},
    {"format", required_argument, NULL, OPTION_FORMAT},
    {"tile-encoding", required_argument, NULL, OPTION_ENCODING},
    {"size", required_argument, NULL, OPTION_SIZE},
    {"eye", required_argument, NULL, OPTION_EYE},
    {"at", required_argument, NULL, OPTION_AT},
    {"up", required_argument, NULL, OPTION_UP},
    {"fov", required_argument, NULL, OPTION_FOV},
    {"camera", required_argument, NULL, OPTION_CAMERA},
    {"path", required_argument, NULL, OPTION_PATH},
    {"light", required_argument, NULL, OPTION_LIGHT},
    {"set", required_argument, NULL, OPTION_SET},
    {"frames", required_argument, NULL, OPTION_FRAMES},
    {"warmup", required_argument, NULL, OPTION_WARMUP},
    {"time", required_argument, NULL, OPTION_TIME},
    {"fps", required_argument, NULL, OPTION_FPS},
    {"out", required_argument, NULL, OPTION_OUT},
    {"channels", required_argument, NULL, OPTION_CHANNELS},
    {"png", no_argument, NULL, OPTION_PNG},
    {"exposure", required_argument, NULL, OPTION_EXPOSURE},
    {"quiet", no_argument, NULL, OPTION_QUIET},
    {"help", no_argument, NULL, OPTION_HELP},
    {"version", no_argument, NULL, OPTION_VERSION},
    {NULL, 0, NULL, 0},
};

/* NAME.intensity=R,G,B; the name may hold dots. Changes of one light gather in one entry. */
static bool parse_light(const char *text, struct record_options *options, struct error *error)
{
    static const char *const properties[] = {"intensity", "position", "direction"};
    const char *equals = strrchr(text, '='), *dot = equals;
    while (dot && dot > text && *dot != '.')
        dot--;
    if (!equals || dot == text || (size_t)(dot - text) > PROTOCOL_MAX_TEXT_BYTES)
        return error_set(error, STATUS_INVALID,
                         "--light %.100s: write NAME.intensity=R,G,B, NAME.position=X,Y,Z or "
                         "NAME.direction=X,Y,Z",
                         text);
    uint32_t property = 0;
    while (property < 3 && (strlen(properties[property]) != (size_t)(equals - dot - 1) ||
                            memcmp(properties[property], dot + 1, strlen(properties[property])) != 0))
        property++;
    if (property == 3)
        return error_set(error, STATUS_INVALID,
                         "--light %.100s: a light has intensity, position and direction", text);
    size_t length = (size_t)(dot - text);
    struct record_light *light = options->lights, *end = options->lights + options->light_count;
    while (light < end && (strlen(light->name) != length || memcmp(light->name, text, length) != 0))
        light++;
    if (light == end) {
        if (options->light_count == PROTOCOL_MAX_LIGHTS)
            return error_set(error, STATUS_LIMIT, "--light %.100s: at most %u lights", text,
                             PROTOCOL_MAX_LIGHTS);
        options->light_count++;
        memcpy(light->name, text, length);
        light->name[length] = 0;
    }
    float *vectors[] = {light->change.intensity, light->change.position, light->change.direction};
    light->change.overrides |= 1u << property;
    return option_vector("light", equals + 1, vectors[property], error);
}

static bool parse_setting(const char *text, struct record_options *options, struct error *error)
{
    if (options->setting_count == RECORD_MAX_SETTINGS)
        return error_set(error, STATUS_LIMIT, "--set %.100s: at most %u settings", text, RECORD_MAX_SETTINGS);
    return option_setting(text, &options->settings[options->setting_count++], error);
}

static bool parse_word(const char *option, const char *text, const char *first, const char *second,
                       bool *is_second, struct error *error)
{
    if (strcmp(text, first) != 0 && strcmp(text, second) != 0)
        return error_set(error, STATUS_INVALID, "--%s %.100s: must be %s or %s", option, text, first, second);
    *is_second = strcmp(text, second) == 0;
    return true;
}

static bool parse_one(struct record_options *options, int option, const char *value, struct error *error)
{
    double number;
    bool is_second;
    switch (option) {
    case OPTION_CONNECT:
        options->address = value;
        return option_address(value, error);
    case OPTION_WAIT:
        return option_number("wait", value, 0, 3600, &options->wait, error);
    case OPTION_FORMAT:
        if (!parse_word("format", value, "f32", "f16", &is_second, error))
            return false;
        options->format = is_second ? PROTOCOL_F16 : PROTOCOL_F32;
        return true;
    case OPTION_ENCODING:
        if (!parse_word("tile-encoding", value, "zstd", "raw", &is_second, error))
            return false;
        options->encoding = is_second ? PROTOCOL_RAW : PROTOCOL_ZSTD;
        return true;
    case OPTION_SIZE:
        return option_size(value, &options->width, &options->height, error);
    case OPTION_EYE:
        return options->has_eye = option_vector("eye", value, options->camera.eye, error);
    case OPTION_AT:
        return options->has_at = option_vector("at", value, options->camera.at, error);
    case OPTION_UP:
        return options->has_up = option_vector("up", value, options->camera.up, error);
    case OPTION_FOV:
        if (!option_number("fov", value, 1e-3, 178.999, &number, error))
            return false;
        options->fov = (float)number;
        return true;
    case OPTION_CAMERA:
        options->camera_name = value;
        return *value ||
               error_set(error, STATUS_INVALID, "--camera: needs the name of a camera of the scene");
    case OPTION_PATH:
        options->path_file = value;
        return true;
    case OPTION_LIGHT:
        return parse_light(value, options, error);
    case OPTION_SET:
        return parse_setting(value, options, error);
    case OPTION_FRAMES:
        return option_count("frames", value, 1, &options->frames, error);
    case OPTION_WARMUP:
        return option_count("warmup", value, 0, &options->warmup, error);
    case OPTION_TIME:
        options->has_time = true;
        return option_number("time", value, -1e9, 1e9, &options->time, error);
    case OPTION_FPS:
        return option_number("fps", value, 0, 1e6, &options->rate, error);
    case OPTION_OUT:
        options->folder = value;
        return *value || error_set(error, STATUS_INVALID, "--out: needs the name of a folder");
    case OPTION_CHANNELS:
        options->channels = value;
        return true;
    case OPTION_PNG:
        options->png = true;
        return true;
    case OPTION_EXPOSURE:
        options->has_exposure = true;
        return option_number("exposure", value, -64, 64, &options->exposure, error);
    case OPTION_QUIET:
        options->quiet = true;
        return true;
    case OPTION_HELP:
        options->help = true;
        return true;
    default:
        options->version = true;
        return true;
    }
}

static bool check_together(const struct record_options *options, struct error *error)
{
    bool is_free = options->has_eye || options->has_at || options->has_up;
    if (options->camera_name && options->path_file)
        return error_set(error, STATUS_INVALID, "--camera and --path exclude each other");
    if (is_free && (options->camera_name || options->path_file))
        return error_set(error, STATUS_INVALID, "--eye, --at and --up exclude %s",
                         options->camera_name ? "--camera" : "--path");
    if (is_free && !(options->has_eye && options->has_at))
        return error_set(error, STATUS_INVALID, "--%s is missing: a camera needs --eye and --at",
                         options->has_eye ? "at" : "eye");
    if (options->fov > 0 && !is_free && !options->path_file)
        return error_set(error, STATUS_INVALID, "--fov needs --eye and --at, or --path");
    return true;
}

bool record_options_parse(struct record_options *options, int argc, char **argv, struct error *error)
{
    memset(options, 0, sizeof *options);
    options->width = 480;
    options->height = 270;
    options->frames = 1;
    options->rate = 24;
    options->camera.up[1] = 1;
    options->channels = "caustics,irradiance,beauty";
    options->folder = "out";
    options->encoding = PROTOCOL_ZSTD;
    const char *value;
    option_begin();
    for (int option; (option = option_next(argc, argv, long_options, &value, error)) != OPTION_END;) {
        if (option == OPTION_WRONG || !parse_one(options, option, value, error))
            return false;
        if (options->help || options->version)
            return true;
    }
    options->camera.fov = options->fov > 0 ? options->fov : 45;
    return check_together(options, error);
}
