/* Attitude and covariance of a frame from its identified stars.
 *
 * The steps are those of startracker/refine.py: all stars of the list that agree with guide stars of the field are matched
 * again with the attitude of the identified ones, with gates from the median of the residuals; then the fit of
 * tracker_pose_fit.c estimates the actual errors, and its gates select the stars of the next fit, until they no longer
 * change. Residuals are measured in pixels of the image, through the derivatives of the grid table. */
#include "tracker_pose.h"

#include "tracker_directions.h"
#include "tracker_integers.h"

#define MATCH_ROUNDS 6
#define FIT_ROUNDS 4
#define FEWEST_TO_REJECT 4
#define MANY 10
#define LEAST_SCALE2 41
#define GATE2 3505      /* 3.7^2, 8 fraction bits */
#define FREEDOM 1477    /* 1 / (2 ln 2), the squared median of a Rayleigh distribution, 11 fraction bits */
#define NEAR (1 << 20)  /* 16 px */
#define LARGEST_RESIDUAL ((1 << 19) - 1)
#define LARGEST_COLUMN ((1 << 16) - 1)
#define LARGEST_VARIANCE ((int64_t)1 << 42)
#define LARGEST_ANGLE ((int64_t)1 << 27)
#define LEAST_DETERMINANT ((int64_t)1 << 31) /* 1/2 */
#define LARGEST_UNKNOWN ((int64_t)1 << 27)   /* of 2.30: 0.125 */
#define LARGEST_SQUARE ((int64_t)1 << 40)
#define COLUMN_ONE 16384
#define DOWN (TRACKER_POSE_RADIUS_BITS + 2)
#define COVARIANCE_BITS 60
#define LARGEST_COVARIANCE ((int64_t)1 << 60) /* a square radian */

static int32_t clipped(int64_t value, int32_t largest)
{
    if (value > largest)
        return largest;
    return value < -largest ? -largest : (int32_t)value;
}

static int matched_stars(const int16_t *index, int count)
{
    int n, found = 0;

    for (n = 0; n < count; n++)
        found += index[n] >= 0;
    return found;
}

static int same(const struct tracker_pose *pose)
{
    int n;

    for (n = 0; n < pose->stars; n++)
        if (pose->index[n] != pose->used[n])
            return 0;
    return 1;
}

/* Median of the values of used stars; `values` beside it is not changed. */
static int64_t median_of_used(const struct tracker_pose *pose, const int64_t *values)
{
    int64_t ordered[TRACKER_MAX_STARS];
    int n, at, count = 0;

    ordered[0] = 0;
    for (n = 0; n < pose->stars; n++) {
        if (pose->used[n] < 0)
            continue;
        for (at = count; at > 0 && ordered[at - 1] > values[n]; at--)
            ordered[at] = ordered[at - 1];
        ordered[at] = values[n];
        count++;
    }
    return (ordered[(count - 1) / 2] + ordered[count / 2]) >> 1;
}

static void take_stars(struct tracker_pose *pose, const struct tracker_star *star, int count)
{
    int n, i, j;

    pose->stars = count;
    for (n = 0; n < count; n++) {
        const int inside = tracker_plane_of(star[n].x, star[n].y, pose->plane[n]);
        int64_t determinant, own;
        int32_t(*slopes)[2] = pose->slopes[n];
        if (!inside)
            pose->plane[n][0] = pose->plane[n][1] = 0;
        tracker_slopes_of(inside ? star[n].x : TRACKER_POSE_CENTRE_X, inside ? star[n].y : TRACKER_POSE_CENTRE_Y, slopes);
        determinant = (int64_t)slopes[0][0] * slopes[1][1] - (int64_t)slopes[0][1] * slopes[1][0];
        pose->usable[n] = (uint8_t)(inside && determinant >= LEAST_DETERMINANT);
        if (!pose->usable[n])
            determinant = (int64_t)1 << 32;
        for (i = 0; i < 2; i++)
            for (j = 0; j < 2; j++) {
                const int64_t adjugate = i == j ? slopes[1 - i][1 - i] : -slopes[i][j];
                pose->inverse[n][i][j] = (int32_t)(adjugate * ((int64_t)1 << 32) / determinant);
            }
        pose->offset[n][0] = clipped((int64_t)star[n].x - TRACKER_POSE_CENTRE_X, INT32_MAX);
        pose->offset[n][1] = clipped((int64_t)star[n].y - TRACKER_POSE_CENTRE_Y, INT32_MAX);
        own = (star[n].variance > 0 ? star[n].variance * (int64_t)1024 : TRACKER_POSE_UNKNOWN) + TRACKER_POSE_FLOOR;
        pose->variance[n] = own < LARGEST_VARIANCE ? own : LARGEST_VARIANCE;
    }
}

