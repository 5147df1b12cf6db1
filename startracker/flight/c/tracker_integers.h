/* Integers of up to 64 bits, and vectors of 2.30. */
#ifndef TRACKER_INTEGERS_H
#define TRACKER_INTEGERS_H

#include <stdint.h>

int64_t tracker_shift_right(int64_t value, int bits);        /* rounds down, also for negative numbers */
int64_t tracker_floor_quotient(int64_t n, int64_t positive); /* rounds down */
int64_t tracker_square_root(int64_t n);                      /* 0 <= n < 2^62 */
int64_t tracker_magnitude(int64_t value);
int64_t tracker_largest(const int64_t *values, int count); /* largest magnitude */
int tracker_thirty_bits(int64_t *values, int count);       /* shifts all right until they are below 2^30; the shift */
int tracker_unit(int64_t v[3], int64_t least);             /* normalises to 2.30 in place; 0: all components below least */
int64_t tracker_dot(const int64_t a[3], const int64_t b[3]); /* of 2.30, as the cross product */
void tracker_cross(const int64_t a[3], const int64_t b[3], int64_t out[3]);

static inline int64_t tracker_smaller(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

static inline int64_t tracker_larger(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

static inline int64_t tracker_limited(int64_t value, int64_t least, int64_t most)
{
    return value < least ? least : value > most ? most : value;
}

#endif
