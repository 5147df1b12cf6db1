"""Coverage-guided fuzzing of exported C by libFuzzer, with the sanitizers of addresses and of undefined behaviour."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from simulator.study.exported_c.build import command, write_sources
from startracker.errors import InputError
from startracker.fixed_point.export_c import CExport

FLAGS = ("-std=c99", "-g", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror")
SANITIZERS = ("-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=undefined")


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


def build_fuzzer(export: CExport, harness: str, folder: Path) -> Path:
    """Compile a harness with the modules of an export.

    Parameters
    ----------
    export : CExport
    harness : str
        Source; ``tracker_`` in its names stands for the prefix ``tracker``.
    folder : Path
        Existing folder for sources and program.

    Returns
    -------
    Path
        Program of libFuzzer.

    Raises
    ------
    InputError
        Without clang, or if it fails.
    """
    missing = missing_fuzzer()
    if missing:
        raise InputError(missing)
    write_sources(export, folder)
    (folder / "harness.c").write_text(harness, encoding="utf-8")
    sources = [str(folder / f"{export.prefix}_{module}.c") for module in ("tables", *export.modules)]
    program = folder / "fuzz"
    command(["clang", *FLAGS, *SANITIZERS, "-o", str(program), str(folder / "harness.c"), *sources])
    return program


def run_fuzzer(program: Path, corpus: Path, seconds: int, longest: int, options: Sequence[str] = ()) -> FuzzResult:
    """Run a harness for some seconds.

    Parameters
    ----------
    program : Path
        From `build_fuzzer`.
    corpus : Path
        Folder of inputs; new ones that reach new code are added.
    seconds : int
        Duration.
    longest : int
        Largest input, bytes.
    options : sequence of str
        Of libFuzzer.
    """
    corpus.mkdir(parents=True, exist_ok=True)
    limits = [f"-max_total_time={seconds}", f"-max_len={longest}", "-timeout=60", f"-artifact_prefix={program.parent}/"]
    begun = time.monotonic()
    words = [str(program), *limits, "-print_final_stats=1", *options, str(corpus)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, errors="replace")
    executed = re.search(r"stat::number_of_executed_units:\s*(\d+)", done.stderr)
    edges = [int(n) for n in re.findall(r"cov: (\d+)", done.stderr)]
    found = re.search(r"^.*(?:ERROR: |runtime error: ).*$", done.stderr, re.MULTILINE)
    finding = found[0] if found else f"status {done.returncode}" if done.returncode else ""
    return FuzzResult(int(executed[1]) if executed else 0, time.monotonic() - begun, max(edges, default=0), finding)
