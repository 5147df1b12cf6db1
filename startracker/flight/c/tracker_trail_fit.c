/* Fit of a trail, an even line blurred by the star image, to the pixels that are kept. */
#include "tracker_front_internal.h"

#define STEPS 9
#define BESIDE (7 << 15)       /* pixels of a fit, from the line and beyond its ends, 16 fraction bits */
#define BEYOND (4 << 16)
#define SHORTEST (3 << 16)
#define LONG (5 << 16)         /* least length of a component that is fitted */
#define LONGEST (60 << 16)
#define STEP (1 << 16)         /* longest steps of the middle, the length (px) and the direction (rad) */
#define STRETCH (4 << 16)
#define TURN 6554
#define AWAY (8 << 16)
#define COVERED 2              /* part of the pixels near a line, as its inverse, that must be known */
#define LEAST_ABOVE 2          /* rows that must be known above a trail: one whose beginning is lost has another middle */
#define FEWEST_PIXELS 20
#define BRIGHT 100             /* fluxes over noises from which a trail has its own length and direction */
#define STRENGTH 64            /* least square of the signal-to-noise ratio; of known length and direction */
#define STRENGTH_KNOWN 36
#define PLACES 8               /* on either side of a piece where the middle of its trail may be */
#define CLIP (1 << 14)         /* largest light of a pixel there, DN of 4 fraction bits */
#define WORST (3 << 8)         /* chi squared a degree of freedom of a trail without light, 8 fraction bits */
#define LEAST_PEAK 2
#define MOST_PEAK (1 << 20)
#define UNUSED 32768
#define ROWS TRACKER_FRONT_TRAIL_ROWS
#define PARTS 5                /* peak, along, across, length / 2 sigma, turn / 8 */

/* What a pixel is in the image of a line of peak 1, and the slopes of that, 15 fraction bits. */
typedef int64_t parts[PARTS];

struct sums {
    parts normal, score;
    int64_t chi2;
    int64_t light;             /* in a line of peak 1 */
    int64_t square;
    int32_t used;
};

/* A line: middle and length (pixels of 16 fraction bits), unit vector (15). */
struct tracker_front_line_image {
    int64_t x, y, length, cos, sin;
};

/* Where a line is in the pixels that are kept. */
struct walk {
    const struct tracker_front_tracing *tracing;
    struct tracker_front_line_image line;
    int64_t inverse;           /* 1 / sigma, 12 fraction bits */
    int64_t square, photon, flat; /* of the noise */
    int64_t peak;
};

static int64_t in_sigmas(const struct walk *walk, int64_t away)
{
    return tracker_shift_right(away * walk->inverse, 12);
}

/* Integral and density of the star image at a distance. */
static int64_t integral_at(const struct walk *walk, int64_t away)
{
    int64_t value = tracker_front_entry(tracker_front_profile, in_sigmas(walk, tracker_magnitude(away)));

    return away < 0 ? -value : away > 0 ? value : 0;
}

static int64_t density_at(const struct walk *walk, int64_t away)
{
    return tracker_front_entry(tracker_front_density, in_sigmas(walk, tracker_magnitude(away)));
}

static void make_parts(const struct walk *walk, int64_t u, int64_t v, parts out)
{
    int64_t ahead = u + (walk->line.length >> 1), behind = u - (walk->line.length >> 1);
    int64_t across = density_at(walk, v), rise = density_at(walk, ahead), fall = density_at(walk, behind);

    out[0] = tracker_shift_right((integral_at(walk, ahead) - integral_at(walk, behind)) * across, 15);
    out[1] = tracker_shift_right((fall - rise) * across, 15);
    out[2] = tracker_shift_right(out[0] * in_sigmas(walk, v), 16);
    out[3] = ((rise + fall) * across) >> 15;
    out[4] = tracker_shift_right(out[2] * in_sigmas(walk, u), 19);
}

static int64_t weight_of(const struct walk *walk, int64_t light)
{
    int64_t uneven = tracker_limited((light * TRACKER_FRONT_FLAT) >> 16, 0, 1 << 16);
    int64_t ratio = 4096 + ((light * walk->photon) >> 20) + ((uneven * uneven * walk->flat) >> 20);

    return ((int64_t)1 << 31) / tracker_limited(ratio, 1, INT32_MAX);
}

