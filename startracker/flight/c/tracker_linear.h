/* Small systems of linear equations. */
#ifndef TRACKER_LINEAR_H
#define TRACKER_LINEAR_H

#include "tracker_arithmetic.h"

#define TRACKER_LARGEST_SYSTEM 6

/* Factorises a symmetric matrix of `size` rows in place, A = L D L' with the inverses of D on the diagonal and L below it;
 * 0: not positive definite to 2^-20. log2 of the determinant. */
int tracker_factorise(tracker_real a[TRACKER_LARGEST_SYSTEM][TRACKER_LARGEST_SYSTEM], int size, tracker_real *log_det);

/* Solves a system with a factorised matrix; x holds the right-hand side and then the solution. */
void tracker_solve_factorised(tracker_real a[TRACKER_LARGEST_SYSTEM][TRACKER_LARGEST_SYSTEM], int size,
                              tracker_real x[TRACKER_LARGEST_SYSTEM]);

#endif
