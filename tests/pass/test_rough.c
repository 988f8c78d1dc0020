/* Rough casters: footprints widened by the lobe against photons of which each takes one slope of it
 * (test_truth_rough.c holds both to integrals). */
#include <string.h>

#include "core/measure/image_measure.h"
#include "core/render/renderer.h"
#include "core/scene/scene.h"
#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 96, HEIGHT = 54, VALUES = WIDTH * HEIGHT * 3 };
/* Of the channels the one that aa=pixel keeps where a pixel's middle sees the caster. */
#define CAUSTICS (1u << CHANNEL_CAUSTICS)

static void open_rough(struct truth *stage, const char *name, float roughness, const char *settings)
{
    struct error error = {0};
    struct scene *scene = scene_open(name, &error);
    assert_non_null(scene);
    for (uint32_t i = 0; i < scene->material_count; i++)
        if (scene->materials[i].kind != MATERIAL_DIFFUSE)
            scene->materials[i].roughness = roughness;
    stage_open_scene(stage, scene, WIDTH, HEIGHT, settings);
}

static void lobes_widen_footprints(void **state)
{
    (void)state;
    static const struct {
        const char *scene;
        float roughness;
        double bound, flux_bound;
    } cases[] = {{"sphere", 0.15f, 0.05, 0.03}, {"sphere", 0.3f, 0.1, 0.05}, {"ring", 0.2f, 0.12, 0.08}};
    static float reference[VALUES], sharp[VALUES];
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct truth stage;
        open_rough(&stage, cases[i].scene, cases[i].roughness,
                   "photons=32768 cells=64 density=uniform aa=pixel accumulate=32");
        memcpy(reference, truth_channel(truth_render(&stage, 1, CAUSTICS), CHANNEL_CAUSTICS),
               sizeof reference);
        truth_set(&stage, "aa=filter accumulate=1 density=sqrt photons=65536");
        view_reset(stage.view);
        const struct frame_result *result = truth_render(&stage, 3, CAUSTICS);
        static float rough[VALUES], smooth[2][VALUES];
        memcpy(rough, truth_channel(result, CHANNEL_CAUSTICS), sizeof rough);
        truth_close(&stage);
        open_rough(&stage, cases[i].scene, 0, "photons=65536");
        memcpy(sharp, truth_channel(truth_render(&stage, 3, CAUSTICS), CHANNEL_CAUSTICS), sizeof sharp);
        truth_close(&stage);
        struct measure_image a = {rough, WIDTH, HEIGHT, 3}, b = {reference, WIDTH, HEIGHT, 3},
                             c = {sharp, WIDTH, HEIGHT, 3};
        measure_box3(&a, smooth[0]);
        measure_box3(&b, smooth[1]);
        struct measure_image smooth_a = {smooth[0], WIDTH, HEIGHT, 3},
                             smooth_b = {smooth[1], WIDTH, HEIGHT, 3};
        double error = measure_relative_l1(&smooth_a, &smooth_b), polished = measure_relative_l1(&c, &b);
        double flux = measure_sum(&a, 1, NULL) / measure_sum(&b, 1, NULL);
        print_message("%s, roughness %.2f: relative L1 %.4f (raw %.4f; polished %.4f), flux %.4f\n",
                      cases[i].scene, (double)cases[i].roughness, error, measure_relative_l1(&a, &b),
                      polished, flux);
        assert_in_bound(error, cases[i].bound);
        assert_true(error < 0.7 * polished);
        /* footprints reach through the ring's wall to the floor behind it, where its own light does not go */
        assert_close(flux, 1, cases[i].flux_bound);
    }
}

/* Polished is polished: a roughness too small to see leaves the same bits as none. */
static void polished_stays_polished(void **state)
{
    (void)state;
    static float none[VALUES];
    for (int i = 0; i < 2; i++) {
        struct truth stage;
        open_rough(&stage, "ring", i ? 0.015f : 0, "photons=8192 cells=32");
        const float *values = truth_channel(truth_render(&stage, 2, CAUSTICS), CHANNEL_CAUSTICS);
        if (i)
            assert_memory_equal(none, values, sizeof none);
        memcpy(none, values, sizeof none);
        truth_close(&stage);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(lobes_widen_footprints),
                                       cmocka_unit_test(polished_stays_polished)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
