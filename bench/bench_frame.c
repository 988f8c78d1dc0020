/* bench_frame.c: what a frame costs: its passes, its host work, and how it grows with photons, pixels and
 * triangles.
 *
 * Everything is wall time of view_render in this process, medians over rounds; what is compared runs in turn,
 * one frame each per round, so that a busy machine slows all of it alike. Every view first renders some
 * frames to let its task buffers settle and its pipelines compile.
 */
#include <math.h>
#include <string.h>

#include "bench/measure.h"
#include "core/render/renderer.h"
#include "core/scene/shapes.h"

#define WARM_UP    6u
#define MAX_ROUNDS 101u
#define MAX_CASES  8u

static uint32_t frame_width = 480,
                frame_height = 270; /* of the tables passes, no-caster, scenes and governor */

struct subject {
    struct scene *scene;
    struct renderer *renderer; /* NULL: shares the one of the case before */
    struct view *view;
    double size; /* what grows: photons emitted, pixels or triangles */
    double frame_ns[MAX_ROUNDS], host_ns[MAX_ROUNDS];
    double emitted, rays, stored; /* of the last frame */
};

static const struct frame_result *render(struct view *view, uint32_t channel_mask)
{
    struct error error;
    const struct frame_result *result = view_render(view, channel_mask, &error);
    if (!result)
        measure_die(&error);
    return result;
}

static struct renderer *make_renderer(struct gpu *gpu, struct scene *scene, struct error *error)
{
    struct renderer *renderer =
        scene ? renderer_create(&(struct renderer_params){.gpu = gpu, .scene = scene}, error) : NULL;
    if (!renderer)
        measure_die(error);
    return renderer;
}

static struct view *make_view(struct renderer *renderer, uint32_t width, uint32_t height)
{
    struct error error;
    struct view *view = view_create(renderer, width, height, &error);
    if (!view)
        measure_die(&error);
    return view;
}

static void set(struct view *view, enum setting_id id, double value)
{
    struct error error;
    if (!view_set_setting(view, id, value, &error))
        measure_die(&error);
}

static double host_ns(const struct frame_result *result)
{
    return result->stats[STAT_plan_ns] + result->stats[STAT_upload_ns] + result->stats[STAT_readback_ns];
}

static void subjects_run(struct subject *subjects, uint32_t count, uint32_t rounds)
{
    for (uint32_t round = 0; round < WARM_UP + rounds; round++)
        for (uint32_t i = 0; i < count; i++) {
            const struct frame_result *result = render(subjects[i].view, 1u << CHANNEL_CAUSTICS);
            if (round < WARM_UP)
                continue;
            subjects[i].frame_ns[round - WARM_UP] = result->stats[STAT_frame_ns];
            subjects[i].host_ns[round - WARM_UP] = host_ns(result);
            subjects[i].emitted = result->stats[STAT_photons_emitted];
            subjects[i].rays = result->stats[STAT_rays_traced];
            subjects[i].stored = result->stats[STAT_photons_stored];
        }
}

static void subjects_destroy(struct subject *subjects, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        view_destroy(&subjects[i].view);
    for (uint32_t i = 0; i < count; i++) {
        renderer_destroy(&subjects[i].renderer);
        scene_destroy(&subjects[i].scene);
    }
}

/* ---- least squares ------------------------------------------------------------------------------------ */

struct line {
    double offset, slope, r2;
};

static struct line fit(const double *x, const double *y, uint32_t count)
{
    double mean_x = 0, mean_y = 0, xx = 0, xy = 0, yy = 0;
    for (uint32_t i = 0; i < count; i++) {
        mean_x += x[i] / count;
        mean_y += y[i] / count;
    }
    for (uint32_t i = 0; i < count; i++) {
        xx += (x[i] - mean_x) * (x[i] - mean_x);
        xy += (x[i] - mean_x) * (y[i] - mean_y);
        yy += (y[i] - mean_y) * (y[i] - mean_y);
    }
    return (struct line){mean_y - xy / xx * mean_x, xy / xx, xy * xy / (xx * yy)};
}

/* Rows of the table, then the fits: of time over size or over its logarithm, and the exponent of a power law.
 */
