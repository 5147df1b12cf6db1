/* Groups of triads and their votes.
 *
 * Triads are grouped by their mean rotation: a triad joins the first group whose running mean is near. The largest group
 * first, its triads are votes for what each star is; the winners with the most disagreeing separations are dropped. Two of
 * at least three that are left, those farthest apart, give the attitude that is verified. */
#include "tracker_cordic.h"
#include "tracker_integers.h"
#include "tracker_search.h"

int tracker_as_long(const struct tracker_search *search, int side, int a, int b, int32_t sides)
{
    const int64_t chord = search->chord[side], allowed = tracker_tolerance(search, side, sides);
    const int64_t low = chord > allowed ? chord - allowed : 0, high = chord + allowed;
    int64_t square = 0;
    int k;

    for (k = 0; k < 3; k++) {
        const int64_t apart = (int64_t)tracker_guide_direction[a][k] - tracker_guide_direction[b][k];
        square += apart * apart;
    }
    return square >= low * low && square <= high * high;
}

/* Group of a rotation: the first whose running mean is near, or a new one; -1: there is no room for it. */
static int group_of(struct tracker_source *source, int32_t rotation)
{
    int64_t step = 0, off;
    int g;

    for (g = 0; g < source->groups; g++) {
        const struct tracker_group *known = &source->group[g];
        step = rotation - known->origin;
        off = step * known->count - known->total; /* on the side of the circle where the mean is */
        if (2 * off >= (int64_t)TRACKER_FULL_TURN * known->count)
            step -= TRACKER_FULL_TURN;
        else if (2 * off < -(int64_t)TRACKER_FULL_TURN * known->count)
            step += TRACKER_FULL_TURN;
        if (tracker_magnitude(step * known->count - known->total) <= (int64_t)TRACKER_TRIAD_GROUPING * known->count)
            break;
    }
    if (g == TRACKER_TRIAD_GROUPS)
        return -1;
    if (g == source->groups) {
        const struct tracker_group made = {0, rotation, 0, 0};
        source->group[source->groups++] = made;
        step = 0;
    }
    source->group[g].total += step;
    source->group[g].count++;
    return g;
}

static int largest_group(struct tracker_source *source)
{
    int largest = -1, g;

    for (g = 0; g < source->groups; g++)
        if (!source->group[g].used && (largest < 0 || source->group[g].count > source->group[largest].count))
            largest = g;
    if (largest >= 0)
        source->group[largest].used = 1;
    return largest;
}

/* Counts a vote; the number of names. */
static int count_name(struct tracker_name *name, int names, int star, int guide)
{
    int n;

    for (n = 0; n < names; n++)
        if (name[n].guide == guide && name[n].star == star) {
            name[n].frequency++;
            return names;
        }
    if (names == TRACKER_TRIAD_NAMED)
        return names;
    name[names].star = (uint8_t)star;
    name[names].guide = (uint16_t)guide;
    name[names].frequency = 1;
    return names + 1;
}

/* The guide star that is named most often for each star, if that is often enough and no other one is. */
static void elect_winners(struct tracker_search *search, int group, int stars, int needed)
{
    struct tracker_source *source = &search->work.source;
    int most, names = 0, star, t, k, n;

    for (t = 0; t < source->triads; t++) {
        if (source->triad[t].group != group)
            continue;
        for (k = 0; k < 3; k++)
            names = count_name(source->part.name, names, source->triad[t].star[k], source->triad[t].guide[k]);
    }
    for (star = 0; star < stars; star++) {
        source->winner[star] = -1;
        most = needed - 1;
        for (n = 0; n < names; n++) {
            if (source->part.name[n].star != star || source->part.name[n].frequency < most)
                continue;
            source->winner[star] = source->part.name[n].frequency > most ? source->part.name[n].guide : -1;
            most = source->part.name[n].frequency;
        }
    }
    search->steps += (2 * (int64_t)source->triads + 3 * (int64_t)source->group[group].count * names) >> 3;
}

/* Drops the winner with the most disagreeing separations, of equal ones the last, until all agree; how many are left. */
static int drop_disagreeing(struct tracker_search *search, int stars, int32_t sides)
{
    struct tracker_source *source = &search->work.source;
    const int32_t *winner = source->winner;
    int left = 0, worst, most, count, i, j;

    for (i = 0; i < stars; i++) {
        left += winner[i] >= 0;
        source->wrong[i][i] = 0;
        for (j = 0; j < i; j++) {
            source->wrong[i][j] = 0;
            if (winner[i] >= 0 && winner[j] >= 0
                && !tracker_as_long(search, tracker_side_of(i, j), winner[i], winner[j], sides))
                source->wrong[i][j] = 1;
            source->wrong[j][i] = source->wrong[i][j];
        }
    }
    for (;;) {
        worst = most = 0;
        for (i = 0; i < stars; i++) {
            count = 0;
            for (j = 0; j < stars; j++)
                count += source->wrong[i][j];
            if (count >= most) {
                most = count;
                worst = i;
            }
        }
        if (most == 0)
            return left;
        source->winner[worst] = -1;
        left--;
        for (j = 0; j < stars; j++)
            source->wrong[worst][j] = source->wrong[j][worst] = 0;
    }
}

/* Tries the attitude of the two winners that are farthest apart. */
static void try_winners(struct tracker_search *search, int stars, const int32_t *row)
{
    const int32_t *winner = search->work.source.winner;
    int64_t farthest = -1, frame[3][3];
    int star[2] = {0, 1}, i, j;
    struct tracker_matrix attitude;
    uint16_t guide[2];

    for (i = 0; i < stars; i++)
        for (j = i + 1; j < stars; j++)
            if (winner[i] >= 0 && winner[j] >= 0 && search->chord[tracker_side_of(i, j)] > farthest) {
                farthest = search->chord[tracker_side_of(i, j)];
                star[0] = i;
                star[1] = j;
            }
    guide[0] = (uint16_t)winner[star[0]];
    guide[1] = (uint16_t)winner[star[1]];
    if (tracker_pair_attitude(search, star, guide, frame, &attitude) && !tracker_is_known(search, &attitude, row))
        tracker_try_attitude(search, &attitude, row[TRACKER_ROW_GATES]);
}

void tracker_try_groups(struct tracker_search *search, int stars, const int32_t *row)
{
    struct tracker_source *source = &search->work.source;
    int needed = TRACKER_TRIAD_VOTES, checked = 0, group, t;

    source->groups = 0;
    for (t = 0; t < source->triads; t++)
        source->triad[t].group = (uint8_t)group_of(source, source->triad[t].rotation); /* 255: none */
    if (TRACKER_TRIAD_LONE && stars == 3 && source->groups == 1)
        needed = 1;
    while (checked < TRACKER_TRIAD_CHECKED) {
        group = largest_group(source);
        if (group < 0)
            return;
        elect_winners(search, group, stars, needed);
        if (drop_disagreeing(search, stars, row[TRACKER_ROW_SIDES]) < 3)
            continue;
        try_winners(search, stars, row);
        checked++;
        if (tracker_is_beyond(search, TRACKER_SURE_BEYOND))
            return;
    }
}
