/* Every line of the plan is true: what it says is left out did not run and takes no memory, what it says is
 * used did, and the reason it gives is the one. */

#include <string.h>

#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 160, HEIGHT = 90, PIXELS = WIDTH * HEIGHT };
#define CAUSTICS (1u << CHANNEL_CAUSTICS)
#define BEAUTY   (1u << CHANNEL_BEAUTY)
#define DEPTH    (1u << CHANNEL_DEPTH)
#define SMALL    "photons=4096 cells=32"
/* What wide footprints are handed out in: a piece for every photon that may be stored, five a photon emitted.
 */
#define PIECES_BYTES (8.0 * 5 * 4096)

static const struct plan_line *find_line(const struct frame_result *result, const char *name)
{
    for (uint32_t i = 0; i < result->plan_count; i++)
        if (!strcmp(result->plan[i].name, name))
            return &result->plan[i];
    fail_msg("the plan has no line \"%s\"", name);
    return NULL;
}

static bool has_pass(const struct frame_result *result, const char *name)
{
    for (uint32_t i = 0; i < result->pass_count; i++)
        if (!strcmp(result->passes[i].name, name))
            return true;
    return false;
}

static void expect_line(const struct frame_result *result, const char *name, bool is_used, const char *reason)
{
    const struct plan_line *line = find_line(result, name);
    if (line->is_used == is_used && strstr(line->reason, reason))
        return;
    fail_msg("\"%s\" is %s because \"%s\"; expected %s because \"...%s...\"", name,
             line->is_used ? "used" : "left out", line->reason, is_used ? "used" : "left out", reason);
}

/* Device memory of the view alone, when frames in flight have grown to what they need. */
static double bytes_of(struct truth *stage, const char *settings, uint32_t channels)
{
    truth_set(stage, settings);
    return truth_render(stage, 4, channels)->stats[STAT_device_bytes];
}

static bool is_black(const float *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (values[i] != 0)
            return false;
    return true;
}

/* ---- lines and passes ---------------------------------------------------------------------------------- */

/* Which passes a line stands for. */
static const struct {
    const char *line, *pass;
} passes_of[] = {{"gbuffer", "gbuffer"},   {"density", "density"}, {"photons", "emit"},
                 {"photons", "trace"},     {"photons", "compact"}, {"splat", "splat"},
                 {"splat", "resolve"},     {"lookup", "lookup"},   {"feedback", "feedback"},
                 {"temporal", "temporal"}, {"output", "compose"}};

static void check_passes(const struct frame_result *result)
{
    for (size_t i = 0; i < sizeof passes_of / sizeof *passes_of; i++)
        if (find_line(result, passes_of[i].line)->is_used != has_pass(result, passes_of[i].pass))
            fail_msg("the plan's \"%s\" and the pass \"%s\" disagree", passes_of[i].line, passes_of[i].pass);
    for (uint32_t i = 0; i < result->pass_count; i++) {
        bool is_known = false;
        for (size_t k = 0; k < sizeof passes_of / sizeof *passes_of; k++)
            is_known = is_known || !strcmp(result->passes[i].name, passes_of[k].pass);
        if (!is_known)
            fail_msg("the pass \"%s\" is in no line of the plan", result->passes[i].name);
    }
    for (uint32_t i = 0; i < result->plan_count; i++)
        assert_true(result->plan[i].reason && result->plan[i].reason[0]);
    if (!find_line(result, "photons")->is_used)
        assert_close(result->stats[STAT_rays_traced], 0, 0);
    else
        assert_true(result->stats[STAT_rays_traced] > 0);
}

struct contents {
    bool glass, thin, mirror, colour, image, glow, sun, spot, soft, rough, rainbow, tint;
};

