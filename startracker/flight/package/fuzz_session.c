/* Fuzzing of the tracking (libFuzzer): a few lists one after the other, each solved with the prediction from those before. */
#include "fuzz_fields.h"

#define STARS 9

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context;
    static struct tracker_answer *answer;
    static struct tracker_following *following;
    static struct list *list;
    int64_t time_us = 0;
    enum tracker_following_result result;

    if (context == NULL) {
        context = guarded(sizeof *context);
        answer = guarded(sizeof *answer);
        following = guarded(sizeof *following);
        list = guarded(sizeof *list);
    }
    tracker_following_start(following);
    while (size >= FIELD_HEAD) {
        const size_t used = make_list(list, data, size, STARS);
        list->info.time_us = time_us += (int64_t)of_two(data + 8) << (data[10] % 24);
        if (tracker_following_predict(following, time_us, NULL, &list->info.prior) != TRACKER_TIME_BAD) {
            tracker_start(context, &list->info);
            tracker_solve_stars(context, list->star, list->count, answer);
            check_answer(answer);
            result = tracker_following_take(following, answer);
            require(result <= TRACKER_FOLLOWING_COASTING);
            require((result == TRACKER_FOLLOWING_COASTING) == (answer->status != TRACKER_SOLVED));
            check_answer(answer);
        }
        data += used;
        size -= used;
    }
    return 0;
}
