/* A frame from its first row to the list of its stars.
 *
 * 1. tracker_background.c, tracker_hot_pixels.c, tracker_rows.c: background and noise of tiles of 4 rows, followed along the
 *    frame; hot pixels are bridged; a separable matched filter; pixels above the threshold; of their local maxima the
 *    highest, with a stamp of 11 x 11 pixels each. Left out are those that no star is as sharp as, and those whose stamp is
 *    bright along its border.
 * 2. tracker_components.c: components of the pixels above, of which those are kept that no stamp holds: with saturated
 *    pixels, longer than a stamp, or larger than any star.
 * 3. tracker_stamps.c: second moments; the motion that the images of all stars share.
 * 4. tracker_fit.c: position, flux and variance of each star by maximum likelihood.
 * 5. Saturated stars and trails join the list by their first moments.
 * 6. tracker_trails.c, tracker_trail_fit.c, tracker_motion.c: where the first candidates are long, components above half the
 *    threshold are fitted as lines, and those of one motion are the stars. */
#include "tracker_front_internal.h"

#define LAG TRACKER_FRONT_LAG
#define BLOCK TRACKER_FRONT_BLOCK
#define APART (2 << 16)        /* fits nearer than this along both axes are of one star */
#define NEAR_PEAK (3 << 14)    /* from its highest pixel a star's image is no farther along an axis */
#define ROUNDS 3               /* of fits with the neighbours' light subtracted */
#define FLAT_TOP 167772        /* 0.05^2 square pixels */
#define TRAIL_ENDS 671089      /* 0.1^2 square pixels */
#define FEWEST_LONG 4          /* trails that make a frame trailed, */
#define FEWEST_POINTS 5        /* and points that make it none, as a quarter as many as trails do */
#define LARGEST_TRACE (1 << 20)
#define LEAST_MOTION (7 << 8)  /* pixels, 8 fraction bits, from which trails are stars as tracker_trails.c finds them */
#define WAIT TRACKER_FRONT_TRAIL_WAIT

void tracker_front_start(struct tracker_front *front)
{
    struct tracker_front_rows *rows = &front->work.rows;
    int n;

    front->given = front->saturated = 0;
    front->lowest = UINT16_MAX;
    front->highest = 0;
    front->candidates = front->objects = front->trails = 0;
    front->room = TRACKER_FRONT_TRAIL_POINTS;
    front->decided = 0;
    front->tracing = 1;
    tracker_front_trace_start(front);
    for (n = 0; n < 2 * TRACKER_FRONT_RUNS; n++)
        rows->component[n].used = 0;
    for (n = 0; n < TRACKER_FRONT_TILES; n++)
        rows->block[0].level[n] = rows->block[0].slope[n] = rows->block[0].noise[n] = 0;
    rows->runs[0] = rows->runs[1] = rows->open = 0;
    rows->bridge[0].count = rows->bridge[1].count = 0;
    rows->worst = -1;
}

/* What can be done when row y has come, or would have. */
static void advance(struct tracker_front *front, int32_t y)
{
    struct tracker_front_rows *rows = &front->work.rows;
    int32_t block = y / BLOCK;

    if (y < TRACKER_HEIGHT && block < TRACKER_FRONT_BLOCKS) {
        if (y % BLOCK == BLOCK - 1)
            tracker_front_follow(rows, block, BLOCK);
        else if (TRACKER_HEIGHT < BLOCK && y == TRACKER_HEIGHT - 1)
            tracker_front_follow(rows, block, TRACKER_HEIGHT);
    }
    if (y >= BLOCK - 1 && y < TRACKER_HEIGHT + BLOCK - 1)
        tracker_front_bridge_row(rows, y - BLOCK + 1);
    if (y >= LAG)
        tracker_front_search_row(front, y - LAG);
}

