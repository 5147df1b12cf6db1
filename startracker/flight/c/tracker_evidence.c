/* Evidence of a match against chance: the Bayes factor of startracker/identification/bayes_factor.py, never too large.
 *
 * log2 B has 12 fraction bits. Every star has its own stated variance; the widths, magnitudes, missing and false stars are
 * averaged over as in floating point, and the crowding of the observed stars lowers the evidence
 * (startracker/identification/clustering_null.py). Each table, logarithm and sum is rounded to the side on which B is
 * smaller. */
#include "tracker_integers.h"
#include "tracker_search.h"

#define ONE 4096
#define LOG_BITS 12
#define LOG_UP 24        /* largest error of tracker_log_down: 4096 log2(1 + 1/256), rounded up */
#define LOG_TWO_PI 10861 /* log2 of 2 pi, rounded up */
#define SUM_STEP 6
#define EXTENT_SHIFT 4
#define CROWD_WIDTHS 8   /* each half of the one before */
#define CROWD_BITS 30
#define SCATTERS 2
#define SAMPLE 24

static int64_t component(const struct tracker_vector *v, int axis)
{
    return axis == 0 ? v->x : axis == 1 ? v->y : v->z;
}

int64_t tracker_log_down(int64_t n)
{
    int64_t m = n;
    int bits = 0, step;

    for (step = 32; step > 0; step /= 2)
        if (m >> step > 0) {
            m >>= step;
            bits += step;
        }
    m = bits >= 8 ? n >> (bits - 8) : n * ((int64_t)1 << (8 - bits));
    return (int64_t)bits * ONE + tracker_search_log[m - 256];
}

int64_t tracker_log_sum(int64_t a, int64_t b)
{
    const int64_t high = tracker_larger(a, b), k = (high - tracker_smaller(a, b)) >> SUM_STEP;

    return k < TRACKER_SEARCH_SUMS ? high + tracker_search_sum[k] : high;
}

int64_t tracker_log_sum_up(int64_t a, int64_t b)
{
    const int64_t high = tracker_larger(a, b), k = (high - tracker_smaller(a, b)) >> SUM_STEP;

    if (k == 0)
        return high + ONE;
    return high + tracker_search_sum[tracker_smaller(k - 1, TRACKER_SEARCH_SUMS - 1)] + 1;
}

/* Sum of the squared distances of the stars from their mean, divided by their number, 2^-52. */
static int64_t extent(const struct tracker_search *search)
{
    int64_t sum = 0;
    int i, axis;

    for (axis = 0; axis < 3; axis++) {
        int64_t mean = 0;
        for (i = 0; i < search->count; i++)
            mean += component(&search->direction[i], axis);
        mean = tracker_floor_quotient(mean, search->count);
        for (i = 0; i < search->count; i++) {
            const int64_t off = tracker_shift_right(component(&search->direction[i], axis) - mean, EXTENT_SHIFT);
            sum += off * off;
        }
    }
    return sum / search->count;
}

/* Adds 1/(1 + x)^2 of a pair of stars to the sums of both, for each width. */
static void add_crowding(struct tracker_search *search, int i, int j, int64_t log_extent)
{
    int64_t square = 0, x;
    int axis, width;

    for (axis = 0; axis < 3; axis++) {
        const int64_t off = component(&search->direction[i], axis) - component(&search->direction[j], axis);
        square += off * off;
    }
    x = tracker_log_down(tracker_larger(square, 1)) - log_extent - LOG_UP;
    for (width = 0; width < CROWD_WIDTHS; width++) {
        const int64_t entry =
            tracker_shift_right(x + (2 * width - TRACKER_SEARCH_CROWD_FROM) * ONE, TRACKER_SEARCH_CROWD_STEP_BITS);
        const int64_t value = entry < 0 ? (int64_t)1 << CROWD_BITS
                                        : tracker_search_crowd[tracker_smaller(entry, TRACKER_SEARCH_CROWD_ENTRIES - 1)];
        search->work.sum[width][i] += value;
        search->work.sum[width][j] += value;
    }
}

