/* SSIM against closed forms and against its definition, window by window. */
#include <string.h>

#include "core/measure/ssim.h"
#include "tests/support/check.h"

enum { WIDTH = 23, HEIGHT = 17, COUNT = WIDTH * HEIGHT };

static uint32_t random_state;

static double random_unit(void)
{
    random_state = random_state * 1664525u + 1013904223u;
    return random_state / 4294967296.0;
}

static double compare(const float *image, const float *reference, double range, float *map)
{
    struct measure_image a = {image, WIDTH, HEIGHT, 1}, b = {reference, WIDTH, HEIGHT, 1};
    struct ssim_result result;
    struct error error;
    if (!ssim_compare(&a, &b, &(struct ssim_params){.dynamic_range = range}, map, &result, &error))
        fail_msg("%s", error.message);
    return result.mean;
}

/* One window, its variances from the differences to the mean. */
static double slow_index(const float *image, const float *reference, int column, int row, double range)
{
    double weights[121], total = 0, mean[2] = {0}, variance[2] = {0}, covariance = 0;
    for (int k = 0; k < 121; k++) {
        double x = k % 11 - 5, y = k / 11 - 5;
        weights[k] = exp(-(x * x + y * y) / (2 * 1.5 * 1.5));
        total += weights[k];
    }
    for (int pass = 0; pass < 2; pass++)
        for (int k = 0; k < 121; k++) {
            int at = (row + k / 11 - 5) * WIDTH + column + k % 11 - 5;
            double w = weights[k] / total, a = (double)image[at], b = (double)reference[at];
            if (!pass) {
                mean[0] += w * a;
                mean[1] += w * b;
            } else {
                variance[0] += w * (a - mean[0]) * (a - mean[0]);
                variance[1] += w * (b - mean[1]) * (b - mean[1]);
                covariance += w * (a - mean[0]) * (b - mean[1]);
            }
        }
    double c1 = pow(0.01 * range, 2), c2 = pow(0.03 * range, 2);
    return (2 * mean[0] * mean[1] + c1) * (2 * covariance + c2) /
           ((mean[0] * mean[0] + mean[1] * mean[1] + c1) * (variance[0] + variance[1] + c2));
}

static void test_against_the_definition(void **state)
{
    (void)state;
    float image[COUNT], reference[COUNT], map[COUNT];
    static const double scales[] = {1, 1e-6, 3e5};
    for (int k = 0; k < 3; k++) {
        random_state = 5;
        for (int i = 0; i < COUNT; i++) {
            reference[i] = (float)(scales[k] * (0.5 + 0.5 * sin(0.3 * (i % WIDTH) + 0.2 * (i / WIDTH))));
            image[i] = (float)((double)reference[i] + scales[k] * 0.4 * (random_unit() - 0.5));
        }
        image[7 * WIDTH + 9] = (float)(scales[k] * 900); /* a firefly */
        double mean = 0, got = compare(image, reference, scales[k], map);
        for (int y = 0; y < HEIGHT; y++)
            for (int x = 0; x < WIDTH; x++) {
                bool is_inside = x >= 5 && y >= 5 && x < WIDTH - 5 && y < HEIGHT - 5;
                double expected = is_inside ? slow_index(image, reference, x, y, scales[k]) : 1;
                assert_close(map[y * WIDTH + x], expected, 1e-6);
                mean += is_inside ? expected / ((WIDTH - 10) * (HEIGHT - 10)) : 0;
            }
        assert_close(got, mean, 1e-9);
    }
}