static void find_field(struct tracker_pose *pose, const struct tracker_matrix *attitude,
                       const struct tracker_observer *observer)
{
    const int64_t axis[3] = {attitude->row[2].x, attitude->row[2].y, attitude->row[2].z};
    struct tracker_vector direction;
    int32_t plane[2];
    int guide;

    pose->in_field = 0;
    for (guide = 0; guide < TRACKER_POSE_GUIDES && pose->in_field < TRACKER_POSE_MAX_FIELD; guide++) {
        const int32_t *at = tracker_guide_direction[guide];
        if (axis[0] * at[0] + axis[1] * at[1] + axis[2] * at[2] < TRACKER_POSE_LEAST_COSINE * ((int64_t)1 << 30))
            continue;
        direction.x = at[0];
        direction.y = at[1];
        direction.z = at[2];
        if (!tracker_project(attitude, &direction, plane)
            || tracker_magnitude(plane[0]) > (int64_t)TRACKER_GRID_HALF_U + TRACKER_POSE_MARGIN
            || tracker_magnitude(plane[1]) > (int64_t)TRACKER_GRID_HALF_V + TRACKER_POSE_MARGIN)
            continue;
        pose->number[pose->in_field] = (uint16_t)guide;
        tracker_apparent(at, tracker_guide_motion[guide], observer, &pose->direction[pose->in_field]);
        pose->in_field++;
    }
}

static void predict_field(struct tracker_pose *pose, const struct tracker_matrix *attitude)
{
    int k;

    for (k = 0; k < pose->in_field; k++) {
        pose->ahead[k] = (uint8_t)tracker_project(attitude, &pose->direction[k], pose->predicted[k]);
        if (!pose->ahead[k])
            pose->predicted[k][0] = pose->predicted[k][1] = 0;
    }
}

/* A difference in the tangent plane in pixels. */
static void in_pixels(int32_t inverse[2][2], int64_t u, int64_t v, int64_t out[2])
{
    int k;

    for (k = 0; k < 2; k++)
        out[k] = tracker_shift_right(inverse[k][0] * u + inverse[k][1] * v, 16);
}

void tracker_pose_residual(struct tracker_pose *pose, int n, int64_t out[2])
{
    const int32_t *p = pose->predicted[pose->used[n]];

    in_pixels(pose->inverse[n], (int64_t)pose->plane[n][0] - p[0], (int64_t)pose->plane[n][1] - p[1], out);
}

/* Squared distance in pixels, 32 fraction bits. */
static int64_t distance_square(int32_t inverse[2][2], int64_t u, int64_t v)
{
    int64_t away[2];

    in_pixels(inverse, u, v, away);
    return away[0] * away[0] + away[1] * away[1];
}

/* The same over a variance, 8 fraction bits. */
static int64_t over_variance(int64_t distance, int64_t variance)
{
    const int64_t square = distance * 4096 / variance;

    return square < LARGEST_SQUARE ? square : LARGEST_SQUARE;
}

/* Nearest guide star of the field of each star within its gate, one to one; returns their number. */
static int match(struct tracker_pose *pose, int32_t plane[][2], const int64_t *variance, int64_t gate)
{
    int n, k;

    for (k = 0; k < pose->in_field; k++)
        pose->owner[k] = -1;
    for (n = 0; n < pose->stars; n++) {
        int64_t best = 0;
        int at = -1, rival;
        pose->index[n] = -1;
        if (!pose->usable[n])
            continue;
        for (k = 0; k < pose->in_field; k++) {
            const int64_t u = (int64_t)plane[n][0] - pose->predicted[k][0], v = (int64_t)plane[n][1] - pose->predicted[k][1];
            int64_t distance;
            if (!pose->ahead[k] || tracker_magnitude(u) > NEAR || tracker_magnitude(v) > NEAR)
                continue;
            distance = distance_square(pose->inverse[n], u, v);
            if (at < 0 || distance < best) {
                best = distance;
                at = k;
            }
        }
        if (at < 0)
            continue;
        pose->square[n] = over_variance(best, variance[n]);
        if (pose->square[n] > gate)
            continue;
        rival = pose->owner[at];
        if (rival >= 0) {
            if (pose->square[rival] <= pose->square[n])
                continue;
            pose->index[rival] = -1;
        }
        pose->owner[at] = (int16_t)n;
        pose->index[n] = (int16_t)at;
    }
    return matched_stars(pose->index, pose->stars);
}

