/* Small systems of linear equations, by Cholesky's factors. */
#include "tracker_linear.h"

#define COUNT TRACKER_LARGEST_SYSTEM

int tracker_factorise(tracker_real a[COUNT][COUNT], int size, tracker_real *log_det)
{
    int i, j, k;

    *log_det = tracker_zero();
    for (k = 0; k < size; k++) {
        const tracker_real least = tracker_times(a[k][k], tracker_real_of(1, -20));
        tracker_real row[COUNT], pivot = a[k][k];
        for (j = 0; j < k; j++) {
            tracker_real value = a[k][j];
            for (i = 0; i < j; i++)
                value = tracker_subtract(value, tracker_times(row[i], a[j][i]));
            row[j] = value;
        }
        for (j = 0; j < k; j++) {
            a[k][j] = tracker_times(row[j], a[j][j]);
            pivot = tracker_subtract(pivot, tracker_times(row[j], a[k][j]));
        }
        if (!tracker_less(least, pivot))
            return 0;
        *log_det = tracker_add(*log_det, tracker_log2(pivot));
        a[k][k] = tracker_over(tracker_real_of(1, 0), pivot);
    }
    return 1;
}

void tracker_solve_factorised(tracker_real a[COUNT][COUNT], int size, tracker_real x[COUNT])
{
    int j, k;

    for (k = 0; k < size; k++)
        for (j = 0; j < k; j++)
            x[k] = tracker_subtract(x[k], tracker_times(a[k][j], x[j]));
    for (k = size - 1; k >= 0; k--) {
        x[k] = tracker_times(x[k], a[k][k]);
        for (j = k + 1; j < size; j++)
            x[k] = tracker_subtract(x[k], tracker_times(a[j][k], x[j]));
    }
}
