/* Identification: working memory and functions of the search. */
#ifndef TRACKER_SEARCH_H
#define TRACKER_SEARCH_H

#include "tracker_types.h"

/* An attitude that explains stars, with its evidence. */
struct tracker_hypothesis {
    struct tracker_matrix attitude;
    int32_t evidence;                     /* log2 of the Bayes factor, 12 fraction bits, rounded down */
    int16_t matched;
    int16_t guide[TRACKER_MAX_STARS];     /* guide star of each star; -1: none */
};

struct tracker_search {
    struct tracker_hypothesis best[TRACKER_SEARCH_KEPT];
};

#endif
