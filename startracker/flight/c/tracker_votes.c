/* Votes of the neighbours of one star, the pole (Padgett & Kreutz-Delgado 1997).
 *
 * Every guide pair as long as the separation of the pole from a neighbour is a vote for both of its stars. A first pass
 * counts the neighbours that vote for each guide star; a second one keeps the votes for those with enough of them. Two votes
 * for a guide star agree if the third side of their triangle is as long as observed, and the triangle has the same sense.
 * With two votes that agree this is the triangle of Mortari et al. 2004; more of them are its confirmation.
 *
 * Memory is bounded: a byte a guide star, and TRACKER_SEARCH_MOST_VOTES votes: if there are more, further passes keep those
 * for the other guide stars, and if there are too many for these, more votes are required. */
#include "tracker_integers.h"
#include "tracker_search.h"

#define ABERRATION 107 /* relative error of a separation, as the pairs are without aberration, 20 fraction bits */
#define LEAST_ERRORS 3
#define AREA_SHIFT 30

int tracker_side_of(int i, int j)
{
    return i > j ? i * (i - 1) / 2 + j : j * (j - 1) / 2 + i;
}

int64_t tracker_tolerance(const struct tracker_search *search, int side, int32_t sides)
{
    return (((int64_t)search->error[side] * sides) >> 8) + (((int64_t)search->chord[side] * ABERRATION) >> 20);
}

static int64_t bin_of(int64_t chord)
{
    const int64_t bin = chord >> TRACKER_SEARCH_BIN_SHIFT;

    return bin < TRACKER_SEARCH_BINS - 1 ? bin : TRACKER_SEARCH_BINS - 1;
}

/* The nearest stars to the pole of those that vote, from number `first` on, with their windows of guide pairs. */
static void find_neighbours(const struct tracker_search *search, struct tracker_votes *votes, int pole, int first,
                            const int32_t *row)
{
    int star, at;

    votes->neighbours = 0;
    for (star = first; star < row[TRACKER_ROW_AMONG] && star < search->count; star++) {
        int64_t chord, allowed;
        if (star == pole)
            continue;
        chord = search->chord[tracker_side_of(star, pole)];
        allowed = tracker_tolerance(search, tracker_side_of(star, pole), row[TRACKER_ROW_SIDES]);
        if (chord < LEAST_ERRORS * allowed || chord - allowed > TRACKER_SEARCH_LONGEST)
            continue;
        at = votes->neighbours;
        if (at == row[TRACKER_ROW_NEIGHBOURS]) {
            if (search->chord[tracker_side_of(votes->star[at - 1], pole)] <= chord)
                continue;
            at--;
        } else
            votes->neighbours++;
        for (; at > 0 && search->chord[tracker_side_of(votes->star[at - 1], pole)] > chord; at--) {
            votes->star[at] = votes->star[at - 1];
            votes->low[at] = votes->low[at - 1];
            votes->high[at] = votes->high[at - 1];
        }
        votes->star[at] = (uint8_t)star;
        votes->low[at] = tracker_search_bin_start[bin_of(chord - allowed)];
        votes->high[at] = tracker_search_bin_start[bin_of(chord + allowed) + 1];
    }
}

/* Possible differences of magnitude of the pole's guide star and a neighbour's. */
struct range {
    int32_t low, high;
};

static struct range possible_range(const struct tracker_search *search, int pole, int neighbour)
{
    const int32_t fainter = search->magnitude[pole] - search->magnitude[neighbour];
    struct range range = {INT32_MIN, INT32_MAX};

    if (search->brightness) {
        range.low = fainter - TRACKER_SEARCH_MAGNITUDE_TOLERANCE;
        range.high = fainter + TRACKER_SEARCH_MAGNITUDE_TOLERANCE;
    }
    return range;
}

static int fits(const struct range *range, int32_t fainter)
{
    return fainter >= range->low && fainter <= range->high;
}

/* Counts the votes for each guide star; the number of pairs looked at. */
static int64_t count_votes(const struct tracker_search *search, struct tracker_votes *votes, int pole)
{
    uint8_t *count = votes->count;
    int64_t looked = 0;
    uint32_t pair;
    int k, star;

    for (star = 0; star < TRACKER_SEARCH_GUIDES; star++)
        count[star] = 0;
    for (k = 0; k < votes->neighbours; k++) {
        const struct range range = possible_range(search, pole, votes->star[k]);
        for (pair = votes->low[k]; pair < votes->high[k]; pair++) {
            const int a = tracker_search_first[pair], b = tracker_search_second[pair];
            const int32_t fainter = (int32_t)tracker_guide_magnitude[a] - tracker_guide_magnitude[b];
            if (fits(&range, fainter) && count[a] < TRACKER_SEARCH_MOST_COUNT)
                count[a]++;
            if (fits(&range, -fainter) && count[b] < TRACKER_SEARCH_MOST_COUNT)
                count[b]++;
        }
        looked += votes->high[k] - votes->low[k];
    }
    return looked;
}

/* Fewest votes, at least `need`, of a guide star whose votes are kept. */
static int enough_votes(const struct tracker_votes *votes, int need)
{
    int64_t number[TRACKER_SEARCH_MOST_COUNT + 1], total = 0;
    int star, least;

    for (least = 0; least <= TRACKER_SEARCH_MOST_COUNT; least++)
        number[least] = 0;
    for (star = 0; star < TRACKER_SEARCH_GUIDES; star++)
        number[votes->count[star]]++;
    for (least = TRACKER_SEARCH_MOST_COUNT; least >= need; least--) {
        total += least * number[least];
        if (total > TRACKER_SEARCH_MOST_KEPT)
            break;
    }
    return least + 1;
}