static struct contents look_at(const struct scene *scene)
{
    struct contents found = {0};
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_material *material =
            &scene->materials[scene->meshes[scene->instances[i].mesh].material];
        const float *absorbed = material->attenuation_color;
        found.glass |= material->kind == MATERIAL_DIELECTRIC;
        found.thin |= material->kind == MATERIAL_THIN;
        found.mirror |= material->kind == MATERIAL_MIRROR;
        found.colour |= material->kind == MATERIAL_DIELECTRIC && material->attenuation_distance > 0 &&
                        fminf(absorbed[0], fminf(absorbed[1], absorbed[2])) < 1;
        found.rough |= material->kind != MATERIAL_DIFFUSE && material->roughness > 0.02f;
        found.rainbow |= material->kind == MATERIAL_DIELECTRIC && material->dispersion > 0;
        found.tint |= material->kind == MATERIAL_DIELECTRIC &&
                      material->base_color[0] + material->base_color[1] + material->base_color[2] < 3;
        found.image |= material->base_color_image != SCENE_NONE || material->emission_image != SCENE_NONE;
        found.glow |= material->emission[0] + material->emission[1] + material->emission[2] > 0;
    }
    for (uint32_t i = 0; i < scene->light_count; i++) {
        found.sun |= scene->lights[i].type == LIGHT_DIRECTIONAL;
        found.spot |= scene->lights[i].type == LIGHT_SPOT;
        found.soft |= scene->lights[i].shape != LIGHT_SHAPE_POINT;
    }
    return found;
}

static void lines_say_what_ran(void **state)
{
    (void)state;
    const uint32_t masks[] = {0, CAUSTICS, BEAUTY, DEPTH, 1u << CHANNEL_DENSITY};
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        struct truth stage;
        stage_open(&stage, builtin_scenes[i].name, WIDTH, HEIGHT, SMALL);
        struct contents found = look_at(stage.scene);
        for (size_t k = 0; k < sizeof masks / sizeof *masks; k++) {
            const struct frame_result *result = truth_render(&stage, 1, masks[k]);
            check_passes(result);
            expect_line(result, "refraction", found.glass, "solid glass");
            expect_line(result, "thin walls", found.thin, "thin walls");
            expect_line(result, "mirrors", found.mirror, "mirrors");
            expect_line(result, "absorption", found.colour, found.colour ? "coloured" : "absorbs");
            expect_line(result, "textures", found.image, "image");
            expect_line(result, "emission", found.glow && (masks[k] & BEAUTY), "glows");
            expect_line(result, "directional light", found.sun, "there is");
            expect_line(result, "spot light", found.spot, "there is");
            expect_line(result, "tinted glass", found.tint, "solid glass");
            if (find_line(result, "photons")->is_used) {
                expect_line(result, "soft light", found.soft, "light");
                expect_line(result, "rough casters", found.rough, "polished");
                expect_line(result, "dispersion", found.rainbow, "glass");
                expect_line(result, "spreads", found.soft || found.rough || found.rainbow, "spread");
            }
            bool is_lit = !result->black_reason, wants = (masks[k] & ~DEPTH) != 0 || masks[k] == 0;
            expect_line(result, "photons", is_lit && wants,
                        !is_lit ? result->black_reason
                        : wants ? "casters"
                                : "no requested channel shows caustics");
            expect_line(result, "direct light", (masks[k] & BEAUTY) && stage.scene->instance_count > 0,
                        "beauty is");
        }
        truth_close(&stage);
    }
}

/* ---- nothing to do ------------------------------------------------------------------------------------- */

static double time_of_sphere(void)
{
    struct truth stage;
    stage_open(&stage, "sphere", 480, 270, NULL);
    truth_render(&stage, 2, CAUSTICS);
    double least = INFINITY;
    for (int i = 0; i < 3; i++)
        least = fmin(least, truth_render(&stage, 1, CAUSTICS)->stats[STAT_frame_ns]);
    truth_close(&stage);
    return least;
}

