/* The default identification: candidates, confirmation, verification, acceptance; the same operations as
 * startracker/flight/search.py, which explains them. */
#include "tracker_search.h"

#include "tracker_integers.h"

#define ONE ((int64_t)1 << 30)
#define LOG_BITS 12
#define LOG_UP 24
#define STATED_VARIANCE 1475
#define FLOOR_VARIANCE 656
#define WORST_VARIANCE ((int64_t)25 << 16)
#define MAGNITUDE_FACTOR 24660
#define MAGNITUDE_SHIFT 21
#define MOST_OTHERS 48
#define LEAST_EVIDENCE (-29545)
#define SURE_BEYOND 88640
#define RIVALS_BEYOND 29547
#define AS_STATED 3
#define QUICK 2
#define LOG_SIX_PI 17352
#define MOST_RATIO ((int64_t)1 << 16)
#define LARGEST_VARIANCE ((int64_t)1 << 42)
#define ONE_RADIAN ((int64_t)1 << 28)
#define CANDIDATE_STEPS 30
#define STAR_STEPS 60
#define PRIOR_SIGMAS2 3969

static void to_array(const struct tracker_vector *v, int64_t out[3])
{
    out[0] = v->x;
    out[1] = v->y;
    out[2] = v->z;
}

static void to_vector(const int64_t v[3], struct tracker_vector *out)
{
    out->x = (int32_t)v[0];
    out->y = (int32_t)v[1];
    out->z = (int32_t)v[2];
}

static int64_t smaller(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

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
        search->variance[k] = (stated * TRACKER_SEARCH_PIXEL2) >> 16;
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

    for (i = 0; i < search->count; i++)
        for (j = 0; j < i; j++) {
            int64_t p[3], q[3], square = 0;
            to_array(&search->direction[i], p);
            to_array(&search->direction[j], q);
            for (axis = 0; axis < 3; axis++)
                square += (p[axis] - q[axis]) * (p[axis] - q[axis]);
            side = tracker_side_of(i, j);
            search->chord[side] = (uint32_t)tracker_square_root(square);
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
        to_array(&one->row[row], p);
        to_array(&other->row[row], q);
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

static int beyond(const struct tracker_search *search, int64_t margin)
{
    return search->kept > 0 && chance_of(search) < TRACKER_SEARCH_LOG_RATE - margin;
}

static void verify(struct tracker_search *search, const struct tracker_matrix *start, int gates)
{
    tracker_verify(search, start, gates, &search->best[search->kept]);
    add_hypothesis(search);
}

/* ------------------------------------------------------------------ candidates */

/* Axes of a pair of directions: the midpoint, the difference, and the normal to both. */
static int pair_frame(const int64_t p[3], const int64_t q[3], int64_t frame[3][3])
{
    int64_t largest;
    int k;

    for (k = 0; k < 3; k++) {
        frame[0][k] = p[k] + q[k];
        frame[1][k] = q[k] - p[k];
    }
    largest = tracker_largest(frame[1], 3);
    if (largest == 0 || !tracker_unit(frame[0], 1 << 20))
        return 0;
    for (; largest < (int64_t)1 << 29; largest *= 2)
        for (k = 0; k < 3; k++)
            frame[1][k] *= 2;
    if (!tracker_unit(frame[1], 1))
        return 0;
    tracker_cross(frame[0], frame[1], frame[2]);
    return 1;
}

static void attitude_of(const int64_t seen[3][3], const int64_t known[3][3], struct tracker_matrix *attitude)
{
    int64_t row[3];
    int i, j, k;

    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            row[j] = 0;
            for (k = 0; k < 3; k++)
                row[j] += seen[k][i] * known[k][j];
            row[j] = tracker_shift_right(row[j], 30);
        }
        to_vector(row, &attitude->row[i]);
    }
}

static int64_t gate_of(int64_t variance, const int32_t *row)
{
    return (smaller(variance, LARGEST_VARIANCE) >> 8) * row[TRACKER_ROW_GATE2];
}

