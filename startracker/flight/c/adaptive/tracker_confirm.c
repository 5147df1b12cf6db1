/* Confirmation of a pair of stars by the others. */
#include "tracker_integers.h"
#include "tracker_search.h"

#define MOST_OTHERS 48
#define MOST_RATIO ((int64_t)1 << 15)
#define CANDIDATE_STEPS 30
#define STAR_STEPS 60

/* Whether a guide star is near a direction in the sky. */
static int guide_near(const int64_t sky[3], int64_t gate2)
{
    const int64_t reach = tracker_square_root(gate2) + 1;
    int x, y, entry;

    for (x = tracker_column_of(sky[0] - reach); x <= tracker_column_of(sky[0] + reach); x++)
        for (y = tracker_column_of(sky[1] - reach); y <= tracker_column_of(sky[1] + reach); y++) {
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
        rare = tracker_smaller(least_matches(mean, TRACKER_SEARCH_CHANCES - 1), row[TRACKER_ROW_ENOUGH]);
        need = rare > need ? rare : need;
    }
    return tracker_smaller(need, count);
}

/* Square of the gate of one of the other stars, 2^-60 rad^2. */
static int64_t gate_beside(const struct tracker_search *search, int star, int64_t shared, int64_t apart2,
                           const int64_t frame[3][3], const int32_t *row)
{
    int64_t direction[3], y, z, ratio;

    tracker_to_array(&search->direction[star], direction);
    y = tracker_dot(frame[1], direction);
    z = tracker_dot(frame[2], direction);
    ratio = tracker_smaller(((y * y + z * z) >> 12) / apart2, MOST_RATIO);
    return tracker_gate_of(search->variance[star] + (shared >> 2) + ((shared * ratio) >> 8), row);
}

static int is_among(int star, const int used[3])
{
    return star == used[0] || star == used[1] || star == used[2];
}

/* Whether enough of the other stars are near guide stars. */
int tracker_is_confirmed(struct tracker_search *search, const struct tracker_matrix *attitude, const int used[3],
                        const int64_t frame[3][3], const int32_t *row)
{
    const int64_t shared = search->variance[used[0]] + search->variance[used[1]];
    const int64_t chord = search->chord[tracker_side_of(used[0], used[1])];
    const int64_t apart2 = chord * chord >> 20 > 1 ? chord * chord >> 20 : 1;
    int64_t gate2[MOST_OTHERS], gates = 0, need, axes[3][3], direction[3], sky[3] = {0, 0, 0};
    int count = 0, found = 0, star, at, k;

    for (star = 0; star < search->count && count < MOST_OTHERS; star++)
        if (!is_among(star, used)) {
            gate2[count] = gate_beside(search, star, shared, apart2, frame, row);
            gates += gate2[count++] >> 24;
        }
    search->steps += CANDIDATE_STEPS + STAR_STEPS * (int64_t)count;
    need = needed_matches(gates, count, row);
    for (k = 0; k < 3; k++)
        tracker_to_array(&attitude->row[k], axes[k]);
    for (star = at = 0; star < search->count && at < count && found < need; star++) {
        if (is_among(star, used))
            continue;
        tracker_to_array(&search->direction[star], direction);
        for (k = 0; k < 3; k++)
            sky[k] = tracker_shift_right(
                direction[0] * axes[0][k] + direction[1] * axes[1][k] + direction[2] * axes[2][k], 30);
        found += guide_near(sky, gate2[at++]);
    }
    return found >= need;
}
