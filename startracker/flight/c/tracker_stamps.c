/* Stamps: which candidates count, their second moments, and the image that all stars share. */
#include "tracker_front_internal.h"

#define SIDE TRACKER_FRONT_SIDE
#define HALF TRACKER_FRONT_HALF
#define RECENTRINGS 3
#define FARTHEST 40        /* from the middle of a stamp, 1/16 pixel */
#define NEAREST 4          /* squared distances: of one star; of a halo, which is HALO_RATIO times fainter */
#define HALO 64
#define HALO_RATIO 20
#define MARGIN 3           /* of boxes */
#define SHAPE_STARS 15
#define FEWEST 3
#define WIDE TRACKER_FRONT_WIDE
#define WIDEST (WIDE * 29 / 32)
#define TRAILED 90         /* difference of the principal variances, 8 fraction bits, of an image moved by 2 px */
#define LONG_LINE 555      /* variance of a line of 8 px under the weight, 8 fraction bits; the widest round image: 475 */
/* A line is shorter than a Gaussian of its variance, and the weight cuts less from it: a difference d is 1 / (1 + d / 8.5)
 * times as large in square pixels, to 3 % of the length for lines of 2 to 6 px. */
#define LINE 2169
#define PIXEL (((int64_t)1 << 24) / 12) /* variance of a pixel, 24 fraction bits */
#define ERROR_OF_SHAPE 1774 /* standard error of a variance for a noise over signal of 1, 8 fraction bits */

static void sort_candidates(struct tracker_front *front)
{
    uint16_t *order = front->work.measures.order;
    const struct tracker_front_candidate *a, *b;
    int n, k;

    for (n = 0; n < front->candidates; n++) {
        a = &front->pool.candidate[n];
        for (k = n; k > 0; k--) {
            b = &front->pool.candidate[order[k - 1]];
            if (b->height > a->height || (b->height == a->height && (b->y < a->y || (b->y == a->y && b->x < a->x))))
                break;
            order[k] = order[k - 1];
        }
        order[k] = (uint16_t)n;
    }
}

int tracker_front_boxed(const struct tracker_front_candidate *c, const struct tracker_front_object *o)
{
    return c->x + MARGIN >= o->left && c->x <= o->right + MARGIN && c->y + MARGIN >= o->top && c->y <= o->bottom + MARGIN;
}

/* Whether candidate n of the order is in no box, or the highest in those of saturated stars, whose image it then is. */
static int is_free(const struct tracker_front *front, int n, uint8_t *full)
{
    const uint16_t *order = front->work.measures.order;
    const struct tracker_front_object *object;
    int k, m;

    *full = 0;
    for (k = 0; k < front->objects; k++) {
        object = &front->object[k];
        if (!tracker_front_boxed(&front->pool.candidate[order[n]], object))
            continue;
        for (m = 0; m < n && !tracker_front_boxed(&front->pool.candidate[order[m]], object); m++)
            ;
        if (!object->star || m < n)
            return 0;
        *full = 1;
    }
    return 1;
}

/* Whether candidate a, the lower one, belongs to b. */
static int is_beside(const struct tracker_front_candidate *a, const struct tracker_front_candidate *b)
{
    int32_t dx = a->x - b->x, dy = a->y - b->y, square = dx * dx + dy * dy;

    return square <= NEAREST || (square <= HALO && (int64_t)HALO_RATIO * a->height < b->height);
}

/* ------------------------------------------------------------------ moments */

struct weighted {
    int64_t total, x, y, xx, yy, xy; /* positions from the weight's centre, 1/16 pixel */
};

static int32_t weight_at(int32_t distance)
{
    int32_t away = distance < 0 ? -distance : distance;

    return tracker_front_shape_weight[away < TRACKER_FRONT_LAST_WEIGHT ? away : TRACKER_FRONT_LAST_WEIGHT];
}

static void weighted_sums(const struct tracker_front_candidate *c, int32_t cx, int32_t cy, struct weighted *sums)
{
    int64_t light, row, row_x, row_xx;
    int32_t u, v, along[SIDE], across;
    int i, j;

    sums->total = sums->x = sums->y = sums->xx = sums->yy = sums->xy = 0;
    for (i = 0; i < SIDE; i++)
        along[i] = weight_at(16 * (i - HALF) - cx);
    for (j = 0; j < SIDE; j++) {
        v = 16 * (j - HALF) - cy;
        across = weight_at(v);
        row = row_x = row_xx = 0;
        for (i = 0; i < SIDE; i++) {
            if (!tracker_front_inside(c, i, j))
                continue;
            u = 16 * (i - HALF) - cx;
            light = (int64_t)((along[i] * across) >> 12) * ((int32_t)c->stamp[j * SIDE + i] * 256 - c->level);
            row += light;
            row_x += light * u;
            row_xx += light * u * u;
        }
        sums->total += row;
        sums->x += row_x;
        sums->xx += row_xx;
        sums->y += row * v;
        sums->yy += row * v * v;
        sums->xy += row_x * v;
    }
}

