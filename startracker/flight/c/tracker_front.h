/* From rows of pixels to measured stars. */
#ifndef TRACKER_FRONT_H
#define TRACKER_FRONT_H

#include "tracker_types.h"

/* Background of a block of rows: level, its slope a block, and noise of each tile, DN of 12 fraction bits. */
struct tracker_front_block {
    int32_t level[TRACKER_FRONT_TILES], slope[TRACKER_FRONT_TILES], noise[TRACKER_FRONT_TILES];
};

/* Background of a row in its knots, and the slope of its level a row, DN of 8 fraction bits. */
struct tracker_front_line {
    int32_t level[TRACKER_FRONT_KNOTS], noise[TRACKER_FRONT_KNOTS], slope[TRACKER_FRONT_KNOTS];
};

/* A run of pixels above the threshold, its sums, and later its component. */
struct tracker_front_run {
    uint16_t first, last, component;
};

/* Sums over pixels above the threshold; light in DN, columns and rows in pixels. */
struct tracker_front_sums {
    int64_t light, x, y, xx, yy, xy;
};

struct tracker_front_component {
    struct tracker_front_sums sums; /* no longer added to beyond TRACKER_FRONT_LARGEST pixels */
    int32_t pixels, saturated;
    int32_t noise;                  /* at its first pixel, DN of 8 fraction bits */
    uint16_t first_x, first_y;      /* its first pixel in reading order */
    uint16_t left, right, top, bottom;
    uint16_t parent;                /* the component that it was joined to; itself: none */
    uint8_t used;
};

enum tracker_front_kind { TRACKER_FRONT_SATURATED = 1, TRACKER_FRONT_LONG = 2, TRACKER_FRONT_LARGE = 3 };

/* A component that no stamp holds. */
struct tracker_front_object {
    int64_t light;              /* sum, DN; of a large one 2^40 + its pixels */
    int32_t x, y;               /* first moments, 16 fraction bits */
    int32_t xx, yy, xy;         /* second moments, square pixels, 8 fraction bits */
    int32_t pixels, noise;
    uint16_t first_x, first_y;
    uint16_t left, right, top, bottom;
    uint8_t kind, star;            /* one of tracker_front_kind; whether it has a saturated star's size and shape */
};

/* A local maximum of the filtered frame, with its pixels, without the slope of the background; 0 beyond the frame. */
struct tracker_front_candidate {
    int32_t height;             /* above the background, filtered units */
    int32_t level, noise;       /* background, DN of 8 fraction bits */
    uint16_t x, y;
    uint16_t stamp[TRACKER_FRONT_SIDE * TRACKER_FRONT_SIDE];
};

/* A component above half the threshold; sums over its pixels, of columns and rows. */
struct tracker_front_piece {
    int64_t x, y, xx, yy, xy;
    int32_t pixels;
    uint16_t first_x, first_y;      /* its first pixel in reading order */
    uint16_t left, right, bottom;
    uint16_t parent;                /* the one that it was joined to; itself: none */
    uint8_t state;                  /* in tracker_trails.c */
};

/* Pixels about these, and what is needed to know them. A row is a sequence of segments: first column, number, values. */
struct tracker_front_tracing {
    struct tracker_front_piece piece[2 * TRACKER_FRONT_TRAIL_RUNS + TRACKER_FRONT_TRAIL_PENDING];
    struct tracker_front_run run[TRACKER_FRONT_TRAIL_HISTORY][TRACKER_FRONT_TRAIL_RUNS];
    uint8_t runs[TRACKER_FRONT_TRAIL_HISTORY];
    uint16_t word[TRACKER_FRONT_TRAIL_WORDS];
    uint16_t begin[TRACKER_FRONT_TRAIL_ROWS], words[TRACKER_FRONT_TRAIL_ROWS];
    int32_t oldest, rows;           /* that are kept */
    int32_t used;                   /* words */
    int32_t next;
    int32_t pending;                /* pieces that have ended */
};

/* A measured trail: position (16 fraction bits), flux (4), variance (26), length along both axes (8; along_x >= 0). */
struct tracker_front_trail {
    int32_t flux, y, x;
    uint32_t variance;
    int16_t along_x, along_y;
    int16_t own_x, own_y;           /* the length that was fitted without a known motion; zeros: there was no such fit */
};

