/* Frames that are made here of a few numbers, with a known attitude or without stars.
 *
 * A frame is an even background, noise from a linear congruential generator of its own for each row, and stars whose
 * images are a product of two profiles, tabulated at eighths of a pixel. */
#include <stdio.h>

#include "tracker.h"

#include "test_data.h"

static uint32_t next(uint32_t state)
{
    return state * 1664525u + 1013904223u;
}

static uint32_t profile(int offset)
{
    const int size = offset < 0 ? -offset : offset;

    return size < TEST_PROFILE ? test_profile[size] : 0;
}

static void make_row(uint16_t *row, uint32_t seed, int y, const struct test_source *source, int count)
{
    uint32_t state = seed + (uint32_t)y * 2654435761u;
    uint64_t value;
    int x, n, k;

    for (x = 0; x < TRACKER_WIDTH; x++) {
        value = 0;
        for (k = 0; k < 4; k++) {
            state = next(state);
            value += state >> 16;
        }
        row[x] = (uint16_t)(TEST_LEVEL + value * TEST_NOISE / 65536);
    }
    for (n = 0; n < count; n++)
        for (x = source[n].x8 / 8 - TEST_REACH; x <= source[n].x8 / 8 + TEST_REACH; x++)
            if (x >= 0 && x < TRACKER_WIDTH) {
                const uint64_t shape = (uint64_t)profile(8 * x - source[n].x8) * profile(8 * y - source[n].y8);
                value = row[x] + ((shape * source[n].flux) >> 30);
                row[x] = (uint16_t)(value > TEST_WHITE ? TEST_WHITE : value);
            }
}

int main(void)
{
    static struct tracker_context context;
    static const struct tracker_frame_info nothing;
    static uint16_t row[TRACKER_WIDTH];
    struct tracker_answer answer;
    uint32_t digest = 2166136261u;
    int n, y, solved = 0, failed = 0;

    for (n = 0; n < TEST_FRAMES; n++) {
        struct tracker_frame_info info = nothing;
        info.velocity = test_velocity;
        info.epoch = TEST_EPOCH;
        tracker_start(&context, &info);
        for (y = 0; y < TRACKER_HEIGHT; y++) {
            make_row(row, TEST_SEED + (uint32_t)n, y, &test_source[test_source_first[n]],
                     test_source_first[n + 1] - test_source_first[n]);
            tracker_row(&context, row);
        }
        tracker_finish(&context, &answer);
        digest = test_digest(digest, &answer);
        solved += answer.status == TRACKER_SOLVED;
        failed += test_fails("frame", n, &answer, &test_frame_truth[n], NULL);
    }
    if (solved == 0) {
        printf("no frame is solved\n");
        failed++;
    }
    tracker_start(&context, &nothing);
    tracker_finish(&context, &answer);
    if (answer.status != TRACKER_BAD_IMAGE) {
        printf("a frame without rows is not refused\n");
        failed++;
    }
    printf("%d frames, %d failed, digest %08lx\n", TEST_FRAMES + 1, failed, (unsigned long)digest);
    return failed > 0;
}
