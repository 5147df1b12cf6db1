/* Types that the stages of a frame share. Fractions are binary: "2.30" is a signed number of 32 bits of which 30 are a
 * fraction, so that 1 is 2^30. */
#ifndef TRACKER_TYPES_H
#define TRACKER_TYPES_H

#include <stdint.h>

#include "tracker_tables.h"

/* A measured star. A list holds at most TRACKER_MAX_STARS of them, the brightest first. */
struct tracker_star {
    int32_t x, y;      /* pixels, 16 fraction bits; (0, 0) is the centre of the first pixel, x along columns, y along rows */
    int32_t flux;      /* DN, 4 fraction bits; 0: not known */
    uint32_t variance; /* of the position on one axis, square pixels, 26 fraction bits; 0: not known */
    uint16_t flags;    /* sum of TRACKER_SATURATED, TRACKER_ELONGATED */
};

#define TRACKER_SATURATED 1
#define TRACKER_ELONGATED 2

/* Unit vector of 2.30: camera axes (x along columns, y along rows, z out along the boresight) or ICRS axes. */
struct tracker_vector {
    int32_t x, y, z;
};

/* Attitude: v_camera = row v_icrs. Rows are the camera's axes x, y, z in ICRS axes. */
struct tracker_matrix {
    struct tracker_vector row[3];
};

/* An attitude that is known before the frame is solved; ignored if its rows are not unit vectors to 2^-10. */
struct tracker_prior {
    struct tracker_matrix attitude;
    uint32_t radius; /* largest rotation by which it may be wrong, radians, 28 fraction bits; 0: there is no prior */
};

/* What is known of a frame before it is read. */
struct tracker_frame_info {
    struct tracker_vector velocity; /* of the observer over that of light, ICRS axes, 2.30; zeros: no aberration */
    struct tracker_prior prior;
    int64_t time_us;                /* middle of the exposure, microseconds of any clock that does not jump */
    int32_t epoch;                  /* the same as Julian epoch (TT), years, 16 fraction bits, for the proper motion of the
                                       stars; 0: TRACKER_EPOCH, that of the tables */
};

/* Who sees the guide stars. */
struct tracker_observer {
    struct tracker_vector velocity; /* as above */
    int32_t years;                  /* since TRACKER_EPOCH, 16 fraction bits */
};

/* In the order of `startracker.solution.Status`. */
enum tracker_status {
    TRACKER_SOLVED,        /* attitude, covariance and catalogue numbers are valid */
    TRACKER_NO_STARS,      /* no star was found */
    TRACKER_TOO_FEW_STARS, /* fewer than TRACKER_SEARCH_LEAST_STARS */
    TRACKER_FRAME_SATURATED, /* not solved, and a large part of the frame is saturated */
    TRACKER_NO_MATCH,      /* no attitude explains the stars better than chance */
    TRACKER_AMBIGUOUS,     /* one explains them, but not beyond the false-alarm rate, or another one as well */
    TRACKER_SEARCH_LIMIT,  /* not solved when the steps of the search were used up */
    TRACKER_BAD_IMAGE      /* not all rows were given, or the frame is uniform */
};

enum tracker_reason {
    TRACKER_ACCEPTED,        /* solved */
    TRACKER_NOTHING_FOUND,   /* no star passes the detection */
    TRACKER_FEW_FOUND,       /* fewer stars than an identification needs, or usable ones with a known error */
    TRACKER_NO_HYPOTHESIS,   /* no attitude explains three stars */
    TRACKER_WEAK_EVIDENCE,   /* the best attitude is no better than chance */
    TRACKER_ABOVE_RATE,      /* the best attitude occurs by chance more often than the false-alarm rate allows */
    TRACKER_RIVAL,           /* another attitude explains the stars nearly as well */
    TRACKER_POSE_FAILED,     /* the identified stars fit no attitude */
    TRACKER_STEPS_USED_UP,   /* the steps of the search, or its room, were used up before an attitude was accepted */
    TRACKER_ROWS_MISSING,    /* tracker_finish before TRACKER_HEIGHT rows */
    TRACKER_FRAME_UNIFORM,   /* the frame has no noise */
    TRACKER_SATURATED_SHARE, /* a large part of the frame is saturated */
    TRACKER_UNEXPLAINED,     /* the attitude leaves bright stars unexplained where bright guide stars are without a star */
    TRACKER_FEW_DISAGREE,    /* only three or four stars fit, and one of them is off by more than its stated error allows */
    TRACKER_ANOTHER_FIELD    /* the stars that the attitude leaves unexplained are those of another field */
};

/* The result of a frame or of a list. */
struct tracker_answer {
    enum tracker_status status;
    enum tracker_reason reason;
    int stars;                               /* in the list, at most TRACKER_MAX_STARS */
    int matched;                             /* identified stars of the best attitude, solved or not */
    int used;                                /* of these, stars that the attitude was fitted to; 0 unless solved */
    int32_t evidence;                        /* log2 of its Bayes factor, 12 fraction bits; 0: there is none */
    int32_t chance;                          /* log2 of the probability that it is wrong, 12 fraction bits, rounded up */
    int32_t steps;                           /* of the search: at most TRACKER_SEARCH_MOST_STEPS */
    int prior_contradicted;                  /* 1: solved outside the prior */
    int32_t number[TRACKER_MAX_STARS];       /* catalogue number of each star; 0: not identified, and all unless solved */
    struct tracker_matrix attitude;          /* zeros unless solved, as all that follows */
    int32_t quaternion[4];                   /* x, y, z, w of the same rotation, 2.30; w is not negative */
    int64_t covariance[3][3];                /* of the rotation vector from truth to estimate, camera axes: square radians,
                                                60 fraction bits */
};

#endif
