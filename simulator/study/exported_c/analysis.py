"""What static analysis says of exported C: gcc's analyzer, and cppcheck with its add-on for MISRA C:2012."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from simulator.study.exported_c.build import FLAGS, command
from startracker.errors import InputError
from startracker.flight.c_text import CExport

STRICT = (*FLAGS, "-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Wcast-align", "-Wvla")
_FOUND = re.compile(r"^(\S+?):(\d+): (\S+): (.*)$", re.MULTILINE)
_RULE = re.compile(r"misra-c2012-(\d+\.\d+)")
_STYLE = "variableScope"
"""Reported where a variable could be declared in an inner block; the sources declare at the beginning of functions."""

_ACCEPTED = (
    ("_rows.c", "negativeIndex"),  # a pointer into the middle of a row, from which both sides are read
    ("_attitude_filter.c", "ctuArrayIndex"),  # a vector of three, passed by its first member
)
"""Findings that are none, by the end of the file's name."""


class Findings(NamedTuple):
    """What cppcheck found."""

    rules: Counter[str]
    """Places by rule of MISRA C:2012, such as ``15.6``."""
    others: tuple[str, ...]
    """Lines of all other findings."""


def analyze(export: CExport, folder: Path) -> None:
    """Compile an export that lies in a folder by gcc with its analyzer and all warnings as errors.

    Raises
    ------
    InputError
        With the first thing that gcc reports.
    """
    for name in solver_sources(export):
        words = [*STRICT, "-fanalyzer", f"-I{folder}", "-c", "-o", str(folder / "analyzed.o"), str(folder / name)]
        command(["gcc", *words])


def cppcheck(export: CExport, folder: Path) -> Findings:
    """What cppcheck finds in an export that lies in a folder.

    Raises
    ------
    InputError
        If cppcheck is not installed.
    """
    if shutil.which("cppcheck") is None:
        raise InputError("cppcheck is not installed (Debian: cppcheck)")
    words = ["--std=c99", "--addon=misra", "--enable=warning,style,performance,portability", "--quiet"]
    words += ["--suppress=missingIncludeSystem", "--template={file}:{line}: {id}: {message}"]
    said = command(["cppcheck", *words, *(str(folder / name) for name in solver_sources(export))], check=False)
    rules: Counter[str] = Counter()
    others = []
    for file, line, name, message in _FOUND.findall(said.stderr):
        rule = _RULE.match(name)
        if rule:
            rules[rule[1]] += 1
        elif name != _STYLE and not any(file.endswith(end) and name == kind for end, kind in _ACCEPTED):
            others.append(f"{Path(file).name}:{line}: {name}: {message}")
    return Findings(rules, tuple(others))


def solver_sources(export: CExport) -> list[str]:
    """Sources of the solver, without tables and ``main``."""
    return [f"{export.prefix}_{module}.c" for module in export.modules]
