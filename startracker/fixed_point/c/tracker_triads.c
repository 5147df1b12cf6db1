/* Identification by triads: the same loops and rules as startracker/identification/triad_search.py and
 * triad_votes.py. */
#include "tracker_internal.h"

#define NONE UINT16_MAX
#define COMBINED 10000

/* First pair whose separation is not below the bound. */
static int32_t first_pair(int32_t bound)
{
    int32_t low = 0, high = TRACKER_PAIRS, middle;

    while (low < high) {
        middle = low + (high - low) / 2;
        if (tracker_pair_separation[middle] < bound)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static void window(const struct tracker_context *context, int i, int j, int32_t *low, int32_t *high)
{
    *low = first_pair(context->separation[i][j] - TRACKER_SEPARATION_TOLERANCE);
    *high = first_pair(context->separation[i][j] + TRACKER_SEPARATION_TOLERANCE + 1);
}

static void chain(const struct tracker_context *context, struct tracker_side *side, int i, int j)
{
    int32_t pair, entry;
    int way;

    window(context, i, j, &side->low, &side->high);
    for (entry = 0; entry < TRACKER_CATALOG_STARS; entry++)
        side->head[entry] = NONE;
    for (pair = side->low; pair < side->high; pair++)
        for (way = 0; way < 2; way++) {
            const uint16_t start = way ? tracker_pair_second[pair] : tracker_pair_first[pair];
            entry = 2 * (pair - side->low) + way;
            side->end[entry] = way ? tracker_pair_first[pair] : tracker_pair_second[pair];
            side->next[entry] = side->head[start];
            side->head[start] = (uint16_t)entry;
        }
}

static int holds(const struct tracker_side *side, int start, int end)
{
    uint16_t entry;

    for (entry = side->head[start]; entry != NONE; entry = side->next[entry])
        if (side->end[entry] == end)
            return 1;
    return 0;
}

static int32_t catalog_direction(int a, int b)
{
    const int32_t half = (int32_t)180 << 22, whole = (int32_t)360 << 22;
    int64_t east = (int64_t)tracker_star_ra[b] - tracker_star_ra[a] + half;

    if (east < 0)
        east += whole;
    if (east >= whole)
        east -= whole;
    return tracker_direction((int64_t)tracker_star_dec[b] - tracker_star_dec[a], half - east);
}

/* Whether the angle between two directions of the image is one of the catalogue. */
static int enclosed(int32_t first, int32_t second, int32_t known)
{
    const int32_t angle = (int32_t)tracker_magnitude(tracker_turn_between(first, second));

    return tracker_magnitude(tracker_turn_between(angle, known)) <= TRACKER_ENCLOSED_TOLERANCE;
}

static int enclosed_agree(const struct tracker_context *context, int p, int q, int r, int a, int b, int c)
{
    const int32_t pq = context->image_direction[p][q], pr = context->image_direction[p][r], qr = context->image_direction[q][r];

    if (TRACKER_ENCLOSED_TOLERANCE < 0)
        return 1;
    return enclosed(pq, pr, tracker_catalog_angle(a, b, c)) && enclosed(pq + TRACKER_FULL_TURN / 2, qr, tracker_catalog_angle(b, a, c))
           && enclosed(pr, qr, tracker_catalog_angle(c, a, b));
}

static int after(const struct tracker_triad *triad, int a, int b, int c)
{
    if (triad->catalog[0] != a)
        return triad->catalog[0] > a;
    return triad->catalog[1] != b ? triad->catalog[1] > b : triad->catalog[2] > c;
}

/* Stores a triad that passes; the triads of one triangle, from `first`, are sorted by the indices of their stars.
 * Returns 1, or 0 if there is no room. */
static int test_triad(struct tracker_context *context, int first, int p, int q, int r, int a, int b, int c)
{
    const int32_t one = tracker_modulo_turn(catalog_direction(a, b) - context->image_direction[p][q]);
    const int32_t two = tracker_modulo_turn(catalog_direction(a, c) - context->image_direction[p][r]);
    struct tracker_triad *triad;

    if (tracker_magnitude(tracker_turn_between(one, two)) > TRACKER_ROTATION_TOLERANCE || !enclosed_agree(context, p, q, r, a, b, c))
        return 1;
    if (context->triad_count == TRACKER_MAX_TRIADS)
        return 0;
    for (triad = &context->triads[context->triad_count]; triad > &context->triads[first] && after(triad - 1, a, b, c); triad--)
        *triad = *(triad - 1);
    triad->star[0] = (uint8_t)p;
    triad->star[1] = (uint8_t)q;
    triad->star[2] = (uint8_t)r;
    triad->catalog[0] = (uint16_t)a;
    triad->catalog[1] = (uint16_t)b;
    triad->catalog[2] = (uint16_t)c;
    triad->mean = (int16_t)tracker_modulo_turn(one + (int32_t)tracker_shift_right(tracker_turn_between(two, one), 1));
    context->triad_count++;
    return 1;
}

static int find_triads(struct tracker_context *context, int stars)
{
    int32_t low, high, pair;
    int p, q, r, way, first;
    uint16_t entry;

    context->triad_count = 0;
    for (p = 0; p < stars; p++)
        for (q = p + 1; q < stars; q++) {
            window(context, p, q, &low, &high);
            for (r = q + 1; r < stars; r++) {
                chain(context, &context->second_side, p, r);
                chain(context, &context->third_side, q, r);
                first = context->triad_count;
                for (pair = low; pair < high; pair++)
                    for (way = 0; way < 2; way++) {
                        const int a = way ? tracker_pair_second[pair] : tracker_pair_first[pair];
                        const int b = way ? tracker_pair_first[pair] : tracker_pair_second[pair];
                        for (entry = context->second_side.head[a]; entry != NONE; entry = context->second_side.next[entry])
                            if (holds(&context->third_side, b, context->second_side.end[entry])
                                && !test_triad(context, first, p, q, r, a, b, context->second_side.end[entry]))
                                return 0;
                    }
            }
        }
    return 1;
}

static void group_triads(struct tracker_context *context)
{
    int64_t off, step;
    int t, g;

    context->group_count = 0;
    for (t = 0; t < context->triad_count; t++) {
        step = 0;
        for (g = 0; g < context->group_count; g++) {
            const struct tracker_group *known = &context->groups[g];
            step = context->triads[t].mean - known->origin;
            off = step * known->count - known->total;
            if (2 * off >= (int64_t)TRACKER_FULL_TURN * known->count)
                step -= TRACKER_FULL_TURN;
            else if (2 * off < -(int64_t)TRACKER_FULL_TURN * known->count)
                step += TRACKER_FULL_TURN;
            off = step * known->count - known->total;
            if ((off < 0 ? -off : off) <= (int64_t)TRACKER_GROUPING_TOLERANCE * known->count)
                break;
        }
        if (g == context->group_count) {
            context->groups[g].origin = context->triads[t].mean;
            context->groups[g].total = context->groups[g].count = context->groups[g].used = 0;
            context->group_count++;
            step = 0;
        }
        context->triads[t].group = (uint16_t)g;
        context->groups[g].total += (int32_t)step;
        context->groups[g].count++;
    }
}

/* Catalogue stars that the triads of a group name for an image star, brightest first. */
static int named(struct tracker_context *context, int g, int star)
{
    int found = 0, t, k, n;

    for (t = 0; t < context->triad_count; t++)
        for (k = 0; k < 3; k++)
            if (context->triads[t].group == g && context->triads[t].star[k] == star) {
                const uint16_t catalog = context->triads[t].catalog[k];
                for (n = 0; n < found && context->named[n] != catalog; n++)
                    ;
                if (n == found) {
                    context->named[found++] = catalog;
                    context->frequency[n] = 0;
                }
                context->frequency[n]++;
            }
    for (t = 1; t < found; t++) {
        const uint16_t p = context->named[t], f = context->frequency[t];
        for (n = t; n > 0 && tracker_star_rank[context->named[n - 1]] > tracker_star_rank[p]; n--) {
            context->named[n] = context->named[n - 1];
            context->frequency[n] = context->frequency[n - 1];
        }
        context->named[n] = p;
        context->frequency[n] = f;
    }
    return found;
}

/* Labels the groups of stars that are not resolved in the image. */
static void combine(struct tracker_context *context, int found)
{
    int i, j, n;

    for (n = 0; n < found; n++)
        context->label[n] = (uint16_t)n;
    for (i = 0; i < found; i++)
        for (j = i + 1; j < found; j++)
            if (tracker_catalog_separation(context->named[i], context->named[j]) <= TRACKER_COMBINE_SEPARATION) {
                const uint16_t low = context->label[i] < context->label[j] ? context->label[i] : context->label[j];
                const uint16_t high = context->label[i] < context->label[j] ? context->label[j] : context->label[i];
                for (n = 0; n < found; n++)
                    if (context->label[n] == high)
                        context->label[n] = low;
            }
}

/* Members of the star, or unresolved group of stars, with the most votes. */
static void vote(struct tracker_context *context, int g, int star, int needed)
{
    const int found = named(context, g, star);
    int most = 0, tied = 0, winner = -1, whole = 0, n, k;

    combine(context, found);
    context->members[star] = 0;
    for (n = 0; n < found; n++) {
        int sum = 0, size = 0;
        for (k = 0; k < found; k++)
            if (context->label[k] == n) {
                sum += context->frequency[k];
                size++;
            }
        for (k = 0; k < 2; k++) { /* the single star; then, for the first of a group, all of the group */
            const int votes = k ? sum : context->frequency[n];
            if (k && size < 2)
                continue;
            if (votes > most) {
                most = votes;
                tied = 0;
                winner = n;
                whole = k;
            } else if (votes == most)
                tied = 1;
        }
    }
    if (winner < 0 || tied || most < needed)
        return;
    for (n = 0; n < found; n++)
        if (whole ? context->label[n] == winner : n == winner)
            context->member[star][context->members[star]++] = context->named[n];
}

static int agree(const struct tracker_context *context, int i, int j)
{
    int m, n;

    for (m = 0; m < context->members[i]; m++)
        for (n = 0; n < context->members[j]; n++)
            if (tracker_magnitude(tracker_catalog_separation(context->member[i][m], context->member[j][n]) - context->separation[i][j]) <= TRACKER_SEPARATION_TOLERANCE)
                return 1;
    return 0;
}

/* Drops the match with the most disagreeing separations (the last of equal ones) until all separations agree. */
static void check(struct tracker_context *context, int stars)
{
    int i, j, worst, most, count;

    for (i = 0; i < stars; i++)
        for (j = i; j < stars; j++)
            context->wrong[i][j] = context->wrong[j][i] = (uint8_t)(i != j && context->members[i] > 0 && context->members[j] > 0 && !agree(context, i, j));
    for (;;) {
        worst = most = 0;
        for (i = 0; i < stars; i++) {
            count = 0;
            for (j = 0; j < stars; j++)
                count += context->wrong[i][j];
            if (count >= most) {
                most = count;
                worst = i;
            }
        }
        if (most == 0)
            return;
        context->members[worst] = 0;
        for (j = 0; j < stars; j++)
            context->wrong[worst][j] = context->wrong[j][worst] = 0;
    }
}

static int next_group(struct tracker_context *context)
{
    int largest = -1, g;

    for (g = 0; g < context->group_count; g++)
        if (!context->groups[g].used && (largest < 0 || context->groups[g].count > context->groups[largest].count))
            largest = g;
    if (largest >= 0)
        context->groups[largest].used = 1;
    return largest;
}

static int measure(struct tracker_context *context, const int32_t xy[][2], int stars)
{
    const int64_t scale[2] = {TRACKER_SCALE_X, TRACKER_SCALE_Y};
    int i, j, k;

    for (i = 0; i < stars; i++)
        for (j = i + 1; j < stars; j++) {
            int64_t step[2], along[2];
            int apart;
            for (k = 0; k < 2; k++) {
                step[k] = (int64_t)xy[j][k] - xy[i][k];
                along[k] = ((step[k] < 0 ? -step[k] : step[k]) * scale[k]) >> 32;
            }
            apart = tracker_image_separation(along[0], along[1]);
            if (apart < 0)
                return 0;
            context->separation[i][j] = (int16_t)apart;
            context->image_direction[i][j] = (int16_t)tracker_direction(step[1], step[0]);
        }
    return 1;
}

/* The best verified attitude so far and its strongest rival. */
struct bench {
    int found, has_rival;
    int64_t evidence, rival;
    int64_t matrix[3][3];
};

static void reached(struct tracker_answer *answer, enum tracker_reason reason)
{
    if (reason > answer->reason)
        answer->reason = reason;
}

/* Catalogue numbers of the points: from the votes if they agree with the verification. */
static void name_points(const struct tracker_context *context, int stars, struct tracker_answer *answer)
{
    int i, m;

    for (i = 0; i < answer->points; i++) {
        const int32_t guide = context->guide[i];
        answer->number[i] = guide >= 0 ? tracker_guide_number[guide] : 0;
        if (i >= stars || guide < 0)
            continue;
        for (m = 0; m < context->members[i]; m++)
            if (tracker_guide_of_star[context->member[i][m]] == guide) {
                answer->number[i] =
                    tracker_star_number[context->member[i][0]] + (context->members[i] > 1 ? COMBINED : 0);
                break;
            }
    }
}

/* Computes an attitude from the stars that a group names, and verifies it. */
static void try_group(struct tracker_context *context, const int32_t xy[][2], int stars, int g, struct bench *bench,
                      struct tracker_answer *answer)
{
    int64_t start[3][3];
    int star, matched = 0, state, same, better, k;

    for (star = 0; star < stars; star++)
        if (context->members[star] > 0) {
            context->seen[matched][0] = xy[star][0];
            context->seen[matched][1] = xy[star][1];
            context->catalog[matched++] = context->member[star][0];
        }
    if (matched < 3)
        return;
    if (!tracker_plate_attitude(context, matched, start)) {
        reached(answer, TRACKER_NO_ATTITUDE);
        return;
    }
    state = tracker_verify(context, answer->points, start);
    if (state != TRACKER_STATE_FIT) {
        reached(answer, state == TRACKER_STATE_FEW_FIT ? TRACKER_FEW_FIT : TRACKER_NOT_SPREAD);
        return;
    }
    reached(answer, TRACKER_WEAK_EVIDENCE);
    same = bench->found;
    for (k = 0; k < 3; k++)
        if (tracker_magnitude(context->fitted[0][k] - bench->matrix[0][k]) > TRACKER_SAME_ROLL
            || tracker_magnitude(context->fitted[2][k] - bench->matrix[2][k]) > TRACKER_SAME)
            same = 0;
    better = !bench->found || context->evidence > bench->evidence;
    if (bench->found && !same) {
        const int64_t weaker = better ? bench->evidence : context->evidence;
        if (!bench->has_rival || weaker > bench->rival)
            bench->rival = weaker;
        bench->has_rival = 1;
    }
    if (!better)
        return;
    bench->found = 1;
    bench->evidence = context->evidence;
    for (k = 0; k < 9; k++)
        bench->matrix[k / 3][k % 3] = context->fitted[k / 3][k % 3];
    answer->matched = context->matched;
    answer->triads = context->groups[g].count;
    name_points(context, stars, answer);
}

static void clear(struct tracker_answer *answer)
{
    int k;

    answer->triads = 0;
    for (k = 0; k < TRACKER_MAX_POINTS; k++)
        answer->number[k] = 0;
    for (k = 0; k < 9; k++)
        answer->attitude.matrix[k / 3][k % 3] = 0;
    answer->attitude.ra = answer->attitude.dec = answer->attitude.roll = 0;
}

static void refuse(struct tracker_answer *answer, enum tracker_status status, enum tracker_reason reason)
{
    answer->status = status;
    answer->reason = reason;
}

void tracker_solve(struct tracker_context *context, const int32_t xy[][2], int count, struct tracker_answer *answer)
{
    const int stars = count < TRACKER_MAX_STARS ? count : TRACKER_MAX_STARS;
    struct bench bench = {0, 0, 0, 0, {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}};
    int g, n, star, needed;

    clear(answer);
    answer->points = count < 0 ? 0 : count < TRACKER_MAX_POINTS ? count : TRACKER_MAX_POINTS;
    answer->matched = 0;
    answer->evidence = 0;
    if (count < 3) {
        refuse(answer, TRACKER_TOO_FEW_STARS, TRACKER_FEWER_THAN_THREE);
        return;
    }
    if (!tracker_place_points(context, xy, answer->points)) {
        refuse(answer, TRACKER_OUTSIDE_IMAGE, TRACKER_POINT_OUTSIDE);
        return;
    }
    if (!measure(context, xy, stars)) {
        refuse(answer, TRACKER_OVERFLOW, TRACKER_SEPARATION_OVERFLOW);
        return;
    }
    if (!find_triads(context, stars)) {
        refuse(answer, TRACKER_SEARCH_LIMIT, TRACKER_TOO_MANY_TRIADS);
        return;
    }
    refuse(answer, TRACKER_NO_MATCH, context->triad_count ? TRACKER_NO_GROUP : TRACKER_NO_TRIADS);
    group_triads(context);
    tracker_local_areas(context, answer->points);
    needed = TRACKER_THREE_STARS && stars == 3 && context->group_count == 1 ? 1 : TRACKER_VOTE_NUMBER;
    for (n = 0; n < TRACKER_MAX_GROUPS && (g = next_group(context)) >= 0; n++) {
        for (star = 0; star < stars; star++)
            vote(context, g, star, needed);
        check(context, stars);
        try_group(context, xy, stars, g, &bench, answer);
    }
    answer->evidence = (int32_t)bench.evidence;
    if (!bench.found || bench.evidence < TRACKER_THRESHOLD)
        clear(answer);
    else if (bench.has_rival && bench.evidence - bench.rival < TRACKER_THRESHOLD) {
        clear(answer);
        refuse(answer, TRACKER_AMBIGUOUS, TRACKER_RIVAL);
    } else {
        refuse(answer, TRACKER_SOLVED, TRACKER_ACCEPTED);
        tracker_angles((const int64_t(*)[3])bench.matrix, &answer->attitude);
    }
}
