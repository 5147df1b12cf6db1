/* Solves @INPUTS@ from standard input, and prints a line for each.
 *
 *     solve stars < FILE                lists: a line "x y flux variance flags" for each star, brightest first, integers
 *                                       as in struct tracker_star; an empty line ends a list. Lines before its stars:
 *                                       "velocity VX VY VZ", "epoch EPOCH", and "prior" with nine numbers of the matrix and the radius
 *     solve follow < FILE               the same lists as a sequence: each has a line "time US", microseconds, and may have a
 *                                       line "gyro X Y Z", rad/s times 2^30; answers are those of the filter, and have
 *                                       filter= (enum tracker_following_result); "bad_time" if the time cannot be used
 *     solve version                     what this program was made from
 *
 * VX VY VZ is the velocity of the observer over that of light, ICRS axes, times 2^30; EPOCH the Julian epoch times 2^16.
 *
 *     status reason stars= matched= used= evidence= chance= steps= contradicted= quaternion= covariance= numbers=
 *
 * quaternion is x,y,z,w in decimals; all other numbers are integers as in struct tracker_answer, and numbers has one for
 * each star of the list. What is only valid if solved is printed only then. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tracker.h"

#define LINE 256

static const char *const statuses[] = {"solved",   "no_stars",  "too_few_stars", "saturated",
                                       "no_match", "ambiguous", "search_limit",  "bad_image"};
static const char *const reasons[] = {"accepted",      "nothing_found", "few_found",     "no_hypothesis",
                                      "weak_evidence", "above_rate",    "rival",         "pose_failed",
                                      "steps_used_up", "rows_missing",  "frame_uniform", "saturated_share",
                                      "unexplained",   "few_disagree",  "another_field"};

/* Prints a number of 2.30 with ten decimals, which distinguish all of them. */
static void print_fraction(int32_t value)
{
    const uint64_t unit = 10000000000u, one = (uint64_t)1 << 30;
    const uint64_t size = (uint64_t)(value < 0 ? -(int64_t)value : (int64_t)value);
    const uint64_t decimals = ((size % one) * unit + one / 2) / one;

    printf("%s%lu.%05lu%05lu", value < 0 ? "-" : "", (unsigned long)(size / one + decimals / unit),
           (unsigned long)(decimals % unit / 100000), (unsigned long)(decimals % 100000));
}

/* Prints an integer of 64 bits, for which some C libraries have no format. */
static void print_wide(int64_t value)
{
    char text[21];
    int at = 20;
    uint64_t size = value < 0 ? (uint64_t)0 - (uint64_t)value : (uint64_t)value;

    text[at] = '\0';
    do {
        text[--at] = (char)('0' + (int)(size % 10));
        size /= 10;
    } while (size > 0);
    printf("%s%s", value < 0 ? "-" : "", &text[at]);
}

/* Prints an answer; filter: result of the filter, -1 without one. */
static void print_answer(const struct tracker_answer *answer, int filter)
{
    int k;

    printf("%s %s stars=%d matched=%d used=%d evidence=%ld chance=%ld steps=%ld contradicted=%d", statuses[answer->status],
           reasons[answer->reason], answer->stars, answer->matched, answer->used, (long)answer->evidence,
           (long)answer->chance, (long)answer->steps, answer->prior_contradicted);
    if (filter >= 0)
        printf(" filter=%d", filter);
    if (answer->status == TRACKER_SOLVED) {
        printf(" quaternion=");
        for (k = 0; k < 4; k++) {
            printf("%s", k ? "," : "");
            print_fraction(answer->quaternion[k]);
        }
        printf(" covariance=");
        for (k = 0; k < 9; k++) {
            printf("%s", k ? "," : "");
            print_wide(answer->covariance[k / 3][k % 3]);
        }
        printf(" numbers=");
        for (k = 0; k < answer->stars; k++)
            printf("%s%ld", k ? "," : "", (long)answer->number[k]);
    }
    printf("\n");
}

#ifndef TRACKER_CENTROIDS
/* solve frames [VX VY VZ [EPOCH]] < FILE: frames of TRACKER_WIDTH x TRACKER_HEIGHT pixels, unsigned 16 bits, the lower byte
 * first, row by row from the top, one frame after the other. */
static int solve_frames(struct tracker_context *context, const struct tracker_frame_info *info)
{
    static unsigned char bytes[2 * TRACKER_WIDTH];
    static uint16_t row[TRACKER_WIDTH];
    struct tracker_answer answer;
    int y, x;

    for (;;) {
        tracker_start(context, info);
        for (y = 0; y < TRACKER_HEIGHT; y++) {
            const size_t got = fread(bytes, 1, sizeof bytes, stdin);
            if (got == 0 && y == 0)
                return 0;
            if (got != sizeof bytes) {
                fprintf(stderr, "the last frame has fewer than %d rows of %d pixels\n", TRACKER_HEIGHT, TRACKER_WIDTH);
                return 2;
            }
            for (x = 0; x < TRACKER_WIDTH; x++)
                row[x] = (uint16_t)(bytes[2 * x] | bytes[2 * x + 1] << 8);
            tracker_row(context, row);
        }
        tracker_finish(context, &answer);
        print_answer(&answer, -1);
    }
}
#endif /* frames */

