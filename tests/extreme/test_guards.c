/* Guards: zero on every built-in scene, and each shown to fire where it should. */
#include <string.h>

#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

static const enum stat_id guards[] = {STAT_guard_density,   STAT_guard_differential, STAT_guard_footprint,
                                      STAT_guard_traversal, STAT_guard_overflow,     STAT_guard_split};
#define GUARD_COUNT (sizeof guards / sizeof *guards)

/* A small budget in the suite, the default one in a long run. */
static void ordinary_scenes_touch_no_guard(void **state)
{
    (void)state;
    bool is_long = getenv("CAUSTICD_LONG") != NULL;
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        struct truth stage;
        stage_open(&stage, builtin_scenes[i].name, 96, 54, is_long ? NULL : "photons=8192 cells=64");
        for (int frame = 0; frame < 3; frame++) {
            const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
            for (size_t g = 0; g < GUARD_COUNT; g++)
                if (result->stats[guards[g]] != 0)
                    fail_msg("%s: %s is %g", builtin_scenes[i].name, stat_infos[guards[g]].name,
                             result->stats[guards[g]]);
        }
        /* what only unusual scenes need is left out */
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_DEPTH);
        assert_false(scenery_plan_uses(result, "nested solids"));
        assert_false(scenery_plan_uses(result, "contacts"));
        assert_true(scenery_plan_uses(result, "full precision"));
        truth_close(&stage);
    }
}

/* Renders until the guard has fired: it must, the picture must be finite, and the ledger must close. */
static void expect_guard(struct truth *stage, enum stat_id guard, uint32_t frames)
{
    double most = 0;
    for (uint32_t i = 0; i < frames; i++) {
        const struct frame_result *result = truth_render(stage, 1, 1u << CHANNEL_CAUSTICS);
        const double *s = result->stats;
        most = fmax(most, s[guard]);
        struct measure_image image = {truth_channel(result, CHANNEL_CAUSTICS), stage->width, stage->height,
                                      3};
        assert_int_equal(measure_non_finite(&image), 0);
        double fates = s[STAT_flux_splatted] + s[STAT_flux_culled_visibility] + s[STAT_flux_culled_energy] +
                       s[STAT_flux_direct] + s[STAT_flux_absorbed] + s[STAT_flux_escaped] +
                       s[STAT_flux_bounce_limit] + s[STAT_flux_thinned];
        assert_close(fates, s[STAT_flux_emitted], 1e-3 * s[STAT_flux_emitted]);
        assert_true(isfinite(s[STAT_density_total]) && isfinite(s[STAT_density_largest]));
    }
    print_message("%s: %.0f\n", stat_infos[guard].name, most);
    assert_true(most > 0);
    truth_close(stage);
}

static struct view_camera from_above(struct scene_builder *builder, double height, double fov)
{
    return scenery_camera(builder, vec3_make(0, height, 0.01 * height), vec3_make(0, 0, 0),
                          vec3_make(0, 1, 0), fov);
}

/* A sheet in the light of a sun 0.001 degrees above its plane. */
static void differential(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 16);
    scenery_place(&builder,
                  shape_floor(&builder, "sheet", scenery_glass(&builder, 1.5), vec3_make(0, 1, 0), 2));
    scenery_sun(&builder, vec3_make(1, -1.7e-5, 0), 1);
    struct view_camera camera = from_above(&builder, 4, 40);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=4096 cells=16");
    expect_guard(&stage, STAT_guard_differential, 1);
}

