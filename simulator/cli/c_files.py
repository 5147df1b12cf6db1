"""Files of an export of C, and a table of the memory that they take."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from simulator.paths import make_folder, write_atomically
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.targets import native_compiler
from startracker.flight.c_text import CExport


def write_export(export: CExport, out: Path) -> Path:
    """Write the files of an export; the folder."""
    folder = make_folder(out)
    for name, text in export.files.items():
        write_atomically(folder / name, text)
    return folder


def compiled_here(export: CExport, folder: Path) -> Build | None:
    """The export compiled in a folder by this machine's compiler; None without one."""
    target = native_compiler()
    return None if target is None else compile_export(export, folder, target)


def memory_table(export: CExport, build: Build | None) -> Table:
    """Memory of the tables, and of the code if it was compiled."""
    table = Table(show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    for name, count in export.table_bytes.items():
        table.add_row(f"table {name}", f"{count:,} bytes")
    table.add_row("tables", f"{sum(export.table_bytes.values()):,} bytes", end_section=True)
    if build is None:
        table.add_row("no C compiler here", "not measured")
        return table
    table.add_row("code", f"{build.code_bytes:,} bytes")
    table.add_row("context, given by the caller", f"{build.context_bytes:,} bytes")
    table.add_row("static buffers", f"{build.static_bytes:,} bytes")
    table.add_row("stack, at most", f"{build.stack_bytes:,} bytes")
    table.add_row("heap", "0 bytes" if not build.heap_calls else ", ".join(build.heap_calls))
    return table
