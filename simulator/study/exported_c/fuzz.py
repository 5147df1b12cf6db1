"""Coverage-guided fuzzing of exported C by libFuzzer, with the sanitizers of addresses and of undefined behaviour."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from simulator.study.exported_c.build import command, write_sources
from startracker.errors import InputError
from startracker.flight.c_text import CExport

FLAGS = ("-std=c99", "-g", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror")
SANITIZERS = (
    "-fsanitize=fuzzer,address,undefined",
    "-fno-sanitize-recover=undefined",
    "-fno-sanitize-coverage=trace-cmp",  # calls at every comparison, most of the time
)
_OPTIONS = ("-detect_leaks=0", "-entropic=0", "-reduce_inputs=0", "-timeout=60", "-print_final_stats=1")
"""There is no heap to leak; the others save bookkeeping, a fifth of the time."""


class FuzzResult(NamedTuple):
    """One run."""

    executions: int
    seconds: float
    edges: int
    """Edges of the program's graph that inputs of the corpus reach."""
    finding: str
    """First line of what was found; empty: nothing."""


def missing_fuzzer() -> str | None:
    """Why nothing can be fuzzed here, or None."""
    return None if shutil.which("clang") else "clang is not installed (Debian: clang, with libFuzzer)"


def build_fuzzers(export: CExport, names: Iterable[str], folder: Path) -> dict[str, Path]:
    """Compile fuzzers of an export with its modules.

    Parameters
    ----------
    export : CExport
    names : iterable of str
        Of its files ``fuzz_NAME.c``.
    folder : Path
        Existing folder for sources, objects and programs.

    Returns
    -------
    dict
        Program of libFuzzer by name.

    Raises
    ------
    InputError
        Without clang, or if it fails.
    """
    missing = missing_fuzzer()
    if missing:
        raise InputError(missing)
    write_sources(export, folder)

    def compiled(source: str) -> str:
        made = str(folder / source) + ".o"
        command(["clang", *FLAGS, *SANITIZERS, "-c", "-o", made, str(folder / source)])
        return made

    objects = [compiled(f"{export.prefix}_{module}.c") for module in ("tables", *export.modules)]
    programs = {name: folder / f"fuzz_{name}" for name in names}
    for name, program in programs.items():
        command(["clang", *SANITIZERS, "-o", str(program), compiled(f"fuzz_{name}.c"), *objects, "-lm"])
    return programs


def run_fuzzer(program: Path, corpus: Path, seconds: int, longest: int, findings: Path) -> FuzzResult:
    """Run a fuzzer for some seconds.

    Parameters
    ----------
    program : Path
        From `build_fuzzers`.
    corpus : Path
        Folder of inputs; new ones that reach new code are added.
    seconds : int
        Duration.
    longest : int
        Largest input, bytes.
    findings : Path
        Folder of the inputs with which something is found.
    """
    for folder in (corpus, findings):
        folder.mkdir(parents=True, exist_ok=True)
    limits = [f"-max_total_time={seconds}", f"-max_len={longest}", f"-artifact_prefix={findings}/{program.name}-"]
    begun = time.monotonic()
    words = [str(program), *limits, *_OPTIONS, str(corpus)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, errors="replace")
    executed = re.search(r"stat::number_of_executed_units:\s*(\d+)", done.stderr)
    edges = [int(n) for n in re.findall(r"cov: (\d+)", done.stderr)]
    found = re.search(r"^.*(?:ERROR: |runtime error: ).*$", done.stderr, re.MULTILINE)
    finding = found[0] if found else f"status {done.returncode}" if done.returncode else ""
    return FuzzResult(int(executed[1]) if executed else 0, time.monotonic() - begun, max(edges, default=0), finding)