static void print_growth(const char *what, struct subject *subjects, uint32_t count, uint32_t rounds,
                         bool is_logarithmic)
{
    double size[MAX_CASES], elapsed_ms[MAX_CASES], log_size[MAX_CASES], log_elapsed[MAX_CASES];
    printf("\n| %s | frame, ms | photons emitted | rays traced | photons stored |\n|---|---|---|---|---|\n",
           what);
    for (uint32_t i = 0; i < count; i++) {
        size[i] = subjects[i].size > 0 ? subjects[i].size : subjects[i].emitted;
        elapsed_ms[i] = 1e-6 * measure_median(subjects[i].frame_ns, rounds);
        log_size[i] = log(size[i]);
        log_elapsed[i] = log(elapsed_ms[i]);
        printf("| %.0f | %.1f | %.0f | %.0f | %.0f |\n", size[i], elapsed_ms[i], subjects[i].emitted,
               subjects[i].rays, subjects[i].stored);
    }
    struct line power = fit(log_size, log_elapsed, count);
    struct line line = fit(is_logarithmic ? log_size : size, elapsed_ms, count);
    if (is_logarithmic)
        printf("\n%.1f ms + %.2f ms per doubling, R² %.3f; log-log slope %.3f\n", line.offset,
               line.slope * log(2), line.r2, power.slope);
    else
        printf("\n%.1f ms + %.2f ms per 10,000, R² %.4f; log-log slope %.2f\n", line.offset, 1e4 * line.slope,
               line.r2, power.slope);
    fflush(stdout);
}

/* ---- the tables --------------------------------------------------------------------------------------- */

static void bench_passes(struct gpu *gpu, uint32_t rounds)
{
    struct error error;
    struct scene *scene = scene_create_builtin("sphere", &error);
    struct renderer *renderer = make_renderer(gpu, scene, &error);
    struct view *view = make_view(renderer, frame_width, frame_height);
    const char *names[VIEW_MAX_PASSES] = {NULL};
    static double pass_ns[VIEW_MAX_PASSES][MAX_ROUNDS];
    static double parts[5][MAX_ROUNDS];
    uint32_t pass_count = 0;
    for (uint32_t round = 0; round < WARM_UP + rounds; round++) {
        const struct frame_result *result = render(view, 1u << CHANNEL_CAUSTICS);
        if (round < WARM_UP)
            continue;
        pass_count = result->pass_count;
        for (uint32_t i = 0; i < pass_count; i++) {
            names[i] = result->passes[i].name;
            pass_ns[i][round - WARM_UP] = (double)result->passes[i].elapsed_ns;
        }
        parts[0][round - WARM_UP] = result->stats[STAT_frame_ns];
        parts[1][round - WARM_UP] = result->stats[STAT_plan_ns];
        parts[2][round - WARM_UP] = result->stats[STAT_upload_ns];
        parts[3][round - WARM_UP] = result->stats[STAT_readback_ns];
        parts[4][round - WARM_UP] = host_ns(result) / result->stats[STAT_frame_ns];
    }
    double frame_ns = measure_median(parts[0], rounds);
    printf("\nA frame of `sphere`, %ux%u, default settings, channel caustics\n\n| part | ms | share "
           "|\n|---|---|---|\n",
           frame_width, frame_height);
    for (uint32_t i = 0; i < pass_count; i++) {
        double elapsed_ns = measure_median(pass_ns[i], rounds);
        printf("| %s | %.2f | %.1f %% |\n", names[i], 1e-6 * elapsed_ns, 100 * elapsed_ns / frame_ns);
    }
    static const char *const hosts[] = {"plan (host)", "upload (host)", "readback (host)"};
    for (int i = 0; i < 3; i++) {
        double elapsed_ns = measure_median(parts[1 + i], rounds);
        printf("| %s | %.3f | %.2f %% |\n", hosts[i], 1e-6 * elapsed_ns, 100 * elapsed_ns / frame_ns);
    }
    printf("| whole frame | %.2f | 100 %% |\n\nplan, upload and readback together: %.2f %% of a frame "
           "(median of "
           "the frames' own shares)\n",
           1e-6 * frame_ns, 100 * measure_median(parts[4], rounds));
    fflush(stdout);
    view_destroy(&view);
    renderer_destroy(&renderer);
    scene_destroy(&scene);
}

