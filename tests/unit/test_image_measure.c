/* Image measures against sums done by hand. */
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(differences), cmocka_unit_test(black_reference),
        cmocka_unit_test(sums),        cmocka_unit_test(non_finite),
        cmocka_unit_test(box),         cmocka_unit_test(percentiles),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