/* Motion that trails share: their length along both axes in the middle of the frame, 8 fraction bits, and its change per
 * half pixel, 20 more bits. */
struct tracker_front_motion {
    int32_t along_x, along_y, turn;
    int known;
};

/* Hot pixels of a row, and the values that replace them. */
struct tracker_front_bridge {
    int count;
    uint16_t x[TRACKER_FRONT_HOT], value[TRACKER_FRONT_HOT];
};

/* While rows come in. */
struct tracker_front_rows {
    uint16_t row[TRACKER_FRONT_RING][TRACKER_WIDTH];
    int32_t column[TRACKER_WIDTH]; /* a row filtered along y */
    struct tracker_front_block block[TRACKER_FRONT_KEPT];
    struct tracker_front_line line;
    struct tracker_front_bridge bridge[2];
    struct tracker_front_component component[2 * TRACKER_FRONT_RUNS];
    struct tracker_front_run run[2][TRACKER_FRONT_RUNS];
    int runs[2];
    int open;                      /* components in use */
    int worst;                     /* of the candidates; -1: not known */
};

/* A candidate that is measured. */
struct tracker_front_fit {
    int32_t x, y;                  /* from the middle of its stamp, 16 fraction bits */
    int32_t xx, yy, xy;            /* second moments under the weight, square pixels, 8 fraction bits */
    int32_t flux;                  /* DN, 4 fraction bits */
    int64_t variance, misfit;      /* square pixels, 26 fraction bits; chi squared, 8 */
    int32_t freedom;
    uint8_t full;                  /* it is the image of a saturated star */
    uint8_t good, valid, sharp;
};

/* A star as it was fitted before; without flux: none. */
struct tracker_front_neighbour {
    int32_t x, y, flux;
};

/* Thereafter. */
struct tracker_front_measures {
    uint16_t order[TRACKER_FRONT_POOL];   /* candidates, the highest first */
    struct tracker_front_fit fit[TRACKER_FRONT_POOL];
    /* the image that all stars share: distance of its nodes (16 fraction bits; 0, 0: it is not moved), 1/sigma (12),
     * half side of the window of a fit, mean variance with the pixel's (square pixels, 8) */
    int32_t trail_x, trail_y, inverse_x, inverse_y, variance;
    int half;
    struct tracker_front_neighbour neighbour[TRACKER_FRONT_POOL];
    int32_t data[TRACKER_FRONT_SIDE * TRACKER_FRONT_SIDE];
    int32_t image[3][TRACKER_FRONT_SIDE * TRACKER_FRONT_SIDE];
    int32_t middle[TRACKER_FRONT_OBJECTS];
};

struct tracker_front {
    int32_t given;                 /* rows */
    int32_t saturated;             /* pixels of TRACKER_FRONT_SATURATION or more */
    uint16_t lowest, highest;      /* pixel values */
    int candidates, objects, trails;
    int room;                      /* for candidates */
    int decided, tracing;          /* what the room beyond TRACKER_FRONT_TRAIL_POINTS is for; whether for trails */
    struct tracker_front_motion motion;
    struct tracker_front_trail trail[TRACKER_MAX_STARS]; /* brightest first */
    union {
        struct tracker_front_candidate candidate[TRACKER_FRONT_POOL];
        struct {
            struct tracker_front_candidate first[TRACKER_FRONT_TRAIL_POINTS];
            struct tracker_front_tracing tracing;
        } beside;
    } pool;
    struct tracker_front_object object[TRACKER_FRONT_OBJECTS];
    union {
        struct tracker_front_rows rows;
        struct tracker_front_measures measures;
    } work;
};

/* Begin a frame. */
void tracker_front_start(struct tracker_front *front);

/* The next row of TRACKER_WIDTH pixels, the top one first; rows beyond TRACKER_HEIGHT are ignored. */
void tracker_front_row(struct tracker_front *front, const uint16_t *row);

/* The frame's stars, brightest first; their number, at most TRACKER_MAX_STARS, or -1 if rows are missing. To be called
 * once a frame; `front` then still holds given, saturated, lowest and highest. */
int tracker_front_finish(struct tracker_front *front, struct tracker_star star[TRACKER_MAX_STARS]);

#endif
