/* check.h: what cmocka lacks: comparing doubles (its assert_float_equal compares floats) and skipping a
 * program. */
#ifndef TEST_CHECK_H
#define TEST_CHECK_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <cmocka.h>

/* |value - expected| <= tolerance; NaN fails. */
#define assert_close(value, expected, tolerance)                                                             \
    check_close((value), (expected), (tolerance), #value, __FILE__, __LINE__)

static inline void check_close(double value, double expected, double tolerance, const char *text,
                               const char *file, int line)
{
    if (fabs(value - expected) <= tolerance)
        return;
    print_error("%s is %.17g, not %.17g within %.3g\n", text, value, expected, tolerance);
    _fail(file, line);
}

/* value <= bound; NaN fails. */
#define assert_in_bound(value, bound) check_in_bound((value), (bound), #value, __FILE__, __LINE__)

static inline void check_in_bound(double value, double bound, const char *text, const char *file, int line)
{
    if (value <= bound)
        return;
    print_error("%s is %.6g, above %.6g\n", text, value, bound);
    _fail(file, line);
}

/* Ends the program as skipped; the reason is a clause that ./caustics test repeats. */
static inline _Noreturn void skip_program(const char *reason)
{
    printf("skipped: %s\n", reason);
    exit(77);
}

#endif
