/* With the pixel filter, or by coverage, a splat is never brighter than its light spread over a pixel, so
 * that no photon alone makes a pixel that stands out: pixels above 4 times the median of the reference's 7x7
 * around them, luminance. A bright focus is above it in the reference itself: only what is brighter than the
 * reference nearby counts.
 */
#include <string.h>

#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/reference.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

static double brightest(const struct measure_image *image)
{
    double largest = 0;
    for (size_t i = 0; i < (size_t)image->width * image->height; i++)
        largest = fmax(largest, measure_luminance(image, i));
    return largest;
}

/* Whether the nine pixels around one see a single plane: along a line on it 1 / depth is linear. Beside a
 * silhouette the reference's pixel is part receiver and part caster, a frame's is all of either. */
static bool is_plane(const float *depth, uint32_t width, uint32_t height, uint32_t x, uint32_t y)
{
    if (x == 0 || y == 0 || x + 1 == width || y + 1 == height)
        return false;
    const float *at = depth + (size_t)y * width + x;
    const ptrdiff_t ways[] = {1, width, width + 1, (ptrdiff_t)width - 1};
    for (int i = 0; i < 4; i++) {
        double middle = 1 / (double)at[0];
        double bend = 1 / (double)at[ways[i]] + 1 / (double)at[-ways[i]] - 2 * middle;
        if (!(fabs(bend) < 1e-3 * middle))
            return false;
    }
    return true;
}

/* Of the pixels above the bar, those more than twice as bright as anything the reference has within a pixel
 * (a dim spot of a few photons may be off by half). `depth` as in the channel. */
static size_t fireflies(const struct measure_image *image, const struct measure_image *reference,
                        const float *depth, size_t *above)
{
    uint8_t *map = malloc((size_t)image->width * image->height);
    assert_non_null(map);
    /* where the median is next to nothing, a thousandth of the brightest pixel is no firefly */
    *above = measure_fireflies(image, reference, MEASURE_FIREFLY_FACTOR, 1e-3 * brightest(reference), map);
    size_t count = 0;
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            double near = 0;
            for (uint32_t v = y ? y - 1 : 0; v <= y + 1 && v < image->height; v++)
                for (uint32_t u = x ? x - 1 : 0; u <= x + 1 && u < image->width; u++)
                    near = fmax(near, measure_luminance(reference, (size_t)v * image->width + u));
            size_t pixel = (size_t)y * image->width + x;
            count += map[pixel] && measure_luminance(image, pixel) > 2 * near &&
                     is_plane(depth, image->width, image->height, x, y);
        }
    free(map);
    return count;
}

/* With every one of the settings. */
static void check(const char *scene, uint32_t width, uint32_t height, double photons,
                  const char *const settings[], uint32_t count)
{
    struct reference reference = reference_make(scene, width, height, photons, "energy");
    struct measure_image truth = {reference.values, width, height, 3};
    print_message("%s: reference of %.1f M photons, noise %.2f %%\n", scene, 1e-6 * reference.photons,
                  100 * reference.noise);
    struct truth stage;
    stage_open(&stage, scene, width, height, NULL);
    for (uint32_t i = 0; i < count; i++) {
        truth_set(&stage, settings[i]);
        view_reset(stage.view);
        const struct frame_result *result =
            truth_render(&stage, 5, 1u << CHANNEL_CAUSTICS | 1u << CHANNEL_DEPTH);
        struct measure_image image = {truth_channel(result, CHANNEL_CAUSTICS), width, height, 3};
        const float *depth = truth_channel(result, CHANNEL_DEPTH);
        size_t above, found = fireflies(&image, &truth, depth, &above), unused;
        print_message("%-10s %ux%u, %s: %zu pixels above the bar, %zu fireflies\n", scene, width, height,
                      settings[i], above, found);
        /* one photon of twice the brightest pixel, on the floor in front, would be found */
        float *spoilt = malloc((size_t)width * height * 3 * sizeof *spoilt);
        assert_non_null(spoilt);
        memcpy(spoilt, image.values, (size_t)width * height * 3 * sizeof *spoilt);
        for (int k = 0; k < 3; k++)
            spoilt[3 * ((height - 3) * width + 2) + (uint32_t)k] = (float)(2 * brightest(&truth));
        const struct measure_image with_one = {spoilt, width, height, 3};
        size_t with_one_found = fireflies(&with_one, &truth, depth, &unused);
        free(spoilt);
        assert_int_equal(with_one_found, found + 1);
        if (strcmp(settings[i], "aa=none"))
            assert_int_equal(found, 0);
        else /* splats that fall on single points do leave some */
            assert_true(found >= 10);
    }
    truth_close(&stage);
    reference_free(&reference);
}

static void glass_ball(void **state)
{
    (void)state;
    static const char *const settings[] = {"aa=filter photons=16384", "aa=coverage photons=16384"};
    check("sphere", 80, 45, 5e5, settings, 2);
}

/* Light that many facets scatter over a dark floor. With an eighth of the photons of the default settings
 * some have a dim spot of it alone: ten pixels of a five-hundredth of the brightest one. */
static void many_facets(void **state)
{
    (void)state;
    static const char *const settings[] = {"aa=filter", "aa=coverage", "aa=none"};
    check("square", 64, 36, 1e6, settings, 3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(glass_ball), cmocka_unit_test(many_facets)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
