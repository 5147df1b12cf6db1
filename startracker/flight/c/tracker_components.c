/* Components: runs that touch, their sums, and those that no stamp holds. */
#include "tracker_front_internal.h"

#define SLOTS (2 * TRACKER_FRONT_RUNS)
#define LONG_SIDE 9           /* without saturated pixels, no larger box is beyond a stamp */
#define LONG_VARIANCE (6 << 8) /* along the major axis, square pixels, 8 fraction bits: more does not fit in a stamp */

static uint16_t root_of(const struct tracker_front_rows *rows, uint16_t component)
{
    int k;

    for (k = 0; k < SLOTS && rows->component[component].parent != component; k++)
        component = rows->component[component].parent;
    return component;
}

static void add_sums(struct tracker_front_component *to, const struct tracker_front_sums *sums, int32_t pixels)
{
    if (to->pixels <= TRACKER_FRONT_LARGEST && pixels <= TRACKER_FRONT_LARGEST) {
        to->sums.light += sums->light;
        to->sums.x += sums->x;
        to->sums.y += sums->y;
        to->sums.xx += sums->xx;
        to->sums.yy += sums->yy;
        to->sums.xy += sums->xy;
    }
    to->pixels += pixels;
}

static int is_before(uint16_t ay, uint16_t ax, uint16_t by, uint16_t bx)
{
    return ay < by || (ay == by && ax < bx);
}

/* Joins component b to a. */
static void join_components(struct tracker_front_rows *rows, uint16_t a, uint16_t b)
{
    struct tracker_front_component *to = &rows->component[a], *from = &rows->component[b];

    from->parent = a;
    add_sums(to, &from->sums, from->pixels);
    to->saturated += from->saturated;
    if (is_before(from->first_y, from->first_x, to->first_y, to->first_x)) {
        to->first_x = from->first_x;
        to->first_y = from->first_y;
        to->noise = from->noise;
    }
    to->left = from->left < to->left ? from->left : to->left;
    to->right = from->right > to->right ? from->right : to->right;
    to->top = from->top < to->top ? from->top : to->top;
    to->bottom = from->bottom > to->bottom ? from->bottom : to->bottom;
}

/* A free component for a run that touches none. There always is one: at most TRACKER_FRONT_RUNS reach a row, and as many
 * begin in it. */
static uint16_t new_component(struct tracker_front_rows *rows, const struct tracker_front_run *run, int32_t y)
{
    static const struct tracker_front_sums none = {0, 0, 0, 0, 0, 0};
    struct tracker_front_component *component;
    uint16_t n = 0;

    while (n < SLOTS - 1 && rows->component[n].used)
        n++;
    component = &rows->component[n];
    component->sums = none;
    component->pixels = component->saturated = 0;
    component->noise = tracker_front_between(rows->line.noise, tracker_front_cell(run->first), run->first);
    component->first_x = component->left = component->right = run->first;
    component->first_y = component->top = component->bottom = (uint16_t)y;
    component->parent = n;
    component->used = 1;
    rows->open++;
    return n;
}

void tracker_front_join(struct tracker_front_rows *rows, const struct tracker_front_run *run, int32_t y,
                        const struct tracker_front_sums *sums, int32_t saturated)
{
    const struct tracker_front_run *above = rows->run[(y + 1) & 1];
    struct tracker_front_run *here = &rows->run[y & 1][rows->runs[y & 1]++];
    struct tracker_front_component *component;
    uint16_t found = SLOTS, other;
    int n;

    for (n = 0; n < rows->runs[(y + 1) & 1] && above[n].first <= run->last + 1; n++) {
        if (above[n].last + 1 < run->first)
            continue;
        other = root_of(rows, above[n].component);
        if (found == SLOTS)
            found = other;
        else if (other != found)
            join_components(rows, found, other);
    }
    if (found == SLOTS)
        found = new_component(rows, run, y);
    *here = *run;
    here->component = found;
    component = &rows->component[found];
    add_sums(component, sums, run->last - run->first + 1);
    component->saturated += saturated;
    component->left = run->first < component->left ? run->first : component->left;
    component->right = run->last > component->right ? run->last : component->right;
    component->bottom = (uint16_t)y;
}

void tracker_front_principal(const int32_t moments[3], int32_t axes[2])
{
    int64_t half = tracker_shift_right((int64_t)moments[0] - moments[1], 1);
    int64_t middle = tracker_shift_right((int64_t)moments[0] + moments[1], 1);
    int64_t apart = tracker_square_root(half * half + (int64_t)moments[2] * moments[2]);

    axes[0] = (int32_t)(middle + apart);
    axes[1] = (int32_t)(middle - apart);
}

