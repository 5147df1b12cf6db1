/* Identification: working memory and functions of the search, in integers in both arithmetics. */
#ifndef TRACKER_SEARCH_H
#define TRACKER_SEARCH_H

#include "tracker_directions.h"
#include "tracker_hypotheses.h"
#include "tracker_integers.h"
#include "tracker_types.h"

#define TRACKER_SEARCH_SIDES (TRACKER_SEARCH_SIDE_STARS * (TRACKER_SEARCH_SIDE_STARS - 1) / 2)
#define TRACKER_SURE_BEYOND 88640 /* 15 / ln 2: margin beyond which no other attitude can compete, log2, 12 fraction bits */
#define TRACKER_SEARCH_NEVER (-((int64_t)1 << 28)) /* log2 of zero, 12 fraction bits */

/* An attitude that explains stars, with its evidence. */
struct tracker_hypothesis {
    int64_t evidence;                 /* log2 of the Bayes factor, 12 fraction bits, rounded down */
    struct tracker_matrix attitude;
    int16_t guide[TRACKER_MAX_STARS]; /* guide star of each star that is used; -1: none */
    int16_t matched;
    int16_t width;                    /* number of the width that fits best */
};

/* Guide stars of a field and their matches. */
struct tracker_field {
    uint16_t guide[TRACKER_SEARCH_MAX_DEPTH];            /* brightest first */
    struct tracker_vector direction[TRACKER_SEARCH_MAX_DEPTH], predicted[TRACKER_SEARCH_MAX_DEPTH];
    int16_t owner[TRACKER_SEARCH_MAX_DEPTH];
    int depth;
    int16_t rank[TRACKER_MAX_STARS], last[TRACKER_MAX_STARS], weighed[TRACKER_MAX_STARS]; /* guide star in the field; -1 */
    int64_t square[TRACKER_MAX_STARS]; /* residuals in units of the stated variances, 8 fraction bits */
    int matched;
    /* of the evidence */
    int64_t base[TRACKER_MAX_STARS], gain[TRACKER_MAX_STARS];
    int32_t ratio[2][TRACKER_MAX_STARS];
    int16_t ordered_rank[TRACKER_MAX_STARS], star[TRACKER_MAX_STARS];
};

/* Working memory of an identification. */
struct tracker_search {
    /* the stars that are used, brightest first */
    int count;
    uint8_t index[TRACKER_MAX_STARS];             /* in the list */
    struct tracker_vector direction[TRACKER_MAX_STARS];
    int64_t variance[TRACKER_MAX_STARS];          /* of the direction on one axis, 2^-60 rad^2 */
    int32_t magnitude[TRACKER_MAX_STARS];         /* 6 fraction bits */
    int brightness;                               /* whether all of them are known */
    int32_t excess[9][TRACKER_MAX_STARS];         /* log2 of the crowding */
    uint32_t chord[TRACKER_SEARCH_SIDES], error[TRACKER_SEARCH_SIDES]; /* of pairs i > j at i (i - 1) / 2 + j */
    struct tracker_observer observer;
    struct tracker_prior prior;
    /* hypotheses, the strongest first */
    struct tracker_hypothesis best[TRACKER_SEARCH_KEPT + 1];
    int kept, cut_short;
    int64_t rest;                                 /* log2 of the evidence of those that are not kept */
    int64_t gain;                                 /* log2 of what the prior adds */
    int64_t steps;
    union {
        struct tracker_source source;             /* of hypotheses */
        int64_t sum[8][TRACKER_MAX_STARS];        /* of the crowding */
    } work;
    struct tracker_field field;
};

/* Result of an identification. */
struct tracker_found {
    enum tracker_reason reason;
    struct tracker_hypothesis best; /* guide: of each star of the list */
    int64_t chance, steps;
    int contradicted;               /* the prior is */
};

/* tracker_search.c: identifies a list of `count` stars with directions where `seen` is not 0. */
void tracker_identify(struct tracker_search *search, const struct tracker_observer *observer,
                      const struct tracker_prior *prior, const struct tracker_star *star, const struct tracker_vector *direction,
                      const uint8_t *seen, int count, struct tracker_found *found);

