/* What an attitude leaves unexplained: bright stars without a guide star where bright guide stars are without a star. */
#ifndef TRACKER_UNEXPLAINED_H
#define TRACKER_UNEXPLAINED_H

#include "tracker_pose.h"

#define TRACKER_UNEXPLAINED_ITEMS (TRACKER_MAX_STARS + TRACKER_POSE_MAX_FIELD)

/* Bright stars that are not matched, and the part of the image with most contradiction. */
struct tracker_unexplained {
    int64_t contrast;              /* ln of the likelihood ratio, 20 fraction bits; 0: there is no contradiction */
    int stars, guides;             /* in that part, not matched */
    int lost_stars, matched_stars; /* bright stars of the list, on the whole image */
    int lost_guides, matched_guides;
    int beside;                    /* stars with a guide star close by that is not matched */
};

/* Working memory: stars of the list, guide stars, and the bright ones of both. */
struct tracker_bright {
    int32_t star[TRACKER_MAX_STARS][2], guide[TRACKER_POSE_MAX_FIELD][2]; /* image positions, 16 fraction bits */
    uint8_t seen[TRACKER_MAX_STARS], matched[TRACKER_POSE_MAX_FIELD];     /* whether the attitude was fitted to them */
    int32_t position[TRACKER_UNEXPLAINED_ITEMS][2];
    int64_t key[TRACKER_UNEXPLAINED_ITEMS];
    int16_t order[TRACKER_UNEXPLAINED_ITEMS];
    uint8_t kind[TRACKER_UNEXPLAINED_ITEMS];
    int stars, guides, items;
};

/* Image position of a guide star, 16 fraction bits; 0: it is not on the image, or near its border. */
int tracker_guide_position(const struct tracker_matrix *attitude, const struct tracker_vector *direction, int32_t xy[2]);

/* What the attitude of the last tracker_solve_pose leaves unexplained of `count` stars. */
void tracker_find_unexplained(struct tracker_bright *bright, const struct tracker_pose *pose,
                              const struct tracker_matrix *attitude, const struct tracker_star *star, int count,
                              struct tracker_unexplained *left);

/* Whether the attitude is refused for it. */
int tracker_contradicts(const struct tracker_unexplained *left);

/* Whether the stars that are not matched may be those of another field, and are enough to be identified. */
int tracker_is_doubtful(const struct tracker_unexplained *left);

/* Whether the attitude of the last tracker_solve_pose is that of few stars, of which one is off by more than stated. */
int tracker_few_disagree(struct tracker_pose *pose, const struct tracker_star *star);

#endif