/* First and second moments of a component with light. */
static void moments_of(const struct tracker_front_sums *sums, struct tracker_front_object *object)
{
    int64_t s = sums->light, cx = sums->x / s, cy = sums->y / s, mx = sums->x - cx * s, my = sums->y - cy * s;
    int64_t xx = sums->xx - 2 * cx * sums->x + cx * cx * s, yy = sums->yy - 2 * cy * sums->y + cy * cy * s;
    int64_t xy = sums->xy - cx * sums->y - cy * sums->x + cx * cy * s;

    object->x = (int32_t)(cx * 65536 + mx * 65536 / s);
    object->y = (int32_t)(cy * 65536 + my * 65536 / s);
    mx = mx * 256 / s;
    my = my * 256 / s;
    object->xx = (int32_t)(xx * 256 / s - ((mx * mx) >> 8));
    object->yy = (int32_t)(yy * 256 / s - ((my * my) >> 8));
    object->xy = (int32_t)(tracker_floor_quotient(xy * 256, s) - ((mx * my) >> 8));
}

static int is_brighter(const struct tracker_front_object *a, const struct tracker_front_object *b)
{
    return a->light > b->light
           || (a->light == b->light && is_before(a->first_y, a->first_x, b->first_y, b->first_x));
}

static void keep_object(struct tracker_front *front, const struct tracker_front_object *object)
{
    int n, last = 0;

    if (front->objects < TRACKER_FRONT_OBJECTS) {
        front->object[front->objects++] = *object;
        return;
    }
    for (n = 1; n < front->objects; n++)
        if (is_brighter(&front->object[last], &front->object[n]))
            last = n;
    if (is_brighter(object, &front->object[last]))
        front->object[last] = *object;
}

int tracker_front_at_border(const struct tracker_front_object *object)
{
    return object->left <= TRACKER_FRONT_REACH || object->top <= TRACKER_FRONT_REACH
           || object->right >= TRACKER_WIDTH - TRACKER_FRONT_REACH - 1
           || object->bottom >= TRACKER_HEIGHT - TRACKER_FRONT_REACH - 1;
}

/* Whether an object with these principal variances has a saturated star's size and shape. */
static uint8_t is_star(const struct tracker_front_object *object, const int32_t axes[2])
{
    return object->kind == TRACKER_FRONT_SATURATED && object->pixels <= TRACKER_FRONT_MAX_PIXELS && object->light > 0
           && axes[1] >= TRACKER_FRONT_SHARP && (int64_t)axes[0] * 256 <= (int64_t)TRACKER_FRONT_AXIS_RATIO * axes[1]
           && !tracker_front_at_border(object);
}

/* A component that is complete: kept if no stamp holds it. */
static void complete(struct tracker_front *front, const struct tracker_front_component *component)
{
    int wide = component->right - component->left >= LONG_SIDE || component->bottom - component->top >= LONG_SIDE;
    struct tracker_front_object object;
    int32_t moments[3], axes[2] = {0, 0};

    if (!wide && component->saturated == 0 && component->pixels <= TRACKER_FRONT_LARGEST)
        return;
    object.light = component->sums.light;
    object.x = object.y = object.xx = object.yy = object.xy = 0;
    object.kind = object.star = 0;
    object.pixels = component->pixels;
    object.noise = component->noise;
    object.first_x = component->first_x;
    object.first_y = component->first_y;
    object.left = component->left;
    object.right = component->right;
    object.top = component->top;
    object.bottom = component->bottom;
    if (component->pixels > TRACKER_FRONT_LARGEST) {
        object.light = ((int64_t)1 << 40) + component->pixels;
        object.kind = TRACKER_FRONT_LARGE;
    } else {
        if (object.light > 0)
            moments_of(&component->sums, &object);
        moments[0] = object.xx;
        moments[1] = object.yy;
        moments[2] = object.xy;
        tracker_front_principal(moments, axes);
        if (component->saturated > 0)
            object.kind = TRACKER_FRONT_SATURATED;
        else if (axes[0] > LONG_VARIANCE)
            object.kind = TRACKER_FRONT_LONG;
    }
    object.star = is_star(&object, axes);
    if (object.kind > 0)
        keep_object(front, &object);
}

void tracker_front_close(struct tracker_front *front, int32_t y)
{
    struct tracker_front_rows *rows = &front->work.rows;
    struct tracker_front_component *component;
    struct tracker_front_run *run = rows->run[y & 1];
    uint16_t n;

    for (n = 0; n < rows->runs[y & 1]; n++)
        run[n].component = root_of(rows, run[n].component);
    for (n = 0; rows->open > 0 && n < SLOTS; n++) {
        component = &rows->component[n];
        if (!component->used || (component->parent == n && component->bottom == y))
            continue;
        if (component->parent == n)
            complete(front, component);
        component->used = 0;
        rows->open--;
    }
}
