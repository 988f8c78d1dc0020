/* Solids in solids: nested, overlapping and touching dielectrics, lamps and cameras inside them, against
 * closed forms. */
#include <string.h>

#include "core/measure/analytic.h"
#include "core/scene/solids.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/truth.h"

#define PI    3.14159265358979323846
#define GLASS 1.5
#define WATER 1.33

static void place_box(struct scene_builder *builder, uint32_t material, double x, double y_low, double y_high,
                      double z)
{
    scenery_place(builder,
                  shape_box(builder, "box", material, vec3_make(-x, y_low, -z), vec3_make(x, y_high, z)));
}

static void place_ball(struct scene_builder *builder, uint32_t material, double height, double radius)
{
    scenery_place(builder, shape_icosphere(builder, "ball", material, vec3_make(0, height, 0), radius, 5));
}

/* Irradiance averaged over the floor within `radius` of the origin, by area; all of it must be seen. */
static double floor_mean(const struct truth *stage, const struct frame_result *result, double radius)
{
    const float *irradiance = truth_channel(result, CHANNEL_IRRADIANCE);
    double sum = 0, area = 0;
    for (uint32_t y = 0; y < stage->height; y++)
        for (uint32_t x = 0; x < stage->width; x++) {
            double floor[2];
            if (!truth_floor_point(stage, x + 0.5, y + 0.5, floor) || hypot(floor[0], floor[1]) > radius)
                continue;
            double share = truth_pixel_area(stage, x + 0.5, y + 0.5);
            sum += share * (double)irradiance[3 * ((size_t)y * stage->width + x)];
            area += share;
        }
    assert_true(area > 0.8 * PI * radius * radius);
    return sum / area;
}

static int ring_of(double radius, const double *edges, int count)
{
    for (int i = 0; i < count; i++)
        if (radius >= edges[i] && radius < edges[i + 1])
            return i;
    return -1;
}

/* A ball of glass in a tank of water, the sun straight above: between water and floor only the ratio of the
 * indices counts. Rings of the floor against pencils of rays through a sphere of that ratio. */
static void a_glass_ball_in_water(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    const double radius = 0.3, height = 0.6, irradiance = 2;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 2);
    place_box(&builder, scenery_glass(&builder, WATER), 1.2, -0.5, 1.5, 1.2);
    place_ball(&builder, scenery_glass(&builder, GLASS), height, radius);
    scenery_sun(&builder, vec3_make(0, -1, 0), irradiance);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.9, 0.9), vec3_make(0, 0, 0.1), vec3_make(0, 1, 0), 60);
    scenery_open(&stage, &builder, &camera, 160, 120, "photons=65536 kappa=4");
    const struct frame_result *result =
        truth_render(&stage, 3, 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_DEPTH);
    assert_true(scenery_plan_uses(result, "nested solids"));
    assert_false(scenery_plan_uses(result, "contacts"));

    /* The rim of the shadow is left out: footprints there are wider than the gap between light and dark. */
    enum { RINGS = 7 };
    const double edges[RINGS + 1] = {0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.4, 0.45};
    double expected[RINGS], found[RINGS] = {0}, area[RINGS] = {0};
    const double far = 1e5;
    struct analytic_sphere sphere = {.intensity = irradiance * far * far,
                                     .radius = radius,
                                     .ior = GLASS / WATER,
                                     .centre_height = height,
                                     .light_height = far};
    analytic_sphere_profile(&sphere, ANALYTIC_SPHERE_REFLECTED | ANALYTIC_SPHERE_TRANSMITTED, edges, RINGS,
                            expected, 0);
    double entering = 1 - analytic_fresnel(1, 1, WATER);
    const float *values = truth_channel(result, CHANNEL_IRRADIANCE),
                *depth = truth_channel(result, CHANNEL_DEPTH);
    for (uint32_t y = 1; y + 1 < stage.height; y++)
        for (uint32_t x = 1; x + 1 < stage.width; x++) {
            double floor[2];
            if (!truth_shows_floor(&stage, depth, x, y) ||
                !truth_floor_point(&stage, x + 0.5, y + 0.5, floor))
                continue;
            int ring = ring_of(hypot(floor[0], floor[1]), edges, RINGS);
            if (ring < 0)
                continue;
            double share = truth_pixel_area(&stage, x + 0.5, y + 0.5);
            found[ring] += share * (double)values[3 * ((size_t)y * stage.width + x)];
            area[ring] += share;
        }
    for (int i = 0; i < RINGS; i++) {
        if (edges[i] < radius && edges[i + 1] > radius)
            continue;
        /* beyond the ball's shadow the sun reaches the floor through water alone */
        double wanted = entering * (expected[i] + (edges[i] > radius ? irradiance : 0));
        print_message("ring %.2f to %.2f m: %.4f W/m^2, expected %.4f\n", edges[i], edges[i + 1],
                      found[i] / area[i], wanted);
        assert_close(found[i] / area[i], wanted, 0.03 * wanted + 0.01 * irradiance);
    }
    truth_close(&stage);
}