/* Adds a pixel: to the sums of a fit, or to the light in the line only. */
static void add_pixel(const struct walk *walk, int64_t u, int64_t v, int64_t data, struct sums *sums)
{
    int64_t light, weight, left;
    parts part;
    int k;

    make_parts(walk, u, v, part);
    sums->used++;
    if (walk->peak == 0) {
        sums->light += part[0] * data;
        sums->square += part[0] * part[0];
        return;
    }
    light = (walk->peak * part[0]) >> 15;
    weight = weight_of(walk, light);
    left = tracker_limited(data - light, -(1 << 16), 1 << 16);
    for (k = 0; k < PARTS; k++) {
        sums->normal[k] += weight * part[k] * part[k];
        sums->score[k] += weight * part[k] * left;
    }
    sums->chi2 += weight * left * left;
}

static uint16_t next_word(const struct tracker_front_tracing *tracing, int32_t *at)
{
    uint16_t word = tracing->word[*at];

    *at = *at + 1 < TRACKER_FRONT_TRAIL_WORDS ? *at + 1 : 0;
    return word;
}

/* Adds the pixels of a row; with `most` as their largest light. */
static void add_row(const struct walk *walk, int32_t y, int64_t most, struct sums *sums)
{
    const struct tracker_front_tracing *tracing = walk->tracing;
    const struct tracker_front_line_image *line = &walk->line;
    int64_t dy = (int64_t)y * 65536 - line->y, dx, u, v, value;
    int32_t at = tracing->begin[y % ROWS], left = tracing->words[y % ROWS], x, count;

    while (left > 0) {
        x = next_word(tracing, &at);
        count = next_word(tracing, &at);
        left -= count + 2;
        for (; count > 0; count--, x++) {
            value = next_word(tracing, &at);
            dx = (int64_t)x * 65536 - line->x;
            u = tracker_shift_right(dx * line->cos + dy * line->sin, 15);
            v = tracker_shift_right(dy * line->cos - dx * line->sin, 15);
            if (value == UNUSED || tracker_magnitude(v) > BESIDE || tracker_magnitude(u) > (line->length >> 1) + BEYOND)
                continue;
            value = (value > UNUSED ? value - 65536 : value) * 4;
            add_pixel(walk, u, v, tracker_limited(value, -most, most), sums);
        }
    }
}

static void sum_pixels(const struct walk *walk, int64_t most, struct sums *sums)
{
    const struct tracker_front_tracing *tracing = walk->tracing;
    int64_t far = (((walk->line.length >> 1) + BEYOND) * tracker_magnitude(walk->line.sin) >> 15) + BEYOND;
    int32_t y;
    int k;

    for (k = 0; k < PARTS; k++)
        sums->normal[k] = sums->score[k] = 0;
    sums->chi2 = sums->light = sums->square = 0;
    sums->used = 0;
    for (y = tracing->oldest; y < tracing->oldest + tracing->rows; y++)
        if (tracker_magnitude((int64_t)y * 65536 - walk->line.y) <= far)
            add_row(walk, y, most, sums);
}

static void start_walk(const struct tracker_front *front, const struct tracker_front_line_image *line, struct walk *walk)
{
    walk->tracing = &front->pool.beside.tracing;
    walk->line = *line;
    walk->inverse = ((int64_t)1 << 24) / tracker_square_root((int64_t)TRACKER_FRONT_IMAGE << 16);
    walk->peak = 0;
}

/* Moves a line along itself to where its light is strongest, of those that cover its middle. */
static void start_along(const struct tracker_front *front, struct tracker_front_line_image *line)
{
    const struct tracker_front_line_image start = *line;
    struct walk walk;
    struct sums sums;
    int64_t best = 0, away;
    int step;

    start_walk(front, line, &walk);
    for (step = -PLACES; step <= PLACES; step++) {
        away = tracker_floor_quotient(start.length * step, 2 * PLACES + 1);
        walk.line.x = start.x + tracker_shift_right(away * start.cos, 15);
        walk.line.y = start.y + tracker_shift_right(away * start.sin, 15);
        sum_pixels(&walk, CLIP, &sums);
        if (sums.light > best) {
            best = sums.light;
            *line = walk.line;
        }
    }
}

/* 2^31 score / (normal peak), rounded down, within 2^40. */
static int64_t step_of(int64_t score, int64_t normal, int64_t peak)
{
    const int64_t most = (int64_t)1 << 31;
    int k;

    for (k = 0; k < 33 && (tracker_magnitude(score) >= most || normal >= most); k++) {
        score = tracker_shift_right(score, 1);
        normal >>= 1;
    }
    score = tracker_floor_quotient(tracker_floor_quotient(score * most, normal > 1 ? normal : 1), peak);
    return tracker_limited(score, -((int64_t)1 << 40), (int64_t)1 << 40);
}