static void test_closed_forms(void **state)
{
    (void)state;
    float flat[COUNT], other[COUNT], board[COUNT], inverse[COUNT];
    for (int i = 0; i < COUNT; i++) {
        flat[i] = 0.25f;
        other[i] = 0.75f;
        board[i] = (float)((i % WIDTH + i / WIDTH) % 2);
        inverse[i] = 1 - board[i];
    }
    assert_close(compare(board, board, 1, NULL), 1, 0);
    /* Without structure only the means are left. */
    double c1 = 0.01 * 0.01;
    assert_close(compare(flat, other, 1, NULL), (2 * 0.25 * 0.75 + c1) / (0.0625 + 0.5625 + c1), 1e-12);
    /* The other way round: covariance is minus the variance, which is 1/4 less what the window's own rounding
     * of the means takes. */
    assert_close(compare(inverse, board, 1, NULL), (9e-4 - 0.5) / (9e-4 + 0.5), 1e-4);

    /* The range is the reference's: 1 for the board, whatever the image holds and with a cusp in it. */
    struct measure_image a = {flat, WIDTH, HEIGHT, 1}, b = {board, WIDTH, HEIGHT, 1},
                         c = {other, WIDTH, HEIGHT, 1};
    struct ssim_result result;
    struct error error;
    assert_true(ssim_compare(&a, &b, &(struct ssim_params){0}, NULL, &result, &error));
    assert_close(result.dynamic_range, 1, 0);
    assert_true(ssim_compare(&a, &c, &(struct ssim_params){0}, NULL, &result, &error));
    assert_close(result.dynamic_range, 0.75, 0);
    board[17] = 1000;
    assert_true(ssim_compare(&a, &b, &(struct ssim_params){0}, NULL, &result, &error));
    assert_close(result.dynamic_range, 1, 0);
    memset(flat, 0, sizeof flat);
    assert_true(ssim_compare(&a, &a, &(struct ssim_params){0}, NULL, &result, &error));
    assert_close(result.dynamic_range, 1, 0);
    assert_close(result.mean, 1, 0);
}

/* Colour by its luminance, and a mean over the mask only. */
static void test_color_and_mask(void **state)
{
    (void)state;
    float image[3 * COUNT], reference[3 * COUNT], one[COUNT], other[COUNT], map[COUNT];
    uint8_t mask[COUNT] = {0};
    random_state = 9;
    for (int i = 0; i < COUNT; i++) {
        for (int c = 0; c < 3; c++) {
            image[3 * i + c] = (float)random_unit();
            reference[3 * i + c] = 0.5f * image[3 * i + c] + 0.5f * (float)random_unit();
        }
        const float *a = image + 3 * i, *b = reference + 3 * i;
        one[i] = 0.2126f * a[0] + 0.7152f * a[1] + 0.0722f * a[2];
        other[i] = 0.2126f * b[0] + 0.7152f * b[1] + 0.0722f * b[2];
    }
    struct measure_image a = {image, WIDTH, HEIGHT, 3}, b = {reference, WIDTH, HEIGHT, 3};
    struct ssim_params params = {.dynamic_range = 1, .mask = mask};
    struct ssim_result result;
    struct error error;
    mask[6 * WIDTH + 6] = mask[8 * WIDTH + 11] = mask[0] = 1; /* the corner has no window */
    assert_true(ssim_compare(&a, &b, &params, map, &result, &error));
    assert_close(result.mean, ((double)map[6 * WIDTH + 6] + (double)map[8 * WIDTH + 11]) / 2, 1e-7);
    params.mask = NULL;
    assert_true(ssim_compare(&a, &b, &params, NULL, &result, &error));
    assert_close(result.mean, compare(one, other, 1, NULL), 1e-6);
    memset(mask, 0, sizeof mask);
    mask[3] = 1;
    params.mask = mask;
    assert_false(ssim_compare(&a, &b, &params, NULL, &result, &error));
}

static void test_refusals(void **state)
{
    (void)state;
    float values[COUNT] = {0};
    struct measure_image a = {values, WIDTH, HEIGHT, 1}, b = {values, HEIGHT, WIDTH, 1},
                         small = {values, 10, 30, 1};
    struct ssim_result result;
    struct error error;
    assert_false(ssim_compare(&a, &b, &(struct ssim_params){0}, NULL, &result, &error));
    assert_string_equal(error.message, "SSIM of 23x17 pixels of 1 against 17x23 of 1");
    assert_false(ssim_compare(&small, &small, &(struct ssim_params){0}, NULL, &result, &error));
    assert_string_equal(error.message, "SSIM needs 11x11 pixels at least; these have 10x30");
    values[3] = NAN;
    assert_false(ssim_compare(&a, &a, &(struct ssim_params){0}, NULL, &result, &error));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_against_the_definition),
        cmocka_unit_test(test_closed_forms),
        cmocka_unit_test(test_color_and_mask),
        cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
