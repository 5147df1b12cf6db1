/* Lists of stars, and the answers that the Python reference gave at the export. */
#include <stdio.h>

#include "tracker.h"

#include "test_data.h"

int main(void)
{
    static struct tracker_context context;
    static const struct tracker_frame_info nothing;
    struct tracker_answer answer;
    int n, failed = 0;

    for (n = 0; n < TEST_LISTS; n++) {
        struct tracker_frame_info info = nothing;
        info.velocity = test_velocity;
        info.epoch = TEST_EPOCH;
        tracker_start(&context, &info);
        tracker_solve_stars(&context, &test_star[test_first[n]], test_first[n + 1] - test_first[n], &answer);
        failed += test_differs("list", n, &answer, &test_list_answer[n]);
    }
    tracker_start(&context, &nothing);
    tracker_solve_stars(&context, test_star, 0, &answer);
    if (answer.status == TRACKER_SOLVED) {
        printf("an empty list is solved\n");
        failed++;
    }
    printf("%d lists, %d failed\n", TEST_LISTS + 1, failed);
    return failed > 0;
}
