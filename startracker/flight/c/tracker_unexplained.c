/* The check of an attitude against the whole field: bright stars that stay unexplained on both sides.
 *
 * The rule is that of startracker/unexplained.py, for the list alone, as the pixels of a frame are no longer known. The
 * bright items are the stars of the list and the guide stars down to those with which most of the matched ones are
 * reached, and at least as many as there are of the rarer kind. On one side of a line across the image, or outside a circle
 * about the matched stars, fewer may be matched than elsewhere: ln of the likelihood ratio of two different matched
 * fractions against a common one is a sum of n ln n, which a table holds. Of both kinds the smaller ratio counts. */
#include "tracker_unexplained.h"

#include "tracker_directions.h"
#include "tracker_integers.h"

#define PIXEL 65536
#define KINDS 5
#define SHARE_BITS 16
#define FARTHEST ((int64_t)1 << 30)
#define ERROR_BITS 10 /* from the stated variances to those of the fit */

enum { LOST_STAR, SEEN_STAR, LOST_GUIDE, SEEN_GUIDE, BESIDE };

/* ------------------------------------------------------------------ the bright items */

/* Number of the brightest items down to a fraction of the matched ones. */
static int number_bright(const uint8_t *matched, int count)
{
    int64_t total = 0, found = 0;
    int n;

    for (n = 0; n < count; n++)
        total += matched[n];
    for (n = 0; n < count; n++) {
        found += matched[n];
        if (found * (1 << SHARE_BITS) >= TRACKER_UNEXPLAINED_BRIGHT * total)
            return n + 1;
    }
    return count;
}

int tracker_guide_position(const struct tracker_matrix *attitude, const struct tracker_vector *direction, int32_t xy[2])
{
    int32_t plane[2];

    return tracker_project(attitude, direction, plane) && tracker_image_of(plane, xy)
           && xy[0] >= TRACKER_UNEXPLAINED_BORDER && xy[0] < (TRACKER_WIDTH - 1) * PIXEL - TRACKER_UNEXPLAINED_BORDER
           && xy[1] >= TRACKER_UNEXPLAINED_BORDER && xy[1] < (TRACKER_HEIGHT - 1) * PIXEL - TRACKER_UNEXPLAINED_BORDER;
}

/* Stars and guide stars on the image, brightest first. */
static void take_items(struct tracker_bright *bright, const struct tracker_pose *pose,
                       const struct tracker_matrix *attitude, const struct tracker_star *star, int count)
{
    int n, k;

    bright->stars = bright->guides = 0;
    for (n = 0; n < count; n++) {
        if (!pose->usable[n])
            continue;
        bright->star[bright->stars][0] = star[n].x;
        bright->star[bright->stars][1] = star[n].y;
        bright->seen[bright->stars++] = pose->used[n] >= 0 ? 1 : 0;
    }
    for (k = 0; k < pose->in_field; k++) {
        if (!tracker_guide_position(attitude, &pose->direction[k], bright->guide[bright->guides]))
            continue;
        bright->matched[bright->guides] = 0;
        for (n = 0; n < count; n++)
            if (pose->used[n] == k)
                bright->matched[bright->guides] = 1;
        bright->guides++;
    }
}

/* Whether a position has another one close by. */
static int has_neighbour(const int32_t at[2], int32_t others[][2], int count)
{
    int k;

    for (k = 0; k < count; k++) {
        const int64_t x = (int64_t)at[0] - others[k][0], y = (int64_t)at[1] - others[k][1];
        if (x * x + y * y < (int64_t)TRACKER_UNEXPLAINED_BESIDE * TRACKER_UNEXPLAINED_BESIDE)
            return 1;
    }
    return 0;
}

static void add_item(struct tracker_bright *bright, int kind, const int32_t at[2])
{
    bright->kind[bright->items] = (uint8_t)kind;
    bright->position[bright->items][0] = at[0];
    bright->position[bright->items][1] = at[1];
    bright->items++;
}

/* The bright items; none if fewer than three of either side are not matched. A star and a guide star close by, but not
 * matched, are one star that is displaced: neither counts. */
