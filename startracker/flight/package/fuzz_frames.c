/* Fuzzing of frames (libFuzzer): pixels to the answer. */
#include "fuzz_pixels.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context;
    static struct tracker_answer *answer;
    static uint16_t *frame, *row;
    struct tracker_frame_info info;
    int y, rows;

    if (size < PIXELS_HEAD)
        return 0;
    if (context == NULL) {
        context = guarded(sizeof *context);
        answer = guarded(sizeof *answer);
        frame = guarded((size_t)TRACKER_WIDTH * TRACKER_HEIGHT * sizeof *frame);
        row = guarded(TRACKER_WIDTH * sizeof *row);
    }
    memset(&info, 0, sizeof info);
    rows = make_frame(frame, data, size);
    tracker_start(context, &info);
    for (y = 0; y < rows; y++) {
        memcpy(row, &frame[y % TRACKER_HEIGHT * TRACKER_WIDTH], TRACKER_WIDTH * sizeof *row);
        tracker_row(context, row);
    }
    tracker_finish(context, answer);
    check_answer(answer);
    check_stars(context->star, context->star_count);
    return 0;
}
