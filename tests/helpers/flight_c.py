"""Modules of the C of a flight build as a shared library, whose functions tests call one by one."""

import ctypes
import subprocess
from importlib.resources import files
from pathlib import Path

from simulator.study.exported_c.build import FLAGS
from startracker.flight.c_table import CTable

STRICT = (*FLAGS, "-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-ffp-contract=off")
SANITIZED = ("-fsanitize=undefined", "-fno-sanitize-recover=all")


class Real(ctypes.Structure):
    """``tracker_real`` of the integer build."""

    _fields_ = (("m", ctypes.c_int32), ("e", ctypes.c_int32))


def library(
    folder: Path,
    modules: tuple[str, ...],
    constants: dict[str, int] | None = None,
    arrays: list[CTable] | None = None,
    extra: tuple[str, ...] = (),
    compiler: str = "gcc",
    arithmetic: str = "fixed",
    source: str = "",
) -> ctypes.CDLL:
    """Modules compiled with the tables and the text of one more source, strictly, in a folder."""
    tables = "#ifndef TRACKER_TABLES_H\n#define TRACKER_TABLES_H\n#include <stdint.h>\n"
    macros = {**(constants or {}), **({"FLOAT": 1} if arithmetic == "float" else {})}
    tables += "".join(f"#define TRACKER_{name} {value}\n" for name, value in macros.items())
    tables += "".join(f"extern {array.declaration};\n" for array in arrays or []) + "#endif\n"
    (folder / "tracker_tables.h").write_text(tables)
    body = "".join("\n".join(array.definition()) + "\n" for array in arrays or [])
    (folder / "tables.c").write_text('#include "tracker_tables.h"\n' + body)
    (folder / "more.c").write_text(source or '#include "tracker_tables.h"\n')
    sources = Path(str(files("startracker.flight") / "c"))
    paths = [sources / f"tracker_{module}.c" for module in modules]
    out = folder / f"{arithmetic}-{compiler}-{len(extra)}.so"
    command = [compiler, *STRICT, *extra, "-fPIC", "-shared", "-o", str(out), f"-I{folder}", f"-I{sources}"]
    done = subprocess.run(
        [*command, *map(str, paths), str(folder / "tables.c"), str(folder / "more.c")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(out))
