/* Fit of matched stars: rotation, focal length and shears, averaged over models of their errors. */
#ifndef TRACKER_POSE_FIT_H
#define TRACKER_POSE_FIT_H

#include "tracker_linear.h"

#define TRACKER_POSE_UNKNOWNS 6

/* A matched star, linearised about an attitude. */
struct tracker_pose_star {
    int32_t columns[2][TRACKER_POSE_UNKNOWNS]; /* derivatives of (x, y), 14 fraction bits, below 2^16 */
    int32_t residual[2];                       /* measured minus predicted, pixels of 16 fraction bits, below 2^19 */
    int64_t variance;                          /* on one axis, square pixels of 36 fraction bits, below 2^43 */
};

/* Result, in the units of the columns. */
struct tracker_pose_fit {
    tracker_real step[TRACKER_POSE_UNKNOWNS];
    tracker_real covariance[3][3]; /* of the first three */
    tracker_real factor;           /* mean factor of the stated variances */
    tracker_real systematic;       /* mean systematic variance, square pixels */
};

/* plain: only the camera as calibrated, without systematic errors. 0: the stars determine no attitude. */
int tracker_fit_pose(const struct tracker_pose_star *star, int count, int plain, struct tracker_pose_fit *fit);

#endif
