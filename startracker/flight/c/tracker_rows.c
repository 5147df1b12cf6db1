/* Rows: matched filter, runs above the threshold, local maxima. */
#include "tracker_front_internal.h"

#define REACH TRACKER_FRONT_REACH
#define SIDE TRACKER_FRONT_SIDE
#define HALF TRACKER_FRONT_HALF
#define CORE 2 /* half side of the pixels of which not all may be saturated: too little is left for a fit */

/* ------------------------------------------------------------------ matched filter */

static void filter_columns(struct tracker_front_rows *rows, int32_t y)
{
    const uint16_t *row[2 * REACH + 1];
    int32_t x, sum;
    int k;

    for (k = 0; k <= 2 * REACH; k++)
        row[k] = tracker_front_row_at(rows, y + k - REACH);
    for (x = 0; x < TRACKER_WIDTH; x++) {
        sum = tracker_front_tap[0] * (int32_t)row[REACH][x];
        for (k = 1; k <= REACH; k++)
            sum += tracker_front_tap[k] * ((int32_t)row[REACH - k][x] + (int32_t)row[REACH + k][x]);
        rows->column[x] = (sum + 8) >> 4;
    }
}

static int32_t filtered_here(const struct tracker_front_rows *rows, int32_t x)
{
    int32_t sum = tracker_front_tap[0] * rows->column[x];
    int k;

    for (k = 1; k <= REACH; k++)
        sum += tracker_front_tap[k] * (rows->column[x - k] + rows->column[x + k]);
    return sum;
}

/* Of any row in the ring. */
static int32_t filtered_at(struct tracker_front_rows *rows, int32_t x, int32_t y)
{
    const uint16_t *row[2 * REACH + 1];
    int32_t sum = 0, column;
    int i, j;

    for (j = -REACH; j <= REACH; j++)
        row[j + REACH] = tracker_front_row_at(rows, y + j) + x;
    for (i = -REACH; i <= REACH; i++) {
        column = 8;
        for (j = -REACH; j <= REACH; j++)
            column += tracker_front_tap[j < 0 ? -j : j] * (int32_t)row[j + REACH][i];
        sum += tracker_front_tap[i < 0 ? -i : i] * (column >> 4);
    }
    return sum;
}

static int is_searched(int32_t x, int32_t y)
{
    return x >= REACH && x < TRACKER_WIDTH - REACH && y >= REACH && y < TRACKER_HEIGHT - REACH;
}

/* Whether no neighbour is higher; of equal ones the first in reading order counts. */
static int is_highest(struct tracker_front_rows *rows, int32_t x, int32_t y, int32_t filtered)
{
    int32_t i, j;

    if (is_searched(x - 1, y) && filtered_here(rows, x - 1) >= filtered)
        return 0;
    if (is_searched(x + 1, y) && filtered_here(rows, x + 1) > filtered)
        return 0;
    for (j = -1; j <= 1; j += 2)
        for (i = -1; i <= 1; i++)
            if (is_searched(x + i, y + j) && filtered_at(rows, x + i, y + j) + (j < 0) > filtered)
                return 0;
    return 1;
}

/* ------------------------------------------------------------------ candidates */

static void copy_stamp(struct tracker_front_rows *rows, struct tracker_front_candidate *candidate)
{
    int i, j;

    for (j = 0; j < SIDE; j++)
        for (i = 0; i < SIDE; i++)
            candidate->stamp[j * SIDE + i] =
                tracker_front_inside(candidate, i, j)
                    ? tracker_front_row_at(rows, candidate->y + j - HALF)[candidate->x + i - HALF]
                    : 0;
}

/* Whether all pixels of the core are saturated: what is left is too little for a fit. */
static int is_full(struct tracker_front_rows *rows, const struct tracker_front_candidate *candidate)
{
    int i, j;

    for (j = HALF - CORE; j <= HALF + CORE; j++)
        for (i = HALF - CORE; i <= HALF + CORE; i++)
            if (!tracker_front_inside(candidate, i, j)
                || tracker_front_row_at(rows, candidate->y + j - HALF)[candidate->x + i - HALF]
                       < TRACKER_FRONT_SATURATION)
                return 0;
    return 1;
}