/* tracker_evidence.c */
int64_t tracker_log_down(int64_t n);                      /* log2 of n >= 1, 12 fraction bits, rounded down */
int64_t tracker_log_sum(int64_t a, int64_t b);            /* log2 of 2^a + 2^b, rounded down */
int64_t tracker_log_sum_up(int64_t a, int64_t b);         /* rounded up */
void tracker_crowding(struct tracker_search *search);     /* fills `excess` */
/* log2 of the Bayes factor of the field's match, by the logarithm of the normal matrix' determinant; the best width */
int64_t tracker_weigh(struct tracker_search *search, int64_t log_normal, int *width);

/* tracker_verify.c: verifies an attitude from the gates of a row on; the hypothesis has TRACKER_SEARCH_NEVER as evidence if
 * fewer than three stars match. Counts its steps. */
void tracker_verify(struct tracker_search *search, const struct tracker_matrix *start, int gates,
                    struct tracker_hypothesis *found);

/* tracker_search.c, for the source of hypotheses */
int tracker_is_beyond(const struct tracker_search *search, int64_t margin); /* the best one is accepted with a margin */
/* Whether an attitude is one of the hypotheses within the gate of the brightest star. */
int tracker_is_known(const struct tracker_search *search, const struct tracker_matrix *attitude, const int32_t *row);
/* Verifies an attitude, and adds it to the hypotheses. */
void tracker_try_attitude(struct tracker_search *search, const struct tracker_matrix *start, int gates);

/* tracker_candidates.c or tracker_triads.c: a row of tracker_search_row; tries attitudes, and counts its steps. */
void tracker_run_row(struct tracker_search *search, const int32_t *row);

/* tracker_votes.c */
int tracker_side_of(int i, int j); /* number of a pair of different stars */
int64_t tracker_tolerance(const struct tracker_search *search, int side, int32_t sides); /* of a chord */
/* Whether two votes for a guide star agree: the third side, and the sense. */
int tracker_votes_agree(const struct tracker_search *search, const struct tracker_votes *votes, int pole, int pole_guide,
                        const struct tracker_vote *one, const struct tracker_vote *other, int32_t sides);
/* Counts the votes about a pole of the stars from `first` on, and the steps of that; 0: too few vote. */
int tracker_open_votes(struct tracker_search *search, struct tracker_votes *votes, int pole, int first, const int32_t *row);
/* Keeps the votes for the next guide stars, and counts the steps of that; how many guide stars, 0: none is left. */
int tracker_next_votes(struct tracker_search *search, struct tracker_votes *votes, int pole);

/* tracker_pair.c */
/* Attitude of two stars and two guide stars; axes of the stars: the midpoint of their directions, the difference, and the
 * normal to both. 0: there is none. */
int tracker_pair_attitude(const struct tracker_search *search, const int star[2], const uint16_t guide[2],
                          int64_t frame[3][3], struct tracker_matrix *attitude);
/* Square of the gate of a star with this variance, 2^-60 rad^2. */
int64_t tracker_gate_of(int64_t variance, const int32_t *row);
/* Whether a guide star can be where a star is, according to the prior. */
int tracker_fits_prior(const struct tracker_search *search, int star, int guide, const int32_t *row);

/* Column of the grid of a coordinate, 2.30. */
static inline int tracker_column_of(int64_t coordinate)
{
    const int64_t shifted = coordinate + ((int64_t)1 << 30);

    if (shifted < 0)
        return 0;
    return (int)tracker_smaller(shifted >> TRACKER_SEARCH_COLUMN_SHIFT, TRACKER_SEARCH_COLUMNS - 1);
}

/* Columns of tracker_search_row. */
enum {
    TRACKER_ROW_POLES,
    TRACKER_ROW_AMONG,
    TRACKER_ROW_NEIGHBOURS,
    TRACKER_ROW_NEED,
    TRACKER_ROW_SIDES,
    TRACKER_ROW_GATE2,
    TRACKER_ROW_GATES,
    TRACKER_ROW_CHANCE,
    TRACKER_ROW_ENOUGH,
    TRACKER_ROW_STATED,
    TRACKER_ROW_STEPS
};

#endif
