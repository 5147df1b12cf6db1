/* Tracking from frame to frame: prediction of the next attitude, and filter of the measured ones.
 *
 * The filter is that of startracker/tracking/mekf.py, with attitudes as measurements: the error of the attitude and the
 * rate, or the bias of a gyro, under white angular acceleration; its innovations are monitored as in
 * startracker/tracking/consistency.py. An attitude that contradicts the prediction is rejected once; if the next one does
 * so as well, the filter restarts from it. Angles are in units of 2^-20 rad (0.2 arcsec). */
#include "tracker_following.h"

#include "tracker_attitude_filter.h"
#include "tracker_directions.h"

#define ONE ((int64_t)1 << 30)
#define PSD_BITS 20
#define LIMIT_BITS 16
#define COVARIANCE_BITS 60
#define RADIUS_BITS 28
#define LARGEST_FACTOR 100000000
#define RAISE 10
#define PRIOR_SIGMAS 5
#define LEAST_RADIUS 468509 /* 0.1 degrees */
#define USELESS 1647099     /* pi / 2 */
#define LONGEST_US 100000000000LL
#define LEAST_STEP_US 1000
#define MOST_REJECTED 1
#define WINDOW TRACKER_FOLLOWING_WINDOW
#define SIGN (TRACKER_FOLLOWING_GYRO ? -1 : 1)

static tracker_real limit_of(int64_t limit)
{
    return tracker_real_of(limit, -LIMIT_BITS);
}

static void copy_quaternion(const int32_t from[4], int32_t to[4])
{
    int k;

    for (k = 0; k < 4; k++)
        to[k] = from[k];
}

static void forget(struct tracker_following *f)
{
    int k;

    f->known = 0;
    f->innovations = f->rejected = 0;
    for (k = 0; k < 3; k++)
        f->rate[k] = f->bias[k] = tracker_zero();
}

void tracker_following_start(struct tracker_following *following)
{
    forget(following);
    following->noise_factor = tracker_real_of(1, 0);
    following->has_time = following->has_refused = following->has_used = 0;
}

static enum tracker_time check_time(struct tracker_following *f, int64_t time_us)
{
    int later;

    if (f->has_used && time_us == f->used_us)
        return TRACKER_TIME_BAD;
    if (!f->has_time || time_us >= f->time_us)
        return TRACKER_TIME_GOOD;
    later = f->has_refused && f->refused_us < time_us;
    f->has_refused = 1;
    f->refused_us = time_us;
    return later ? TRACKER_TIME_SET_BACK : TRACKER_TIME_BAD;
}

/* Microseconds from one time to a later one, at most LONGEST_US + 1. */
static int64_t elapsed(int64_t from, int64_t to)
{
    const uint64_t apart = (uint64_t)to - (uint64_t)from;

    return apart > LONGEST_US ? LONGEST_US + 1 : (int64_t)apart;
}

static int propagate(struct tracker_following *f, int64_t step_us, int measured)
{
    const int64_t extra = measured ? 0 : TRACKER_FOLLOWING_EXTRA_PSD;
    const tracker_real step = tracker_over(tracker_real_of(step_us, 0), tracker_real_of(1000000, 0));
    tracker_real psd[3];

    psd[0] = tracker_times(f->noise_factor, tracker_real_of(TRACKER_FOLLOWING_ANGLE_PSD, -PSD_BITS));
    psd[1] = tracker_times(f->noise_factor, tracker_real_of(TRACKER_FOLLOWING_RATE_PSD, -PSD_BITS));
    psd[2] = tracker_times(f->noise_factor, tracker_real_of(TRACKER_FOLLOWING_RATE_PSD + extra, -PSD_BITS));
    return tracker_propagate(f->quaternion, f->covariance, f->rate, step, SIGN, psd);
}

/* Standard deviation of the attitude about all axes together. */
static tracker_real uncertainty(const struct tracker_following *f)
{
    const tracker_real sum = tracker_add(f->covariance[0][0], f->covariance[1][1]);

    return tracker_real_root(tracker_add(sum, f->covariance[2][2]));
}

static int32_t element(int64_t sum)
{
    return (int32_t)tracker_shift_right(sum, 29);
}

static void matrix_of(const int32_t q[4], struct tracker_matrix *out)
{
    const int64_t x = q[0], y = q[1], z = q[2], w = q[3];

    out->row[0].x = (int32_t)(ONE - element(y * y + z * z));
    out->row[0].y = element(x * y + z * w);
    out->row[0].z = element(x * z - y * w);
    out->row[1].x = element(x * y - z * w);
    out->row[1].y = (int32_t)(ONE - element(x * x + z * z));
    out->row[1].z = element(y * z + x * w);
    out->row[2].x = element(x * z + y * w);
    out->row[2].y = element(y * z - x * w);
    out->row[2].z = (int32_t)(ONE - element(x * x + y * y));
}

