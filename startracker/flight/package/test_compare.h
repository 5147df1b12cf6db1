/* Comparison of answers: every number in integer arithmetic; with float attitudes within TEST_TOLERANCE of 2.30 and
 * covariances within 1 %, as the reference is in integers. */
#ifndef TRACKER_TEST_COMPARE_H
#define TRACKER_TEST_COMPARE_H

#include <stdio.h>

#include "tracker.h"

static int64_t test_apart(int64_t a, int64_t b)
{
    return a < b ? b - a : a - b;
}

static int test_differs(const char *what, int n, const struct tracker_answer *got, const struct tracker_answer *expected)
{
    const struct tracker_vector *a = got->attitude.row, *b = expected->attitude.row;
    int differs = got->status != expected->status || got->reason != expected->reason || got->stars != expected->stars;
    int k;

    for (k = 0; k < got->stars && k < TRACKER_MAX_STARS; k++)
        differs |= got->number[k] != expected->number[k];
    for (k = 0; k < 3; k++)
        differs |= test_apart(a[k].x, b[k].x) > TEST_TOLERANCE || test_apart(a[k].y, b[k].y) > TEST_TOLERANCE
                   || test_apart(a[k].z, b[k].z) > TEST_TOLERANCE;
    for (k = 0; k < 4; k++)
        differs |= test_apart(got->quaternion[k], expected->quaternion[k]) > TEST_TOLERANCE;
    for (k = 0; k < 3; k++)
        differs |= test_apart(got->covariance[k][k], expected->covariance[k][k])
                   > (TEST_TOLERANCE > 0 ? expected->covariance[k][k] / 100 : 0);
    if (differs)
        printf("%s %d: status %d, reason %d, %d of %d stars identified; expected %d, %d, %d of %d\n", what, n,
               (int)got->status, (int)got->reason, got->matched, got->stars, (int)expected->status,
               (int)expected->reason, expected->matched, expected->stars);
    return differs;
}

#endif
