"""Files of a design study."""

from __future__ import annotations

import json
from pathlib import Path

from simulator.paths import make_folder, write_atomically
from simulator.study.design.plot import design_plot
from simulator.study.design.search import Design, Verification
from simulator.study.plots import save_bytes
from simulator.study.results_folder import Identity

__all__ = ["write_design"]


def write_design(
    result: Design, verification: Verification | None, folder: Path, identity: Identity | None = None
) -> None:
    """Write ``design.json`` and ``design.png``, each moved into place whole."""
    make_folder(folder)
    values = result.to_dict() | {
        "verification": verification.to_dict() if verification else None,
        "identity": identity.to_dict() if identity else None,
    }
    write_atomically(folder / "design.json", json.dumps(values, indent=2, allow_nan=False) + "\n")
    write_atomically(folder / "design.png", save_bytes(design_plot(result)))
