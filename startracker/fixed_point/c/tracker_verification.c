/* Verification of an attitude against all points and all guide stars of the field: the same operations in the same order as
 * startracker/fixed_point/verification.py and evidence.py, which explain them. */
#include "tracker_internal.h"

#define ONE ((int64_t)1 << 30)
#define PLANE_BITS 12
#define LOG_BITS 12
#define LOG_UP 24
#define NEVER (-((int64_t)1 << 28))
#define SUM_STEP 8
#define LEAST_LENGTH (1 << 20)
#define ROUNDS 8
#define SETTLED 8
#define SETTLED_ANGLE 4096
#define LARGEST_ANGLE ((int64_t)1 << 27)
#define MOST_EXTRA 10

/* log2 of n >= 1, rounded down. */
static int64_t log_down(int64_t n)
{
    int64_t m = n;
    int bits = 0;

    while (m > 1) {
        m >>= 1;
        bits++;
    }
    m = bits >= 8 ? n >> (bits - 8) : n * ((int64_t)1 << (8 - bits));
    return bits * ((int64_t)1 << LOG_BITS) + tracker_log_table[m - 256];
}

/* log2 of 2^a + 2^b, rounded down. */
static int64_t log_sum(int64_t a, int64_t b)
{
    const int64_t high = tracker_larger(a, b), k = (high - tracker_smaller(a, b)) >> SUM_STEP;

    return k < TRACKER_SUMS ? high + tracker_sum_table[k] : high;
}

int tracker_place_points(struct tracker_context *context, const int32_t xy[][2], int count)
{
    int n;

    for (n = 0; n < count; n++) {
        context->point[n][0] = tracker_shift_right(xy[n][0], 22 - PLANE_BITS);
        context->point[n][1] = -tracker_shift_right((int64_t)xy[n][1] * TRACKER_RATIO, 42 - PLANE_BITS);
        if (tracker_magnitude(context->point[n][0]) > TRACKER_HALF_X || tracker_magnitude(context->point[n][1]) > TRACKER_HALF_Y)
            return 0;
    }
    return 1;
}

void tracker_local_areas(struct tracker_context *context, int count)
{
    int64_t *square = context->square;
    int i, j, k, found, at;

    for (i = 0; i < count; i++) {
        found = 0;
        for (j = 0; j < count; j++) {
            const int64_t dx = context->point[j][0] - context->point[i][0];
            const int64_t dy = context->point[j][1] - context->point[i][1];
            if (j == i)
                continue;
            for (at = found; at > 0 && square[at - 1] > dx * dx + dy * dy; at--)
                square[at] = square[at - 1];
            square[at] = dx * dx + dy * dy;
            found++;
        }
        context->area[i] = TRACKER_LOG_AREA;
        for (k = 0; k < found; k++) {
            const int64_t area = square[k] * found / (k + 1);
            const int64_t log_area = area > 0 ? log_down(area) + TRACKER_LOG_PI : NEVER;
            if (log_area < context->area[i])
                context->area[i] = log_area;
        }
    }
}

/* Rotates an attitude by small angles of 2.30 about the camera's axes. */
static int turn(int64_t matrix[3][3], int64_t x, int64_t y, int64_t z)
{
    int64_t first[3], third[3], along;
    int k;

    for (k = 0; k < 3; k++) {
        first[k] = matrix[0][k] + tracker_shift_right(y * matrix[2][k] - z * matrix[1][k], 30);
        third[k] = matrix[2][k] + tracker_shift_right(x * matrix[1][k] - y * matrix[0][k], 30);
    }
    if (!tracker_unit(third, LEAST_LENGTH))
        return 0;
    along = tracker_dot(first, third);
    for (k = 0; k < 3; k++)
        first[k] -= tracker_shift_right(along * third[k], 30);
    if (!tracker_unit(first, LEAST_LENGTH))
        return 0;
    tracker_cross(third, first, matrix[1]);
    for (k = 0; k < 3; k++) {
        matrix[0][k] = first[k];
        matrix[2][k] = third[k];
    }
    return 1;
}

