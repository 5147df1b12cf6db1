/* Internal functions of the solver. */
#ifndef TRACKER_INTERNAL_H
#define TRACKER_INTERNAL_H

#include "tracker.h"
#include "tracker_cordic.h"
#include "tracker_integers.h"

/* tracker_separations.c */
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
