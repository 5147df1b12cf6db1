/* Plate constants in 64 bits: the same operations in the same order as startracker/fixed_point/attitude.py. */
#include "tracker_internal.h"

#define ONE ((int64_t)1 << 30)
#define MAP_BITS 24
#define ROUNDS 40
#define LEAST_ROUNDS 4
#define SETTLED 8
#define SLENDER_SHIFT 10
#define LEAST_LENGTH (1 << 10)
#define LARGEST_LEFT ((int64_t)1 << 31)
#define LARGEST_MAP ((int64_t)1 << 32)

struct fit {
    int64_t xx, xy, yy, divisor;
    int shift, full;
};

static int axes(const int64_t center[3], int smallest, int64_t east[3], int64_t north[3])
{
    int k;

    for (k = 0; k < 3; k++)
        east[k] = -tracker_shift_right(center[smallest] * center[k], 30);
    east[smallest] += ONE;
    if (!tracker_unit(east, LEAST_LENGTH))
        return 0;
    tracker_cross(center, east, north);
    return 1;
}

static int make_fit(struct tracker_context *context, struct fit *fit, int count)
{
    int64_t sums[3] = {0, 0, 0}, total, determinant;
    int n;

    for (n = 0; n < count; n++) {
        sums[0] += context->image[n][0] * context->image[n][0];
        sums[1] += context->image[n][0] * context->image[n][1];
        sums[2] += context->image[n][1] * context->image[n][1];
    }
    fit->shift = tracker_thirty_bits(sums, 3);
    fit->xx = sums[0];
    fit->xy = sums[1];
    fit->yy = sums[2];
    total = fit->xx + fit->yy;
    determinant = fit->xx * fit->yy - fit->xy * fit->xy;
    fit->full = determinant > tracker_shift_right(total * total, SLENDER_SHIFT);
    fit->divisor = fit->full ? tracker_shift_right(determinant, 30) : total;
    return fit->divisor >= 1 << 12;
}

static int add_shifted(int64_t value, int power, int64_t *to)
{
    if (power <= 0) {
        *to += tracker_shift_right(value, -power);
        return 1;
    }
    if (tracker_magnitude(value) >> (power < 33 ? 33 - power : 0))
        return 0;
    *to += value * ((int64_t)1 << power);
    return 1;
}

/* Fits the residuals and adds the result to the map. */
static int add_fit(struct tracker_context *context, const struct fit *fit, int count, int64_t plate[2][2])
{
    int64_t sums[4] = {0, 0, 0, 0}, numerator[4];
    int power, n, k;

    for (n = 0; n < count; n++)
        for (k = 0; k < 4; k++)
            sums[k] += context->left[n][k / 2] * context->image[n][k % 2];
    power = tracker_thirty_bits(sums, 4) - fit->shift;
    if (fit->full) {
        power += MAP_BITS - 30;
        for (k = 0; k < 2; k++) {
            numerator[2 * k] = fit->yy * sums[2 * k] - fit->xy * sums[2 * k + 1];
            numerator[2 * k + 1] = fit->xx * sums[2 * k + 1] - fit->xy * sums[2 * k];
        }
    } else {
        numerator[0] = numerator[3] = (sums[0] + sums[3]) * ((int64_t)1 << MAP_BITS);
        numerator[2] = (sums[2] - sums[1]) * ((int64_t)1 << MAP_BITS);
        numerator[1] = -numerator[2];
    }
    for (k = 0; k < 4; k++)
        if (!add_shifted(numerator[k] / fit->divisor, power, &plate[k / 2][k % 2]))
            return 0;
    return 1;
}

static int32_t rounded_degrees(int64_t y, int64_t x)
{
    int64_t angle = tracker_shift_right(tracker_fine_angle(y, x) + ((int64_t)1 << 17), 18), turn = (int64_t)360 << 22;

    angle %= turn;
    return (int32_t)(angle < 0 ? angle + turn : angle);
}

void tracker_angles(const int64_t matrix[3][3], struct tracker_attitude *attitude)
{
    const int64_t *center = matrix[2];
    int64_t up[3], level, to_east, to_north;
    int k;

    for (k = 0; k < 3; k++)
        up[k] = -matrix[1][k];
    level = tracker_square_root(center[0] * center[0] + center[1] * center[1]);
    to_east = tracker_shift_right(center[0] * up[1] - center[1] * up[0], 30);
    to_north = tracker_shift_right(tracker_shift_right(up[2] * level, 30) * level
                                       - tracker_shift_right(center[0] * up[0] + center[1] * up[1], 30) * center[2],
                                   30);
    for (k = 0; k < 9; k++)
        attitude->matrix[k / 3][k % 3] = (int32_t)matrix[k / 3][k % 3];
    attitude->ra = rounded_degrees(center[1], center[0]);
    attitude->dec = rounded_degrees(center[2], level);
    if (attitude->dec > (int32_t)180 << 22)
        attitude->dec -= (int32_t)360 << 22;
    attitude->roll = rounded_degrees(to_east, to_north);
}

