/* Directions of star images, positions in the tangent plane, and aberration.
 *
 * A table holds the tangent-plane position of a grid of pixels, for whatever projection and distortion the camera has;
 * between them it is interpolated by cubic polynomials through four nodes in each direction. The plane touches the sphere
 * at the camera's axis z: (u, v) = F (X/Z, Y/Z), with F the focal length along the columns for both axes. */
#include "tracker_directions.h"

#include "tracker_integers.h"

#define ONE ((int64_t)1 << 30)
#define HALF_PX 32768
#define WEIGHT_BITS 26
#define CELL ((int64_t)1 << 26)
#define LEAST_LENGTH (1 << 16)
#define MOST_STEPS 8
#define CLOSE 64        /* 0.001 px */
#define LEAST_AREA 8192 /* of a pixel in the plane, 16 fraction bits: 1/8 */

static void to_array(const struct tracker_vector *vector, int64_t out[3])
{
    out[0] = vector->x;
    out[1] = vector->y;
    out[2] = vector->z;
}

static void to_vector(const int64_t v[3], struct tracker_vector *out)
{
    out->x = (int32_t)v[0];
    out->y = (int32_t)v[1];
    out->z = (int32_t)v[2];
}

/* First of four nodes around a position in cells of 26 fraction bits, and their weights, whose sum is one. */
static int weights(int64_t position, int nodes, int64_t out[4])
{
    int64_t first = tracker_shift_right(position, 26) - 1, a, b, c, d;

    if (first < 0)
        first = 0;
    if (first > nodes - 4)
        first = nodes - 4;
    a = position - first * CELL;
    b = a - CELL;
    c = a - 2 * CELL;
    d = a - 3 * CELL;
    out[0] = -(tracker_shift_right(b * c, 26) * d) / (6 * CELL);
    out[2] = -(tracker_shift_right(a * b, 26) * d) / (2 * CELL);
    out[3] = tracker_shift_right(a * b, 26) * c / (6 * CELL);
    out[1] = CELL - out[0] - out[2] - out[3];
    return (int)first;
}

static void interpolate(int32_t x, int32_t y, int32_t plane[2])
{
    int64_t across[4], down[4];
    const int column = weights(tracker_shift_right(((int64_t)x + HALF_PX) * TRACKER_GRID_SCALE_X, 20), TRACKER_GRID_COLUMNS, across);
    const int row = weights(tracker_shift_right(((int64_t)y + HALF_PX) * TRACKER_GRID_SCALE_Y, 20), TRACKER_GRID_ROWS, down);
    int i, j, k;

    for (k = 0; k < 2; k++) {
        int64_t total = 0;
        for (i = 0; i < 4; i++) {
            int64_t along = 0;
            for (j = 0; j < 4; j++)
                along += across[j] * tracker_grid_plane[row + i][column + j][k];
            total += down[i] * tracker_shift_right(along, WEIGHT_BITS);
        }
        plane[k] = (int32_t)tracker_shift_right(total + CELL / 2, WEIGHT_BITS);
    }
}

int tracker_plane_of(int32_t x, int32_t y, int32_t plane[2])
{
    if (x < -HALF_PX || y < -HALF_PX || x >= TRACKER_GRID_WIDTH * 65536 - HALF_PX || y >= TRACKER_GRID_HEIGHT * 65536 - HALF_PX)
        return 0;
    interpolate(x, y, plane);
    return 1;
}

void tracker_slopes_of(int32_t x, int32_t y, int32_t slopes[2][2])
{
    int32_t before[2], after[2];
    int axis, k;

    for (axis = 0; axis < 2; axis++) {
        interpolate(x - HALF_PX * (1 - axis), y - HALF_PX * axis, before);
        interpolate(x + HALF_PX * (1 - axis), y + HALF_PX * axis, after);
        for (k = 0; k < 2; k++)
            slopes[k][axis] = after[k] - before[k];
    }
}

/* Newton's method from the middle of the image. Every step ends on the image, so that what is beyond it ends at its edge. */
int tracker_image_of(const int32_t plane[2], int32_t xy[2])
{
    const int64_t size[2] = {TRACKER_GRID_WIDTH, TRACKER_GRID_HEIGHT};
    int32_t slopes[2][2], here[2];
    int64_t away[2], area, moved;
    int step, k;

    for (k = 0; k < 2; k++)
        xy[k] = (int32_t)(size[k] * HALF_PX - HALF_PX);
    for (step = 0; step < MOST_STEPS; step++) {
        interpolate(xy[0], xy[1], here);
        for (k = 0; k < 2; k++)
            away[k] = (int64_t)plane[k] - here[k];
        if (tracker_largest(away, 2) < CLOSE)
            return 1;
        tracker_slopes_of(xy[0], xy[1], slopes);
        area = tracker_shift_right((int64_t)slopes[0][0] * slopes[1][1] - (int64_t)slopes[0][1] * slopes[1][0], 16);
        if (tracker_magnitude(area) < LEAST_AREA)
            return 0;
        for (k = 0; k < 2; k++) {
            moved = (slopes[1 - k][1 - k] * away[k] - slopes[k][1 - k] * away[1 - k]) / area;
            xy[k] = (int32_t)tracker_limited(xy[k] + moved, -HALF_PX, size[k] * 65536 - HALF_PX - 1);
        }
    }
    return 0;
}

