/* Trails: components above half the threshold and the pixels about them, until they have ended. */
#include "tracker_front_internal.h"

#define HALF TRACKER_FRONT_HALF
#define RUNS TRACKER_FRONT_TRAIL_RUNS
#define PIECES (2 * RUNS + TRACKER_FRONT_TRAIL_PENDING)
#define HISTORY TRACKER_FRONT_TRAIL_HISTORY
#define WORDS TRACKER_FRONT_TRAIL_WORDS
#define ROWS TRACKER_FRONT_TRAIL_ROWS
#define MARGIN TRACKER_FRONT_TRAIL_MARGIN
#define NONE PIECES
#define LOOKED_AT 8            /* pixels of a component from which it is kept, and fitted */
#define FEWEST 12
#define LARGEST_SIDE 56
#define MOST_PIXELS 900
#define UNUSED 32768           /* of a pixel that is saturated or beyond the range */
#define RANGE 32767
#define BIT(x) ((uint8_t)(1u << ((x) & 7)))

enum state { FREE, OPEN, PENDING, READY };

void tracker_front_trace_start(struct tracker_front *front)
{
    struct tracker_front_tracing *tracing = &front->pool.beside.tracing;
    int n;

    for (n = 0; n < PIECES; n++)
        tracing->piece[n].state = FREE;
    for (n = 0; n < HISTORY; n++)
        tracing->runs[n] = 0;
    tracing->oldest = tracing->rows = tracing->used = tracing->next = tracing->pending = 0;
    front->motion.known = 0;
}

void tracker_front_trace(struct tracker_front *front, int32_t y, int32_t x)
{
    struct tracker_front_tracing *tracing = &front->pool.beside.tracing;
    struct tracker_front_run *run = tracing->run[y % HISTORY];
    int count = tracing->runs[y % HISTORY];

    if (count > 0 && run[count - 1].last + 1 == x) {
        run[count - 1].last = (uint16_t)x;
    } else if (count < RUNS) {
        run[count].first = run[count].last = (uint16_t)x;
        run[count].component = NONE;
        tracing->runs[y % HISTORY]++;
    }
}

/* ------------------------------------------------------------------ components */

static uint16_t root_of(const struct tracker_front_tracing *tracing, uint16_t piece)
{
    int k;

    for (k = 0; k < PIECES && tracing->piece[piece].parent != piece; k++)
        piece = tracing->piece[piece].parent;
    return piece;
}

static int is_first(const struct tracker_front_piece *a, const struct tracker_front_piece *b)
{
    return a->first_y < b->first_y || (a->first_y == b->first_y && a->first_x < b->first_x);
}

static void join(struct tracker_front_tracing *tracing, uint16_t a, uint16_t b)
{
    struct tracker_front_piece *to = &tracing->piece[a], *from = &tracing->piece[b];

    from->parent = a;
    to->x += from->x;
    to->y += from->y;
    to->xx += from->xx;
    to->yy += from->yy;
    to->xy += from->xy;
    to->pixels += from->pixels;
    if (is_first(from, to)) {
        to->first_x = from->first_x;
        to->first_y = from->first_y;
    }
    to->left = from->left < to->left ? from->left : to->left;
    to->right = from->right > to->right ? from->right : to->right;
    to->bottom = from->bottom > to->bottom ? from->bottom : to->bottom;
}

/* A free piece; there always is one, as at most RUNS reach a row, as many begin in it, and the others are pending. */
static uint16_t begin(struct tracker_front_tracing *tracing, const struct tracker_front_run *run, int32_t y)
{
    struct tracker_front_piece *piece;
    uint16_t n = 0;

    while (n < PIECES - 1 && tracing->piece[n].state != FREE)
        n++;
    piece = &tracing->piece[n];
    piece->x = piece->y = piece->xx = piece->yy = piece->xy = 0;
    piece->pixels = 0;
    piece->first_x = piece->left = piece->right = run->first;
    piece->first_y = piece->bottom = (uint16_t)y;
    piece->parent = n;
    piece->state = OPEN;
    return n;
}

static void add_run(struct tracker_front_piece *piece, const struct tracker_front_run *run, int32_t y)
{
    int64_t n = run->last - run->first + 1, sx = 0, sxx = 0;
    int32_t x;

    for (x = run->first; x <= run->last; x++) {
        sx += x;
        sxx += (int64_t)x * x;
    }
    piece->pixels += (int32_t)n;
    piece->x += sx;
    piece->y += n * y;
    piece->xx += sxx;
    piece->yy += n * y * y;
    piece->xy += sx * y;
    piece->left = run->first < piece->left ? run->first : piece->left;
    piece->right = run->last > piece->right ? run->last : piece->right;
    piece->bottom = (uint16_t)y;
}

