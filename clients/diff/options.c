#include "options.h"

#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/measure/image_measure.h"

const char *const metric_names[METRIC_COUNT] = {
    [METRIC_RMSE] = "rmse",   [METRIC_RELRMSE] = "relrmse", [METRIC_RELMSE] = "relmse",
    [METRIC_RELL1] = "rell1", [METRIC_FLUX] = "flux",       [METRIC_SSIM] = "ssim",
    [METRIC_FLIP] = "flip",   [METRIC_HDRFLIP] = "hdrflip", [METRIC_FIREFLIES] = "fireflies",
};

const char diff_help[] =
    "caustic-diff: how far an image is from a reference.\n"
    "\n"
    "  caustic-diff frame_0000.exr truth.exr                      the usual measures\n"
    "  caustic-diff frame_0000.exr truth.exr --layer caustics     of the channels caustics.R, .G and .B\n"
    "  caustic-diff a.png b.png --metric flip --heatmap flip.png  and where it differs\n"
    "  caustic-diff a.exr b.exr --metric rell1,flux --fail-above rell1=0.05 --fail-above flux=0.01\n"
    "                                                             a gate: ends with 1 when either is passed\n"
    "  caustic-diff a.exr b.exr --crop 100,40,64,64 --json        of a part, for a program to read\n"
    "\n"
    "  caustic-diff IMAGE REFERENCE [OPTIONS]\n"
    "\n"
    "Files are EXR, PFM, Radiance HDR, PNG or JPEG, told apart by what is in them. All measures but ssim "
    "work in\n"
    "linear light: 8- and 16-bit integers are sRGB-decoded to 0..1, floats are taken as they are. Both must "
    "have\n"
    "the same size; a NaN or an infinity in either is reported with its pixel count and nothing is "
    "measured.\n"
    "\n"
    "What is measured (a is the image, b the reference; sums and means over pixels and R, G, B)\n"
    "  --metric LIST         of these, comma-separated, or all; default rmse,rell1,flux,ssim and flip for "
    "PNG\n"
    "                        and JPEG or hdrflip for the others\n"
    "      rmse              sqrt(mean (a-b)^2), in the image's unit\n"
    "      relrmse           sqrt(sum (a-b)^2 / sum b^2): the bright parts decide\n"
    "      relmse            mean of (a-b)^2 / (b^2 + epsilon): every part counts by its own brightness. It "
    "is\n"
    "                        not the square of relrmse\n"
    "      rell1             sum |a-b| / sum |b|\n"
    "      flux              (sum a - sum b) / sum b, with its sign: 0.02 is 2 % too much light\n"
    "      ssim              structural similarity of luminance, Gaussian window 11x11: 1 is the same. PNG "
    "and\n"
    "                        JPEG by their stored values with range 1, others by the luminance "
    "that\n"
    "                        99 % of the reference's lit pixels stay below\n"
    "      flip              LDR-FLIP, 0 to 1, of values clamped to 0..1: what someone who switches between "
    "the\n"
    "                        two on a display would notice; black against white is 0.97\n"
    "      hdrflip           HDR-FLIP: the largest over a range of exposures that the reference decides\n"
    "      fireflies         pixels brighter than 4 times the median of the 7x7 around them in the "
    "reference\n"
    "  --layer NAME          which channels of an EXR: NAME.R, NAME.G and NAME.B, or the one channel NAME "
    "as\n"
    "                        grey. Default R, G and B. A file without layers is taken as it is\n"
    "  --crop X,Y,W,H        only this part, as if the files were cut to it\n"
    "  --mask FILE           only pixels where this image of the same size is above half; their "
    "surroundings\n"
    "                        still count for ssim, flip, hdrflip and fireflies\n"
    "\n"
    "What is made of it\n"
    "  --fail-above METRIC=VALUE, or VALUE for every metric that is measured; may be repeated. Ends with 1 "
    "when\n"
    "                        one is above: of flux its magnitude, of ssim 1 - ssim\n"
    "  --heatmap OUT.png     per pixel, of the first metric: black is none, pale yellow most; cyan is "
    "masked\n"
    "  --json                one object on stdout instead of a table\n"
    "\n"
    "How\n"
    "  --ppd N               pixels per degree for flip and hdrflip, 5 to 500; default 67.02: 0.7 m from a\n"
    "                        display 0.7 m and 3840 pixels wide\n"
    "  --epsilon E           of relmse, in squared units of the image; default 0.01\n"
    "  --ssim-range L        dynamic range for ssim\n"
    "  --firefly-floor L     fireflies are also brighter than this; default 0\n"
    "  --transfer srgb|linear\n"
    "                        how integers are encoded; default srgb\n"
    "\n"
    "Exit status: 0 measured, and nothing above its limit; 1 something is above; 2 nothing could be "
    "measured.\n"
    "docs/measuring.md says which measure answers which question.\n";

void options_add_metric(struct options *options, enum metric metric)
{
    for (uint32_t i = 0; i < options->metric_count; i++)
        if (options->metrics[i] == metric)
            return;
    options->metrics[options->metric_count++] = metric;
}

static bool find_metric(const char *name, size_t length, enum metric *metric)
{
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        if (strlen(metric_names[i]) == length && strncmp(metric_names[i], name, length) == 0) {
            *metric = (enum metric)i;
            return true;
        }
    return false;
}

static bool no_metric(const char *option, const char *name, size_t length, struct error *error)
{
    char list[128];
    size_t used = 0;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        used += (size_t)snprintf(list + used, sizeof list - used, "%s%s", i ? ", " : "", metric_names[i]);
    return error_set(error, STATUS_INVALID, "%s: there is no metric \"%.*s\"; there are %s", option,
                     (int)length, name, list);
}

