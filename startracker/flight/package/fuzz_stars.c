/* Fuzzing of lists of stars (libFuzzer): a list to the answer. */
#include "fuzz_fields.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context;
    static struct tracker_answer *answer;
    static struct list *list;

    if (size < FIELD_HEAD)
        return 0;
    if (context == NULL) {
        context = guarded(sizeof *context);
        answer = guarded(sizeof *answer);
        list = guarded(sizeof *list);
    }
    (void)make_list(list, data, size, TRACKER_MAX_STARS);
    tracker_start(context, &list->info);
    tracker_solve_stars(context, list->star, list->count, answer);
    check_answer(answer);
    return 0;
}
