/* Fields of guide stars for the fuzzers: an attitude from bytes, and lists of stars. */
#ifndef TRACKER_FUZZ_FIELDS_H
#define TRACKER_FUZZ_FIELDS_H

#include <math.h>

#include "fuzz_check.h"

#define FIELD_HEAD 12
#define FIELD_GROUP 8
#define ONE 1073741824.0

/* An attitude with the guide stars in the image, brightest first. */
struct field {
    double axis[3][3], at[TRACKER_MAX_STARS][2];
    int guide[TRACKER_MAX_STARS], count;
};

/* A list, and what is known of it. */
struct list {
    struct tracker_frame_info info;
    struct tracker_observer observer; /* the same, as the stages take it */
    struct tracker_matrix attitude;
    struct tracker_star star[TRACKER_MAX_STARS];
    int16_t guide[TRACKER_MAX_STARS]; /* of each star: the one that was moved, or -1 */
    int count;
};

/* Attitude with the boresight at a guide star. */
static inline void look_at(double m[3][3], uint32_t guide, uint32_t roll)
{
    const int32_t *g = tracker_guide_direction[guide % TRACKER_SEARCH_GUIDES];
    const double angle = roll * 3.14159265358979 / 32768.0;
    double east[3], north[3], size;
    int k;

    for (k = 0; k < 3; k++)
        m[2][k] = g[k] / ONE;
    size = sqrt(m[2][0] * m[2][0] + m[2][1] * m[2][1]) + 1e-12;
    east[0] = -m[2][1] / size;
    east[1] = m[2][0] / size;
    east[2] = 0.0;
    for (k = 0; k < 3; k++)
        north[k] = m[2][(k + 1) % 3] * east[(k + 2) % 3] - m[2][(k + 2) % 3] * east[(k + 1) % 3];
    for (k = 0; k < 3; k++) {
        m[0][k] = cos(angle) * east[k] + sin(angle) * north[k];
        m[1][k] = cos(angle) * north[k] - sin(angle) * east[k];
    }
}

static inline void find_field(struct field *field)
{
    const double focal = TRACKER_GRID_FOCAL / 65536.0;
    int guide;

    field->count = 0;
    for (guide = 0; guide < TRACKER_SEARCH_GUIDES && field->count < TRACKER_MAX_STARS; guide++) {
        const int32_t *g = tracker_guide_direction[guide];
        double seen[3], *at = field->at[field->count];
        int j;
        for (j = 0; j < 3; j++)
            seen[j] = (field->axis[j][0] * g[0] + field->axis[j][1] * g[1] + field->axis[j][2] * g[2]) / ONE;
        if (seen[2] < 0.9)
            continue;
        at[0] = focal * seen[0] / seen[2] + 0.5 * (TRACKER_WIDTH - 1);
        at[1] = focal * seen[1] / seen[2] + 0.5 * (TRACKER_HEIGHT - 1);
        if (at[0] > -0.5 && at[1] > -0.5 && at[0] < TRACKER_WIDTH - 0.5 && at[1] < TRACKER_HEIGHT - 0.5)
            field->guide[field->count++] = guide;
    }
}

static inline void to_matrix(double m[3][3], struct tracker_matrix *out)
{
    int k;

    for (k = 0; k < 3; k++) {
        out->row[k].x = (int32_t)lrint(m[k][0] * (ONE - 1.0));
        out->row[k].y = (int32_t)lrint(m[k][1] * (ONE - 1.0));
        out->row[k].z = (int32_t)lrint(m[k][2] * (ONE - 1.0));
    }
}

/* A star from eight bytes: a guide star of the field moved by some of them, a position anywhere in the image, or any
 * values that the type holds. */
static inline void make_star(struct list *list, const uint8_t *bytes, const struct field *field, int *next)
{
    struct tracker_star *star = &list->star[list->count];
    const int way = bytes[0] % 8, dx = (int8_t)bytes[1], dy = (int8_t)bytes[2];

    star->flux = (int32_t)(of_two(bytes + 3) << (bytes[0] / 8 % 12));
    star->variance = 1u << (bytes[5] % 32);
    star->flags = (uint16_t)(bytes[5] / 64);
    star->x = (int32_t)((int64_t)of_two(bytes + 1) * (TRACKER_WIDTH + 2) - 65536);
    star->y = (int32_t)((int64_t)of_two(bytes + 6) * (TRACKER_HEIGHT + 2) - 65536);
    list->guide[list->count] = -1;
    if (way == 1) {
        star->x = (int32_t)(of_two(bytes + 1) << 16 | bytes[3]);
        star->y = (int32_t)(of_two(bytes + 6) << 16 | bytes[4]);
        star->flux = (int32_t)(of_two(bytes + 3) << 16);
        star->variance = of_two(bytes + 3) << 16 | of_two(bytes + 5);
        star->flags = (uint16_t)of_two(bytes + 6);
    } else if (way > 2 && *next < field->count) {
        star->x = (int32_t)(65536.0 * field->at[*next][0]) + dx * (1 << (bytes[6] % 12));
        star->y = (int32_t)(65536.0 * field->at[*next][1]) + dy * (1 << (bytes[7] % 12));
        list->guide[list->count] = (int16_t)field->guide[*next];
        (*next)++;
    }
    list->count++;
}

/* A list from bytes: guide star and roll of the attitude, velocity, epoch, prior, then the stars. The bytes used. */
static inline size_t make_list(struct list *list, const uint8_t *data, size_t size, int most)
{
    struct field field;
    size_t used = FIELD_HEAD;
    int next = 0;

    memset(list, 0, sizeof *list);
    look_at(field.axis, of_two(data), of_two(data + 2));
    find_field(&field);
    to_matrix(field.axis, &list->attitude);
    list->info.velocity.x = ((int8_t)data[4]) * 8192;
    list->info.velocity.y = ((int8_t)data[5]) * 8192;
    list->info.velocity.z = ((int8_t)data[6]) * 8192;
    list->observer.velocity = list->info.velocity;
    if (data[11] & 128) { /* up to 64 years either way */
        list->observer.years = ((int32_t)of_two(data + 4) - 32768) * 128;
        list->info.epoch = TRACKER_EPOCH + list->observer.years;
    }
    if (data[7] & 1) {
        list->info.prior.attitude = list->attitude;
        list->info.prior.radius = of_two(data + 8) << (data[7] / 8 % 16);
        if (data[7] & 2)
            list->info.prior.attitude.row[data[10] % 3].x ^= (int32_t)((uint32_t)data[11] << (data[7] / 8 % 24));
    }
    for (; size >= used + FIELD_GROUP && list->count < most; used += FIELD_GROUP)
        make_star(list, data + used, &field, &next);
    return used;
}

#endif
