"""Files of a design study."""

from __future__ import annotations

from pathlib import Path

from simulator.paths import make_folder
from simulator.study.design.plot import design_plot
from simulator.study.design.search import Design, Verification
from simulator.study.plots import save_bytes
from simulator.study.result_files import json_text, write_files
from simulator.study.results_folder import Identity

__all__ = ["write_design"]


def write_design(
    result: Design, verification: Verification | None, folder: Path, identity: Identity | None = None
) -> None:
    """Write ``design.json`` and ``design.png``."""
    values = result.to_dict() | {
        "verification": verification.to_dict() if verification else None,
        "identity": identity.to_dict() if identity else None,
    }
    write_files(make_folder(folder), {"design.json": json_text(values), "design.png": save_bytes(design_plot(result))})
