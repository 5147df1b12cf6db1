/* Attitude filter: propagation at a constant rate, and correction, by the equations of
 * startracker/tracking/kinematics.py. Angles are in units of 2^-20 rad, rates in units per second. */
#include "tracker_attitude_filter.h"

#define ONE ((int64_t)1 << 30)
#define TERMS 8
#define MOST_PARTS 64
#ifdef TRACKER_FLOAT
#define ROUNDING (-24)
#else
#define ROUNDING (-28)
#endif

static tracker_real scaled(tracker_real x, int exponent)
{
    return tracker_times(x, tracker_real_of(1, exponent));
}

tracker_real tracker_square_sum(tracker_real x, tracker_real y, tracker_real z)
{
    const tracker_real sum = tracker_add(tracker_times(x, x), tracker_times(y, y));

    return tracker_add(sum, tracker_times(z, z));
}

/* sum of (-x)^k / (2 k + first)!, x = square. */
static tracker_real series(tracker_real square, int first)
{
    tracker_real total = tracker_zero();
    int k, factorial = 1;

    for (k = TERMS - 1; k >= 0; k--) {
        const tracker_real below = tracker_real_of((2 * k + first + 1) * (2 * k + first + 2), 0);
        total = tracker_subtract(tracker_real_of(1, 0), tracker_over(tracker_times(square, total), below));
    }
    for (k = 2; k <= first; k++)
        factorial *= k;
    return tracker_over(total, tracker_real_of(factorial, 0));
}

static void multiply(const int32_t second[4], const int32_t first[4], int64_t out[4])
{
    const int64_t x1 = second[0], y1 = second[1], z1 = second[2], w1 = second[3];
    const int64_t x2 = first[0], y2 = first[1], z2 = first[2], w2 = first[3];

    out[0] = tracker_shift_right(w1 * x2 + x1 * w2 - y1 * z2 + z1 * y2, 30);
    out[1] = tracker_shift_right(w1 * y2 + y1 * w2 - z1 * x2 + x1 * z2, 30);
    out[2] = tracker_shift_right(w1 * z2 + z1 * w2 - x1 * y2 + y1 * x2, 30);
    out[3] = tracker_shift_right(w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2, 30);
}

void tracker_turn_quaternion(int32_t quaternion[4], const tracker_real angle[3])
{
    const int down = -TRACKER_ANGLE_BITS - 1;
    const tracker_real half[3] = {scaled(angle[0], down), scaled(angle[1], down), scaled(angle[2], down)};
    tracker_real square, share;
    int32_t turn[4];
    int64_t q[4], length;
    int k;

    square = tracker_square_sum(half[0], half[1], half[2]);
    share = series(square, 1);
    for (k = 0; k < 3; k++)
        turn[k] = (int32_t)tracker_integer_of(tracker_times(share, half[k]), 30);
    share = tracker_subtract(tracker_real_of(1, 0), tracker_times(square, series(square, 2)));
    turn[3] = (int32_t)tracker_integer_of(share, 30);
    multiply(turn, quaternion, q);
    length = tracker_square_root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (k = 0; k < 4; k++)
        quaternion[k] = (int32_t)(q[k] * ONE / length);
}

void tracker_rotation_between(const int32_t first[4], const int32_t second[4], tracker_real vector[3])
{
    const int32_t back[4] = {-first[0], -first[1], -first[2], first[3]};
    tracker_real share = tracker_real_of(2, 0), sine;
    int64_t q[4];
    int k;

    multiply(second, back, q);
    for (k = 0; k < 3; k++)
        vector[k] = tracker_real_of(q[3] < 0 ? -q[k] : q[k], -30);
    sine = tracker_real_root(tracker_square_sum(vector[0], vector[1], vector[2]));
    if (tracker_sign(sine) > 0) {
        share = tracker_arctangent(sine, tracker_real_of(tracker_magnitude(q[3]), -30));
        share = tracker_over(scaled(share, 1), sine);
    }
    for (k = 0; k < 3; k++)
        vector[k] = scaled(tracker_times(share, vector[k]), TRACKER_ANGLE_BITS);
}

static tracker_real row_product(const tracker_real *a, const tracker_real *b)
{
    tracker_real total = tracker_zero();
    int k;

    for (k = 0; k < 6; k++)
        total = tracker_add(total, tracker_times(a[k], b[k]));
    return total;
}