static void check_black(struct truth *stage, double lit_ns, const char *reason)
{
    double before = (double)gpu_memory_in_use(stage->gpu), least = INFINITY;
    for (int i = 0; i < 5; i++) {
        const struct frame_result *result = truth_render(stage, 1, CAUSTICS);
        assert_int_equal(result->pass_count, 0);
        assert_close(result->stats[STAT_gpu_ns], 0, 0);
        assert_close(result->stats[STAT_photons_emitted], 0, 0);
        assert_in_bound(result->stats[STAT_device_bytes], before);
        assert_true(is_black(truth_channel(result, CHANNEL_CAUSTICS), (size_t)3 * 480 * 270));
        assert_non_null(result->black_reason);
        assert_non_null(strstr(result->black_reason, reason));
        for (size_t k = 0; k < sizeof passes_of / sizeof *passes_of; k++)
            assert_false(find_line(result, passes_of[k].line)->is_used);
        expect_line(result, "photons", false, reason);
        least = fmin(least, result->stats[STAT_frame_ns]);
    }
    print_message("black because \"%s\": %.1f us, %.3f %% of a frame of sphere\n", reason, 1e-3 * least,
                  100 * least / lit_ns);
    assert_in_bound(least, 0.02 * lit_ns);
}

static void black_frames_cost_nothing(void **state)
{
    (void)state;
    double lit_ns = time_of_sphere();
    static const struct {
        const char *scene, *reason;
    } cases[] = {{"no-caster", "there is no caster"}, {"empty", "no geometry"}};
    struct truth stage;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        stage_open(&stage, cases[i].scene, 480, 270, NULL);
        check_black(&stage, lit_ns, cases[i].reason);
        truth_close(&stage);
    }
    struct error error = {0};
    stage_open(&stage, "sphere", 480, 270, NULL);
    const struct view_light off = {.overrides = LIGHT_OVERRIDE_INTENSITY}, on = {0};
    assert_true(view_set_light(stage.view, 0, &off, &error));
    check_black(&stage, lit_ns, "every light is black");
    /* and back: the very same first frame as a view that was never dark */
    assert_true(view_set_light(stage.view, 0, &on, &error));
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    assert_null(result->black_reason);
    assert_true(result->stats[STAT_flux_buffer] > 0);
    /* then dark again: no light of the frame before may stay in the picture */
    assert_true(view_set_light(stage.view, 0, &off, &error));
    result = truth_render(&stage, 1, CAUSTICS);
    assert_true(is_black(truth_channel(result, CHANNEL_CAUSTICS), (size_t)3 * 480 * 270));
    truth_close(&stage);
}

/* ---- settings ------------------------------------------------------------------------------------------ */

static void what_is_off_takes_no_memory(void **state)
{
    (void)state;
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, SMALL);
    double all = bytes_of(&stage, "", CAUSTICS);
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "variance", true, "variance_gain is above 0");
    expect_line(result, "feedback", true, "density follows");
    expect_line(result, "visibility rays", false, "only aa=pixel");
    expect_line(result, "accumulation", false, "accumulate is 1");
    expect_line(result, "temporal", false, "temporal is 0");

    double blended = bytes_of(&stage, "temporal=0.9", CAUSTICS);
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "temporal", true, "above 0");
    assert_true(has_pass(result, "temporal"));
    /* two irradiances and a surface, four floats a pixel each */
    assert_close(blended - all, 48.0 * PIXELS, 0);
    expect_line(truth_render(&stage, 1, DEPTH), "temporal", false, "no requested channel");
    expect_line(truth_render(&stage, 1, 0), "temporal", false, "no requested channel shows directly");
    truth_set(&stage, "accumulate=2");
    expect_line(truth_render(&stage, 1, CAUSTICS), "temporal", false, "accumulate averages");
    assert_close(bytes_of(&stage, "temporal=0 accumulate=1", CAUSTICS), all, 0);

    double still = bytes_of(&stage, "variance_gain=0", CAUSTICS);
    expect_line(truth_render(&stage, 1, CAUSTICS), "variance", false, "variance_gain is 0");
    print_message("%u pixels, %u cells: %.0f bytes; variance_gain=0 %+.0f\n", PIXELS, 32 * 32, all,
                  still - all);
    /* last frame's irradiance: four floats a pixel */
    assert_in_bound(still, all - 16.0 * PIXELS);

    double uniform = bytes_of(&stage, "density=uniform", CAUSTICS);
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "feedback", false, "density=uniform");
    assert_false(has_pass(result, "feedback"));
    print_message("density=uniform %+.0f\n", uniform - still);
    /* at the very least an area and a root, 64 bits each, per cell */
    assert_in_bound(uniform, still - 16.0 * 32 * 32);

    truth_set(&stage, "density=sqrt aa=pixel accumulate=2");
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "visibility rays", true, "aa=pixel");
    expect_line(result, "accumulation", true, "above 1");
    assert_close(result->stats[STAT_subframes], 2, 0);
    truth_close(&stage);
}

