/* Fuzzing of lists of stars (libFuzzer): bytes to stars, and what holds for every answer.
 *
 * The first bytes choose an attitude, a velocity and a prior; then each group of eight bytes is a star: a guide star seen
 * from that attitude, moved by some of the bytes, so that lists are solved; a position anywhere in the image; or any
 * values that the type holds. */
#include <math.h>
#include <string.h>

#include "fuzz_check.h"

#define HEAD 12
#define GROUP 8

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static int of_two(const uint8_t *bytes)
{
    return bytes[0] | bytes[1] << 8;
}

/* Attitude with the boresight at a guide star. */
static void look_at(double m[3][3], int guide, int roll)
{
    const int32_t *g = tracker_guide_direction[guide];
    const double angle = roll * 3.14159265358979 / 32768.0;
    double east[3], north[3], size;
    int k;

    for (k = 0; k < 3; k++)
        m[2][k] = g[k] / 1073741824.0;
    east[0] = -m[2][1];
    east[1] = m[2][0];
    east[2] = 0.0;
    size = sqrt(east[0] * east[0] + east[1] * east[1]) + 1e-12;
    for (k = 0; k < 3; k++)
        east[k] /= size;
    for (k = 0; k < 3; k++)
        north[k] = m[2][(k + 1) % 3] * east[(k + 2) % 3] - m[2][(k + 2) % 3] * east[(k + 1) % 3];
    for (k = 0; k < 3; k++) {
        m[0][k] = cos(angle) * east[k] + sin(angle) * north[k];
        m[1][k] = cos(angle) * north[k] - sin(angle) * east[k];
    }
}

/* Position of the next guide star in the image from `guide` on; the guide star, or -1. */
static int next_star(double m[3][3], int guide, double focal, double out[2])
{
    double seen[3];
    int j, k;

    for (; guide < TRACKER_SEARCH_GUIDES; guide++) {
        for (j = 0; j < 3; j++)
            for (seen[j] = 0.0, k = 0; k < 3; k++)
                seen[j] += m[j][k] * tracker_guide_direction[guide][k] / 1073741824.0;
        if (seen[2] < 0.5)
            continue;
        out[0] = focal * seen[0] / seen[2] + 0.5 * (TRACKER_WIDTH - 1);
        out[1] = focal * seen[1] / seen[2] + 0.5 * (TRACKER_HEIGHT - 1);
        if (out[0] > -0.5 && out[1] > -0.5 && out[0] < TRACKER_WIDTH - 0.5 && out[1] < TRACKER_HEIGHT - 0.5)
            return guide;
    }
    return -1;
}

static struct tracker_vector row_of(const double *m)
{
    const struct tracker_vector v = {(int32_t)(m[0] * 1073741823.0), (int32_t)(m[1] * 1073741823.0),
                                     (int32_t)(m[2] * 1073741823.0)};

    return v;
}

static void make_star(struct tracker_star *star, const uint8_t *bytes, double m[3][3], int *guide)
{
    const int way = bytes[0] % 8, dx = (int8_t)bytes[1], dy = (int8_t)bytes[2];
    double at[2];

    star->flux = of_two(bytes + 3) << (bytes[0] / 8 % 12);
    star->variance = 1u << (bytes[5] % 32);
    star->flags = (uint16_t)(bytes[5] / 64);
    star->x = (int32_t)((int64_t)of_two(bytes + 1) * (TRACKER_WIDTH + 2) - 65536);
    star->y = (int32_t)((int64_t)of_two(bytes + 6) * (TRACKER_HEIGHT + 2) - 65536);
    if (way == 1) {
        star->x = (int32_t)((uint32_t)of_two(bytes + 1) << 16 | bytes[3]);
        star->y = (int32_t)((uint32_t)of_two(bytes + 6) << 16 | bytes[4]);
        star->flux = (int32_t)((uint32_t)of_two(bytes + 3) << 16);
        star->variance = (uint32_t)of_two(bytes + 3) << 16 | (uint32_t)of_two(bytes + 5);
        star->flags = (uint16_t)of_two(bytes + 6);
    } else if (way > 2) {
        *guide = next_star(m, *guide, TRACKER_GRID_FOCAL / 65536.0, at);
        if (*guide >= 0) {
            star->x = (int32_t)(65536.0 * at[0]) + dx * (1 << (bytes[6] % 12));
            star->y = (int32_t)(65536.0 * at[1]) + dy * (1 << (bytes[7] % 12));
        }
        (*guide)++;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct tracker_context *context;
    static struct tracker_answer *answer;
    static struct tracker_star *star;
    struct tracker_frame_info info;
    double m[3][3];
    int guide = 0, count = 0, k;

    if (size < HEAD)
        return 0;
    if (context == NULL) {
        context = guarded(sizeof *context);
        answer = guarded(sizeof *answer);
        star = guarded(TRACKER_MAX_STARS * sizeof *star);
    }
    memset(&info, 0, sizeof info);
    look_at(m, of_two(data) % TRACKER_SEARCH_GUIDES, of_two(data + 2));
    info.velocity.x = ((int8_t)data[4]) * 8192;
    info.velocity.y = ((int8_t)data[5]) * 8192;
    info.velocity.z = ((int8_t)data[6]) * 8192;
    if (data[7] & 2)
        info.epoch = TRACKER_EPOCH + of_two(data + 4) * 128;
    if (data[7] & 1) {
        for (k = 0; k < 3; k++)
            info.prior.attitude.row[k] = row_of(m[k]);
        info.prior.radius = (uint32_t)of_two(data + 8) << (data[7] / 8 % 16);
    }
    for (data += HEAD, size -= HEAD; size >= GROUP && count < TRACKER_MAX_STARS; data += GROUP, size -= GROUP)
        make_star(&star[count++], data, m, &guide);
    tracker_start(context, &info);
    tracker_solve_stars(context, star, count, answer);
    check_answer(answer);
    return 0;
}
