/* Functions around those of the interface (-Wl,--wrap), whose calls mark where an answer begins and ends. */
#include HEADER

#define PASTE(a, b) a##_##b
#define NAME(a, b) PASTE(a, b)
#define TYPE(name) struct NAME(PREFIX, name)
#define REAL(name) NAME(NAME(__real, PREFIX), name)
#define WRAP(name) NAME(NAME(__wrap, PREFIX), name)

void mark_enter(void);
void mark_leave(void);
void mark_answer(void);

__attribute__((noinline)) void mark_enter(void)
{
    __asm__ volatile("" ::: "memory");
}

__attribute__((noinline)) void mark_leave(void)
{
    __asm__ volatile("" ::: "memory");
}

__attribute__((noinline)) void mark_answer(void)
{
    __asm__ volatile("" ::: "memory");
}

void REAL(start)(TYPE(context) *context, const TYPE(frame_info) *info);
void WRAP(start)(TYPE(context) *context, const TYPE(frame_info) *info);
void REAL(row)(TYPE(context) *context, const uint16_t *row);
void WRAP(row)(TYPE(context) *context, const uint16_t *row);
void REAL(finish)(TYPE(context) *context, TYPE(answer) *answer);
void WRAP(finish)(TYPE(context) *context, TYPE(answer) *answer);
void REAL(solve_stars)(TYPE(context) *context, const TYPE(star) *star, int count, TYPE(answer) *answer);
void WRAP(solve_stars)(TYPE(context) *context, const TYPE(star) *star, int count, TYPE(answer) *answer);

void WRAP(start)(TYPE(context) *context, const TYPE(frame_info) *info)
{
    mark_enter();
    REAL(start)(context, info);
    mark_leave();
}

void WRAP(row)(TYPE(context) *context, const uint16_t *row)
{
    mark_enter();
    REAL(row)(context, row);
    mark_leave();
}

void WRAP(finish)(TYPE(context) *context, TYPE(answer) *answer)
{
    mark_enter();
    REAL(finish)(context, answer);
    mark_leave();
    mark_answer();
}

void WRAP(solve_stars)(TYPE(context) *context, const TYPE(star) *star, int count, TYPE(answer) *answer)
{
    mark_enter();
    REAL(solve_stars)(context, star, count, answer);
    mark_leave();
    mark_answer();
}
