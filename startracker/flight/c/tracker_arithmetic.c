/* Real numbers in integers, or in single precision: see tracker_arithmetic.h.
 *
 * The attitude's normal equations and the filter's covariances span many decades; a mantissa of 31 bits and an exponent
 * hold them without a scale for each. Every result is truncated. */
#include "tracker_arithmetic.h"

#define BITS 31
#define LARGEST ((int64_t)1 << 62)

#ifdef TRACKER_FLOAT

#define NEWTON_STEPS 4

/* x 2^exponent. */
static float scaled(float x, int exponent)
{
    int left = exponent < 0 ? -exponent : exponent;

    while (left > 0) {
        const int step = left < 30 ? left : 30;
        const float by = (float)((int32_t)1 << step);
        x = exponent < 0 ? x * (1.0f / by) : x * by;
        left -= step;
    }
    return x;
}

/* Exponent e of x = f 2^e with 1 <= f < 2, for x > 0; f is written to x. */
static int split(float *x)
{
    int e = 0, step;

    for (step = 64; step > 0; step /= 2) {
        if (*x >= scaled(1.0f, step)) {
            *x = scaled(*x, -step);
            e += step;
        }
        if (*x < scaled(1.0f, 1 - step)) {
            *x = scaled(*x, step);
            e -= step;
        }
    }
    return e;
}

tracker_real tracker_real_of(int64_t n, int exponent)
{
    return scaled((float)n, exponent);
}

int64_t tracker_integer_of(tracker_real x, int bits)
{
    const float value = scaled(x, bits);

    if (value >= 4611686018427387904.0f)
        return LARGEST;
    if (value <= -4611686018427387904.0f)
        return -LARGEST;
    return (int64_t)(value < 0.0f ? value - 0.5f : value + 0.5f);
}

tracker_real tracker_real_root(tracker_real x)
{
    float f = x, y;
    int e, step;

    if (!(x > 0.0f))
        return 0.0f;
    e = split(&f);
    if (e % 2 != 0) {
        f *= 2.0f;
        e -= 1;
    }
    y = 0.41f + 0.6f * f - 0.065f * f * f;
    for (step = 0; step < NEWTON_STEPS; step++)
        y = 0.5f * (y + f / y);
    return scaled(y, e / 2);
}

#else

/* Number of bits of n. */
static int length_of(uint32_t n)
{
    int bits = 0;

    if (n >= (uint32_t)1 << 16) {
        n >>= 16;
        bits += 16;
    }
    if (n >= (uint32_t)1 << 8) {
        n >>= 8;
        bits += 8;
    }
    if (n >= (uint32_t)1 << 4) {
        n >>= 4;
        bits += 4;
    }
    if (n >= (uint32_t)1 << 2) {
        n >>= 2;
        bits += 2;
    }
    return n > 1 ? bits + 2 : bits + (int)n;
}

static tracker_real made(uint32_t m, int negative, int exponent)
{
    tracker_real out;

    out.m = negative ? -(int32_t)m : (int32_t)m;
    out.e = exponent;
    return out;
}

/* value 2^exponent, truncated to 31 bits. */
static tracker_real normal(int64_t value, int exponent)
{
    const uint64_t u = (uint64_t)tracker_magnitude(value);
    const uint32_t high = (uint32_t)(u >> BITS);
    int shift;

    if (u == 0)
        return made(0, 0, 0);
    if (high > 0) {
        shift = length_of(high);
        return made((uint32_t)(u >> shift), value < 0, exponent + shift);
    }
    shift = BITS - length_of((uint32_t)u);
    return made((uint32_t)u << shift, value < 0, exponent - shift);
}

tracker_real tracker_real_of(int64_t n, int exponent)
{
    return normal(n, exponent);
}

int64_t tracker_integer_of(tracker_real x, int bits)
{
    const int64_t u = tracker_magnitude(x.m);
    const int shift = x.e + bits;
    int64_t n;

    if (shift >= BITS)
        n = u > 0 ? LARGEST : 0;
    else if (shift >= 0)
        n = u * ((int64_t)1 << shift);
    else if (shift < -32)
        n = 0;
    else
        n = (u + ((int64_t)1 << (-shift - 1))) >> -shift;
    return x.m < 0 ? -n : n;
}

tracker_real tracker_add(tracker_real a, tracker_real b)
{
    int apart = a.e - b.e;

    if (a.m == 0)
        return b;
    if (b.m == 0)
        return a;
    if (apart < 0) {
        const tracker_real c = a;
        a = b;
        b = c;
        apart = -apart;
    }
    if (apart > BITS)
        return a;
    return normal(a.m * ((int64_t)1 << BITS) + b.m * ((int64_t)1 << (BITS - apart)), a.e - BITS);
}

