/* The motion that the trails of a frame share. */
#include "tracker_front_internal.h"

#define FEWEST_AGREEING 4 /* trails that make a motion, */
#define FEWEST_TURNED 8   /* and that show whether the camera turns about its boresight */
#define ROUNDS 3
#define LARGEST_SHARE 4
#define FASTEST_TURN ((int64_t)1 << 26)

void tracker_front_motion_at(const struct tracker_front_motion *motion, int64_t x, int64_t y, int64_t along[2])
{
    int64_t right = tracker_shift_right(x, 15) - TRACKER_WIDTH, down = tracker_shift_right(y, 15) - TRACKER_HEIGHT;

    along[0] = motion->along_x - tracker_shift_right(motion->turn * down, 20);
    along[1] = motion->along_y + tracker_shift_right(motion->turn * right, 20);
}

/* A length along both axes in the sense of the motion at a trail, and the motion's there. */
static void turned(const struct tracker_front_trail *trail, int32_t x, int32_t y, const struct tracker_front_motion *motion,
                   int64_t own[2], int64_t along[2])
{
    tracker_front_motion_at(motion, trail->x, trail->y, along);
    own[0] = x;
    own[1] = y;
    if (own[0] * along[0] + own[1] * along[1] < 0) {
        own[0] = -own[0];
        own[1] = -own[1];
    }
}

/* To 1 px and a fifth of its length. */
static int is_near(const int64_t own[2], const int64_t along[2])
{
    const int64_t limit = 256 + tracker_square_root(along[0] * along[0] + along[1] * along[1]) / 5;
    const int64_t x = own[0] - along[0], y = own[1] - along[1];

    return x * x + y * y <= limit * limit;
}

int tracker_front_agrees(const struct tracker_front_trail *trail, const struct tracker_front_motion *motion)
{
    int64_t own[2], along[2];

    turned(trail, trail->along_x, trail->along_y, motion, own, along);
    return is_near(own, along);
}

static int has_own(const struct tracker_front_trail *trail)
{
    return trail->own_x != 0 || trail->own_y != 0;
}

/* The motion, by least squares over the trails whose own lengths agree with it. */
static void fit_motion(const struct tracker_front *front, struct tracker_front_motion *motion)
{
    int64_t own[2], along[2], x, y, sx = 0, sy = 0, ax = 0, ay = 0, moment = 0, square = 0, below, turn = 0;
    const struct tracker_front_trail *trail;
    int n, count = 0;

    for (n = 0; n < front->trails; n++) {
        trail = &front->trail[n];
        turned(trail, trail->own_x, trail->own_y, motion, own, along);
        if (!has_own(trail) || !is_near(own, along))
            continue;
        x = tracker_shift_right(trail->x, 15) - TRACKER_WIDTH;
        y = tracker_shift_right(trail->y, 15) - TRACKER_HEIGHT;
        sx += x;
        sy += y;
        ax += own[0];
        ay += own[1];
        moment += own[1] * x - own[0] * y;
        square += x * x + y * y;
        count++;
    }
    if (count < FEWEST_AGREEING)
        return;
    below = count * square - sx * sx - sy * sy;
    if (count >= FEWEST_TURNED)
        turn = tracker_floor_quotient((count * moment - sx * ay + sy * ax) * ((int64_t)1 << 20), below > 1 ? below : 1);
    turn = turn < -FASTEST_TURN ? -FASTEST_TURN : turn > FASTEST_TURN ? FASTEST_TURN : turn;
    motion->along_x = (int32_t)tracker_floor_quotient(ax + tracker_shift_right(turn * sy, 20), count);
    motion->along_y = (int32_t)tracker_floor_quotient(ay - tracker_shift_right(turn * sx, 20), count);
    motion->turn = (int32_t)turn;
}

/* The middle of the trails' own lengths along an axis, in the sense of the brightest, by their light: broken trails, which
 * have pieces of all lengths, are faint. No trail counts more than LARGEST_SHARE times as much as the one of middle light. */
