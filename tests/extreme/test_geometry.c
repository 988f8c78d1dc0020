/* Sizes, places and counts at their limits: a scene made tiny, huge and moved far away, triangles without
 * area, a single triangle and millions of them. */
#include <string.h>
#include <unistd.h>

#include "core/measure/image_measure.h"
#include "core/scene/bvh.h"
#include "core/scene/extent.h"
#include "tests/support/check.h"
#include "tests/support/glb.h"
#include "tests/support/scenery.h"
#include "tests/support/truth.h"

#define WIDTH  96
#define HEIGHT 72

/* A glass ball over a floor, the lamp's intensity scaled so that irradiances stay. `extra` adds to it. */
static void open_ball(struct truth *stage, const struct scenery_params *params, struct vec3 baked,
                      void (*extra)(struct scene_builder *))
{
    struct scene_builder builder;
    double scale = params && params->scale > 0 ? params->scale : 1;
    scenery_begin(&builder, params);
    scenery_place(&builder, shape_floor(&builder, "floor", scenery_diffuse(&builder), baked, 16));
    scenery_place(&builder, shape_icosphere(&builder, "ball", scenery_glass(&builder, 1.5),
                                            vec3_add(baked, vec3_make(0, 0.6, 0)), 0.5, 5));
    if (extra)
        extra(&builder);
    scenery_lamp(&builder, vec3_add(baked, vec3_make(1.3, 3.6, -0.7)), 40 * scale * scale);
    struct view_camera camera =
        scenery_camera(&builder, vec3_add(baked, vec3_make(-2, 2.6, 2.7)),
                       vec3_add(baked, vec3_make(-0.15, 0.2, 0.1)), vec3_make(0, 1, 0), 32);
    scenery_open(stage, &builder, &camera, WIDTH, HEIGHT, "photons=16384 cells=64");
}

static float *picture_of(struct truth *stage, double *flux)
{
    const struct frame_result *result = truth_render(stage, 3, 1u << CHANNEL_CAUSTICS);
    float *copy = malloc(3 * WIDTH * HEIGHT * sizeof *copy);
    assert_non_null(copy);
    memcpy(copy, truth_channel(result, CHANNEL_CAUSTICS), 3 * WIDTH * HEIGHT * sizeof *copy);
    if (flux)
        *flux = result->stats[STAT_flux_splatted] / result->stats[STAT_flux_emitted];
    return copy;
}

static double difference(const float *a, const float *b)
{
    struct measure_image first = {a, WIDTH, HEIGHT, 3}, second = {b, WIDTH, HEIGHT, 3};
    assert_int_equal(measure_non_finite(&first), 0);
    return measure_relative_l1(&first, &second);
}

/* The same picture at every size and place, when everything scales along. What is left are a few photons that
 * took another branch at a rim. */
static void sizes_and_places(void **state)
{
    (void)state;
    static const struct {
        struct scenery_params params;
        double bound;
    } cases[] = {
        {{.scale = 1e-4}, 0.01},
        {{.scale = 1e5}, 0.01},
        {{.shift = {1e5, -1e5, 1e5}}, 0.01},
        {{.scale = 1e-4, .shift = {3, 4, 5}}, 0.01},
        {{.scale = 1e5, .shift = {1e8, 0, 0}}, 0.01},
    };
    struct truth stage;
    double flux_there;
    open_ball(&stage, NULL, vec3_make(0, 0, 0), NULL);
    float *there = picture_of(&stage, &flux_there);
    truth_close(&stage);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        double flux;
        open_ball(&stage, &cases[i].params, vec3_make(0, 0, 0), NULL);
        float *here = picture_of(&stage, &flux);
        assert_true(scenery_plan_uses(truth_render(&stage, 1, 1u << CHANNEL_DEPTH), "full precision"));
        truth_close(&stage);
        double error = difference(here, there);
        print_message("scale %g, moved %g m: relative L1 %.2e, flux off by %.1e\n",
                      cases[i].params.scale > 0 ? cases[i].params.scale : 1, cases[i].params.shift[0], error,
                      flux / flux_there - 1);
        assert_in_bound(error, cases[i].bound);
        assert_close(flux, flux_there, 1e-3 * flux_there);
        free(here);
    }
    free(there);
}