/* p becomes A P A' + added, symmetric. A share of the terms is added to the variances, in which the roundings of all are
 * lost: where an attitude is far better known than predicted, a variance of the rate could become negative. */
static void transform(tracker_real a[6][6], tracker_real p[6][6], tracker_real added[6][6])
{
    tracker_real first[6][6], column[6], terms[6];
    int i, j, k;

    for (i = 0; i < 6; i++) {
        terms[i] = tracker_zero();
        for (k = 0; k < 6; k++)
            terms[i] = tracker_add(terms[i], tracker_times(tracker_times(a[i][k], a[i][k]), p[k][k]));
    }
    for (j = 0; j < 6; j++) {
        for (k = 0; k < 6; k++)
            column[k] = p[k][j];
        for (i = 0; i < 6; i++)
            first[i][j] = row_product(a[i], column);
    }
    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++)
            p[i][j] = tracker_add(row_product(first[i], a[j]), added[i][j]);
    for (i = 0; i < 6; i++) {
        for (j = 0; j <= i; j++)
            p[i][j] = p[j][i] = scaled(tracker_add(p[i][j], p[j][i]), -1);
        p[i][i] = tracker_add(p[i][i], scaled(terms[i], ROUNDING));
    }
}

/* A step: its powers 1, t, t^2, t^3, the rate in rad/s, the rotation vector. */
struct powers {
    tracker_real one[4], omega[3], angle[3];
    tracker_real s1, c1, d1, f1, e1;
};

static void make_powers(tracker_real speed, tracker_real dt, struct powers *p)
{
    const tracker_real angle = tracker_times(speed, dt), square = tracker_times(angle, angle);
    const tracker_real dt2 = tracker_times(dt, dt), dt3 = tracker_times(dt2, dt);

    p->one[0] = tracker_real_of(1, 0);
    p->one[1] = dt;
    p->one[2] = dt2;
    p->one[3] = dt3;
    p->s1 = tracker_times(dt, series(square, 1));
    p->c1 = tracker_times(dt2, series(square, 2));
    p->d1 = tracker_times(dt3, series(square, 3));
    p->f1 = tracker_times(tracker_times(dt2, dt2), series(square, 4));
    p->e1 = scaled(tracker_times(tracker_times(dt3, dt2), series(square, 5)), 1);
}

/* a one - b cross + c twice of an element of the identity, of the cross product's matrix and of its square. */
static tracker_real element(tracker_real a, tracker_real b, tracker_real c, tracker_real cross, tracker_real twice)
{
    return tracker_add(tracker_subtract(a, tracker_times(b, cross)), tracker_times(c, twice));
}

static tracker_real signed_as(tracker_real x, int sign)
{
    return sign < 0 ? tracker_minus(x) : x;
}

static void make_transition(const struct powers *p, int sign, const tracker_real psd[3],
                            tracker_real phi[6][6], tracker_real noise[6][6])
{
    const tracker_real zero = tracker_zero(), w = tracker_real_root(tracker_square_sum(p->omega[0], p->omega[1], p->omega[2])), w2 = tracker_times(w, w);
    const tracker_real x = p->omega[0], y = p->omega[1], z = p->omega[2];
    const tracker_real cross[3][3] = {{zero, tracker_minus(z), y}, {z, zero, tracker_minus(x)}, {tracker_minus(y), x, zero}};
    int i, j;

    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++)
            phi[i][j] = noise[i][j] = zero;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            const tracker_real one = tracker_real_of(i == j, 0);
            const tracker_real twice = tracker_subtract(tracker_times(p->omega[i], p->omega[j]), tracker_times(one, w2));
            const tracker_real half = tracker_times(tracker_times(p->one[2], tracker_real_of(1, -1)), one);
            const tracker_real third = tracker_times(tracker_over(p->one[3], tracker_real_of(3, 0)), one);
            tracker_real mixed = element(half, p->d1, p->f1, cross[i][j], twice);
            phi[i][j] = element(one, p->s1, p->c1, cross[i][j], twice);
            phi[i][3 + j] = signed_as(element(tracker_times(p->one[1], one), p->c1, p->d1, cross[i][j], twice), sign);
            mixed = signed_as(tracker_times(psd[1], mixed), sign);
            noise[i][3 + j] = noise[3 + j][i] = mixed;
            noise[i][j] = tracker_times(psd[2], tracker_add(third, tracker_times(p->e1, twice)));
        }
        phi[3 + i][3 + i] = tracker_real_of(1, 0);
        noise[i][i] = tracker_add(noise[i][i], tracker_times(psd[0], p->one[1]));
        noise[3 + i][3 + i] = tracker_times(psd[1], p->one[1]);
    }
}