static int finish(const int64_t center[3], const int64_t east[3], const int64_t north[3], int64_t plate[2][2],
                  int64_t matrix[3][3])
{
    int64_t turn[3];
    int k;

    if (plate[0][0] * tracker_shift_right(plate[1][1], 4) - plate[0][1] * tracker_shift_right(plate[1][0], 4) <= 0)
        return 0;
    turn[0] = plate[0][0] + plate[1][1];
    turn[1] = plate[1][0] - plate[0][1];
    turn[2] = 0;
    while (tracker_largest(turn, 2) > 0 && tracker_largest(turn, 2) < ONE) {
        turn[0] *= 2;
        turn[1] *= 2;
    }
    if (!tracker_unit(turn, LEAST_LENGTH))
        return 0;
    for (k = 0; k < 3; k++) {
        matrix[0][k] = tracker_shift_right(turn[0] * east[k] + turn[1] * north[k], 30);
        matrix[1][k] = tracker_shift_right(turn[0] * north[k] - turn[1] * east[k], 30);
        matrix[2][k] = center[k];
    }
    return 1;
}

/* Subtracts the mean of the values, rounded down. */
static void take_off_mean(int64_t values[][2], int count, int64_t mean[2])
{
    int64_t sum;
    int n, k;

    for (k = 0; k < 2; k++) {
        sum = 0;
        for (n = 0; n < count; n++)
            sum += values[n][k];
        mean[k] = tracker_floor_quotient(sum, count);
        for (n = 0; n < count; n++)
            values[n][k] -= mean[k];
    }
}

int tracker_plate_attitude(struct tracker_context *context, int count, int64_t matrix[3][3])
{
    int64_t middle[2], center[3] = {0, 0, 0}, east[3], north[3], plate[2][2] = {{0, 0}, {0, 0}};
    int64_t mean[2], offset[2], depth, along[2];
    struct fit fit;
    int smallest = 0, round, n, k;

    for (n = 0; n < count; n++) {
        context->image[n][0] = tracker_shift_right(context->seen[n][0], 6);
        context->image[n][1] = -tracker_shift_right(context->seen[n][1], 6);
        for (k = 0; k < 3; k++)
            center[k] += tracker_star_direction[context->catalog[n]][k];
    }
    take_off_mean(context->image, count, middle);
    if (!make_fit(context, &fit, count) || !tracker_unit(center, LEAST_LENGTH))
        return 0;
    for (k = 1; k < 3; k++)
        if (tracker_magnitude(center[k]) < tracker_magnitude(center[smallest]))
            smallest = k;
    for (round = 1; round <= ROUNDS; round++) {
        if (!axes(center, smallest, east, north))
            return 0;
        for (n = 0; n < count; n++) {
            depth = along[0] = along[1] = 0;
            for (k = 0; k < 3; k++) {
                const int64_t component = tracker_star_direction[context->catalog[n]][k];
                depth += component * center[k];
                along[0] += component * east[k];
                along[1] += component * north[k];
            }
            depth = tracker_shift_right(depth, 30);
            if (depth < ONE / 2)
                return 0;
            for (k = 0; k < 2; k++) {
                context->left[n][k] = along[k] / depth
                             - tracker_shift_right(plate[k][0] * context->image[n][0] + plate[k][1] * context->image[n][1], MAP_BITS);
                if (tracker_magnitude(context->left[n][k]) >= LARGEST_LEFT)
                    return 0;
            }
        }
        take_off_mean(context->left, count, mean);
        if (!add_fit(context, &fit, count, plate) || tracker_largest(&plate[0][0], 4) >= LARGEST_MAP)
            return 0;
        for (k = 0; k < 2; k++)
            offset[k] = mean[k] - tracker_shift_right(plate[k][0] * middle[0] + plate[k][1] * middle[1], MAP_BITS);
        if (tracker_largest(offset, 2) >= ONE)
            return 0;
        if (round >= LEAST_ROUNDS && tracker_largest(offset, 2) <= SETTLED)
            return finish(center, east, north, plate, matrix);
        for (k = 0; k < 3; k++)
            center[k] += tracker_shift_right(offset[0] * east[k] + offset[1] * north[k], 30);
        if (!tracker_unit(center, LEAST_LENGTH))
            return 0;
    }
    return 0;
}
