/* Background and noise of tiles, followed along the frame. */
#include "tracker_front_internal.h"

#define LEAST_NOISE 18      /* of rounding, 6 fraction bits */
#define LARGEST_LEVEL 65535

uint16_t *tracker_front_row_at(struct tracker_front_rows *rows, int32_t y)
{
    return rows->row[y % TRACKER_FRONT_RING];
}

/* The value that is k-th from 0 in the order of values: found bit by bit, below the bits that all have in common. */
static int32_t kth(const uint16_t *values, int count, int k)
{
    uint32_t all = values[0], any = values[0], found, trial, bit = 1;
    int n, below;

    for (n = 1; n < count; n++) {
        all &= values[n];
        any |= values[n];
    }
    while (bit <= (all ^ any))
        bit <<= 1;
    found = all & ~(bit - 1);
    for (bit >>= 1; bit > 0; bit >>= 1) {
        trial = found | bit;
        below = 0;
        for (n = 0; n < count; n++)
            below += values[n] < trial;
        if (below <= k)
            found = trial;
    }
    return (int32_t)found;
}

static uint32_t root(uint32_t n)
{
    uint32_t found = 0, bit;

    for (bit = (uint32_t)1 << 30; bit > 0; bit >>= 2) {
        if (n >= found + bit) {
            n -= found + bit;
            found = (found >> 1) + bit;
        } else {
            found >>= 1;
        }
    }
    return found;
}

/* Mean above `middle` (8 fraction bits) and noise (6) of the values within a half width (6). */
static int32_t clipped(const uint16_t *values, int count, int32_t middle, int32_t half, int32_t *noise)
{
    int64_t squares = 0, mean, variance;
    int32_t apart, total = 0;
    int n, kept = 0;

    for (n = 0; n < count; n++) {
        apart = (int32_t)values[n] - middle;
        if (apart * 64 <= half && apart * 64 >= -half) {
            total += apart;
            squares += (int64_t)apart * apart;
            kept++;
        }
    }
    mean = tracker_floor_quotient((int64_t)total * 256, kept);
    variance = squares * 4096 / kept - ((mean * mean) >> 4);
    if (variance < 0)
        variance = 0;
    if (variance > UINT32_MAX)
        variance = UINT32_MAX;
    *noise = (int32_t)((root((uint32_t)variance) * 1038u) >> 10);
    if (*noise < LEAST_NOISE)
        *noise = LEAST_NOISE;
    return (int32_t)mean;
}

/* Level (8 fraction bits) and noise (6) of a tile in the `count` rows up to `last`. */
static void measure_tile(struct tracker_front_rows *rows, int tile, int32_t last, int32_t count, int32_t *level,
                         int32_t *noise)
{
    uint16_t values[TRACKER_FRONT_SAMPLES];
    const uint16_t *row;
    int32_t x, y, middle, upper, half;
    int n = 0;

    for (y = 0; y < count; y++) {
        row = tracker_front_row_at(rows, last - count + 1 + y);
        for (x = tracker_front_edge[tile] + y % TRACKER_FRONT_STRIDE; x < tracker_front_edge[tile + 1];
             x += TRACKER_FRONT_STRIDE)
            values[n++] = row[x];
    }
    if (n == 0) {
        *level = 0;
        *noise = LEAST_NOISE;
        return;
    }
    middle = kth(values, n, (n - 1) / 2);
    upper = kth(values, n, (n * 27571) >> 15);
    half = 192 * (upper - middle);
    if (half < 3 * LEAST_NOISE)
        half = 3 * LEAST_NOISE;
    (void)clipped(values, n, middle, half + 32, noise);
    *level = middle * 256 + clipped(values, n, middle, 3 * *noise + 32, noise);
    /* noise below zero is missing: its tail is longer */
    if (2 * middle <= upper - middle && *noise < 64 * (upper - middle + 1) && kth(values, n, 0) == 0)
        *noise = 64 * (upper - middle + 1);
}

static int32_t median(int32_t a, int32_t b, int32_t c)
{
    int32_t low = a < b ? a : b, high = a < b ? b : a;

    return c < low ? low : c > high ? high : c;
}

static int32_t positive(int64_t value, int32_t most)
{
    return (int32_t)tracker_limited(value, 0, most);
}

/* One tile after another block; levels of 12 fraction bits. */
static void follow_tile(struct tracker_front_block *block, int tile, int32_t level, int32_t noise, int gain)
{
    int32_t ahead = level - block->level[tile] - block->slope[tile], before = block->noise[tile];
    int32_t followed = 2 * (int64_t)noise <= 3 * (int64_t)before ? ahead : 0; /* not the light of stars and trails */
    int lost = tracker_magnitude(followed) > before >> 1;
    int step = gain == 0 || tracker_magnitude(ahead) > 4 * (int64_t)before;

    if (lost || step)
        block->level[tile] = level;
    else
        block->level[tile] = positive((int64_t)block->level[tile] + block->slope[tile] + tracker_shift_right(followed, gain),
                                     LARGEST_LEVEL << 12);
    if (step)
        block->slope[tile] = 0;
    else
        block->slope[tile] += (int32_t)tracker_shift_right(followed, lost ? 2 : 5);
    if (gain == 0 || noise > 4 * (int64_t)before || 2 * (int64_t)noise < before)
        block->noise[tile] = noise;
    else
        block->noise[tile] += (int32_t)tracker_shift_right(noise - block->noise[tile], gain);
}

