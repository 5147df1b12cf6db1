"""Files of a design study."""

from __future__ import annotations

from pathlib import Path

from simulator.paths import make_folder
from simulator.study.design.plot import design_plot
from simulator.study.design.verification import Verified
from simulator.study.plots import save_bytes
from simulator.study.result_files import json_text, write_files
from simulator.study.results_folder import Identity


def write_design(verified: Verified, folder: Path, identity: Identity | None = None) -> None:
    """Write ``design.json`` and ``design.png``."""
    result, answer = verified.design, verified.answer
    last = answer or (verified.runs[-1] if verified.runs else None)
    values = result.to_dict() | {
        "answer": answer.value if answer else result.best.value if result.best and not verified.runs else None,
        "verification": last.to_dict() if last else None,
        "verifications": [run.to_dict() for run in verified.runs],
        "identity": identity.to_dict() if identity else None,
    }
    write_files(
        make_folder(folder), {"design.json": json_text(values), "design.png": save_bytes(design_plot(verified))}
    )