static void bench_no_caster(struct gpu *gpu, uint32_t rounds)
{
    static struct subject subjects[2];
    static const char *const names[2] = {"sphere", "no-caster"};
    struct error error;
    for (int i = 0; i < 2; i++) {
        subjects[i].scene = scene_create_builtin(names[i], &error);
        subjects[i].renderer = make_renderer(gpu, subjects[i].scene, &error);
        subjects[i].view = make_view(subjects[i].renderer, frame_width, frame_height);
    }
    subjects_run(subjects, 2, rounds);
    double sphere = measure_median(subjects[0].frame_ns, rounds),
           no_caster = measure_median(subjects[1].frame_ns, rounds);
    printf("\nA frame of `no-caster`, channel caustics: %.3f ms, %.3f %% of `sphere`'s %.1f ms\n",
           1e-6 * no_caster, 100 * no_caster / sphere, 1e-6 * sphere);
    fflush(stdout);
    subjects_destroy(subjects, 2);
}

static void bench_photons(struct gpu *gpu, uint32_t rounds)
{
    static struct subject subjects[6];
    struct error error;
    subjects[0].scene = scene_create_builtin("sphere", &error);
    subjects[0].renderer = make_renderer(gpu, subjects[0].scene, &error);
    for (uint32_t i = 0; i < 6; i++) {
        subjects[i].view = make_view(subjects[0].renderer, 480, 270);
        set(subjects[i].view, SETTING_photons, 8192u << i);
        set(subjects[i].view, SETTING_target_area, 1e-3); /* wants more than any of the budgets */
    }
    subjects_run(subjects, 6, rounds);
    puts("\nPhotons: `sphere`, 480x270, the budget doubled five times");
    print_growth("photons emitted", subjects, 6, rounds, false);
    subjects_destroy(subjects, 6);
}

static void bench_pixels(struct gpu *gpu, uint32_t rounds)
{
    static struct subject subjects[5];
    static const uint32_t sizes[5][2] = {{240, 135}, {480, 270}, {960, 540}, {1440, 810}, {1920, 1080}};
    struct error error;
    subjects[0].scene = scene_create_builtin("sphere", &error);
    subjects[0].renderer = make_renderer(gpu, subjects[0].scene, &error);
    for (uint32_t i = 0; i < 5; i++) {
        subjects[i].view = make_view(subjects[0].renderer, sizes[i][0], sizes[i][1]);
        subjects[i].size = sizes[i][0] * sizes[i][1];
        set(subjects[i].view, SETTING_target_area, 1e-3); /* the budget decides, at every size alike */
    }
    subjects_run(subjects, 5, rounds);
    puts("\nPixels: `sphere`, 240x135 to 1920x1080, 131,072 photons");
    print_growth("pixels", subjects, 5, rounds, false);
    subjects_destroy(subjects, 5);
}

/* The built-in scene `sphere` with a ball of 20 * 4^subdivisions triangles. */
static struct scene *make_ball(uint32_t subdivisions, struct error *error)
{
    struct scene_builder builder;
    scene_builder_begin(&builder, "ball");
    struct scene_material floor = scene_material_default("floor"), glass = scene_material_default("glass");
    floor.double_sided = true;
    glass.kind = MATERIAL_DIELECTRIC;
    glass.roughness = 0;
    glass.transmission = 1;
    uint32_t meshes[2];
    meshes[0] =
        shape_floor(&builder, "floor", scene_builder_material(&builder, &floor), vec3_make(0, 0, 0), 16);
    meshes[1] = shape_icosphere(&builder, "ball", scene_builder_material(&builder, &glass),
                                vec3_make(0, 0.6, 0), 0.5, subdivisions);
    for (int i = 0; i < 2; i++) {
        struct scene_node node = scene_node_default(i ? "ball" : "floor", SCENE_NONE);
        scene_builder_instance(&builder, scene_builder_node(&builder, &node), meshes[i]);
    }
    struct scene_light lamp = {.type = LIGHT_POINT, .intensity = {40, 40, 40}};
    struct scene_node node = scene_node_default("lamp", SCENE_NONE);
    vec3_store(node.translation, vec3_make(1.3, 3.6, -0.7));
    lamp.node = scene_builder_node(&builder, &node);
    scene_builder_light(&builder, &lamp);
    return scene_builder_finish(&builder, error);
}

