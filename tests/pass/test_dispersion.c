/* Dispersion: where a narrow beam's colours land behind a prism, by Snell's law at every wavelength; that
 * bands add up to white; that every channel keeps its flux. */
#include <string.h>

#include "core/render/renderer.h"
#include "core/scene/scene.h"
#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { WIDTH = 160, HEIGHT = 90, PIXELS = WIDTH * HEIGHT };
#define IRRADIANCE (1u << CHANNEL_IRRADIANCE)

static const double eye[2] = {-1.5, 1.9},
                    at[2] = {0.15, 0.8}; /* of the beam, in the plane of the prism's section */

/* `prism` with a narrow beam in place of the sun, in the plane z = 0. */
static void open_beam(struct truth *stage, float dispersion)
{
    struct error error = {0};
    struct scene *scene = scene_open("prism", &error);
    assert_non_null(scene);
    for (uint32_t i = 0; i < scene->material_count; i++)
        if (scene->materials[i].kind == MATERIAL_DIELECTRIC)
            scene->materials[i].dispersion = dispersion;
    struct scene_light *light = &scene->lights[0];
    light->type = LIGHT_SPOT;
    light->inner_cone = 0.004f;
    light->outer_cone = 0.006f;
    float *m = scene->nodes[light->node].matrix;
    double length = hypot(at[0] - eye[0], at[1] - eye[1]), bx = (eye[0] - at[0]) / length,
           by = (eye[1] - at[1]) / length;
    const float matrix[16] = {0,         0,         -1, 0, (float)-by,    (float)bx,     0, 0,
                              (float)bx, (float)by, 0,  0, (float)eye[0], (float)eye[1], 0, 1};
    memcpy(m, matrix, sizeof matrix);
    stage_open_scene(stage, scene, WIDTH, HEIGHT, "photons=16384 cells=64");
    stage->camera =
        (struct view_camera){.eye = {1.4f, 1.2f, 0}, .at = {0.45f, 0, 0}, .up = {0, 1, 0}, .fov = 14};
    assert_true(view_set_camera(stage->view, &stage->camera, &error));
}

/* Where the beam's axis meets the floor after the prism, for one index of refraction: straight in the plane.
 * The share that both faces let through goes to *kept. */
static double floor_place(double ior, double *kept)
{
    *kept = 1;
    double corner[3][2], p[2] = {eye[0], eye[1]}, d[2] = {at[0] - eye[0], at[1] - eye[1]};
    for (int i = 0; i < 3; i++) {
        double angle = 3.14159265358979 / 180 * (-90 + 120 * i), radius = 0.7 / sqrt(3.0);
        corner[i][0] = radius * cos(angle);
        corner[i][1] = 0.6 + radius * sin(angle);
    }
    double length = hypot(d[0], d[1]);
    d[0] /= length, d[1] /= length;
    for (int face = 0; face < 2; face++) {
        double best = INFINITY, n[2] = {0, 0};
        for (int i = 0; i < 3; i++) {
            const double *a = corner[i], *b = corner[(i + 1) % 3];
            double e[2] = {b[0] - a[0], b[1] - a[1]}, det = d[0] * e[1] - d[1] * e[0];
            double t = ((a[0] - p[0]) * e[1] - (a[1] - p[1]) * e[0]) / det;
            double s = ((a[0] - p[0]) * d[1] - (a[1] - p[1]) * d[0]) / det;
            if (t > 1e-9 && t < best && s >= 0 && s <= 1) {
                best = t;
                n[0] = e[1] / 0.7, n[1] = -e[0] / 0.7; /* outward: corners go round counter-clockwise */
            }
        }
        assert_true(best < INFINITY);
        p[0] += best * d[0], p[1] += best * d[1];
        /* angles from the normal on the side the light goes to */
        double side = d[0] * n[0] + d[1] * n[1] > 0 ? 1 : -1;
        double in = atan2(side * (n[0] * d[1] - n[1] * d[0]), side * (n[0] * d[0] + n[1] * d[1]));
        double out = asin(sin(in) * (face ? ior : 1 / ior));
        *kept *= 1 - 0.5 * (pow(sin(in - out) / sin(in + out), 2) + pow(tan(in - out) / tan(in + out), 2));
        double angle = atan2(side * n[1], side * n[0]) + out;
        d[0] = cos(angle), d[1] = sin(angle);
    }
    assert_true(d[1] < 0);
    return p[0] - p[1] / d[1] * d[0];
}

