/* Angles of vectors in integers. */
#ifndef TRACKER_CORDIC_H
#define TRACKER_CORDIC_H

#include <stdint.h>

int64_t tracker_fine_angle(int64_t y, int64_t x); /* arctangent of y / x, degrees, 40 fraction bits, -90 to 270 */
/* Angle at a vertex between two directions of 2.30, degrees of 10.6. */
int32_t tracker_inner_angle(const int64_t vertex[3], const int64_t first[3], const int64_t second[3]);

#endif