void tracker_front_row(struct tracker_front *front, const uint16_t *row)
{
    uint16_t *kept;
    int32_t x;

    if (front->given >= TRACKER_HEIGHT)
        return;
    kept = tracker_front_row_at(&front->work.rows, front->given);
    for (x = 0; x < TRACKER_WIDTH; x++) {
        kept[x] = row[x];
        front->saturated += row[x] >= TRACKER_FRONT_SATURATION;
        front->lowest = row[x] < front->lowest ? row[x] : front->lowest;
        front->highest = row[x] > front->highest ? row[x] : front->highest;
    }
    advance(front, front->given++);
}

/* ------------------------------------------------------------------ the list */

static int precedes(const struct tracker_star *a, const struct tracker_star *b)
{
    if (a->flux != b->flux)
        return a->flux > b->flux;
    return a->y != b->y ? a->y < b->y : a->x < b->x;
}

static void keep_star(struct tracker_star *list, int *count, const struct tracker_star *star)
{
    int n;

    if (*count == TRACKER_MAX_STARS && !precedes(star, &list[*count - 1]))
        return;
    if (*count < TRACKER_MAX_STARS)
        (*count)++;
    for (n = *count - 1; n > 0 && precedes(star, &list[n - 1]); n--)
        list[n] = list[n - 1];
    list[n] = *star;
}

static int32_t near_peak(int32_t x)
{
    return x < -NEAR_PEAK ? -NEAR_PEAK : x > NEAR_PEAK ? NEAR_PEAK : x;
}

/* Fits of candidates; those that end on a higher star do not count. */
static void fit_candidates(struct tracker_front *front)
{
    struct tracker_front_measures *measures = &front->work.measures;
    const struct tracker_front_candidate *a, *b;
    struct tracker_front_fit *fit;
    int64_t dx, dy;
    int n, m;

    for (n = 0; n < front->candidates; n++)
        measures->neighbour[n].flux = 0;
    for (n = 0; n < front->candidates; n++) {
        fit = &measures->fit[n];
        if (!fit->full && measures->trail_x == 0 && measures->trail_y == 0) {
            fit->x = near_peak(fit->x);
            fit->y = near_peak(fit->y);
        }
        if (fit->good)
            tracker_front_fit_star(front, n);
        a = &front->pool.candidate[measures->order[n]];
        for (m = 0; m < n && fit->good; m++) {
            if (!measures->fit[m].good)
                continue;
            b = &front->pool.candidate[measures->order[m]];
            dx = (int64_t)(a->x - b->x) * 65536 + fit->x - measures->fit[m].x;
            dy = (int64_t)(a->y - b->y) * 65536 + fit->y - measures->fit[m].y;
            fit->good = tracker_magnitude(dx) >= APART || tracker_magnitude(dy) >= APART;
        }
    }
}

/* Fits of stars that have neighbours, with the neighbours' light subtracted, as fitted before. */
static void fit_beside(struct tracker_front *front)
{
    struct tracker_front_measures *measures = &front->work.measures;
    const struct tracker_front_fit *fit;
    int n, m;

    for (n = 0; n < front->candidates; n++) {
        fit = &measures->fit[n];
        measures->neighbour[n].x = fit->good ? fit->x : 0;
        measures->neighbour[n].y = fit->good ? fit->y : 0;
        measures->neighbour[n].flux = fit->good ? fit->flux : 0;
    }
    for (n = 0; n < front->candidates; n++) {
        if (measures->neighbour[n].flux == 0)
            continue;
        for (m = 0; m < front->candidates && !tracker_front_neighbours(front, n, m); m++)
            ;
        if (m < front->candidates)
            tracker_front_fit_star(front, n);
    }
}

static int misfits(const struct tracker_front_fit *fit)
{
    int64_t excess = fit->misfit - ((int64_t)fit->freedom << 8);

    return excess > tracker_square_root((int64_t)32 * fit->freedom << 16);
}

static uint32_t with_floor(int64_t variance)
{
    variance += TRACKER_FRONT_FLOOR;
    return variance < UINT32_MAX ? (uint32_t)variance : UINT32_MAX;
}