static int32_t middle_along(const struct tracker_front *front, int axis)
{
    int32_t values[TRACKER_MAX_STARS] = {0}, value;
    int64_t weights[TRACKER_MAX_STARS] = {0}, weight, most = (int64_t)LARGEST_SHARE * front->trail[front->trails / 2].flux;
    int64_t total = 0, below = 0;
    const struct tracker_front_trail *first = &front->trail[0], *trail;
    int n, k, count = 0;

    for (n = 0; n < front->trails; n++) {
        trail = &front->trail[n];
        if (!has_own(trail))
            continue;
        value = axis == 0 ? trail->own_x : trail->own_y;
        if ((int32_t)trail->own_x * first->along_x + (int32_t)trail->own_y * first->along_y < 0)
            value = -value;
        weight = tracker_smaller(trail->flux, most);
        total += weight;
        for (k = count++; k > 0 && values[k - 1] > value; k--) {
            values[k] = values[k - 1];
            weights[k] = weights[k - 1];
        }
        values[k] = value;
        weights[k] = weight;
    }
    for (k = 0; k < count - 1; k++) {
        below += weights[k];
        if (2 * below > total)
            break;
    }
    return values[k];
}

/* The motion that at least four of the trails, and a third of them, share. */
static void find_motion(struct tracker_front *front)
{
    struct tracker_front_motion *motion = &front->motion;
    int n, count = 0;

    motion->known = 0;
    if (front->trails < FEWEST_AGREEING)
        return;
    motion->along_x = middle_along(front, 0);
    motion->along_y = middle_along(front, 1);
    motion->turn = 0;
    for (n = 0; n < ROUNDS; n++)
        fit_motion(front, motion);
    for (n = 0; n < front->trails; n++)
        count += tracker_front_agrees(&front->trail[n], motion);
    motion->known = count >= FEWEST_AGREEING && 3 * count >= front->trails;
}

/* ------------------------------------------------------------------ the list */

/* Whether the middle of a trail is on another one, or not far beyond its ends. */
static int lies_on(const struct tracker_front_trail *one, const struct tracker_front_trail *other)
{
    int64_t x = tracker_shift_right((int64_t)one->x - other->x, 8), y = tracker_shift_right((int64_t)one->y - other->y, 8);
    int64_t along = x * other->along_x + y * other->along_y, across = x * other->along_y - y * other->along_x;
    int64_t square = (int64_t)other->along_x * other->along_x + (int64_t)other->along_y * other->along_y;

    return tracker_magnitude(along) * 4 <= 3 * square && tracker_magnitude(across) < INT32_MAX / 2
           && across * across <= square * 9 * 65536;
}

static int is_brighter(const struct tracker_front_trail *a, const struct tracker_front_trail *b)
{
    if (a->flux != b->flux)
        return a->flux > b->flux;
    return a->y != b->y ? a->y < b->y : a->x < b->x;
}

static int is_same(const struct tracker_front_trail *a, const struct tracker_front_trail *b)
{
    return lies_on(a, b) || lies_on(b, a);
}

/* Adds a trail, unless it is on one that has more light; those that have less are left out. */
void tracker_front_add_trail(struct tracker_front *front, const struct tracker_front_trail *trail)
{
    struct tracker_front_trail *list = front->trail;
    int n, left = 0;

    for (n = 0; n < front->trails; n++)
        if (is_same(trail, &list[n]) && !is_brighter(trail, &list[n]))
            return;
    for (n = 0; n < front->trails; n++)
        if (!is_same(trail, &list[n]))
            list[left++] = list[n];
    front->trails = left;
    if (left < TRACKER_MAX_STARS || is_brighter(trail, &list[left - 1])) {
        n = left < TRACKER_MAX_STARS ? front->trails++ : left - 1;
        for (; n > 0 && is_brighter(trail, &list[n - 1]); n--)
            list[n] = list[n - 1];
        list[n] = *trail;
    }
    find_motion(front);
}