/* Whether it is not saturated throughout, not sharper than a star, and not part of something extended. */
static int can_be_star(struct tracker_front_rows *rows, const struct tracker_front_candidate *candidate)
{
    const int32_t level = candidate->level, noise = candidate->noise;
    int32_t peak = (int32_t)tracker_front_row_at(rows, candidate->y)[candidate->x] * 256 - level;
    int32_t limit = (int32_t)tracker_larger(tracker_shift_right(peak, 2), 2 * (int64_t)noise);
    int full = tracker_front_row_at(rows, candidate->y)[candidate->x] >= TRACKER_FRONT_SATURATION;
    int i, j, border = 0, bright = 0;

    if (full && is_full(rows, candidate))
        return 0;
    if (TRACKER_FRONT_SHARE > 0 && !full
        && 4 * (int64_t)peak > (((int64_t)TRACKER_FRONT_SHARE * candidate->height) >> 16) + 12 * (int64_t)noise)
        return 0;
    for (j = 0; j < SIDE; j++)
        for (i = 0; i < SIDE; i += j == 0 || j == SIDE - 1 ? 1 : SIDE - 1)
            if (tracker_front_inside(candidate, i, j)) {
                border++;
                bright += (int32_t)tracker_front_row_at(rows, candidate->y + j - HALF)[candidate->x + i - HALF] * 256
                          - level > limit;
            }
    return bright * 20 <= border * 7;
}

/* The last of the candidates in the order of heights. */
static int last_candidate(const struct tracker_front *front)
{
    const struct tracker_front_candidate *a, *b;
    int n, last = 0;

    for (n = 1; n < front->candidates; n++) {
        a = &front->pool.candidate[n];
        b = &front->pool.candidate[last];
        if (a->height < b->height
            || (a->height == b->height && (a->y > b->y || (a->y == b->y && a->x > b->x))))
            last = n;
    }
    return last;
}

/* Whether there are higher ones enough. */
static int is_too_low(struct tracker_front *front, const struct tracker_front_candidate *candidate)
{
    struct tracker_front_rows *rows = &front->work.rows;

    if (front->candidates < front->room)
        return 0;
    if (rows->worst < 0)
        rows->worst = last_candidate(front);
    return candidate->height <= front->pool.candidate[rows->worst].height;
}

/* The first candidates decide whether the rest of the memory is for more of them, or for trails. */
static void decide(struct tracker_front *front)
{
    front->decided = 1;
    if (TRACKER_FRONT_POOL > TRACKER_FRONT_TRAIL_POINTS && !tracker_front_look_trailed(front)) {
        front->tracing = front->trails = front->motion.known = 0;
        front->room = TRACKER_FRONT_POOL;
    }
}

/* A pixel above the threshold. */
static void consider(struct tracker_front *front, int cell, int32_t x, int32_t y, int32_t filtered)
{
    struct tracker_front_rows *rows = &front->work.rows;
    struct tracker_front_candidate here, *kept;

    here.x = (uint16_t)x;
    here.y = (uint16_t)y;
    here.level = tracker_front_between(rows->line.level, cell, x);
    here.noise = tracker_front_between(rows->line.noise, cell, x);
    here.height = filtered - (int32_t)tracker_shift_right((int64_t)TRACKER_FRONT_LEVEL_WEIGHT * here.level, 16);
    if (here.height <= 0)
        return;
    if (front->decided && is_too_low(front, &here))
        return;
    if (!is_highest(rows, x, y, filtered) || !can_be_star(rows, &here))
        return;
    if (!front->decided && front->candidates == front->room) {
        decide(front);
        if (is_too_low(front, &here))
            return;
    }
    kept = &front->pool.candidate[front->candidates < front->room ? front->candidates++ : rows->worst];
    kept->x = here.x;
    kept->y = here.y;
    kept->level = here.level;
    kept->noise = here.noise;
    kept->height = here.height;
    copy_stamp(rows, kept);
    tracker_front_level(rows, cell, kept);
    rows->worst = -1;
}

/* ------------------------------------------------------------------ threshold */

/* A run as it grows. */
struct growing {
    struct tracker_front_run run;
    struct tracker_front_sums sums;
    int32_t saturated;
};

