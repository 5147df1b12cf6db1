/* Attitudes of pairs of stars, and gates, by the rules of startracker/identification/hypothesis.py. */
#include "tracker_integers.h"
#include "tracker_search.h"

#define LARGEST_VARIANCE ((int64_t)1 << 42)
#define ONE_RADIAN ((int64_t)1 << 28)

/* Axes of a pair of directions: the midpoint, the difference, and the normal to both. */
static int pair_frame(const int64_t p[3], const int64_t q[3], int64_t frame[3][3])
{
    int64_t largest;
    int k;

    for (k = 0; k < 3; k++) {
        frame[0][k] = p[k] + q[k];
        frame[1][k] = q[k] - p[k];
    }
    largest = tracker_largest(frame[1], 3);
    if (largest == 0 || !tracker_unit(frame[0], 1 << 20))
        return 0;
    for (; largest < (int64_t)1 << 29; largest *= 2)
        for (k = 0; k < 3; k++)
            frame[1][k] *= 2;
    if (!tracker_unit(frame[1], 1))
        return 0;
    tracker_cross(frame[0], frame[1], frame[2]);
    return 1;
}

static void attitude_of(const int64_t seen[3][3], const int64_t known[3][3], struct tracker_matrix *attitude)
{
    int64_t row[3];
    int i, j, k;

    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            row[j] = 0;
            for (k = 0; k < 3; k++)
                row[j] += seen[k][i] * known[k][j];
            row[j] = tracker_shift_right(row[j], 30);
        }
        tracker_to_vector(row, &attitude->row[i]);
    }
}

int64_t tracker_gate_of(int64_t variance, const int32_t *row)
{
    return (tracker_smaller(variance, LARGEST_VARIANCE) >> 8) * row[TRACKER_ROW_GATE2];
}

/* Whether a guide star can be where a star is, according to the prior. */
int tracker_fits_prior(const struct tracker_search *search, int star, int guide, const int32_t *row)
{
    const int64_t radius = search->prior.radius;
    int64_t axis[3], direction[3], seen[3], square = 0;
    int k;

    if (radius == 0 || radius >= ONE_RADIAN)
        return 1;
    for (k = 0; k < 3; k++)
        direction[k] = tracker_guide_direction[guide][k];
    tracker_to_array(&search->direction[star], seen);
    for (k = 0; k < 3; k++) {
        int64_t apart;
        tracker_to_array(&search->prior.attitude.row[k], axis);
        apart = tracker_dot(axis, direction) - seen[k];
        square += apart * apart;
    }
    return square <= 2 * (radius * 4) * (radius * 4) + 4 * tracker_gate_of(search->variance[star], row);
}

int tracker_pair_attitude(const struct tracker_search *search, const int star[2], const uint16_t guide[2],
                          int64_t frame[3][3], struct tracker_matrix *attitude)
{
    int64_t known[3][3], p[3], q[3], u[3], w[3];
    int k;

    tracker_to_array(&search->direction[star[0]], p);
    tracker_to_array(&search->direction[star[1]], q);
    for (k = 0; k < 3; k++) {
        u[k] = tracker_guide_direction[guide[0]][k];
        w[k] = tracker_guide_direction[guide[1]][k];
    }
    if (!pair_frame(p, q, frame) || !pair_frame(u, w, known))
        return 0;
    attitude_of((const int64_t(*)[3])frame, (const int64_t(*)[3])known, attitude);
    return 1;
}
