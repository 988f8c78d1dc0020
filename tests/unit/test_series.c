/* Every measure of a series against the closed form of a signal: exponentials, a second-order response,
 * sinusoids, straight lines under noise whose correlation is known. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/measure/series.h"
#include "tests/support/check.h"

#define PI 3.14159265358979323846

static struct error error;
static double values[4096];

/* Uniform in [-1, 1], the same numbers every time. */
static double noise(void)
{
    static uint64_t state = 1;
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(state >> 11) * 0x1p-52 - 1;
}

/* What is left of a change after t frames is exp(-t / tau): 90, 95 and 99 % are made after tau ln 10, tau ln
 * 20 and tau ln 100. */
static void exponentials_take_their_logarithms(void **state)
{
    (void)state;
    const double taus[] = {0.3, 1, 5, 17.7};
    for (int i = 0; i < 4; i++) {
        for (uint32_t t = 0; t < 200; t++)
            values[t] = exp(-(double)t / taus[i]);
        assert_close(series_frames_to(values, 200, 0.1), ceil(taus[i] * log(10)), 0);
        assert_close(series_frames_to(values, 200, 0.05), ceil(taus[i] * log(20)), 0);
        assert_close(series_frames_to(values, 200, 0.01), ceil(taus[i] * log(100)), 0);
    }
}

static void a_return_above_the_limit_counts(void **state)
{
    (void)state;
    const double back[] = {1, 0.01, 0.01, 0.3, 0.01, 0.01}, never[] = {1, 0, 0, 0.06};
    assert_close(series_frames_to(back, 6, 0.05), 4, 0);
    assert_true(isinf(series_frames_to(never, 4, 0.05)));
    assert_close(series_frames_to(back, 6, 1), 0, 0);
    assert_true(isinf(series_frames_to(values, 0, 1)));
}

/* Damping z and damped frequency w: the step response peaks at pi / w with an overshoot of
 * exp(-pi z / sqrt(1 - z^2)), and stays within 2 % once its envelope does, at most half a swing earlier. */
static void second_order_response(void **state)
{
    (void)state;
    const double dampings[] = {0.1, 0.3, 0.5};
    for (int i = 0; i < 3; i++) {
        double z = dampings[i], w = PI / 20, rate = w * z / sqrt(1 - z * z);
        for (uint32_t t = 0; t < 4000; t++)
            values[t] = 50 - 30 * exp(-rate * t) * (cos(w * t) + rate / w * sin(w * t));
        struct series_settling settling;
        assert_true(series_settling(values, 4000, 0.02, &settling, &error));
        assert_close(settling.initial, 20, 1e-12);
        assert_close(settling.end, 50, 1e-6);
        assert_close(settling.overshoot, exp(-PI * z / sqrt(1 - z * z)), 1e-6);
        double envelope = log(30 / sqrt(1 - z * z) / (0.02 * 50)) / rate;
        assert_in_bound(settling.frames, ceil(envelope));
        assert_in_bound(envelope - 20, settling.frames);
        for (uint32_t t = 0; t < 4000; t++)
            values[t] = -values[t]; /* downwards it is the same */
        assert_true(series_settling(values, 4000, 0.02, &settling, &error));
        assert_close(settling.overshoot, exp(-PI * z / sqrt(1 - z * z)), 1e-6);
    }
}

static void what_stands_still_is_settled(void **state)
{
    (void)state;
    struct series_settling settling;
    for (uint32_t t = 0; t < 40; t++)
        values[t] = 7;
    assert_true(series_settling(values, 40, 0, &settling, &error));
    assert_true(settling.frames == 0 && isnan(settling.overshoot));
    /* Monotonic: no overshoot. 100 (1 - 2^-t) is within 2 % of 100 from t = 6 on. */
    for (uint32_t t = 0; t < 80; t++)
        values[t] = 100 * (1 - exp2(-(double)t));
    assert_true(series_settling(values, 80, 0, &settling, &error));
    assert_close(settling.frames, 6, 0);
    assert_close(settling.overshoot, 0, 1e-12);
    /* An alternation of 5 % never settles. */
    for (uint32_t t = 0; t < 40; t++)
        values[t] = 100 + (t % 2 ? 5 : -5);
    assert_true(series_settling(values, 40, 0, &settling, &error));
    assert_true(isinf(settling.frames));
}

static void sinusoids_are_found(void **state)
{
    (void)state;
    const double periods[] = {2, 2.3, 3, 7.3, 16, 40, 91};
    for (int i = 0; i < 7; i++) {
        for (int trend = 0; trend < 2; trend++) {
            for (uint32_t t = 0; t < 400; t++)
                values[t] = 200 + 6 * cos(2 * PI * t / periods[i]) + (trend ? 0.05 * (t - 199.5) : 0);
            struct series_oscillation found;
            assert_true(series_oscillation(values, 400, &found, &error));
            assert_close(found.mean, 200, 0.2);
            assert_close(found.period, periods[i], 0.005 * periods[i]);
            assert_close(found.amplitude, 6.0 / 200, 0.02 * 6 / 200);
            /* Frames meet a period of 3 at 1, -1/2 and -1/2; the line leans into 4.4 periods of 91. */
            double met = periods[i] == 3 ? 0.75 : 1;
            assert_close(found.swing, met * 6 / 200, 0.06 * 6 / 200);
            assert_in_bound(0.99, found.share);
        }
    }
}

