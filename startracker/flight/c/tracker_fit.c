/* Position, flux and variance of a star by maximum likelihood: Fisher scoring, a fixed number of steps. */
#include "tracker_front_internal.h"

#define SIDE TRACKER_FRONT_SIDE
#define HALF TRACKER_FRONT_HALF
#define ITERATIONS 8
#define NODES 8
#define NEIGHBOUR 10 /* pixels along each axis within which the light of another star is subtracted */
#define LONGEST_STEP (1 << 15)
#define FARTHEST (5 << 15)  /* from the middle of the stamp, 16 fraction bits */
#define CONVERGED (1 << 11) /* longest last step, 16 fraction bits: the next is far shorter */
#define LEAST_FLUX 16
#define MOST_FLUX (1 << 28)
#define HOT_ODDS (9 << 8)   /* twice the logarithm of the odds of a star against a hot pixel: 10 stars a hot pixel, 10 times */
#define MOST (((int64_t)1 << 62) - 1)

/* What a fit knows of its star. */
struct fitted {
    const struct tracker_front_candidate *candidate;
    struct tracker_front_measures *measures;
    int first, last;               /* columns and rows of the window in the stamp */
    int64_t photon, flat, square;  /* of the noise */
    int64_t ceiling;               /* pixels from here on are left out, DN of 8 fraction bits */
    int32_t used;                  /* pixels */
};

/* Sums over the window. */
struct normal {
    int64_t matrix[6];             /* of image and its slopes: pp, px, py, xx, yy, xy */
    int64_t score[3];
    int scale, shift;              /* by which they were shifted right */
};

/* value 2^bits, rounded down; at most 2^62 - 1 in magnitude. */
static int64_t scaled(int64_t value, int bits)
{
    if (bits <= 0)
        return tracker_shift_right(value, bits < -62 ? 62 : -bits);
    bits = bits > 62 ? 62 : bits;
    if (tracker_magnitude(value) > MOST >> bits)
        return value > 0 ? MOST : -MOST;
    return value * ((int64_t)1 << bits);
}

static int is_used(const struct fitted *fitted, int column, int row)
{
    return tracker_front_inside(fitted->candidate, column, row)
           && (int64_t)fitted->candidate->stamp[row * SIDE + column] * 256 < fitted->ceiling;
}

/* ------------------------------------------------------------------ the star image */

int32_t tracker_front_entry(const uint16_t *table, int64_t away)
{
    int32_t index, part;

    if (away >= (int64_t)TRACKER_FRONT_LAST_PROFILE << 10)
        return table[TRACKER_FRONT_LAST_PROFILE];
    index = (int32_t)(away >> 10);
    part = (int32_t)(away & 1023);
    return ((int32_t)table[index] * (1024 - part) + (int32_t)table[index + 1] * part) >> 10;
}

/* Shares of the pixels of an axis in an image off the middle, and their slopes. */
static void profile(int32_t offset, int32_t inverse, int32_t share[SIDE], int32_t slope[SIDE])
{
    int64_t away;
    int32_t edge, integral, density, last_integral = 0, last_density = 0;
    int k;

    for (k = 0; k <= SIDE; k++) {
        edge = (k - HALF) * 65536 - 32768 - offset;
        away = (tracker_magnitude(edge) * inverse) >> 12;
        integral = tracker_front_entry(tracker_front_profile, away);
        integral = edge < 0 ? -integral : integral;
        density = (tracker_front_entry(tracker_front_density, away) * inverse) >> 12;
        if (k > 0) {
            share[k - 1] = integral - last_integral;
            slope[k - 1] = last_density - density;
        }
        last_integral = integral;
        last_density = density;
    }
}