static int32_t within(int64_t value, int32_t most)
{
    return value < -most ? -most : value > most ? most : (int32_t)value;
}

static void measure_shape(const struct tracker_front_candidate *c, struct tracker_front_fit *fit)
{
    int32_t cx = 0, cy = 0, axes[2], moments[3];
    struct weighted sums;
    int64_t s, mx, my;
    int attempt;

    for (attempt = 0; attempt < RECENTRINGS; attempt++) {
        weighted_sums(c, cx, cy, &sums);
        s = sums.total > 1 ? sums.total : 1;
        mx = tracker_floor_quotient(sums.x * 16, s);
        my = tracker_floor_quotient(sums.y * 16, s);
        if (attempt < RECENTRINGS - 1 && sums.total > 0) {
            cx = within(cx + tracker_shift_right(mx + 8, 4), FARTHEST);
            cy = within(cy + tracker_shift_right(my + 8, 4), FARTHEST);
        }
    }
    mx = within(mx, 1 << 15);
    my = within(my, 1 << 15);
    fit->xx = within(tracker_floor_quotient(sums.xx, s) - ((mx * mx) >> 8), 1 << 28);
    fit->yy = within(tracker_floor_quotient(sums.yy, s) - ((my * my) >> 8), 1 << 28);
    fit->xy = within(tracker_floor_quotient(sums.xy, s) - tracker_shift_right(mx * my, 8), 1 << 28);
    fit->x = within((int64_t)cx * 4096 + mx * 256, FARTHEST * 4096);
    fit->y = within((int64_t)cy * 4096 + my * 256, FARTHEST * 4096);
    fit->valid = sums.total > 0;
    moments[0] = fit->xx;
    moments[1] = fit->yy;
    moments[2] = fit->xy;
    tracker_front_principal(moments, axes);
    s = sums.total > 4096 ? sums.total >> 12 : 1;
    fit->sharp = axes[1] + 2 * ((int64_t)c->noise * ERROR_OF_SHAPE / s) < TRACKER_FRONT_SEEN_SHARP;
}

/* ------------------------------------------------------------------ the image that all share */

static int is_whole(const struct tracker_front_candidate *c)
{
    int k;

    if (!tracker_front_inside(c, 0, 0) || !tracker_front_inside(c, SIDE - 1, SIDE - 1))
        return 0;
    for (k = 0; k < SIDE * SIDE; k++)
        if (c->stamp[k] >= TRACKER_FRONT_SATURATION)
            return 0;
    return 1;
}

static void insert_sorted(int32_t *values, int count, int32_t value)
{
    int k;

    for (k = count; k > 0 && values[k - 1] > value; k--)
        values[k] = values[k - 1];
    values[k] = value;
}

int tracker_front_look_trailed(const struct tracker_front *front)
{
    int32_t major[TRACKER_FRONT_TRAIL_POINTS] = {0}, moments[3], axes[2];
    struct tracker_front_fit fit;
    int n;

    for (n = 0; n < TRACKER_FRONT_TRAIL_POINTS; n++) {
        measure_shape(&front->pool.candidate[n], &fit);
        moments[0] = fit.xx;
        moments[1] = fit.yy;
        moments[2] = fit.xy;
        tracker_front_principal(moments, axes);
        insert_sorted(major, n, axes[0]);
    }
    return major[TRACKER_FRONT_TRAIL_POINTS / 2] > LONG_LINE;
}

/* Variance without the weight. */
static int32_t unweighted(int32_t seen)
{
    int32_t value = seen < 0 ? 0 : seen > WIDEST ? WIDEST : seen;

    return value * WIDE / (WIDE - value);
}

static int32_t node_distance(int32_t twice)
{
    return twice > 0 ? (int32_t)tracker_square_root((int64_t)(2 * twice / 21) << 24) : 0;
}

static int32_t inverse_sigma(int32_t variance)
{
    return (int32_t)(((int64_t)1 << 24) / tracker_square_root(((int64_t)variance << 16) - PIXEL));
}