static int predict(int64_t matrix[3][3], int guide, int64_t out[2])
{
    int64_t direction[3], u, v, w;
    int k;

    for (k = 0; k < 3; k++)
        direction[k] = tracker_guide_direction[guide][k];
    w = tracker_dot(matrix[2], direction);
    if (w <= 0)
        return 0;
    u = tracker_dot(matrix[0], direction);
    v = tracker_dot(matrix[1], direction);
    if (tracker_magnitude(u) > w || tracker_magnitude(v) > w)
        return 0;
    out[0] = u * TRACKER_FOCAL / w;
    out[1] = v * TRACKER_FOCAL / w;
    return 1;
}

static int find_field(struct tracker_context *context, int most)
{
    int64_t at[2];
    int guide, count = 0;

    for (guide = 0; guide < TRACKER_GUIDES && count < most; guide++)
        if (predict(context->matrix, guide, at) && tracker_magnitude(at[0]) <= TRACKER_HALF_X
            && tracker_magnitude(at[1]) <= TRACKER_HALF_Y)
            context->field[count++] = (uint16_t)guide;
    return count;
}

static int match(struct tracker_context *context, int points, int in_field, int64_t gate)
{
    int i, k, count = 0;

    for (k = 0; k < in_field; k++)
        context->owner[k] = -1;
    for (i = 0; i < points; i++) {
        int64_t best = gate + 1;
        int at = -1, rival;
        for (k = 0; k < in_field; k++) {
            const int64_t dx = context->predicted[k][0] - context->point[i][0];
            const int64_t dy = context->predicted[k][1] - context->point[i][1];
            if (dx * dx + dy * dy < best) {
                best = dx * dx + dy * dy;
                at = k;
            }
        }
        context->index[i] = -1;
        if (at < 0)
            continue;
        rival = context->owner[at];
        if (rival >= 0) {
            if (context->square[rival] <= best)
                continue;
            context->index[rival] = -1;
            count--;
        }
        context->owner[at] = (int16_t)i;
        context->index[i] = (int16_t)at;
        context->square[i] = best;
        count++;
    }
    return count;
}

/* One iteration of the fit: 0: failed, 1: not converged, 2: converged. */
static int refit(struct tracker_context *context, int points, int count)
{
    int64_t mean[2] = {0, 0}, off[2] = {0, 0}, turning = 0, lever = 0, angle, shift_x, shift_y, x, y;
    int i, k;

    for (i = 0; i < points; i++)
        if (context->index[i] >= 0)
            for (k = 0; k < 2; k++) {
                mean[k] += context->predicted[context->index[i]][k];
                off[k] += context->point[i][k] - context->predicted[context->index[i]][k];
            }
    for (k = 0; k < 2; k++) {
        mean[k] /= count;
        off[k] /= count;
    }
    for (i = 0; i < points; i++)
        if (context->index[i] >= 0) {
            const int64_t *at = context->predicted[context->index[i]];
            x = at[0] - mean[0];
            y = at[1] - mean[1];
            turning += x * (context->point[i][1] - at[1]) - y * (context->point[i][0] - at[0]);
            lever += x * x + y * y;
        }
    lever >>= 16;
    if (lever == 0)
        return 0;
    angle = turning * 16384 / lever;
    shift_x = off[0] + tracker_shift_right(angle * mean[1], 30);
    shift_y = off[1] - tracker_shift_right(angle * mean[0], 30);
    x = -shift_y * ONE / TRACKER_FOCAL;
    y = shift_x * ONE / TRACKER_FOCAL;
    if (tracker_larger(tracker_magnitude(angle), tracker_larger(tracker_magnitude(x), tracker_magnitude(y))) > LARGEST_ANGLE
        || !turn(context->matrix, x, y, angle))
        return 0;
    return tracker_larger(tracker_magnitude(shift_x), tracker_magnitude(shift_y)) <= SETTLED && tracker_magnitude(angle) <= SETTLED_ANGLE ? 2 : 1;
}