/* Image and slopes in the stamp's pixels, at a position. */
static void make_images(const struct fitted *fitted, int32_t x, int32_t y)
{
    struct tracker_front_measures *m = fitted->measures;
    int32_t share_x[SIDE], share_y[SIDE], slope_x[SIDE], slope_y[SIDE], steps;
    int moved = m->trail_x != 0 || m->trail_y != 0, nodes = moved ? NODES : 1, less = moved ? 3 : 0;
    int node, i, j, k;

    for (node = 0; node < nodes; node++) {
        steps = 2 * node - nodes + 1;
        profile(x + (int32_t)tracker_shift_right((int64_t)steps * m->trail_x, 1), m->inverse_x, share_x, slope_x);
        profile(y + (int32_t)tracker_shift_right((int64_t)steps * m->trail_y, 1), m->inverse_y, share_y, slope_y);
        for (j = fitted->first; j <= fitted->last; j++)
            for (i = fitted->first; i <= fitted->last; i++) {
                k = j * SIDE + i;
                if (node == 0)
                    m->image[0][k] = m->image[1][k] = m->image[2][k] = 0;
                m->image[0][k] += (share_x[i] * share_y[j]) >> less;
                m->image[1][k] += (int32_t)tracker_shift_right(slope_x[i] * share_y[j], less);
                m->image[2][k] += (int32_t)tracker_shift_right(share_x[i] * slope_y[j], less);
            }
    }
    for (j = fitted->first; j <= fitted->last; j++)
        for (i = fitted->first; i <= fitted->last; i++)
            for (k = 0; k < 3; k++)
                m->image[k][j * SIDE + i] = (int32_t)tracker_shift_right(m->image[k][j * SIDE + i], 15);
}

/* ------------------------------------------------------------------ sums */

/* 2^19 x the dark variance over that of a pixel with a light, DN of 4 fraction bits. */
static int64_t weight_of(const struct fitted *fitted, int32_t light)
{
    const int64_t uneven = tracker_smaller(((int64_t)light * TRACKER_FRONT_FLAT) >> 16, 1 << 16);
    const int64_t ratio = tracker_smaller(4096 + ((light * fitted->photon) >> 20) + ((uneven * uneven * fitted->flat) >> 20), INT32_MAX);

    return (int64_t)(((uint32_t)1 << 31) / (uint32_t)ratio);
}

static int32_t light_at(const struct fitted *fitted, int32_t flux, int k)
{
    return (int32_t)(((int64_t)flux * fitted->measures->image[0][k]) >> 15);
}

static void sum_pixels(const struct fitted *fitted, int32_t flux, struct normal *normal)
{
    const struct tracker_front_measures *m = fitted->measures;
    int64_t weight, p, x, y, left;
    int32_t light;
    int i, j, k;

    for (k = 0; k < 6; k++)
        normal->matrix[k] = 0;
    for (k = 0; k < 3; k++)
        normal->score[k] = 0;
    for (j = fitted->first; j <= fitted->last; j++)
        for (i = fitted->first; i <= fitted->last; i++) {
            if (!is_used(fitted, i, j))
                continue;
            k = j * SIDE + i;
            light = light_at(fitted, flux, k);
            weight = weight_of(fitted, light);
            left = (int64_t)m->data[k] - light;
            p = weight * m->image[0][k];
            x = weight * m->image[1][k];
            y = weight * m->image[2][k];
            normal->matrix[0] += p * m->image[0][k];
            normal->matrix[1] += p * m->image[1][k];
            normal->matrix[2] += p * m->image[2][k];
            normal->matrix[3] += x * m->image[1][k];
            normal->matrix[4] += y * m->image[2][k];
            normal->matrix[5] += x * m->image[2][k];
            normal->score[0] += p * left;
            normal->score[1] += x * left;
            normal->score[2] += y * left;
        }
    normal->scale = tracker_thirty_bits(normal->matrix, 6);
    normal->shift = tracker_thirty_bits(normal->score, 3);
}

/* Marginalises the flux: xx, yy, xy and the determinant; 0: not possible. */
static int marginalise(struct normal *normal, int64_t *determinant)
{
    int64_t *m = normal->matrix, pp = m[0] > 1 ? m[0] : 1;
    int usable = m[0] > 0;

    m[3] -= m[1] * m[1] / pp;
    m[4] -= m[2] * m[2] / pp;
    m[5] -= tracker_floor_quotient(m[1] * m[2], pp);
    *determinant = m[3] * m[4] - m[5] * m[5];
    return usable && *determinant >= 1 << 20 && m[3] + m[4] > 0;
}

