"""What measures exported C: the stack of its call graph, and counted instructions."""

import subprocess

import pytest

from simulator.study.exported_c.build import compile_export
from simulator.study.exported_c.instructions import count_instructions, marked
from simulator.study.exported_c.stack import deepest_stack
from simulator.study.exported_c.targets import CORTEX_M4, EMULATED, HOST, M68K, MACHINE
from startracker.errors import InputError
from startracker.flight.c_text import CExport

pytestmark = pytest.mark.system

needs_gcc = pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")

CHAIN = """
volatile char sink;
static __attribute__((noinline)) void leaf(int n) { volatile char a[1000]; a[n] = 1; sink = a[n]; }
static __attribute__((noinline)) void other(int n) { volatile char a[400]; a[n] = 1; sink = a[n]; }
void top(int n);
void top(int n) { volatile char a[2000]; a[n] = 1; leaf(n); other(n); sink = a[n]; }
"""
RECURSIVE = (
    "int down(int n); int up(int n) { return n < 1 ? 0 : 1 + down(n - 1); } int down(int n) { return 2 * up(n - 1); }"
)


def graph(tmp_path, source):
    (tmp_path / "x.c").write_text(source)
    words = ["gcc", "-std=c99", "-O1", "-fno-inline", "-fno-optimize-sibling-calls", "-fcallgraph-info=su", "-c"]
    subprocess.run([*words, "-o", str(tmp_path / "x.o"), str(tmp_path / "x.c")], check=True)
    return [tmp_path / "x.ci"]


@needs_gcc
def test_the_deepest_chain_counts_once(tmp_path):
    """2000 + 1000 bytes of arrays and what the calls push, less x86-64's red zone of 128; not the 400 of the other."""
    assert 3000 - 128 <= deepest_stack(graph(tmp_path, CHAIN)) < 3200


@needs_gcc
def test_recursion_and_frames_without_a_size_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"recursion: .*up"):
        deepest_stack(graph(tmp_path, RECURSIVE))
    with pytest.raises(InputError, match="no fixed size"):
        deepest_stack(graph(tmp_path, "char f(int n) { volatile char a[n]; a[0] = 1; return a[0]; }"))


LOOP = """
#include "tracker.h"
int tracker_spin(int n)
{
    int k, sum = 0;
    for (k = 0; k < n; k++) {
        sum ^= k;
        __asm__ volatile("" : "+r"(sum));
    }
    return sum;
}
"""
LOOP_MAIN = """
#include <stdio.h>
#include <stdlib.h>
#include "tracker.h"
int main(int argc, char **argv)
{
    static volatile char context[8];
    char line[32];
    while (fgets(line, sizeof line, stdin))
        printf("%d\\n", tracker_spin(atoi(line)) + context[0] + argc * 0 + (argv == NULL));
    return 0;
}
"""


def loop_export():
    files = {"tracker.h": "int tracker_spin(int n);\n", "tracker_loop.c": LOOP, "main.c": LOOP_MAIN}
    files["tracker_tables.c"] = "const int tracker_nothing = 1;\n"
    return CExport("tracker", {name: text.lstrip() for name, text in files.items()}, {}, ("loop",))


@pytest.mark.parametrize("target", EMULATED, ids=lambda target: target.name)
def test_instructions_of_a_loop(target, tmp_path):
    """Equal steps of the counter, of the same few instructions a turn; of the rest, the divisions of printf alone."""
    if target.missing() or HOST.missing():
        pytest.skip(f"{target.missing() or 'gcc'} is not installed (Debian: {target.debian})")
    build = compile_export(loop_export(), tmp_path, target)
    assert build.run(b"10\n").split() == [b"1"]  # 0 ^ 1 ^ ... ^ 9
    counts = [count_instructions(build, f"{n}\n".encode()).modules for n in (1000, 2000, 3000)]
    assert all(set(count) <= {"loop", "library"} for count in counts)
    first, second, third = (count["loop"] for count in counts)
    assert third - second == second - first
    assert (second - first) % 1000 == 0
    assert 2 <= (second - first) // 1000 <= 6


@pytest.mark.skipif(M68K.missing() is not None, reason=f"{M68K.missing()} is not installed")
def test_the_plugin_counts_what_the_log_of_the_emulator_lists(tmp_path):
    build = compile_export(loop_export(), tmp_path, M68K)
    lists = tmp_path / "lists"
    lists.write_text("3000\n")
    (tmp_path / "count.so").unlink(missing_ok=True)
    plugin = ["gcc", "-O2", "-fPIC", "-shared", "-o", str(tmp_path / "count.so"), str(MACHINE / "count_instructions.c")]
    subprocess.run(plugin, check=True)
    build.run(lists.read_bytes(), plugin=f"{tmp_path / 'count.so'},out={tmp_path / 'counts'}")
    counted = sum(int(line.split()[2]) for line in (tmp_path / "counts").read_text().splitlines())
    command = [*M68K.emulator, "-singlestep", "-d", "nochain,exec", str(build.program)]
    with lists.open() as given:
        listed = subprocess.run(command, stdin=given, capture_output=True, check=True).stderr.count(b"\n")
    # a block that a system call or a signal leaves is counted as a whole: a few instructions of some ten thousand
    assert counted == pytest.approx(listed, rel=0.01)
    assert counted > 12_000


def test_a_bare_machine_opens_its_input_itself(tmp_path):
    words = CORTEX_M4.command(tmp_path / "solve", ("stars",), tmp_path / "in")
    assert words[-2:] == ["-kernel", str(tmp_path / "solve")]
    assert f"enable=on,target=native,arg=solve,arg=stars,arg={tmp_path / 'in'}" in words
    assert M68K.command(tmp_path / "solve", ("1",), tmp_path / "in")[-2:] == [str(tmp_path / "solve"), "1"]


def test_instructions_need_an_emulator():
    class Unemulated:
        target = HOST

    with pytest.raises(InputError, match="under emulation"):
        count_instructions(Unemulated, b"")
    assert "marks.c" in marked(CORTEX_M4, "vega").machine