/* The glass of dispersion 1 at the middle of a band: n = A + B / wavelength^2 through the d line, Abbe number
 * 20; the middles of 575-650, 500-575 and 430-500 nm in inverse squares. */
static double band_ior(int band)
{
    static const double edges[4] = {650, 575, 500, 430};
    double slope = 0.5 / 20 / (1e6 / (486.1 * 486.1) - 1e6 / (656.3 * 656.3));
    double middle = 0.5 * (1e6 / (edges[band] * edges[band]) + 1e6 / (edges[band + 1] * edges[band + 1]));
    return 1.5 + slope * (middle - 1e6 / (587.6 * 587.6));
}

static void colours_land_where_snell_says(void **state)
{
    (void)state;
    struct truth stage;
    open_beam(&stage, 1);
    const struct frame_result *result = truth_render(&stage, 4, IRRADIANCE);
    const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
    double expected[3], found[3], kept;
    for (int band = 0; band < 3; band++) {
        expected[band] = floor_place(band_ior(band), &kept);
        double sum = 0, moment = 0;
        for (uint32_t y = 0; y < HEIGHT; y++)
            for (uint32_t x = 0; x < WIDTH; x++) {
                double floor[2];
                if (!truth_floor_point(&stage, x + 0.5, y + 0.5, floor) ||
                    fabs(floor[0] - expected[band]) > 0.06 || fabs(floor[1]) > 0.06)
                    continue;
                double flux = (double)values[3 * (y * WIDTH + x) + (uint32_t)band] *
                              truth_pixel_area(&stage, x + 0.5, y + 0.5);
                sum += flux;
                moment += flux * floor[0];
            }
        assert_true(sum > 0);
        found[band] = moment / sum;
        print_message("band %d: at %.4f m, by Snell %.4f m\n", band, found[band], expected[band]);
        assert_close(found[band], expected[band], 0.0015);
    }
    assert_true(fabs(expected[0] - expected[2]) > 0.02); /* what the tolerance is small against */
    truth_close(&stage);
}

static void channels_keep_their_flux(void **state)
{
    (void)state;
    static const float dispersions[3] = {0, 1e-30f, 1};
    double flux[3][3] = {{0}};
    for (int i = 0; i < 3; i++) {
        struct truth stage;
        open_beam(&stage, dispersions[i]);
        truth_set(&stage, "density=uniform");
        const struct frame_result *result = truth_render(&stage, 1, IRRADIANCE);
        const float *values = truth_channel(result, CHANNEL_IRRADIANCE);
        for (uint32_t p = 0; p < PIXELS; p++)
            for (uint32_t c = 0; c < 3; c++)
                flux[i][c] +=
                    (double)values[3 * p + c] * truth_pixel_area(&stage, p % WIDTH + 0.5, p / WIDTH + 0.5);
        if (i == 1) /* three bands on one path are white, to the last bit */
            for (int p = 0; p < PIXELS; p++)
                assert_true(values[3 * p] == values[3 * p + 1] && values[3 * p] == values[3 * p + 2]);
        double balance = result->stats[STAT_flux_emitted] - result->stats[STAT_flux_splatted] -
                         result->stats[STAT_flux_culled_visibility] - result->stats[STAT_flux_culled_energy] -
                         result->stats[STAT_flux_direct] - result->stats[STAT_flux_absorbed] -
                         result->stats[STAT_flux_escaped] - result->stats[STAT_flux_bounce_limit];
        print_message("dispersion %g: flux %.4e %.4e %.4e W, %.0f rays, ledger off by %.2e of %.3e W\n",
                      (double)dispersions[i], flux[i][0], flux[i][1], flux[i][2],
                      result->stats[STAT_rays_traced], balance, result->stats[STAT_flux_emitted]);
        assert_in_bound(fabs(balance), 1e-3 * result->stats[STAT_flux_emitted]);
        /* blue leaves the prism nearer to total reflection than red */
        for (uint32_t c = 0; c < 3; c++) {
            double kept[2];
            floor_place(1.5, &kept[0]);
            floor_place(i == 2 ? band_ior((int)c) : 1.5, &kept[1]);
            if (i == 2)
                print_message("channel %u: %.4f of the flux without dispersion, by Fresnel %.4f\n", c,
                              flux[i][c] / flux[0][c], kept[1] / kept[0]);
            assert_close(flux[i][c] / flux[0][c], kept[1] / kept[0], 0.002);
        }
        truth_close(&stage);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(colours_land_where_snell_says),
                                       cmocka_unit_test(channels_keep_their_flux)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
