/* The default source of hypotheses: candidates by the votes of a star's neighbours, confirmed by the other stars. The rules
 * are those of startracker/identification/candidate_search.py. */
#include "tracker_search.h"

static int better(const struct tracker_candidate *one, const struct tracker_candidate *other)
{
    return one->agreeing > other->agreeing;
}

/* Inserts a candidate behind those with as many votes. */
static void insert(struct tracker_source *source, const struct tracker_candidate *candidate)
{
    int at = source->candidates;

    if (at == TRACKER_SEARCH_MOST_CANDIDATES) {
        if (!better(candidate, &source->candidate[at - 1]))
            return;
        at--;
    } else
        source->candidates++;
    for (; at > 0 && better(candidate, &source->candidate[at - 1]); at--)
        source->candidate[at] = source->candidate[at - 1];
    source->candidate[at] = *candidate;
}

/* The best vote for an elected guide star, if enough agree; the votes compared. */
static int64_t examine(struct tracker_search *search, int pole, int at, const int32_t *row)
{
    const struct tracker_votes *votes = &search->work.source.votes;
    const int begin = votes->begin[at], end = begin + votes->filled[at], star = votes->elected[at];
    struct tracker_candidate best = {0, 0, 0, {0, 0}};
    int x, y, nearest = -1;

    for (x = begin; x < end; x++) {
        const struct tracker_vote *vote = &votes->vote[x];
        uint32_t agreeing = 0;
        int count = 1, first = -1, k;
        for (y = begin; y < end; y++)
            if (votes->vote[y].neighbour != vote->neighbour && !(agreeing >> votes->vote[y].neighbour & 1)
                && tracker_votes_agree(search, votes, pole, star, vote, &votes->vote[y], row[TRACKER_ROW_SIDES]))
                agreeing |= (uint32_t)1 << votes->vote[y].neighbour;
        for (k = votes->neighbours - 1; k >= 0; k--)
            if (agreeing >> k & 1) {
                count++;
                first = k;
            }
        if (count < row[TRACKER_ROW_NEED] || count < best.agreeing
            || (count == best.agreeing && vote->neighbour <= nearest))
            continue;
        nearest = vote->neighbour;
        best.neighbour = votes->star[vote->neighbour];
        best.third = votes->star[first];
        best.agreeing = (uint8_t)count;
        best.guide[0] = (uint16_t)star;
        best.guide[1] = vote->guide;
    }
    if (best.agreeing > 0)
        insert(&search->work.source, &best);
    return (int64_t)(end - begin) * (end - begin - 1);
}

/* Candidates of a pole; begins no further pass over the pairs beyond `most` steps. */
static void vote_about(struct tracker_search *search, int pole, const int32_t *row, int64_t most)
{
    struct tracker_source *source = &search->work.source;
    int elected, at;

    source->candidates = 0;
    if (!tracker_open_votes(search, &source->votes, pole, 0, row))
        return;
    while (search->steps <= most) {
        elected = tracker_next_votes(search, &source->votes, pole);
        if (elected == 0)
            return;
        for (at = 0; at < elected; at++)
            search->steps += 4 * examine(search, pole, at, row);
    }
}

static void try_candidate(struct tracker_search *search, int pole, const struct tracker_candidate *candidate,
                          const int32_t *row)
{
    const int used[3] = {pole, candidate->neighbour, candidate->third};
    struct tracker_matrix attitude;
    int64_t frame[3][3];

    if (!tracker_fits_prior(search, pole, candidate->guide[0], row)
        || !tracker_fits_prior(search, candidate->neighbour, candidate->guide[1], row)
        || !tracker_pair_attitude(search, used, candidate->guide, frame, &attitude)
        || tracker_is_known(search, &attitude, row))
        return;
    if (tracker_is_confirmed(search, &attitude, used, (const int64_t(*)[3])frame, row))
        tracker_try_attitude(search, &attitude, row[TRACKER_ROW_GATES]);
}

void tracker_run_row(struct tracker_search *search, const int32_t *row)
{
    const int64_t most = search->steps + row[TRACKER_ROW_STEPS];
    int pole, k;

    for (pole = 0; pole < row[TRACKER_ROW_POLES] && pole < search->count; pole++) {
        if (tracker_is_beyond(search, TRACKER_SURE_BEYOND))
            return;
        if (search->steps > most) {
            if (row[TRACKER_ROW_STATED])
                search->cut_short = 1;
            return;
        }
        vote_about(search, pole, row, most);
        for (k = 0; k < search->work.source.candidates; k++) {
            if (search->steps > most || tracker_is_beyond(search, TRACKER_SURE_BEYOND))
                break;
            try_candidate(search, pole, &search->work.source.candidate[k], row);
        }
    }
}