/* Whether a guide star can be where a star is, according to the prior. */
static int fits_prior(const struct tracker_search *search, int star, int guide, const int32_t *row)
{
    const int64_t radius = search->prior.radius;
    int64_t axis[3], direction[3], seen[3], square = 0;
    int k;

    if (radius == 0 || radius >= ONE_RADIAN)
        return 1;
    for (k = 0; k < 3; k++)
        direction[k] = tracker_guide_direction[guide][k];
    to_array(&search->direction[star], seen);
    for (k = 0; k < 3; k++) {
        int64_t apart;
        to_array(&search->prior.attitude.row[k], axis);
        apart = tracker_dot(axis, direction) - seen[k];
        square += apart * apart;
    }
    return square <= 2 * (radius * 4) * (radius * 4) + 4 * gate_of(search->variance[star], row);
}

static int column_of(int64_t coordinate)
{
    const int64_t cell = tracker_shift_right(coordinate + ONE, TRACKER_SEARCH_COLUMN_SHIFT);

    return cell < 0 ? 0 : cell >= TRACKER_SEARCH_COLUMNS ? TRACKER_SEARCH_COLUMNS - 1 : (int)cell;
}

/* Whether a guide star is near a direction in the sky. */
static int guide_near(const int64_t sky[3], int64_t gate2)
{
    const int64_t reach = tracker_square_root(gate2) + 1;
    int x, y, entry;

    for (x = column_of(sky[0] - reach); x <= column_of(sky[0] + reach); x++)
        for (y = column_of(sky[1] - reach); y <= column_of(sky[1] + reach); y++) {
            const int column = x * TRACKER_SEARCH_COLUMNS + y;
            for (entry = tracker_search_column_start[column]; entry < tracker_search_column_start[column + 1]; entry++) {
                const int32_t *guide = tracker_guide_direction[tracker_search_column_star[entry]];
                const int64_t dx = sky[0] - guide[0], dy = sky[1] - guide[1], dz = sky[2] - guide[2];
                if (tracker_magnitude(dz) <= reach && dx * dx + dy * dy + dz * dz <= gate2)
                    return 1;
            }
        }
    return 0;
}

/* Fewest matches that occur by chance as rarely as a row of the table requires. */
static int64_t least_matches(int64_t mean, int chance)
{
    int k;

    for (k = 0; k < TRACKER_SEARCH_MOST_NEEDED; k++)
        if (mean <= tracker_search_needed[chance][k])
            break;
    return k + 1;
}

/* Matches required of `count` other stars. */
static int64_t needed_matches(int64_t gates, int count, const int32_t *row)
{
    const int64_t mean = (gates * TRACKER_SEARCH_GUIDES) >> 22;
    int64_t need = least_matches(mean, row[TRACKER_ROW_CHANCE]), rare;

    if (row[TRACKER_ROW_ENOUGH] > 0) {
        rare = smaller(least_matches(mean, TRACKER_SEARCH_CHANCES - 1), row[TRACKER_ROW_ENOUGH]);
        need = rare > need ? rare : need;
    }
    return smaller(need, count);
}

/* Square of the gate of one of the other stars, 2^-60 rad^2. */
static int64_t gate_beside(const struct tracker_search *search, int star, int64_t shared, int64_t apart2,
                           const int64_t frame[3][3], const int32_t *row)
{
    int64_t direction[3], y, z, ratio;

    to_array(&search->direction[star], direction);
    y = tracker_dot(frame[1], direction);
    z = tracker_dot(frame[2], direction);
    ratio = smaller(((y * y + z * z) >> 12) / apart2, MOST_RATIO);
    return gate_of(search->variance[star] + (shared >> 2) + ((shared * ratio) >> 8), row);
}

static int is_among(int star, const int used[3])
{
    return star == used[0] || star == used[1] || star == used[2];
}

