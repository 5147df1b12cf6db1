/* Lists of stars of fields whose attitude is known, with errors, false and missing stars; and lists of no field. */
#include <stdio.h>

#include "tracker.h"

#include "test_data.h"

int main(void)
{
    static struct tracker_context context;
    static const struct tracker_frame_info nothing;
    struct tracker_answer answer;
    uint32_t digest = 2166136261u;
    int n, failed = 0;

    for (n = 0; n < TEST_LISTS; n++) {
        const int first = test_first[n], count = test_first[n + 1] - first;
        struct tracker_frame_info info = nothing;
        info.velocity = test_velocity;
        info.epoch = TEST_EPOCH;
        tracker_start(&context, &info);
        tracker_solve_stars(&context, &test_star[first], count, &answer);
        digest = test_digest(digest, &answer);
        failed += test_fails("list", n, &answer, &test_list_truth[n], &test_number[first]);
        if (test_sure[n] && answer.status != TRACKER_SOLVED) {
            printf("list %d: not solved; status %d, reason %d\n", n, (int)answer.status, (int)answer.reason);
            failed++;
        }
    }
    tracker_start(&context, &nothing);
    tracker_solve_stars(&context, test_star, 0, &answer);
    if (answer.status == TRACKER_SOLVED) {
        printf("an empty list is solved\n");
        failed++;
    }
    printf("%d lists, %d failed, digest %08lx\n", TEST_LISTS + 1, failed, (unsigned long)digest);
    return failed > 0;
}
