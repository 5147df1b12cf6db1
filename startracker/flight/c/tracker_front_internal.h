/* Functions of the front end's modules. */
#ifndef TRACKER_FRONT_INTERNAL_H
#define TRACKER_FRONT_INTERNAL_H

#include "tracker_front.h"
#include "tracker_integers.h"

/* tracker_background.c */
uint16_t *tracker_front_row_at(struct tracker_front_rows *rows, int32_t y);
void tracker_front_follow(struct tracker_front_rows *rows, int32_t block, int32_t count); /* with the last `count` rows */
void tracker_front_line_at(struct tracker_front_rows *rows, int32_t y);                   /* fills rows->line */
int tracker_front_cell(int32_t x);                                                        /* knots about a column */
int32_t tracker_front_between(const int32_t *knots, int cell, int32_t x);
void tracker_front_level(const struct tracker_front_rows *rows, int cell,
                         struct tracker_front_candidate *candidate); /* removes the background's slope from its stamp */
int tracker_front_inside(const struct tracker_front_candidate *candidate, int column, int row);

/* tracker_hot_pixels.c */
void tracker_front_bridge_row(struct tracker_front_rows *rows, int32_t y); /* rows up to y - 1 are then without hot pixels */

/* tracker_rows.c */
void tracker_front_search_row(struct tracker_front *front, int32_t y);

/* tracker_components.c */
void tracker_front_join(struct tracker_front_rows *rows, const struct tracker_front_run *run, int32_t y,
                        const struct tracker_front_sums *sums, int32_t saturated);
void tracker_front_close(struct tracker_front *front, int32_t y); /* components that do not reach row y */
int tracker_front_at_border(const struct tracker_front_object *object);
void tracker_front_principal(const int32_t moments[3], int32_t axes[2]); /* the larger variance first */

/* tracker_stamps.c */
void tracker_front_shapes(struct tracker_front *front);
int tracker_front_boxed(const struct tracker_front_candidate *candidate, const struct tracker_front_object *object);
int tracker_front_look_trailed(const struct tracker_front *front); /* whether most candidates are long */

/* tracker_trails.c */
void tracker_front_trace_start(struct tracker_front *front);
void tracker_front_trace(struct tracker_front *front, int32_t y, int32_t x); /* a pixel above half the threshold */
void tracker_front_trace_row(struct tracker_front *front, int32_t y);        /* after the pixels of row y */

/* tracker_trail_fit.c */
void tracker_front_measure_trail(struct tracker_front *front, const struct tracker_front_piece *piece); /* adds it */

/* tracker_motion.c */
void tracker_front_motion_at(const struct tracker_front_motion *motion, int64_t x, int64_t y, int64_t along[2]);
int tracker_front_agrees(const struct tracker_front_trail *trail, const struct tracker_front_motion *motion);
void tracker_front_add_trail(struct tracker_front *front, const struct tracker_front_trail *trail);

/* tracker_fit.c */
int32_t tracker_front_entry(const uint16_t *table, int64_t away);
void tracker_front_fit_star(struct tracker_front *front, int candidate); /* without the light of the neighbours */
int tracker_front_neighbours(const struct tracker_front *front, int candidate, int other); /* that have a flux */

#endif
