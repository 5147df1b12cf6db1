/* Fuzzing of the front end alone (libFuzzer): pixels to a list of stars. */
#include "fuzz_pixels.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_front *front;
    static struct tracker_star *star;
    static uint16_t *frame, *row;
    int y, rows, count;

    if (size < PIXELS_HEAD)
        return 0;
    if (front == NULL) {
        front = guarded(sizeof *front);
        star = guarded(TRACKER_MAX_STARS * sizeof *star);
        frame = guarded((size_t)TRACKER_WIDTH * TRACKER_HEIGHT * sizeof *frame);
        row = guarded(TRACKER_WIDTH * sizeof *row);
    }
    rows = make_frame(frame, data, size);
    tracker_front_start(front);
    for (y = 0; y < rows; y++) {
        memcpy(row, &frame[y % TRACKER_HEIGHT * TRACKER_WIDTH], TRACKER_WIDTH * sizeof *row);
        tracker_front_row(front, row);
    }
    count = tracker_front_finish(front, star);
    require((count < 0) == (rows < TRACKER_HEIGHT));
    check_stars(star, count < 0 ? 0 : count);
    return 0;
}
