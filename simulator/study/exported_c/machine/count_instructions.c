/* A plugin of QEMU (user mode or system) that counts executed instructions.
 *
 *     -plugin count.so,out=FILE[,enter=ADDRESS,leave=ADDRESS,answer=ADDRESS]
 *
 * Writes to FILE a line "block ADDRESS COUNT" for each translated block. With the addresses of three functions it also
 * writes "answer COUNT" at each call of the third: the instructions between calls of the first and the second since the
 * call before. QEMU 7.2 of Debian comes without the header of its plugins; the declarations are those of its manual. */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct qemu_plugin_tb;
enum { ADD_U64 = 0, NO_REGISTERS = 0 };
typedef void (*on_block)(uint64_t id, struct qemu_plugin_tb *block);
typedef void (*on_execution)(unsigned int processor, void *data);
void qemu_plugin_register_vcpu_tb_trans_cb(uint64_t id, on_block callback);
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *block, int operation, void *to, uint64_t value);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *block, on_execution callback, int flags, void *data);
void qemu_plugin_register_atexit_cb(uint64_t id, void (*callback)(uint64_t id, void *data), void *data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *block);
uint64_t qemu_plugin_tb_vaddr(const struct qemu_plugin_tb *block);
__attribute__((visibility("default"))) int qemu_plugin_version = 1;
__attribute__((visibility("default"))) int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv);

struct block {
    uint64_t address, executed, instructions;
    struct block *next;
};

enum mark { ENTER, LEAVE, ANSWER, MARKS };
static const char *const names[MARKS] = {"enter=", "leave=", "answer="};
static uint64_t address[MARKS], total, entered, spent;
static struct block *blocks;
static FILE *out;

static void marked(unsigned int processor, void *data)
{
    (void)processor;
    switch ((enum mark)(intptr_t)data) {
    case ENTER:
        entered = total;
        break;
    case LEAVE:
        spent += total - entered;
        break;
    default:
        fprintf(out, "answer %llu\n", (unsigned long long)spent);
        spent = 0;
    }
}

static void translated(uint64_t id, struct qemu_plugin_tb *of)
{
    struct block *block = calloc(1, sizeof *block);
    int k;

    (void)id;
    if (block == NULL)
        abort();
    block->address = qemu_plugin_tb_vaddr(of);
    block->instructions = qemu_plugin_tb_n_insns(of);
    block->next = blocks;
    blocks = block;
    qemu_plugin_register_vcpu_tb_exec_inline(of, ADD_U64, &block->executed, 1);
    qemu_plugin_register_vcpu_tb_exec_inline(of, ADD_U64, &total, block->instructions);
    for (k = 0; k < MARKS; k++)
        if (address[k] != 0 && block->address == address[k])
            qemu_plugin_register_vcpu_tb_exec_cb(of, marked, NO_REGISTERS, (void *)(intptr_t)k);
}

static void ended(uint64_t id, void *data)
{
    const struct block *block;

    (void)id;
    (void)data;
    for (block = blocks; block != NULL; block = block->next)
        if (block->executed != 0)
            fprintf(out, "block %llx %llu\n", (unsigned long long)block->address,
                    (unsigned long long)(block->executed * block->instructions));
    fclose(out);
}

int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv)
{
    int n, k;

    (void)info;
    for (n = 0; n < argc; n++) {
        if (strncmp(argv[n], "out=", 4) == 0)
            out = fopen(argv[n] + 4, "w");
        for (k = 0; k < MARKS; k++)
            if (strncmp(argv[n], names[k], strlen(names[k])) == 0)
                address[k] = strtoull(argv[n] + strlen(names[k]), NULL, 16);
    }
    if (out == NULL)
        return 1;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, ended, NULL);
    return 0;
}
