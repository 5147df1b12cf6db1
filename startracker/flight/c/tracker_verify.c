/* Verification of an attitude against all observed stars and guide stars of the field, on the sphere.
 *
 * The steps are those of startracker/identification/verification.py: match within a gate, refit until the match no longer
 * changes, compute the evidence, narrow the gate. The refit is the Gauss-Newton step of
 * startracker/estimation/directions.py with weights from the stated variances. */
#include "tracker_integers.h"
#include "tracker_search.h"

#define ONE ((int64_t)1 << 30)
#define LOG_BITS 12
#define LOG_UP 24
#define WEIGHT_BITS 12
#define SQUARE_BITS 8
#define ROUNDS 5 /* of a gate */
#define MOST_EXTRA 10
#define FARTHEST2 ((int64_t)1 << 54)    /* squared chord of 7 degrees */
#define LARGEST_TURN ((int64_t)1 << 27) /* of 2.30: the same */
#define DIVISOR_SHIFT 16
#define LEAST_DIVISOR 4096
#define VERIFY_STEPS 500

/* Components of a vector along three axes, each rounded down. */
static void along(const int64_t axes[3][3], const int64_t v[3], int64_t out[3])
{
    int k;

    for (k = 0; k < 3; k++)
        out[k] = tracker_dot(axes[k], v);
}

/* Whether a direction in the axes of the outline is on the image. */
static int inside(const int64_t seen[3])
{
    const int64_t x = seen[0], y = seen[1];
    int64_t total, part, share, low, rest;

    if (seen[2] < TRACKER_SEARCH_LEAST_COSINE)
        return 0;
    total = tracker_magnitude(x) + tracker_magnitude(y);
    part = (x >= 0) == (y >= 0) ? tracker_magnitude(y) : tracker_magnitude(x);
    share = part * (TRACKER_SEARCH_QUADRANT * 256) / (total > 1 ? total : 1);
    share += (y >= 0 ? (x >= 0 ? 0 : 1) : (x < 0 ? 2 : 3)) * (TRACKER_SEARCH_QUADRANT * 256);
    low = share >> 8;
    rest = share & 255;
    if (low == 4 * TRACKER_SEARCH_QUADRANT) {
        low--;
        rest = 256;
    }
    part = (int64_t)tracker_search_outline[low + 1] - tracker_search_outline[low];
    return seen[2] >= tracker_search_outline[low] + tracker_shift_right(part * rest, 8);
}

/* Inserts a guide star into the field, ascending; at most `most`. */
static void insert(struct tracker_field *field, int guide, int most)
{
    int at;

    if (field->depth == most) {
        if (field->guide[most - 1] < guide)
            return;
        field->depth--;
    }
    for (at = field->depth; at > 0 && field->guide[at - 1] > guide; at--)
        field->guide[at] = field->guide[at - 1];
    field->guide[at] = (uint16_t)guide;
    field->depth++;
}

/* The brightest `most` guide stars on the image at an attitude, in their apparent directions. */
static void find_field(struct tracker_search *search, const struct tracker_matrix *matrix, int most)
{
    struct tracker_field *field = &search->field;
    int64_t axes[3][3], rows[3][3], guide[3], seen[3];
    int i, j, k, x, y, entry;

    for (k = 0; k < 3; k++)
        tracker_to_array(&matrix->row[k], rows[k]);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            int64_t sum = 0;
            for (k = 0; k < 3; k++)
                sum += tracker_search_outline_axes[i][k] * rows[k][j];
            axes[i][j] = tracker_shift_right(sum, 30);
        }
    field->depth = 0;
    for (x = tracker_column_of(axes[2][0] - TRACKER_SEARCH_FIELD_CHORD); x <= tracker_column_of(axes[2][0] + TRACKER_SEARCH_FIELD_CHORD); x++)
        for (y = tracker_column_of(axes[2][1] - TRACKER_SEARCH_FIELD_CHORD);
             y <= tracker_column_of(axes[2][1] + TRACKER_SEARCH_FIELD_CHORD); y++) {
            const int column = x * TRACKER_SEARCH_COLUMNS + y;
            for (entry = tracker_search_column_start[column]; entry < tracker_search_column_start[column + 1]; entry++) {
                const int star = tracker_search_column_star[entry];
                for (k = 0; k < 3; k++)
                    guide[k] = tracker_guide_direction[star][k];
                along((const int64_t(*)[3])axes, guide, seen);
                if (inside(seen))
                    insert(field, star, most);
            }
        }
    for (k = 0; k < field->depth; k++) {
        const int star = field->guide[k];
        tracker_apparent(tracker_guide_direction[star], tracker_guide_motion[star], &search->observer, &field->direction[k]);
    }
}

