/* Fit of matched stars: rotation, focal length and shears, averaged over models of their errors.
 *
 * The model, its priors and the average are those of startracker/estimation/pose.py: a factor of all variances, a
 * systematic error tau equal for all stars, and the camera as calibrated, with a free focal length, or with shears as well.
 * Left out are unequal axes of the systematic error and errors that depend on the sub-pixel position. Sums over stars are
 * exact in 64 bits; small systems of equations are solved in real numbers. */
#include "tracker_pose_fit.h"

#include "tracker_tables.h"

#define COUNT TRACKER_POSE_UNKNOWNS
#define COLUMN_BITS 14
#define RESIDUAL_BITS 16
#define VARIANCE_BITS 36
#define WEIGHT_BITS 20
#define PRIOR_BITS 24
#define SYSTEMATIC_SHARE 41943 /* 0.04, the square of the first tau, 20 fraction bits */
#define TRUSTED 20
#define LONGEST ((int64_t)1 << 42)
#define NEGLIGIBLE ((int64_t)60 << PRIOR_BITS)

struct sums {
    tracker_real normal[COUNT][COUNT], right[COUNT];
    tracker_real total, log_weights, best, systematic;
    int count;
};

struct average {
    int any;
    tracker_real highest, weight, factor, systematic, shear2;
    tracker_real mean[COUNT], square[3][3]; /* mean, and weighted sum of the squares about it */
};

static tracker_real twice(tracker_real x)
{
    return tracker_times(x, tracker_real_of(1, 1));
}

static tracker_real halved(tracker_real x)
{
    return tracker_times(x, tracker_real_of(1, -1));
}

static int64_t median_variance(const struct tracker_pose_star *star, int count)
{
    int64_t ordered[TRACKER_MAX_STARS];
    int n, at;

    ordered[0] = 0;
    for (n = 0; n < count; n++) {
        for (at = n; at > 0 && ordered[at - 1] > star[n].variance; at--)
            ordered[at] = ordered[at - 1];
        ordered[at] = star[n].variance;
    }
    return (ordered[(count - 1) / 2] + ordered[count / 2]) >> 1;
}

/* Adds a star with a weight of 20 fraction bits to the sums in integers. */
static void add_star(const struct tracker_pose_star *star, int64_t weight, int64_t normal[COUNT][COUNT], int64_t right[COUNT])
{
    int axis, i, j;

    for (axis = 0; axis < 2; axis++)
        for (i = 0; i < COUNT; i++) {
            const int64_t weighted = weight * star->columns[axis][i];
            right[i] += weighted * star->residual[axis];
            for (j = 0; j <= i; j++)
                normal[i][j] += weighted * star->columns[axis][j];
        }
}

static void make_sums(const struct tracker_pose_star *star, int count, int64_t added, struct sums *sums)
{
    int64_t normal[COUNT][COUNT] = {{0}}, right[COUNT] = {0}, total = 0, best = star[0].variance;
    tracker_real product = tracker_real_of(1, 0);
    int n, i, j, shift = 0;

    for (n = 1; n < count; n++)
        if (star[n].variance < best)
            best = star[n].variance;
    best += added;
    while (best >> shift >= LONGEST)
        shift++;
    sums->log_weights = tracker_zero();
    for (n = 0; n < count; n++) {
        const int64_t c = (star[n].variance + added) >> shift;
        const int64_t x = star[n].residual[0], y = star[n].residual[1];
        int64_t weight = ((best >> shift) * ((int64_t)1 << WEIGHT_BITS) + (c >> 1)) / c;
        if (weight < 1)
            weight = 1;
        add_star(&star[n], weight, normal, right);
        total += weight * ((x * x + y * y) >> 8);
        product = tracker_times(product, tracker_real_of(weight, -WEIGHT_BITS));
        if (n % 4 == 3 || n == count - 1) {
            sums->log_weights = tracker_add(sums->log_weights, tracker_log2(product));
            product = tracker_real_of(1, 0);
        }
    }
    for (i = 0; i < COUNT; i++) {
        for (j = 0; j <= i; j++)
            sums->normal[i][j] = tracker_real_of(normal[i][j], -WEIGHT_BITS - 2 * COLUMN_BITS);
        sums->right[i] = tracker_real_of(right[i], -WEIGHT_BITS - COLUMN_BITS - RESIDUAL_BITS);
    }
    sums->total = tracker_real_of(total, 8 - WEIGHT_BITS - 2 * RESIDUAL_BITS);
    sums->best = tracker_real_of(best, -VARIANCE_BITS);
    sums->systematic = tracker_real_of(added, -VARIANCE_BITS);
    sums->count = count;
}

/* Reduces everything to the weight of a model that is 2^apart times as probable. */
static void fade(struct average *to, tracker_real apart)
{
    tracker_real by = tracker_zero();
    int i, j;

    if (tracker_integer_of(apart, PRIOR_BITS) <= NEGLIGIBLE)
        by = tracker_power_of_2(tracker_minus(apart));
    to->weight = tracker_times(to->weight, by);
    to->factor = tracker_times(to->factor, by);
    to->systematic = tracker_times(to->systematic, by);
    to->shear2 = tracker_times(to->shear2, by);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            to->square[i][j] = tracker_times(to->square[i][j], by);
}

