/* Angles of vectors in integers by CORDIC (Volder 1959): rotations by arctangents of powers of two. */
#include "tracker_cordic.h"

#include "tracker_integers.h"
#include "tracker_tables.h"

int64_t tracker_fine_angle(int64_t y, int64_t x)
{
    int64_t largest = tracker_magnitude(y), angle = 0, turned;
    int k;

    if (tracker_magnitude(x) > largest)
        largest = tracker_magnitude(x);
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

int32_t tracker_inner_angle(const int64_t vertex[3], const int64_t first[3], const int64_t second[3])
{
    int64_t u[3], w[3], normal[3], sine, cosine;
    int k;

    for (k = 0; k < 3; k++) {
        u[k] = first[k] - vertex[k];
        w[k] = second[k] - vertex[k];
    }
    tracker_cross(u, w, normal);
    sine = tracker_dot(normal, vertex);
    cosine = tracker_dot(u, w) - tracker_shift_right(tracker_dot(u, vertex) * tracker_dot(w, vertex), 30);
    return (int32_t)tracker_shift_right(tracker_fine_angle(tracker_magnitude(sine), cosine), 34);
}

int32_t tracker_modulo_turn(int32_t angle)
{
    angle %= TRACKER_FULL_TURN;
    return angle < 0 ? angle + TRACKER_FULL_TURN : angle;
}

int32_t tracker_turn_between(int32_t first, int32_t second)
{
    return tracker_modulo_turn(first - second + TRACKER_FULL_TURN / 2) - TRACKER_FULL_TURN / 2;
}