/* A haystack of 60,000 needles that all lie along one diagonal: every box holds every other. */
static void traversal(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 16);
    const uint32_t count = 60000;
    uint32_t first_vertex = builder.scene->vertex_count, first_index = builder.scene->index_count;
    struct scene_vertex *vertices = scene_builder_vertices(&builder, 3 * count);
    uint32_t *indices = scene_builder_indices(&builder, 3 * count);
    for (uint32_t i = 0; i < 3 * count; i++) {
        double end = i % 3 == 0 ? -1 : 1, shift = 1e-3 * ((i / 3) % 251), thin = i % 3 == 2 ? 1e-5 : 0;
        vec3_store(vertices[i].position,
                   vec3_make(end + shift, 2 + 0.5 * end + thin, end - 1e-3 * ((i / 3) % 241)));
        vec3_store(vertices[i].normal, vec3_make(0, 1, 0));
        indices[i] = i;
    }
    scenery_place(&builder, scene_builder_mesh(&builder, "hay", scenery_glass(&builder, 1.5), first_vertex,
                                               first_index));
    scenery_sun(&builder, vec3_make(0, -1, 0), 1);
    struct view_camera camera = from_above(&builder, 1, 40);
    scenery_open(&stage, &builder, &camera, 16, 16, "photons=256 cells=16 max_bounces=1");
    expect_guard(&stage, STAT_guard_traversal, 1);
}

static double at_zero(double radius)
{
    (void)radius;
    return 0;
}

static double at_one(double radius)
{
    (void)radius;
    return 1;
}

/* One photon for a square of 4 m, through the middle of a sheet of glass, and a camera 1 cm above where it
 * lands that shows a stretch of floor of `fov` degrees. Sheet and floor have a vertex there: it lands there
 * to the bit. */
static void open_microscope(struct truth *stage, double fov, const char *settings)
{
    struct scene_builder builder;
    scenery_begin(&builder, NULL);
    scenery_dish(&builder, scenery_diffuse(&builder),
                 &(struct scenery_dish){at_zero, at_zero, 2, 1, 4, false});
    scenery_dish(&builder, scenery_glass(&builder, 1.5),
                 &(struct scenery_dish){at_one, at_zero, 1, 1, 4, false});
    scenery_sun(&builder, vec3_make(0, -1, 0), 1e-3);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.01, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), fov);
    scenery_open(stage, &builder, &camera, 32, 32, "photons=1 tile=full");
    truth_set(stage, settings);
}

/* A pixel of 1e-15 m: the photon's energy in it is more than the sums of the picture hold. */
static void overflow(void **state)
{
    (void)state;
    struct truth stage;
    open_microscope(&stage, 2e-10, NULL);
    assert_true(truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS)->stats[STAT_guard_footprint] == 0);
    expect_guard(&stage, STAT_guard_overflow, 1);
}

/* The area rule asks for the footprint's area in pixels over target_area: more than a density may be. */
static void density(void **state)
{
    (void)state;
    struct truth stage;
    open_microscope(&stage, 2e-10, "density=area target_area=0.001");
    expect_guard(&stage, STAT_guard_density, 3);
}

/* A pixel of 1e-19 m: the square of the footprint's size in pixels is beyond the floats. */
static void footprint(void **state)
{
    (void)state;
    struct truth stage;
    open_microscope(&stage, 1.83e-14, NULL);
    expect_guard(&stage, STAT_guard_footprint, 1);
}

/* Plates of index 2.4: every interface splits every photon, until there is no room for all branches. */
static void split(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 16);
    uint32_t diamond = scenery_glass(&builder, 2.4);
    for (int i = 0; i < 6; i++)
        scenery_place(&builder, shape_box(&builder, "plate", diamond, vec3_make(-1, 1 + 0.2 * i, -1),
                                          vec3_make(1, 1.1 + 0.2 * i, 1)));
    scenery_sun(&builder, vec3_make(0, -1, 0), 1);
    struct view_camera camera = from_above(&builder, 0.8, 40);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=4096 cells=16");
    expect_guard(&stage, STAT_guard_split, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ordinary_scenes_touch_no_guard),
        cmocka_unit_test(differential),
        cmocka_unit_test(overflow),
        cmocka_unit_test(density),
        cmocka_unit_test(footprint),
        cmocka_unit_test(traversal),
        cmocka_unit_test(split),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
