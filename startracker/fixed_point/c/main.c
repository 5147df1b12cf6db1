/* Solves lists of centroids from standard input, a line "x y" for each star in pixels (x right, y up, from the image's
 * centre, brightest first; up to nine decimals), an empty line after each list. Prints a line for each list:
 *
 *     status numbers=HR,HR,... triads=N ra=R dec=D roll=P matrix=M11,...,M33
 *
 * all integers; ra, dec and roll of 10.22 degrees, the matrix of 2.30. With an argument each list is solved that many
 * times, to take the time. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tracker.h"

#define LINE 256

static const char *const names[] = {"solved", "too_few_stars", "no_match", "no_attitude", "overflow",
                                    "too_many_triads"};

/* A decimal number to 10.22, truncated towards zero; 1: good, 0: does not fit, -1: no number. */
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

static void print(const struct answer *answer)
{
    int k;

    printf("%s numbers=", names[answer->status]);
    for (k = 0; k < answer->stars; k++)
        printf("%s%ld", k ? "," : "", (long)answer->number[k]);
    printf(" triads=%d", answer->triads);
    if (answer->status == SOLVED) {
        printf(" ra=%ld dec=%ld roll=%ld matrix=", (long)answer->attitude.ra, (long)answer->attitude.dec,
               (long)answer->attitude.roll);
        for (k = 0; k < 9; k++)
            printf("%s%ld", k ? "," : "", (long)answer->attitude.matrix[k / 3][k % 3]);
    }
    printf("\n");
}

int main(int argc, char **argv)
{
    static int32_t xy[MAX_STARS][2];
    static struct answer answer;
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
                if (!good && count < MAX_STARS)
                    outside = 1;
            }
            if (count < MAX_STARS) {
                xy[count][0] = value[0];
                xy[count++][1] = value[1];
            }
            continue;
        }
        if (!more && !open)
            break;
        if (outside && count >= 3) {
            memset(&answer, 0, sizeof answer);
            answer.status = OVERFLOW_STATUS;
            answer.stars = count;
        } else
            for (n = 0; n < times; n++)
                solve((const int32_t(*)[2])xy, count, &answer);
        print(&answer);
        count = outside = open = 0;
    }
    return 0;
}
