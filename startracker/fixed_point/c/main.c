/* Solves lists of centroids from standard input, a line "x y" for each star in pixels (x right, y up, from the image's
 * centre, brightest first; up to nine decimals), an empty line after each list. Prints a line for each list:
 *
 *     status reason numbers=HR,HR,... triads=N matched=M evidence=E ra=R dec=D roll=P matrix=M11,...,M33
 *
 * all integers, the last four only if solved; evidence is log2 of the Bayes factor with 12 fraction bits, ra, dec and
 * roll are degrees of 10.22, the matrix is of 2.30. With an argument each list is solved that many times, for timing.
 * Coordinates beyond 10.22 are an overflow. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tracker.h"

#define LINE 256

static const char *const statuses[] = {"solved",        "too_few_stars", "no_match",    "ambiguous",
                                       "outside_image", "overflow",      "search_limit"};
static const char *const reasons[] = {"accepted",    "fewer_than_three", "no_triads",  "no_group",
                                      "no_attitude", "few_fit",          "not_spread", "weak_evidence",
                                      "rival",       "outside_image",    "overflow",   "too_many_triads"};

/* Converts a decimal number to 10.22, truncated towards zero; 1: valid, 0: overflow, -1: not a number. */
static int parse(const char **text, int32_t *value)
{
    const char *c = *text;
    int64_t whole = 0, fraction = 0, unit = 1, fixed;
    int negative, digits = 0;

    while (*c == ' ' || *c == '\t' || *c == ',')
        c++;
    negative = *c == '-';
    if (*c == '-' || *c == '+')
        c++;
    for (; *c >= '0' && *c <= '9'; c++, digits++)
        if (whole < 100000)
            whole = 10 * whole + (*c - '0');
    if (*c == '.')
        for (c++; *c >= '0' && *c <= '9'; c++, digits++)
            if (unit < 1000000000) {
                fraction = 10 * fraction + (*c - '0');
                unit *= 10;
            }
    if (digits == 0)
        return -1;
    *text = c;
    fixed = (whole << 22) + (fraction << 22) / unit;
    if (negative)
        fixed = -fixed;
    if (fixed < INT32_MIN || fixed > INT32_MAX)
        return 0;
    *value = (int32_t)fixed;
    return 1;
}

static void print(const struct tracker_answer *answer)
{
    int k;

    printf("%s %s numbers=", statuses[answer->status], reasons[answer->reason]);
    for (k = 0; k < answer->points; k++)
        printf("%s%ld", k ? "," : "", (long)answer->number[k]);
    printf(" triads=%d matched=%d evidence=%ld", answer->triads, answer->matched, (long)answer->evidence);
    if (answer->status == TRACKER_SOLVED) {
        printf(" ra=%ld dec=%ld roll=%ld matrix=", (long)answer->attitude.ra, (long)answer->attitude.dec,
               (long)answer->attitude.roll);
        for (k = 0; k < 9; k++)
            printf("%s%ld", k ? "," : "", (long)answer->attitude.matrix[k / 3][k % 3]);
    }
    printf("\n");
}

int main(int argc, char **argv)
{
    static int32_t xy[TRACKER_MAX_POINTS][2];
    static struct tracker_context context;
    static struct tracker_answer answer;
    static char line[LINE];
    const long times = argc > 1 ? atol(argv[1]) : 1;
    int count = 0, outside = 0, open = 0, more = 1;
    long n;

    while (more) {
        const char *text = line;
        more = fgets(line, LINE, stdin) != NULL;
        if (more && line[strspn(line, " \t\r\n")] != '\0') {
            int32_t value[2] = {0, 0};
            int k, good;
            open = 1;
            for (k = 0; k < 2; k++) {
                good = parse(&text, &value[k]);
                if (good < 0) {
                    fprintf(stderr, "no star: %s", line);
                    return 2;
                }
                if (!good && count < TRACKER_MAX_POINTS)
                    outside = 1;
            }
            if (count < TRACKER_MAX_POINTS) {
                xy[count][0] = value[0];
                xy[count++][1] = value[1];
            }
            continue;
        }
        if (!more && !open)
            break;
        if (outside && count >= 3) {
            memset(&answer, 0, sizeof answer);
            answer.status = TRACKER_OVERFLOW;
            answer.reason = TRACKER_SEPARATION_OVERFLOW;
            answer.points = count;
        } else
            for (n = 0; n < times; n++)
                tracker_solve(&context, (const int32_t(*)[2])xy, count, &answer);
        print(&answer);
        count = outside = open = 0;
    }
    return 0;
}
