/* Steps of the attitude filter: angles in units of 2^-20 rad, rates in units per second. */
#ifndef TRACKER_ATTITUDE_FILTER_H
#define TRACKER_ATTITUDE_FILTER_H

#include "tracker_linear.h"

#define TRACKER_ANGLE_BITS 20

/* State after the attitude: its covariance and that of the rate, or of the bias. */
struct tracker_correction {
    tracker_real distance2, white[3], change[6];
};

/* Quaternion of 2.30 and covariance after a step in seconds at a rate. sign: 1 if the second state is the rate, -1 if it is
 * a gyro's bias. psd: white noise of the angle's derivative, of the second state's, of both disturbances of the rate.
 * 0: the step is longer than 64 rad. */
int tracker_propagate(int32_t quaternion[4], tracker_real covariance[6][6], const tracker_real rate[3], tracker_real step,
                      int sign, const tracker_real psd[3]);

/* Update with a measured attitude error and its covariance; the updated covariance replaces the given one if `keep` is 1.
 * 0: the innovation's covariance is not positive definite. */
int tracker_correct(tracker_real covariance[6][6], const tracker_real innovation[3], tracker_real noise[3][3], int keep,
                    struct tracker_correction *correction);

/* Rotates the frame of an attitude by a rotation vector in its own axes, up to three radians. */
void tracker_turn_quaternion(int32_t quaternion[4], const tracker_real angle[3]);

/* Rotation vector from one attitude to another, in the axes of the first one's frame. */
void tracker_rotation_between(const int32_t first[4], const int32_t second[4], tracker_real vector[3]);

/* x^2 + y^2 + z^2 */
tracker_real tracker_square_sum(tracker_real x, tracker_real y, tracker_real z);

#endif
