/* Fuzzing of the attitude alone (libFuzzer): stars with guide stars, true ones or any, and an attitude nearby. */
#include "fuzz_fields.h"

#include "tracker_directions.h"
#include "tracker_pose.h"

/* Gives a star any guide star that no other one has. */
static void misidentify(struct list *list, int star, int16_t guide)
{
    int k;

    for (k = 0; k < list->count; k++)
        if (list->guide[k] == guide)
            return;
    list->guide[star] = guide;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_pose *pose;
    static struct list *list;
    struct tracker_matrix attitude;
    int64_t covariance[3][3];
    int shift, used, k, named = 0;

    if (size < FIELD_HEAD)
        return 0;
    if (pose == NULL) {
        pose = guarded(sizeof *pose);
        list = guarded(sizeof *list);
    }
    (void)make_list(list, data, size, TRACKER_MAX_STARS);
    attitude = list->attitude;
    shift = data[7] / 8 % 20;
    if (!tracker_turn(&attitude, (int8_t)data[8] * ((int64_t)1 << shift), (int8_t)data[9] * ((int64_t)1 << shift),
                      (int8_t)data[10] * ((int64_t)1 << shift)))
        return 0;
    if (data[7] & 4)
        misidentify(list, data[11] % TRACKER_MAX_STARS, (int16_t)(of_two(data + 10) % TRACKER_SEARCH_GUIDES));
    used = tracker_solve_pose(pose, list->star, list->count, list->guide, &list->observer, &attitude, covariance);
    require(used == 0 || (used >= 2 && used <= list->count));
    if (used == 0)
        return 0;
    for (k = 0; k < list->count; k++)
        named += list->guide[k] >= 0;
    require(named == used);
    check_guides(list->guide, list->count);
    check_attitude(&attitude);
    check_covariance(covariance);
    return 0;
}
