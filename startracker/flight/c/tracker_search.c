/* Identification: searches for hypotheses, the strongest first, and their acceptance.
 *
 * The rules are those of startracker/identification/adaptive.py and hypothesis.py. Whatever makes the hypotheses
 * (tracker_candidates.c, tracker_triads.c) gives attitudes to tracker_try_attitude. */
#include "tracker_search.h"

#include "tracker_integers.h"

#define ONE ((int64_t)1 << 30)
#define UNIT_TOLERANCE ((int64_t)1 << 20)
#define LOG_BITS 12
#define LOG_UP 24
/* Squares of 0.15, 0.1 and 5 pixels, 16 fraction bits: of centroids without a stated error; added to the stated ones; beyond
 * which a centroid is not used. */
#define STATED_VARIANCE 1475
#define FLOOR_VARIANCE 656
#define WORST_VARIANCE ((int64_t)25 << 16)
#define MAGNITUDE_FACTOR 24660  /* 2.5 log10(2), in units of 2^-6 magnitudes per 2^-12 of log2 of the flux */
#define MAGNITUDE_SHIFT 21
#define LEAST_EVIDENCE (-29545) /* log2 e^-5 */
#define RIVALS_BEYOND 29547     /* 5 / ln 2: margin with which a field that fits the stated errors is not searched further */
#define AS_STATED 3             /* number of the width 2.2 */
#define LOG_SIX_PI 17352        /* rounded down */
#define MOST_VARIANCE ((int64_t)1 << 46) /* of a direction on one axis, 2^-60 rad^2: the square of half a degree */
#define ONE_RADIAN ((int64_t)1 << 28)
#define PRIOR_SIGMAS2 3969

/* ------------------------------------------------------------------ the stars that are used */

static void take_stars(struct tracker_search *search, const struct tracker_star *star, const struct tracker_vector *direction,
                       const uint8_t *seen, int count)
{
    int n, k;

    search->count = 0;
    search->brightness = 1;
    for (n = 0; n < count; n++) {
        int64_t stated = star[n].variance >> 10;
        if (!seen[n] || stated >= WORST_VARIANCE)
            continue;
        stated = star[n].variance == 0 ? STATED_VARIANCE : stated + FLOOR_VARIANCE;
        k = search->count++;
        search->index[k] = (uint8_t)n;
        search->direction[k] = direction[n];
        search->variance[k] = tracker_smaller((stated * (TRACKER_SEARCH_PIXEL2 >> 4)) >> 12, MOST_VARIANCE);
        if (star[n].flux <= 0)
            search->brightness = 0;
        else
            search->magnitude[k] =
                -(int32_t)((tracker_log_down(star[n].flux) * MAGNITUDE_FACTOR) >> MAGNITUDE_SHIFT);
    }
    for (k = 0; k < search->count && !search->brightness; k++)
        search->magnitude[k] = 0;
}

static void measure_sides(struct tracker_search *search)
{
    int i, j, axis, side;

    for (i = 0; i < search->count && i < TRACKER_SEARCH_SIDE_STARS; i++)
        for (j = 0; j < i; j++) {
            int64_t p[3], q[3], square = 0;
            tracker_to_array(&search->direction[i], p);
            tracker_to_array(&search->direction[j], q);
            for (axis = 0; axis < 3; axis++)
                square += (p[axis] - q[axis]) * (p[axis] - q[axis]);
            side = tracker_side_of(i, j);
            search->chord[side] = (uint32_t)tracker_square_root(square);
            search->error[side] = TRACKER_SEARCH_FIXED_ERROR;
            if (TRACKER_SEARCH_FIXED_ERROR == 0)
                search->error[side] = (uint32_t)tracker_square_root(search->variance[i] + search->variance[j]);
        }
}

/* ------------------------------------------------------------------ hypotheses */

/* Sum of the squared differences of two attitudes, 2^-56. */
static int64_t rotation2(const struct tracker_matrix *one, const struct tracker_matrix *other)
{
    int64_t p[3], q[3], sum = 0;
    int row, k;

    for (row = 0; row < 3; row++) {
        tracker_to_array(&one->row[row], p);
        tracker_to_array(&other->row[row], q);
        for (k = 0; k < 3; k++) {
            const int64_t apart = tracker_shift_right(p[k] - q[k], 2);
            sum += apart * apart;
        }
    }
    return sum;
}