static void predict(struct tracker_field *field, const struct tracker_matrix *matrix)
{
    int64_t rows[3][3], direction[3], seen[3];
    int k;

    for (k = 0; k < 3; k++)
        tracker_to_array(&matrix->row[k], rows[k]);
    for (k = 0; k < field->depth; k++) {
        tracker_to_array(&field->direction[k], direction);
        along((const int64_t(*)[3])rows, direction, seen);
        tracker_to_vector(seen, &field->predicted[k]);
    }
}

/* Nearest prediction of each star within the gate, one to one. */
static void match(struct tracker_search *search, int64_t gate)
{
    struct tracker_field *field = &search->field;
    int i, k;

    for (k = 0; k < field->depth; k++)
        field->owner[k] = -1;
    field->matched = 0;
    for (i = 0; i < search->count; i++) {
        const struct tracker_vector *star = &search->direction[i];
        int64_t best = INT64_MAX, square;
        int at = 0, rival;
        for (k = 0; k < field->depth; k++) {
            const int64_t x = (int64_t)star->x - field->predicted[k].x, y = (int64_t)star->y - field->predicted[k].y;
            const int64_t z = (int64_t)star->z - field->predicted[k].z, apart = x * x + y * y + z * z;
            if (apart < best) {
                best = apart;
                at = k;
            }
        }
        field->rank[i] = -1;
        if (best >= FARTHEST2)
            continue;
        square = (best << SQUARE_BITS) / search->variance[i];
        if (square > gate)
            continue;
        rival = field->owner[at];
        if (rival >= 0) {
            if (field->square[rival] <= square)
                continue;
            field->rank[rival] = -1;
            field->matched--;
        }
        field->owner[at] = (int16_t)i;
        field->rank[i] = (int16_t)at;
        field->square[i] = square;
        field->matched++;
    }
}

/* Normal matrix of small rotations: cofactors and determinant of its leading 30 bits, both shifted by 30. */
struct normal {
    int64_t cofactor[3][3], determinant, gradient[3], least;
    int shift;
};

static void add_star(const struct tracker_search *search, int star, struct normal *normal, int64_t a[9])
{
    const int64_t weight = normal->least * ((int64_t)1 << WEIGHT_BITS) / search->variance[star] + 1;
    int64_t p[3], e[3], turning[3];
    int i, j;

    tracker_to_array(&search->field.predicted[search->field.rank[star]], p);
    tracker_to_array(&search->direction[star], e);
    for (i = 0; i < 3; i++)
        e[i] -= p[i];
    tracker_cross(p, e, turning);
    for (i = 0; i < 3; i++) {
        normal->gradient[i] += weight * turning[i];
        for (j = 0; j < 3; j++)
            a[3 * i + j] += weight * ((i == j ? ONE : 0) - tracker_shift_right(p[i] * p[j], 30));
    }
}

static void make_normal(const struct tracker_search *search, struct normal *normal)
{
    int64_t a[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    int i, j, star;

    normal->least = INT64_MAX;
    for (star = 0; star < search->count; star++)
        if (search->field.rank[star] >= 0 && search->variance[star] < normal->least)
            normal->least = search->variance[star];
    for (i = 0; i < 3; i++)
        normal->gradient[i] = 0;
    for (star = 0; star < search->count; star++)
        if (search->field.rank[star] >= 0)
            add_star(search, star, normal, a);
    normal->shift = tracker_thirty_bits(a, 9);
    normal->determinant = 0;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            const int p1 = (i + 1) % 3 * 3, p2 = (i + 2) % 3 * 3, q1 = (j + 1) % 3, q2 = (j + 2) % 3;
            normal->cofactor[i][j] = tracker_shift_right(a[p1 + q1] * a[p2 + q2] - a[p1 + q2] * a[p2 + q1], 30);
        }
    for (i = 0; i < 3; i++)
        normal->determinant += a[i] * normal->cofactor[0][i];
}