/* Derivatives of a star's position in units of the fit. */
static void make_columns(struct tracker_pose *pose, int n, const int32_t p[2], int32_t out[2][TRACKER_POSE_UNKNOWNS])
{
    const int64_t a = (int64_t)p[0] * COLUMN_ONE / TRACKER_GRID_FOCAL, b = (int64_t)p[1] * COLUMN_ONE / TRACKER_GRID_FOCAL;
    const int64_t ab = tracker_shift_right(a * b, 14);
    const int32_t x = clipped(tracker_shift_right(pose->offset[n][0], DOWN), LARGEST_COLUMN);
    const int32_t y = clipped(tracker_shift_right(pose->offset[n][1], DOWN), LARGEST_COLUMN);
    int64_t plane[2][3];
    int axis, k;

    plane[0][0] = ab;
    plane[0][1] = -COLUMN_ONE - tracker_shift_right(a * a, 14);
    plane[0][2] = tracker_shift_right(p[1], DOWN);
    plane[1][0] = COLUMN_ONE + tracker_shift_right(b * b, 14);
    plane[1][1] = -ab;
    plane[1][2] = -tracker_shift_right(p[0], DOWN);
    for (axis = 0; axis < 2; axis++)
        for (k = 0; k < 3; k++)
            out[axis][k] = clipped(tracker_shift_right(pose->inverse[n][axis][0] * plane[0][k]
                                                           + pose->inverse[n][axis][1] * plane[1][k], 16),
                                   LARGEST_COLUMN);
    out[0][3] = out[0][4] = out[1][5] = x;
    out[1][3] = out[0][5] = y;
    out[1][4] = -y;
}

/* Used stars as the fit takes them; their number. */
static int linearise(struct tracker_pose *pose, const int64_t *variance)
{
    int n, axis, count = 0;

    for (n = 0; n < pose->stars; n++) {
        struct tracker_pose_star *star = &pose->star[count];
        int64_t away[2];
        if (pose->used[n] < 0)
            continue;
        make_columns(pose, n, pose->predicted[pose->used[n]], star->columns);
        tracker_pose_residual(pose, n, away);
        for (axis = 0; axis < 2; axis++)
            star->residual[axis] = clipped(away[axis], LARGEST_RESIDUAL);
        star->variance = variance[n];
        count++;
    }
    return count;
}

/* Radians of a unit of a component of the rotation. */
static tracker_real scale_of(int k)
{
    if (k == 2)
        return tracker_real_of(1, -TRACKER_POSE_RADIUS_BITS);
    return tracker_over(tracker_real_of(1, 0), tracker_real_of(TRACKER_GRID_FOCAL, -16));
}

/* One fit, and the attitude and predictions after its step. */
static int step(struct tracker_pose *pose, const int64_t *variance, int plain, struct tracker_matrix *attitude)
{
    const int count = linearise(pose, variance);
    int64_t angle[3];
    int k;

    if (!tracker_fit_pose(pose->star, count, plain, &pose->fit))
        return 0;
    for (k = 0; k < 3; k++) {
        angle[k] = tracker_integer_of(tracker_times(pose->fit.step[k], scale_of(k)), 30);
        if (tracker_magnitude(angle[k]) >= LARGEST_ANGLE)
            return 0;
    }
    if (!tracker_turn(attitude, angle[0], angle[1], angle[2]))
        return 0;
    predict_field(pose, attitude);
    return 1;
}

static int match_again(struct tracker_pose *pose, int fewest, struct tracker_matrix *attitude)
{
    int round, n;

    for (round = 0; round < MATCH_ROUNDS; round++) {
        const int64_t least = median_of_used(pose, pose->variance);
        const int count = matched_stars(pose->used, pose->stars);
        int64_t scale2;
        for (n = 0; n < pose->stars; n++)
            pose->wide[n] = pose->variance[n] > least ? pose->variance[n] : least;
        if (!step(pose, pose->wide, 1, attitude))
            return 0;
        for (n = 0; n < pose->stars; n++)
            if (pose->used[n] >= 0) {
                const int32_t *p = pose->predicted[pose->used[n]];
                const int64_t u = clipped((int64_t)pose->plane[n][0] - p[0], NEAR);
                const int64_t v = clipped((int64_t)pose->plane[n][1] - p[1], NEAR);
                pose->square[n] = over_variance(distance_square(pose->inverse[n], u, v), pose->wide[n]);
            }
        scale2 = median_of_used(pose, pose->square) * 2 * count * FREEDOM / ((int64_t)(2 * count - 3) * 2048);
        if (scale2 < (count >= MANY ? LEAST_SCALE2 : 256))
            scale2 = count >= MANY ? LEAST_SCALE2 : 256;
        if (match(pose, pose->plane, pose->wide, (scale2 * GATE2) >> 8) < fewest || same(pose))
            break;
        for (n = 0; n < pose->stars; n++)
            pose->used[n] = pose->index[n];
    }
    return 1;
}

