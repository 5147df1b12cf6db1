/* Fuzzing of the identification alone (libFuzzer): a list to the guide stars that it may show. */
#include "fuzz_fields.h"

#include "tracker_directions.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_search *search;
    static struct list *list;
    static struct tracker_found *found;
    struct tracker_vector direction[TRACKER_MAX_STARS];
    uint8_t seen[TRACKER_MAX_STARS];
    int k;

    if (size < FIELD_HEAD)
        return 0;
    if (search == NULL) {
        search = guarded(sizeof *search);
        list = guarded(sizeof *list);
        found = guarded(sizeof *found);
    }
    (void)make_list(list, data, size, TRACKER_MAX_STARS);
    for (k = 0; k < list->count; k++) {
        seen[k] = (uint8_t)tracker_star_vector(&list->star[k], &direction[k]);
        if (seen[k])
            check_product(&direction[k], &direction[k], 1 << 30);
    }
    tracker_identify(search, &list->observer, &list->info.prior, list->star, direction, seen, list->count, found);
    require(found->reason <= TRACKER_STEPS_USED_UP && found->steps >= 0 && found->steps <= TRACKER_SEARCH_MOST_STEPS);
    require(found->best.matched >= 0 && found->best.matched <= list->count);
    if (found->best.matched > 0) {
        check_guides(found->best.guide, list->count);
        check_attitude(&found->best.attitude);
    }
    return 0;
}