static int64_t log_determinant(const struct normal *normal)
{
    const int64_t scale = 30 + 3 * ((int64_t)normal->shift - 30 - WEIGHT_BITS);

    return tracker_log_down(normal->determinant) + LOG_UP + 2 + scale * ((int64_t)1 << LOG_BITS)
           - 3 * tracker_log_down(normal->least);
}

static int bits_of(int64_t value)
{
    int bits = 0;

    for (value = tracker_magnitude(value); value > 0; value >>= 1)
        bits++;
    return bits;
}

/* Gauss-Newton step; 0: not determined, or too large. */
static int refit(struct normal *normal, struct tracker_matrix *matrix)
{
    const int64_t divisor = tracker_shift_right(normal->determinant, DIVISOR_SHIFT);
    int64_t step[3];
    int i, down, power;

    if (divisor < LEAST_DIVISOR)
        return 0;
    down = tracker_thirty_bits(normal->gradient, 3);
    power = 30 - normal->shift + down - DIVISOR_SHIFT;
    for (i = 0; i < 3; i++) {
        const int64_t *c = normal->cofactor[i], *right = normal->gradient;
        const int64_t value = (c[0] * right[0] + c[1] * right[1] + c[2] * right[2]) / divisor;
        if (bits_of(value) + power > 40)
            return 0;
        step[i] = power >= 0 ? value * ((int64_t)1 << power) : tracker_shift_right(value, -power);
    }
    if (tracker_largest(step, 3) > LARGEST_TURN)
        return 0;
    return tracker_turn(matrix, -step[0], -step[1], -step[2]);
}

static int same(const int16_t *one, const int16_t *other, int count)
{
    int i;

    for (i = 0; i < count; i++)
        if (one[i] != other[i])
            return 0;
    return 1;
}

/* Matches and refits until the match no longer changes; 0: fewer than three stars match, or the fit fails. */
static int settle(struct tracker_search *search, struct tracker_matrix *matrix, const int32_t gate[2])
{
    struct tracker_field *field = &search->field;
    struct normal normal;
    int round, i;

    for (i = 0; i < search->count; i++)
        field->last[i] = -2;
    for (round = 0; round < ROUNDS; round++) {
        predict(field, matrix);
        match(search, gate[round > 0]);
        search->steps += (int64_t)search->count * field->depth;
        if (field->matched < 3)
            return 0;
        if (same(field->rank, field->last, search->count) || round == ROUNDS - 1)
            return 1;
        for (i = 0; i < search->count; i++)
            field->last[i] = field->rank[i];
        make_normal(search, &normal);
        if (!refit(&normal, matrix))
            return 0;
    }
    return 0;
}

void tracker_verify(struct tracker_search *search, const struct tracker_matrix *start, int gates,
                    struct tracker_hypothesis *found)
{
    struct tracker_field *field = &search->field;
    struct tracker_matrix matrix = *start;
    struct normal normal;
    int most = 2 * search->count + MOST_EXTRA, step, i, width;

    if (most > TRACKER_SEARCH_MAX_DEPTH)
        most = TRACKER_SEARCH_MAX_DEPTH;
    found->evidence = TRACKER_SEARCH_NEVER;
    found->matched = found->width = 0;
    search->steps += VERIFY_STEPS;
    find_field(search, start, most);
    if (field->depth < 3)
        return;
    for (i = 0; i < search->count; i++)
        field->weighed[i] = -1;
    for (step = 0; step < TRACKER_SEARCH_GATES && tracker_search_gate[gates][step][0] > 0; step++) {
        int64_t evidence;
        if (!settle(search, &matrix, tracker_search_gate[gates][step]))
            return;
        if (same(field->rank, field->weighed, search->count))
            continue;
        for (i = 0; i < search->count; i++)
            field->weighed[i] = field->rank[i];
        make_normal(search, &normal);
        search->steps += (int64_t)14 * field->depth * field->matched;
        if (normal.determinant < 1)
            return;
        evidence = tracker_weigh(search, log_determinant(&normal), &width);
        if (evidence <= found->evidence)
            continue;
        found->evidence = evidence;
        found->attitude = matrix;
        found->matched = (int16_t)field->matched;
        found->width = (int16_t)width;
        for (i = 0; i < search->count; i++)
            found->guide[i] = field->rank[i] >= 0 ? (int16_t)field->guide[field->rank[i]] : (int16_t)-1;
    }
}