/* ---- plane-parallel layers ----------------------------------------------------------------------------- */

/* Light through a stack of layers, all reflections between them summed, angles by Snell's law; `ior` has
 * count entries, the first and last are where the light comes from and goes to. */
static double stack_transmittance(const double *ior, int count, double angle)
{
    double sine = ior[0] * sin(angle), through = 1, back = 0; /* back: seen from below, upward light */
    for (int i = 0; i + 1 < count; i++) {
        double cosine = sqrt(1 - pow(sine / ior[i], 2)), r = analytic_fresnel(cosine, ior[i], ior[i + 1]);
        double between = 1 - back * r;
        through *= (1 - r) / between;
        back = r + (1 - r) * (1 - r) * back / between;
    }
    return through;
}

/* Irradiance below plates under the sun at `angle` from straight above, over what it is without them. */
static double plate_transmittance(double water_top, double angle, const char *used)
{
    struct scene_builder builder;
    struct truth stage;
    const double irradiance = 2;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    /* on the side the sun comes from they reach far enough for what is reflected between them */
    scenery_place(&builder, shape_box(&builder, "glass", scenery_glass(&builder, GLASS),
                                      vec3_make(-3.3, 0.6, -2), vec3_make(0.7, 0.8, 2)));
    scenery_place(&builder, shape_box(&builder, "water", scenery_glass(&builder, WATER),
                                      vec3_make(-3.2, 0.4, -1.9), vec3_make(0.6, water_top, 1.9)));
    scenery_sun(&builder, vec3_make(sin(angle), -cos(angle), 0), irradiance);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.35, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 70);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=131072 kappa=16 density=uniform jitter=1");
    const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE);
    assert_true(scenery_plan_uses(result, used));
    double mean = floor_mean(&stage, result, 0.2);
    truth_close(&stage);
    return mean / (irradiance * cos(angle));
}

/* Glass on water: touching without a gap, and the water reaching into the glass. There is no air between. */
static void touching_and_overlapping_plates(void **state)
{
    (void)state;
    const double layers[] = {1, GLASS, WATER, 1};
    for (int touch = 0; touch < 2; touch++)
        for (int i = 0; i < 2; i++) {
            double angle = i * 70 * PI / 180, wanted = stack_transmittance(layers, 4, angle);
            double found =
                plate_transmittance(touch ? 0.6 : 0.7, angle, touch ? "contacts" : "nested solids");
            print_message("%s, %d degrees: transmittance %.4f, expected %.4f\n",
                          touch ? "touching" : "overlapping", 70 * i, found, wanted);
            assert_close(found, wanted, 0.005 * wanted);
        }
}

/* A lamp in glass above water that reaches 0.5 m into it: the smaller solid counts, so glass ends where the
 * water begins. Straight below, a pencil of rays of solid angle w in the glass is n^2 w wide in the air. */
static void a_lamp_in_glass_over_water(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 4);
    place_box(&builder, scenery_glass(&builder, GLASS), 3, 0.8, 8, 3);
    place_box(&builder, scenery_glass(&builder, WATER), 3, 0.5, 1.3, 3);
    scenery_lamp(&builder, vec3_make(0, 1.4, 0), 10);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.4, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 60);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=65536 kappa=8 max_bounces=6");
    const struct frame_result *result = truth_render(&stage, 2, 1u << CHANNEL_IRRADIANCE);
    double path = 0.1 + 0.8 * GLASS / WATER + 0.5 * GLASS;
    double wanted =
        10 / (path * path) * (1 - analytic_fresnel(1, GLASS, WATER)) * (1 - analytic_fresnel(1, WATER, 1));
    double found = floor_mean(&stage, result, 0.06);
    print_message("below a lamp in glass over water: %.4f W/m^2, expected %.4f\n", found, wanted);
    assert_close(found, wanted, 0.015 * wanted);
    truth_close(&stage);
}

