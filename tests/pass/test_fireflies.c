/* With the pixel filter a splat is never brighter than its light spread over a pixel, so that no photon alone
 * makes a pixel that stands out: pixels above 4 times the median of the reference's 7x7 around them,
 * luminance. A bright focus is above it in the reference itself: only what is brighter than the reference
 * nearby counts.
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

/* Of the pixels above the bar, those more than half again as bright as anything the reference has within a
 * pixel. */
static size_t fireflies(const struct measure_image *image, const struct measure_image *reference,
                        size_t *above)
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
            count += map[pixel] && measure_luminance(image, pixel) > 1.5 * near;
        }
    free(map);
    return count;
}

static void check(const char *scene, uint32_t width, uint32_t height, double photons, const char *settings)
{
    struct reference reference = reference_make(scene, width, height, photons, "energy");
    struct truth stage;
    stage_open(&stage, scene, width, height, settings);
    const struct frame_result *result = truth_render(&stage, 5, 1u << CHANNEL_CAUSTICS);
    struct measure_image image = {truth_channel(result, CHANNEL_CAUSTICS), width, height, 3},
                         truth = {reference.values, width, height, 3};
    size_t above, count = fireflies(&image, &truth, &above), unused;
    print_message("%-10s %ux%u: %zu pixels above the bar, %zu fireflies\n", scene, width, height, above,
                  count);
    /* one photon of twice the brightest pixel in a corner would be found */
    float *spoilt = malloc((size_t)width * height * 3 * sizeof *spoilt);
    assert_non_null(spoilt);
    memcpy(spoilt, image.values, (size_t)width * height * 3 * sizeof *spoilt);
    for (int k = 0; k < 3; k++)
        spoilt[k] = (float)(2 * brightest(&truth));
    const struct measure_image with_one = {spoilt, width, height, 3};
    size_t found = fireflies(&with_one, &truth, &unused);
    free(spoilt);
    truth_close(&stage);
    reference_free(&reference);
    assert_int_equal(found, count + 1);
    assert_int_equal(count, 0);
}

static void filter_has_none(void **state)
{
    (void)state;
    check("sphere", 80, 45, 5e5, "aa=filter photons=16384");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(filter_has_none)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
