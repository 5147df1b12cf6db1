/* Attitude and covariance of a frame from its identified stars. */
#ifndef TRACKER_POSE_H
#define TRACKER_POSE_H

#include "tracker_pose_fit.h"
#include "tracker_types.h"

/* Working memory. */
struct tracker_pose {
    int32_t plane[TRACKER_MAX_STARS][2], seen[TRACKER_MAX_STARS][2]; /* positions, measured and corrected */
    int32_t slopes[TRACKER_MAX_STARS][2][2], inverse[TRACKER_MAX_STARS][2][2];
    int32_t offset[TRACKER_MAX_STARS][2];
    int64_t variance[TRACKER_MAX_STARS], wide[TRACKER_MAX_STARS], square[TRACKER_MAX_STARS];
    uint8_t usable[TRACKER_MAX_STARS];
    int16_t used[TRACKER_MAX_STARS], index[TRACKER_MAX_STARS];
    struct tracker_pose_star star[TRACKER_MAX_STARS];
    struct tracker_pose_fit fit;
    struct tracker_vector direction[TRACKER_POSE_MAX_FIELD];
    int32_t predicted[TRACKER_POSE_MAX_FIELD][2];
    uint8_t ahead[TRACKER_POSE_MAX_FIELD];
    uint16_t number[TRACKER_POSE_MAX_FIELD];
    int16_t owner[TRACKER_POSE_MAX_FIELD];
    int stars, in_field;
};

/* Attitude of identified stars, and of all others that agree with it.
 *
 * star         `count` stars of the frame, at most TRACKER_MAX_STARS
 * guide        guide star with which each is identified, -1 for none; replaced by the one that it was fitted to
 * observer     who sees the guide stars
 * attitude     of the identification, right to about eight pixels; replaced by the fitted one
 * covariance   of the rotation vector in camera axes, square radians of 60 fraction bits
 *
 * The number of fitted stars; 0, with nothing replaced, if fewer than two are identified or they determine no attitude to a radian.
 * At most 10 fits and 11 comparisons of all stars with TRACKER_POSE_MAX_FIELD guide stars, one pass over all guide stars. */
int tracker_solve_pose(struct tracker_pose *pose, const struct tracker_star *star, int count,
                       int16_t guide[TRACKER_MAX_STARS], const struct tracker_observer *observer,
                       struct tracker_matrix *attitude, int64_t covariance[3][3]);

/* Residual of a star that the attitude was fitted to: measured minus predicted, pixels of 16 fraction bits. */
void tracker_pose_residual(struct tracker_pose *pose, int n, int64_t out[2]);

#endif
