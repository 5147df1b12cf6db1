/* Real numbers of the attitude's fit and of the filter, in one of two arithmetics.
 *
 *                   TRACKER_FLOAT defined              otherwise
 * tracker_real      float                              31-bit mantissa and exponent in integers, truncated
 *
 * Both have no library call. The float version takes roots by Newton's method and functions by polynomials; it needs
 * IEEE single precision in every step (FLT_EVAL_METHOD 0, -ffp-contract=off), so that all processors give the same bits. */
#ifndef TRACKER_ARITHMETIC_H
#define TRACKER_ARITHMETIC_H

#include "tracker_integers.h"
#include "tracker_tables.h"

#ifdef TRACKER_FLOAT
typedef float tracker_real;
#else
struct tracker_number {
    int32_t m; /* 0, or 2^30 <= |m| < 2^31 */
    int32_t e; /* the number is m 2^e */
};
typedef struct tracker_number tracker_real;
#endif

/* ------------------------------------------------------------------ real numbers: |exponent| <= 120
 * Numbers outside 1e-37 to 1e38 must not occur: the callers choose their units. A division by zero, and the root of a
 * negative number, are 0. */
tracker_real tracker_real_of(int64_t n, int exponent);    /* n 2^exponent, |n| < 2^63 */
int64_t tracker_integer_of(tracker_real x, int bits);     /* x 2^bits, rounded; at most 2^62 in magnitude */
tracker_real tracker_real_root(tracker_real x);
tracker_real tracker_log2(tracker_real x);                /* x > 0 */
tracker_real tracker_power_of_2(tracker_real x);          /* |x| < 100 */
tracker_real tracker_arctangent(tracker_real y, tracker_real x); /* of y/x >= 0, both not negative: 0 to pi/2 */

#ifdef TRACKER_FLOAT

static inline tracker_real tracker_add(tracker_real a, tracker_real b)
{
    return a + b;
}

static inline tracker_real tracker_minus(tracker_real a)
{
    return -a;
}

static inline tracker_real tracker_times(tracker_real a, tracker_real b)
{
    return a * b;
}

static inline tracker_real tracker_over(tracker_real a, tracker_real b)
{
    return (b < 0.0f || b > 0.0f) ? a / b : 0.0f;
}

static inline int tracker_sign(tracker_real a)
{
    return (a > 0.0f) - (a < 0.0f);
}

#else

tracker_real tracker_add(tracker_real a, tracker_real b);
tracker_real tracker_minus(tracker_real a);
tracker_real tracker_times(tracker_real a, tracker_real b);
tracker_real tracker_over(tracker_real a, tracker_real b);
int tracker_sign(tracker_real a);

#endif

static inline tracker_real tracker_zero(void)
{
    return tracker_real_of(0, 0);
}

static inline tracker_real tracker_subtract(tracker_real a, tracker_real b)
{
    return tracker_add(a, tracker_minus(b));
}

static inline int tracker_less(tracker_real a, tracker_real b)
{
    return tracker_sign(tracker_subtract(a, b)) < 0;
}

#endif
