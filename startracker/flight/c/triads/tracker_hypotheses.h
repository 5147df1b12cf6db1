/* Working memory of the triads as the source of hypotheses. */
#ifndef TRACKER_HYPOTHESES_H
#define TRACKER_HYPOTHESES_H

#include "tracker_votes.h"

/* Three stars and the guide stars that they may be. */
struct tracker_triad {
    uint8_t star[3], group;
    uint16_t guide[3];
    int16_t rotation; /* mean of the rotations of two sides, degrees of 10.6 */
};

struct tracker_group {
    int64_t total; /* of the differences from the origin */
    int32_t origin, count;
    int used;
};

/* What the triads of a group say a star is. */
struct tracker_name {
    uint16_t guide, frequency;
    uint8_t star;
};

struct tracker_source {
    struct tracker_triad triad[TRACKER_TRIAD_ROOM];
    int triads, full; /* full: there was one more than there is room for */
    struct tracker_group group[TRACKER_TRIAD_GROUPS];
    int groups;
    int32_t winner[TRACKER_TRIAD_STARS]; /* guide star of each star; -1: none */
    uint8_t wrong[TRACKER_TRIAD_STARS][TRACKER_TRIAD_STARS]; /* separations that disagree */
    union {
        struct tracker_votes votes; /* about one pole */
        struct tracker_name name[TRACKER_TRIAD_NAMED];
    } part;
};

struct tracker_search;

/* tracker_triad_votes.c: groups the triads, and tries the attitudes of the largest groups. */
void tracker_try_groups(struct tracker_search *search, int stars, const int32_t *row);
/* Whether two guide stars are as far apart as two stars. */
int tracker_as_long(const struct tracker_search *search, int side, int a, int b, int32_t sides);

#endif
