/* Hot pixels: replaced by the median of their neighbours before a row is searched. */
#include "tracker_front_internal.h"

/* The eight pixels about column x of three rows, in rising order. */
static void sorted_neighbours(const uint16_t *const rows[3], int32_t x, uint16_t out[8])
{
    uint16_t value;
    int j, i, n = 0, k;

    for (j = 0; j < 3; j++)
        for (i = -1; i <= 1; i++) {
            if (j == 1 && i == 0)
                continue;
            value = rows[j][x + i];
            for (k = n; k > 0 && out[k - 1] > value; k--)
                out[k] = out[k - 1];
            out[k] = value;
            n++;
        }
}

/* Adds column x to the list if it is a hot pixel. */
static void note_hot(struct tracker_front_rows *all, const uint16_t *const rows[3], int cell, int32_t x,
                     struct tracker_front_bridge *bridge)
{
    int32_t level = tracker_front_between(all->line.level, cell, x);
    uint16_t around[8];

    sorted_neighbours(rows, x, around);
    if (20 * ((int64_t)around[5] * 256 - level) <= 3 * ((int64_t)rows[1][x] * 256 - level)) {
        bridge->x[bridge->count] = (uint16_t)x;
        bridge->value[bridge->count] = around[3];
        bridge->count++;
    }
}

static void find_hot(struct tracker_front_rows *all, int32_t y, struct tracker_front_bridge *bridge)
{
    const struct tracker_front_line *line = &all->line;
    const uint16_t *rows[3];
    int32_t knots[TRACKER_FRONT_KNOTS], step, limit, x, end;
    int cell, k;

    for (k = 0; k < 3; k++)
        rows[k] = tracker_front_row_at(all, y + k - 1);
    tracker_front_line_at(all, y);
    for (k = 0; k < TRACKER_FRONT_KNOTS; k++)
        knots[k] = line->level[k] + 5 * line->noise[k];
    for (cell = 0; cell <= TRACKER_FRONT_TILES; cell++) {
        x = (int32_t)tracker_larger(cell == 0 ? 0 : tracker_front_knot[cell], 1);
        end = cell == TRACKER_FRONT_TILES ? TRACKER_WIDTH : tracker_front_knot[cell + 1];
        end = (int32_t)tracker_smaller(end, TRACKER_WIDTH - 1);
        step = (int32_t)tracker_shift_right((int64_t)(knots[cell + 1] - knots[cell]) * tracker_front_inverse[cell], 12);
        limit = knots[cell] * 16 + step * (x - tracker_front_knot[cell]);
        for (; x < end; x++) {
            if ((int32_t)rows[1][x] * 4096 > limit) {
                note_hot(all, rows, cell, x, bridge);
                if (bridge->count == TRACKER_FRONT_HOT)
                    return;
            }
            limit += step;
        }
    }
}

void tracker_front_bridge_row(struct tracker_front_rows *rows, int32_t y)
{
    struct tracker_front_bridge *here = &rows->bridge[y & 1], *above = &rows->bridge[(y + 1) & 1];
    uint16_t *row;
    int k;

    here->count = 0;
    if (TRACKER_FRONT_SHARE > 0 && TRACKER_WIDTH > 2 && y > 0 && y < TRACKER_HEIGHT - 1)
        find_hot(rows, y, here);
    if (y == 0)
        return;
    row = tracker_front_row_at(rows, y - 1);
    for (k = 0; k < above->count; k++)
        row[above->x[k]] = above->value[k];
}
