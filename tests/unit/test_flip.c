/* FLIP against closed forms and against the paper's formulas done the slow way: in double, every kernel whole
 * in two dimensions, step by step. */
#include <string.h>

#include "core/measure/flip.h"
#include "tests/support/check.h"

#define PPD (3840 * M_PI / 180)

static struct measure_image image_of(const float *values, uint32_t width, uint32_t height)
{
    return (struct measure_image){values, width, height, 3};
}

static double compare(const struct measure_image *image, const struct measure_image *reference,
                      const struct flip_params *params, float *map)
{
    struct error error;
    struct flip_result result;
    if (!flip_compare(image, reference, params, map, &result, &error))
        fail_msg("%s", error.message);
    return result.mean;
}

/* ---- the slow way ---------------------------------------------------------------------------------------
 */

struct plane {
    double *v;
    int width, height;
};

static struct plane plane_create(int width, int height)
{
    struct plane plane = {calloc((size_t)width * (size_t)height, sizeof(double)), width, height};
    assert_non_null(plane.v);
    return plane;
}

/* Correlates with a whole (2 radius + 1)^2 kernel; the border repeats. */
static struct plane correlate(struct plane from, const double *kernel, int radius)
{
    struct plane to = plane_create(from.width, from.height);
    int side = 2 * radius + 1;
    for (int y = 0; y < from.height; y++)
        for (int x = 0; x < from.width; x++) {
            double sum = 0;
            for (int j = -radius; j <= radius; j++)
                for (int i = -radius; i <= radius; i++) {
                    int row = y + j < 0 ? 0 : y + j >= from.height ? from.height - 1 : y + j;
                    int column = x + i < 0 ? 0 : x + i >= from.width ? from.width - 1 : x + i;
                    sum += kernel[(j + radius) * side + i + radius] * from.v[row * from.width + column];
                }
            to.v[y * from.width + x] = sum;
        }
    return to;
}

static double *contrast_kernel(int channel, double ppd, int *radius)
{
    static const double a1[3] = {1, 1, 34.1}, b1[3] = {0.0047, 0.0053, 0.04};
    static const double a2[3] = {0, 0, 13.5}, b2[3] = {1e-5, 1e-5, 0.025};
    *radius = (int)ceil(3 * sqrt(0.04 / (2 * M_PI * M_PI)) * ppd);
    int side = 2 * *radius + 1;
    double *kernel = calloc((size_t)(side * side), sizeof *kernel), sum = 0;
    assert_non_null(kernel);
    for (int k = 0; k < side * side; k++) {
        double x = (k % side - *radius) / ppd, y = (k / side - *radius) / ppd, d = x * x + y * y;
        kernel[k] = a1[channel] * sqrt(M_PI / b1[channel]) * exp(-M_PI * M_PI * d / b1[channel]) +
                    a2[channel] * sqrt(M_PI / b2[channel]) * exp(-M_PI * M_PI * d / b2[channel]);
        sum += kernel[k];
    }
    for (int k = 0; k < side * side; k++)
        kernel[k] /= sum;
    return kernel;
}

static double *feature_kernel(bool is_point, bool is_down, double ppd, int *radius)
{
    double sigma = 0.5 * 0.082 * ppd, above = 0, below = 0;
    *radius = (int)ceil(3 * sigma);
    int side = 2 * *radius + 1;
    double *kernel = calloc((size_t)(side * side), sizeof *kernel);
    assert_non_null(kernel);
    for (int k = 0; k < side * side; k++) {
        double x = k % side - *radius, y = k / side - *radius, along = is_down ? y : x;
        double gaussian = exp(-(x * x + y * y) / (2 * sigma * sigma));
        kernel[k] = (is_point ? along * along / (sigma * sigma) - 1 : -along) * gaussian;
        *(kernel[k] > 0 ? &above : &below) += fabs(kernel[k]);
    }
    for (int k = 0; k < side * side; k++)
        kernel[k] /= kernel[k] > 0 ? above : below;
    return kernel;
}

static const double to_xyz[3][3] = {
    {10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794},
    {2613072.0 / 12288897, 8788810.0 / 12288897, 887015.0 / 12288897},
    {1425312.0 / 73733382, 8788810.0 / 73733382, 70074185.0 / 73733382},
};
static const double to_rgb[3][3] = {
    {3.241003275, -1.537398934, -0.498615861},
    {-0.969224334, 1.875930071, 0.041554224},
    {0.055639423, -0.204011202, 1.057148933},
};
static const double white[3] = {0.950428545, 1, 1.088900371};

