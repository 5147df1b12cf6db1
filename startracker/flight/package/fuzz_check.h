/* What holds for every answer, and the memory of the fuzzers. */
#ifndef TRACKER_FUZZ_CHECK_H
#define TRACKER_FUZZ_CHECK_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tracker.h"

#define require(holds) require_that((holds) != 0, #holds)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static inline void require_that(int holds, const char *what)
{
    if (!holds) {
        fprintf(stderr, "ERROR: does not hold: %s\n", what);
        __builtin_trap();
    }
}

/* Memory from the heap, whose ends the sanitizer guards; never freed. */
static inline void *guarded(size_t size)
{
    void *memory = malloc(size);

    require(memory != NULL);
    return memory;
}

static inline uint32_t of_two(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8;
}

static inline int near(int64_t value, int64_t target, int64_t tolerance)
{
    return value - target <= tolerance && target - value <= tolerance;
}

static inline void check_product(const struct tracker_vector *a, const struct tracker_vector *b, int64_t target)
{
    const int64_t dot = (int64_t)a->x * b->x + (int64_t)a->y * b->y + (int64_t)a->z * b->z;

    require(near(dot >> 30, target, 1 << 10));
}

/* Rows of unit length at right angles, and right-handed, to 2^-20. */
static inline void check_attitude(const struct tracker_matrix *attitude)
{
    const struct tracker_vector *x = &attitude->row[0], *y = &attitude->row[1];
    struct tracker_vector cross;
    int j, k;

    for (j = 0; j < 3; j++)
        for (k = 0; k < 3; k++)
            check_product(&attitude->row[j], &attitude->row[k], j == k ? (int64_t)1 << 30 : 0);
    cross.x = (int32_t)(((int64_t)x->y * y->z - (int64_t)x->z * y->y) >> 30);
    cross.y = (int32_t)(((int64_t)x->z * y->x - (int64_t)x->x * y->z) >> 30);
    cross.z = (int32_t)(((int64_t)x->x * y->y - (int64_t)x->y * y->x) >> 30);
    check_product(&cross, &attitude->row[2], (int64_t)1 << 30);
}

/* Symmetric, and positive definite within the rounding of its elements. */
static inline void check_covariance(int64_t c[3][3])
{
    int j, k;

    for (j = 0; j < 3; j++) {
        require(c[j][j] > 0);
        for (k = 0; k < j; k++) {
            const double rounding = 1.0 + 1e-5 * (double)c[j][j];
            require(c[j][k] == c[k][j]);
            require((double)c[j][k] * (double)c[j][k]
                    <= ((double)c[j][j] + rounding) * ((double)c[k][k] + 1.0 + 1e-5 * (double)c[k][k]));
        }
    }
}

static inline void check_quaternion(const int32_t quaternion[4])
{
    int64_t norm = 0;
    int k;

    for (k = 0; k < 4; k++)
        norm += (int64_t)quaternion[k] * quaternion[k];
    require(near(norm >> 30, (int64_t)1 << 30, 1 << 10));
}

/* A list that a frame gave: sorted, within reach of the frame. */
static inline void check_stars(const struct tracker_star *star, int count)
{
    const int32_t margin = 6 << 16;
    int n;

    require(count >= 0 && count <= TRACKER_MAX_STARS);
    for (n = 0; n < count; n++) {
        require(star[n].flux >= 0 && (n == 0 || star[n].flux <= star[n - 1].flux));
        require(star[n].x >= -margin && star[n].x <= ((TRACKER_WIDTH - 1) << 16) + margin);
        require(star[n].y >= -margin && star[n].y <= ((TRACKER_HEIGHT - 1) << 16) + margin);
        require(star[n].variance > 0 && star[n].flags <= (TRACKER_SATURATED | TRACKER_ELONGATED));
    }
}

/* Guide stars of `count` stars: in the table, each once. */
static inline void check_guides(const int16_t *guide, int count)
{
    int n, k;

    for (n = 0; n < count; n++) {
        require(guide[n] >= -1 && guide[n] < TRACKER_SEARCH_GUIDES);
        for (k = 0; k < n; k++)
            require(guide[n] < 0 || guide[k] != guide[n]);
    }
}

static inline void check_unsolved(const struct tracker_answer *answer)
{
    int j, k;

    require(answer->used == 0);
    for (k = 0; k < TRACKER_MAX_STARS; k++)
        require(answer->number[k] == 0);
    for (k = 0; k < 4; k++)
        require(answer->quaternion[k] == 0);
    for (j = 0; j < 3; j++)
        for (k = 0; k < 3; k++)
            require(answer->covariance[j][k] == 0);
}

static inline void check_answer(struct tracker_answer *answer)
{
    int named = 0, k;

    require(answer->status <= TRACKER_BAD_IMAGE && answer->reason <= TRACKER_ANOTHER_FIELD);
    require((answer->status == TRACKER_SOLVED) == (answer->reason == TRACKER_ACCEPTED));
    require(answer->stars >= 0 && answer->stars <= TRACKER_MAX_STARS);
    require(answer->matched >= 0 && answer->matched <= answer->stars);
    require(answer->steps >= 0 && answer->steps <= TRACKER_SEARCH_MOST_STEPS);
    require(answer->prior_contradicted == 0 || (answer->prior_contradicted == 1 && answer->status == TRACKER_SOLVED));
    if (answer->status != TRACKER_SOLVED) {
        check_unsolved(answer);
        return;
    }
    for (k = 0; k < TRACKER_MAX_STARS; k++)
        named += answer->number[k] != 0;
    require(named == answer->used && answer->matched >= 3 && answer->used >= 2 && answer->used <= answer->stars);
    require(answer->chance <= TRACKER_SEARCH_LOG_RATE && answer->quaternion[3] >= 0);
    check_quaternion(answer->quaternion);
    check_attitude(&answer->attitude);
    check_covariance(answer->covariance);
}

#endif