static void bench_triangles(struct gpu *gpu, uint32_t rounds)
{
    static struct subject subjects[6];
    const struct view_camera camera = {
        .eye = {-2, 2.6f, 2.7f}, .at = {-0.15f, 0.2f, 0.1f}, .up = {0, 1, 0}, .fov = 32};
    struct error error;
    for (uint32_t i = 0; i < 6; i++) {
        subjects[i].scene = make_ball(2 + i, &error);
        subjects[i].renderer = make_renderer(gpu, subjects[i].scene, &error);
        subjects[i].view = make_view(subjects[i].renderer, 480, 270);
        subjects[i].size = subjects[i].scene->triangle_count;
        if (!view_set_camera(subjects[i].view, &camera, &error))
            measure_die(&error);
    }
    subjects_run(subjects, 6, rounds);
    puts("\nTriangles: the ball of `sphere` in 320 to 327,680 triangles, 480x270");
    print_growth("triangles", subjects, 6, rounds, true);
    subjects_destroy(subjects, 6);
}

enum part { FRAME, DEVICE, TRACE, COMPACT, SPLAT, PARTS };

static double part_ns(const struct frame_result *result, enum part part)
{
    static const char *const names[PARTS] = {[TRACE] = "trace", [COMPACT] = "compact", [SPLAT] = "splat"};
    double sum = part == FRAME ? result->stats[STAT_frame_ns] : 0;
    for (uint32_t i = 0; part != FRAME && i < result->pass_count; i++)
        if (!names[part] || strcmp(result->passes[i].name, names[part]) == 0)
            sum += (double)result->passes[i].elapsed_ns;
    return sum;
}

static void bench_scenes(struct gpu *gpu, uint32_t rounds)
{
    static const char *const names[] = {"sphere", "ring", "square", "cornell", "pool", "cube", "prism"};
    static const double budgets[] = {131072, 1048576};
    printf(
        "\nFrames of the built-in scenes, %ux%u, default settings but the budget, channel caustics\n\n"
        "| scene | photons emitted | rays traced | frame, ms | on the device, ms | trace | compact | splat | "
        "million rays/s in trace |\n|---|---|---|---|---|---|---|---|---|\n",
        frame_width, frame_height);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        struct error error;
        struct scene *scene = scene_create_builtin(names[i], &error);
        struct renderer *renderer = make_renderer(gpu, scene, &error);
        for (size_t k = 0; k < sizeof budgets / sizeof *budgets; k++) {
            static double elapsed[PARTS][MAX_ROUNDS];
            if (budgets[k] > renderer_limits(renderer)->max_photons)
                continue;
            struct view *view = make_view(renderer, frame_width, frame_height);
            set(view, SETTING_photons, budgets[k]);
            const struct frame_result *result = NULL;
            for (uint32_t round = 0; round < WARM_UP + rounds; round++) {
                result = render(view, 1u << CHANNEL_CAUSTICS);
                for (enum part part = 0; round >= WARM_UP && part < PARTS; part++)
                    elapsed[part][round - WARM_UP] = 1e-6 * part_ns(result, part);
            }
            double rays = result->stats[STAT_rays_traced], ms[PARTS];
            for (enum part part = 0; part < PARTS; part++)
                ms[part] = measure_median(elapsed[part], rounds);
            printf("| %s | %.0f | %.0f | %.3f | %.3f | %.3f | %.3f | %.3f | %.1f |\n", names[i],
                   result->stats[STAT_photons_emitted], rays, ms[FRAME], ms[DEVICE], ms[TRACE], ms[COMPACT],
                   ms[SPLAT], 1e-3 * rays / ms[TRACE]);
            fflush(stdout);
            view_destroy(&view);
        }
        renderer_destroy(&renderer);
        scene_destroy(&scene);
    }
}

/* ---- the governor ------------------------------------------------------------------------------------- */