static void list_bright(struct tracker_bright *bright)
{
    const int fewer = bright->stars < bright->guides ? bright->stars : bright->guides;
    int stars = number_bright(bright->seen, bright->stars), guides = number_bright(bright->matched, bright->guides);
    int n, lost_stars = 0, lost_guides = 0;

    stars = stars > fewer ? stars : fewer;
    guides = guides > fewer ? guides : fewer;
    bright->items = 0;
    for (n = 0; n < stars; n++)
        lost_stars += !bright->seen[n];
    for (n = 0; n < guides; n++)
        lost_guides += !bright->matched[n];
    if (lost_stars < TRACKER_UNEXPLAINED_FEWEST || lost_guides < TRACKER_UNEXPLAINED_FEWEST)
        return;
    for (n = 0; n < stars; n++)
        if (bright->seen[n])
            add_item(bright, SEEN_STAR, bright->star[n]);
        else if (has_neighbour(bright->star[n], bright->guide, bright->guides))
            add_item(bright, BESIDE, bright->star[n]);
        else
            add_item(bright, LOST_STAR, bright->star[n]);
    for (n = 0; n < guides; n++)
        if (bright->matched[n])
            add_item(bright, SEEN_GUIDE, bright->guide[n]);
        else if (!has_neighbour(bright->guide[n], bright->star, bright->stars))
            add_item(bright, LOST_GUIDE, bright->guide[n]);
}

/* ------------------------------------------------------------------ parts of the image */

/* Keys of the items along a line, or the negative squared distances from the middle of the matched guide stars. */
static void make_keys(struct tracker_bright *bright, int line, const int64_t middle[2])
{
    int n;

    for (n = 0; n < bright->items; n++) {
        const int64_t x = bright->position[n][0], y = bright->position[n][1];
        if (line < TRACKER_UNEXPLAINED_LINES)
            bright->key[n] = x * tracker_unexplained_line[line][0] + y * tracker_unexplained_line[line][1];
        else
            bright->key[n] = -(x - middle[0]) * (x - middle[0]) - (y - middle[1]) * (y - middle[1]);
    }
}

static void sort_by_keys(struct tracker_bright *bright)
{
    int n, at;

    for (n = 0; n < bright->items; n++) {
        for (at = n; at > 0 && bright->key[bright->order[at - 1]] > bright->key[n]; at--)
            bright->order[at] = bright->order[at - 1];
        bright->order[at] = (int16_t)n;
    }
}

/* ln of the likelihood of so many matched and lost items at their most likely fraction, 20 fraction bits. */
static int64_t log_likelihood(int matched, int lost)
{
    return (int64_t)tracker_unexplained_sum[matched] + tracker_unexplained_sum[lost] - tracker_unexplained_sum[matched + lost];
}

/* ln of the likelihood ratio of two parts of one side; `lost` is its kind that is not matched. */
static int64_t contrast_of(const int outside[KINDS], const int total[KINDS], int lost)
{
    const int seen = lost + 1;

    return log_likelihood(outside[seen], outside[lost])
           + log_likelihood(total[seen] - outside[seen], total[lost] - outside[lost])
           - log_likelihood(total[seen], total[lost]);
}

/* Whether a smaller fraction of a side is matched in a part than on the whole image. */
static int is_fewer(const int outside[KINDS], const int total[KINDS], int lost)
{
    return outside[lost + 1] * total[lost] < outside[lost] * total[lost + 1];
}

/* The part with most contradiction of those that the order of the items makes. */
static void find_part(const struct tracker_bright *bright, const int total[KINDS], struct tracker_unexplained *left)
{
    int outside[KINDS] = {0, 0, 0, 0, 0}, n;
    int64_t contrast;

    for (n = 0; n < bright->items; n++) {
        outside[bright->kind[bright->order[n]]]++;
        if (outside[LOST_STAR] < TRACKER_UNEXPLAINED_FEWEST || outside[LOST_GUIDE] < TRACKER_UNEXPLAINED_FEWEST
            || !is_fewer(outside, total, LOST_STAR) || !is_fewer(outside, total, LOST_GUIDE))
            continue;
        contrast = tracker_smaller(contrast_of(outside, total, LOST_STAR), contrast_of(outside, total, LOST_GUIDE));
        if (contrast > left->contrast) {
            left->contrast = contrast;
            left->stars = outside[LOST_STAR];
            left->guides = outside[LOST_GUIDE];
        }
    }
}

