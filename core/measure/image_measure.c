#include "image_measure.h"

#include <math.h>
#include <stdlib.h>

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