/* Reads `count` integers separated by spaces; 0: there are fewer, or more. */
static int read_numbers(const char *text, int count, long long *numbers)
{
    char *end;
    int n;

    for (n = 0; n < count; n++) {
        numbers[n] = strtoll(text, &end, 10);
        if (end == text)
            return 0;
        text = end;
    }
    return text[strspn(text, " \t\r\n")] == '\0';
}

static struct tracker_vector vector(const long long *numbers)
{
    const struct tracker_vector made = {(int32_t)numbers[0], (int32_t)numbers[1], (int32_t)numbers[2]};

    return made;
}

/* A list, and what is known of its frame. */
struct list {
    struct tracker_frame_info info;
    int32_t gyro[3];
    int has_gyro, count, open;
    struct tracker_star star[TRACKER_MAX_STARS];
};

/* Reads a line of a list; 0: it is none. */
static int read_line(const char *line, struct list *list)
{
    struct tracker_frame_info *info = &list->info;
    long long n[10];
    int k;

    if (strncmp(line, "velocity ", 9) == 0) {
        if (!read_numbers(line + 9, 3, n))
            return 0;
        info->velocity = vector(n);
    } else if (strncmp(line, "epoch ", 6) == 0) {
        if (!read_numbers(line + 6, 1, n))
            return 0;
        info->epoch = (int32_t)n[0];
    } else if (strncmp(line, "time ", 5) == 0) {
        if (!read_numbers(line + 5, 1, n))
            return 0;
        info->time_us = n[0];
    } else if (strncmp(line, "gyro ", 5) == 0) {
        if (!read_numbers(line + 5, 3, n))
            return 0;
        for (k = 0; k < 3; k++)
            list->gyro[k] = (int32_t)n[k];
        list->has_gyro = 1;
    } else if (strncmp(line, "prior ", 6) == 0) {
        if (!read_numbers(line + 6, 10, n))
            return 0;
        for (k = 0; k < 3; k++)
            info->prior.attitude.row[k] = vector(&n[3 * k]);
        info->prior.radius = (uint32_t)n[9];
    } else {
        if (!read_numbers(line, 5, n))
            return 0;
        if (list->count < TRACKER_MAX_STARS) {
            struct tracker_star *read = &list->star[list->count++];
            read->x = (int32_t)n[0];
            read->y = (int32_t)n[1];
            read->flux = (int32_t)n[2];
            read->variance = (uint32_t)n[3];
            read->flags = (uint16_t)n[4];
        }
    }
    return 1;
}

/* Solves a list, as the next frame of a sequence if there is a filter. */
static void solve_list(struct tracker_context *context, struct list *list, struct tracker_following *following)
{
    const int32_t *gyro = list->has_gyro ? list->gyro : NULL;
    struct tracker_answer answer;

    if (following && tracker_following_predict(following, list->info.time_us, gyro, &list->info.prior) == TRACKER_TIME_BAD) {
        printf("bad_time not_after_the_last filter=%d\n", (int)TRACKER_FOLLOWING_COASTING);
        return;
    }
    tracker_start(context, &list->info);
    tracker_solve_stars(context, list->star, list->count, &answer);
    print_answer(&answer, following ? (int)tracker_following_take(following, &answer) : -1);
}

static int solve_lists(struct tracker_context *context, struct tracker_following *following)
{
    static const struct tracker_frame_info nothing;
    static struct list list;
    static char line[LINE];
    int more = 1;

    while (more) {
        more = fgets(line, LINE, stdin) != NULL;
        if (more && line[strspn(line, " \t\r\n")] != '\0') {
            list.open = 1;
            if (!read_line(line, &list)) {
                fprintf(stderr, "no star: %s", line);
                return 2;
            }
        } else if (more || list.open) {
            solve_list(context, &list, following);
            list.info = nothing;
            list.count = list.open = list.has_gyro = 0;
        }
    }
    return 0;
}

int main(int argc, char **argv)
{
    static struct tracker_context context;
    static struct tracker_following following;
#ifndef TRACKER_CENTROIDS
    struct tracker_frame_info info = {{0, 0, 0}, {{{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}}, 0}, 0, 0};
    long long known[4] = {0, 0, 0, 0};
    int k;
#endif /* frames */

    if (argc == 2 && strcmp(argv[1], "version") == 0) {
        printf("%s\n", tracker_version);
        return 0;
    }
    if (argc == 2 && strcmp(argv[1], "stars") == 0)
        return solve_lists(&context, NULL);
    if (argc == 2 && strcmp(argv[1], "follow") == 0) {
        tracker_following_start(&following);
        return solve_lists(&context, &following);
    }
#ifndef TRACKER_CENTROIDS
    if ((argc == 2 || argc == 5 || argc == 6) && strcmp(argv[1], "frames") == 0) {
        for (k = 0; k < argc - 2; k++)
            known[k] = strtoll(argv[2 + k], NULL, 10);
        info.velocity = vector(known);
        info.epoch = (int32_t)known[3];
        return solve_frames(&context, &info);
    }
#endif /* frames */
    fprintf(stderr, "solve @MODES@, with the @INPUTS@ on standard input\n");
    return 2;
}
