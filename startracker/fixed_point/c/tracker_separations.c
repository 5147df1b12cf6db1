/* Separations and angles of stars in integers, from tables. */
#include "tracker_internal.h"

int32_t tracker_direction(int64_t y, int64_t x)
{
    int64_t along = tracker_magnitude(x) >> 8, across = tracker_magnitude(y) >> 8;
    int64_t length = tracker_square_root(along * along + across * across);
    int32_t angle;

    if (length == 0)
        angle = 0;
    else if (along >= across)
        angle = 90 * 64 - tracker_quadrant[(across << 15) / length];
    else
        angle = tracker_quadrant[(along << 15) / length];
    if (x < 0)
        angle = 180 * 64 - angle;
    if (y < 0)
        angle = TRACKER_FULL_TURN - angle;
    return angle % TRACKER_FULL_TURN;
}

int tracker_image_separation(int64_t chi, int64_t psi)
{
    int64_t plane;
    int32_t entry;

    if (chi > 32767 || psi > 32767)
        return -1;
    plane = tracker_square_root(chi * chi + psi * psi);
    if (plane <= TRACKER_CROSSOVER)
        return (int)plane;
    entry = (int32_t)(((uint32_t)tracker_cosine[chi] * tracker_cosine[psi]) >> 15) - TRACKER_ARCCOSINE_DISCARDED;
    return entry < 0 ? -1 : tracker_arccosine[entry];
}

static int64_t length(const int64_t v[3])
{
    int64_t sum = 0, half;
    int k;

    for (k = 0; k < 3; k++) {
        half = tracker_shift_right(v[k], 1);
        sum += half * half;
    }
    return tracker_square_root(sum);
}

int32_t tracker_catalog_separation(int a, int b)
{
    int64_t difference[3], sum[3];
    int k;

    for (k = 0; k < 3; k++) {
        difference[k] = (int64_t)tracker_star_direction[a][k] - tracker_star_direction[b][k];
        sum[k] = (int64_t)tracker_star_direction[a][k] + tracker_star_direction[b][k];
    }
    return (int32_t)tracker_shift_right(tracker_fine_angle(length(difference), length(sum)), 29);
}

int32_t tracker_catalog_angle(int vertex, int first, int second)
{
    int64_t v[3], p[3], q[3];
    int k;

    for (k = 0; k < 3; k++) {
        v[k] = tracker_star_direction[vertex][k];
        p[k] = tracker_star_direction[first][k];
        q[k] = tracker_star_direction[second][k];
    }
    return tracker_inner_angle(v, p, q);
}
