#include "image_measure.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

static size_t value_count(const struct measure_image *image)
{
    return (size_t)image->width * image->height * image->components;
}

size_t measure_non_finite(const struct measure_image *image)
{
    size_t count = 0;
    for (size_t i = 0; i < value_count(image); i++)
        count += isfinite(image->values[i]) ? 0 : 1;
    return count;
}

size_t measure_non_finite_pixels(const struct measure_image *image)
{
    size_t count = 0, pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++) {
        bool is_finite = true;
        for (uint32_t c = 0; c < image->components; c++)
            is_finite = is_finite && isfinite(image->values[i * image->components + c]);
        count += is_finite ? 0 : 1;
    }
    return count;
}

static double ratio(double difference, double reference)
{
    if (reference == 0)
        return difference == 0 ? 0 : INFINITY;
    return difference / reference;
}

double measure_relative_l1(const struct measure_image *image, const struct measure_image *reference)
{
    double difference = 0, total = 0;
    for (size_t i = 0; i < value_count(image); i++) {
        difference += fabs((double)image->values[i] - (double)reference->values[i]);
        total += fabs((double)reference->values[i]);
    }
    return ratio(difference, total);
}

static double squared_difference(const struct measure_image *image, const struct measure_image *reference)
{
    double sum = 0;
    for (size_t i = 0; i < value_count(image); i++) {
        double difference = (double)image->values[i] - (double)reference->values[i];
        sum += difference * difference;
    }
    return sum;
}

double measure_rmse(const struct measure_image *image, const struct measure_image *reference)
{
    size_t count = value_count(image);
    return count ? sqrt(squared_difference(image, reference) / (double)count) : 0;
}

double measure_relative_rmse(const struct measure_image *image, const struct measure_image *reference)
{
    double total = 0;
    for (size_t i = 0; i < value_count(reference); i++)
        total += (double)reference->values[i] * (double)reference->values[i];
    return sqrt(ratio(squared_difference(image, reference), total));
}

double measure_relmse(const struct measure_image *image, const struct measure_image *reference,
                      double epsilon)
{
    size_t count = value_count(image);
    double sum = 0;
    for (size_t i = 0; i < count; i++) {
        double truth = (double)reference->values[i], difference = (double)image->values[i] - truth;
        sum += difference * difference / (truth * truth + epsilon);
    }
    return count ? sum / (double)count : 0;
}

double measure_flux(const struct measure_image *image, const struct measure_image *reference)
{
    double sum = 0, truth = 0;
    for (size_t i = 0; i < value_count(image); i++) {
        sum += (double)image->values[i];
        truth += (double)reference->values[i];
    }
    return truth == 0 && sum != 0 ? copysign(INFINITY, sum) : ratio(sum - truth, truth);
}

double measure_luminance(const struct measure_image *image, size_t index)
{
    const float *value = image->values + index * image->components;
    if (image->components < 3)
        return (double)value[0];
    return 0.2126 * (double)value[0] + 0.7152 * (double)value[1] + 0.0722 * (double)value[2];
}

/* A pixel is above factor * median of 49 exactly when it is above factor * at least 25 of them: no sorting.
 */
