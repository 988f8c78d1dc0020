/* Image measures against sums done by hand. */
#include <stdbool.h>

#include "core/measure/image_measure.h"
#include "tests/support/check.h"

static void differences(void **state)
{
    (void)state;
    const float a[] = {1, 2, 3, 4, 5, 6}, b[] = {1, 4, 3, 2, 5, 9};
    struct measure_image image = {a, 1, 2, 3}, reference = {b, 1, 2, 3};
    assert_close(measure_relative_l1(&image, &reference), 7.0 / 24, 1e-15);
    assert_close(measure_rmse(&image, &reference), sqrt(17.0 / 6), 1e-15);
    assert_close(measure_relative_rmse(&image, &reference), sqrt(17.0 / 136), 1e-15);
    assert_close(measure_relative_l1(&image, &image), 0, 0);
    assert_close(measure_relative_rmse(&image, &image), 0, 0);
}

static void black_reference(void **state)
{
    (void)state;
    const float black[] = {0, 0}, light[] = {0, 1};
    struct measure_image none = {black, 2, 1, 1}, some = {light, 2, 1, 1};
    assert_close(measure_relative_l1(&none, &none), 0, 0);
    assert_true(isinf(measure_relative_l1(&some, &none)));
    assert_close(measure_relative_l1(&none, &some), 1, 0);
    assert_true(isinf(measure_relative_rmse(&some, &none)));
}

static void relative_squares(void **state)
{
    (void)state;
    const float a[] = {1, 0, 3}, b[] = {0, 2, 1};
    struct measure_image image = {a, 3, 1, 1}, reference = {b, 3, 1, 1};
    assert_close(measure_relmse(&image, &reference, 0.5), (1 / 0.5 + 4 / 4.5 + 4 / 1.5) / 3, 1e-15);
    assert_close(measure_relmse(&reference, &reference, 0.5), 0, 0);
}

static void flux(void **state)
{
    (void)state;
    const float a[] = {1, 2, 3, 5}, b[] = {4, 1, 2, 3}, none[] = {0, 0, 0, 0}, minus[] = {0, -1, 0, 0};
    struct measure_image more = {a, 2, 2, 1}, less = {b, 2, 2, 1}, black = {none, 2, 2, 1};
    struct measure_image negative = {minus, 2, 2, 1};
    assert_close(measure_flux(&more, &less), 0.1, 1e-15);
    assert_close(measure_flux(&less, &more), -1.0 / 11, 1e-15);
    assert_close(measure_flux(&black, &less), -1, 0);
    assert_close(measure_flux(&black, &black), 0, 0);
    assert_true(measure_flux(&more, &black) == (double)INFINITY);
    assert_true(measure_flux(&negative, &black) == -(double)INFINITY);
}

static int compare_values(const void *left, const void *right)
{
    double a = *(const double *)left, b = *(const double *)right;
    return (a > b) - (a < b);
}

/* Against sorted windows, on a slope with noise where many pixels are near the bar. */
static void fireflies(void **state)
{
    (void)state;
    enum { WIDTH = 19, HEIGHT = 11, COUNT = WIDTH * HEIGHT };
    float values[3 * COUNT], truth[3 * COUNT];
    uint8_t map[COUNT];
    uint32_t random = 1;
    for (int i = 0; i < 3 * COUNT; i++) {
        random = random * 1664525u + 1013904223u;
        truth[i] = (float)(1 + (uint32_t)i % 50 + (random >> 16) % 32);
        values[i] = truth[i] * (float)((random >> 8) % 9);
    }
    struct measure_image image = {values, WIDTH, HEIGHT, 3}, reference = {truth, WIDTH, HEIGHT, 3};
    size_t expected = 0, count = measure_fireflies(&image, &reference, 4, 0, map);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            double window[49];
            for (int k = 0; k < 49; k++) {
                int row = y + k / 7 - 3, column = x + k % 7 - 3;
                row = row < 0 ? 0 : row >= HEIGHT ? HEIGHT - 1 : row;
                column = column < 0 ? 0 : column >= WIDTH ? WIDTH - 1 : column;
                window[k] = measure_luminance(&reference, (size_t)row * WIDTH + (size_t)column);
            }
            qsort(window, 49, sizeof *window, compare_values);
            bool is_firefly = measure_luminance(&image, (size_t)y * WIDTH + (size_t)x) > 4 * window[24];
            assert_int_equal(map[y * WIDTH + x], is_firefly);
            expected += is_firefly;
        }
    assert_int_equal(count, expected);
    assert_in_range(count, 20, COUNT / 2);

    /* One bright pixel in the dark: light without a floor, nothing below it. */
    for (int i = 0; i < 3 * COUNT; i++)
        values[i] = truth[i] = 0;
    values[300] = values[301] = values[302] = 0.5f;
    assert_int_equal(measure_fireflies(&image, &reference, 4, 0, map), 1);
    assert_int_equal(map[100], 1);
    assert_int_equal(measure_fireflies(&image, &reference, 4, 0.5, NULL), 0);
    assert_int_equal(measure_fireflies(&reference, &reference, 4, 0, NULL), 0);
}