static void compare_parts(struct tracker_bright *bright, struct tracker_unexplained *left)
{
    int64_t middle[2] = {0, 0};
    int total[KINDS] = {0, 0, 0, 0, 0}, n, k;

    for (n = 0; n < bright->items; n++) {
        total[bright->kind[n]]++;
        for (k = 0; k < 2 && bright->kind[n] == SEEN_GUIDE; k++)
            middle[k] += bright->position[n][k];
    }
    left->lost_stars = total[LOST_STAR];
    left->matched_stars = total[SEEN_STAR];
    left->lost_guides = total[LOST_GUIDE];
    left->matched_guides = total[SEEN_GUIDE];
    left->beside = total[BESIDE];
    left->contrast = 0;
    left->stars = left->guides = 0;
    if (total[LOST_STAR] < TRACKER_UNEXPLAINED_FEWEST || total[LOST_GUIDE] < TRACKER_UNEXPLAINED_FEWEST
        || total[SEEN_STAR] == 0 || total[SEEN_GUIDE] == 0)
        return;
    for (k = 0; k < 2; k++)
        middle[k] /= total[SEEN_GUIDE];
    for (n = 0; n <= TRACKER_UNEXPLAINED_LINES; n++) { /* the last one is the circle */
        make_keys(bright, n, middle);
        sort_by_keys(bright);
        find_part(bright, total, left);
    }
}

void tracker_find_unexplained(struct tracker_bright *bright, const struct tracker_pose *pose,
                              const struct tracker_matrix *attitude, const struct tracker_star *star, int count,
                              struct tracker_unexplained *left)
{
    take_items(bright, pose, attitude, star, count);
    list_bright(bright);
    compare_parts(bright, left);
}

/* ------------------------------------------------------------------ the limits */

/* Whether a number is a fraction (16 fraction bits) of another one, or more. */
static int is_share(int number, int64_t share, int whole)
{
    return number * ((int64_t)1 << SHARE_BITS) >= share * whole;
}

/* Whether too few are matched on both sides, wherever they are. */
static int leaves_the_rest(const struct tracker_unexplained *left)
{
    return left->lost_stars >= TRACKER_UNEXPLAINED_FEWEST && left->lost_guides >= TRACKER_UNEXPLAINED_FEWEST
           && !is_share(left->matched_stars, TRACKER_UNEXPLAINED_LEAST_EXPLAINED, left->matched_stars + left->lost_stars)
           && !is_share(left->matched_guides, TRACKER_UNEXPLAINED_LEAST_EXPLAINED, left->matched_guides + left->lost_guides);
}

int tracker_contradicts(const struct tracker_unexplained *left)
{
    const int part = left->contrast > TRACKER_UNEXPLAINED_LARGEST_CONTRAST
                     && is_share(left->stars, TRACKER_UNEXPLAINED_LEAST_SHARE, left->matched_stars)
                     && is_share(left->guides, TRACKER_UNEXPLAINED_LEAST_SHARE, left->matched_guides);

    return part || left->beside > left->matched_stars || leaves_the_rest(left);
}

int tracker_is_doubtful(const struct tracker_unexplained *left)
{
    return left->contrast > TRACKER_UNEXPLAINED_DOUBTFUL_CONTRAST && left->stars >= TRACKER_UNEXPLAINED_FEWEST_OF_ANOTHER;
}

int tracker_few_disagree(struct tracker_pose *pose, const struct tracker_star *star)
{
    int64_t away[2], variance;
    int n, k, used = 0, off = 0;

    for (n = 0; n < pose->stars; n++) {
        if (pose->used[n] < 0)
            continue;
        used++;
        tracker_pose_residual(pose, n, away);
        for (k = 0; k < 2; k++)
            away[k] = tracker_limited(away[k], -FARTHEST, FARTHEST);
        variance = star[n].variance > 0 ? (star[n].variance * ((int64_t)1 << ERROR_BITS)) + TRACKER_UNEXPLAINED_FLOOR
                                        : TRACKER_UNEXPLAINED_UNKNOWN;
        off += (away[0] * away[0] + away[1] * away[1]) > variance / 4096 * TRACKER_UNEXPLAINED_FEW_GATE2;
    }
    return used <= TRACKER_UNEXPLAINED_FEW_STARS && off > 0;
}