void tracker_crowding(struct tracker_search *search)
{
    const int n = search->count;
    int64_t extent2, log_extent, scale;
    int i, j, width;

    for (width = 0; width <= CROWD_WIDTHS; width++)
        for (i = 0; i < n; i++) {
            search->excess[width][i] = 0;
            if (width < CROWD_WIDTHS)
                search->work.sum[width][i] = 0;
        }
    if (n < 2)
        return;
    extent2 = extent(search);
    if (extent2 < 1)
        return;
    log_extent = tracker_log_down(extent2) + 2 * EXTENT_SHIFT * ONE;
    for (i = 0; i < n; i++)
        for (j = 0; j < i; j++)
            add_crowding(search, i, j, log_extent);
    scale = TRACKER_SEARCH_SPREAD_SHARE + TRACKER_SEARCH_LOG_AREA_UP - CROWD_BITS * ONE - tracker_log_down(n - 1) - log_extent;
    for (i = 0; i < n; i++) {
        int64_t total = 0, value;
        for (width = 0; width < CROWD_WIDTHS; width++) {
            const int64_t sum = search->work.sum[width][i];
            total += sum * ((int64_t)1 << (2 * width));
            value = tracker_log_down(sum) + LOG_UP + (int64_t)2 * width * ONE + scale;
            search->excess[width][i] = (int32_t)tracker_log_sum_up(value, TRACKER_SEARCH_EVEN_SHARE);
        }
        value = tracker_log_down(total) + LOG_UP - 3 * ONE + scale;
        search->excess[CROWD_WIDTHS][i] = (int32_t)tracker_log_sum_up(value, TRACKER_SEARCH_EVEN_SHARE);
    }
}

static int64_t density(int scatter, int64_t difference)
{
    const int64_t entry = tracker_magnitude(difference);

    return entry < TRACKER_SEARCH_DENSITY_ENTRIES ? tracker_search_density[scatter][entry] : 0;
}

/* Zero point: the median of observed minus catalogued magnitudes of the matched stars. */
static int64_t zero_point(struct tracker_field *field, const struct tracker_search *search)
{
    int64_t *ordered = field->gain;
    int k, at;

    for (k = 0; k < field->matched; k++) {
        const int star = field->star[k];
        const int64_t off =
            (int64_t)search->magnitude[star] - tracker_guide_magnitude[field->guide[field->rank[star]]];
        for (at = k; at > 0 && ordered[at - 1] > off; at--)
            ordered[at] = ordered[at - 1];
        ordered[at] = off;
    }
    return tracker_shift_right(ordered[(field->matched - 1) / 2] + ordered[field->matched / 2], 1);
}

/* log2 of how much better each magnitude fits its guide star than any of the field. */
static void compare_magnitudes(struct tracker_search *search)
{
    struct tracker_field *field = &search->field;
    const int stride = field->depth / SAMPLE > 1 ? field->depth / SAMPLE : 1;
    int64_t zero;
    int k, scatter, at;

    for (scatter = 0; scatter < SCATTERS; scatter++)
        for (k = 0; k < field->matched; k++)
            field->ratio[scatter][k] = 0;
    if (!search->brightness || field->matched < 3)
        return;
    zero = zero_point(field, search);
    for (scatter = 0; scatter < SCATTERS; scatter++) {
        int64_t most = 0;
        for (k = 0; k < field->matched; k++) {
            const int star = field->star[k];
            const int64_t own = search->magnitude[star] - zero;
            int64_t anyhow = 0, likely, samples = 0;
            for (at = 0; at < field->depth; at += stride) {
                anyhow += density(scatter, own - tracker_guide_magnitude[field->guide[at]]) + 1;
                samples++;
            }
            anyhow = anyhow / samples + 1 + TRACKER_SEARCH_DENSITY_FLOOR + 1;
            likely = density(scatter, own - tracker_guide_magnitude[field->guide[field->rank[star]]]);
            likely = tracker_log_down(likely + TRACKER_SEARCH_DENSITY_FLOOR) - tracker_log_down(anyhow) - LOG_UP;
            field->ratio[scatter][k] = (int32_t)likely;
            most = tracker_larger(most, likely);
        }
        field->ratio[scatter][0] -= (int32_t)most;
    }
}