size_t measure_fireflies(const struct measure_image *image, const struct measure_image *reference,
                         double factor, double floor, uint8_t *map)
{
    enum { RADIUS = 3, SIDE = 2 * RADIUS + 1, MAJORITY = SIDE * SIDE / 2 + 1 };
    uint32_t width = image->width, height = image->height;
    if (!width || !height)
        return 0;
    size_t stride = (size_t)width + 2 * RADIUS, total = 0;
    float *bars = malloc(stride * height * sizeof *bars); /* factor * reference, its sides repeated */
    float *values = malloc(width * sizeof *values);
    uint8_t *passed = malloc(width);
    if (!bars || !values || !passed)
        total = SIZE_MAX;
    for (uint32_t y = 0; !total && y < height; y++) {
        float *row = bars + y * stride + RADIUS;
        for (uint32_t x = 0; x < width; x++)
            row[x] = (float)(factor * measure_luminance(reference, (size_t)y * width + x));
        for (uint32_t i = 1; i <= RADIUS; i++) {
            *(row - i) = row[0];
            row[width - 1 + i] = row[width - 1];
        }
    }
    for (uint32_t y = 0; total != SIZE_MAX && y < height; y++) {
        for (uint32_t x = 0; x < width; x++) {
            values[x] = (float)measure_luminance(image, (size_t)y * width + x);
            passed[x] = 0;
        }
        for (uint32_t j = 0; j < SIDE; j++) {
            uint32_t near = y + j < RADIUS ? 0 : y + j - RADIUS < height ? y + j - RADIUS : height - 1;
            for (uint32_t i = 0; i < SIDE; i++) {
                const float *bar = bars + near * stride + i;
                for (uint32_t x = 0; x < width; x++)
                    passed[x] = (uint8_t)(passed[x] + (values[x] > bar[x] ? 1 : 0));
            }
        }
        for (uint32_t x = 0; x < width; x++) {
            bool is_firefly = passed[x] >= MAJORITY && (double)values[x] > floor;
            total += is_firefly;
            if (map)
                map[(size_t)y * width + x] = is_firefly;
        }
    }
    free(bars);
    free(values);
    free(passed);
    return total;
}

double measure_sum(const struct measure_image *image, uint32_t component, const double *weights)
{
    double sum = 0;
    size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++)
        sum += (double)image->values[i * image->components + component] * (weights ? weights[i] : 1);
    return sum;
}

void measure_box3(const struct measure_image *image, float *target)
{
    uint32_t width = image->width, height = image->height, components = image->components;
    for (uint32_t y = 0; y < height; y++) {
        uint32_t top = y ? y - 1 : 0, bottom = y + 1 < height ? y + 1 : y;
        for (uint32_t x = 0; x < width; x++) {
            uint32_t left = x ? x - 1 : 0, right = x + 1 < width ? x + 1 : x;
            double area = (double)(bottom - top + 1) * (double)(right - left + 1);
            for (uint32_t c = 0; c < components; c++) {
                double sum = 0;
                for (uint32_t j = top; j <= bottom; j++)
                    for (uint32_t i = left; i <= right; i++)
                        sum += (double)image->values[((size_t)j * width + i) * components + c];
                target[((size_t)y * width + x) * components + c] = (float)(sum / area);
            }
        }
    }
}

/* The bits of floats above 0 are ordered as they are: one half of the bits after the other, each by counting.
 */
float measure_rank_above_zero(const float *values, size_t count, size_t rank)
{
    enum { DIGITS = 65536 };
    uint32_t *counts = malloc(DIGITS * sizeof *counts);
    if (!counts)
        return NAN;
    uint32_t found = 0;
    bool is_there = true;
    for (int half = 0; half < 2 && is_there; half++) {
        memset(counts, 0, DIGITS * sizeof *counts);
        for (size_t i = 0; i < count; i++) {
            uint32_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            if (values[i] > 0 && (!half || bits >> 16 == found))
                counts[half ? bits & 0xffff : bits >> 16]++;
        }
        uint32_t digit = 0;
        while (digit < DIGITS && rank >= counts[digit])
            rank -= counts[digit++];
        is_there = digit < DIGITS;
        found = found << 16 | digit;
    }
    free(counts);
    float value;
    memcpy(&value, &found, sizeof value);
    return is_there ? value : 0;
}

static int compare_values(const void *left, const void *right)
{
    double a = *(const double *)left, b = *(const double *)right;
    return (a > b) - (a < b);
}

double measure_percentile(double *values, size_t count, double percent)
{
    if (!count)
        return 0;
    qsort(values, count, sizeof *values, compare_values);
    double place = fmin(fmax(percent, 0), 100) / 100 * (double)(count - 1);
    size_t below = (size_t)place, above = below + 1 < count ? below + 1 : below;
    return values[below] + (place - (double)below) * (values[above] - values[below]);
}