struct model {
    tracker_real log_weight, scale; /* scale: factor of the variances */
    tracker_real normal[COUNT][COUNT], mean[COUNT];
    int size;
};

static void add_to_average(struct average *to, struct model *model, const struct sums *sums)
{
    tracker_real share = tracker_real_of(1, 0), scaled, spread, before, part, away[COUNT], column[COUNT];
    int i, j, k;

    if (!to->any) {
        to->any = 1;
        to->highest = model->log_weight;
    } else {
        const tracker_real apart = tracker_subtract(model->log_weight, to->highest);
        if (tracker_integer_of(apart, PRIOR_BITS) < -NEGLIGIBLE)
            return;
        if (tracker_sign(apart) > 0) {
            fade(to, apart);
            to->highest = model->log_weight;
        } else {
            share = tracker_power_of_2(apart);
        }
    }
    before = to->weight;
    to->weight = tracker_add(before, share);
    part = tracker_over(share, to->weight);
    for (k = 0; k < COUNT; k++) {
        away[k] = tracker_subtract(k < model->size ? model->mean[k] : tracker_zero(), to->mean[k]);
        to->mean[k] = tracker_add(to->mean[k], tracker_times(part, away[k]));
    }
    part = tracker_times(before, part);
    scaled = tracker_times(share, model->scale);
    spread = tracker_times(scaled, sums->best);
    for (i = 0; i < 3; i++) {
        for (k = 0; k < model->size; k++)
            column[k] = tracker_real_of(k == i, 0);
        tracker_solve_factorised(model->normal, model->size, column);
        for (j = 0; j < 3; j++)
            to->square[i][j] = tracker_add(
                to->square[i][j], tracker_add(tracker_times(spread, column[j]),
                                              tracker_times(part, tracker_times(away[i], away[j]))));
    }
    to->factor = tracker_add(to->factor, scaled);
    to->systematic = tracker_add(to->systematic, tracker_times(scaled, sums->systematic));
    if (model->size == COUNT)
        to->shear2 = tracker_add(to->shear2, tracker_times(share, tracker_times(model->mean[5], model->mean[5])));
}

static void add_model(struct average *to, const struct sums *sums, int t, int m)
{
    const int size = m == 0 ? 3 : m == 1 ? 4 : 6, power = TRUSTED + 2 * sums->count - 3;
    tracker_real pivots, chi2, spread, log_data;
    struct model model;
    int i, j, k;

    model.size = size;
    for (i = 0; i < size; i++) {
        for (j = 0; j <= i; j++)
            model.normal[i][j] = sums->normal[i][j];
        model.mean[i] = sums->right[i];
    }
    for (k = 3; k < size; k++)
        model.normal[k][k] = tracker_add(
            model.normal[k][k], tracker_times(sums->best, tracker_real_of(tracker_pose_information[m][k - 3], -PRIOR_BITS)));
    if (!tracker_factorise(model.normal, size, &pivots))
        return;
    tracker_solve_factorised(model.normal, size, model.mean);
    chi2 = sums->total;
    for (k = 0; k < size; k++)
        chi2 = tracker_subtract(chi2, tracker_times(model.mean[k], sums->right[k]));
    chi2 = tracker_over(chi2, sums->best);
    if (tracker_less(chi2, tracker_real_of(1, -40)))
        chi2 = tracker_real_of(1, -40);
    spread = tracker_add(tracker_real_of(TRUSTED, 0), chi2);
    log_data = tracker_times(tracker_real_of(2 * sums->count - size, 0), tracker_log2(sums->best));
    log_data = tracker_add(tracker_subtract(log_data, twice(sums->log_weights)), pivots);
    log_data = tracker_add(log_data, tracker_times(tracker_real_of(power, 0), tracker_log2(spread)));
    model.log_weight = tracker_real_of((int64_t)tracker_pose_model[m] + tracker_pose_systematic[t], -PRIOR_BITS);
    model.log_weight = tracker_subtract(model.log_weight, halved(log_data));
    model.scale = tracker_over(spread, tracker_real_of(power - 2, 0));
    add_to_average(to, &model, sums);
}

int tracker_fit_pose(const struct tracker_pose_star *star, int count, int plain, struct tracker_pose_fit *fit)
{
    const int64_t unit = median_variance(star, count);
    struct average average = {0};
    struct sums sums;
    tracker_real share;
    int t, m, i, j;

    for (t = 0; t < (plain ? 1 : TRACKER_POSE_GRID); t++) {
        const int64_t first = (unit * SYSTEMATIC_SHARE) >> 20;
        make_sums(star, count, t == 0 ? 0 : first * ((int64_t)1 << (t - 1)), &sums);
        for (m = 0; m < (plain ? 1 : 3); m++)
            add_model(&average, &sums, t, m);
    }
    if (!average.any)
        return 0;
    share = tracker_over(tracker_real_of(1, 0), average.weight);
    for (i = 0; i < COUNT; i++)
        fit->step[i] = average.mean[i];
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            fit->covariance[i][j] = tracker_times(average.square[i][j], share);
    /* a shear is also half a rotation, which residuals do not show */
    fit->covariance[2][2] = tracker_add(fit->covariance[2][2], tracker_times(average.shear2, share));
    fit->factor = tracker_times(average.factor, share);
    fit->systematic = tracker_times(average.systematic, share);
    return 1;
}
