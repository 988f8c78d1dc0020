/* Coloured glass: light that went down a pool of it, every pixel against Fresnel, Snell, Beer and Lambert,
 * and the base colour of the surface it crossed. */
#include <string.h>

#include "core/measure/analytic.h"
#include "core/render/renderer.h"
#include "core/scene/scene.h"
#include "tests/support/check.h"
#include "tests/support/truth.h"

/* Metres below a boundary 1 m under the light on the way to `radius` on a floor 1 m under it. */
static double path_below(double radius, double ior)
{
    double low = 0, high = 1; /* sine of the angle in air */
    for (int i = 0; i < 60; i++) {
        double sine = 0.5 * (low + high), below = sine / ior;
        double reached = sine / sqrt(1 - sine * sine) + below / sqrt(1 - below * below);
        *(reached < radius ? &low : &high) = sine;
    }
    return 1 / sqrt(1 - low * low / (ior * ior));
}

static void beer_lambert(void **state)
{
    (void)state;
    struct truth truth;
    struct error error = {0};
    struct truth_params params = {
        .caster = TRUTH_INTERFACE,
        .size = 6,
        .height = 1,
        .light = {0, 2, 0},
        .intensity = 10,
        .camera = {.eye = {0.3f, 0.9f, 0.4f}, .at = {0.3f, 0, 0.4f}, .up = {0, 0, -1}, .fov = 75},
        .width = 96,
        .height_px = 54,
    };
    truth_open(&truth, &params);
    view_destroy(&truth.view);
    renderer_destroy(&truth.renderer);
    static const float tint[3] = {0.9f, 0.5f, 0.25f}, kept[3] = {0.2f, 0.6f, 1};
    const double distance = 0.8;
    for (uint32_t i = 0; i < truth.scene->material_count; i++) {
        struct scene_material *material = &truth.scene->materials[i];
        if (material->kind != MATERIAL_DIELECTRIC)
            continue;
        memcpy(material->base_color, tint, sizeof tint);
        memcpy(material->attenuation_color, kept, sizeof kept);
        material->attenuation_distance = (float)distance;
    }
    truth.renderer =
        renderer_create(&(struct renderer_params){.gpu = truth.gpu, .scene = truth.scene}, &error);
    assert_non_null(truth.renderer);
    truth.view = view_create(truth.renderer, truth.width, truth.height, &error);
    assert_non_null(truth.view);
    assert_true(view_set_camera(truth.view, &truth.camera, &error));
    truth_set(&truth, "density=uniform photons=65536 kappa=16");
    const struct frame_result *result = truth_render(&truth, 1, 1u << CHANNEL_IRRADIANCE);
    const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
    struct analytic_interface scene = {.intensity = 10, .light_height = 1, .depth = 1, .ior = 1.5};
    double mean[3] = {0}, bias[3] = {0}, count = truth.width * truth.height;
    for (uint32_t y = 0; y < truth.height; y++)
        for (uint32_t x = 0; x < truth.width; x++) {
            double floor[2];
            assert_true(truth_floor_point(&truth, x + 0.5, y + 0.5, floor));
            double radius = hypot(floor[0], floor[1]), clear = analytic_interface_irradiance(&scene, radius);
            for (uint32_t c = 0; c < 3; c++) {
                double expected =
                    clear * (double)tint[c] * pow((double)kept[c], path_below(radius, 1.5) / distance);
                double off = (double)values[3 * (y * truth.width + x) + c] / expected - 1;
                mean[c] += fabs(off) / count;
                bias[c] += off / count;
            }
        }
    for (int c = 0; c < 3; c++) {
        print_message("channel %d, %.2f after %.1f m, base colour %.2f: error mean %.3f %%, bias %.3f %%\n",
                      c, (double)kept[c], distance, (double)tint[c], 100 * mean[c], 100 * bias[c]);
        assert_in_bound(mean[c], 0.01);
        assert_in_bound(fabs(bias[c]), 0.003);
    }
    truth_close(&truth);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(beer_lambert)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