/* A Gaussian of these variances, pixel included. */
static void set_gaussian(struct tracker_front_measures *measures, int32_t xx, int32_t yy)
{
    int half = TRACKER_FRONT_FIT_HALF;

    xx = xx < TRACKER_FRONT_LEAST_IMAGE ? TRACKER_FRONT_LEAST_IMAGE : xx;
    xx = xx > TRACKER_FRONT_MOST_IMAGE ? TRACKER_FRONT_MOST_IMAGE : xx;
    yy = yy < TRACKER_FRONT_LEAST_IMAGE ? TRACKER_FRONT_LEAST_IMAGE : yy;
    yy = yy > TRACKER_FRONT_MOST_IMAGE ? TRACKER_FRONT_MOST_IMAGE : yy;
    while (half < HALF && 1024 * half * half < 25 * (xx > yy ? xx : yy))
        half++;
    measures->trail_x = measures->trail_y = 0;
    measures->inverse_x = inverse_sigma(xx);
    measures->inverse_y = inverse_sigma(yy);
    measures->half = half;
    measures->variance = (xx + yy) >> 1;
}

/* The image of these median moments under the weight. */
static void set_image(struct tracker_front_measures *measures, const int32_t moments[3])
{
    int32_t seen[2], minor, apart, turned;

    tracker_front_principal(moments, seen);
    minor = unweighted(seen[1]);
    apart = unweighted(seen[0]) - minor;
    if (apart <= TRAILED) {
        set_gaussian(measures, unweighted(moments[0]), unweighted(moments[1]));
        return;
    }
    set_gaussian(measures, minor, minor);
    apart = apart * LINE / (LINE + apart);
    turned = (int32_t)tracker_floor_quotient((int64_t)apart * (moments[0] - moments[1]), (int64_t)seen[0] - seen[1]);
    measures->trail_x = node_distance(apart + turned);
    measures->trail_y = node_distance(apart - turned);
    if (moments[2] < 0)
        measures->trail_y = -measures->trail_y;
    measures->half = HALF;
    measures->variance = minor + (apart >> 1);
}

static void find_image(struct tracker_front *front)
{
    struct tracker_front_measures *measures = &front->work.measures;
    int32_t xx[SHAPE_STARS], yy[SHAPE_STARS], xy[SHAPE_STARS], moments[3];
    const struct tracker_front_fit *fit;
    int n, used = 0;

    for (n = 0; n < front->candidates && used < SHAPE_STARS; n++) {
        fit = &measures->fit[n];
        if (!fit->good || !fit->valid || fit->sharp || !is_whole(&front->pool.candidate[measures->order[n]]))
            continue;
        insert_sorted(xx, used, fit->xx);
        insert_sorted(yy, used, fit->yy);
        insert_sorted(xy, used, fit->xy);
        used++;
    }
    if (used < FEWEST) {
        set_gaussian(measures, TRACKER_FRONT_IMAGE, TRACKER_FRONT_IMAGE);
        return;
    }
    moments[0] = xx[used / 2];
    moments[1] = yy[used / 2];
    moments[2] = xy[used / 2];
    set_image(measures, moments);
}

/* Whether candidate a, the lower one, lies on the trail of b. */
static int is_on_trail(const struct tracker_front_measures *measures, const struct tracker_front_candidate *a,
                       const struct tracker_front_candidate *b)
{
    int64_t tx = tracker_shift_right(measures->trail_x, 8), ty = tracker_shift_right(measures->trail_y, 8);
    int64_t dx = a->x - b->x, dy = a->y - b->y;
    int64_t along = dx * tx + dy * ty, across = dx * ty - dy * tx, square = tx * tx + ty * ty;

    return square > 0 && across * across <= 4 * square && tracker_magnitude(along) * 256 <= 8 * square;
}

void tracker_front_shapes(struct tracker_front *front)
{
    struct tracker_front_measures *measures = &front->work.measures;
    const struct tracker_front_candidate *a, *b;
    struct tracker_front_fit *fit;
    int n, m;

    sort_candidates(front);
    for (n = 0; n < front->candidates; n++) {
        a = &front->pool.candidate[measures->order[n]];
        fit = &measures->fit[n];
        measure_shape(a, fit);
        fit->good = (uint8_t)is_free(front, n, &fit->full);
        for (m = 0; m < n && fit->good; m++)
            fit->good = !is_beside(a, &front->pool.candidate[measures->order[m]]);
    }
    find_image(front);
    for (n = 0; n < front->candidates; n++) {
        a = &front->pool.candidate[measures->order[n]];
        fit = &measures->fit[n];
        fit->good = fit->good && fit->valid && !fit->sharp;
        for (m = 0; m < n && fit->good; m++) {
            b = &front->pool.candidate[measures->order[m]];
            fit->good = !is_on_trail(measures, a, b);
        }
    }
}
