/* Star identification by triads and attitude by plate constants, in integers (Yee 1999, chapters 2 and 3).
 *
 * Centroids of 10.22 fixed point (pixels from the image's centre, x right, y up, brightest first) to attitude.
 * No floating point, no heap, no recursion; all memory is static, so one call at a time. */
#ifndef TRACKER_H
#define TRACKER_H

#include <stdint.h>

#include "tables.h"

enum status { SOLVED, TOO_FEW_STARS, NO_MATCH, NO_ATTITUDE, OVERFLOW_STATUS, TOO_MANY_TRIADS };

struct attitude {
    int32_t matrix[3][3]; /* 2.30; rows: camera x (right), y (down), boresight in the catalogue's axes */
    int32_t ra, dec, roll; /* of the boresight, degrees of 10.22; roll: the image's up, east of north */
};

struct answer {
    enum status status;
    int stars;                  /* used: the first MAX_STARS */
    int32_t number[MAX_STARS];  /* catalogue number of each, + 10000 where several are one in the image; 0: none */
    int triads;                 /* in the group that won */
    struct attitude attitude;   /* when solved */
};

void solve(const int32_t xy[][2], int count, struct answer *answer);

/* attitude.c: 1 when found, 0 when not. catalog: places of the stars in the tables. */
int plate_attitude(const int32_t xy[][2], const uint16_t *catalog, int count, struct attitude *attitude);

/* integers.c */
int64_t shift_right(int64_t value, int bits);       /* downwards, also of negative numbers */
int64_t floor_quotient(int64_t n, int64_t positive); /* downwards */
int64_t square_root(int64_t n);                     /* of 0 to below 2^62 */
int64_t fine_angle(int64_t y, int64_t x);           /* degrees, 40 bits of fraction, -90 to 270 */
int32_t direction(int64_t y, int64_t x);            /* degrees of 10.6, by the table of arccosines */
int image_separation(int64_t chi, int64_t psi);     /* 6.10; -1: overflow */
int32_t catalog_separation(int a, int b);           /* 22.10 */
int32_t catalog_angle(int vertex, int first, int second); /* 10.6 */

#endif
