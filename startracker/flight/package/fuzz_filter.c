/* Fuzzing of the tracking filter alone (libFuzzer): a sequence of times, gyro rates and attitudes with covariances. */
#include "fuzz_fields.h"

#include "tracker_directions.h"

#define GROUP 16

/* Of the diagonal, up to (0.06 rad)^2, and correlations up to 1/2. */
static void make_covariance(const uint8_t *bytes, int64_t c[3][3])
{
    int j, k;

    for (j = 0; j < 3; j++)
        c[j][j] = (int64_t)(1 + bytes[j] % 16) << (bytes[j] / 16 * 3 + 3);
    for (j = 0; j < 3; j++)
        for (k = 0; k < j; k++)
            c[j][k] = c[k][j] = (c[j][j] < c[k][k] ? c[j][j] : c[k][k]) * (int8_t)bytes[3] / 256;
}

static void check_filter(const struct tracker_following *following)
{
    struct tracker_matrix attitude;
    int64_t covariance[3][3];

    require(following->innovations >= 0 && following->innovations <= TRACKER_FOLLOWING_WINDOW);
    if (!tracker_following_attitude(following, &attitude, covariance))
        return;
    check_quaternion(following->quaternion);
    check_attitude(&attitude);
    check_covariance(covariance);
}

/* Bytes: time step (0 to 2), attitude's change (3 to 5) and its size (6), covariance (7 to 10), what is done (11), gyro. */
static void step(struct tracker_following *following, const uint8_t *bytes, struct tracker_matrix *attitude, int64_t *time_us)
{
    const int32_t gyro[3] = {(int32_t)(of_two(bytes + 12) << (bytes[6] / 16)), (int8_t)bytes[14] * (1 << 20), (int8_t)bytes[15]};
    const int64_t size = (int64_t)1 << bytes[6] % 20;
    int64_t covariance[3][3];
    struct tracker_prior prior;
    enum tracker_time status;

    *time_us = (int64_t)((uint64_t)*time_us + ((uint64_t)of_two(bytes) << (bytes[2] % 64)));
    if (bytes[2] == 255)
        *time_us = (int64_t)((uint64_t)of_two(bytes) << 48);
    (void)tracker_turn(attitude, (int8_t)bytes[3] * size, (int8_t)bytes[4] * size, (int8_t)bytes[5] * size);
    status = tracker_following_predict(following, *time_us, bytes[11] & 1 ? gyro : NULL, &prior);
    check_filter(following);
    if (prior.radius > 0)
        check_attitude(&prior.attitude);
    if (status == TRACKER_TIME_BAD || bytes[11] % 8 == 6)
        return;
    make_covariance(bytes + 7, covariance);
    require(tracker_following_update(following, attitude, covariance) <= TRACKER_FOLLOWING_COASTING);
    check_filter(following);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_following *following;
    struct tracker_matrix attitude;
    double m[3][3];
    int64_t time_us = 0;

    if (size < 4)
        return 0;
    if (following == NULL)
        following = guarded(sizeof *following);
    look_at(m, of_two(data), of_two(data + 2));
    to_matrix(m, &attitude);
    tracker_following_start(following);
    for (data += 4, size -= 4; size >= GROUP; data += GROUP, size -= GROUP)
        step(following, data, &attitude, &time_us);
    return 0;
}
