/* Identification by triads: the order of loops and the rules of startracker/identification/triad_search.py and
 * triad_votes.py. */
#include "tracker.h"

#define HALF_TURN (FULL_TURN / 2)
#define NONE UINT16_MAX
#define COMBINED 10000

/* Catalogue pairs that one image pair may be, both ways round, chained by their first star. */
struct side {
    int32_t low, high;
    uint16_t end[2 * MAX_WINDOW];
    uint16_t next[2 * MAX_WINDOW];
    uint16_t head[CATALOG_STARS];
};

struct triad {
    uint8_t star[3];
    uint16_t catalog[3];
    int16_t mean;
    uint16_t group;
};

struct group {
    int32_t origin, total, count;
    int used;
};

static struct side second_side, third_side;
static struct triad triads[MAX_TRIADS];
static struct group groups[MAX_TRIADS];
static int triad_count, group_count;

static int16_t separation[MAX_STARS][MAX_STARS];
static int16_t image_direction[MAX_STARS][MAX_STARS];

static uint16_t frequency[CATALOG_STARS], place[CATALOG_STARS], label[CATALOG_STARS];
static uint16_t member[MAX_STARS][CATALOG_STARS];
static int members[MAX_STARS];

static int32_t modulo(int32_t angle)
{
    angle %= FULL_TURN;
    return angle < 0 ? angle + FULL_TURN : angle;
}

static int32_t between(int32_t first, int32_t second)
{
    return modulo(first - second + HALF_TURN) - HALF_TURN;
}

static int32_t absolute(int32_t value)
{
    return value < 0 ? -value : value;
}