/* A client's camera and lights are given in the world, and told in it, wherever the renderer has its origin.
 */
static void clients_speak_of_the_world(void **state)
{
    (void)state;
    struct truth stage;
    struct error error;
    const struct scenery_params far = {.shift = {65536, 0, -65536}}; /* floats hold its halves */
    open_ball(&stage, &far, vec3_make(0, 0, 0), NULL);
    float *followed = picture_of(&stage, NULL);
    struct view_camera camera = truth_render(&stage, 1, 0)->camera;
    assert_close((double)camera.eye[0], 65534, 0.01);
    view_reset(stage.view);
    assert_true(view_set_camera(stage.view, &camera, &error));
    struct view_light lamp = {.overrides = LIGHT_OVERRIDE_POSITION, .position = {65537.3f, 3.6f, -65536.7f}};
    assert_true(view_set_light(stage.view, 0, &lamp, &error));
    float *given = picture_of(&stage, NULL);
    const struct frame_result *result = truth_render(&stage, 1, 0);
    assert_memory_equal(&result->camera, &camera, sizeof camera);
    /* the eye is where the matrix says: its image is the camera's origin */
    for (int row = 0; row < 3; row++) {
        double place = (double)result->world_to_camera[12 + row];
        for (int k = 0; k < 3; k++)
            place += (double)result->world_to_camera[4 * k + row] * (double)camera.eye[k];
        assert_close(place, 0, 0.02);
    }
    double error_there = difference(given, followed);
    print_message("a camera and a lamp given in floats 92 km from the origin: relative L1 %.2e\n",
                  error_there);
    assert_in_bound(error_there, 0.1); /* eye and lamp are rounded to 8 mm there */
    free(given);
    free(followed);
    truth_close(&stage);
}

/* Vertices that were stored far from their own origin are rounded for good: said, not hidden. */
static void far_vertices_are_told(void **state)
{
    (void)state;
    static const struct {
        double distance;
        bool is_fine;
    } cases[] = {{10, true}, {1e5, false}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct truth stage;
        open_ball(&stage, NULL, vec3_make(cases[i].distance, 0, 0), NULL);
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        assert_true(scenery_plan_uses(result, "full precision") == cases[i].is_fine);
        struct measure_image image = {truth_channel(result, CHANNEL_CAUSTICS), WIDTH, HEIGHT, 3};
        assert_int_equal(measure_non_finite(&image), 0);
        struct scene_extent extent;
        struct error error;
        assert_true(scene_extent_find(stage.scene, &extent, &error));
        print_message("vertices %g m from their origin: coarseness %.1e\n", cases[i].distance,
                      extent.coarseness);
        assert_true(extent.coarsest == 1);
        /* and by the importer */
        char path[] = "/tmp/caustic-geometry-XXXXXX.glb";
        int file = mkstemps(path, 4);
        assert_true(file >= 0);
        close(file);
        assert_true(scene_export(stage.scene, path, &error));
        struct scene *imported = scene_import(path, &error);
        unlink(path);
        assert_non_null(imported);
        assert_true(scene_warns(imported, "is small as against its distance") != cases[i].is_fine);
        scene_destroy(&imported);
        truth_close(&stage);
    }
}

/* ---- triangles ----------------------------------------------------------------------------------------- */

/* A thousand triangles inside the ball whose corners coincide or lie on a line, of glass like the ball. */
static void add_flat_triangles(struct scene_builder *builder)
{
    uint32_t first_vertex = builder->scene->vertex_count, first_index = builder->scene->index_count;
    struct scene_vertex *vertices = scene_builder_vertices(builder, 3000);
    uint32_t *indices = scene_builder_indices(builder, 3000);
    for (uint32_t i = 0; i < 3000; i++) {
        double along = i % 3 == 0 ? -0.2 : i % 3 == 1 ? (i % 2 ? 0.2 : -0.2) : 0.1, turn = 0.01 * (i / 3);
        vec3_store(vertices[i].position,
                   vec3_make(along * cos(turn), 0.6 + 1e-4 * (i / 3), along * sin(turn)));
        vec3_store(vertices[i].normal, vec3_make(0, 1, 0));
        indices[i] = i;
    }
    scenery_place(
        builder, scene_builder_mesh(builder, "flat", scenery_glass(builder, 1.5), first_vertex, first_index));
}

