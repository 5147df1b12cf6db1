/* From a list of stars to the answer: directions, identification, attitude. */
#include "tracker_solver.h"

#include "tracker_directions.h"

static void clear(struct tracker_answer *answer)
{
    const struct tracker_vector zero = {0, 0, 0};
    int i, j;

    answer->stars = answer->matched = answer->used = 0;
    answer->evidence = answer->chance = answer->steps = 0;
    answer->prior_contradicted = 0;
    for (i = 0; i < TRACKER_MAX_STARS; i++)
        answer->number[i] = 0;
    for (i = 0; i < 4; i++)
        answer->quaternion[i] = 0;
    for (i = 0; i < 3; i++) {
        answer->attitude.row[i] = zero;
        for (j = 0; j < 3; j++)
            answer->covariance[i][j] = 0;
    }
}

void tracker_refuse(struct tracker_answer *answer, enum tracker_status status, enum tracker_reason reason)
{
    clear(answer);
    answer->status = status;
    answer->reason = reason;
}

static enum tracker_status status_of(enum tracker_reason reason)
{
    switch (reason) {
    case TRACKER_ACCEPTED:
        return TRACKER_SOLVED;
    case TRACKER_NOTHING_FOUND:
        return TRACKER_NO_STARS;
    case TRACKER_FEW_FOUND:
        return TRACKER_TOO_FEW_STARS;
    case TRACKER_STEPS_USED_UP:
        return TRACKER_SEARCH_LIMIT;
    case TRACKER_ABOVE_RATE:
    case TRACKER_RIVAL:
        return TRACKER_AMBIGUOUS;
    default:
        return TRACKER_NO_MATCH;
    }
}

/* Attitude and covariance of the identified stars; 0: they fit none. */
static int fit_pose(struct tracker_context *context, struct tracker_found *found, struct tracker_answer *answer)
{
    int k;

    answer->used = tracker_solve_pose(&context->work.fit.pose, context->star, context->star_count, found->best.guide,
                                      &context->observer, &found->best.attitude, answer->covariance);
    if (answer->used == 0)
        return 0;
    answer->attitude = found->best.attitude;
    tracker_quaternion_of(&answer->attitude, answer->quaternion);
    for (k = 0; k < context->star_count; k++)
        if (found->best.guide[k] >= 0)
            answer->number[k] = tracker_guide_number[found->best.guide[k]];
    return 1;
}

/* Whether the stars that an attitude was not fitted to are identified by themselves, most of them as stars beyond its field. */
static int are_of_another_field(struct tracker_context *context, const uint8_t *seen, const struct tracker_found *found,
                                const struct tracker_matrix *attitude, int64_t *steps)
{
    static const struct tracker_prior nothing = {{{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}}, 0};
    struct tracker_vector direction;
    struct tracker_found others;
    uint8_t left[TRACKER_MAX_STARS];
    int32_t xy[2];
    int k, guide, named = 0, inside = 0;

    for (k = 0; k < context->star_count; k++)
        left[k] = seen[k] && found->best.guide[k] < 0 ? 1 : 0;
    tracker_identify(&context->work.search, &context->observer, &nothing, context->star, context->direction, left,
                     context->star_count, &others);
    *steps += others.steps;
    for (k = 0; k < context->star_count && others.reason == TRACKER_ACCEPTED; k++) {
        guide = others.best.guide[k];
        if (guide < 0)
            continue;
        named++;
        tracker_apparent(tracker_guide_direction[guide], tracker_guide_motion[guide], &context->observer, &direction);
        inside += tracker_guide_position(attitude, &direction, xy);
    }
    return named > 2 * inside;
}

/* Why a fitted attitude is refused although chance does not explain it; TRACKER_ACCEPTED: it is not. */
static enum tracker_reason refusal(struct tracker_context *context, const uint8_t *seen, struct tracker_found *found,
                                   const struct tracker_matrix *attitude)
{
    struct tracker_unexplained left;

    if (tracker_few_disagree(&context->work.fit.pose, context->star))
        return TRACKER_FEW_DISAGREE;
    tracker_find_unexplained(&context->work.fit.bright, &context->work.fit.pose, attitude, context->star,
                             context->star_count, &left);
    if (tracker_contradicts(&left))
        return TRACKER_UNEXPLAINED;
    if (tracker_is_doubtful(&left) && are_of_another_field(context, seen, found, attitude, &found->steps))
        return TRACKER_ANOTHER_FIELD;
    return TRACKER_ACCEPTED;
}

void tracker_solve_list(struct tracker_context *context, struct tracker_answer *answer)
{
    uint8_t seen[TRACKER_MAX_STARS];
    struct tracker_found found;
    int k;

    clear(answer);
    for (k = 0; k < context->star_count; k++)
        seen[k] = (uint8_t)tracker_star_vector(&context->star[k], &context->direction[k]);
    tracker_identify(&context->work.search, &context->observer, &context->info.prior, context->star, context->direction, seen,
                     context->star_count, &found);
    answer->reason = found.reason;
    if (found.reason == TRACKER_ACCEPTED)
        answer->reason = fit_pose(context, &found, answer) ? refusal(context, seen, &found, &answer->attitude) : TRACKER_POSE_FAILED;
    if (answer->reason != TRACKER_ACCEPTED)
        clear(answer);
    answer->status = status_of(answer->reason);
    answer->stars = context->star_count;
    answer->matched = found.best.matched;
    answer->evidence = (int32_t)found.best.evidence;
    answer->chance = (int32_t)found.chance;
    answer->steps = (int32_t)found.steps;
    answer->prior_contradicted = answer->status == TRACKER_SOLVED && found.contradicted;
}

void tracker_solve_stars(struct tracker_context *context, const struct tracker_star *star, int count,
                         struct tracker_answer *answer)
{
    int k;

    context->star_count = 0;
    for (k = 0; k < count && k < TRACKER_MAX_STARS; k++)
        context->star[context->star_count++] = star[k];
    tracker_solve_list(context, answer);
}
