/* Measures of pictures over time against constructed sequences: known deviations, patches, moving edges,
 * fades. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/measure/temporal.h"
#include "tests/support/check.h"

#define WIDTH  20u
#define HEIGHT 10u
#define PIXELS (WIDTH * HEIGHT)

static struct error error;

static void luminance_is_rec709(void **state)
{
    (void)state;
    const float rgb[] = {1, 1, 1, 1, 0, 0, 0, 2, 0};
    float luminance[3];
    temporal_luminance(rgb, 3, luminance);
    assert_close((double)luminance[0], 1, 1e-6);
    assert_close((double)luminance[1], 0.2126, 1e-6);
    assert_close((double)luminance[2], 1.4304, 1e-6);
}

static void the_bar_ignores_fireflies_and_black(void **state)
{
    (void)state;
    float picture[1000] = {0};
    assert_true(isinf(temporal_caustic_threshold(picture, 1000, 0)));
    for (int i = 0; i < 500; i++)
        picture[2 * i] = 3;
    picture[10] = 1e6f; /* one in 500 is above the 99th percentile */
    assert_close(temporal_caustic_threshold(picture, 1000, 0), 0.06, 1e-9);
    assert_close(temporal_caustic_threshold(picture, 1000, 0.5), 1.5, 1e-9);
}

/* Pixel i of the lit half swings by i tenths of a per cent of its mean, up and down in turn: over n frames
 * its std is that times sqrt(n / (n - 1)). */
static void deviations_are_known(void **state)
{
    (void)state;
    const uint32_t frames = 64;
    struct temporal_pixels *pixels = temporal_pixels_create(WIDTH, HEIGHT, &error);
    float picture[PIXELS], map[PIXELS], mean[PIXELS];
    for (uint32_t t = 0; t < frames; t++) {
        for (uint32_t i = 0; i < PIXELS; i++) {
            double swing = 0.001 * (i + 1) * (t % 2 ? 1 : -1);
            picture[i] = i < 100 ? (float)(8 * (1 + swing)) : i < 150 ? 1e-3f * (float)(t % 2) : 0;
        }
        temporal_pixels_add(pixels, picture);
    }
    struct temporal_flicker flicker;
    assert_true(temporal_flicker(pixels, &(struct temporal_flicker_params){0}, map, &flicker, &error));
    double bessel = sqrt(frames / (frames - 1.0));
    assert_int_equal(flicker.frames, frames);
    assert_int_equal(flicker.caustic_pixels, 100);
    assert_close(flicker.threshold, 0.16, 1e-6);
    assert_close(flicker.mean, 0.0505 * bessel, 1e-6);
    assert_close(flicker.p95, (0.001 + 0.95 * 0.099) * bessel, 1e-6);
    assert_close(flicker.p99, (0.001 + 0.99 * 0.099) * bessel, 1e-6);
    assert_close(flicker.largest, 0.1 * bessel, 1e-6);
    /* More than half a per cent: all but the first four, in rows that touch. */
    assert_int_equal(flicker.flickering_pixels, 96);
    assert_int_equal(flicker.largest_patch, 96);
    assert_close((double)map[49], 0.05 * bessel, 1e-6);
    assert_true(map[120] == 0);
    temporal_pixels_mean(pixels, mean);
    assert_close((double)mean[49], 8, 1e-6);
    temporal_pixels_destroy(&pixels);
    assert_null(pixels);
}

/* A sinusoid's std is amplitude / sqrt 2; streaming keeps its digits on top of a large mean. */
static void a_sinusoid_on_a_large_mean(void **state)
{
    (void)state;
    struct temporal_pixels *pixels = temporal_pixels_create(1, 1, &error);
    for (uint32_t t = 0; t < 5000; t++) {
        float value = (float)(1000 + 0.5 * sin(6.283185307179586 * t / 50));
        temporal_pixels_add(pixels, &value);
    }
    struct temporal_flicker flicker;
    assert_true(temporal_flicker(pixels, &(struct temporal_flicker_params){0}, NULL, &flicker, &error));
    assert_close(flicker.p99, 0.5 / sqrt(2) / 1000, 1e-6);
    temporal_pixels_destroy(&pixels);
}

static void a_still_picture_does_not_flicker(void **state)
{
    (void)state;
    struct temporal_pixels *pixels = temporal_pixels_create(WIDTH, HEIGHT, &error);
    float picture[PIXELS];
    struct temporal_flicker flicker;
    for (uint32_t i = 0; i < PIXELS; i++)
        picture[i] = 0.1f * (float)i;
    temporal_pixels_add(pixels, picture);
    assert_false(temporal_flicker(pixels, &(struct temporal_flicker_params){0}, NULL, &flicker, &error));
    assert_non_null(strstr(error.message, "1 frames are too few to measure flicker; it takes 2"));
    for (int t = 0; t < 9; t++)
        temporal_pixels_add(pixels, picture);
    assert_true(temporal_flicker(pixels, &(struct temporal_flicker_params){0}, NULL, &flicker, &error));
    assert_true(flicker.caustic_pixels > 0 && flicker.largest == 0 && flicker.flickering_pixels == 0);
    temporal_pixels_destroy(&pixels);
}

