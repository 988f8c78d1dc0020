/* config.h: what to measure: scenes x methods x settings, as a JSON file or the command line says it.
 *
 *     {
 *       "scenes": ["sphere", "room.glb",
 *                  {"scene": "pool", "time": 0.5, "camera": "main", "reference": "pool.exr"},
 *                  {"scene": "ring", "camera": {"eye": [0, 1, 3], "at": [0, 0, 0], "fov": 40}}],
 *       "size": "480x270",
 *       "methods": {"default": {}, "papers": {"density": "area", "split": "once", "aa": "none"}},
 *       "settings": {"photons": [8192, 32768, 131072], "aa": ["filter", "none"]},
 *       "curve": "photons",
 *       "warmup": 8, "repeats": 5,
 *       "metrics": ["rell1", "hdrflip"],
 *       "reference": {"confidence": 0.02, "photons": 2e8, "settings": {"max_bounces": 24}, "cache": "refs"},
 *       "budgets_ms": [10, 20, 50],
 *       "plots": [{"file": "contributing.svg", "title": "...", "scene": "pool", "x": "target_area",
 *                  "y": "1 - photons_contributing / photons_splatted", "log_x": true, "log_y": false,
 *                  "x_label": "...", "y_label": "..."}],
 *       "bars": [{"file": "passes.svg", "scene": "pool", "is_share": true}]
 *     }
 *
 * Every field may be left out; the command line replaces what it names. A method is a named group of
 * settings; a setting with several values is an axis; every combination is a point. An axis wins over a
 * method's own value. Files are found beside the JSON file. An unknown field is refused.
 */
#ifndef CAUSTIC_BENCH_CONFIG_H
#define CAUSTIC_BENCH_CONFIG_H

#include "../../protocol/protocol.h"
#include "../lib/option_value.h"
#include "metrics.h"

#define BENCH_MAX_SCENES  32u
#define BENCH_MAX_METHODS 32u
#define BENCH_MAX_AXES    12u
#define BENCH_MAX_VALUES  64u /* of an axis, of a method, of the reference */
#define BENCH_MAX_BUDGETS 16u
#define BENCH_MAX_PLOTS   48u
#define BENCH_MAX_POINTS  20000u
#define BENCH_TEXT        64u
#define BENCH_PATH        1024u

enum bench_camera_kind { BENCH_CAMERA_SCENE, BENCH_CAMERA_NAMED, BENCH_CAMERA_FREE };

struct bench_scene {
    char source[BENCH_PATH];    /* built-in name or file, for the server */
    char label[BENCH_TEXT];     /* the name, or the file's without folder and ending */
    char reference[BENCH_PATH]; /* a file; empty: made */
    enum bench_camera_kind camera_kind;
    char camera_name[BENCH_TEXT];
    struct protocol_camera camera;
    double time;
};

struct bench_group {
    char name[BENCH_TEXT];
    struct option_setting settings[BENCH_MAX_VALUES];
    uint32_t count;
};

struct bench_axis {
    char name[BENCH_TEXT], values[BENCH_MAX_VALUES][BENCH_TEXT];
    uint32_t count;
};

struct bench_plot {
    bool is_bars, is_share, is_log_x, is_log_y;
    char file[BENCH_TEXT], title[160], scene[BENCH_TEXT], method[BENCH_TEXT]; /* scene, method empty: all */
    char x[160], y[160], x_label[160], y_label[160];
};

struct bench_config {
    struct bench_scene scenes[BENCH_MAX_SCENES];
    struct bench_group methods[BENCH_MAX_METHODS];
    struct bench_axis axes[BENCH_MAX_AXES];
    struct bench_plot plots[BENCH_MAX_PLOTS];
    uint32_t scene_count, method_count, axis_count, plot_count;
    uint32_t width, height;
    char curve[BENCH_TEXT]; /* the axis that runs along a curve; empty: photons, or else the longest of
                               numbers */
    uint32_t warmup, repeats;
    bool metrics[METRIC_COUNT]; /* which are computed */
    enum metric judge;          /* the first that was named: fronts and budgets go by it */
    double confidence, reference_photons;
    struct bench_group reference;
    char cache[BENCH_PATH]; /* empty: the user's cache folder */
    double budgets_ms[BENCH_MAX_BUDGETS];
    uint32_t budget_count;
};

/* Nothing to measure yet, and every number at its default. */
void bench_config_default(struct bench_config *config);

/* Errors name the file and the field, as in `study.json: settings.photons[2]: ...`. `name` is the text's, for
 * errors and for the files it names. */
bool bench_config_read(struct bench_config *config, const char *file, struct error *error);
bool bench_config_parse(struct bench_config *config, const char *text, const char *name, struct error *error);

/* One scene by name or file, as --scene gives it. */
bool bench_config_add_scene(struct bench_config *config, const char *source, struct error *error);
/* NAME=VALUE,VALUE...: an axis; it replaces one of that name. */
bool bench_config_set_axis(struct bench_config *config, const char *text, struct error *error);
/* NAME or NAME:SETTING=VALUE,SETTING=VALUE...: replaces one of that name. */
bool bench_config_set_method(struct bench_config *config, const char *text, struct error *error);
/* LIST of metrics with commas; the first judges. */
bool bench_config_set_metrics(struct bench_config *config, const char *list, struct error *error);

/* What is missing or does not go together. */
bool bench_config_check(const struct bench_config *config, struct error *error);

/* ---- points -------------------------------------------------------------------------------------------- */

/* One combination. Its settings are those of the method and the axes, by name, each once. */
struct bench_point {
    uint32_t scene, method;
    uint32_t setting_count;
    struct option_setting settings[BENCH_MAX_VALUES + BENCH_MAX_AXES];
};

uint32_t bench_point_count(const struct bench_config *config);
/* In the order scene, method, first axis, ... last axis. */
struct bench_point bench_point_at(const struct bench_config *config, uint32_t index);

#endif