/* A needle of glass above the ball, 3 m long and 10 micrometres thick: it shades 3e-5 m^2 of the floor. */
static void add_needle(struct scene_builder *builder)
{
    scenery_place(builder, shape_box(builder, "needle", scenery_glass(builder, 1.5), vec3_make(-1.5, 1.4, 0),
                                     vec3_make(1.5, 1.40001, 1e-5)));
}

static void triangles_without_area(void **state)
{
    (void)state;
    struct truth stage;
    double flux[3];
    float *pictures[3];
    void (*const extras[3])(struct scene_builder *) = {NULL, add_flat_triangles, add_needle};
    for (int i = 0; i < 3; i++) {
        open_ball(&stage, NULL, vec3_make(0, 0, 0), extras[i]);
        /* the tile covers the needle too: compare with all of the light's emission covered */
        truth_set(&stage, "tile=full caster_mask=0 density=uniform photons=65536");
        pictures[i] = picture_of(&stage, &flux[i]);
        truth_close(&stage);
    }
    print_message("relative L1 with flat triangles %.1e, with a needle %.1e\n",
                  difference(pictures[1], pictures[0]), difference(pictures[2], pictures[0]));
    assert_in_bound(difference(pictures[1], pictures[0]), 1e-6);
    assert_in_bound(difference(pictures[2], pictures[0]), 0.02);
    assert_close(flux[2], flux[0], 5e-3 * flux[0]);
    for (int i = 0; i < 3; i++)
        free(pictures[i]);
}

/* ---- counts -------------------------------------------------------------------------------------------- */

/* Flux that lands through a sheet of glass under the sun straight above, over what meets it: 1 - R. What is
 * reflected leaves the scene, or is left to a neighbour that may have missed the sheet's edge. */
static void check_sheet(struct truth *stage, double area)
{
    const double *s = truth_render(stage, 1, 1u << CHANNEL_IRRADIANCE)->stats;
    double landed = s[STAT_flux_splatted] + s[STAT_flux_culled_visibility],
           met = landed + s[STAT_flux_escaped] + s[STAT_flux_thinned];
    print_message("%u triangles: %.5f W of %.5f W land, %.0f MiB on the device\n",
                  stage->scene->triangle_count, landed, met, s[STAT_device_bytes] / 0x1p20);
    assert_close(landed, 0.96 * met, 1e-4 * met);
    assert_close(met, 3 * area, 0.02 * 3 * area);
    assert_true(s[STAT_guard_traversal] == 0);
}

static void one_triangle(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct truth stage;
    scenery_begin(&builder, NULL);
    scenery_floor(&builder, 8);
    uint32_t first_vertex = builder.scene->vertex_count, first_index = builder.scene->index_count;
    struct scene_vertex *vertices = scene_builder_vertices(&builder, 3);
    uint32_t *indices = scene_builder_indices(&builder, 3);
    const struct vec3 corners[3] = {{-1, 1, 1}, {1, 1, 1}, {0, 1, -1}};
    for (uint32_t i = 0; i < 3; i++) {
        vec3_store(vertices[i].position, corners[i]);
        vec3_store(vertices[i].normal, vec3_make(0, 1, 0));
        indices[i] = i;
    }
    scenery_place(&builder, scene_builder_mesh(&builder, "glass", scenery_glass(&builder, 1.5), first_vertex,
                                               first_index));
    scenery_sun(&builder, vec3_make(0, -1, 0), 1);
    struct view_camera camera =
        scenery_camera(&builder, vec3_make(0, 2, 3), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 40);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=65536");
    check_sheet(&stage, 2);
    truth_close(&stage);
}