int tracker_propagate(int32_t quaternion[4], tracker_real covariance[6][6], const tracker_real rate[3], tracker_real step,
                      int sign, const tracker_real psd[3])
{
    tracker_real phi[6][6], noise[6][6], speed, part;
    struct powers p;
    int parts = 1, k;

    for (k = 0; k < 3; k++)
        p.omega[k] = scaled(rate[k], -TRACKER_ANGLE_BITS);
    speed = tracker_real_root(tracker_square_sum(p.omega[0], p.omega[1], p.omega[2]));
    while (tracker_less(tracker_real_of(parts, 0), tracker_times(speed, step))) {
        parts *= 2;
        if (parts > MOST_PARTS)
            return 0;
    }
    part = tracker_over(step, tracker_real_of(parts, 0));
    for (k = 0; k < 3; k++)
        p.angle[k] = tracker_times(rate[k], part);
    make_powers(speed, part, &p);
    make_transition(&p, sign, psd, phi, noise);
    for (k = 0; k < parts; k++) {
        transform(phi, covariance, noise);
        tracker_turn_quaternion(quaternion, p.angle);
    }
    return 1;
}

/* Covariance after the update, in Joseph form. */
static void update_covariance(tracker_real covariance[6][6], tracker_real gain[6][6], tracker_real noise[3][3])
{
    tracker_real left[6][6], wide[6][3], added[6][6], before[6], ignored;
    int i, j, k;

    for (i = 0; i < 6; i++) {
        for (j = 0; j < 6; j++)
            left[i][j] = tracker_real_of(i == j, 0);
        for (j = 0; j < 3; j++) {
            left[i][j] = tracker_subtract(left[i][j], gain[i][j]);
            wide[i][j] = tracker_zero();
            for (k = 0; k < 3; k++)
                wide[i][j] = tracker_add(wide[i][j], tracker_times(gain[i][k], noise[k][j]));
        }
    }
    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++) {
            added[i][j] = tracker_times(wide[i][0], gain[j][0]);
            for (k = 1; k < 3; k++)
                added[i][j] = tracker_add(added[i][j], tracker_times(wide[i][k], gain[j][k]));
        }
    for (i = 3; i < 6; i++)
        before[i] = covariance[i][i];
    transform(left, covariance, added);
    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++)
            left[i][j] = covariance[i][j];
    if (tracker_factorise(left, 6, &ignored))
        return;
    for (i = 3; i < 6; i++) /* nothing but rounding is left of them */
        covariance[i][i] = tracker_add(covariance[i][i], scaled(before[i], ROUNDING + 6));
}

int tracker_correct(tracker_real covariance[6][6], const tracker_real innovation[3], tracker_real noise[3][3], int keep,
                    struct tracker_correction *correction)
{
    tracker_real spread[6][6], gain[6][6], ignored;
    int i, j, k;

    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            spread[i][j] = tracker_add(covariance[i][j], noise[i][j]);
    if (!tracker_factorise(spread, 3, &ignored))
        return 0;
    correction->distance2 = tracker_zero();
    for (k = 0; k < 3; k++) {
        correction->white[k] = innovation[k];
        for (j = 0; j < k; j++)
            correction->white[k] = tracker_subtract(correction->white[k], tracker_times(spread[k][j], correction->white[j]));
    }
    for (k = 0; k < 3; k++) {
        correction->white[k] = tracker_times(correction->white[k], tracker_real_root(spread[k][k]));
        correction->distance2 = tracker_add(correction->distance2, tracker_times(correction->white[k], correction->white[k]));
    }
    for (i = 0; i < 6; i++) {
        for (k = 0; k < 6; k++)
            gain[i][k] = covariance[i][k];
        tracker_solve_factorised(spread, 3, gain[i]);
        correction->change[i] = tracker_times(gain[i][0], innovation[0]);
        for (k = 1; k < 3; k++)
            correction->change[i] = tracker_add(correction->change[i], tracker_times(gain[i][k], innovation[k]));
    }
    if (keep)
        update_covariance(covariance, gain, noise);
    return 1;
}