/* log2 of the likelihood ratio with errors of a width, averaged over depths and missing stars; scatter -1: without
 * magnitudes. */
static int64_t assignments(struct tracker_search *search, int width, int scatter)
{
    struct tracker_field *field = &search->field;
    const int n = search->count, up = 1 << (LOG_BITS - TRACKER_SEARCH_COUNT_BITS);
    int64_t out = TRACKER_SEARCH_NEVER;
    int k, m, at, depth;

    for (k = 0; k < field->matched; k++) {
        const int star = field->star[k];
        int64_t gain = field->base[k] - tracker_search_log_scale2[width]
                       - ((field->square[star] * tracker_search_quadratic[width]) >> 16) - 1;
        if (scatter >= 0)
            gain += field->ratio[scatter][k];
        for (at = k; at > 0 && field->gain[at - 1] < gain; at--) {
            field->gain[at] = field->gain[at - 1];
            field->ordered_rank[at] = field->ordered_rank[at - 1];
        }
        field->gain[at] = gain;
        field->ordered_rank[at] = field->rank[star];
    }
    for (depth = 1; depth <= field->depth; depth++) {
        int64_t value = ((int64_t)tracker_search_distracting[n] + tracker_search_seeing[0][depth]) * up, total = 0;
        for (k = m = 0; k < field->matched; k++)
            if (field->ordered_rank[k] < depth) {
                m++;
                total += field->gain[k];
                value = tracker_larger(value, total + ((int64_t)tracker_search_distracting[n - m]
                                               + tracker_search_seeing[m][depth - m]) * up);
            }
        out = tracker_log_sum(out, value);
    }
    return out - (int64_t)tracker_search_total[n][field->depth] * up;
}

/* By how much the crowding of the matched stars lowers the evidence. */
static int64_t crowding_price(const struct tracker_search *search)
{
    int64_t price = 0;
    int width, k;

    for (width = 0; width <= CROWD_WIDTHS; width++) {
        int64_t sum = 0;
        for (k = 0; k < search->field.matched; k++)
            sum += search->excess[width][search->field.star[k]];
        price = tracker_larger(price, sum);
    }
    return price;
}

int64_t tracker_weigh(struct tracker_search *search, int64_t log_normal, int *width)
{
    struct tracker_field *field = &search->field;
    const int64_t half = tracker_shift_right(log_normal + (int64_t)180 * ONE + 1, 1);
    int64_t highest = TRACKER_SEARCH_NEVER, everything = TRACKER_SEARCH_NEVER;
    int s, scatter, k;

    for (k = s = 0; s < search->count; s++)
        if (field->rank[s] >= 0)
            field->star[k++] = (int16_t)s;
    for (k = 0; k < field->matched; k++)
        field->base[k] = TRACKER_SEARCH_LOG_AREA - LOG_TWO_PI - tracker_log_down(search->variance[field->star[k]]) - LOG_UP;
    compare_magnitudes(search);
    *width = 0;
    for (s = 0; s < TRACKER_SEARCH_WIDTHS; s++) {
        const int64_t value = tracker_search_log_volume[s] - half + assignments(search, s, -1);
        if (s == 0 || value > highest) {
            highest = value;
            *width = s;
        }
    }
    for (s = *width > 0 ? *width - 1 : 0; s < *width + 2 && s < TRACKER_SEARCH_WIDTHS; s++)
        for (scatter = 0; scatter < SCATTERS; scatter++)
            everything =
                tracker_log_sum(everything, assignments(search, s, scatter) + tracker_search_log_volume[s] - half);
    return everything - ONE - crowding_price(search);
}