static void join_runs(struct tracker_front_tracing *tracing, int32_t y)
{
    const struct tracker_front_run *above = tracing->run[(y + HISTORY - 1) % HISTORY];
    struct tracker_front_run *here = tracing->run[y % HISTORY];
    uint16_t found, other;
    int n, k;

    for (n = 0; n < tracing->runs[y % HISTORY]; n++) {
        found = NONE;
        for (k = 0; k < tracing->runs[(y + HISTORY - 1) % HISTORY]; k++) {
            if (above[k].first > here[n].last + 1 || above[k].last + 1 < here[n].first)
                continue;
            other = root_of(tracing, above[k].component);
            if (found == NONE)
                found = other;
            else if (other != found)
                join(tracing, found, other);
        }
        if (found == NONE)
            found = begin(tracing, &here[n], y);
        add_run(&tracing->piece[found], &here[n], y);
        here[n].component = found;
    }
}

/* Whether it is large enough to be looked at, and no larger than a trail. */
static int is_looked_at(const struct tracker_front_piece *piece)
{
    return piece->pixels >= LOOKED_AT && piece->pixels <= MOST_PIXELS && piece->right - piece->left < LARGEST_SIDE
           && piece->bottom - piece->first_y < LARGEST_SIDE;
}

/* The first in the order of ends and beginnings of the pieces in a state that end above row y; NONE: no one does. */
static uint16_t next_in(const struct tracker_front_tracing *tracing, enum state state, int32_t y)
{
    const struct tracker_front_piece *piece, *first;
    uint16_t n, found = NONE;

    for (n = 0; n < PIECES; n++) {
        piece = &tracing->piece[n];
        if (piece->state != state || piece->bottom >= y)
            continue;
        first = &tracing->piece[found < NONE ? found : n];
        if (found == NONE || piece->bottom < first->bottom || (piece->bottom == first->bottom && is_first(piece, first)))
            found = n;
    }
    return found;
}

/* Pieces that do not reach row y: those that may be trails wait for their pixels. */
static void end_pieces(struct tracker_front_tracing *tracing, int32_t y)
{
    struct tracker_front_run *run;
    uint16_t n;
    int row, k;

    for (row = 0; row < HISTORY; row++)
        for (k = 0; k < tracing->runs[row]; k++) {
            run = &tracing->run[row][k];
            if (run->component != NONE)
                run->component = root_of(tracing, run->component);
        }
    for (n = 0; n < PIECES; n++)
        if (tracing->piece[n].state == OPEN
            && (tracing->piece[n].parent != n
                || (tracing->piece[n].bottom < y
                    && (tracing->piece[n].pixels < FEWEST || !is_looked_at(&tracing->piece[n])))))
            tracing->piece[n].state = FREE;
    for (n = next_in(tracing, OPEN, y); n != NONE; n = next_in(tracing, OPEN, y)) {
        tracing->piece[n].state = tracing->pending < TRACKER_FRONT_TRAIL_PENDING ? PENDING : FREE;
        tracing->pending += tracing->piece[n].state == PENDING;
    }
    for (row = 0; row < HISTORY; row++)
        for (k = 0; k < tracing->runs[row]; k++) {
            run = &tracing->run[row][k];
            if (run->component != NONE && tracing->piece[run->component].state == FREE)
                run->component = NONE;
        }
}

/* ------------------------------------------------------------------ pixels */

/* Middle (px) of a component that may be a piece of a trail, and length along both axes of the whole; 0: it is whole. */
static int is_part(const struct tracker_front *front, const struct tracker_front_piece *piece, int64_t middle[2],
                   int64_t along[2])
{
    int32_t size = piece->right - piece->left + piece->bottom - piece->first_y;

    if (!front->motion.known || !is_looked_at(piece))
        return 0;
    middle[0] = piece->x / piece->pixels;
    middle[1] = piece->y / piece->pixels;
    tracker_front_motion_at(&front->motion, middle[0] * 65536, middle[1] * 65536, along);
    return (int64_t)size * 1024 < 3 * (tracker_magnitude(along[0]) + tracker_magnitude(along[1]));
}

static void mark(uint8_t *near, int64_t first, int64_t last)
{
    int64_t x;

    for (x = first > 0 ? first : 0; x <= last && x < TRACKER_WIDTH; x++)
        near[x >> 3] |= BIT(x);
}

/* Pixels of row r on the trail of which a component is a piece. */
static void mark_trail(const struct tracker_front *front, const struct tracker_front_piece *piece, int32_t r, uint8_t *near)
{
    int64_t middle[2], along[2], x, half, reach;

    if (!is_part(front, piece, middle, along)
        || tracker_magnitude(r - middle[1]) > (tracker_magnitude(along[1]) >> 8) + MARGIN)
        return;
    reach = (tracker_magnitude(along[0]) >> 8) + MARGIN;
    if (along[1] < 0) {
        along[0] = -along[0];
        along[1] = -along[1];
    }
    along[1] = along[1] > 0 ? along[1] : 1;
    x = middle[0] + tracker_floor_quotient((r - middle[1]) * along[0], along[1]);
    half = MARGIN * tracker_square_root(along[0] * along[0] + along[1] * along[1]) / along[1];
    mark(near, x - half > middle[0] - reach ? x - half : middle[0] - reach,
         x + half < middle[0] + reach ? x + half : middle[0] + reach);
}