static void make_prior(const struct tracker_following *f, struct tracker_prior *prior)
{
    const int32_t none[4] = {0, 0, 0, 0};
    int64_t radius;
    int k;

    matrix_of(f->known ? f->quaternion : none, &prior->attitude);
    if (!f->known)
        for (k = 0; k < 3; k++)
            prior->attitude.row[k].x = prior->attitude.row[k].y = prior->attitude.row[k].z = 0;
    prior->radius = 0;
    if (!f->known)
        return;
    radius = tracker_integer_of(tracker_times(tracker_real_of(PRIOR_SIGMAS, 0), uncertainty(f)), RADIUS_BITS - TRACKER_ANGLE_BITS);
    if (radius < LEAST_RADIUS)
        radius = LEAST_RADIUS;
    if (radius <= TRACKER_FOLLOWING_LARGEST_RADIUS)
        prior->radius = (uint32_t)radius;
}

enum tracker_time tracker_following_predict(struct tracker_following *following, int64_t time_us, const int32_t *gyro,
                                            struct tracker_prior *prior)
{
    struct tracker_following *f = following;
    const enum tracker_time status = check_time(f, time_us);
    int64_t step_us;
    int k;

    if (status != TRACKER_TIME_BAD) {
        step_us = !f->has_time || status == TRACKER_TIME_SET_BACK ? 0 : elapsed(f->time_us, time_us);
        if (status == TRACKER_TIME_SET_BACK)
            forget(f);
        f->time_us = time_us;
        f->has_time = 1;
        f->has_refused = 0;
        if (f->known) {
            if (gyro && TRACKER_FOLLOWING_GYRO)
                for (k = 0; k < 3; k++)
                    f->rate[k] = tracker_subtract(tracker_real_of(gyro[k], TRACKER_ANGLE_BITS - 30), f->bias[k]);
            if (step_us > LONGEST_US || !propagate(f, step_us, gyro && TRACKER_FOLLOWING_GYRO)
                || !tracker_less(uncertainty(f), tracker_real_of(USELESS, 0)))
                forget(f);
        }
    }
    make_prior(f, prior);
    return status;
}

/* The filter from one attitude and a standard deviation of the second state. */
static void begin(struct tracker_following *f, const int32_t measured[4], tracker_real noise[3][3], tracker_real sigma)
{
    int i, j;

    copy_quaternion(measured, f->quaternion);
    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++)
            f->covariance[i][j] = i < 3 && j < 3 ? noise[i][j] : tracker_zero();
    for (i = 3; i < 6; i++)
        f->covariance[i][i] = tracker_times(sigma, sigma);
    f->known = 1;
}

static void mark(struct tracker_following *f)
{
    copy_quaternion(f->quaternion, f->solved);
    f->used_us = f->time_us;
    f->has_used = 1;
    f->rejected = 0;
}

/* Innovation of an attitude; 0: beyond the gate. With keep, the filter is updated with it. */
static int compare(struct tracker_following *f, const int32_t measured[4], tracker_real noise[3][3], int keep,
                   struct tracker_innovation *innovation)
{
    struct tracker_correction correction;
    tracker_real vector[3];
    int k;

    tracker_rotation_between(f->quaternion, measured, vector);
    if (!tracker_correct(f->covariance, vector, noise, keep, &correction)
        || tracker_less(limit_of(TRACKER_FOLLOWING_GATE), correction.distance2))
        return 0;
    innovation->distance2 = correction.distance2;
    for (k = 0; k < 3; k++)
        innovation->white[k] = correction.white[k];
    if (!keep)
        return 1;
    tracker_turn_quaternion(f->quaternion, correction.change);
    for (k = 0; k < 3; k++) {
        if (TRACKER_FOLLOWING_GYRO) {
            f->bias[k] = tracker_add(f->bias[k], correction.change[3 + k]);
            f->rate[k] = tracker_subtract(f->rate[k], correction.change[3 + k]);
        } else {
            f->rate[k] = tracker_add(f->rate[k], correction.change[3 + k]);
        }
    }
    return 1;
}

/* Whether the recent innovations and one more contradict the filter. */
static int contradicts(const struct tracker_following *f, const struct tracker_innovation *innovation)
{
    const int first = f->innovations == WINDOW ? 1 : 0, count = f->innovations - first + 1;
    struct tracker_innovation total = *innovation;
    tracker_real square = tracker_zero();
    int n, k;

    for (n = first; n < f->innovations; n++) {
        total.distance2 = tracker_add(total.distance2, f->window[n].distance2);
        for (k = 0; k < 3; k++)
            total.white[k] = tracker_add(total.white[k], f->window[n].white[k]);
    }
    if (count < 2)
        return 0;
    for (k = 0; k < 3; k++)
        square = tracker_add(square, tracker_times(total.white[k], total.white[k]));
    square = tracker_over(square, tracker_real_of(count, 0));
    return tracker_less(limit_of(tracker_following_limits[count]), total.distance2)
           || tracker_less(limit_of(TRACKER_FOLLOWING_MEAN_LIMIT), square);
}

