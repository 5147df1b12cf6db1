/* Functions of the frame's stages that are no part of the interface. */
#ifndef TRACKER_SOLVER_H
#define TRACKER_SOLVER_H

#include "tracker.h"

/* An answer without an attitude. */
void tracker_refuse(struct tracker_answer *answer, enum tracker_status status, enum tracker_reason reason);

/* Identification and attitude of the stars of the context. */
void tracker_solve_list(struct tracker_context *context, struct tracker_answer *answer);

#endif
