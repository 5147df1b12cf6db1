"""Executes the notebooks that ship, and stores their outputs.

python tests/helpers/run_notebooks.py [NAME ...]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import nbformat

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"


def valid(path: Path) -> nbformat.NotebookNode:
    """The stored notebook; raises an error if it is not a valid one."""
    import nbformat  # two seconds, which other tests do not wait for

    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs of a run from its first cell to its last, in a kernel of its own."""
    from nbclient import NotebookClient

    notebook = valid(path)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    notebook.metadata.pop("widgets", None)
    run_in = {"metadata": {"path": path.parent}}
    options = {"timeout": 300, "kernel_name": "python3", "record_timing": False, "store_widget_state": False}
    NotebookClient(notebook, resources=run_in, **options).execute()
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


def main(names: list[str]) -> None:
    """Execute the named notebooks, or all, and write them with their outputs."""
    import nbformat

    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            nbformat.write(executed(path), path)
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