/* Whether enough of the other stars are near guide stars. */
static int is_confirmed(struct tracker_search *search, const struct tracker_matrix *attitude, const int used[3],
                        const int64_t frame[3][3], const int32_t *row)
{
    const int64_t shared = search->variance[used[0]] + search->variance[used[1]];
    const int64_t chord = search->chord[tracker_side_of(used[0], used[1])];
    const int64_t apart2 = chord * chord >> 20 > 1 ? chord * chord >> 20 : 1;
    int64_t gate2[MOST_OTHERS], gates = 0, need, axes[3][3], direction[3], sky[3];
    int count = 0, found = 0, star, at, k;

    for (star = 0; star < search->count && count < MOST_OTHERS; star++)
        if (!is_among(star, used)) {
            gate2[count] = gate_beside(search, star, shared, apart2, frame, row);
            gates += gate2[count++] >> 24;
        }
    search->steps += CANDIDATE_STEPS + STAR_STEPS * (int64_t)count;
    need = needed_matches(gates, count, row);
    for (k = 0; k < 3; k++)
        to_array(&attitude->row[k], axes[k]);
    for (star = at = 0; star < search->count && at < count && found < need; star++) {
        if (is_among(star, used))
            continue;
        to_array(&search->direction[star], direction);
        for (k = 0; k < 3; k++)
            sky[k] = tracker_shift_right(
                direction[0] * axes[0][k] + direction[1] * axes[1][k] + direction[2] * axes[2][k], 30);
        found += guide_near(sky, gate2[at++]);
    }
    return found >= need;
}

static void try_candidate(struct tracker_search *search, int pole, const struct tracker_candidate *candidate,
                          const int32_t *row)
{
    const int used[3] = {pole, candidate->neighbour, candidate->third};
    int64_t seen[3][3], known[3][3], p[3], q[3], u[3], w[3], square;
    struct tracker_matrix attitude;
    int k;

    if (!fits_prior(search, pole, candidate->guide[0], row)
        || !fits_prior(search, candidate->neighbour, candidate->guide[1], row))
        return;
    to_array(&search->direction[pole], p);
    to_array(&search->direction[candidate->neighbour], q);
    for (k = 0; k < 3; k++) {
        u[k] = tracker_guide_direction[candidate->guide[0]][k];
        w[k] = tracker_guide_direction[candidate->guide[1]][k];
    }
    if (!pair_frame(p, q, seen) || !pair_frame(u, w, known))
        return;
    attitude_of((const int64_t(*)[3])seen, (const int64_t(*)[3])known, &attitude);
    square = gate_of(search->variance[0], row) >> 4;
    for (k = 0; k < search->kept; k++)
        if (rotation2(&attitude, &search->best[k].attitude) <= square)
            return;
    if (is_confirmed(search, &attitude, used, (const int64_t(*)[3])seen, row))
        verify(search, &attitude, row[TRACKER_ROW_GATES]);
}

/* ------------------------------------------------------------------ searches */

static void run_row(struct tracker_search *search, const int32_t *row)
{
    const int64_t most = search->steps + row[TRACKER_ROW_STEPS];
    int pole, k;

    for (pole = 0; pole < row[TRACKER_ROW_POLES] && pole < search->count; pole++) {
        if (beyond(search, SURE_BEYOND))
            return;
        if (search->steps > most) {
            if (row[TRACKER_ROW_STATED])
                search->cut_short = 1;
            return;
        }
        tracker_vote_about(search, pole, row, most);
        for (k = 0; k < search->work.votes.candidates; k++) {
            if (search->steps > most || beyond(search, SURE_BEYOND))
                break;
            try_candidate(search, pole, &search->work.votes.candidate[k], row);
        }
    }
}

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
        radius = smaller(radius, ONE_RADIAN) * 4;
        if (radius * radius <= PRIOR_SIGMAS2 * search->variance[0])
            verify(search, &search->prior.attitude, 0);
    }
    for (number = 0; number < TRACKER_SEARCH_ROWS; number++) {
        const int32_t *row = tracker_search_row[number];
        if (beyond(search, SURE_BEYOND))
            break;
        if (number >= QUICK && beyond(search, RIVALS_BEYOND) && search->best[0].width <= AS_STATED)
            break;
        run_row(search, row);
        if (number >= QUICK && row[TRACKER_ROW_STATED] && beyond(search, 0))
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
    return beyond(search, RIVALS_BEYOND);
}

static int shares_star(const struct tracker_hypothesis *one, const struct tracker_hypothesis *other, int count)
{
    int k;

    for (k = 0; k < count; k++)
        if (one->guide[k] >= 0 && one->guide[k] == other->guide[k])
            return 1;
    return 0;
}

void tracker_identify(struct tracker_search *search, const struct tracker_frame_info *info, const struct tracker_star *star,
                      const struct tracker_vector *direction, const uint8_t *seen, int count, struct tracker_found *found)
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
    search->velocity = info->velocity;
    search->prior = info->prior;
    if (run_searches(search, count, found) || info->prior.radius == 0)
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