static void move(struct walk *walk, const struct sums *sums, int free)
{
    struct tracker_front_line_image *line = &walk->line;
    int64_t more = tracker_shift_right(step_of(sums->score[0], sums->normal[0], 1), 16);
    int64_t step[PARTS], along, across, cos, sin, size;
    int k;

    for (k = 1; k < PARTS; k++)
        step[k] = step_of(sums->score[k], sums->normal[k], walk->peak);
    along = tracker_limited(tracker_floor_quotient(step[1] * 4096, walk->inverse), -STEP, STEP);
    across = tracker_limited(tracker_floor_quotient(step[2] * 4096, walk->inverse), -STEP, STEP);
    line->x += tracker_shift_right(along * line->cos - across * line->sin, 15);
    line->y += tracker_shift_right(along * line->sin + across * line->cos, 15);
    if (free)
        line->length += tracker_limited(tracker_floor_quotient(step[3] * 8192, walk->inverse), -STRETCH, STRETCH);
    step[4] = free ? tracker_limited(tracker_shift_right(step[4], 3), -TURN, TURN) : 0;
    cos = line->cos - tracker_shift_right(line->sin * step[4], 16);
    sin = line->sin + tracker_shift_right(line->cos * step[4], 16);
    size = tracker_square_root(cos * cos + sin * sin);
    line->cos = tracker_floor_quotient(cos * 32768, size);
    line->sin = tracker_floor_quotient(sin * 32768, size);
    line->length = tracker_limited(line->length, SHORTEST, LONGEST);
    more = tracker_limited(more, -(walk->peak / 2), walk->peak);
    walk->peak = tracker_limited(walk->peak + more, LEAST_PEAK, MOST_PEAK);
}

/* ------------------------------------------------------------------ result */

/* square 2^35 / normal, at most 2^32. */
static int64_t variance_of(int64_t square, int64_t normal)
{
    int bits = 35;

    while (square < (int64_t)1 << 61 && bits > 0) {
        square *= 2;
        bits--;
    }
    square /= normal;
    return square > (int64_t)UINT32_MAX >> bits ? UINT32_MAX : square * ((int64_t)1 << bits);
}

/* Whether both ends are on the searched part of the frame. */
static int is_inside(const struct tracker_front_line_image *line, int64_t half_x, int64_t half_y)
{
    const int64_t reach = TRACKER_FRONT_REACH * 65536;

    return line->x - half_x >= reach && line->y - half_y >= reach
           && line->x + half_x <= (int64_t)(TRACKER_WIDTH - 1) * 65536 - reach
           && line->y + half_y <= (int64_t)(TRACKER_HEIGHT - 1) * 65536 - reach;
}

static int make_trail(const struct walk *walk, const struct sums *sums, int32_t noise, int free,
                      struct tracker_front_trail *trail)
{
    const struct tracker_front_line_image *line = &walk->line;
    int64_t dark = tracker_limited(((int64_t)noise << 12) / walk->peak, 1, 1 << 20), square = dark * dark, variance;
    int64_t strength = sums->normal[0] / (square << 17), freedom = sums->used - 5, excess, half_x, half_y;
    int64_t chi2 = sums->chi2 / (8 * walk->square), allowed = WORST + (WORST * tracker_limited(strength, 0, 1 << 30) >> 12);

    if (strength < (free ? STRENGTH : STRENGTH_KNOWN) || chi2 > allowed * freedom)
        return 0;
    variance = (variance_of(square * TRACKER_FRONT_IMAGE, sums->normal[1])
                + variance_of(square * TRACKER_FRONT_IMAGE, sums->normal[2]))
               >> 1;
    excess = chi2 - freedom * 256;
    if (excess > tracker_square_root(32 * freedom << 16))
        variance = variance * tracker_limited(chi2 >> 4, 0, 1 << 24) / (16 * freedom);
    half_x = tracker_shift_right(line->length * line->cos, 16);
    half_y = tracker_shift_right(line->length * line->sin, 16);
    if (walk->tracing->oldest > 0
        && line->y - tracker_magnitude(half_y) < (int64_t)(walk->tracing->oldest + LEAST_ABOVE) * 65536)
        return 0;
    if (!is_inside(line, tracker_magnitude(half_x), tracker_magnitude(half_y)))
        return 0;
    half_x = tracker_shift_right(half_x, 7);
    half_y = tracker_shift_right(half_y, 7);
    if (half_x < 0 || (half_x == 0 && half_y < 0)) {
        half_x = -half_x;
        half_y = -half_y;
    }
    trail->flux = (int32_t)(((walk->peak * line->length >> 16) * 4096) / walk->inverse);
    trail->x = (int32_t)line->x;
    trail->y = (int32_t)line->y;
    trail->variance = (uint32_t)tracker_limited(variance, 0, UINT32_MAX);
    trail->along_x = trail->own_x = (int16_t)half_x;
    trail->along_y = trail->own_y = (int16_t)half_y;
    return 1;
}

