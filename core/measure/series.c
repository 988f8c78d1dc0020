#include "series.h"

#include <math.h>

#define TWO_PI 6.283185307179586476925

static bool enough(uint32_t count, uint32_t least, const char *what, struct error *error)
{
    return count >= least ||
           error_set(error, STATUS_INVALID, "%u frames are too few to measure %s; it takes %u", count, what,
                     least);
}

static double mean_of(const double *values, uint32_t count)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++)
        sum += values[i];
    return sum / count;
}

double series_frames_to(const double *values, uint32_t count, double limit)
{
    uint32_t first = count;
    while (first > 0 && values[first - 1] <= limit)
        first--;
    return first < count ? (double)first : (double)INFINITY;
}

bool series_settling(const double *values, uint32_t count, double band, struct series_settling *settling,
                     struct error *error)
{
    if (!enough(count, SERIES_MIN_SETTLING, "how a value settles", error))
        return false;
    uint32_t tail = count / 4;
    double end = mean_of(values + count - tail, tail), initial = values[0];
    double allowed = (band > 0 ? band : 0.02) * (end != 0 ? fabs(end) : 1), change = end - initial;
    double past = 0;
    uint32_t first = count;
    for (uint32_t i = 0; i < count; i++)
        past = fmax(past, change > 0 ? values[i] - end : end - values[i]);
    while (first > 0 && fabs(values[first - 1] - end) <= allowed)
        first--;
    *settling = (struct series_settling){
        .initial = initial,
        .end = end,
        .frames = first < count ? (double)first : (double)INFINITY,
        .overshoot = fabs(change) > allowed ? past / fabs(change) : NAN,
    };
    return true;
}

/* ---- the straight line through a series ---------------------------------------------------------------- */

struct line {
    double mean, middle, slope; /* value = mean + slope * (frame - middle) */
    double spread;              /* sum of (frame - middle)^2 */
};

static struct line fit_line(const double *values, uint32_t count)
{
    struct line line = {.mean = mean_of(values, count), .middle = 0.5 * (count - 1)};
    double product = 0;
    for (uint32_t i = 0; i < count; i++) {
        product += (i - line.middle) * (values[i] - line.mean);
        line.spread += (i - line.middle) * (i - line.middle);
    }
    line.slope = product / line.spread;
    return line;
}

static double residual(const struct line *line, const double *values, uint32_t i)
{
    return values[i] - line->mean - line->slope * (i - line->middle);
}

/* Residuals below this are rounding, of the values themselves and of the sums over them. */
static double rounding(const struct line *line)
{
    return 1e-12 * fmax(fabs(line->mean), fabs(line->slope) * line->middle);
}

/* ---- oscillation --------------------------------------------------------------------------------------- */

/* What the best a cos + b sin of `frequency` (per frame) takes off the residuals' sum of squares. */
static double explained(const double *values, uint32_t count, const struct line *line, double frequency,
                        double *amplitude)
{
    double step_cos = cos(TWO_PI * frequency), step_sin = sin(TWO_PI * frequency);
    double c = 1, s = 0, cc = 0, ss = 0, cs = 0, yc = 0, ys = 0;
    for (uint32_t i = 0; i < count; i++) {
        double y = residual(line, values, i);
        cc += c * c;
        ss += s * s;
        cs += c * s;
        yc += y * c;
        ys += y * s;
        double turned = c * step_cos - s * step_sin;
        s = s * step_cos + c * step_sin;
        c = turned;
    }
    /* At a period of 2 the sine is zero at every frame: the cosine alone. */
    double determinant = cc * ss - cs * cs, a = yc / cc, b = 0;
    if (determinant > 1e-9 * cc * cc) {
        a = (ss * yc - cs * ys) / determinant;
        b = (cc * ys - cs * yc) / determinant;
    }
    *amplitude = hypot(a, b);
    return a * yc + b * ys;
}

bool series_oscillation(const double *values, uint32_t count, struct series_oscillation *oscillation,
                        struct error *error)
{
    if (!enough(count, SERIES_MIN_OSCILLATION, "how a value oscillates", error))
        return false;
    struct line line = fit_line(values, count);
    double lowest = INFINITY, highest = -INFINITY, squares = 0, amplitude;
    for (uint32_t i = 0; i < count; i++) {
        double rest = residual(&line, values, i);
        lowest = fmin(lowest, rest);
        highest = fmax(highest, rest);
        squares += rest * rest;
    }
    *oscillation = (struct series_oscillation){.mean = line.mean, .period = NAN};
    if (highest - lowest <= 2 * rounding(&line))
        return true;
    double step = 0.25 / count, best = 0.5, best_power = 0;
    for (double frequency = 2.0 / count; frequency < 0.5 + 0.5 * step; frequency += step) {
        double power = explained(values, count, &line, fmin(frequency, 0.5), &amplitude);
        if (power > best_power) {
            best_power = power;
            best = fmin(frequency, 0.5);
        }
    }
    const double golden = 0.6180339887498949;
    double low = fmax(best - step, 2.0 / count), high = fmin(best + step, 0.5);
    for (int i = 0; i < 40; i++) {
        double left = high - golden * (high - low), right = low + golden * (high - low);
        if (explained(values, count, &line, left, &amplitude) <
            explained(values, count, &line, right, &amplitude))
            low = left;
        else
            high = right;
    }
    double refined = 0.5 * (low + high);
    if (explained(values, count, &line, refined, &amplitude) > best_power)
        best = refined;
    best_power = explained(values, count, &line, best, &amplitude);
    double scale = line.mean != 0 ? fabs(line.mean) : 1;
    oscillation->swing = 0.5 * (highest - lowest) / scale;
    oscillation->amplitude = amplitude / scale;
    oscillation->period = 1 / best;
    oscillation->share = fmin(best_power / squares, 1);
    return true;
}

/* ---- drift --------------------------------------------------------------------------------------------- */

/* The 97.5 % quantile of Student's t (Abramowitz and Stegun 26.7.5); within 0.1 % from 4 degrees on. */
static double student_quantile(double freedom)
{
    const double z = 1.959963984540054, z2 = z * z;
    double n = freedom;
    return z + z * (z2 + 1) / (4 * n) + z * ((5 * z2 + 16) * z2 + 3) / (96 * n * n) +
           z * (((3 * z2 + 19) * z2 + 17) * z2 - 15) / (384 * n * n * n);
}

bool series_drift(const double *values, uint32_t count, struct series_drift *drift, struct error *error)
{
    if (!enough(count, SERIES_MIN_DRIFT, "drift", error))
        return false;
    struct line line = fit_line(values, count);
    double squares = 0, products = 0, before = 0;
    for (uint32_t i = 0; i < count; i++) {
        double rest = residual(&line, values, i);
        squares += rest * rest;
        products += i ? rest * before : 0;
        before = rest;
    }
    /* As many independent values as an AR(1) series of this correlation is worth (Santer et al. 2000). An
     * alternating series would count as more than it has; it does not. */
    double correlation = squares > 0 ? fmin(fmax(products / squares, 0), 0.999) : 0;
    double worth = fmax(count * (1 - correlation) / (1 + correlation), 6);
    double confidence = student_quantile(worth - 2) * sqrt(squares / (worth - 2) / line.spread);
    double over_all = fabs(line.slope) * (count - 1);
    *drift = (struct series_drift){
        .mean = line.mean,
        .slope = line.slope,
        .confidence = confidence,
        .is_significant = fabs(line.slope) > confidence && over_all > 1e-12 * fabs(line.mean),
    };
    return true;
}