#define PATH_FRAMES 160u
#define PATH_SETTLE 14u /* frames that it may take to find its budget */

/* Once around what the scene's camera looks at, in to 0.7 of its distance and out again. */
static struct view_camera path_camera(const struct view_camera *start, uint32_t frame)
{
    struct view_camera camera = *start;
    double turn = 2 * 3.14159265358979 * frame / PATH_FRAMES, scale = 0.85 + 0.15 * cos(turn);
    double x = start->eye[0] - start->at[0], y = start->eye[1] - start->at[1],
           z = start->eye[2] - start->at[2];
    camera.eye[0] = (float)(start->at[0] + scale * (x * cos(turn) + z * sin(turn)));
    camera.eye[1] = (float)(start->at[1] + scale * y);
    camera.eye[2] = (float)(start->at[2] + scale * (z * cos(turn) - x * sin(turn)));
    return camera;
}

static void render_path(struct view *view, uint32_t channels, double *elapsed_ms, double *budgets)
{
    struct error error;
    struct view_camera start = render(view, channels)->camera;
    for (uint32_t frame = 0; frame < PATH_FRAMES; frame++) {
        struct view_camera camera = path_camera(&start, frame);
        if (!view_set_camera(view, &camera, &error))
            measure_die(&error);
        const struct frame_result *result = render(view, channels);
        elapsed_ms[frame] = 1e-6 * result->stats[STAT_frame_ns];
        budgets[frame] = result->stats[STAT_governor_photons];
    }
    if (!view_set_camera(view, &start, &error))
        measure_die(&error);
}

/* Of the frames that count; they stay in their order. */
static double path_median(const double *values)
{
    double sorted[PATH_FRAMES - PATH_SETTLE];
    memcpy(sorted, values + PATH_SETTLE, sizeof sorted);
    return measure_median(sorted, PATH_FRAMES - PATH_SETTLE);
}

static void bench_governor(struct gpu *gpu, uint32_t rounds)
{
    (void)rounds; /* a path is rendered once */
    static const struct {
        const char *scene;
        uint32_t channels;
        double share; /* of the way from the median frame with the least photons to that with the most */
    } cases[] = {
        {"sphere", 1u << CHANNEL_CAUSTICS, 0.6},
        {"sphere", 1u << CHANNEL_CAUSTICS, 0.3},
        {"square", 1u << CHANNEL_CAUSTICS, 0.6},
        {"square", 1u << CHANNEL_CAUSTICS, 0.3},
        {"pool", 1u << CHANNEL_CAUSTICS, 0.6},
        {"pool", 1u << CHANNEL_CAUSTICS | 1u << CHANNEL_INDIRECT, 0.6},
    };
    printf(
        "\nbudget_ms over a path of %u frames around the scene, %ux%u, after %u frames; photons 1,048,576 at "
        "most. A frame can hold T where the path without photons to spare takes less than 1.1 T and with all "
        "of them more than 0.9 T.\n\n| scene | channels | least to all photons, median ms | T, ms | median "
        "ms | can hold T | of those within 10 %% | above | budgets | changes, there and back, largest "
        "|\n|---|---|---|---|---|---|---|---|---|---|\n",
        PATH_FRAMES, frame_width, frame_height, PATH_SETTLE);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        static double least[PATH_FRAMES], most[PATH_FRAMES], elapsed[PATH_FRAMES], budgets[PATH_FRAMES];
        const uint32_t count = PATH_FRAMES - PATH_SETTLE, channels = cases[i].channels;
        struct error error;
        struct scene *scene = scene_create_builtin(cases[i].scene, &error);
        struct renderer *renderer = make_renderer(gpu, scene, &error);
        struct view *view = make_view(renderer, frame_width, frame_height);
        set(view, SETTING_photons, fmin(1048576, renderer_limits(renderer)->max_photons));
        set(view, SETTING_budget_ms, 1e-3);
        render_path(view, channels, least, budgets);
        set(view, SETTING_budget_ms, 3.6e6);
        render_path(view, channels, most, budgets);
        double low = path_median(least), high = path_median(most);
        double target = low + cases[i].share * (high - low);
        set(view, SETTING_budget_ms, target);
        render_path(view, channels, elapsed, budgets);
        uint32_t can = 0, within = 0, above = 0, changes = 0, turns = 0;
        double smallest = INFINITY, largest = 0, step = 1, last = 1;
        for (uint32_t frame = PATH_SETTLE; frame < PATH_FRAMES; frame++) {
            bool can_hold = least[frame] <= 1.1 * target && most[frame] >= 0.9 * target;
            can += can_hold;
            within += can_hold && fabs(elapsed[frame] - target) <= 0.1 * target;
            above += elapsed[frame] > 1.1 * target;
            double ratio = budgets[frame] / budgets[frame - 1];
            if (frame > PATH_SETTLE && ratio != 1) {
                changes++;
                turns += (ratio > 1) != (last > 1) && last != 1;
                last = ratio;
                step = fmax(step, fmax(ratio, 1 / ratio));
            }
            smallest = fmin(smallest, budgets[frame]);
            largest = fmax(largest, budgets[frame]);
        }
        printf(
            "| %s | %s | %.2f to %.2f | %.2f | %.2f | %u of %u | %u | %u | %.0f to %.0f | %u, %u, x%.2f |\n",
            cases[i].scene, channels >> CHANNEL_INDIRECT & 1 ? "caustics, indirect" : "caustics", low, high,
            target, path_median(elapsed), can, count, within, above, smallest, largest, changes, turns, step);
        fflush(stdout);
        view_destroy(&view);
        renderer_destroy(&renderer);
        scene_destroy(&scene);
    }
}

