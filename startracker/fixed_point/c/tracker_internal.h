/* Internal functions of the solver. */
#ifndef TRACKER_INTERNAL_H
#define TRACKER_INTERNAL_H

#include "tracker.h"

/* tracker_integers.c */
int64_t tracker_shift_right(int64_t value, int bits);        /* rounds down, also for negative numbers */
int64_t tracker_floor_quotient(int64_t n, int64_t positive); /* rounds down */
int64_t tracker_square_root(int64_t n);                      /* 0 <= n < 2^62 */
int64_t tracker_magnitude(int64_t value);
int64_t tracker_largest(const int64_t *values, int count); /* largest magnitude */
int tracker_thirty_bits(int64_t *values, int count);       /* shifts all right until they are below 2^30; the shift */
int tracker_unit(int64_t v[3], int64_t least);             /* normalises to 2.30 in place; 0: all components below least */
int64_t tracker_dot(const int64_t a[3], const int64_t b[3]); /* of 2.30, as the cross product */
void tracker_cross(const int64_t a[3], const int64_t b[3], int64_t out[3]);
int64_t tracker_fine_angle(int64_t y, int64_t x);            /* degrees, 40 fraction bits, -90 to 270 */
int32_t tracker_direction(int64_t y, int64_t x);             /* degrees of 10.6, from the arccosine table */
int tracker_image_separation(int64_t chi, int64_t psi);      /* 6.10; -1: overflow */
int32_t tracker_catalog_separation(int a, int b);            /* 22.10 */
int32_t tracker_catalog_angle(int vertex, int first, int second); /* 10.6 */

/* tracker_attitude.c: plate constants of context->seen and context->catalog; 1 when found, 0 when not. */
int tracker_plate_attitude(struct tracker_context *context, int count, int64_t matrix[3][3]);
void tracker_angles(const int64_t matrix[3][3], struct tracker_attitude *attitude);

/* tracker_verification.c */
enum { TRACKER_STATE_FEW_FIT, TRACKER_STATE_NOT_SPREAD, TRACKER_STATE_FIT };
int tracker_place_points(struct tracker_context *context, const int32_t xy[][2], int count); /* 0: one is outside */
void tracker_local_areas(struct tracker_context *context, int count);
int tracker_verify(struct tracker_context *context, int count, int64_t start[3][3]); /* one of the states */

#endif
