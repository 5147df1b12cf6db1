/* A flight build for a caller in the same process that has no declarations of its structures: flat arrays of integers.
 *
 * Compiled together with the exported sources, of which it only uses the interface (`tracker.h`). */
#include <math.h>
#include <stddef.h>

#include "tracker.h"

#define ANGLE_BITS 20 /* of the filter's angles */

/* All memory of one camera. */
struct library {
    struct tracker_context context;
    struct tracker_answer answer;
    struct tracker_following following;
};

size_t library_bytes(void)
{
    return sizeof(struct library);
}

int library_most_stars(void)
{
    return TRACKER_MAX_STARS;
}

const char *library_version(void)
{
    return tracker_version;
}

/* Begin a frame. known: velocity (3), epoch, time, rows of the prior's matrix (9), its radius. */
static void begin(struct library *library, const int64_t known[15])
{
    struct tracker_frame_info info;
    int k;

    info.velocity.x = (int32_t)known[0];
    info.velocity.y = (int32_t)known[1];
    info.velocity.z = (int32_t)known[2];
    info.epoch = (int32_t)known[3];
    info.time_us = known[4];
    for (k = 0; k < 3; k++) {
        info.prior.attitude.row[k].x = (int32_t)known[5 + 3 * k];
        info.prior.attitude.row[k].y = (int32_t)known[6 + 3 * k];
        info.prior.attitude.row[k].z = (int32_t)known[7 + 3 * k];
    }
    info.prior.radius = (uint32_t)known[14];
    tracker_start(&library->context, &info);
}

#ifndef TRACKER_CENTROIDS
/* All rows of a frame. */
void library_read(struct library *library, const int64_t known[15], const uint16_t *pixel)
{
    int y;

    begin(library, known);
    for (y = 0; y < TRACKER_HEIGHT; y++)
        tracker_row(&library->context, pixel + (size_t)y * TRACKER_WIDTH);
}

/* Stars, identification and attitude of the frame that was read. */
void library_finish(struct library *library)
{
    tracker_finish(&library->context, &library->answer);
}
#endif /* frames */

/* The same of a list of stars in place of a frame: x, y, flux, variance, flags of each. */
void library_solve_list(struct library *library, const int64_t known[15], const int64_t *list, int count)
{
    struct tracker_star star[TRACKER_MAX_STARS];
    int k;

    count = count < TRACKER_MAX_STARS ? count : TRACKER_MAX_STARS;
    for (k = 0; k < count; k++) {
        star[k].x = (int32_t)list[5 * k];
        star[k].y = (int32_t)list[5 * k + 1];
        star[k].flux = (int32_t)list[5 * k + 2];
        star[k].variance = (uint32_t)list[5 * k + 3];
        star[k].flags = (uint16_t)list[5 * k + 4];
    }
    begin(library, known);
    tracker_solve_stars(&library->context, star, count, &library->answer);
}

/* The answer: status, reason, stars, matched, used, evidence, chance, steps, contradicted, quaternion (4), covariance (9);
 * and x, y, flux, variance, flags, catalogue number of each star of the list. */
void library_answer(const struct library *library, int64_t answer[22], int64_t *list)
{
    const struct tracker_answer *a = &library->answer;
    int k;

    answer[0] = (int64_t)a->status;
    answer[1] = (int64_t)a->reason;
    answer[2] = a->stars;
    answer[3] = a->matched;
    answer[4] = a->used;
    answer[5] = a->evidence;
    answer[6] = a->chance;
    answer[7] = a->steps;
    answer[8] = a->prior_contradicted;
    for (k = 0; k < 4; k++)
        answer[9 + k] = a->quaternion[k];
    for (k = 0; k < 9; k++)
        answer[13 + k] = a->covariance[k / 3][k % 3];
    for (k = 0; k < a->stars; k++) {
        const struct tracker_star *star = &library->context.star[k];
        list[6 * k] = star->x;
        list[6 * k + 1] = star->y;
        list[6 * k + 2] = star->flux;
        list[6 * k + 3] = star->variance;
        list[6 * k + 4] = star->flags;
        list[6 * k + 5] = a->number[k];
    }
}

void library_forget(struct library *library)
{
    tracker_following_start(&library->following);
}

/* Prediction for the time of a frame; prior: rows of its matrix (9), its radius. gyro may be NULL. */
int library_predict(struct library *library, int64_t time_us, const int32_t *gyro, int64_t prior[10])
{
    struct tracker_prior predicted;
    const int time = (int)tracker_following_predict(&library->following, time_us, gyro, &predicted);
    int k;

    for (k = 0; k < 3; k++) {
        prior[3 * k] = predicted.attitude.row[k].x;
        prior[3 * k + 1] = predicted.attitude.row[k].y;
        prior[3 * k + 2] = predicted.attitude.row[k].z;
    }
    prior[9] = predicted.radius;
    return time;
}

/* Give the answer of the predicted frame to the filter; the answer is then the filter's. */
int library_take(struct library *library)
{
    return (int)tracker_following_take(&library->following, &library->answer);
}

static double number(tracker_real x)
{
#ifdef TRACKER_FLOAT
    return (double)x;
#else
    return ldexp((double)x.m, (int)x.e);
#endif
}

/* State of the filter: quaternion (4), rate (3) and bias (3) in rad/s, covariance (36) in square radians and seconds, squared
 * distance of the last innovation, or -1. 0: there is no attitude. */
int library_filter(const struct library *library, double state[47])
{
    const struct tracker_following *f = &library->following;
    int k;

    for (k = 0; k < 4; k++)
        state[k] = ldexp((double)f->quaternion[k], -30);
    for (k = 0; k < 3; k++) {
        state[4 + k] = ldexp(number(f->rate[k]), -ANGLE_BITS);
        state[7 + k] = ldexp(number(f->bias[k]), -ANGLE_BITS);
    }
    for (k = 0; k < 36; k++)
        state[10 + k] = ldexp(number(f->covariance[k / 6][k % 6]), -2 * ANGLE_BITS);
    state[46] = f->innovations > 0 ? number(f->window[f->innovations - 1].distance2) : -1.0;
    return f->known;
}