static const struct {
    const char *name;
    void (*run)(struct gpu *gpu, uint32_t rounds);
} tables[] = {{"passes", bench_passes},    {"scenes", bench_scenes}, {"no-caster", bench_no_caster},
              {"photons", bench_photons},  {"pixels", bench_pixels}, {"triangles", bench_triangles},
              {"governor", bench_governor}};
#define TABLE_COUNT (sizeof tables / sizeof *tables)

static const char usage[] =
    "usage: bench-frame [--device NAME] [--rounds N] [--size WxH] [TABLE...]\n"
    "What a frame costs, as medians of N rounds (15), in Markdown. TABLE is passes, scenes, no-caster, "
    "photons,\n"
    "pixels, triangles or governor; all of them when none is given. --size is that of passes, scenes, "
    "no-caster\n"
    "and governor (480x270).\n";

int main(int argc, char **argv)
{
    struct gpu_params params = {0};
    uint32_t rounds = 15;
    int first = 1;
    for (; first + 1 < argc && strncmp(argv[first], "--", 2) == 0; first += 2) {
        if (strcmp(argv[first], "--device") == 0)
            params.device = argv[first + 1];
        else if (strcmp(argv[first], "--rounds") == 0)
            rounds = (uint32_t)strtoul(argv[first + 1], NULL, 10);
        else if (strcmp(argv[first], "--size") != 0 ||
                 sscanf(argv[first + 1], "%ux%u", &frame_width, &frame_height) != 2)
            break;
    }
    bool is_chosen[TABLE_COUNT] = {false}, is_good = rounds >= 1 && rounds <= MAX_ROUNDS;
    for (int i = first; i < argc; i++) {
        size_t table = 0;
        while (table < TABLE_COUNT && strcmp(tables[table].name, argv[i]) != 0)
            table++;
        if (table < TABLE_COUNT)
            is_chosen[table] = true;
        is_good = is_good && table < TABLE_COUNT;
    }
    if (!is_good) {
        bool is_help = first < argc && strcmp(argv[first], "--help") == 0;
        fputs(usage, is_help ? stdout : stderr);
        return is_help ? 0 : 2;
    }
    struct error error;
    struct gpu *gpu = gpu_create(&params, &error);
    if (!gpu)
        measure_die(&error);
    printf("%s, %s, %u rounds\n", gpu_info(gpu)->name, gpu_info(gpu)->driver, rounds);
    for (size_t i = 0; i < TABLE_COUNT; i++)
        if (first == argc || is_chosen[i])
            tables[i].run(gpu, rounds);
    gpu_destroy(&gpu);
    return 0;
}
