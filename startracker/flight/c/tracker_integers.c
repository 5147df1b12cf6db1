/* Square roots, quotients and vectors in integers. Right shifts of negative numbers, which are implementation-defined in
 * C99, are replaced by shifts of positive ones. */
#include "tracker_integers.h"

int64_t tracker_shift_right(int64_t value, int bits)
{
    return value >= 0 ? value >> bits : ~(~value >> bits);
}

int64_t tracker_floor_quotient(int64_t n, int64_t positive)
{
    return n >= 0 ? n / positive : -((-n + positive - 1) / positive);
}

int64_t tracker_square_root(int64_t n)
{
    int64_t x = 1, left = n, lower;

    if (n == 0)
        return 0;
    while (left > 0) {
        x *= 2;
        left >>= 2;
    }
    for (;;) {
        lower = (x + n / x) >> 1;
        if (lower >= x)
            return x;
        x = lower;
    }
}

int64_t tracker_magnitude(int64_t value)
{
    return value < 0 ? -value : value;
}

int64_t tracker_largest(const int64_t *values, int count)
{
    int64_t largest = 0;
    int k;

    for (k = 0; k < count; k++)
        if (tracker_magnitude(values[k]) > largest)
            largest = tracker_magnitude(values[k]);
    return largest;
}

int tracker_thirty_bits(int64_t *values, int count)
{
    int64_t largest = tracker_largest(values, count);
    int shift = 0, k;

    while (largest >= (int64_t)1 << 30) {
        largest >>= 1;
        shift++;
    }
    for (k = 0; k < count; k++)
        values[k] = tracker_shift_right(values[k], shift);
    return shift;
}

int tracker_unit(int64_t v[3], int64_t least)
{
    int64_t length;
    int k;

    if (tracker_largest(v, 3) < least)
        return 0;
    tracker_thirty_bits(v, 3);
    length = tracker_square_root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (k = 0; k < 3; k++)
        v[k] = v[k] * ((int64_t)1 << 30) / length;
    return 1;
}

int64_t tracker_dot(const int64_t a[3], const int64_t b[3])
{
    return tracker_shift_right(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 30);
}

void tracker_cross(const int64_t a[3], const int64_t b[3], int64_t out[3])
{
    int k;

    for (k = 0; k < 3; k++)
        out[k] = tracker_shift_right(a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3], 30);
}