/* 0: it is none. */
static int fit_trail(const struct tracker_front *front, const struct tracker_front_line_image *start, int32_t noise,
                     int free, struct tracker_front_trail *trail)
{
    struct walk walk;
    struct sums sums;
    int64_t area;
    int step, k;

    start_walk(front, start, &walk);
    walk.square = (int64_t)noise * noise;
    walk.photon = tracker_limited(TRACKER_FRONT_GAIN / walk.square, 0, (int64_t)1 << 34);
    walk.flat = ((int64_t)1 << 40) / walk.square;
    sum_pixels(&walk, INT32_MAX, &sums);
    sums.square >>= 15;
    walk.peak = tracker_limited(tracker_floor_quotient(sums.light, sums.square > 1 ? sums.square : 1), LEAST_PEAK, MOST_PEAK);
    for (step = 0; step <= STEPS; step++) {
        sum_pixels(&walk, INT32_MAX, &sums);
        for (k = 0; k < PARTS; k++)
            if (sums.normal[k] <= 0)
                return 0;
        if (sums.used < FEWEST_PIXELS)
            return 0;
        if (step < STEPS)
            move(&walk, &sums, free);
    }
    area = ((walk.line.length + 2 * BEYOND) * 2 * BESIDE) >> 32;
    if (tracker_magnitude(walk.line.x - start->x) > AWAY || tracker_magnitude(walk.line.y - start->y) > AWAY
        || COVERED * sums.used < area)
        return 0;
    return make_trail(&walk, &sums, noise, free, trail);
}

/* ------------------------------------------------------------------ components */

/* Line with the moments of a component's area; 0: it is not long. */
static int line_of(const struct tracker_front_piece *piece, struct tracker_front_line_image *line)
{
    int64_t n = piece->pixels, cx = piece->x / n, cy = piece->y / n, size;
    int64_t mx = (piece->x - cx * n) * 256 / n, my = (piece->y - cy * n) * 256 / n;
    int32_t moments[3], axes[2];

    moments[0] = (int32_t)((piece->xx - 2 * cx * piece->x + cx * cx * n) * 256 / n - ((mx * mx) >> 8));
    moments[1] = (int32_t)((piece->yy - 2 * cy * piece->y + cy * cy * n) * 256 / n - ((my * my) >> 8));
    moments[2] = (int32_t)(tracker_floor_quotient((piece->xy - cx * piece->y - cy * piece->x + cx * cy * n) * 256, n)
                           - ((mx * my) >> 8));
    tracker_front_principal(moments, axes);
    line->length = tracker_square_root((int64_t)12 * (axes[0] - axes[1]) << 24);
    if (line->length < LONG)
        return 0;
    line->cos = moments[0] >= moments[1] ? axes[0] - moments[1] : moments[2];
    line->sin = moments[0] >= moments[1] ? moments[2] : axes[0] - moments[0];
    size = tracker_square_root((line->cos * line->cos + line->sin * line->sin) << 16);
    if (size == 0)
        return 0;
    line->cos = tracker_floor_quotient(line->cos * 8388608, size);
    line->sin = tracker_floor_quotient(line->sin * 8388608, size);
    line->x = cx * 65536 + mx * 256;
    line->y = cy * 65536 + my * 256;
    return 1;
}

void tracker_front_measure_trail(struct tracker_front *front, const struct tracker_front_piece *piece)
{
    struct tracker_front_line_image line;
    struct tracker_front_trail trail, other;
    int64_t along[2], length;
    int32_t noise, x;
    int found;

    if (!line_of(piece, &line))
        return;
    x = (int32_t)(line.x >> 16);
    noise = tracker_front_between(front->work.rows.line.noise, tracker_front_cell(x), x);
    found = fit_trail(front, &line, noise, 1, &trail);
    if (front->motion.known
        && (!found || trail.flux < BRIGHT * (int64_t)noise || !tracker_front_agrees(&trail, &front->motion))) {
        tracker_front_motion_at(&front->motion, line.x, line.y, along);
        length = tracker_square_root((along[0] * along[0] + along[1] * along[1]) << 16);
        if (length >= LONG && length <= LONGEST) {
            line.length = length;
            line.cos = tracker_floor_quotient(along[0] * 8388608, length);
            line.sin = tracker_floor_quotient(along[1] * 8388608, length);
            start_along(front, &line);
            if (fit_trail(front, &line, noise, 0, &other)) {
                other.own_x = (int16_t)(found ? trail.own_x : 0);
                other.own_y = (int16_t)(found ? trail.own_y : 0);
                trail = other;
                found = 1;
            }
        }
    }
    if (found)
        tracker_front_add_trail(front, &trail);
}
