/* What holds for every answer, and the memory of the fuzzers. */
#ifndef TRACKER_FUZZ_CHECK_H
#define TRACKER_FUZZ_CHECK_H

#include <stdio.h>
#include <stdlib.h>

#include "tracker.h"

#define require(holds) require_that((holds) != 0, #holds)

static inline void require_that(int holds, const char *what)
{
    if (!holds) {
        fprintf(stderr, "ERROR: does not hold: %s\n", what);
        abort();
    }
}

/* Memory from the heap, whose ends the sanitizer guards; never freed. */
static inline void *guarded(size_t size)
{
    void *memory = malloc(size);

    require(memory != NULL);
    return memory;
}

static inline int near(int64_t value, int64_t target, int64_t tolerance)
{
    return value - target <= tolerance && target - value <= tolerance;
}

static inline void check_unit(const struct tracker_vector *a, const struct tracker_vector *b, int64_t target)
{
    const int64_t dot = (int64_t)a->x * b->x + (int64_t)a->y * b->y + (int64_t)a->z * b->z;

    require(near(dot >> 30, target, 1 << 10));
}

static inline void check_solved(const struct tracker_answer *answer)
{
    int64_t norm = 0;
    int j, k;

    require(answer->matched >= 3 && answer->used >= 2 && answer->used <= answer->stars);
    for (k = 0; k < 4; k++)
        norm += (int64_t)answer->quaternion[k] * answer->quaternion[k];
    require(near(norm >> 30, (int64_t)1 << 30, 1 << 10) && answer->quaternion[3] >= 0);
    for (j = 0; j < 3; j++)
        for (k = 0; k < 3; k++) {
            check_unit(&answer->attitude.row[j], &answer->attitude.row[k], j == k ? (int64_t)1 << 30 : 0);
            require(answer->covariance[j][k] == answer->covariance[k][j]);
        }
    for (j = 0; j < 3; j++)
        require(answer->covariance[j][j] > 0);
}

static inline void check_answer(const struct tracker_answer *answer)
{
    int named = 0, j, k;

    require(answer->status <= TRACKER_BAD_IMAGE && answer->reason <= TRACKER_SATURATED_SHARE);
    require((answer->status == TRACKER_SOLVED) == (answer->reason == TRACKER_ACCEPTED));
    require(answer->stars >= 0 && answer->stars <= TRACKER_MAX_STARS);
    require(answer->matched >= 0 && answer->matched <= answer->stars && answer->steps >= 0);
    for (k = 0; k < TRACKER_MAX_STARS; k++)
        named += answer->number[k] != 0;
    if (answer->status == TRACKER_SOLVED) {
        require(named == answer->used);
        check_solved(answer);
        return;
    }
    require(named == 0 && answer->used == 0);
    for (k = 0; k < 4; k++)
        require(answer->quaternion[k] == 0);
    for (j = 0; j < 3; j++)
        for (k = 0; k < 3; k++)
            require(answer->covariance[j][k] == 0);
}

#endif