static void sums(void **state)
{
    (void)state;
    const float values[] = {1, 10, 2, 20, 3, 30};
    const double areas[] = {0.5, 0.25, 2};
    struct measure_image image = {values, 3, 1, 2};
    assert_close(measure_sum(&image, 0, NULL), 6, 0);
    assert_close(measure_sum(&image, 1, areas), 5 + 5 + 60, 0);
}

static void non_finite(void **state)
{
    (void)state;
    const float values[] = {1, NAN, INFINITY, 0, -INFINITY};
    struct measure_image image = {values, 5, 1, 1};
    assert_int_equal(measure_non_finite(&image), 3);
    const float two[] = {1, NAN, INFINITY, NAN, 0, 0};
    struct measure_image pixels = {two, 3, 1, 2};
    assert_int_equal(measure_non_finite_pixels(&pixels), 2);
    assert_true(isnan(measure_rmse(&image, &image)));
}

static void box(void **state)
{
    (void)state;
    /* One bright pixel in the corner of 4x3: 1/4 at the corner, 1/6 beside it, 1/9 across. */
    float values[4 * 3 * 2] = {0}, filtered[4 * 3 * 2];
    values[0] = 36;
    values[1] = -36;
    struct measure_image image = {values, 4, 3, 2};
    measure_box3(&image, filtered);
    const float expected[4 * 3] = {9, 6, 0, 0, 6, 4, 0, 0, 0, 0, 0, 0};
    for (int i = 0; i < 4 * 3; i++) {
        assert_close(filtered[2 * i], expected[i], 1e-6);
        assert_close(filtered[2 * i + 1], -expected[i], 1e-6);
    }

    float single = 3, same;
    struct measure_image pixel = {&single, 1, 1, 1};
    measure_box3(&pixel, &same);
    assert_close(same, 3, 0);
}

static void percentiles(void **state)
{
    (void)state;
    double values[] = {5, 1, 4, 2, 3};
    assert_close(measure_percentile(values, 5, 0), 1, 0);
    assert_close(measure_percentile(values, 5, 50), 3, 0);
    assert_close(measure_percentile(values, 5, 90), 4.6, 1e-12);
    assert_close(measure_percentile(values, 5, 100), 5, 0);
    assert_close(measure_percentile(values, 1, 99), 1, 0);
    assert_close(measure_percentile(values, 0, 50), 0, 0);
}

static void ranks(void **state)
{
    (void)state;
    enum { COUNT = 3000 };
    float values[COUNT], order[COUNT];
    uint32_t random = 1, lit = 0;
    for (int i = 0; i < COUNT; i++) {
        random = random * 1664525u + 1013904223u;
        float value = ldexpf((float)(random >> 20), (int)(random >> 8 & 63) - 40); /* many equal, some 0 */
        values[i] = i % 7 ? value : -value;
        if (values[i] > 0)
            order[lit++] = values[i];
    }
    for (uint32_t i = 1; i < lit; i++) /* insertion sort */
        for (uint32_t j = i; j && order[j - 1] > order[j]; j--) {
            float swapped = order[j];
            order[j] = order[j - 1];
            order[j - 1] = swapped;
        }
    for (uint32_t rank = 0; rank < lit; rank += 97)
        assert_close(measure_rank_above_zero(values, COUNT, rank), order[rank], 0);
    assert_close(measure_rank_above_zero(values, COUNT, lit - 1), order[lit - 1], 0);
    assert_close(measure_rank_above_zero(values, COUNT, lit), 0, 0);
    assert_close(measure_rank_above_zero(values, 0, 0), 0, 0);
    const float ends[] = {3.4e38f, 1e-45f};
    assert_close(measure_rank_above_zero(ends, 2, 0), ends[1], 0);
    assert_close(measure_rank_above_zero(ends, 2, 1), ends[0], 0);
    assert_close(measure_rank_above_zero(ends, 2, 2), 0, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(differences),      cmocka_unit_test(black_reference),
        cmocka_unit_test(relative_squares), cmocka_unit_test(flux),
        cmocka_unit_test(fireflies),        cmocka_unit_test(sums),
        cmocka_unit_test(non_finite),       cmocka_unit_test(box),
        cmocka_unit_test(percentiles),      cmocka_unit_test(ranks),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
