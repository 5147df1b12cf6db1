/* Start of a program on a Cortex-M in QEMU: vector table, floating-point unit, and standard input from the file that
 * the last argument names. Arguments, files and output go through semihosting (newlib's rdimon). */
#include <stdint.h>
#include <stdio.h>

#define VECTORS 16

extern char __stack[];
int __real_main(int argc, char **argv);
int __wrap_main(int argc, char **argv);
void reset(void);

static void fault(void)
{
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[VECTORS] = {
    (uintptr_t)__stack, (uintptr_t)reset, (uintptr_t)fault, (uintptr_t)fault,
    (uintptr_t)fault,   (uintptr_t)fault, (uintptr_t)fault,
};

/* Enables the coprocessors 10 and 11 (CPACR), the floating-point unit, which code before main may use. */
__attribute__((naked)) void reset(void)
{
    __asm__ volatile("ldr r0, =0xE000ED88\n ldr r1, =0x00F00000\n str r1, [r0]\n dsb\n isb\n b _start\n");
}

int __wrap_main(int argc, char **argv)
{
    if (argc < 2 || freopen(argv[argc - 1], "rb", stdin) == NULL)
        return 3;
    return __real_main(argc - 1, argv);
}