void tracker_vector_of(const int32_t plane[2], struct tracker_vector *vector)
{
    int64_t v[3];

    v[0] = (int64_t)plane[0] * TRACKER_GRID_UP;
    v[1] = (int64_t)plane[1] * TRACKER_GRID_UP;
    v[2] = (int64_t)TRACKER_GRID_FOCAL * TRACKER_GRID_UP;
    (void)tracker_unit(v, 1);
    to_vector(v, vector);
}

int tracker_star_vector(const struct tracker_star *star, struct tracker_vector *vector)
{
    int32_t plane[2];

    if (!tracker_plane_of(star->x, star->y, plane))
        return 0;
    tracker_vector_of(plane, vector);
    return 1;
}

int tracker_project(const struct tracker_matrix *attitude, const struct tracker_vector *direction, int32_t plane[2])
{
    int64_t row[3], d[3], along[3];
    int k;

    to_array(direction, d);
    for (k = 0; k < 3; k++) {
        to_array(&attitude->row[k], row);
        along[k] = tracker_dot(row, d);
    }
    if (along[2] <= 0 || tracker_magnitude(along[0]) > along[2] || tracker_magnitude(along[1]) > along[2])
        return 0;
    for (k = 0; k < 2; k++)
        plane[k] = (int32_t)(along[k] * TRACKER_GRID_FOCAL / along[2]);
    return 1;
}

void tracker_aberrate(const struct tracker_vector *direction, const struct tracker_vector *velocity,
                      struct tracker_vector *apparent)
{
    int64_t d[3], v[3], slower, share;
    int k;

    to_array(direction, d);
    to_array(velocity, v);
    slower = ONE - tracker_shift_right(tracker_dot(v, v), 1);
    share = ONE + tracker_shift_right(tracker_dot(d, v), 1);
    for (k = 0; k < 3; k++)
        d[k] = tracker_shift_right(d[k] * slower + v[k] * share, 30);
    (void)tracker_unit(d, 1);
    to_vector(d, apparent);
}

void tracker_apparent(const int32_t direction[3], const int16_t motion[3], const struct tracker_observer *observer,
                      struct tracker_vector *apparent)
{
    const struct tracker_vector *velocity = &observer->velocity;
    int64_t moved[3];
    int k;

    for (k = 0; k < 3; k++)
        moved[k] = direction[k] + tracker_shift_right((int64_t)motion[k] * observer->years, 15);
    to_vector(moved, apparent);
    if (velocity->x != 0 || velocity->y != 0 || velocity->z != 0)
        tracker_aberrate(apparent, velocity, apparent);
}

int tracker_turn(struct tracker_matrix *attitude, int64_t x, int64_t y, int64_t z)
{
    int64_t row[3][3], first[3], third[3], along;
    int k;

    for (k = 0; k < 3; k++)
        to_array(&attitude->row[k], row[k]);
    for (k = 0; k < 3; k++) {
        first[k] = row[0][k] + tracker_shift_right(z * row[1][k] - y * row[2][k], 30);
        third[k] = row[2][k] + tracker_shift_right(y * row[0][k] - x * row[1][k], 30);
    }
    if (!tracker_unit(third, LEAST_LENGTH))
        return 0;
    along = tracker_dot(first, third);
    for (k = 0; k < 3; k++)
        first[k] -= tracker_shift_right(along * third[k], 30);
    if (!tracker_unit(first, LEAST_LENGTH))
        return 0;
    tracker_cross(third, first, row[1]);
    to_vector(first, &attitude->row[0]);
    to_vector(row[1], &attitude->row[1]);
    to_vector(third, &attitude->row[2]);
    return 1;
}

void tracker_quaternion_of(const struct tracker_matrix *attitude, int32_t quaternion[4])
{
    int64_t m[3][3], q[4], square[4], length;
    int k, at = 3;

    for (k = 0; k < 3; k++)
        to_array(&attitude->row[k], m[k]);
    /* four times the squares of the components: the largest is at least one */
    square[3] = ONE + m[0][0] + m[1][1] + m[2][2];
    for (k = 0; k < 3; k++) {
        square[k] = ONE + 2 * m[k][k] - (m[0][0] + m[1][1] + m[2][2]);
        if (square[k] > square[at])
            at = k;
    }
    if (at == 3) {
        q[3] = square[3];
        for (k = 0; k < 3; k++)
            q[k] = m[(k + 1) % 3][(k + 2) % 3] - m[(k + 2) % 3][(k + 1) % 3];
    } else {
        const int next = (at + 1) % 3, last = (at + 2) % 3;
        q[at] = square[at];
        q[next] = m[at][next] + m[next][at];
        q[last] = m[at][last] + m[last][at];
        q[3] = m[next][last] - m[last][next];
    }
    for (k = 0; k < 4; k++)
        q[k] = tracker_shift_right(q[k], 2);
    length = tracker_square_root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (k = 0; k < 4; k++)
        quaternion[k] = (int32_t)((q[3] < 0 ? -q[k] : q[k]) * ONE / length);
}