tracker_real tracker_minus(tracker_real a)
{
    a.m = -a.m;
    return a;
}

tracker_real tracker_times(tracker_real a, tracker_real b)
{
    const uint32_t x = (uint32_t)(a.m < 0 ? -a.m : a.m), y = (uint32_t)(b.m < 0 ? -b.m : b.m);
    const uint64_t product = (uint64_t)x * y;
    const int shift = (product >> (2 * BITS - 1)) != 0 ? BITS : BITS - 1;

    if (product == 0)
        return made(0, 0, 0);
    return made((uint32_t)(product >> shift), (a.m < 0) != (b.m < 0), a.e + b.e + shift);
}

tracker_real tracker_over(tracker_real a, tracker_real b)
{
    if (b.m == 0)
        return b;
    return normal(a.m * ((int64_t)1 << BITS) / b.m, a.e - b.e - BITS);
}

int tracker_sign(tracker_real a)
{
    return (a.m > 0) - (a.m < 0);
}

tracker_real tracker_real_root(tracker_real x)
{
    const int shift = (x.e % 2 != 0) ? BITS : BITS - 1;

    if (x.m <= 0)
        return normal(0, 0);
    return normal(tracker_square_root(x.m * ((int64_t)1 << shift)), (x.e - shift) / 2);
}

/* Exponent e of x = f 2^e with 1 <= f < 2, for x > 0; f is written to x. */
static int split(tracker_real *x)
{
    const int e = x->e + BITS - 1;

    x->e = 1 - BITS;
    return e;
}

static tracker_real scaled(tracker_real x, int exponent)
{
    if (x.m != 0)
        x.e += exponent;
    return x;
}

#endif

/* 1 / k of 40 fraction bits, truncated, for 0 < k < 10. */
static tracker_real reciprocal(int k)
{
    static const int64_t of[10] = {0,
                                   1099511627776,
                                   549755813888,
                                   366503875925,
                                   274877906944,
                                   219902325555,
                                   183251937962,
                                   157073089682,
                                   137438953472,
                                   122167958641};

    return tracker_real_of(of[k], -40);
}

/* sum of x^(2k + 1) / (2k + 1), with alternating signs if `sign` is -1. */
static tracker_real odd_series(tracker_real x, int terms, int sign)
{
    const tracker_real square = tracker_times(x, x);
    tracker_real sum = tracker_zero();
    int k;

    for (k = terms - 1; k >= 0; k--) {
        sum = tracker_times(square, sum);
        sum = tracker_add(reciprocal(2 * k + 1), sign < 0 ? tracker_minus(sum) : sum);
    }
    return tracker_times(x, sum);
}

tracker_real tracker_log2(tracker_real x)
{
    const tracker_real one = tracker_real_of(1, 0);
    int e = split(&x);

    if (tracker_less(tracker_real_of(1518500250, -30), x)) { /* the root of 2 */
        x = scaled(x, -1);
        e++;
    }
    x = tracker_over(tracker_subtract(x, one), tracker_add(x, one));
    x = tracker_times(odd_series(x, 5, 1), tracker_real_of(1549082005, -29)); /* 2 / ln 2 */
    return tracker_add(tracker_real_of(e, 0), x);
}

tracker_real tracker_power_of_2(tracker_real x)
{
    const int whole = (int)tracker_integer_of(x, 0);
    tracker_real term = tracker_times(tracker_subtract(x, tracker_real_of(whole, 0)), tracker_real_of(1488522236, -31));
    tracker_real sum = tracker_real_of(1, 0);
    int k;

    for (k = 8; k > 0; k--)
        sum = tracker_add(tracker_real_of(1, 0), tracker_times(tracker_times(term, sum), reciprocal(k)));
    return scaled(sum, whole);
}

tracker_real tracker_arctangent(tracker_real y, tracker_real x)
{
    const int steep = tracker_less(x, y);
    const tracker_real one = tracker_real_of(1, 0);
    tracker_real t = steep ? tracker_over(x, y) : tracker_over(y, x);
    int k;

    for (k = 0; k < 2; k++) /* half of the angle */
        t = tracker_over(t, tracker_add(one, tracker_real_root(tracker_add(one, tracker_times(t, t)))));
    t = scaled(odd_series(t, 5, -1), 2);
    return steep ? tracker_subtract(tracker_real_of(1686629713, -30), t) : t;
}