static void open_sheet(struct scene_builder *builder, uint32_t quads, struct view_camera *camera)
{
    scenery_begin(builder, NULL);
    scenery_floor(builder, 8);
    scenery_place(builder, shape_water(builder, "sheet", scenery_glass(builder, 1.5), vec3_make(0, 1, 0), 2,
                                       quads, NULL, 0));
    scenery_sun(builder, vec3_make(0, -1, 0), 1);
    *camera = scenery_camera(builder, vec3_make(0, 2, 3), vec3_make(0, 0, 0), vec3_make(0, 1, 0), 40);
}

/* 1581^2 quads are 5 million triangles: on lavapipe, whose buffers take 2.8 million, in two of them. */
static void many_triangles(void **state)
{
    (void)state;
    const uint32_t quads = getenv("CAUSTICD_LONG") ? 1581 : 200;
    struct scene_builder builder;
    struct view_camera camera;
    struct truth stage;
    open_sheet(&builder, quads, &camera);
    scenery_open(&stage, &builder, &camera, 32, 32, "photons=65536");
    check_sheet(&stage, 4);
    bool is_too_many =
        stage.scene->triangle_count * sizeof(struct bvh_triangle) > gpu_info(stage.gpu)->max_storage_bytes;
    assert_true(scenery_plan_uses(truth_render(&stage, 1, 0), "second triangle buffer") ==
                (is_too_many && renderer_tracer(stage.renderer) == TRACER_BVH));
    truth_close(&stage);
}

/* 80,002 triangles, 3.7 MiB, on devices whose storage buffers take less: two of 2 MiB give the same bits; for
 * two of 1.5 MiB they are too many, and it says so. */
static void more_triangles_than_a_buffer_takes(void **state)
{
    (void)state;
    struct scene_builder builder;
    struct view_camera camera;
    struct truth stages[2];
    const struct frame_result *results[2];
    for (int i = 0; i < 2; i++) {
        open_sheet(&builder, 200, &camera);
        scenery_open_within(&stages[i], &builder, &camera, 32, 32, "photons=4096", i ? 2u << 20 : 0);
        if (renderer_tracer(stages[i].renderer) != TRACER_BVH) {
            truth_close(&stages[i]);
            skip(); /* the device keeps the triangles itself */
        }
        results[i] = truth_render(&stages[i], 2, 1u << CHANNEL_IRRADIANCE | 1u << CHANNEL_NORMAL);
        assert_true(scenery_plan_uses(results[i], "second triangle buffer") == (i == 1));
    }
    assert_true(results[0]->stats[STAT_photons_contributing] > 0);
    for (uint32_t c = 0; c < 2; c++)
        assert_memory_equal(results[0]->channels[c].values, results[1]->channels[c].values,
                            3 * 32 * 32 * sizeof(float));
    assert_true(results[0]->stats[STAT_flux_splatted] == results[1]->stats[STAT_flux_splatted]);
    truth_close(&stages[0]);
    truth_close(&stages[1]);

    struct error error;
    struct gpu *gpu = gpu_create(&(struct gpu_params){.max_storage_bytes = 3u << 19}, &error);
    assert_non_null(gpu);
    open_sheet(&builder, 200, &camera);
    struct scene *scene = scene_builder_finish(&builder, &error);
    assert_non_null(scene);
    assert_null(renderer_create(&(struct renderer_params){.gpu = gpu, .scene = scene}, &error));
    print_message("%s\n", error.message);
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "the triangles of scene 'scenery' need 3 MiB"));
    scene_destroy(&scene);
    gpu_destroy(&gpu);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sizes_and_places),
        cmocka_unit_test(clients_speak_of_the_world),
        cmocka_unit_test(far_vertices_are_told),
        cmocka_unit_test(triangles_without_area),
        cmocka_unit_test(one_triangle),
        cmocka_unit_test(many_triangles),
        cmocka_unit_test(more_triangles_than_a_buffer_takes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