/* Whether the matched points span the field; the sum of their squared distances from their mean. */
static int spans(const struct tracker_context *context, int points, int count, int64_t *lever)
{
    int64_t mean[2] = {0, 0}, xx = 0, xy = 0, yy = 0, x, y;
    int i, k;

    for (i = 0; i < points; i++)
        if (context->index[i] >= 0)
            for (k = 0; k < 2; k++)
                mean[k] += context->point[i][k];
    for (k = 0; k < 2; k++)
        mean[k] /= count;
    *lever = 0;
    for (i = 0; i < points; i++)
        if (context->index[i] >= 0) {
            x = context->point[i][0] - mean[0];
            y = context->point[i][1] - mean[1];
            *lever += x * x + y * y;
            x = tracker_shift_right(x, PLANE_BITS);
            y = tracker_shift_right(y, PLANE_BITS);
            xx += x * x;
            xy += x * y;
            yy += y * y;
        }
    return xx * yy - xy * xy >= (int64_t)TRACKER_SPREAD * count * count;
}

/* log2 of the Bayes factor of the given matches, rounded down. */
static int64_t weigh(struct tracker_context *context, int points, int count, int in_field, int64_t lever)
{
    const int64_t lowered = log_down(count) + LOG_UP + ((log_down(tracker_larger(lever, 1)) + LOG_UP + 1) >> 1);
    int64_t everything = NEVER;
    int s, i, k, m, at, found, depth;

    for (s = 0; s < TRACKER_WIDTHS; s++) {
        int64_t of_width = NEVER;
        found = 0;
        for (i = 0; i < points; i++) {
            int64_t gain;
            if (context->index[i] < 0 || context->square[i] > tracker_farthest[s])
                continue;
            gain = context->area[i] - tracker_log_cell[s] - ((context->square[i] * tracker_quadratic[s]) >> 32) - 1;
            for (at = found; at > 0 && context->gain[at - 1] < gain; at--) {
                context->gain[at] = context->gain[at - 1];
                context->rank[at] = context->rank[at - 1];
            }
            context->gain[at] = gain;
            context->rank[at] = context->index[i];
            found++;
        }
        for (depth = 1; depth <= in_field; depth++) {
            int64_t value = (int64_t)tracker_distracting[points] + tracker_seeing[0][depth], total = 0;
            for (k = m = 0; k < found; k++)
                if (context->rank[k] < depth) {
                    m++;
                    total += context->gain[k];
                    value = tracker_larger(value, total + tracker_distracting[points - m] + tracker_seeing[m][depth - m]);
                }
            of_width = log_sum(of_width, value);
        }
        everything = log_sum(everything, of_width + tracker_log_volume[s]);
    }
    return everything - lowered - tracker_total[points][in_field];
}

int tracker_verify(struct tracker_context *context, int count, int64_t start[3][3])
{
    int most = 2 * count + MOST_EXTRA, in_field, state = TRACKER_STATE_FEW_FIT;
    int step, round, same, matched = 0, i, k;

    if (most > TRACKER_MAX_FIELD)
        most = TRACKER_MAX_FIELD;
    for (i = 0; i < 9; i++)
        context->matrix[i / 3][i % 3] = start[i / 3][i % 3];
    context->evidence = NEVER;
    context->matched = 0;
    in_field = find_field(context, most);
    for (step = 0; step < TRACKER_GATES; step++) {
        int64_t lever, value;
        int settled = 0;
        for (i = 0; i < count; i++)
            context->last[i] = -2;
        for (round = 0; round < ROUNDS; round++) {
            for (k = 0; k < in_field; k++)
                if (!predict(context->matrix, context->field[k], context->predicted[k]))
                    return state;
            matched = match(context, count, in_field, tracker_gate[step]);
            if (matched < 3)
                return state;
            same = 1;
            for (i = 0; i < count; i++)
                if (context->index[i] != context->last[i])
                    same = 0;
            if (settled && same)
                break;
            for (i = 0; i < count; i++)
                context->last[i] = context->index[i];
            k = refit(context, count, matched);
            if (k == 0)
                return state;
            settled = k == 2;
        }
        if (state < TRACKER_STATE_NOT_SPREAD)
            state = TRACKER_STATE_NOT_SPREAD;
        if (!spans(context, count, matched, &lever))
            continue;
        state = TRACKER_STATE_FIT;
        value = weigh(context, count, matched, in_field, lever);
        if (value > context->evidence) {
            context->evidence = value;
            context->matched = matched;
            for (i = 0; i < 9; i++)
                context->fitted[i / 3][i % 3] = context->matrix[i / 3][i % 3];
            for (i = 0; i < count; i++)
                context->guide[i] = context->index[i] >= 0 ? context->field[context->index[i]] : -1;
        }
    }
    return state;
}
