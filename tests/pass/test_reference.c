/* Frames at the default settings against converged ones: the project's own unbiased mode, and pictures of
 * another program that has nothing in common with it. */

#include <stdlib.h>
#include <string.h>

#include "core/image/image_io.h"
#include "tests/support/check.h"
#include "tests/support/reference.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

#ifndef REFERENCE_PHOTONS
#define REFERENCE_PHOTONS 50e6
#endif
enum { WIDTH = 480, HEIGHT = 270, WARM_UP = 4 };

static const float *render_warm(struct truth *stage, const char *settings)
{
    truth_set(stage, settings);
    view_reset(stage->view);
    return truth_channel(truth_render(stage, WARM_UP + 1, 1u << CHANNEL_CAUSTICS), CHANNEL_CAUSTICS);
}

/* ---- own reference ------------------------------------------------------------------------------------- */

static void check_scene(const char *scene, double bound, double photons)
{
    struct reference reference = reference_make(scene, WIDTH, HEIGHT, photons, "roulette");
    print_message("%s: reference of %.1f M photons, noise %.2f %%, after a 3x3 box %.2f %%\n", scene,
                  1e-6 * reference.photons, 100 * reference.noise, 100 * reference.filtered_noise);
    struct truth stage;
    stage_open(&stage, scene, WIDTH, HEIGHT, NULL);
    enum { DEFAULT = 2, BUDGETS = 4 };
    const int budgets[BUDGETS] = {8192, 32768, (int)setting_infos[SETTING_photons].value, 294912};
    double errors[BUDGETS];
    for (int i = 0; i < BUDGETS; i++) {
        char settings[64];
        snprintf(settings, sizeof settings, "photons=%d", budgets[i]);
        const float *caustics = render_warm(&stage, settings);
        errors[i] = reference_error(&reference, caustics);
        print_message("%s, photons=%d%s: relative L1 %.2f %%, after a 3x3 box %.2f %%\n", scene, budgets[i],
                      i == DEFAULT ? ", the default" : "", 100 * errors[i],
                      100 * reference_filtered_error(&reference, caustics));
    }
    truth_close(&stage);

    assert_in_bound(errors[DEFAULT], bound);
    /* A reference noisier than this could hide a rise. */
    assert_in_bound(reference.noise, 0.5 * bound);
    for (int i = 1; i < BUDGETS; i++)
        assert_in_bound(errors[i], hypot(errors[i - 1], reference.noise));
    assert_true(errors[BUDGETS - 1] < errors[0]);
    reference_free(&reference);
}

static void sphere(void **state)
{
    (void)state;
    check_scene("sphere", 0.06, REFERENCE_PHOTONS);
}

static void ring(void **state)
{
    (void)state;
    check_scene("ring", 0.06, REFERENCE_PHOTONS);
}

static void square(void **state)
{
    (void)state;
    /* Its many interfaces take minutes for 50 M photons: on demand. Noise of the smaller reference raises the
     * error. */
    check_scene("square", 0.10, getenv("CAUSTICD_LONG") ? REFERENCE_PHOTONS : 0.2 * REFERENCE_PHOTONS);
}

/* ---- another program's picture ------------------------------------------------------------------------- */

static float *read_picture(const char *path)
{
    struct error error = {0};
    struct image_file *file = image_read_exr(path, &error);
    if (!file)
        fail_msg("%s", error.message);
    assert_int_equal(file->width, WIDTH);
    assert_int_equal(file->height, HEIGHT);
    float *values = malloc((size_t)3 * WIDTH * HEIGHT * sizeof *values);
    assert_non_null(values);
    for (int k = 0; k < 3; k++) {
        const char *const names[] = {"R", "G", "B"};
        const float *plane = image_file_plane(file, names[k]);
        assert_non_null(plane);
        for (size_t i = 0; i < (size_t)WIDTH * HEIGHT; i++)
            values[3 * i + (size_t)k] = plane[i];
    }
    image_file_destroy(&file);
    return values;
}

static void check_picture(const char *name)
{
    char file[64], scene[512], picture[512];
    snprintf(file, sizeof file, "truth/%s.glb", name);
    bool is_there = stage_shared_file(file, scene, sizeof scene);
    snprintf(file, sizeof file, "truth/%s_caustics.exr", name);
    if (!is_there || !stage_shared_file(file, picture, sizeof picture)) {
        print_message("not compared: %s is not there\n", file);
        skip();
    }
    float *truth = read_picture(picture);
    struct measure_image expected = {truth, WIDTH, HEIGHT, 3};
    struct truth stage;
    stage_open(&stage, scene, WIDTH, HEIGHT, NULL);
    struct measure_image image = {render_warm(&stage, ""), WIDTH, HEIGHT, 3};
    double error = measure_relative_l1(&image, &expected), flux = 0, truth_flux = 0;
    for (uint32_t k = 0; k < 3; k++) {
        flux += measure_sum(&image, k, NULL);
        truth_flux += measure_sum(&expected, k, NULL);
    }
    double flux_error = flux / truth_flux - 1;
    print_message("%s, default settings against another program: relative L1 %.2f %%, flux %+.3f %%\n", name,
                  100 * error, 100 * flux_error);
    /* And the unbiased mode: its flux is free of the splats' error at edges. */
    truth_set(&stage, "photons=262144 density=uniform aa=pixel accumulate=16");
    image.values = truth_channel(truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS), CHANNEL_CAUSTICS);
    double unbiased_flux = 0;
    for (uint32_t k = 0; k < 3; k++)
        unbiased_flux += measure_sum(&image, k, NULL);
    double unbiased_error = unbiased_flux / truth_flux - 1;
    print_message("%s, accumulate=16 aa=pixel: relative L1 %.2f %%, flux %+.3f %%\n", name,
                  100 * measure_relative_l1(&image, &expected), 100 * unbiased_error);
    truth_close(&stage);
    free(truth);
    assert_in_bound(error, 0.06);
    assert_in_bound(fabs(flux_error), 5e-3);
    assert_in_bound(fabs(unbiased_error), 5e-3);
}

static void sphere_of_another_program(void **state)
{
    (void)state;
    check_picture("sphere");
}

static void ring_of_another_program(void **state)
{
    (void)state;
    check_picture("ring");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(sphere_of_another_program),
                                       cmocka_unit_test(ring_of_another_program), cmocka_unit_test(sphere),
                                       cmocka_unit_test(ring), cmocka_unit_test(square)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
