/* Working memory of the default source of hypotheses: candidates. */
#ifndef TRACKER_HYPOTHESES_H
#define TRACKER_HYPOTHESES_H

#include "tracker_votes.h"

/* A pair of stars with the guide stars that they may be. */
struct tracker_candidate {
    uint8_t neighbour, third, agreeing;
    uint16_t guide[2]; /* of the pole and of the neighbour */
};

struct tracker_source {
    struct tracker_votes votes; /* about one pole */
    struct tracker_candidate candidate[TRACKER_SEARCH_MOST_CANDIDATES]; /* those with most votes first */
    int candidates;
};

struct tracker_search;

/* tracker_confirm.c: whether enough of the stars other than three are near guide stars; `frame`: axes of the first two.
 * Counts its steps. */
int tracker_is_confirmed(struct tracker_search *search, const struct tracker_matrix *attitude, const int used[3],
                         const int64_t frame[3][3], const int32_t *row);

#endif