static void learn(struct tracker_following *f, const struct tracker_innovation *innovation)
{
    const tracker_real one = tracker_real_of(1, 0);
    tracker_real total = tracker_zero();
    int n;

    if (f->innovations == WINDOW) {
        for (n = 1; n < WINDOW; n++)
            f->window[n - 1] = f->window[n];
        f->innovations--;
    }
    f->window[f->innovations++] = *innovation;
    f->noise_factor = tracker_add(f->noise_factor, tracker_times(tracker_real_of(1, -8), tracker_subtract(one, f->noise_factor)));
    for (n = 0; n < f->innovations; n++)
        total = tracker_add(total, f->window[n].distance2);
    if (f->innovations == WINDOW && tracker_less(one, f->noise_factor) && tracker_less(total, limit_of(TRACKER_FOLLOWING_TOO_SMALL))) {
        f->innovations = 0;
        f->noise_factor = tracker_over(f->noise_factor, tracker_real_of(RAISE, 0));
        if (tracker_less(f->noise_factor, one))
            f->noise_factor = one;
    }
}

/* More noise of the process, and a new window. */
static void alarm(struct tracker_following *f)
{
    const tracker_real largest = tracker_real_of(LARGEST_FACTOR, 0);

    f->innovations = 0;
    f->noise_factor = tracker_times(f->noise_factor, tracker_real_of(RAISE, 0));
    if (tracker_less(largest, f->noise_factor))
        f->noise_factor = largest;
}

/* Restart; the difference to the last attitude, or to the prediction with a gyro, limits the second state. */
static void restart(struct tracker_following *f, const int32_t measured[4], tracker_real noise[3][3])
{
    const int64_t step_us = f->time_us - f->used_us > LEAST_STEP_US ? f->time_us - f->used_us : LEAST_STEP_US;
    tracker_real away[3], rate, sigma = tracker_real_of(TRACKER_FOLLOWING_SIGMA, 0);
    int k;

    if (f->innovations < WINDOW)
        alarm(f);
    f->innovations = 0;
    tracker_rotation_between(TRACKER_FOLLOWING_GYRO ? f->quaternion : f->solved, measured, away);
    rate = tracker_over(tracker_real_root(tracker_square_sum(away[0], away[1], away[2])), tracker_over(tracker_real_of(step_us, 0), tracker_real_of(1000000, 0)));
    begin(f, measured, noise, tracker_less(sigma, rate) ? rate : sigma);
    if (!TRACKER_FOLLOWING_GYRO)
        for (k = 0; k < 3; k++)
            f->rate[k] = tracker_zero();
}

enum tracker_following_result tracker_following_update(struct tracker_following *following,
                                                       const struct tracker_matrix *attitude, int64_t covariance[3][3])
{
    struct tracker_following *f = following;
    enum tracker_following_result result = TRACKER_FOLLOWING_USED;
    struct tracker_innovation innovation;
    tracker_real noise[3][3];
    int32_t measured[4];
    int i, j, good;

    tracker_quaternion_of(attitude, measured);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            noise[i][j] = tracker_real_of(covariance[i][j], 2 * TRACKER_ANGLE_BITS - COVARIANCE_BITS);
    if (!f->known) {
        begin(f, measured, noise, tracker_real_of(TRACKER_FOLLOWING_SIGMA, 0));
        f->noise_factor = tracker_real_of(1, 0);
        mark(f);
        return TRACKER_FOLLOWING_BEGUN;
    }
    good = compare(f, measured, noise, 0, &innovation);
    if (good && contradicts(f, &innovation)) {
        alarm(f);
        for (i = 0; i < 6; i++)
            for (j = 0; j < 6; j++)
                f->covariance[i][j] = tracker_times(tracker_real_of(RAISE, 0), f->covariance[i][j]);
        good = compare(f, measured, noise, 0, &innovation);
        result = TRACKER_FOLLOWING_DISTRUSTED;
    }
    if (!good) {
        if (f->rejected < MOST_REJECTED) {
            f->rejected++;
            return TRACKER_FOLLOWING_REJECTED;
        }
        restart(f, measured, noise);
        mark(f);
        return TRACKER_FOLLOWING_RESTARTED;
    }
    (void)compare(f, measured, noise, 1, &innovation);
    learn(f, &innovation);
    mark(f);
    return result;
}

int tracker_following_attitude(const struct tracker_following *following, struct tracker_matrix *attitude,
                               int64_t covariance[3][3])
{
    int i, j;

    if (!following->known)
        return 0;
    matrix_of(following->quaternion, attitude);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            covariance[i][j] = tracker_integer_of(following->covariance[i][j], COVARIANCE_BITS - 2 * TRACKER_ANGLE_BITS);
    return 1;
}

enum tracker_following_result tracker_following_take(struct tracker_following *following, struct tracker_answer *answer)
{
    enum tracker_following_result result;

    if (answer->status != TRACKER_SOLVED)
        return TRACKER_FOLLOWING_COASTING;
    result = tracker_following_update(following, &answer->attitude, answer->covariance);
    if (result != TRACKER_FOLLOWING_REJECTED) {
        (void)tracker_following_attitude(following, &answer->attitude, answer->covariance);
        tracker_quaternion_of(&answer->attitude, answer->quaternion);
    }
    return result;
}