static bool parse_metrics(const char *list, struct options *options, struct error *error)
{
    if (strcmp(list, "all") == 0) {
        for (uint32_t i = 0; i < METRIC_COUNT; i++)
            options_add_metric(options, (enum metric)i);
        return true;
    }
    for (const char *name = list;; name++) {
        size_t length = strcspn(name, ",");
        enum metric metric;
        if (!find_metric(name, length, &metric))
            return no_metric("--metric", name, length, error);
        options_add_metric(options, metric);
        name += length;
        if (!*name)
            return true;
    }
}

/* A whole finite number from `low` upward. */
static bool parse_number(const char *option, const char *text, double low, double *number,
                         struct error *error)
{
    char *end;
    *number = strtod(text, &end);
    if (end == text || *end || !isfinite(*number) || *number < low)
        return error_set(error, STATUS_INVALID, "%s %s: it takes a number of %g or more", option, text, low);
    return true;
}

static bool parse_limit(const char *text, struct options *options, struct error *error)
{
    const char *equals = strchr(text, '=');
    enum metric metric = METRIC_COUNT;
    double *limit = &options->limit;
    if (equals) {
        if (!find_metric(text, (size_t)(equals - text), &metric))
            return no_metric("--fail-above", text, (size_t)(equals - text), error);
        limit = &options->limits[metric];
    }
    return parse_number("--fail-above", equals ? equals + 1 : text, 0, limit, error);
}

static bool parse_crop(const char *text, struct options *options, struct error *error)
{
    const char *at = text;
    for (int i = 0; i < 4; i++) {
        char *end;
        unsigned long value = strtoul(at, &end, 10);
        if (end == at || *at < '0' || *at > '9' || value > UINT16_MAX || *end != (i < 3 ? ',' : 0))
            return error_set(error, STATUS_INVALID, "--crop %s: it takes X,Y,WIDTH,HEIGHT in pixels", text);
        options->crop[i] = (uint32_t)value;
        at = end + 1;
    }
    options->has_crop = true;
    return true;
}

bool options_parse(int argc, char **argv, struct options *options, struct error *error)
{
    enum {
        METRIC = 1000,
        LAYER,
        CROP,
        MASK,
        FAIL_ABOVE,
        HEAT_MAP,
        JSON,
        PPD,
        EPSILON,
        RANGE,
        FLOOR,
        TRANSFER
    };
    static const struct option names[] = {
        {"metric", required_argument, NULL, METRIC},
        {"layer", required_argument, NULL, LAYER},
        {"crop", required_argument, NULL, CROP},
        {"mask", required_argument, NULL, MASK},
        {"fail-above", required_argument, NULL, FAIL_ABOVE},
        {"heatmap", required_argument, NULL, HEAT_MAP},
        {"json", no_argument, NULL, JSON},
        {"ppd", required_argument, NULL, PPD},
        {"epsilon", required_argument, NULL, EPSILON},
        {"ssim-range", required_argument, NULL, RANGE},
        {"firefly-floor", required_argument, NULL, FLOOR},
        {"transfer", required_argument, NULL, TRANSFER},
        {"help", no_argument, NULL, 'h'},
        {NULL, 0, NULL, 0},
    };
    *options = (struct options){.epsilon = MEASURE_RELMSE_EPSILON, .limit = (double)INFINITY};
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        options->limits[i] = (double)INFINITY;
    opterr = 0;
    bool is_good = true;
    for (int found; is_good && (found = getopt_long(argc, argv, ":h", names, NULL)) != -1;)
        switch (found) {
        case 'h':
            options->is_help = true;
            return true;
        case METRIC:
            is_good = parse_metrics(optarg, options, error);
            break;
        case LAYER:
            options->layer = optarg;
            break;
        case CROP:
            is_good = parse_crop(optarg, options, error);
            break;
        case MASK:
            options->mask = optarg;
            break;
        case FAIL_ABOVE:
            is_good = parse_limit(optarg, options, error);
            break;
        case HEAT_MAP:
            options->heat_map = optarg;
            break;
        case JSON:
            options->is_json = true;
            break;
        case PPD:
            is_good = parse_number("--ppd", optarg, 5, &options->pixels_per_degree, error);
            break;
        case EPSILON:
            is_good = parse_number("--epsilon", optarg, 1e-30, &options->epsilon, error);
            break;
        case RANGE:
            is_good = parse_number("--ssim-range", optarg, 1e-30, &options->ssim_range, error);
            break;
        case FLOOR:
            is_good = parse_number("--firefly-floor", optarg, 0, &options->firefly_floor, error);
            break;
        case TRANSFER:
            options->is_integer_linear = strcmp(optarg, "linear") == 0;
            if (!options->is_integer_linear && strcmp(optarg, "srgb") != 0)
                is_good = error_set(error, STATUS_INVALID, "--transfer %s: it takes srgb or linear", optarg);
            break;
        case ':':
            is_good = error_set(error, STATUS_INVALID, "%s needs a value", argv[optind - 1]);
            break;
        default:
            is_good = error_set(error, STATUS_INVALID, "there is no option %s", argv[optind - 1]);
        }
    if (!is_good)
        return false;
    if (argc - optind != 2)
        return error_set(error, STATUS_INVALID, "it takes an image and a reference; %d files are named",
                         argc - optind);
    options->image = argv[optind];
    options->reference = argv[optind + 1];
    return true;
}
