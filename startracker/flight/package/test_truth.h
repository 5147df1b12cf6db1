/* Whether an answer agrees with the truth, and a digest of all answers.
 *
 * An attitude may differ from the true one by TEST_SIGMAS of its own standard errors about each axis of the camera; an
 * identified star must be that star; stars of no attitude must not be solved. The digest holds every number of every
 * answer: builds for two processors have the same one if they compute the same bits. */
#ifndef TRACKER_TEST_TRUTH_H
#define TRACKER_TEST_TRUTH_H

#include <stdio.h>

#include "tracker.h"

struct test_truth {
    int known;                      /* 0: there is no attitude, or there are too few stars to determine it */
    struct tracker_matrix attitude; /* 2.30 */
};

static int64_t test_product(const struct tracker_vector *a, const struct tracker_vector *b)
{
    return ((int64_t)a->x * b->x + (int64_t)a->y * b->y + (int64_t)a->z * b->z) / (1 << 30);
}

/* Whether a rotation about an axis, 2.30, is beyond the standard error of a variance, square radians, 60 fraction bits. */
static int test_is_beyond(int64_t rotation, int64_t variance)
{
    return variance <= 0 || rotation * rotation / (TEST_SIGMAS * TEST_SIGMAS) > variance;
}

static int test_is_wrong(const struct tracker_answer *got, const struct tracker_matrix *truth)
{
    const struct tracker_vector *a = got->attitude.row, *b = truth->row;
    int wrong = 0;
    int k;

    for (k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const int64_t rotation = (test_product(&a[j], &b[i]) - test_product(&a[i], &b[j])) / 2;
        wrong |= test_product(&a[k], &b[k]) < (1 << 30) - (1 << 20); /* 2.5 degrees */
        wrong |= test_is_beyond(rotation, got->covariance[k][k]);
    }
    return wrong;
}

/* 1, and a line of text, if an answer contradicts the truth. number: catalogue number of each star, 0 for a false one; NULL
 * if they are not known. */
static int test_fails(const char *what, int n, const struct tracker_answer *got, const struct test_truth *truth,
                      const int32_t *number)
{
    const int solved = got->status == TRACKER_SOLVED;
    int fails = solved && (!truth->known || test_is_wrong(got, &truth->attitude));
    int k;

    for (k = 0; number != NULL && k < got->stars; k++)
        fails |= got->number[k] != 0 && got->number[k] != number[k];
    fails |= got->steps > TRACKER_SEARCH_MOST_STEPS;
    if (fails)
        printf("%s %d: wrong; status %d, reason %d, %d of %d stars identified\n", what, n, (int)got->status,
               (int)got->reason, got->matched, got->stars);
    return fails;
}

/* The digest with one more number (FNV-1a). */
static uint32_t test_mixed(uint32_t digest, int64_t number)
{
    uint64_t bits = (uint64_t)number;
    int k;

    for (k = 0; k < 8; k++) {
        digest = (digest ^ (uint32_t)(bits & 255u)) * 16777619u;
        bits >>= 8;
    }
    return digest;
}

/* The digest with one more answer. */
static uint32_t test_digest(uint32_t digest, const struct tracker_answer *got)
{
    const int64_t said[] = {(int64_t)got->status, (int64_t)got->reason, got->stars, got->matched, got->used,
                            got->evidence, got->chance, got->steps, got->prior_contradicted};
    int k;

    for (k = 0; k < (int)(sizeof said / sizeof said[0]); k++)
        digest = test_mixed(digest, said[k]);
    for (k = 0; k < got->stars; k++)
        digest = test_mixed(digest, got->number[k]);
    for (k = 0; k < 3; k++) {
        const struct tracker_vector *row = &got->attitude.row[k];
        digest = test_mixed(test_mixed(test_mixed(digest, row->x), row->y), row->z);
    }
    for (k = 0; k < 4; k++)
        digest = test_mixed(digest, got->quaternion[k]);
    for (k = 0; k < 9; k++)
        digest = test_mixed(digest, got->covariance[k / 3][k % 3]);
    return digest;
}

#endif
