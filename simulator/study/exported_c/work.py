"""Work that the exported C does for each answer, counted natively: executed blocks of each module.

Clang calls a function at each block of the program; each module has its own. With the instructions of an emulated
processor per block of each module (`instruction_weights`) the sum estimates its instructions, hundreds of times faster
than the emulation.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from simulator.study.exported_c.build import command, write_sources
from simulator.study.exported_c.instructions import InstructionCounts
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.flight.c_text import CExport

_COMPILE = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-vectorize", "-fno-slp-vectorize", "-fno-unroll-loops")
_COUNTED = "-fsanitize-coverage=bb,no-prune,trace-pc-guard"
_HOOK = "__sanitizer_cov_trace_pc_guard"
_OUT = "WORK_OUT"
_SOURCE = """#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "@PREFIX@.h"

static uint64_t work[@MODULES@];

@HOOKS@
void __sanitizer_cov_trace_pc_guard_init(uint32_t *from, uint32_t *to);
void __sanitizer_cov_trace_pc_guard_init(uint32_t *from, uint32_t *to) { (void)from; (void)to; }

static void answered(void)
{
    FILE *file = fopen(getenv("WORK_OUT"), "ab");

    if (file == NULL || fwrite(work, sizeof work, 1, file) != 1 || fclose(file) != 0)
        abort();
    memset(work, 0, sizeof work);
}

void __real_@PREFIX@_finish(struct @PREFIX@_context *context, struct @PREFIX@_answer *answer);
void __wrap_@PREFIX@_finish(struct @PREFIX@_context *context, struct @PREFIX@_answer *answer);
void __wrap_@PREFIX@_finish(struct @PREFIX@_context *context, struct @PREFIX@_answer *answer)
{
    __real_@PREFIX@_finish(context, answer);
    answered();
}

void __real_@PREFIX@_solve_stars(struct @PREFIX@_context *context, const struct @PREFIX@_star *star, int count,
                                 struct @PREFIX@_answer *answer);
void __wrap_@PREFIX@_solve_stars(struct @PREFIX@_context *context, const struct @PREFIX@_star *star, int count,
                                 struct @PREFIX@_answer *answer);
void __wrap_@PREFIX@_solve_stars(struct @PREFIX@_context *context, const struct @PREFIX@_star *star, int count,
                                 struct @PREFIX@_answer *answer)
{
    __real_@PREFIX@_solve_stars(context, star, count, answer);
    answered();
}
"""


def missing_counter() -> str | None:
    """Why work cannot be counted here, or None."""
    needed = [("clang", "clang"), ("objcopy", "binutils")]
    return next((f"{word} is not installed (Debian: {name})" for word, name in needed if not shutil.which(word)), None)


class WorkProgram:
    """The program of an export, which counts.

    Parameters
    ----------
    export : CExport
    folder : Path
        Existing folder for sources, objects and program.

    Raises
    ------
    InputError
        Without clang and objcopy, or if they fail.
    """

    def __init__(self, export: CExport, folder: Path) -> None:
        missing = missing_counter()
        if missing:
            raise InputError(missing)
        self.modules = export.modules
        self.program = folder / "work"
        write_sources(export, folder)
        hooks = [f"void work_{k}(uint32_t *guard) {{ (void)guard; work[{k}]++; }}" for k in range(len(self.modules))]
        text = _SOURCE.replace("@PREFIX@", export.prefix).replace("@MODULES@", str(len(self.modules)))
        (folder / "work.c").write_text(text.replace("@HOOKS@", "\n".join(hooks)))
        objects = []
        for name in ("work", "main", f"{export.prefix}_tables"):
            objects.append(str(folder / f"{name}.work.o"))
            command(["clang", *_COMPILE, "-c", "-o", objects[-1], str(folder / f"{name}.c")])
        for k, module in enumerate(self.modules):
            objects.append(str(folder / f"{module}.work.o"))
            source = str(folder / f"{export.prefix}_{module}.c")
            command(["clang", *_COMPILE, _COUNTED, "-c", "-o", objects[-1], source])
            command(["objcopy", f"--redefine-sym={_HOOK}=work_{k}", objects[-1]])
        wraps = [f"-Wl,--wrap={export.prefix}_{name}" for name in ("finish", "solve_stars")]
        command(["clang", *wraps, "-o", str(self.program), *objects])

    def run(self, data: bytes, *arguments: str) -> tuple[list[str], FloatArray]:
        """Lines of the answers for this standard input, and blocks by answer and module (N, M).

        Raises
        ------
        InputError
            If the program fails.
        """
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "work"
            environment = {**os.environ, _OUT: str(out)}
            words = [str(self.program), *arguments]
            done = subprocess.run(words, input=data, capture_output=True, check=False, env=environment)
            if done.returncode:
                raise InputError(f"work: {done.stderr.decode(errors='replace').strip() or done.returncode}")
            counts = np.fromfile(out, np.uint64) if out.exists() else np.zeros(0, np.uint64)
        return done.stdout.decode().splitlines(), counts.reshape(-1, len(self.modules)).astype(float)


def instruction_weights(
    modules: Sequence[str], work: FloatArray, counted: Sequence[InstructionCounts]
) -> tuple[FloatArray, float]:
    """Instructions per block of each module, and the correlation of the estimate with the emulated counts.

    Parameters
    ----------
    modules : sequence of str
    work : array, shape (N, M)
        Blocks of each scene and module.
    counted : sequence of InstructionCounts
        Emulated instructions of the same scenes. Those of each module are proportional to its blocks; those of the
        compiler's library are distributed by non-negative least squares.

    Returns
    -------
    weights : array, shape (M,)
    correlation : float
    """
    own = np.array([[one.modules.get(name, 0) for name in modules] for one in counted], float)
    total = np.array([one.total for one in counted], float)
    weights = own.sum(axis=0) / np.maximum(work.sum(axis=0), 1.0)
    library = total - own.sum(axis=1)
    scale = np.maximum(work.max(axis=0), 1.0)
    weights = weights + nnls(work / scale, library)[0] / scale
    return weights, float(np.corrcoef(work @ weights, total)[0, 1])