/* One step of position and flux; the longer of the position's components. */
static int32_t move(struct tracker_front_fit *fit, const struct normal *normal, int64_t determinant)
{
    const int64_t *m = normal->matrix, pp = m[0] > 1 ? m[0] : 1, positive = determinant >> 20;
    int64_t rx = normal->score[1] - tracker_floor_quotient(m[1] * normal->score[0], pp);
    int64_t ry = normal->score[2] - tracker_floor_quotient(m[2] * normal->score[0], pp);
    int64_t dx = tracker_floor_quotient(m[4] * rx - m[5] * ry, positive);
    int64_t dy = tracker_floor_quotient(m[3] * ry - m[5] * rx, positive);
    int64_t more = tracker_floor_quotient(normal->score[0] * ((int64_t)1 << 30), pp);

    dx = tracker_floor_quotient(scaled(dx, 11 + normal->shift - normal->scale), fit->flux);
    dy = tracker_floor_quotient(scaled(dy, 11 + normal->shift - normal->scale), fit->flux);
    dx = tracker_limited(dx, -LONGEST_STEP, LONGEST_STEP);
    dy = tracker_limited(dy, -LONGEST_STEP, LONGEST_STEP);
    more = scaled(more, normal->shift - normal->scale - 15);
    more = tracker_limited(more, -(((int64_t)fit->flux + 1) / 2), fit->flux);
    fit->x = (int32_t)tracker_limited(fit->x + dx, -FARTHEST - 1, FARTHEST + 1);
    fit->y = (int32_t)tracker_limited(fit->y + dy, -FARTHEST - 1, FARTHEST + 1);
    fit->flux = (int32_t)tracker_limited(fit->flux + more, LEAST_FLUX, MOST_FLUX);
    dx = tracker_magnitude(dx);
    dy = tracker_magnitude(dy);
    return (int32_t)(dx > dy ? dx : dy);
}

/* ------------------------------------------------------------------ results */

/* Half the trace of the inverse information matrix. */
static int64_t variance_of(const struct fitted *fitted, int32_t flux, const struct normal *normal, int64_t determinant)
{
    int64_t ratio = tracker_limited(((int64_t)fitted->candidate->noise << 24) / flux, 0, (1 << 30) - 1);
    int64_t square = ratio * ratio, information = determinant / (normal->matrix[3] + normal->matrix[4]);
    int shift = 18 - normal->scale, k;

    for (k = 0; k < 62 && square < (int64_t)1 << 61; k++) {
        square *= 2;
        shift--;
    }
    return tracker_limited(scaled(square / (information > 1 ? information : 1), shift), 0, UINT32_MAX);
}

/* Chi squared of the fit, and of nothing but one bright pixel. */
static int64_t misfits(const struct fitted *fitted, int32_t flux, int64_t *alone)
{
    const struct tracker_front_measures *m = fitted->measures;
    int64_t total = 0, squares = 0, brightest = 0, size;
    int32_t light;
    int i, j, k;

    for (j = fitted->first; j <= fitted->last; j++)
        for (i = fitted->first; i <= fitted->last; i++) {
            if (!is_used(fitted, i, j))
                continue;
            k = j * SIDE + i;
            light = light_at(fitted, flux, k);
            size = tracker_limited(tracker_magnitude((int64_t)m->data[k] - light), 0, 1 << 16);
            total += weight_of(fitted, light) * size * size;
            size = tracker_limited(tracker_magnitude(m->data[k]), 0, 1 << 16);
            size = size * size * ((int64_t)1 << 19);
            squares += size;
            if (m->data[k] > 0 && size > brightest)
                brightest = size;
        }
    *alone = (squares - brightest) / (8 * fitted->square);
    return total / (8 * fitted->square);
}

/* The window; of a saturated star the stamp without the pixels above 0.9 of its highest, as each has its own full well. */
static void set_window(struct fitted *fitted)
{
    const struct tracker_front_candidate *c = fitted->candidate;
    int half = fitted->measures->half, k;
    uint16_t highest = 0;

    for (k = 0; k < SIDE * SIDE; k++)
        highest = c->stamp[k] > highest ? c->stamp[k] : highest;
    fitted->ceiling = INT32_MAX;
    if (highest >= TRACKER_FRONT_SATURATION) {
        half = HALF;
        fitted->ceiling = c->level + tracker_floor_quotient(9 * ((int64_t)highest * 256 - c->level), 10);
    }
    fitted->first = HALF - half;
    fitted->last = HALF + half;
}