/* First pair whose separation is not below the bound. */
static int32_t first_pair(int32_t bound)
{
    int32_t low = 0, high = PAIRS, middle;

    while (low < high) {
        middle = low + (high - low) / 2;
        if (pair_separation[middle] < bound)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static void window(int i, int j, int32_t *low, int32_t *high)
{
    *low = first_pair(separation[i][j] - SEPARATION_TOLERANCE);
    *high = first_pair(separation[i][j] + SEPARATION_TOLERANCE + 1);
}

static void chain(struct side *side, int i, int j)
{
    int32_t pair, entry;
    int way;

    window(i, j, &side->low, &side->high);
    for (entry = 0; entry < CATALOG_STARS; entry++)
        side->head[entry] = NONE;
    for (pair = side->low; pair < side->high; pair++)
        for (way = 0; way < 2; way++) {
            const uint16_t start = way ? pair_second[pair] : pair_first[pair];
            entry = 2 * (pair - side->low) + way;
            side->end[entry] = way ? pair_first[pair] : pair_second[pair];
            side->next[entry] = side->head[start];
            side->head[start] = (uint16_t)entry;
        }
}

static int holds(const struct side *side, int start, int end)
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
    int64_t east = (int64_t)star_ra[b] - star_ra[a] + half;

    if (east < 0)
        east += whole;
    if (east >= whole)
        east -= whole;
    return direction((int64_t)star_dec[b] - star_dec[a], half - east);
}

static int enclosed_agree(int p, int q, int r, int a, int b, int c)
{
    const int32_t pq = image_direction[p][q], pr = image_direction[p][r], qr = image_direction[q][r];

    if (ENCLOSED_TOLERANCE < 0)
        return 1;
    return absolute(between(absolute(between(pq, pr)), catalog_angle(a, b, c))) <= ENCLOSED_TOLERANCE
           && absolute(between(absolute(between(pq + HALF_TURN, qr)), catalog_angle(b, a, c))) <= ENCLOSED_TOLERANCE
           && absolute(between(absolute(between(pr, qr)), catalog_angle(c, a, b))) <= ENCLOSED_TOLERANCE;
}

static int after(const struct triad *triad, int a, int b, int c)
{
    if (triad->catalog[0] != a)
        return triad->catalog[0] > a;
    return triad->catalog[1] != b ? triad->catalog[1] > b : triad->catalog[2] > c;
}

/* Keeps a triad that passes, the triads since `first`, of one triangle, in the order of their stars' places.
 * 1: went well, 0: no room. */
static int test_triad(int first, int p, int q, int r, int a, int b, int c)
{
    const int32_t one = modulo(catalog_direction(a, b) - image_direction[p][q]);
    const int32_t two = modulo(catalog_direction(a, c) - image_direction[p][r]);
    struct triad *triad;

    if (absolute(between(one, two)) > ROTATION_TOLERANCE || !enclosed_agree(p, q, r, a, b, c))
        return 1;
    if (triad_count == MAX_TRIADS)
        return 0;
    for (triad = &triads[triad_count]; triad > &triads[first] && after(triad - 1, a, b, c); triad--)
        *triad = *(triad - 1);
    triad->star[0] = (uint8_t)p;
    triad->star[1] = (uint8_t)q;
    triad->star[2] = (uint8_t)r;
    triad->catalog[0] = (uint16_t)a;
    triad->catalog[1] = (uint16_t)b;
    triad->catalog[2] = (uint16_t)c;
    triad->mean = (int16_t)modulo(one + (int32_t)shift_right(between(two, one), 1));
    triad_count++;
    return 1;
}

static int find_triads(int stars)
{
    int32_t low, high, pair;
    int p, q, r, way, first;
    uint16_t entry;

    triad_count = 0;
    for (p = 0; p < stars; p++)
        for (q = p + 1; q < stars; q++) {
            window(p, q, &low, &high);
            for (r = q + 1; r < stars; r++) {
                chain(&second_side, p, r);
                chain(&third_side, q, r);
                first = triad_count;
                for (pair = low; pair < high; pair++)
                    for (way = 0; way < 2; way++) {
                        const int a = way ? pair_second[pair] : pair_first[pair];
                        const int b = way ? pair_first[pair] : pair_second[pair];
                        for (entry = second_side.head[a]; entry != NONE; entry = second_side.next[entry])
                            if (holds(&third_side, b, second_side.end[entry])
                                && !test_triad(first, p, q, r, a, b, second_side.end[entry]))
                                return 0;
                    }
            }
        }
    return 1;
}

static void group_triads(void)
{
    int64_t off, step;
    int t, g;

    group_count = 0;
    for (t = 0; t < triad_count; t++) {
        step = 0;
        for (g = 0; g < group_count; g++) {
            const struct group *known = &groups[g];
            step = triads[t].mean - known->origin;
            off = step * known->count - known->total;
            if (2 * off >= (int64_t)FULL_TURN * known->count)
                step -= FULL_TURN;
            else if (2 * off < -(int64_t)FULL_TURN * known->count)
                step += FULL_TURN;
            off = step * known->count - known->total;
            if ((off < 0 ? -off : off) <= (int64_t)GROUPING_TOLERANCE * known->count)
                break;
        }
        if (g == group_count) {
            groups[g].origin = triads[t].mean;
            groups[g].total = groups[g].count = groups[g].used = 0;
            group_count++;
            step = 0;
        }
        triads[t].group = (uint16_t)g;
        groups[g].total += (int32_t)step;
        groups[g].count++;
    }
}

/* Catalogue stars that the triads of a group name for an image star, brightest first. */
static int named(int g, int star)
{
    int found = 0, t, k, n;

    for (t = 0; t < triad_count; t++)
        for (k = 0; k < 3; k++)
            if (triads[t].group == g && triads[t].star[k] == star) {
                const uint16_t catalog = triads[t].catalog[k];
                for (n = 0; n < found && place[n] != catalog; n++)
                    ;
                if (n == found) {
                    place[found++] = catalog;
                    frequency[n] = 0;
                }
                frequency[n]++;
            }
    for (t = 1; t < found; t++) {
        const uint16_t p = place[t], f = frequency[t];
        for (n = t; n > 0 && star_rank[place[n - 1]] > star_rank[p]; n--) {
            place[n] = place[n - 1];
            frequency[n] = frequency[n - 1];
        }
        place[n] = p;
        frequency[n] = f;
    }
    return found;
}

/* Labels of the stars that hang together because they are one in the image. */
static void combine(int found)
{
    int i, j, n;

    for (n = 0; n < found; n++)
        label[n] = (uint16_t)n;
    for (i = 0; i < found; i++)
        for (j = i + 1; j < found; j++)
            if (catalog_separation(place[i], place[j]) <= COMBINE_SEPARATION) {
                const uint16_t low = label[i] < label[j] ? label[i] : label[j];
                const uint16_t high = label[i] < label[j] ? label[j] : label[i];
                for (n = 0; n < found; n++)
                    if (label[n] == high)
                        label[n] = low;
            }
}

/* The star, or the several that are one, that has most votes: its members. */
static void vote(int g, int star, int needed)
{
    const int found = named(g, star);
    int most = 0, tied = 0, winner = -1, whole = 0, n, k;

    combine(found);
    members[star] = 0;
    for (n = 0; n < found; n++) {
        int sum = 0, size = 0;
        for (k = 0; k < found; k++)
            if (label[k] == n) {
                sum += frequency[k];
                size++;
            }
        for (k = 0; k < 2; k++) { /* the star alone; then, for the first of several, all of them */
            const int votes = k ? sum : frequency[n];
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
        if (whole ? label[n] == winner : n == winner)
            member[star][members[star]++] = place[n];
}

static int agree(int i, int j)
{
    int m, n;

    for (m = 0; m < members[i]; m++)
        for (n = 0; n < members[j]; n++)
            if (absolute(catalog_separation(member[i][m], member[j][n]) - separation[i][j]) <= SEPARATION_TOLERANCE)
                return 1;
    return 0;
}

/* Drops matches until all separations agree, each time the one with most disagreements, of equal ones the last. */
static void check(int stars)
{
    static uint8_t wrong[MAX_STARS][MAX_STARS];
    int i, j, worst, most, count;

    for (i = 0; i < stars; i++)
        for (j = i; j < stars; j++)
            wrong[i][j] = wrong[j][i] = (uint8_t)(i != j && members[i] > 0 && members[j] > 0 && !agree(i, j));
    for (;;) {
        worst = most = 0;
        for (i = 0; i < stars; i++) {
            count = 0;
            for (j = 0; j < stars; j++)
                count += wrong[i][j];
            if (count >= most) {
                most = count;
                worst = i;
            }
        }
        if (most == 0)
            return;
        members[worst] = 0;
        for (j = 0; j < stars; j++)
            wrong[worst][j] = wrong[j][worst] = 0;
    }
}

static int next_group(void)
{
    int largest = -1, g;

    for (g = 0; g < group_count; g++)
        if (!groups[g].used && (largest < 0 || groups[g].count > groups[largest].count))
            largest = g;
    if (largest >= 0)
        groups[largest].used = 1;
    return largest;
}

static int measure(const int32_t xy[][2], int stars)
{
    const int64_t scale[2] = {SCALE_X, SCALE_Y};
    int i, j, k;

    for (i = 0; i < stars; i++)
        for (j = i + 1; j < stars; j++) {
            int64_t step[2], along[2];
            int apart;
            for (k = 0; k < 2; k++) {
                step[k] = (int64_t)xy[j][k] - xy[i][k];
                along[k] = ((step[k] < 0 ? -step[k] : step[k]) * scale[k]) >> 32;
            }
            apart = image_separation(along[0], along[1]);
            if (apart < 0)
                return 0;
            separation[i][j] = (int16_t)apart;
            image_direction[i][j] = (int16_t)direction(step[1], step[0]);
        }
    return 1;
}

void solve(const int32_t xy[][2], int count, struct answer *answer)
{
    static int32_t seen[MAX_STARS][2];
    static uint16_t catalog[MAX_STARS];
    const int stars = count < MAX_STARS ? count : MAX_STARS;
    int g, star, matched, needed;

    answer->stars = stars;
    answer->triads = 0;
    for (star = 0; star < stars; star++)
        answer->number[star] = 0;
    answer->status = TOO_FEW_STARS;
    if (stars < 3)
        return;
    answer->status = OVERFLOW_STATUS;
    if (!measure(xy, stars))
        return;
    answer->status = TOO_MANY_TRIADS;
    if (!find_triads(stars))
        return;
    group_triads();
    needed = THREE_STARS && stars == 3 && group_count == 1 ? 1 : VOTE_NUMBER;
    answer->status = NO_MATCH;
    while ((g = next_group()) >= 0) {
        matched = 0;
        for (star = 0; star < stars; star++)
            vote(g, star, needed);
        check(stars);
        for (star = 0; star < stars; star++)
            if (members[star] > 0) {
                seen[matched][0] = xy[star][0];
                seen[matched][1] = xy[star][1];
                catalog[matched++] = member[star][0];
            }
        if (matched < 3)
            continue;
        for (star = 0; star < stars; star++)
            if (members[star] > 0)
                answer->number[star] = star_number[member[star][0]] + (members[star] > 1 ? COMBINED : 0);
        answer->triads = groups[g].count;
        answer->status = plate_attitude((const int32_t(*)[2])seen, catalog, matched, &answer->attitude) ? SOLVED
                                                                                                         : NO_ATTITUDE;
        return;
    }
}