static void add_pixel(struct tracker_front *front, struct growing *growing, int cell, int32_t x, int32_t y, int open)
{
    struct tracker_front_rows *rows = &front->work.rows;
    uint16_t value = tracker_front_row_at(rows, y)[x];
    int64_t light = value - ((tracker_front_between(rows->line.level, cell, x) + 128) >> 8);

    if (!open) {
        growing->run.first = (uint16_t)x;
        growing->sums.light = growing->sums.x = growing->sums.xx = 0;
        growing->saturated = 0;
    }
    growing->run.last = (uint16_t)x;
    growing->saturated += value >= TRACKER_FRONT_SATURATION;
    if (light > 0) {
        growing->sums.light += light;
        growing->sums.x += light * x;
        growing->sums.xx += light * x * x;
    }
}

static void end_run(struct tracker_front *front, struct growing *growing, int32_t y)
{
    struct tracker_front_sums *sums = &growing->sums;

    sums->y = sums->light * y;
    sums->yy = sums->y * y;
    sums->xy = sums->x * y;
    tracker_front_join(&front->work.rows, &growing->run, y, sums, growing->saturated);
}

/* Thresholds in the knots of a row, and of half the height. */
struct limits {
    int32_t whole[TRACKER_FRONT_KNOTS], half[TRACKER_FRONT_KNOTS];
};

static int32_t step_of(const int32_t *limits, int cell)
{
    return (int32_t)tracker_shift_right((int64_t)(limits[cell + 1] - limits[cell]) * tracker_front_inverse[cell], 16);
}

/* Runs and candidates of a row whose columns are filtered. */
static void search(struct tracker_front *front, const struct limits *limits, int32_t y)
{
    struct tracker_front_rows *rows = &front->work.rows;
    struct growing growing;
    const int32_t *least = front->tracing ? limits->half : limits->whole; /* all that matters for most pixels */
    int32_t x, end, limit, step, whole_step, filtered;
    int cell, open = 0, full = 0;

    for (cell = 0; cell <= TRACKER_FRONT_TILES; cell++) {
        x = (int32_t)tracker_larger(cell == 0 ? 0 : tracker_front_knot[cell], REACH);
        end = cell == TRACKER_FRONT_TILES ? TRACKER_WIDTH : tracker_front_knot[cell + 1];
        end = (int32_t)tracker_smaller(end, TRACKER_WIDTH - REACH);
        step = step_of(least, cell);
        whole_step = step_of(limits->whole, cell);
        limit = least[cell] + step * (x - tracker_front_knot[cell]);
        for (; x < end; x++) {
            filtered = filtered_here(rows, x);
            if (filtered > limit && front->tracing)
                tracker_front_trace(front, y, x);
            if (filtered > limit && filtered > limits->whole[cell] + whole_step * (x - tracker_front_knot[cell])) {
                full = full || (!open && rows->runs[y & 1] == TRACKER_FRONT_RUNS);
                if (!full) {
                    add_pixel(front, &growing, cell, x, y, open);
                    consider(front, cell, x, y, filtered);
                    open = 1;
                }
            } else if (open) {
                end_run(front, &growing, y);
                open = 0;
            }
            limit += step;
        }
    }
    if (open)
        end_run(front, &growing, y);
}

static int32_t limit_of(const struct tracker_front_line *line, int knot, int32_t threshold)
{
    return (int32_t)((((int64_t)TRACKER_FRONT_LEVEL_WEIGHT * line->level[knot]) >> 16)
                     + (((int64_t)threshold * line->noise[knot]) >> 8));
}

void tracker_front_search_row(struct tracker_front *front, int32_t y)
{
    struct tracker_front_rows *rows = &front->work.rows;
    struct limits limits;
    int k;

    rows->runs[y & 1] = 0;
    if (y >= REACH && y < TRACKER_HEIGHT - REACH && TRACKER_WIDTH > 2 * REACH) {
        tracker_front_line_at(rows, y);
        for (k = 0; k < TRACKER_FRONT_KNOTS; k++) {
            limits.whole[k] = limit_of(&rows->line, k, TRACKER_FRONT_THRESHOLD);
            limits.half[k] = limit_of(&rows->line, k, TRACKER_FRONT_THRESHOLD >> 1);
        }
        filter_columns(rows, y);
        search(front, &limits, y);
    }
    tracker_front_close(front, y);
    if (front->tracing)
        tracker_front_trace_row(front, y);
}
