/* Fuzzing of frames (libFuzzer): bytes to rows, and what holds for every answer.
 *
 * The first byte chooses how the others become pixels: 16 bits each, repeated to the end of the frame; or a background
 * with noise, on which each group of eight bytes sets a star, a column, a row, a box or single pixels. */
#include <string.h>

#include "fuzz_check.h"

#define HEAD 8
#define GROUP 8
#define REACH 6

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static uint32_t of_two(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8;
}

static void add(uint16_t *pixel, uint32_t value)
{
    const uint32_t sum = *pixel + value;

    *pixel = (uint16_t)(sum > UINT16_MAX ? UINT16_MAX : sum);
}

/* A star: flux over a parabola to the fourth power, width and centre in sixteenths of a pixel. */
static void add_star(uint16_t *frame, int x16, int y16, uint32_t peak, int width)
{
    int x, y;

    for (y = y16 / 16 - REACH; y <= y16 / 16 + REACH; y++)
        for (x = x16 / 16 - REACH; x <= x16 / 16 + REACH; x++) {
            const int dx = 16 * x - x16, dy = 16 * y - y16, square = (dx * dx + dy * dy) / (1 + width);
            const uint32_t left = square < 1024 ? (uint32_t)(1024 - square) : 0;
            if (x >= 0 && y >= 0 && x < TRACKER_WIDTH && y < TRACKER_HEIGHT)
                add(&frame[y * TRACKER_WIDTH + x], (uint32_t)(((uint64_t)peak * left * left) >> 20));
        }
}

static void add_box(uint16_t *frame, int left, int top, int width, int height, uint32_t value)
{
    int x, y;

    for (y = top; y < top + height && y < TRACKER_HEIGHT; y++)
        for (x = left; x < left + width && x < TRACKER_WIDTH; x++)
            add(&frame[y * TRACKER_WIDTH + x], value);
}

static void add_group(uint16_t *frame, const uint8_t *bytes)
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

static void make_frame(uint16_t *frame, const uint8_t *data, size_t size)
{
    const size_t pixels = (size_t)TRACKER_WIDTH * TRACKER_HEIGHT;
    uint32_t state = 1 + of_two(data + 1), base = of_two(data + 3), noise = data[5], slope = data[6];
    size_t n;

    for (n = 0; n < pixels; n++) {
        state = state * 1664525u + 1013904223u;
        frame[n] = 0;
        add(&frame[n], base + ((state >> 16) % (1 + noise) + (state >> 8 & 0xFF) % (1 + noise)) / 2
                           + (uint32_t)(n % TRACKER_WIDTH) * slope / 64);
    }
    for (; size >= GROUP; data += GROUP, size -= GROUP)
        add_group(frame, data);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context;
    static struct tracker_answer *answer;
    static uint16_t *frame, *row;
    const size_t pixels = (size_t)TRACKER_WIDTH * TRACKER_HEIGHT;
    struct tracker_frame_info info;
    int y, rows = TRACKER_HEIGHT;
    size_t n;

    if (size < HEAD)
        return 0;
    if (context == NULL) {
        context = guarded(sizeof *context);
        answer = guarded(sizeof *answer);
        frame = guarded(pixels * sizeof *frame);
        row = guarded(TRACKER_WIDTH * sizeof *row);
    }
    memset(&info, 0, sizeof info);
    if (data[0] % 16 == 0)
        for (n = 0; n < pixels; n++)
            frame[n] = (uint16_t)of_two(data + 1 + 2 * n % (size - 2));
    else
        make_frame(frame, data, size);
    if (data[0] % 16 == 15)
        rows = data[7] % (TRACKER_HEIGHT + 4);
    tracker_start(context, &info);
    for (y = 0; y < rows; y++) {
        memcpy(row, &frame[y % TRACKER_HEIGHT * TRACKER_WIDTH], TRACKER_WIDTH * sizeof *row);
        tracker_row(context, row);
    }
    tracker_finish(context, answer);
    check_answer(answer);
    return 0;
}