/* In the middle of a ball light leaves along the normals and what is reflected comes back through the middle:
 * in the end all of it leaves as if there were no glass. */
static void a_lamp_in_the_middle_of_a_ball(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    place_ball(&builder, scenery_glass(&builder, GLASS), 1, 0.5);
    scenery_lamp(&builder, vec3_make(0, 1, 0), 10);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 0.45, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 80);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=65536 kappa=8 max_bounces=6");
    const struct frame_result *result = truth_render(&stage, 2, 1u << CHANNEL_IRRADIANCE);
    const double radius = 0.3;
    double wanted = 2 * 10 / (radius * radius) * (1 - 1 / sqrt(1 + radius * radius)); /* mean of h / d^3 */
    double found = floor_mean(&stage, result, radius);
    print_message("below a lamp in the middle of a ball: %.4f W/m^2, expected %.4f\n", found, wanted);
    assert_close(found, wanted, 0.01 * wanted);
    truth_close(&stage);
}

/* ---- the camera inside --------------------------------------------------------------------------------- */

static uint32_t add_glowing(struct scene_builder *builder)
{
    struct scene_material material = scene_material_default("glowing");
    vec3_store(material.emission, vec3_make(1, 1, 1));
    return scene_builder_material(builder, &material);
}

/* Radiance in the middle of the picture of a floor that glows with 1 W/(m^2 sr), seen from `eye` height. */
static double glow_seen(double eye, bool has_water)
{
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_place(&builder, shape_floor(&builder, "floor", add_glowing(&builder), vec3_make(0, 0, 0), 8));
    if (has_water)
        place_box(&builder, scenery_glass(&builder, WATER), 2, -0.5, 3, 2);
    place_ball(&builder, scenery_glass(&builder, GLASS), 1, 0.5);
    scenery_lamp(&builder, vec3_make(0, 9, 0), 1e-6); /* what it adds is no matter */
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, eye, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 2);
    scenery_open(&stage, &builder, &camera, 9, 9, NULL);
    const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_BEAUTY);
    double seen = (double)truth_channel(result, CHANNEL_BEAUTY)[3 * (4 * 9 + 4)];
    truth_close(&stage);
    return seen;
}

/* Radiance over the square of the index of refraction is what a boundary leaves alone. */
static void cameras_inside(void **state)
{
    (void)state;
    double air_glass = 1 - analytic_fresnel(1, 1, GLASS), water_glass = 1 - analytic_fresnel(1, WATER, GLASS);
    double ratio = GLASS * GLASS / (WATER * WATER);
    assert_close(glow_seen(1, false), air_glass * GLASS * GLASS, 1e-3);
    assert_close(glow_seen(1, true), water_glass * ratio, 1e-3);
    assert_close(glow_seen(2, true), water_glass * water_glass, 1e-3);
}

/* Where a point is, at rest: lists hold numbers by size, the smaller solid first. */
static void points_know_what_they_are_in(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct error error;
    scenery_begin(&builder, &(struct scenery_params){.scale = 2, .shift = {3, 0, 0}});
    uint32_t water = scenery_glass(&builder, WATER), glass = scenery_glass(&builder, GLASS);
    place_box(&builder, water, 1, 0, 2, 1);
    place_ball(&builder, glass, 1, 0.5);
    struct scene *scene = scene_builder_finish(&builder, &error);
    assert_non_null(scene);
    struct bvh *trees[2];
    for (uint32_t i = 0; i < 2; i++)
        trees[i] = bvh_create_mesh(scene, i, &error);
    struct solids solids;
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_true(solids_find(&solids, scene, pose, trees, 1, &error));
    assert_int_equal(solids.count, 2);
    assert_int_equal(solids.number[glass], 1);
    assert_int_equal(solids.number[water], 2);
    assert_int_equal(solids.material[0], glass);
    assert_true(solids.is_nested);
    assert_false(solids.has_contact);
    const struct {
        float point[3];
        uint32_t list;
    } places[] = {{{3, 2, 0}, 0x102},      {{3, 2.98f, 0}, 0x102}, {{3, 3.1f, 0}, 2}, {{4.9f, 0.1f, 1.9f}, 2},
                  {{5.1f, 0.1f, 1.9f}, 0}, {{3, 4.1f, 0}, 0},      {{0, 1, 0}, 0}};
    for (size_t i = 0; i < sizeof places / sizeof *places; i++)
        assert_int_equal(solids_at(&solids, scene, pose, trees, places[i].point), places[i].list);
    scene_pose_destroy(&pose);
    solids_free(&solids);
    for (uint32_t i = 0; i < 2; i++)
        bvh_destroy(&trees[i]);
    scene_destroy(&scene);
}

