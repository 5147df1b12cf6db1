/* Directions of star images, tangent-plane positions, aberration. */
#ifndef TRACKER_DIRECTIONS_H
#define TRACKER_DIRECTIONS_H

#include "tracker_types.h"

/* Tangent-plane position (u, v) = F (X/Z, Y/Z) of an image position, pixels of 16 fraction bits; 0: outside the image. */
int tracker_plane_of(int32_t x, int32_t y, int32_t plane[2]);

/* d(u, v)/d(x, y) at an image position, 16 fraction bits. */
void tracker_slopes_of(int32_t x, int32_t y, int32_t slopes[2][2]);

/* Image position of a tangent-plane position, to 0.002 px; 0: it is not on the image. At most 8 interpolations with slopes. */
int tracker_image_of(const int32_t plane[2], int32_t xy[2]);

/* Unit vector of 2.30 in camera axes of a tangent-plane position. */
void tracker_vector_of(const int32_t plane[2], struct tracker_vector *vector);

/* Unit vector of a star in camera axes; 0: outside the image. */
int tracker_star_vector(const struct tracker_star *star, struct tracker_vector *vector);

/* Tangent-plane position of a direction in ICRS axes at an attitude; 0: 45 degrees or more off-axis along either axis. */
int tracker_project(const struct tracker_matrix *attitude, const struct tracker_vector *direction, int32_t plane[2]);

/* Apparent direction for an observer's velocity over that of light, components up to 2^-10; error below 0.001 arcsec. */
void tracker_aberrate(const struct tracker_vector *direction, const struct tracker_vector *velocity,
                      struct tracker_vector *apparent);

/* Apparent direction of a guide star of a direction (2.30) and a proper motion a year (29 fraction bits). */
void tracker_apparent(const int32_t direction[3], const int16_t motion[3], const struct tracker_observer *observer,
                      struct tracker_vector *apparent);

/* Rotates an attitude by small angles of 2.30 about the camera's axes, as a rotation vector (v becomes v - angle x v);
 * 0: they are too large. */
int tracker_turn(struct tracker_matrix *attitude, int64_t x, int64_t y, int64_t z);

/* Unit quaternion of 2.30, scalar last and not negative. */
void tracker_quaternion_of(const struct tracker_matrix *attitude, int32_t quaternion[4]);

static inline void tracker_to_array(const struct tracker_vector *v, int64_t out[3])
{
    out[0] = v->x;
    out[1] = v->y;
    out[2] = v->z;
}

static inline void tracker_to_vector(const int64_t v[3], struct tracker_vector *out)
{
    out->x = (int32_t)v[0];
    out->y = (int32_t)v[1];
    out->z = (int32_t)v[2];
}

#endif
