/* Lost-in-space star identification and attitude in integers, for one camera (made by `boresight export-c`).
 *
 * Method: triads (Yee 1999), then every hypothesis is verified: matched with all points of the list and all guide stars
 * of the field, refitted, and accepted only where its Bayes factor exceeds 1 / false-alarm rate (TRACKER_THRESHOLD) and
 * no second attitude comes near it. Everything but TRACKER_SOLVED says nothing of the attitude.
 *
 * C99, integers of up to 64 bits; no floating point, heap, recursion, library call or static variable. Reentrant: all
 * working memory is in the context, one for each thread. Only names that begin with `tracker_` or `TRACKER_` are
 * defined, so that several exports with prefixes of their own link into one program.
 *
 * Work is bounded: every loop has a limit in tracker_tables.h. At most
 *     TRACKER_MOST_STEPS     comparisons of catalogue pairs in the search for triads;
 *     TRACKER_MAX_TRIADS     triads that pass all tests; more are TRACKER_SEARCH_LIMIT. Sorting them into groups compares
 *                            each with the groups before it: TRACKER_MAX_TRIADS^2 / 2 comparisons;
 *     TRACKER_MAX_GROUPS     groups that are looked at, the largest. Of each, for each of TRACKER_MAX_STARS points: three
 *                            passes over the triads, and a separation for each two catalogue stars that they name;
 *     TRACKER_MAX_GROUPS     attitudes verified: 3 gates of 8 rounds of TRACKER_MAX_POINTS x TRACKER_MAX_FIELD distances,
 *                            and one pass over TRACKER_GUIDES directions.
 *
 * Memory: sizeof(struct tracker_context) of the caller's, the constant tables, and a stack of less than 4 kB. */
#ifndef TRACKER_H
#define TRACKER_H

#include <stdint.h>

#include "tracker_tables.h"

#ifdef __cplusplus
extern "C" {
#endif

enum tracker_status {
    TRACKER_SOLVED,        /* attitude and numbers are valid */
    TRACKER_TOO_FEW_STARS, /* fewer than three points */
    TRACKER_NO_MATCH,      /* no attitude explains the list better than chance; the reason says how far it came */
    TRACKER_AMBIGUOUS,     /* two attitudes do */
    TRACKER_OUTSIDE_IMAGE, /* a point lies outside the image */
    TRACKER_OVERFLOW,      /* two points are 32 degrees or more apart */
    TRACKER_SEARCH_LIMIT   /* more than TRACKER_MAX_TRIADS triads */
};

enum tracker_reason {
    TRACKER_ACCEPTED,
    TRACKER_FEWER_THAN_THREE,
    TRACKER_NO_TRIADS,      /* no triad of catalogue stars passes the tests */
    TRACKER_NO_GROUP,       /* no group of triads names three stars */
    TRACKER_NO_ATTITUDE,    /* the stars named fit no attitude */
    TRACKER_FEW_FIT,        /* fewer than three points fit an attitude */
    TRACKER_NOT_SPREAD,     /* the points that fit lie in a clump or a line */
    TRACKER_WEAK_EVIDENCE,  /* chance explains the points that fit */
    TRACKER_RIVAL,
    TRACKER_POINT_OUTSIDE,
    TRACKER_SEPARATION_OVERFLOW,
    TRACKER_TOO_MANY_TRIADS
};

/* Of the image, in the catalogue's axes and epoch (J2000 unless exported otherwise). */
struct tracker_attitude {
    int32_t matrix[3][3]; /* 2.30 (1 is 2^30); rows: camera x (right), y (down), boresight: v_camera = matrix v_sky */
    int32_t ra, dec;      /* of the boresight, degrees of 10.22 (1 degree is 2^22): 0 to 360, -90 to 90 */
    int32_t roll;         /* position angle of the image's up, east of north, degrees of 10.22: 0 to 360 */
};

struct tracker_answer {
    enum tracker_status status;
    enum tracker_reason reason;
    int points;                          /* used: the first TRACKER_MAX_POINTS */
    int32_t number[TRACKER_MAX_POINTS];  /* catalogue number of each, + 10000 where several are one in the image;
                                            0: not matched; all 0 unless solved */
    int triads;                          /* in the group that won; 0 unless solved */
    int matched;                         /* points that fit the best attitude, solved or not */
    int32_t evidence;                    /* log2 of its Bayes factor, 12 bits of fraction; 0: none was weighed */
    struct tracker_attitude attitude;    /* zeros unless solved */
};

/* Working memory, sizeof(struct tracker_context) bytes; its contents mean nothing between calls. */
struct tracker_side {
    int32_t low, high;
    uint16_t end[2 * TRACKER_MAX_WINDOW];
    uint16_t next[2 * TRACKER_MAX_WINDOW];
    uint16_t head[TRACKER_CATALOG_STARS];
};

struct tracker_triad {
    uint8_t star[3];
    uint16_t catalog[3];
    int16_t mean;
    uint16_t group;
};

struct tracker_group {
    int32_t origin, total, count;
    int used;
};

struct tracker_context {
    struct tracker_side second_side, third_side;
    struct tracker_triad triads[TRACKER_MAX_TRIADS];
    struct tracker_group groups[TRACKER_MAX_TRIADS];
    int triad_count, group_count;
    int16_t separation[TRACKER_MAX_STARS][TRACKER_MAX_STARS];
    int16_t image_direction[TRACKER_MAX_STARS][TRACKER_MAX_STARS];
    uint8_t wrong[TRACKER_MAX_STARS][TRACKER_MAX_STARS];
    uint16_t frequency[TRACKER_CATALOG_STARS], place[TRACKER_CATALOG_STARS], label[TRACKER_CATALOG_STARS];
    uint16_t member[TRACKER_MAX_STARS][TRACKER_CATALOG_STARS];
    int members[TRACKER_MAX_STARS];
    int32_t seen[TRACKER_MAX_STARS][2];
    uint16_t catalog[TRACKER_MAX_STARS];
    int64_t image[TRACKER_MAX_STARS][2], left[TRACKER_MAX_STARS][2];
    /* verification */
    int64_t point[TRACKER_MAX_POINTS][2], square[TRACKER_MAX_POINTS], area[TRACKER_MAX_POINTS];
    int64_t gain[TRACKER_MAX_POINTS];
    int16_t rank[TRACKER_MAX_POINTS], index[TRACKER_MAX_POINTS], last[TRACKER_MAX_POINTS];
    int64_t predicted[TRACKER_MAX_FIELD][2];
    int16_t owner[TRACKER_MAX_FIELD];
    uint16_t field[TRACKER_MAX_FIELD];
    int64_t matrix[3][3];
    /* of the hypothesis verified last */
    int64_t evidence;
    int matched;
    int32_t guide[TRACKER_MAX_POINTS];
    int64_t fitted[3][3];
};

/* Solve one list.
 *
 * xy       `count` centroids without distortion, brightest first: pixels of 10.22 (1 pixel is 2^22) from the centre of
 *          the image, x right, y up; below 512 pixels in magnitude, which the type sees to. The first
 *          TRACKER_MAX_STARS make triads, the first TRACKER_MAX_POINTS are verified, the others are not looked at.
 * answer   filled in every case. */
void tracker_solve(struct tracker_context *context, const int32_t xy[][2], int count, struct tracker_answer *answer);

#ifdef __cplusplus
}
#endif

#endif