static int allowed(const struct tracker_search *search, const struct tracker_matrix *attitude)
{
    const int64_t radius = search->prior.radius, wider = (radius * 1075) >> 10;

    return radius == 0 || radius >= ONE_RADIAN || rotation2(attitude, &search->prior.attitude) <= 2 * wider * wider;
}

/* Whether two hypotheses share most of the smaller one's pairs. */
static int same_stars(const struct tracker_search *search, const struct tracker_hypothesis *one,
                      const struct tracker_hypothesis *other)
{
    int shared = 0, k;

    for (k = 0; k < search->count; k++)
        if (one->guide[k] >= 0 && one->guide[k] == other->guide[k])
            shared++;
    return 2 * shared >= (one->matched < other->matched ? one->matched : other->matched);
}

/* Adds the hypothesis at best[kept], where it was verified. */
static void add_hypothesis(struct tracker_search *search)
{
    const struct tracker_hypothesis found = search->best[search->kept];
    int k;

    if (found.evidence <= LEAST_EVIDENCE || !allowed(search, &found.attitude))
        return;
    for (k = 0; k < search->kept; k++)
        if (same_stars(search, &search->best[k], &found))
            break;
    if (k == search->kept)
        search->kept++;
    else if (found.evidence <= search->best[k].evidence)
        return;
    for (; k > 0 && search->best[k - 1].evidence < found.evidence; k--)
        search->best[k] = search->best[k - 1];
    search->best[k] = found;
    if (search->kept > TRACKER_SEARCH_KEPT) {
        search->kept--;
        search->rest = tracker_log_sum_up(search->rest, search->best[search->kept].evidence);
    }
}

/* log2 of the chance that the best hypothesis is wrong, rounded up. */
static int64_t chance_of(const struct tracker_search *search)
{
    int64_t others = tracker_log_sum_up(-search->gain, search->rest);
    int k;

    if (search->kept == 0)
        return 0;
    for (k = 1; k < search->kept; k++)
        others = tracker_log_sum_up(others, search->best[k].evidence);
    return tracker_search_log_density[search->count] + others - search->best[0].evidence;
}

int tracker_is_beyond(const struct tracker_search *search, int64_t margin)
{
    return search->kept > 0 && chance_of(search) < TRACKER_SEARCH_LOG_RATE - margin;
}

void tracker_try_attitude(struct tracker_search *search, const struct tracker_matrix *start, int gates)
{
    tracker_verify(search, start, gates, &search->best[search->kept]);
    add_hypothesis(search);
}

int tracker_is_known(const struct tracker_search *search, const struct tracker_matrix *attitude, const int32_t *row)
{
    const int64_t square = tracker_gate_of(search->variance[0], row) >> 4;
    int k;

    for (k = 0; k < search->kept; k++)
        if (rotation2(attitude, &search->best[k].attitude) <= square)
            return 1;
    return 0;
}

/* ------------------------------------------------------------------ searches */

static enum tracker_reason judge(const struct tracker_search *search)
{
    const int64_t chance = chance_of(search), density = tracker_search_log_density[search->count];
    const struct tracker_hypothesis *best = &search->best[0];

    if (search->kept > 0 && best->matched >= TRACKER_SEARCH_LEAST_STARS && chance <= TRACKER_SEARCH_LOG_RATE)
        return TRACKER_ACCEPTED;
    if (search->cut_short)
        return TRACKER_STEPS_USED_UP;
    if (search->kept == 0)
        return TRACKER_NO_HYPOTHESIS;
    if (best->matched < TRACKER_SEARCH_LEAST_STARS || chance > density)
        return TRACKER_WEAK_EVIDENCE;
    return density - best->evidence - search->gain <= TRACKER_SEARCH_LOG_RATE && search->kept > 1 ? TRACKER_RIVAL
                                                                                               : TRACKER_ABOVE_RATE;
}

