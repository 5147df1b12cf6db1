/* Roots, arctangents, separations and angles in integers. Right shifts of negative numbers, which C99 leaves to the
 * compiler, are made of shifts of positive ones. */
#include "tracker_internal.h"

int64_t tracker_shift_right(int64_t value, int bits)
{
    return value >= 0 ? value >> bits : ~(~value >> bits);
}

int64_t tracker_floor_quotient(int64_t n, int64_t positive)
{
    return n >= 0 ? n / positive : -((-n + positive - 1) / positive);
}

int64_t tracker_square_root(int64_t n)
{
    int64_t x = 1, left = n, lower;

    if (n == 0)
        return 0;
    while (left > 0) {
        x *= 2;
        left >>= 2;
    }
    for (;;) {
        lower = (x + n / x) >> 1;
        if (lower >= x)
            return x;
        x = lower;
    }
}

int64_t tracker_fine_angle(int64_t y, int64_t x)
{
    int64_t largest = y < 0 ? -y : y, other = x < 0 ? -x : x, angle = 0, turned;
    int k;

    if (other > largest)
        largest = other;
    if (largest == 0)
        return 0;
    while (largest < (int64_t)1 << 58) {
        largest *= 2;
        y *= 2;
        x *= 2;
    }
    if (x < 0) {
        y = -y;
        x = -x;
        angle = (int64_t)180 << 40;
    }
    for (k = 0; k < TRACKER_ROTATIONS; k++) {
        if (y > 0) {
            turned = y - (x >> k);
            x = x + (y >> k);
            angle += tracker_rotation_step[k];
        } else {
            turned = y + (x >> k);
            x = x - tracker_shift_right(y, k);
            angle -= tracker_rotation_step[k];
        }
        y = turned;
    }
    return angle;
}

int32_t tracker_direction(int64_t y, int64_t x)
{
    int64_t along = (x < 0 ? -x : x) >> 8, across = (y < 0 ? -y : y) >> 8;
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
    int32_t place;

    if (chi > 32767 || psi > 32767)
        return -1;
    plane = tracker_square_root(chi * chi + psi * psi);
    if (plane <= TRACKER_CROSSOVER)
        return (int)plane;
    place = (int32_t)(((uint32_t)tracker_cosine[chi] * tracker_cosine[psi]) >> 15) - TRACKER_ARCCOSINE_DISCARDED;
    return place < 0 ? -1 : tracker_arccosine[place];
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

static int64_t dot(const int64_t a[3], const int64_t b[3])
{
    return tracker_shift_right(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 30);
}

int32_t tracker_catalog_angle(int vertex, int first, int second)
{
    int64_t v[3], u[3], w[3], cross[3], sine, cosine;
    int k;

    for (k = 0; k < 3; k++) {
        v[k] = tracker_star_direction[vertex][k];
        u[k] = tracker_star_direction[first][k] - v[k];
        w[k] = tracker_star_direction[second][k] - v[k];
    }
    for (k = 0; k < 3; k++)
        cross[k] = tracker_shift_right(u[(k + 1) % 3] * w[(k + 2) % 3] - u[(k + 2) % 3] * w[(k + 1) % 3], 30);
    sine = dot(cross, v);
    cosine = dot(u, w) - tracker_shift_right(dot(u, v) * dot(w, v), 30);
    return (int32_t)tracker_shift_right(tracker_fine_angle(sine < 0 ? -sine : sine, cosine), 34);
}