/* Fitted stars. Variances are larger where chi squared is too large, unless that of most of the highest stars is. */
static void list_points(struct tracker_front *front, struct tracker_star *list, int *count)
{
    const struct tracker_front_measures *measures = &front->work.measures;
    const struct tracker_front_candidate *candidate;
    const struct tracker_front_fit *fit;
    struct tracker_star star;
    int64_t variance;
    int n, first = 0, wrong = 0;

    for (n = 0; n < front->candidates && first < 9; n++)
        if (measures->fit[n].good) {
            first++;
            wrong += misfits(&measures->fit[n]);
        }
    for (n = 0; n < front->candidates; n++) {
        fit = &measures->fit[n];
        if (!fit->good)
            continue;
        candidate = &front->pool.candidate[measures->order[n]];
        variance = fit->variance;
        if (2 * wrong <= first && misfits(fit))
            variance = variance * (fit->misfit >> 4 < (int64_t)1 << 32 ? fit->misfit >> 4 : (int64_t)1 << 32)
                       / (16 * fit->freedom);
        star.x = (int32_t)((int64_t)candidate->x * 65536 + fit->x);
        star.y = (int32_t)((int64_t)candidate->y * 65536 + fit->y);
        star.flux = fit->flux;
        star.variance = with_floor(variance);
        star.flags = (uint16_t)((fit->full ? TRACKER_SATURATED : 0)
                                + (measures->trail_x != 0 || measures->trail_y != 0 ? TRACKER_ELONGATED : 0));
        keep_star(list, count, &star);
    }
}

/* ------------------------------------------------------------------ objects */

static void keep_object_star(const struct tracker_front_object *object, int64_t variance, uint16_t flag,
                             struct tracker_star *list, int *count)
{
    struct tracker_star star;

    star.x = object->x;
    star.y = object->y;
    star.flux = object->light <= INT32_MAX >> 4 ? (int32_t)object->light * 16 : INT32_MAX;
    star.variance = with_floor(variance);
    star.flags = flag;
    keep_star(list, count, &star);
}

/* Saturated stars that no fit measures. */
static void list_saturated(const struct tracker_front *front, struct tracker_star *list, int *count)
{
    const struct tracker_front_object *object;
    const struct tracker_front_fit *fit;
    int64_t bloomed;
    int n, m, fitted;

    for (n = 0; n < front->objects; n++) {
        object = &front->object[n];
        fitted = 0;
        for (m = 0; m < front->candidates; m++) {
            fit = &front->work.measures.fit[m];
            fitted = fitted
                     || (fit->good && fit->full
                         && tracker_front_boxed(&front->pool.candidate[front->work.measures.order[m]], object));
        }
        if (!object->star || fitted)
            continue;
        bloomed = tracker_square_root((int64_t)(object->xx > 0 ? object->xx : 0) << 8)
                  - tracker_square_root((int64_t)(object->yy > 0 ? object->yy : 0) << 8);
        bloomed = tracker_shift_right(bloomed, 2);
        keep_object_star(object, bloomed * bloomed * 1024 + FLAT_TOP, TRACKER_SATURATED, list, count);
    }
}

static int is_trail(const struct tracker_front_object *object)
{
    return object->kind == TRACKER_FRONT_LONG && !tracker_front_at_border(object);
}

/* The middle one of a moment of the trails: 0 is xx, 1 yy, 2 xy. */
static int32_t middle_moment(struct tracker_front *front, int which, int count)
{
    int32_t *values = front->work.measures.middle, value;
    const struct tracker_front_object *object;
    int n, k, sorted = 0;

    for (n = 0; n < front->objects; n++) {
        object = &front->object[n];
        if (!is_trail(object))
            continue;
        value = which == 0 ? object->xx : which == 1 ? object->yy : object->xy;
        for (k = sorted++; k > 0 && values[k - 1] > value; k--)
            values[k] = values[k - 1];
        values[k] = value;
    }
    return values[count / 2];
}