/* All searches under the prior; 1: the result is beyond doubt within it. */
static int run_searches(struct tracker_search *search, int count, struct tracker_found *found)
{
    int64_t radius = search->prior.radius;
    int number, k;

    search->kept = search->cut_short = 0;
    search->rest = TRACKER_SEARCH_NEVER;
    search->gain = 0;
    search->steps = 0;
    if (radius > 0) {
        search->gain = LOG_SIX_PI - 3 * (tracker_log_down(radius) + LOG_UP - (28 << LOG_BITS));
        search->gain = search->gain > 0 ? search->gain : 0;
        radius = tracker_smaller(radius, ONE_RADIAN) * 4;
        if (radius * radius <= PRIOR_SIGMAS2 * search->variance[0])
            tracker_try_attitude(search, &search->prior.attitude, 0);
    }
    for (number = 0; number < TRACKER_SEARCH_ROWS; number++) {
        const int32_t *row = tracker_search_row[number];
        if (tracker_is_beyond(search, TRACKER_SURE_BEYOND))
            break;
        if (number >= TRACKER_SEARCH_QUICK && tracker_is_beyond(search, RIVALS_BEYOND) && search->best[0].width <= AS_STATED)
            break;
        tracker_run_row(search, row);
        if (number >= TRACKER_SEARCH_QUICK && row[TRACKER_ROW_STATED] && tracker_is_beyond(search, 0))
            break;
    }
    found->reason = judge(search);
    found->chance = chance_of(search);
    found->steps += search->steps;
    found->contradicted = 0;
    if (search->kept == 0) {
        found->best.evidence = 0;
        found->best.matched = 0;
        return 0;
    }
    found->best = search->best[0];
    for (k = 0; k < count; k++)
        found->best.guide[k] = -1;
    for (k = 0; k < search->count; k++)
        found->best.guide[search->index[k]] = search->best[0].guide[k];
    return tracker_is_beyond(search, RIVALS_BEYOND);
}

/* Whether the rows of a matrix are unit vectors to 2^-10: of others products would overflow. */
static int has_unit_rows(const struct tracker_matrix *matrix)
{
    int64_t row[3];
    int k;

    for (k = 0; k < 3; k++) {
        tracker_to_array(&matrix->row[k], row);
        if (tracker_largest(row, 3) > ONE + UNIT_TOLERANCE || tracker_magnitude(tracker_dot(row, row) - ONE) > UNIT_TOLERANCE)
            return 0;
    }
    return 1;
}

static int shares_star(const struct tracker_hypothesis *one, const struct tracker_hypothesis *other, int count)
{
    int k;

    for (k = 0; k < count; k++)
        if (one->guide[k] >= 0 && one->guide[k] == other->guide[k])
            return 1;
    return 0;
}

void tracker_identify(struct tracker_search *search, const struct tracker_observer *observer,
                      const struct tracker_prior *prior, const struct tracker_star *star, const struct tracker_vector *direction,
                      const uint8_t *seen, int count, struct tracker_found *found)
{
    struct tracker_found elsewhere;
    int same;

    found->best.evidence = 0;
    found->best.matched = 0;
    found->chance = found->steps = 0;
    found->contradicted = 0;
    found->reason = count > 0 ? TRACKER_FEW_FOUND : TRACKER_NOTHING_FOUND;
    take_stars(search, star, direction, seen, count);
    if (search->count < TRACKER_SEARCH_LEAST_STARS)
        return;
    measure_sides(search);
    tracker_crowding(search);
    search->observer = *observer;
    search->prior = *prior;
    if (!has_unit_rows(&search->prior.attitude))
        search->prior.radius = 0;
    if (run_searches(search, count, found) || search->prior.radius == 0)
        return;
    search->prior.radius = 0;
    elsewhere.steps = found->steps;
    run_searches(search, count, &elsewhere);
    if (elsewhere.reason != TRACKER_ACCEPTED
        || (found->reason == TRACKER_ACCEPTED && elsewhere.chance >= found->chance)) {
        found->steps = elsewhere.steps;
        return;
    }
    same = found->reason == TRACKER_ACCEPTED && shares_star(&found->best, &elsewhere.best, count);
    *found = elsewhere;
    found->contradicted = !same;
}