/* A square wave of period p: its fundamental has 4/pi of its amplitude and 8/pi^2 of its variance. */
static void square_wave(void **state)
{
    (void)state;
    for (uint32_t t = 0; t < 1000; t++)
        values[t] = 10 + ((2 * t + 25) / 50 % 2 ? 1 : -1);
    struct series_oscillation found;
    assert_true(series_oscillation(values, 1000, &found, &error));
    assert_close(found.period, 50, 0.1);
    assert_close(found.amplitude, 4 / PI / 10, 0.003);
    assert_close(found.share, 8 / (PI * PI), 0.01);
    assert_close(found.swing, 0.1, 0.005);
}

static void noise_and_rest_have_no_period(void **state)
{
    (void)state;
    struct series_oscillation found;
    for (uint32_t t = 0; t < 500; t++)
        values[t] = 10 + noise();
    assert_true(series_oscillation(values, 500, &found, &error));
    assert_in_bound(found.share, 0.1);
    assert_close(found.swing, 0.1, 0.005);
    for (uint32_t t = 0; t < 500; t++)
        values[t] = 131072.125 + 0.25 * t; /* a straight line does not swing */
    assert_true(series_oscillation(values, 500, &found, &error));
    assert_true(found.swing == 0 && found.amplitude == 0 && found.share == 0 && isnan(found.period));
}

static void lines_have_their_slope(void **state)
{
    (void)state;
    struct series_drift drift;
    for (uint32_t t = 0; t < 5000 / 2; t++)
        values[t] = 1000 - 0.01 * t;
    assert_true(series_drift(values, 2500, &drift, &error));
    assert_close(drift.slope, -0.01, 1e-12);
    assert_close(drift.mean, 1000 - 0.01 * 1249.5, 1e-8);
    assert_true(drift.is_significant);
    for (uint32_t t = 0; t < 2500; t++)
        values[t] = 131072.3;
    assert_true(series_drift(values, 2500, &drift, &error));
    assert_true(drift.slope == 0 && !drift.is_significant);
    /* White noise of variance 1/3: the 95 % interval is 1.96 sigma / sqrt(n^3 / 12) to either side. */
    for (uint32_t t = 0; t < 2000; t++)
        values[t] = 5 + 0.0005 * t + noise();
    assert_true(series_drift(values, 2000, &drift, &error));
    assert_close(drift.confidence, 1.96 * sqrt(1.0 / 3) / sqrt(2000.0 * 2000 * 2000 / 12), 2e-6);
    assert_close(drift.slope, 0.0005, drift.confidence * 1.5);
    assert_true(drift.is_significant);
}

/* Correlated noise without drift: an interval of 95 % is wrong about one time in twenty. One that took the
 * values for independent would be wrong about one time in three. */
static void intervals_hold_their_promise(void **state)
{
    (void)state;
    const double correlations[] = {0, 0.6};
    for (int i = 0; i < 2; i++) {
        uint32_t wrong = 0;
        double last = 0;
        for (uint32_t trial = 0; trial < 2000; trial++) {
            struct series_drift drift;
            for (uint32_t t = 0; t < 250; t++)
                values[t] = 100 + (last = correlations[i] * last + noise());
            assert_true(series_drift(values, 250, &drift, &error));
            wrong += drift.is_significant;
        }
        if (wrong < 60 || wrong > 160)
            fail_msg("%u of 2000 intervals miss at correlation %g", wrong, correlations[i]);
    }
}

static void too_few_frames_are_refused(void **state)
{
    (void)state;
    struct series_settling settling;
    struct series_oscillation oscillation;
    struct series_drift drift;
    assert_false(series_settling(values, 7, 0, &settling, &error));
    assert_non_null(strstr(error.message, "7 frames are too few to measure how a value settles; it takes 8"));
    assert_false(series_oscillation(values, 15, &oscillation, &error));
    assert_non_null(strstr(error.message, "it takes 16"));
    assert_false(series_drift(values, 31, &drift, &error));
    assert_non_null(strstr(error.message, "it takes 32"));
    assert_int_equal(error.status, STATUS_INVALID);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exponentials_take_their_logarithms),
        cmocka_unit_test(a_return_above_the_limit_counts),
        cmocka_unit_test(second_order_response),
        cmocka_unit_test(what_stands_still_is_settled),
        cmocka_unit_test(sinusoids_are_found),
        cmocka_unit_test(square_wave),
        cmocka_unit_test(noise_and_rest_have_no_period),
        cmocka_unit_test(lines_have_their_slope),
        cmocka_unit_test(intervals_hold_their_promise),
        cmocka_unit_test(too_few_frames_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