static int64_t trail_variance(const struct tracker_front_object *object)
{
    int64_t trace = (int64_t)object->xx + object->yy, s = object->light > 1 ? object->light : 1;
    int64_t ratio = ((int64_t)object->noise << 12) / s;

    trace = trace < LARGEST_TRACE ? trace : LARGEST_TRACE;
    ratio = ratio < 1 << 14 ? ratio : 1 << 14;
    return ((object->pixels * ratio * ratio * 2 * trace) >> 24) + ((trace * (TRACKER_FRONT_GAIN >> 20)) >> 7) / s
           + TRAIL_ENDS;
}

/* Trails of one motion, where they are so many that they are the stars, or the stars of stamps are moved as well;
 * whether they alone are the stars. */
static int list_trails(struct tracker_front *front, struct tracker_star *list, int *count)
{
    const struct tracker_front_object *object;
    int32_t middle[3];
    int64_t off[3];
    int moved = front->work.measures.trail_x != 0 || front->work.measures.trail_y != 0;
    int n, k, trails = 0, points = 0, listed = 0;

    for (n = 0; n < front->candidates && !moved; n++)
        points += front->work.measures.fit[n].good;
    for (n = 0; n < front->objects; n++)
        trails += is_trail(&front->object[n]);
    if (trails < FEWEST_LONG || points >= (trails / 4 > FEWEST_POINTS ? trails / 4 : FEWEST_POINTS))
        return 0;
    for (k = 0; k < 3; k++)
        middle[k] = middle_moment(front, k, trails);
    for (n = 0; n < front->objects; n++) {
        object = &front->object[n];
        off[0] = (int64_t)object->xx - middle[0];
        off[1] = (int64_t)object->yy - middle[1];
        off[2] = (int64_t)object->xy - middle[2];
        if (!is_trail(object) || 5 * tracker_largest(off, 3) > (int64_t)middle[0] + middle[1])
            continue;
        keep_object_star(object, trail_variance(object), TRACKER_ELONGATED, list, count);
        listed = 1;
    }
    return listed && !moved;
}

/* Trails that share the frame's motion, where this is long and they are the stars; whether they are. */
static int list_lines(struct tracker_front *front, struct tracker_star *list, int *count)
{
    const struct tracker_front_motion *motion = &front->motion;
    int64_t square = (int64_t)motion->along_x * motion->along_x + (int64_t)motion->along_y * motion->along_y;
    const struct tracker_front_trail *trail;
    struct tracker_star star;
    int moved = front->work.measures.trail_x != 0 || front->work.measures.trail_y != 0;
    int n, points = 0, lines = 0;

    if (!motion->known || square < (int64_t)LEAST_MOTION * LEAST_MOTION)
        return 0;
    for (n = 0; n < front->candidates && !moved; n++)
        points += front->work.measures.fit[n].good;
    for (n = 0; n < front->trails; n++)
        lines += tracker_front_agrees(&front->trail[n], motion);
    if (points >= (lines / 4 > FEWEST_POINTS ? lines / 4 : FEWEST_POINTS))
        return 0;
    for (n = 0; n < front->trails; n++) {
        trail = &front->trail[n];
        if (!tracker_front_agrees(trail, motion))
            continue;
        star.x = trail->x;
        star.y = trail->y;
        star.flux = trail->flux;
        star.variance = with_floor(trail->variance);
        star.flags = TRACKER_ELONGATED;
        keep_star(list, count, &star);
    }
    return lines > 0;
}

int tracker_front_finish(struct tracker_front *front, struct tracker_star star[TRACKER_MAX_STARS])
{
    int32_t y;
    int count = 0;

    if (front->given < TRACKER_HEIGHT)
        return -1;
    for (y = TRACKER_HEIGHT; y < TRACKER_HEIGHT + LAG; y++)
        advance(front, y);
    for (y = TRACKER_HEIGHT; y <= TRACKER_HEIGHT + WAIT && front->tracing; y++)
        tracker_front_trace_row(front, y);
    tracker_front_shapes(front);
    fit_candidates(front);
    for (y = 0; y < ROUNDS; y++)
        fit_beside(front);
    list_saturated(front, star, &count);
    if (!list_lines(front, star, &count) && !list_trails(front, star, &count))
        list_points(front, star, &count);
    return count;
}
