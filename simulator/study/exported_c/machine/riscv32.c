/* Start, standard input and output of a program for 32-bit RISC-V in QEMU's user mode (system calls of Linux) with
 * picolibc, for which Debian has no crt0 of that kind. */
#include <stdio.h>
#include <stdlib.h>

#define READ 63
#define WRITE 64
#define EXIT 93

int main(int argc, char **argv);
void _exit(int status);
void begin(long *stack);

char thread_block[256]; /* picolibc keeps errno there */
static unsigned char input[1 << 16], output[1 << 12];
static long have, at, filled;

static long call(long number, long a, long b, long c)
{
    register long a0 __asm__("a0") = a, a1 __asm__("a1") = b, a2 __asm__("a2") = c, a7 __asm__("a7") = number;

    __asm__ volatile("ecall" : "+r"(a0) : "r"(a1), "r"(a2), "r"(a7) : "memory");
    return a0;
}

static int get(FILE *file)
{
    (void)file;
    if (at == have) {
        at = 0;
        have = call(READ, 0, (long)input, sizeof input);
        if (have <= 0) {
            have = 0;
            return EOF;
        }
    }
    return input[at++];
}

static int flush(FILE *file)
{
    (void)file;
    call(WRITE, 1, (long)output, filled);
    filled = 0;
    return 0;
}

static int put(char c, FILE *file)
{
    output[filled++] = (unsigned char)c;
    return c == '\n' || filled == (long)sizeof output ? flush(file) : 0;
}

static int put_error(char c, FILE *file)
{
    (void)file;
    return call(WRITE, 2, (long)&c, 1) == 1 ? 0 : EOF;
}

static FILE standard = FDEV_SETUP_STREAM(put, get, flush, _FDEV_SETUP_RW);
static FILE error = FDEV_SETUP_STREAM(put_error, NULL, NULL, _FDEV_SETUP_WRITE);
FILE *const stdin = &standard;
FILE *const stdout = &standard;
FILE *const stderr = &error;

void _exit(int status)
{
    for (;;)
        call(EXIT, status, 0, 0);
}

void begin(long *stack)
{
    const int status = main((int)stack[0], (char **)(stack + 1));

    if (filled > 0)
        flush(NULL);
    exit(status);
}

__asm__(".globl _start\n"
        "_start:\n"
        " .option push\n .option norelax\n la gp, __global_pointer$\n .option pop\n"
        " la tp, thread_block\n mv a0, sp\n andi sp, sp, -16\n call begin\n");