static void multiply(const double m[3][3], const double from[3], double to[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[i][0] * from[0] + m[i][1] * from[1] + m[i][2] * from[2];
}

static void to_ycxcz(const double rgb[3], double ycxcz[3])
{
    double xyz[3];
    multiply(to_xyz, rgb, xyz);
    for (int i = 0; i < 3; i++)
        xyz[i] /= white[i];
    ycxcz[0] = 116 * xyz[1] - 16;
    ycxcz[1] = 500 * (xyz[0] - xyz[1]);
    ycxcz[2] = 200 * (xyz[1] - xyz[2]);
}

static void to_hunt_lab(const double rgb[3], double lab[3])
{
    double xyz[3], f[3], delta = 6.0 / 29;
    multiply(to_xyz, rgb, xyz);
    for (int i = 0; i < 3; i++) {
        double t = xyz[i] / white[i];
        f[i] = t > delta * delta * delta ? cbrt(t) : t / (3 * delta * delta) + 4.0 / 29;
    }
    lab[0] = 116 * f[1] - 16;
    lab[1] = 0.01 * lab[0] * 500 * (f[0] - f[1]);
    lab[2] = 0.01 * lab[0] * 200 * (f[1] - f[2]);
}

static double hyab(const double a[3], const double b[3])
{
    return fabs(a[0] - b[0]) + hypot(a[1] - b[1], a[2] - b[2]);
}

/* LDR-FLIP of linear pictures in 0..1. */
static void slow_flip(const double *image, const double *reference, int width, int height, double ppd,
                      double *map)
{
    const double *pictures[2] = {image, reference};
    struct plane color[2][3], feature[2][2][2];
    for (int p = 0; p < 2; p++) {
        struct plane channels[3], luminance = plane_create(width, height);
        for (int c = 0; c < 3; c++)
            channels[c] = plane_create(width, height);
        for (int i = 0; i < width * height; i++) {
            double ycxcz[3];
            to_ycxcz(pictures[p] + 3 * i, ycxcz);
            for (int c = 0; c < 3; c++)
                channels[c].v[i] = ycxcz[c];
            luminance.v[i] = (ycxcz[0] + 16) / 116;
        }
        int radius;
        for (int c = 0; c < 3; c++) {
            double *kernel = contrast_kernel(c, ppd, &radius);
            color[p][c] = correlate(channels[c], kernel, radius);
            free(kernel);
            free(channels[c].v);
        }
        for (int k = 0; k < 4; k++) {
            double *kernel = feature_kernel(k / 2, k % 2, ppd, &radius);
            feature[p][k / 2][k % 2] = correlate(luminance, kernel, radius);
            free(kernel);
        }
        free(luminance.v);
    }
    double green[3], blue[3];
    to_hunt_lab((const double[3]){0, 1, 0}, green);
    to_hunt_lab((const double[3]){0, 0, 1}, blue);
    double largest = pow(hyab(green, blue), 0.7);
    for (int i = 0; i < width * height; i++) {
        double lab[2][3], size[2][2];
        for (int p = 0; p < 2; p++) {
            double y = (color[p][0].v[i] + 16) / 116, rgb[3];
            double xyz[3] = {(y + color[p][1].v[i] / 500) * white[0], y,
                             (y - color[p][2].v[i] / 200) * white[2]};
            multiply(to_rgb, xyz, rgb);
            for (int c = 0; c < 3; c++)
                rgb[c] = fmin(fmax(rgb[c], 0), 1);
            to_hunt_lab(rgb, lab[p]);
            for (int k = 0; k < 2; k++)
                size[p][k] = hypot(feature[p][k][0].v[i], feature[p][k][1].v[i]);
        }
        double distance = pow(hyab(lab[0], lab[1]), 0.7), knee = 0.4 * largest;
        double difference =
            distance < knee ? 0.95 / knee * distance : 0.95 + (distance - knee) / (largest - knee) * 0.05;
        double features = fmax(fabs(size[0][0] - size[1][0]), fabs(size[0][1] - size[1][1]));
        map[i] = pow(difference, 1 - sqrt(features / sqrt(2)));
    }
    for (int p = 0; p < 2; p++) {
        for (int c = 0; c < 3; c++)
            free(color[p][c].v);
        for (int k = 0; k < 4; k++)
            free(feature[p][k / 2][k % 2].v);
    }
}

/* ---- pictures -------------------------------------------------------------------------------------------
 */

static uint32_t random_state;

static double random_unit(void)
{
    random_state = random_state * 747796405u + 2891336453u;
    uint32_t word = ((random_state >> ((random_state >> 28) + 4)) ^ random_state) * 277803737u;
    return (double)((word >> 22) ^ word) / 4294967296.0;
}

/* Smooth colours with edges, a bright line and points; the image is the reference disturbed. */
static void make_pictures(int width, int height, double scale, float *image, float *reference)
{
    random_state = 3;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            for (int c = 0; c < 3; c++) {
                double value = 0.3 + 0.25 * sin(0.4 * x + c) * cos(0.3 * y - c);
                value *= x > y + 4 ? 1 : 0.2;
                value = x == 9 ? 1.6 : value;
                double noise = random_unit() < 0.1 ? 3 * random_unit() : 1 + 0.1 * (random_unit() - 0.5);
                int at = 3 * (y * width + x) + c;
                reference[at] = (float)(scale * value);
                image[at] = (float)(scale * value * noise);
            }
}

/* ---- tests ----------------------------------------------------------------------------------------------
 */

static void test_closed_forms(void **state)
{
    (void)state;
    enum { WIDTH = 5, HEIGHT = 4, COUNT = WIDTH * HEIGHT };
    float black[3 * COUNT] = {0}, light[3 * COUNT], map[COUNT];
    for (int i = 0; i < 3 * COUNT; i++)
        light[i] = 1;
    struct measure_image a = image_of(black, WIDTH, HEIGHT), b = image_of(light, WIDTH, HEIGHT);
    const struct flip_params params = {0};
    assert_close(compare(&a, &a, &params, map), 0, 0);
    assert_close(compare(&b, &b, &params, map), 0, 0);

    /* Black against white is a lightness difference of 100; green against blue, the largest there is, from
     * CIELAB as tables give them: (87.735, -86.183, 83.180) and (32.297, 79.188, -107.860). */
    double red = 0.87735 * -86.183 - 0.32297 * 79.188, yellow = 0.87735 * 83.180 + 0.32297 * 107.860;
    double largest = pow(87.735 - 32.297 + hypot(red, yellow), 0.7), knee = 0.4 * largest;
    double expected = 0.95 + 0.05 * (pow(100, 0.7) - knee) / (largest - knee);
    assert_close(expected, 0.97, 0.005);
    assert_close(compare(&a, &b, &params, map), expected, 1e-5);
    assert_close(compare(&b, &a, &params, map), expected, 1e-5);
    for (int i = 0; i < COUNT; i++)
        assert_close(map[i], expected, 1e-5);

    /* Beyond white is white. */
    for (int i = 0; i < 3 * COUNT; i++)
        black[i] = 7;
    assert_close(compare(&a, &b, &params, NULL), 0, 0);

    /* Green against blue is 1. */
    for (int i = 0; i < 3 * COUNT; i++) {
        black[i] = i % 3 == 1;
        light[i] = i % 3 == 2;
    }
    assert_close(compare(&a, &b, &params, map), 1, 1e-6);

    /* Grey is three times the same component. */
    float grey[3 * COUNT], one[COUNT], other[COUNT];
    for (int i = 0; i < COUNT; i++) {
        one[i] = (float)i / COUNT;
        other[i] = 0.3f;
        for (int c = 0; c < 3; c++) {
            grey[3 * i + c] = one[i];
            light[3 * i + c] = other[i];
        }
    }
    struct measure_image single = {one, WIDTH, HEIGHT, 1}, flat = {other, WIDTH, HEIGHT, 1};
    struct measure_image triple = image_of(grey, WIDTH, HEIGHT);
    assert_close(compare(&single, &flat, &params, NULL), compare(&triple, &b, &params, NULL), 0);
}

/* Sizes below and above the filters', wide, tall and one pixel, at three distances. */
static void test_against_the_slow_way(void **state)
{
    (void)state;
    static const struct {
        int width, height;
        double ppd;
    } cases[] = {{40, 29, PPD}, {7, 31, PPD}, {1, 1, PPD},   {33, 2, 25},
                 {23, 19, 110}, {12, 12, 5},  {1033, 3, PPD}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        int width = cases[k].width, height = cases[k].height, count = width * height;
        enum { MOST = 1033 * 3 }; /* three strips */
        static float image[3 * MOST], reference[3 * MOST], map[MOST];
        static double a[3 * MOST], b[3 * MOST], expected[MOST];
        double mean = 0;
        make_pictures(width, height, 1, image, reference);
        for (int i = 0; i < 3 * count; i++) {
            a[i] = fmin((double)image[i], 1);
            b[i] = fmin((double)reference[i], 1);
        }
        struct measure_image test = image_of(image, (uint32_t)width, (uint32_t)height);
        struct measure_image truth = image_of(reference, (uint32_t)width, (uint32_t)height);
        const struct flip_params params = {.pixels_per_degree = cases[k].ppd};
        slow_flip(a, b, width, height, cases[k].ppd, expected);
        double got = compare(&test, &truth, &params, map);
        for (int i = 0; i < count; i++) {
            /* A float's rounding of a difference is raised to 0.7 where the pictures agree. */
            assert_close(map[i], expected[i], 2e-4);
            mean += expected[i] / count;
        }
        /* Floats; and in flat pictures, taps that should cancel leave 1e-8, whose root it is that counts. */
        assert_close(got, mean, count == 1 ? 5e-5 : 5e-6);
        assert_true(count == 1 || mean > 0.02);
    }
}

static double aces(double x)
{
    x = 0.6 * fmax(x, 0);
    return fmin(fmax(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0), 1);
}

static void test_hdr(void **state)
{
    (void)state;
    enum { WIDTH = 26, HEIGHT = 17, COUNT = WIDTH * HEIGHT };
    static float image[3 * COUNT], reference[3 * COUNT], map[COUNT];
    static double a[3 * COUNT], b[3 * COUNT], once[COUNT], expected[COUNT];
    make_pictures(WIDTH, HEIGHT, 37, image, reference);
    image[5] = -2; /* taken as 0 */
    struct measure_image test = image_of(image, WIDTH, HEIGHT), truth = image_of(reference, WIDTH, HEIGHT);

    struct flip_exposures exposures;
    struct error error;
    assert_true(flip_exposures_of(&truth, &exposures, &error));
    double luminance[COUNT], brightest = 0, curve_low = 0, curve_high = 10;
    for (int i = 0; i < COUNT; i++) {
        luminance[i] = 0.2126 * (double)reference[3 * i] + 0.7152 * (double)reference[3 * i + 1] +
                       0.0722 * (double)reference[3 * i + 2];
        brightest = fmax(brightest, luminance[i]);
    }
    /* The upper median: as many below it as the even count allows. */
    double median = 0;
    for (int i = 0; i < COUNT; i++) {
        int below = 0, same = 0;
        for (int j = 0; j < COUNT; j++) {
            below += luminance[j] < luminance[i];
            same += luminance[j] == luminance[i];
        }
        if (below <= COUNT / 2 && COUNT / 2 < below + same)
            median = luminance[i];
    }
    for (int i = 0; i < 60; i++) {
        double middle = 0.5 * (curve_low + curve_high);
        *(aces(middle) < 0.85 ? &curve_low : &curve_high) = middle;
    }
    assert_close(exposures.start, log2(curve_low / brightest), 1e-5);
    assert_close(exposures.stop, log2(curve_low / median), 1e-5);
    assert_int_equal(exposures.count, (int)fmax(2, ceil(log2(brightest / median))));
    assert_true(exposures.count > 2);

    for (uint32_t e = 0; e < exposures.count; e++) {
        double exposure =
            exposures.start + e * (exposures.stop - exposures.start) / (double)(exposures.count - 1);
        for (int i = 0; i < 3 * COUNT; i++) {
            a[i] = aces(exp2(exposure) * (double)image[i]);
            b[i] = aces(exp2(exposure) * (double)reference[i]);
        }
        slow_flip(a, b, WIDTH, HEIGHT, PPD, once);
        for (int i = 0; i < COUNT; i++)
            expected[i] = fmax(expected[i], once[i]);
    }
    const struct flip_params params = {.is_hdr = true};
    double got = compare(&test, &truth, &params, map), mean = 0;
    for (int i = 0; i < COUNT; i++) {
        assert_close(map[i], expected[i], 2e-4);
        mean += expected[i] / COUNT;
    }
    assert_close(got, mean, 2e-5);

    /* The same light in other units is the same picture. */
    for (int i = 0; i < 3 * COUNT; i++) {
        image[i] *= 0x1p-9f;
        reference[i] *= 0x1p-9f;
    }
    assert_close(compare(&test, &truth, &params, NULL), got, 1e-5);
}

/* A picture that is dark in most places, as caustics alone are, and one that is dark everywhere. */
static void test_dark_references(void **state)
{
    (void)state;
    enum { COUNT = 10 };
    float values[3 * COUNT] = {0}, image[3 * COUNT] = {0};
    struct measure_image truth = image_of(values, 5, 2), test = image_of(image, 5, 2);
    for (int c = 0; c < 3; c++) {
        values[c] = 1; /* luminances 1, 2, 8 and seven of 0: the lit median is 2 */
        values[3 + c] = 2;
        values[6 + c] = 8;
    }
    struct flip_exposures exposures;
    struct error error;
    assert_true(flip_exposures_of(&truth, &exposures, &error));
    assert_close(exposures.stop - exposures.start, 2, 1e-6);
    assert_int_equal(exposures.count, 2);
    const struct flip_params params = {.is_hdr = true};
    assert_true(compare(&test, &truth, &params, NULL) > 0.1);

    memset(values, 0, sizeof values);
    assert_true(flip_exposures_of(&truth, &exposures, &error));
    assert_close(exposures.start, 0, 0);
    assert_close(exposures.stop, 0, 0);
    assert_close(compare(&test, &truth, &params, NULL), 0, 0);
    image[4] = 1;
    assert_true(compare(&test, &truth, &params, NULL) > 0);

    /* Whatever a float can hold is finite after tone mapping. */
    values[0] = 1e-45f;
    values[3] = 3e38f;
    double extreme = compare(&test, &truth, &params, NULL);
    assert_true(extreme > 0 && extreme <= 1);
}

static void test_mask(void **state)
{
    (void)state;
    enum { WIDTH = 20, HEIGHT = 12, COUNT = WIDTH * HEIGHT };
    float image[3 * COUNT], reference[3 * COUNT], map[COUNT];
    uint8_t mask[COUNT] = {0};
    make_pictures(WIDTH, HEIGHT, 1, image, reference);
    struct measure_image test = image_of(image, WIDTH, HEIGHT), truth = image_of(reference, WIDTH, HEIGHT);
    mask[17] = mask[100] = 1;
    struct flip_params params = {.mask = mask};
    struct flip_result result;
    struct error error;
    assert_true(flip_compare(&test, &truth, &params, map, &result, &error));
    assert_close(result.mean, ((double)map[17] + (double)map[100]) / 2, 1e-12);
    assert_close(result.largest, fmax((double)map[17], (double)map[100]), 0);
    mask[17] = mask[100] = 0;
    assert_false(flip_compare(&test, &truth, &params, map, &result, &error));
    assert_string_equal(error.message, "the mask leaves no pixel");
}

static void assert_refused(const struct measure_image *image, const struct measure_image *reference,
                           const struct flip_params *params, const char *said)
{
    struct flip_result result;
    struct error error;
    assert_false(flip_compare(image, reference, params, NULL, &result, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_string_equal(error.message, said);
}

static void test_refusals(void **state)
{
    (void)state;
    float values[18] = {0}, broken[18] = {0};
    broken[4] = NAN;
    broken[5] = INFINITY;
    broken[17] = -INFINITY;
    struct measure_image good = image_of(values, 3, 2), other = image_of(values, 2, 3);
    struct measure_image bad = image_of(broken, 3, 2), empty = image_of(values, 0, 0);
    assert_refused(&good, &other, &(struct flip_params){0}, "FLIP of 3x2 pixels against 2x3");
    assert_refused(&empty, &empty, &(struct flip_params){0}, "FLIP of 0x0 pixels against 0x0");
    assert_refused(&bad, &good, &(struct flip_params){0}, "FLIP of 2 pixels that are not finite");
    assert_refused(&good, &good, &(struct flip_params){.pixels_per_degree = 4},
                   "FLIP at 4 pixels per degree; 5 to 500 can be");
    assert_refused(&good, &good, &(struct flip_params){.pixels_per_degree = NAN},
                   "FLIP at nan pixels per degree; 5 to 500 can be");
    assert_refused(&good, &good, &(struct flip_params){.is_hdr = true, .exposures = {2, 1, 3}},
                   "FLIP at 3 exposures from 2 to 1");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_closed_forms), cmocka_unit_test(test_against_the_slow_way),
        cmocka_unit_test(test_hdr),          cmocka_unit_test(test_dark_references),
        cmocka_unit_test(test_mask),         cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
