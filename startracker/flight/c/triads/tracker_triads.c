/* Triads as the source of hypotheses (Yee 1999, section 2.3.4).
 *
 * Three observed stars may be three guide stars if sides, sense and inner angles of their triangles agree, and two sides are
 * turned alike against the celestial pole. The first star of a triangle is a pole (tracker_votes.c): two votes for a guide
 * star are two sides, and a triad if the third one agrees. startracker/identification/triads.py is the same in floating
 * point, but for stars that are not resolved: guide stars with a close neighbour are in no pair here. Angles are degrees of
 * 10.6. */
#include "tracker_cordic.h"
#include "tracker_integers.h"
#include "tracker_search.h"

#define ANGLE_SHIFT 34
#define SIDES_BITS 10
#define VOTE_STEPS 3
#define TRIAD_STEPS 300

static void guide_vector(int guide, int64_t out[3])
{
    int k;

    for (k = 0; k < 3; k++)
        out[k] = tracker_guide_direction[guide][k];
}

/* Direction of the line from a star to another in the tangent plane, from x over the image's upper edge, 10.6. */
static int32_t image_bearing(const int64_t p[3], const int64_t q[3])
{
    const int64_t across = tracker_shift_right(q[0] * p[2] - p[0] * q[2], 30);
    const int64_t up = tracker_shift_right(p[1] * q[2] - q[1] * p[2], 30);

    return (int32_t)tracker_shift_right(tracker_fine_angle(up, across), ANGLE_SHIFT);
}

/* Direction of the great circle from a guide star to another, from west over north, 10.6. */
static int32_t sky_bearing(const int64_t p[3], const int64_t q[3])
{
    int64_t step[3], west, north;
    int k;

    for (k = 0; k < 3; k++)
        step[k] = q[k] - p[k];
    west = tracker_shift_right(p[1] * step[0] - p[0] * step[1], 30);
    north = step[2] - tracker_shift_right(p[2] * tracker_dot(p, step), 30);
    return (int32_t)tracker_shift_right(tracker_fine_angle(north, west), ANGLE_SHIFT);
}

static int angles_agree(int64_t seen[3][3], int64_t known[3][3])
{
    int k;

    if (TRACKER_TRIAD_ENCLOSED < 0)
        return 1;
    for (k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const int64_t apart = (int64_t)tracker_inner_angle(seen[k], seen[i], seen[j])
                              - tracker_inner_angle(known[k], known[i], known[j]);
        if (tracker_magnitude(apart) > TRACKER_TRIAD_ENCLOSED)
            return 0;
    }
    return 1;
}

/* Keeps a triad if its rotations and inner angles agree. */
static void try_triad(struct tracker_search *search, const struct tracker_triad *found)
{
    struct tracker_source *source = &search->work.source;
    int64_t seen[3][3], known[3][3];
    int32_t one, two, apart;
    int k;

    for (k = 0; k < 3; k++) {
        tracker_to_array(&search->direction[found->star[k]], seen[k]);
        guide_vector(found->guide[k], known[k]);
    }
    one = tracker_modulo_turn(sky_bearing(known[0], known[1]) - image_bearing(seen[0], seen[1]));
    two = tracker_modulo_turn(sky_bearing(known[0], known[2]) - image_bearing(seen[0], seen[2]));
    apart = tracker_turn_between(two, one);
    if (tracker_magnitude(apart) > TRACKER_TRIAD_ROTATION || !angles_agree(seen, known))
        return;
    if (source->triads == TRACKER_TRIAD_ROOM) {
        source->full = 1;
        return;
    }
    source->triad[source->triads] = *found;
    source->triad[source->triads++].rotation = (int16_t)tracker_modulo_turn(one + (int32_t)tracker_shift_right(apart, 1));
}

/* Triads of the votes for an elected guide star; counts the steps. */
static void examine(struct tracker_search *search, int pole, int at, const int32_t *row)
{
    const struct tracker_votes *votes = &search->work.source.part.votes;
    const int begin = votes->begin[at], end = begin + votes->filled[at], star = votes->elected[at];
    const int32_t sides = row[TRACKER_ROW_SIDES];
    int x, y;

    if (!tracker_fits_prior(search, pole, star, row))
        return;
    for (x = begin; x < end; x++)
        for (y = x + 1; y < end; y++) {
            const struct tracker_vote *one = &votes->vote[x], *other = &votes->vote[y];
            struct tracker_triad found = {{(uint8_t)pole, 0, 0}, 0, {(uint16_t)star, one->guide, other->guide}, 0};
            search->steps += VOTE_STEPS;
            if (one->neighbour == other->neighbour || !tracker_votes_agree(search, votes, pole, star, one, other, sides))
                continue;
            found.star[1] = votes->star[one->neighbour];
            found.star[2] = votes->star[other->neighbour];
            if (!tracker_as_long(search, tracker_side_of(pole, found.star[1]), star, one->guide, sides)
                || !tracker_as_long(search, tracker_side_of(pole, found.star[2]), star, other->guide, sides))
                continue;
            search->steps += TRIAD_STEPS;
            try_triad(search, &found);
        }
}

/* Triads whose first star is a pole. */
static void find_about(struct tracker_search *search, int pole, const int32_t *row, int64_t most)
{
    struct tracker_source *source = &search->work.source;
    int elected, at;

    if (!tracker_open_votes(search, &source->part.votes, pole, pole + 1, row))
        return;
    while (search->steps <= most && !source->full) {
        elected = tracker_next_votes(search, &source->part.votes, pole);
        if (elected == 0)
            return;
        for (at = 0; at < elected; at++)
            examine(search, pole, at, row);
    }
}

/* Whether the errors that a row assumes are a small share of the field for half of the stars, or stated. */
static int is_tried(const struct tracker_search *search, const int32_t *row)
{
    const int64_t largest = ((int64_t)TRACKER_TRIAD_WIDEST << SIDES_BITS) / row[TRACKER_ROW_SIDES];
    int small = 0, k;

    for (k = 0; k < search->count; k++)
        small += search->variance[k] <= largest * largest;
    return row == tracker_search_row[0] || 2 * small >= search->count;
}

void tracker_run_row(struct tracker_search *search, const int32_t *row)
{
    const int64_t most = search->steps + row[TRACKER_ROW_STEPS];
    const int stars = search->count < TRACKER_TRIAD_STARS ? search->count : TRACKER_TRIAD_STARS;
    struct tracker_source *source = &search->work.source;
    int pole;

    if (!is_tried(search, row))
        return;
    source->triads = source->full = 0;
    for (pole = 0; pole < stars - 2; pole++)
        if (search->steps <= most && !source->full)
            find_about(search, pole, row, most);
    if (search->steps > most || source->full)
        search->cut_short = 1;
    tracker_try_groups(search, stars, row);
}
