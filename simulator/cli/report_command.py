"""``boresight report``: the report of a run once more, from its files; also as PDF, and with an error budget."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simulator.checks import load_scenario
from simulator.paths import write_atomically
from startracker.errors import InputError
from startracker.files import RESULT_BYTES, read_text


def report_of_folder(folder: Path, pdf: bool, budget: Path | None) -> int:
    """Write ``report.html``, and with `pdf` ``report.pdf``, into the folder of a run; exit status 0.

    Raises
    ------
    InputError
        Where the folder holds no run, or a file cannot be read or written.
    """
    from simulator.study.folder_lock import folder_lock
    from simulator.study.pages.drawing import drawn_apart
    from simulator.study.pages.html import html_of
    from simulator.study.pages.pdf import pdf_of
    from simulator.study.report.page import report_page
    from simulator.study.trials.checked_files import fault_of
    from simulator.study.trials.columns import Columns

    files = {name: folder / name for name in ("summary.json", "trials.parquet", "scenario.resolved.yaml")}
    if missing := [name for name, path in files.items() if not path.is_file()]:
        raise InputError(f"{folder}: not the folder of a finished run ({', '.join(missing)} missing)")
    summary = _read_json(files["summary.json"], {"trials", "errors_deg", "specification", "versions"})
    if "trials_sha256" in summary and (fault := fault_of(files["trials.parquet"], str(summary["trials_sha256"]))):
        raise InputError(f"{files['trials.parquet']}: {fault}; boresight run --resume computes its trials again")
    added = None if budget is None else _read_json(budget, {"effects", "classes", "rms_deg"})
    scenario = load_scenario(files["scenario.resolved.yaml"], [])
    if added is not None and added.get("scenario") != scenario.name:
        raise InputError(
            f"{budget}: the budget is that of '{added.get('scenario')}', the run that of '{scenario.name}'"
        )
    try:
        columns = Columns(files["trials.parquet"])
    except (OSError, ValueError) as error:  # pyarrow's errors are of these classes
        raise InputError(f"{files['trials.parquet']}: cannot be read ({str(error).splitlines()[0]})") from error
    page = report_page(scenario, summary, columns, budget=added)
    written: dict[str, str | bytes] = {"report.html": drawn_apart(html_of, page)}
    if pdf:
        written["report.pdf"] = drawn_apart(pdf_of, page)
    with folder_lock(folder):
        for name, content in written.items():
            write_atomically(folder / name, content)
    print(f"{folder}: {', '.join(written)}")
    return 0


def _read_json(path: Path, keys: set[str]) -> dict[str, Any]:
    text = read_text(path, RESULT_BYTES, "give the folder of a study")
    try:
        found = json.loads(text)
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from error
    if not isinstance(found, dict) or (lost := keys - set(found)):
        raise InputError(
            f"{path}: not what boresight writes there"
            + (f" ({', '.join(sorted(lost))} missing)" if isinstance(found, dict) else "")
        )
    return found