static void only_the_chosen_anti_aliasing_exists(void **state)
{
    (void)state;
    static const struct {
        const char *setting;
        bool has_sums, has_quads;
    } modes[] = {{"aa=filter", true, false},      {"aa=none", true, false},      {"aa=coverage", true, false},
                 {"aa=pixel", true, false},       {"aa=msaa_small", true, true}, {"aa=msaa", false, true},
                 {"aa=msaa_sample", false, true}, {"aa=filter", true, false}};
    enum { MODES = sizeof modes / sizeof *modes };
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, SMALL);
    double bytes[MODES], samples = gpu_info(stage.gpu)->max_samples;
    for (int i = 0; i < MODES; i++) {
        if (modes[i].has_quads && samples < 2) {
            print_message("%s: left out, the device takes one sample a pixel\n", modes[i].setting);
            continue;
        }
        bytes[i] = bytes_of(&stage, modes[i].setting, CAUSTICS);
        const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
        print_message("%s: %+.0f bytes\n", modes[i].setting, bytes[i] - bytes[0]);
        expect_line(result, "splat sums", modes[i].has_sums, modes[i].has_sums ? "fixed point" : "quads");
        expect_line(result, "multisampled quads", modes[i].has_quads,
                    modes[i].has_quads ? "rasterise" : "takes no samples");
        assert_close(result->stats[STAT_aa_samples], modes[i].has_quads ? samples : 1, 0);
        double contributing = result->stats[STAT_photons_contributing];
        assert_true(contributing > 0);
        assert_in_bound(contributing, result->stats[STAT_photons_splatted]);
        /* the sums of one channel are two words a pixel, what quads draw four floats, resolved and as
         * samples, and a word a photon */
        double quads = 16.0 * PIXELS * (2 + samples);
        if (modes[i].has_quads)
            assert_true(bytes[i] >= bytes[0] + quads - (modes[i].has_sums ? 0 : 8.0 * PIXELS + PIECES_BYTES));
        else
            assert_close(bytes[i], bytes[0] - (strcmp(modes[i].setting, "aa=pixel") == 0 ? PIECES_BYTES : 0),
                         0);
    }
    truth_close(&stage);
}