/* Positions without the displacements by the camera's unknowns, and variances, of the last fit. */
static void correct(struct tracker_pose *pose)
{
    int64_t unknown[3], factor = tracker_integer_of(pose->fit.factor, 12), systematic = tracker_integer_of(pose->fit.systematic, 36);
    int n, k;

    if (factor < 1)
        factor = 1;
    if (factor > 1 << 20)
        factor = 1 << 20;
    if (systematic > LARGEST_VARIANCE)
        systematic = LARGEST_VARIANCE;
    for (k = 0; k < 3; k++) {
        unknown[k] = tracker_integer_of(tracker_times(pose->fit.step[3 + k], tracker_real_of(1, -TRACKER_POSE_RADIUS_BITS)), 30);
        if (tracker_magnitude(unknown[k]) > LARGEST_UNKNOWN)
            unknown[k] = unknown[k] < 0 ? -LARGEST_UNKNOWN : LARGEST_UNKNOWN;
    }
    for (n = 0; n < pose->stars; n++) {
        const int64_t x = pose->offset[n][0], y = pose->offset[n][1];
        const int64_t right = tracker_shift_right((unknown[0] + unknown[1]) * x + unknown[2] * y, 30);
        const int64_t down = tracker_shift_right(unknown[2] * x + (unknown[0] - unknown[1]) * y, 30);
        for (k = 0; k < 2; k++)
            pose->seen[n][k] = clipped(pose->plane[n][k]
                                           - tracker_shift_right(pose->slopes[n][k][0] * right + pose->slopes[n][k][1] * down, 16),
                                       INT32_MAX);
        pose->wide[n] = ((pose->variance[n] * factor) >> 12) + systematic + 1;
    }
}

static int64_t covariance_of(const struct tracker_pose_fit *fit, int k, int j)
{
    return tracker_integer_of(tracker_times(tracker_times(fit->covariance[k][j], scale_of(k)), scale_of(j)), COVARIANCE_BITS);
}

int tracker_solve_pose(struct tracker_pose *pose, const struct tracker_star *star, int count,
                       int16_t guide[TRACKER_MAX_STARS], const struct tracker_observer *observer,
                       struct tracker_matrix *attitude, int64_t covariance[3][3])
{
    struct tracker_matrix fitted = *attitude;
    int n, k, j, round, fewest;

    take_stars(pose, star, count);
    find_field(pose, attitude, observer);
    for (n = 0; n < count; n++) {
        pose->used[n] = -1;
        for (k = 0; k < pose->in_field; k++)
            if (pose->usable[n] && guide[n] == pose->number[k])
                pose->used[n] = (int16_t)k;
    }
    fewest = matched_stars(pose->used, count);
    if (fewest < 2)
        return 0;
    if (fewest > FEWEST_TO_REJECT)
        fewest = FEWEST_TO_REJECT;
    predict_field(pose, &fitted);
    if (!match_again(pose, fewest, &fitted))
        return 0;
    for (round = 0; round < FIT_ROUNDS; round++) {
        if (!step(pose, pose->variance, 0, &fitted))
            return 0;
        correct(pose);
        if (round == FIT_ROUNDS - 1 || match(pose, pose->seen, pose->wide, GATE2) < fewest || same(pose))
            break;
        for (n = 0; n < count; n++)
            pose->used[n] = pose->index[n];
    }
    for (k = 0; k < 3; k++)
        if (covariance_of(&pose->fit, k, k) >= LARGEST_COVARIANCE)
            return 0;
    for (k = 0; k < 3; k++)
        for (j = 0; j <= k; j++)
            covariance[k][j] = covariance[j][k] = covariance_of(&pose->fit, k, j);
    for (n = 0; n < count; n++)
        guide[n] = pose->used[n] >= 0 ? (int16_t)pose->number[pose->used[n]] : (int16_t)-1;
    *attitude = fitted;
    return matched_stars(pose->used, count);
}
