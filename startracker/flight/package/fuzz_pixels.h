/* Frames for the fuzzers, from bytes.
 *
 * The first byte chooses how the others become pixels: 16 bits each, repeated to the end of the frame; or a background
 * with noise and the stars of a field, perhaps moved along a line, on which each group of eight bytes sets a star, a
 * column, a row, a box or single pixels. */
#ifndef TRACKER_FUZZ_PIXELS_H
#define TRACKER_FUZZ_PIXELS_H

#include "fuzz_fields.h"

#define PIXELS_HEAD 12
#define PIXELS_GROUP 8
#define REACH 6
#define TRAIL_NODES 8

static inline void add(uint16_t *pixel, uint32_t value)
{
    const uint32_t sum = *pixel + value;

    *pixel = (uint16_t)(sum > UINT16_MAX ? UINT16_MAX : sum);
}

/* A star: flux over a parabola to the fourth power, width and centre in sixteenths of a pixel. */
static inline void add_star(uint16_t *frame, int x16, int y16, uint32_t peak, int width)
{
    int x, y;

    for (y = y16 / 16 - REACH; y <= y16 / 16 + REACH; y++)
        for (x = x16 / 16 - REACH; x <= x16 / 16 + REACH; x++) {
            const int dx = 16 * x - x16, dy = 16 * y - y16, square = (dx * dx + dy * dy) / (1 + width);
            const uint32_t left = square < 1024 ? (uint32_t)(1024 - square) : 0;
            if (left > 0 && x >= 0 && y >= 0 && x < TRACKER_WIDTH && y < TRACKER_HEIGHT)
                add(&frame[y * TRACKER_WIDTH + x], (uint32_t)(((uint64_t)peak * left * left) >> 20));
        }
}

static inline void add_box(uint16_t *frame, int left, int top, int width, int height, uint32_t value)
{
    int x, y;

    for (y = top; y < top + height && y < TRACKER_HEIGHT; y++)
        for (x = left; x < left + width && x < TRACKER_WIDTH; x++)
            add(&frame[y * TRACKER_WIDTH + x], value);
}

static inline void add_group(uint16_t *frame, const uint8_t *bytes)
{
    const int x16 = (int)(of_two(bytes + 1) % (16 * TRACKER_WIDTH)), y16 = (int)(of_two(bytes + 3) % (16 * TRACKER_HEIGHT));
    const uint32_t value = of_two(bytes + 5);

    switch (bytes[0] % 8) {
    case 0:
        add_box(frame, x16 / 16, 0, 1, TRACKER_HEIGHT, value);
        break;
    case 1:
        add_box(frame, 0, y16 / 16, TRACKER_WIDTH, 1 + bytes[7] % 4, value);
        break;
    case 2:
        add_box(frame, x16 / 16, y16 / 16, 1 + bytes[7] % 64, 1 + bytes[7] / 8, value);
        break;
    case 3:
        frame[y16 / 16 * TRACKER_WIDTH + x16 / 16] = (uint16_t)value;
        break;
    default:
        add_star(frame, x16, y16, value, bytes[7] % 16);
    }
}

/* The guide stars of a field, with peaks that fall by a tenth from one to the next. */
static inline void add_field(uint16_t *frame, const uint8_t *data)
{
    struct field field;
    uint32_t peak = (uint32_t)data[8] << 4;
    int n, k;

    look_at(field.axis, of_two(data + 1), data[7] * 256u);
    find_field(&field);
    for (n = 0; n < field.count; n++, peak -= peak / 10)
        for (k = 0; k < TRAIL_NODES; k++)
            add_star(frame, (int)(16.0 * field.at[n][0]) + (int8_t)data[9] * (2 * k - TRAIL_NODES + 1) / TRAIL_NODES,
                     (int)(16.0 * field.at[n][1]) + (int8_t)data[10] * (2 * k - TRAIL_NODES + 1) / TRAIL_NODES,
                     peak / TRAIL_NODES, data[11] % 16);
}

/* A frame from at least PIXELS_HEAD bytes; the number of its rows that are given. */
static inline int make_frame(uint16_t *frame, const uint8_t *data, size_t size)
{
    const size_t pixels = (size_t)TRACKER_WIDTH * TRACKER_HEIGHT;
    uint32_t state = 1 + of_two(data + 1);
    const uint32_t base = of_two(data + 3), noise = data[5], slope = data[6];
    const int kind = data[0] % 16, rows = kind == 15 ? data[7] % (TRACKER_HEIGHT + 4) : TRACKER_HEIGHT;
    size_t n;

    for (n = 0; n < pixels; n++) {
        if (kind == 0) {
            frame[n] = (uint16_t)of_two(data + 1 + 2 * n % (size - 2));
            continue;
        }
        state = state * 1664525u + 1013904223u;
        frame[n] = 0;
        add(&frame[n], base + ((state >> 16) % (1 + noise) + (state >> 8 & 0xFF) % (1 + noise)) / 2
                           + (uint32_t)(n % TRACKER_WIDTH) * slope / 64);
    }
    if (kind == 0)
        return rows;
    if (kind < 8)
        add_field(frame, data);
    for (data += PIXELS_HEAD, size -= PIXELS_HEAD; size >= PIXELS_GROUP; data += PIXELS_GROUP, size -= PIXELS_GROUP)
        add_group(frame, data);
    return rows;
}

#endif