static void white_light_is_one_channel(void **state)
{
    (void)state;
    struct truth stage;
    struct error error = {0};
    stage_open(&stage, "sphere", WIDTH, HEIGHT, SMALL);
    expect_line(truth_render(&stage, 1, CAUSTICS), "three channels", false, "one tint");

    /* One coloured light is still one tint. */
    const struct view_light amber = {.overrides = LIGHT_OVERRIDE_INTENSITY, .intensity = {40, 20, 10}};
    assert_true(view_set_light(stage.view, 0, &amber, &error));
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "three channels", false, "one tint");
    const float *values = truth_channel(result, CHANNEL_CAUSTICS);
    double red = 0, green = 0, blue = 0;
    for (size_t i = 0; i < PIXELS; i++) {
        red += (double)values[3 * i];
        green += (double)values[3 * i + 1];
        blue += (double)values[3 * i + 2];
    }
    assert_true(red > 0);
    assert_close(green / red, 0.5, 1e-4);
    assert_close(blue / red, 0.25, 1e-4);
    truth_close(&stage);

    /* aa=pixel multiplies photons by the colour of what they meet: the torus in the cube is yellow. */
    stage_open(&stage, "cube", WIDTH, HEIGHT, SMALL);
    bool is_coloured = false;
    for (uint32_t i = 0; i < stage.scene->instance_count; i++) {
        const struct scene_material *material =
            &stage.scene->materials[stage.scene->meshes[stage.scene->instances[i].mesh].material];
        const float *c = material->base_color;
        is_coloured |= material->kind == MATERIAL_DIFFUSE && (c[0] != c[1] || c[1] != c[2]);
    }
    assert_true(is_coloured);
    double one = bytes_of(&stage, "aa=none", CAUSTICS);
    expect_line(truth_render(&stage, 1, CAUSTICS), "three channels", false, "one tint");
    double three = bytes_of(&stage, "aa=pixel", CAUSTICS);
    expect_line(truth_render(&stage, 1, CAUSTICS), "three channels", true, "differ in colour");
    print_message("three channels take %+.0f bytes\n", three - one);
    /* two more sums of 64 bits a pixel, and no footprints */
    assert_close(three - one, 16.0 * PIXELS - PIECES_BYTES, 4096);
    truth_close(&stage);
}

static void requested_channels_decide(void **state)
{
    (void)state;
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, SMALL);
    double empty = (double)gpu_memory_in_use(stage.gpu);
    double caustics = bytes_of(&stage, "", CAUSTICS) - empty;
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "direct light", false, "beauty is not requested");
    expect_line(result, "camera chains", false, "neither beauty");
    double depth = bytes_of(&stage, "", DEPTH) - empty;
    result = truth_render(&stage, 1, DEPTH);
    expect_line(result, "photons", false, "no requested channel shows caustics");
    assert_close(result->stats[STAT_photons_emitted], 0, 0);
    assert_false(is_black(truth_channel(result, CHANNEL_DEPTH), PIXELS));
    result = truth_render(&stage, 1, BEAUTY);
    expect_line(result, "direct light", true, "beauty is requested");
    expect_line(result, "camera chains", true, "beauty");
    assert_false(is_black(truth_channel(result, CHANNEL_BEAUTY), (size_t)3 * PIXELS));
    result = truth_render(&stage, 1, 0);
    expect_line(result, "output", false, "no image channel is requested");
    assert_false(has_pass(result, "compose"));
    assert_true(result->stats[STAT_photons_emitted] > 0);
    print_message("caustics %.0f bytes, depth alone %.0f\n", caustics, depth);
    assert_true(depth < 0.5 * caustics);
    truth_close(&stage);
}