/* Pixels of row r about components; the words that they take. */
static int32_t mark_row(const struct tracker_front *front, int32_t r, uint8_t *near)
{
    const struct tracker_front_tracing *tracing = &front->pool.beside.tracing;
    const struct tracker_front_run *run;
    int32_t k, words = 0, x;
    int n, before = 0, here;

    for (n = 0; n < (TRACKER_WIDTH + 7) / 8; n++)
        near[n] = 0;
    for (k = r > MARGIN ? r - MARGIN : 0; k <= r + MARGIN; k++)
        for (n = 0; n < tracing->runs[k % HISTORY]; n++) {
            run = &tracing->run[k % HISTORY][n];
            if (run->component != NONE && is_looked_at(&tracing->piece[run->component]))
                mark(near, run->first - MARGIN, run->last + MARGIN);
        }
    for (n = 0; n < PIECES; n++)
        if (tracing->piece[n].state != FREE)
            mark_trail(front, &tracing->piece[n], r, near);
    for (x = 0; x < TRACKER_WIDTH; x++) {
        here = (near[x >> 3] & BIT(x)) != 0;
        words += here ? (before ? 1 : 3) : 0;
        before = here;
    }
    return words;
}

static void drop_oldest(struct tracker_front_tracing *tracing)
{
    tracing->used -= tracing->words[tracing->oldest % ROWS];
    tracing->oldest++;
    tracing->rows--;
}

static void put(struct tracker_front_tracing *tracing, int32_t value)
{
    tracing->word[tracing->next] = (uint16_t)value;
    tracing->next = tracing->next + 1 < WORDS ? tracing->next + 1 : 0;
}

/* A pixel above the background, DN of 2 fraction bits, as a word. */
static int32_t value_of(struct tracker_front_rows *rows, int32_t x, int32_t r)
{
    int32_t pixel = tracker_front_row_at(rows, r)[x];
    int32_t value = pixel * 4 - (tracker_front_between(rows->line.level, tracker_front_cell(x), x) >> 6);

    if (pixel >= TRACKER_FRONT_SATURATION || value > RANGE || value < -RANGE)
        return UNUSED;
    return value < 0 ? value + 65536 : value;
}

/* Keeps what is about components in row r. */
static void keep_row(struct tracker_front *front, int32_t r)
{
    struct tracker_front_tracing *tracing = &front->pool.beside.tracing;
    uint8_t near[(TRACKER_WIDTH + 7) / 8];
    int32_t words, x, end;

    words = mark_row(front, r, near);
    words = words <= WORDS ? words : 0;
    while (tracing->rows > 0 && (tracing->rows == ROWS || tracing->used + words > WORDS))
        drop_oldest(tracing);
    if (tracing->rows == 0)
        tracing->oldest = r;
    tracing->begin[r % ROWS] = (uint16_t)tracing->next;
    tracing->words[r % ROWS] = (uint16_t)words;
    tracing->used += words;
    tracing->rows++;
    if (words == 0)
        return;
    for (x = 0; x < TRACKER_WIDTH; x++) {
        if (!(near[x >> 3] & BIT(x)))
            continue;
        if (x == 0 || !(near[(x - 1) >> 3] & BIT(x - 1))) {
            for (end = x + 1; end < TRACKER_WIDTH && (near[end >> 3] & BIT(end)); end++)
                ;
            put(tracing, x);
            put(tracing, end - x);
        }
        put(tracing, value_of(&front->work.rows, x, r));
    }
}

/* ------------------------------------------------------------------ rows */

/* Row from which all pixels about a piece are kept. */
static int64_t last_row(const struct tracker_front *front, const struct tracker_front_piece *piece)
{
    int64_t middle[2], along[2], last = piece->bottom + MARGIN, far;

    if (is_part(front, piece, middle, along)) {
        far = middle[1] + (tracker_magnitude(along[1]) >> 8) + MARGIN;
        last = far > last ? far : last;
    }
    return last + HALF;
}

void tracker_front_trace_row(struct tracker_front *front, int32_t y)
{
    struct tracker_front_tracing *tracing = &front->pool.beside.tracing;
    struct tracker_front_piece *piece;
    uint16_t n;

    if (y >= TRACKER_HEIGHT)
        tracing->runs[y % HISTORY] = 0;
    join_runs(tracing, y);
    end_pieces(tracing, y);
    tracker_front_line_at(&front->work.rows, y < TRACKER_HEIGHT ? y : TRACKER_HEIGHT - 1);
    if (y >= HALF && y - HALF < TRACKER_HEIGHT)
        keep_row(front, y - HALF);
    for (n = 0; n < PIECES; n++) {
        piece = &tracing->piece[n];
        if (piece->state == PENDING && (y == TRACKER_HEIGHT + TRACKER_FRONT_TRAIL_WAIT || last_row(front, piece) <= y))
            piece->state = READY;
    }
    for (n = next_in(tracing, READY, y); n != NONE; n = next_in(tracing, READY, y)) {
        tracker_front_measure_trail(front, &tracing->piece[n]);
        tracing->piece[n].state = FREE;
        tracing->pending--;
    }
    tracing->runs[(y + 1) % HISTORY] = 0;
}
