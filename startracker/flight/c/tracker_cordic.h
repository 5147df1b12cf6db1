/* Angles of vectors in integers. */
#ifndef TRACKER_CORDIC_H
#define TRACKER_CORDIC_H

#include <stdint.h>

#define TRACKER_FULL_TURN (360 * 64) /* degrees of 10.6 */

int64_t tracker_fine_angle(int64_t y, int64_t x); /* arctangent of y / x, degrees, 40 fraction bits, -90 to 270 */
/* Angle at a vertex between two directions of 2.30, degrees of 10.6. */
int32_t tracker_inner_angle(const int64_t vertex[3], const int64_t first[3], const int64_t second[3]);
int32_t tracker_modulo_turn(int32_t angle);                     /* from 0 to a turn, degrees of 10.6 */
int32_t tracker_turn_between(int32_t first, int32_t second);    /* first - second, from minus half a turn to half a turn */

#endif