/* What looks caustics up exists only where the picture needs it: channel, setting, casters in view. */
static void lookup_needs_glass_in_view(void **state)
{
    (void)state;
    const uint32_t indirect = 1u << CHANNEL_INDIRECT;
    struct truth stage;
    struct error error;
    stage_open(&stage, "cube", WIDTH, HEIGHT, SMALL);
    double caustics = bytes_of(&stage, NULL, CAUSTICS),
           off = bytes_of(&stage, "lookup=off", CAUSTICS | indirect);
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS | indirect);
    expect_line(result, "lookup", false, "lookup is off");
    assert_true(is_black(truth_channel(result, CHANNEL_INDIRECT), (size_t)3 * PIXELS));
    assert_close(off - caustics, 12.0 * 2 * PIXELS, 0); /* the channel, on the device and read back */
    double on = bytes_of(&stage, "lookup=auto", CAUSTICS | indirect),
           both = bytes_of(&stage, "camera_branches=2", CAUSTICS | indirect);
    result = truth_render(&stage, 1, CAUSTICS | indirect);
    expect_line(result, "lookup", true, "glass or mirrors");
    expect_line(result, "camera branches", true, "camera_branches is 2");
    expect_line(result, "camera samples", true, "camera_samples is above 1");
    assert_false(is_black(truth_channel(result, CHANNEL_INDIRECT), (size_t)3 * PIXELS));
    print_message("lookup: %.0f bytes, both branches %.0f\n", on - off, both - on);
    assert_true(on > off && both > on);
    assert_true(both > bytes_of(&stage, "camera_samples=1", CAUSTICS | indirect));
    truth_set(&stage, "camera_branches=1");
    result = truth_render(&stage, 1, indirect);
    expect_line(result, "camera samples", false, "camera_samples is 1");
    double points = result->stats[STAT_pixels_looked_up];
    assert_true(points > 0 && points < PIXELS);
    truth_set(&stage, "camera_samples=8 accumulate=2");
    expect_line(truth_render(&stage, 1, indirect), "camera samples", false, "accumulate moves camera rays");
    truth_set(&stage, "accumulate=1");
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "lookup", false, "neither beauty nor indirect");
    assert_false(has_pass(result, "lookup"));
    truth_set(&stage, "camera_bounces=0");
    expect_line(truth_render(&stage, 1, BEAUTY), "lookup", false, "camera_bounces is 0");
    truth_set(&stage, "camera_bounces=8");
    struct view_camera away = {.eye = {-1.3f, 1.9f, 3}, .at = {-2.6f, 1.5f, 6}, .up = {0, 1, 0}, .fov = 34};
    assert_true(view_set_camera(stage.view, &away, &error));
    result = truth_render(&stage, 1, BEAUTY);
    expect_line(result, "lookup", false, "in view");
    assert_close(result->stats[STAT_pixels_looked_up], 0, 0);
    /* nothing else shows photons then */
    result = truth_render(&stage, 1, indirect);
    expect_line(result, "photons", false, "no requested channel");
    assert_true(is_black(truth_channel(result, CHANNEL_INDIRECT), (size_t)3 * PIXELS));
    truth_close(&stage);
}

/* What a frame's time and quality make of it, and what they are in conflict with. */
static void budgets_say_what_they_steer(void **state)
{
    (void)state;
    struct truth stage;
    stage_open(&stage, "sphere", WIDTH, HEIGHT, SMALL);
    const struct frame_result *result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "governor", false, "budget_ms is 0");
    expect_line(result, "draft or final", false, "quality=good");
    assert_close(result->stats[STAT_governor_photons], 0, 0);
    truth_set(&stage, "budget_ms=5 quality=draft");
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "governor", true, "target_area is no limit");
    expect_line(result, "draft or final", true, "photons / 4");
    assert_true(result->stats[STAT_governor_photons] > 0);
    expect_line(truth_render(&stage, 1, DEPTH), "governor", false, "no photons");
    truth_set(&stage, "accumulate=2 quality=final");
    result = truth_render(&stage, 1, CAUSTICS);
    expect_line(result, "governor", false, "budget_ms is not held");
    expect_line(result, "draft or final", true, "photons x 4");
    assert_close(result->stats[STAT_governor_photons], 0, 0);
    truth_close(&stage);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lines_say_what_ran),          cmocka_unit_test(black_frames_cost_nothing),
        cmocka_unit_test(what_is_off_takes_no_memory), cmocka_unit_test(white_light_is_one_channel),
        cmocka_unit_test(requested_channels_decide),   cmocka_unit_test(only_the_chosen_anti_aliasing_exists),
        cmocka_unit_test(lookup_needs_glass_in_view),  cmocka_unit_test(budgets_say_what_they_steer),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
