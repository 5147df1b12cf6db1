/* Working memory of the votes of the neighbours of one star. */
#ifndef TRACKER_VOTES_H
#define TRACKER_VOTES_H

#include "tracker_types.h"

struct tracker_vote {
    uint16_t guide;    /* of the neighbour */
    uint8_t neighbour; /* its number among the neighbours */
};

/* Votes about one pole. */
struct tracker_votes {
    uint8_t count[TRACKER_SEARCH_GUIDES];
    uint8_t star[TRACKER_SEARCH_MOST_NEIGHBOURS]; /* the neighbours, nearest first */
    uint32_t low[TRACKER_SEARCH_MOST_NEIGHBOURS], high[TRACKER_SEARCH_MOST_NEIGHBOURS]; /* windows of guide pairs */
    int neighbours;
    struct tracker_vote vote[TRACKER_SEARCH_MOST_VOTES];
    uint16_t elected[TRACKER_SEARCH_MOST_VOTES / 2];     /* guide stars whose votes are kept, ascending */
    uint16_t begin[TRACKER_SEARCH_MOST_VOTES / 2 + 1];   /* their first votes */
    uint8_t filled[TRACKER_SEARCH_MOST_VOTES / 2];
    int need, from;    /* fewest votes of those guide stars; the first guide star that is left */
    int64_t looked;    /* pairs of the windows */
};

#endif
