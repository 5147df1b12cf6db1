/* A frame from its first row to the answer. */
#include "tracker_solver.h"

#define FASTEST (1 << 20)

/* Who sees the guide stars; what makes products overflow is left out. */
static struct tracker_observer observer_of(const struct tracker_frame_info *info)
{
    const struct tracker_vector *v = &info->velocity, at_rest = {0, 0, 0};
    const int64_t years = info->epoch != 0 ? (int64_t)info->epoch - TRACKER_EPOCH : 0, most = TRACKER_MOST_YEARS * (int64_t)65536;
    struct tracker_observer observer;

    observer.velocity = *v;
    if (v->x > FASTEST || v->x < -FASTEST || v->y > FASTEST || v->y < -FASTEST || v->z > FASTEST || v->z < -FASTEST)
        observer.velocity = at_rest;
    observer.years = years >= -most && years <= most ? (int32_t)years : 0;
    return observer;
}

void tracker_start(struct tracker_context *context, const struct tracker_frame_info *info)
{
    context->info = *info;
    context->observer = observer_of(info);
    context->star_count = 0;
#ifndef TRACKER_CENTROIDS
    tracker_front_start(&context->work.front);
#endif /* frames */
}

#ifndef TRACKER_CENTROIDS
void tracker_row(struct tracker_context *context, const uint16_t *row)
{
    tracker_front_row(&context->work.front, row);
}

void tracker_finish(struct tracker_context *context, struct tracker_answer *answer)
{
    const struct tracker_front *front = &context->work.front;
    int32_t saturated;
    int count;

    count = tracker_front_finish(&context->work.front, context->star);
    saturated = front->saturated;
    if (count < 0) {
        tracker_refuse(answer, TRACKER_BAD_IMAGE, TRACKER_ROWS_MISSING);
        return;
    }
    if (front->lowest == front->highest) {
        tracker_refuse(answer, TRACKER_BAD_IMAGE, TRACKER_FRAME_UNIFORM);
        return;
    }
    context->star_count = count;
    tracker_solve_list(context, answer); /* its memory is that of the front end */
    if (answer->status != TRACKER_SOLVED && (int64_t)saturated * TRACKER_SATURATED_PART > (int64_t)TRACKER_WIDTH * TRACKER_HEIGHT) {
        answer->status = TRACKER_FRAME_SATURATED;
        answer->reason = TRACKER_SATURATED_SHARE;
    }
}
#endif /* frames */