/* Lists guide stars from `from` on whose votes there is room for; the first that is left. */
static int elect(struct tracker_votes *votes, int from, int need, int *elected)
{
    int kept = 0, star;

    *elected = 0;
    for (star = from; star < TRACKER_SEARCH_GUIDES; star++) {
        if (votes->count[star] < need)
            continue;
        if (kept + votes->count[star] > TRACKER_SEARCH_MOST_VOTES)
            break;
        votes->elected[*elected] = (uint16_t)star;
        votes->begin[*elected] = (uint16_t)kept;
        votes->filled[*elected] = 0;
        kept += votes->count[star];
        (*elected)++;
    }
    votes->begin[*elected] = (uint16_t)kept;
    return star;
}

static void keep_vote(struct tracker_votes *votes, int elected, int pole_guide, int guide, int neighbour)
{
    int low = 0, high = elected - 1, at;

    while (low < high) {
        const int middle = (low + high) / 2;
        if (votes->elected[middle] < pole_guide)
            low = middle + 1;
        else
            high = middle;
    }
    at = votes->begin[low] + votes->filled[low];
    if (at >= votes->begin[low + 1])
        return; /* more than are counted for a guide star */
    votes->vote[at].guide = (uint16_t)guide;
    votes->vote[at].neighbour = (uint8_t)neighbour;
    votes->filled[low]++;
}

/* Keeps the votes for the elected guide stars. */
static void collect(const struct tracker_search *search, struct tracker_votes *votes, int pole, int need, int elected)
{
    const int first = votes->elected[0], last = votes->elected[elected - 1];
    uint32_t pair;
    int k;

    for (k = 0; k < votes->neighbours; k++) {
        const struct range range = possible_range(search, pole, votes->star[k]);
        for (pair = votes->low[k]; pair < votes->high[k]; pair++) {
            const int a = tracker_search_first[pair], b = tracker_search_second[pair];
            const int32_t fainter = (int32_t)tracker_guide_magnitude[a] - tracker_guide_magnitude[b];
            if (a >= first && a <= last && votes->count[a] >= need && fits(&range, fainter))
                keep_vote(votes, elected, a, b, k);
            if (b >= first && b <= last && votes->count[b] >= need && fits(&range, -fainter))
                keep_vote(votes, elected, b, a, k);
        }
    }
}

/* Twice the area of a spherical triangle, positive if counted about the outward normal, 2^-30. */
static int64_t area(const int64_t p[3], const int64_t q[3], const int64_t r[3])
{
    int64_t u[3], v[3], sum = 0;
    int k;

    for (k = 0; k < 3; k++) {
        u[k] = q[k] - p[k];
        v[k] = r[k] - p[k];
    }
    for (k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        sum += tracker_shift_right(u[i] * v[j] - u[j] * v[i], AREA_SHIFT) * p[k];
    }
    return tracker_shift_right(sum, 30);
}

/* Whether two votes for a guide star agree: the third side, and the sense. */
int tracker_votes_agree(const struct tracker_search *search, const struct tracker_votes *votes, int pole, int pole_guide,
                        const struct tracker_vote *one, const struct tracker_vote *other, int32_t sides)
{
    const int k = votes->star[one->neighbour], l = votes->star[other->neighbour], side = tracker_side_of(k, l);
    const int64_t chord = search->chord[side], allowed = tracker_tolerance(search, side, sides);
    const int64_t low = chord > allowed ? chord - allowed : 0, high = chord + allowed;
    int64_t a[3], b[3], c[3], p[3], q[3], r[3], square = 0, observed;
    int axis;

    for (axis = 0; axis < 3; axis++) {
        a[axis] = tracker_guide_direction[pole_guide][axis];
        b[axis] = tracker_guide_direction[one->guide][axis];
        c[axis] = tracker_guide_direction[other->guide][axis];
        square += (b[axis] - c[axis]) * (b[axis] - c[axis]);
    }
    if (square < low * low || square > high * high)
        return 0;
    tracker_to_array(&search->direction[pole], p);
    tracker_to_array(&search->direction[k], q);
    tracker_to_array(&search->direction[l], r);
    observed = area((const int64_t *)p, q, r);
    if (tracker_magnitude(observed) <= (allowed * chord) >> AREA_SHIFT)
        return 1;
    return (observed > 0) == (area(a, b, c) > 0);
}

int tracker_open_votes(struct tracker_search *search, struct tracker_votes *votes, int pole, int first, const int32_t *row)
{
    find_neighbours(search, votes, pole, first, row);
    if (votes->neighbours < row[TRACKER_ROW_NEED])
        return 0;
    votes->looked = count_votes(search, votes, pole);
    votes->need = enough_votes(votes, row[TRACKER_ROW_NEED]);
    votes->from = 0;
    search->steps += TRACKER_SEARCH_GUIDES + 2 * votes->looked;
    return 1;
}

int tracker_next_votes(struct tracker_search *search, struct tracker_votes *votes, int pole)
{
    int elected;

    votes->from = elect(votes, votes->from, votes->need, &elected);
    if (elected == 0)
        return 0;
    search->steps += 2 * votes->looked;
    collect(search, votes, pole, votes->need, elected);
    return elected;
}
