/* Tracking from frame to frame: prediction of the next attitude, and filter of the measured ones.
 *
 *     static struct tracker_following following;
 *     tracker_following_start(&following);
 *     for each frame:
 *         if (tracker_following_predict(&following, info.time_us, gyro, &info.prior) != TRACKER_TIME_BAD) {
 *             tracker_start(&context, &info); ... tracker_finish(&context, &answer);
 *             tracker_following_take(&following, &answer);
 *         } */
#ifndef TRACKER_FOLLOWING_H
#define TRACKER_FOLLOWING_H

#include "tracker_arithmetic.h"
#include "tracker_types.h"

#ifdef __cplusplus
extern "C" {
#endif

enum tracker_time {
    TRACKER_TIME_GOOD,
    TRACKER_TIME_BAD,     /* before the last frame, or that of a frame that was used: the frame cannot be used */
    TRACKER_TIME_SET_BACK /* the second such time, later than the first: the clock was set back, the filter is forgotten */
};

enum tracker_following_result {
    TRACKER_FOLLOWING_BEGUN,      /* the filter begins with the attitude */
    TRACKER_FOLLOWING_USED,       /* the attitude was used */
    TRACKER_FOLLOWING_DISTRUSTED, /* used, after recent attitudes had contradicted the filter: its covariance was increased */
    TRACKER_FOLLOWING_REJECTED,   /* it contradicts the prediction and was not used */
    TRACKER_FOLLOWING_RESTARTED,  /* the second that contradicts it: the filter restarted from this one */
    TRACKER_FOLLOWING_COASTING    /* the frame has no attitude: the filter only predicts */
};

struct tracker_innovation {
    tracker_real distance2, white[3];
};

/* The filter; kept from frame to frame. */
struct tracker_following {
    int known;                 /* 1: there is an attitude */
    int32_t quaternion[4];     /* at time_us, 2.30, scalar last */
    tracker_real covariance[6][6], rate[3], bias[3], noise_factor; /* units of 2^-20 rad, and per second */
    struct tracker_innovation window[TRACKER_FOLLOWING_WINDOW];    /* oldest first */
    int innovations, rejected, has_time, has_refused, has_used;
    int64_t time_us, refused_us, used_us;
    int32_t solved[4];         /* attitude at used_us */
};

/* Forget everything. */
void tracker_following_start(struct tracker_following *following);

/* Propagate to the middle of a frame's exposure, microseconds of a clock that does not jump. At most 64 steps of the filter.
 *
 * gyro     mean measured rate since the last frame, camera axes, rad/s of 2.30; NULL: none
 * prior    the predicted attitude and its largest error for the identification; radius 0: none */
enum tracker_time tracker_following_predict(struct tracker_following *following, int64_t time_us, const int32_t *gyro,
                                            struct tracker_prior *prior);

/* Update with the attitude and covariance (camera axes, square radians of 60 fraction bits) of the frame of the last
 * prediction, whose time was good. */
enum tracker_following_result tracker_following_update(struct tracker_following *following,
                                                       const struct tracker_matrix *attitude, int64_t covariance[3][3]);

/* Update with the answer of that frame. An attitude that is used is replaced by that of the filter, with its covariance: it
 * is of this and all earlier frames. */
enum tracker_following_result tracker_following_take(struct tracker_following *following, struct tracker_answer *answer);

/* Attitude and covariance of the filter at the time of the last prediction; 0: there is none. */
int tracker_following_attitude(const struct tracker_following *following, struct tracker_matrix *attitude,
                               int64_t covariance[3][3]);

#ifdef __cplusplus
}
#endif

#endif