int tracker_front_neighbours(const struct tracker_front *front, int candidate, int other)
{
    const uint16_t *order = front->work.measures.order;
    const struct tracker_front_candidate *a = &front->pool.candidate[order[candidate]], *b = &front->pool.candidate[order[other]];

    return other != candidate && front->work.measures.neighbour[other].flux > 0 && a->x <= b->x + NEIGHBOUR
           && b->x <= a->x + NEIGHBOUR && a->y <= b->y + NEIGHBOUR && b->y <= a->y + NEIGHBOUR;
}

/* The stamp's pixels above the background, without the light of the neighbours. */
static void set_data(const struct tracker_front *front, const struct fitted *fitted, int candidate)
{
    struct tracker_front_measures *m = fitted->measures;
    const struct tracker_front_candidate *c = fitted->candidate, *other;
    const struct tracker_front_neighbour *neighbour;
    int n, i, j;

    for (n = 0; n < SIDE * SIDE; n++)
        m->data[n] = (int32_t)c->stamp[n] * 16 - (int32_t)tracker_shift_right(c->level, 4);
    for (n = 0; n < front->candidates; n++) {
        if (!tracker_front_neighbours(front, candidate, n))
            continue;
        other = &front->pool.candidate[m->order[n]];
        neighbour = &m->neighbour[n];
        make_images(fitted, (other->x - c->x) * 65536 + neighbour->x, (other->y - c->y) * 65536 + neighbour->y);
        for (j = fitted->first; j <= fitted->last; j++)
            for (i = fitted->first; i <= fitted->last; i++)
                m->data[j * SIDE + i] -= light_at(fitted, neighbour->flux, j * SIDE + i);
    }
}

/* Noise of a star, and its flux by unweighted least squares. */
static void begin(struct fitted *fitted, struct tracker_front_fit *fit)
{
    struct tracker_front_measures *m = fitted->measures;
    const struct tracker_front_candidate *c = fitted->candidate;
    int i, j, k;
    int64_t above = 0, below = 0;

    fitted->square = (int64_t)c->noise * c->noise;
    fitted->photon = tracker_limited(TRACKER_FRONT_GAIN / fitted->square, 0, (int64_t)1 << 34);
    fitted->flat = ((int64_t)1 << 40) / fitted->square;
    fitted->used = 0;
    make_images(fitted, fit->x, fit->y);
    for (j = fitted->first; j <= fitted->last; j++)
        for (i = fitted->first; i <= fitted->last; i++) {
            if (!is_used(fitted, i, j))
                continue;
            k = j * SIDE + i;
            above += (int64_t)m->image[0][k] * m->data[k];
            below += (int64_t)m->image[0][k] * m->image[0][k];
            fitted->used++;
        }
    below >>= 15;
    fit->flux = (int32_t)tracker_limited(tracker_floor_quotient(above, below > 1 ? below : 1), LEAST_FLUX, MOST_FLUX);
}

void tracker_front_fit_star(struct tracker_front *front, int candidate)
{
    struct tracker_front_measures *measures = &front->work.measures;
    struct tracker_front_fit *fit = &measures->fit[candidate];
    struct fitted fitted;
    struct normal normal;
    int64_t determinant, alone;
    int32_t longest = 0;
    int step;

    fitted.candidate = &front->pool.candidate[measures->order[candidate]];
    fitted.measures = measures;
    set_window(&fitted);
    set_data(front, &fitted, candidate);
    begin(&fitted, fit);
    fit->freedom = fitted.used - 3;
    fit->good = fitted.used > 3;
    for (step = 0; step <= ITERATIONS && fit->good; step++) {
        if (step > 0)
            make_images(&fitted, fit->x, fit->y);
        sum_pixels(&fitted, fit->flux, &normal);
        fit->good = (uint8_t)marginalise(&normal, &determinant);
        if (fit->good && step < ITERATIONS)
            longest = move(fit, &normal, determinant);
    }
    if (!fit->good)
        return;
    fit->variance = variance_of(&fitted, fit->flux, &normal, determinant);
    fit->misfit = misfits(&fitted, fit->flux, &alone);
    fit->good = longest <= CONVERGED && tracker_magnitude(fit->x) <= FARTHEST && tracker_magnitude(fit->y) <= FARTHEST
                && alone + HOT_ODDS >= fit->misfit && fit->variance <= (int64_t)measures->variance << 18;
}
