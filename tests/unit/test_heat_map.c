/* Heat maps: magma's ends and middle as matplotlib has them, order, and what is no number. */
#include "core/measure/heat_map.h"
#include "tests/support/check.h"

static void test_known_colors(void **state)
{
    (void)state;
    /* Indices 0, 100, 128, 250 and 255 of the table of 256. */
    const float values[] = {0, 100, 128, 250, 255};
    const double expected[5][3] = {{0.001462, 0.000466, 0.013866},
                                   {0.537755, 0.156894, 0.506551},
                                   {0.716387, 0.214982, 0.475290},
                                   {0.988717, 0.955742, 0.712242},
                                   {0.987053, 0.991438, 0.749504}};
    uint8_t rgb[15];
    heat_map_colors(values, 5, 0, 255, rgb);
    for (int i = 0; i < 15; i++)
        assert_close(rgb[i], 255 * expected[i / 3][i % 3], 1.5);
}

static void test_order_and_ends(void **state)
{
    (void)state;
    float values[1001];
    uint8_t rgb[3003];
    for (int i = 0; i <= 1000; i++)
        values[i] = (float)(i * 0.002 - 0.5);
    heat_map_colors(values, 1001, 0, 1, rgb);
    double lightness = 0;
    for (int i = 0; i <= 1000; i++) {
        double now = 0.2126 * rgb[3 * i] + 0.7152 * rgb[3 * i + 1] + 0.0722 * rgb[3 * i + 2];
        assert_true(now >= lightness - 0.8); /* a step of rounding */
        lightness = now;
    }
    assert_int_equal(rgb[0], 0);
    assert_int_equal(rgb[3000], 252);

    const float odd[] = {NAN, -INFINITY, INFINITY, 0, 1};
    heat_map_colors(odd, 5, 0, 0, rgb);
    assert_true(rgb[0] == 0 && rgb[1] == 255 && rgb[2] == 255);
    assert_true(rgb[3] == 0 && rgb[6] == 252 && rgb[9] == 0 && rgb[12] == 252);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_known_colors),
        cmocka_unit_test(test_order_and_ends),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