void tracker_front_follow(struct tracker_front_rows *rows, int32_t block, int32_t count)
{
    struct tracker_front_block *next = &rows->block[block % TRACKER_FRONT_KEPT];
    int32_t level[TRACKER_FRONT_TILES], noise[TRACKER_FRONT_TILES];
    int32_t last = block * TRACKER_FRONT_BLOCK + count - 1;
    int tile, side;

    for (tile = 0; tile < TRACKER_FRONT_TILES; tile++)
        measure_tile(rows, tile, last, count, &level[tile], &noise[tile]);
    if (block > 0)
        *next = rows->block[(block - 1) % TRACKER_FRONT_KEPT];
    for (tile = 0; tile < TRACKER_FRONT_TILES; tile++) {
        side = tile > 0 && tile < TRACKER_FRONT_TILES - 1;
        follow_tile(next, tile, 16 * (side ? median(level[tile - 1], level[tile], level[tile + 1]) : level[tile]),
                    64 * (side ? median(noise[tile - 1], noise[tile], noise[tile + 1]) : noise[tile]),
                    block < 2 ? block : 2);
    }
}

/* Level at a border, from those of the tiles next to it. */
static int32_t extended(int32_t first, int32_t second, int side)
{
    int64_t rise = (int64_t)(first - second) * tracker_front_extend[side];

    return positive(first + tracker_shift_right(rise, 16), LARGEST_LEVEL << 8);
}

void tracker_front_line_at(struct tracker_front_rows *rows, int32_t y)
{
    int32_t number = y / TRACKER_FRONT_BLOCK;
    struct tracker_front_line *line = &rows->line;
    const struct tracker_front_block *block;
    int64_t moved;
    int tile;

    if (number > TRACKER_FRONT_BLOCKS - 1)
        number = TRACKER_FRONT_BLOCKS - 1;
    block = &rows->block[number % TRACKER_FRONT_KEPT];
    for (tile = 0; tile < TRACKER_FRONT_TILES; tile++) {
        moved = (int64_t)block->slope[tile] * (2 * (y - number * TRACKER_FRONT_BLOCK) - TRACKER_FRONT_BLOCK + 1);
        line->level[tile + 1] =
            positive(block->level[tile] + tracker_shift_right(moved, 3), LARGEST_LEVEL << 12) >> 4;
        line->noise[tile + 1] = block->noise[tile] >> 4;
        line->slope[tile + 1] = (int32_t)tracker_shift_right(block->slope[tile], 6);
    }
    tile = TRACKER_FRONT_TILES > 1;
    line->level[0] = extended(line->level[1], line->level[1 + tile], 0);
    line->level[TRACKER_FRONT_TILES + 1] =
        extended(line->level[TRACKER_FRONT_TILES], line->level[TRACKER_FRONT_TILES - tile], 1);
    line->noise[0] = line->noise[1];
    line->noise[TRACKER_FRONT_TILES + 1] = line->noise[TRACKER_FRONT_TILES];
    line->slope[0] = line->slope[1];
    line->slope[TRACKER_FRONT_TILES + 1] = line->slope[TRACKER_FRONT_TILES];
}

int tracker_front_cell(int32_t x)
{
    int cell = 0;

    while (cell < TRACKER_FRONT_TILES && x >= tracker_front_knot[cell + 1])
        cell++;
    return cell;
}

int32_t tracker_front_between(const int32_t *knots, int cell, int32_t x)
{
    int64_t rise = (int64_t)(knots[cell + 1] - knots[cell]) * tracker_front_inverse[cell];

    return knots[cell] + (int32_t)tracker_shift_right(rise * (x - tracker_front_knot[cell]), 16);
}

/* A pixel without the rise of the background, in whole DN; it remains saturated, or not. */
static uint16_t without(uint16_t value, int32_t rise)
{
    const int32_t most = TRACKER_FRONT_SATURATION - 1 < UINT16_MAX ? TRACKER_FRONT_SATURATION - 1 : UINT16_MAX;

    return value < TRACKER_FRONT_SATURATION ? (uint16_t)positive((int64_t)value - rise, most) : value;
}

int tracker_front_inside(const struct tracker_front_candidate *candidate, int column, int row)
{
    int32_t x = candidate->x + column - TRACKER_FRONT_HALF, y = candidate->y + row - TRACKER_FRONT_HALF;

    return x >= 0 && x < TRACKER_WIDTH && y >= 0 && y < TRACKER_HEIGHT;
}

void tracker_front_level(const struct tracker_front_rows *rows, int cell, struct tracker_front_candidate *candidate)
{
    const int32_t *level = rows->line.level;
    const int32_t across =
        (int32_t)tracker_shift_right((int64_t)(level[cell + 1] - level[cell]) * tracker_front_inverse[cell], 16);
    const int32_t down = tracker_front_between(rows->line.slope, cell, candidate->x);
    int32_t rise;
    int i, j;

    for (j = 0; j < TRACKER_FRONT_SIDE; j++)
        for (i = 0; i < TRACKER_FRONT_SIDE; i++) {
            uint16_t *value = &candidate->stamp[j * TRACKER_FRONT_SIDE + i];
            rise = across * (i - TRACKER_FRONT_HALF) + down * (j - TRACKER_FRONT_HALF);
            if (tracker_front_inside(candidate, i, j))
                *value = without(*value, (int32_t)tracker_shift_right(rise + 128, 8));
        }
}
