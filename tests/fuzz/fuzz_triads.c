/* Fuzzing of the exported triads (libFuzzer): bytes to a list of centroids, and what holds for every answer.
 *
 * Each star takes six bytes, the first two of which choose what they mean: coordinates of 24 bits over the image, a step
 * of 12 bits from the star before, a star given twice, or coordinates of the whole format. */
#include <stdint.h>
#include <stdlib.h>

#include "tracker.h"

#define BYTES 6
#define LONGEST (TRACKER_MAX_POINTS + 2)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static int32_t scaled(const uint8_t *bytes, int64_t half)
{
    const int64_t n = ((int64_t)bytes[1] << 8 | bytes[0]) - 32768;

    return (int32_t)(n * half / 32768);
}

static void require(int holds)
{
    if (!holds)
        abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context; /* from the heap, whose ends the sanitizer guards */
    static struct tracker_answer *answer;
    int32_t xy[LONGEST][2];
    int count = 0, named = 0, k, j;

    if (context == NULL) {
        context = malloc(sizeof *context);
        answer = malloc(sizeof *answer);
    }
    require(context != NULL && answer != NULL);
    for (; size >= BYTES && count < LONGEST; data += BYTES, size -= BYTES, count++) {
        const int way = data[0] % 8;
        for (k = 0; k < 2; k++) {
            const uint8_t *bytes = data + 2 + 2 * k;
            if (way == 0 && count > 0)
                xy[count][k] = xy[count - 1][k];
            else if (way == 1 && count > 0)
                xy[count][k] = xy[count - 1][k] / 2 + scaled(bytes, 1 << 22);
            else if (way == 2)
                xy[count][k] = scaled(bytes, INT32_MAX);
            else
                xy[count][k] = scaled(bytes, (int64_t)(k ? TRACKER_HALF_Y : TRACKER_HALF_X) << 10);
        }
    }
    tracker_solve(context, (const int32_t(*)[2])xy, count, answer);
    require(answer->status <= TRACKER_SEARCH_LIMIT && answer->reason <= TRACKER_TOO_MANY_TRIADS);
    require((answer->status == TRACKER_SOLVED) == (answer->reason == TRACKER_ACCEPTED));
    require(answer->points >= 0 && answer->points <= TRACKER_MAX_POINTS && answer->matched <= answer->points);
    for (k = 0; k < TRACKER_MAX_POINTS; k++)
        named += answer->number[k] != 0;
    require(answer->status == TRACKER_SOLVED ? named >= 3 && answer->evidence >= TRACKER_THRESHOLD : named == 0);
    for (k = 0; answer->status == TRACKER_SOLVED && k < 3; k++)
        for (j = 0; j < 3; j++) {
            const int32_t(*m)[3] = (const int32_t(*)[3])answer->attitude.matrix;
            const int64_t dot = (int64_t)m[k][0] * m[j][0] + (int64_t)m[k][1] * m[j][1] + (int64_t)m[k][2] * m[j][2];
            const int64_t off = dot - (k == j ? (int64_t)1 << 60 : 0);
            require(off < (int64_t)1 << 35 && off > -((int64_t)1 << 35));
        }
    return 0;
}