static void a_black_picture_has_no_caustic_pixels(void **state)
{
    (void)state;
    struct temporal_pixels *pixels = temporal_pixels_create(WIDTH, HEIGHT, &error);
    float picture[PIXELS] = {0};
    struct temporal_flicker flicker;
    temporal_pixels_add(pixels, picture);
    temporal_pixels_add(pixels, picture);
    assert_true(temporal_flicker(pixels, &(struct temporal_flicker_params){0}, NULL, &flicker, &error));
    assert_true(flicker.caustic_pixels == 0 && flicker.mean == 0 && flicker.p99 == 0);
    temporal_pixels_destroy(&pixels);
}

static uint32_t patch_of(const char *rows, uint32_t width, uint32_t height)
{
    uint8_t mask[256];
    uint32_t pixels;
    for (uint32_t i = 0; i < width * height; i++)
        mask[i] = rows[i] == '#';
    assert_true(temporal_largest_patch(mask, width, height, &pixels, &error));
    return pixels;
}

static void patches_are_counted(void **state)
{
    (void)state;
    assert_int_equal(patch_of("......"
                              "......",
                              6, 2),
                     0);
    assert_int_equal(patch_of("#....#"
                              "##..##",
                              6, 2),
                     3);
    assert_int_equal(patch_of("#....." /* corners touch */
                              ".#...."
                              "..#..#",
                              6, 3),
                     3);
    assert_int_equal(patch_of("#####" /* a ring and its middle */
                              "#...#"
                              "#.#.#"
                              "#...#"
                              "#####",
                              5, 5),
                     16);
    assert_int_equal(patch_of("..#" /* the end of a row does not touch the start of the next but one */
                              "..."
                              "#..",
                              3, 3),
                     1);
    assert_int_equal(patch_of("####"
                              "####",
                              4, 2),
                     8);
}

/* The reference moves by one pixel; a picture that stands still is wrong by the whole change, one that
 * moves along and is brighter all over by none of it. */
static void differences_against_the_references_own(void **state)
{
    (void)state;
    const float before[] = {0, 0, 4, 0}, now[] = {0, 4, 0, 0}, bright[] = {1, 1, 5, 1},
                later[] = {1, 5, 1, 1};
    struct temporal_difference d;
    temporal_difference(bright, later, before, now, 4, &d);
    assert_close(d.rmse, 0, 0);
    assert_close(d.reference_change, sqrt(8), 1e-12);
    temporal_difference(before, before, before, now, 4, &d);
    assert_close(d.rmse, sqrt(8), 1e-12);
    assert_close(d.relative, sqrt(2), 1e-12);
    assert_close(d.relative_change, sqrt(2), 1e-12);
    temporal_difference(before, now, now, now, 4, &d); /* moves where nothing should */
    assert_close(d.rmse, sqrt(8), 1e-12);
    assert_close(d.reference_change, 0, 0);
}

static void a_fade_leaves_its_rest(void **state)
{
    (void)state;
    const float old[] = {8, 8, 0.1f, 0, 2}, settled[] = {0.25f, 0, 8, 8, 2};
    float picture[5];
    for (int step = 0; step <= 10; step++) {
        double rest = 1 - 0.1 * step;
        for (int i = 0; i < 5; i++)
            picture[i] = (float)(rest * (double)old[i] + (1 - rest) * (double)settled[i]);
        assert_close(temporal_remaining(picture, old, settled, 5), rest, 1e-6);
        assert_close(temporal_ghost(picture, old, settled, 5, 1), rest, 1e-6);
    }
    /* What is missing elsewhere is no ghost; what is left in one of the two old places is. */
    const float half[] = {0.25f, 8, 0, 0, 9};
    assert_close(temporal_ghost(half, old, settled, 5, 1), 8 / 15.75, 1e-6);
    assert_true(isnan(temporal_remaining(half, old, old, 5)));
    assert_true(isnan(temporal_ghost(half, old, old, 5, 1)));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(luminance_is_rec709),
        cmocka_unit_test(the_bar_ignores_fireflies_and_black),
        cmocka_unit_test(deviations_are_known),
        cmocka_unit_test(a_sinusoid_on_a_large_mean),
        cmocka_unit_test(a_still_picture_does_not_flicker),
        cmocka_unit_test(a_black_picture_has_no_caustic_pixels),
        cmocka_unit_test(patches_are_counted),
        cmocka_unit_test(differences_against_the_references_own),
        cmocka_unit_test(a_fade_leaves_its_rest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