/* ---- glass on the floor -------------------------------------------------------------------------------- */

/* A block that stands on the floor, its lower face in it: all light that enters from above is deposited, none
 * slips through the floor. */
static void glass_that_lies_in_the_floor(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    place_box(&builder, scenery_glass(&builder, GLASS), 0.5, 0, 0.5, 0.5);
    scenery_sun(&builder, vec3_make(0, -1, 0), 1);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 2, 3), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 40);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=65536");
    const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE);
    assert_true(scenery_plan_uses(result, "contacts"));
    const double *s = result->stats;
    double entering = s[STAT_flux_emitted] - s[STAT_flux_direct];
    double landed = s[STAT_flux_splatted] + s[STAT_flux_culled_visibility];
    print_message("of %.4f W onto the block %.4f W land, %.4f W escape\n", entering, landed,
                  s[STAT_flux_escaped]);
    assert_close(entering, 3, 0.03); /* 1 m^2, three channels; cells at the rim are shared */
    assert_close(landed, 0.96 * entering, 1e-3 * entering);
    assert_close(s[STAT_flux_escaped], 0.04 * entering, 1e-3 * entering);
    truth_close(&stage);
}

/* Light that no face lets out stays until max_bounces. In a cube of index n a direction leaves through faces
 * whose cosine is above that of the critical angle; of a lamp's light that is 3 (1 - cos) of it, for n = 4.
 */
static void a_box_that_keeps_its_light(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    place_box(&builder, scenery_glass(&builder, 4), 0.5, 1, 2, 0.5);
    scenery_lamp(&builder, vec3_make(0.03, 1.52, -0.04), 1);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 2, 3), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 40);
    double kept = 1 - 3 * (1 - sqrt(1 - 1.0 / 16));
    for (int i = 0; i < 2; i++) {
        if (i == 0)
            scenery_open(&stage, &builder, &camera, 16, 16,
                         "photons=16384 max_bounces=64 cull_energy=0 jitter=1");
        else
            truth_set(&stage, "max_bounces=12");
        const double *s = truth_render(&stage, 1, 1u << CHANNEL_IRRADIANCE)->stats;
        double emitted = s[STAT_flux_emitted], limit = s[STAT_flux_bounce_limit];
        double rest = s[STAT_flux_escaped] + s[STAT_flux_splatted] + s[STAT_flux_culled_visibility] +
                      s[STAT_flux_culled_energy] + s[STAT_flux_absorbed] + s[STAT_flux_direct] +
                      s[STAT_flux_split_once] + s[STAT_flux_thinned];
        print_message("%d bounces: %.4f of the light is kept, %.4f for ever; the ledger is off by %.1e\n",
                      i == 0 ? 64 : 12, limit / emitted, kept, (limit + rest) / emitted - 1);
        assert_close(limit + rest, emitted, 1e-5 * emitted);
        assert_true(limit > (kept - 0.004) * emitted);
        if (i == 0)
            assert_close(limit, kept * emitted, 0.004 * emitted);
    }
    truth_close(&stage);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_know_what_they_are_in),    cmocka_unit_test(a_glass_ball_in_water),
        cmocka_unit_test(touching_and_overlapping_plates), cmocka_unit_test(a_lamp_in_glass_over_water),
        cmocka_unit_test(a_lamp_in_the_middle_of_a_ball),  cmocka_unit_test(cameras_inside),
        cmocka_unit_test(glass_that_lies_in_the_floor),    cmocka_unit_test(a_box_that_keeps_its_light),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
