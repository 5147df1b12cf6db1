"""A complete sequence: frames in tracking mode, statistics, and the files of ``boresight run --sequence``."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from simulator.checks import as_scenario
from simulator.mission.spice import need_spiceypy
from simulator.scenario import Scenario
from simulator.study.result_files import catalogs_of, json_text, now_utc, parquet_bytes, write_files
from simulator.study.result_options import check_run_options
from simulator.study.results_folder import Identity, results_folder, scenario_sha256, standing
from simulator.study.sequence.animation import FrameView, find_ffmpeg, gif_bytes, mp4_bytes, view_of
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.heads import HeadsRunner
from simulator.study.sequence.messages import sequence_kernels, sequence_messages, state_columns
from simulator.study.sequence.operation import summarise_operation
from simulator.study.sequence.result import Sequence
from simulator.study.sequence.statistics import fused_nees, summarise_heads, summarise_sequence
from simulator.study.statistics import median
from simulator.study.trials.arrow import table_of
from simulator.study.trials.stopping import stop_on_signal
from startracker._compiled import clock
from startracker._version import __version__
from startracker.errors import BoresightError, InputError

Progress = Callable[[int, int], None]
"""Called with (frames finished, total frames)."""


class _Asked(NamedTuple):
    """What is computed and written besides the frames and their summary; see `run_sequence`."""

    single: bool
    animate: bool
    ccsds: bool
    spice: bool


_FLUSH_FRAMES = 500
"""Rows are stored as columns in chunks of this size, to limit memory."""


def run_sequence(
    scenario: Scenario | str | os.PathLike[str],
    *,
    out: str | Path | None = None,
    single: bool = False,
    animate: bool = False,
    ccsds: bool = False,
    spice: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Sequence:
    """Run a scenario's sequence: frames of an orbit or a slew in tracking mode.

    Parameters
    ----------
    scenario : Scenario or path
        The scenario, with its ``sequence`` section, or the name of an included one or of a file.
    out : path, optional
        Folder for ``sequence.parquet``, ``sequence.json``, ``sequence.html``, ``scenario.resolved.yaml`` and, with
        `animate`, ``sequence.gif`` and, if ffmpeg is installed, ``sequence.mp4``; with `ccsds` and `spice` the files of
        `simulator.study.sequence.messages`; None: nothing is written.
    single : bool
        Also solve every frame on its own, for comparison.
    animate : bool
        Create the animation.
    ccsds : bool
        Write trajectory and attitudes as messages of CCSDS.
    spice : bool
        Write trajectory and attitudes as kernels of SPICE; needs the extra ``spice``.
    force : bool
        Replace any results in `out`.
    progress : callable, optional
        Called with (finished, total).

    Raises
    ------
    InputError
        For an unwritable folder, or invalid names or files in the scenario; if `out` contains results of another
        scenario, seed, version or longer sequence; or if another process uses it.
    BoresightError
        For a sequence interrupted with fewer frames than the results in `out`.

    Notes
    -----
    Ctrl-C ends the sequence after the current frame; results and files contain the frames so far, and the summary has
    ``interrupted``.
    """
    check_run_options(out, progress, single=single, animate=animate, ccsds=ccsds, spice=spice, force=force)
    scenario, asked = as_scenario(scenario), _Asked(single, animate, ccsds, spice)
    if out is None:
        return _run(scenario, None, asked, progress)
    if spice:
        need_spiceypy()
    with results_folder(Path(out), _identity(scenario, single, scenario.sequence.frames), force=force) as folder:
        old = None if force else standing(folder, "sequence")
        return _run(scenario, folder, asked, progress, old.amounts["frames"] if old else 0)


def _identity(scenario: Scenario, single: bool, frames: int) -> Identity:
    """Identity of a number of frames of a sequence."""
    begun = scenario.changed({"sequence.frames": 1})
    sha256 = scenario_sha256(begun, sequence=True, single=single)
    return Identity("sequence", scenario.name, scenario.seed, sha256, {"frames": frames})


def _run(
    scenario: Scenario, folder: Path | None, asked: _Asked, progress: Progress | None, frames_standing: int = 0
) -> Sequence:
    if asked.single and scenario.heads:
        raise InputError("single: the heads are solved frame by frame; omit --single")
    runner = HeadsRunner(scenario) if scenario.heads else SequenceRunner(scenario, single=asked.single)
    requested, started = scenario.sequence.frames, clock()
    table, views = _tracked(runner, requested, asked.animate, progress)
    elapsed_s, done = clock() - started, table.num_rows
    if done < frames_standing:
        raise BoresightError(
            f"interrupted after {done} frames; {folder} still contains the "
            f"results of an earlier run of {frames_standing}"
        )
    for name, column in state_columns(scenario, table["t_s"].to_numpy()).items():
        table = table.append_column(name, pa.array(column))
    sequence = Sequence(scenario, table, {}, folder)
    columns = sequence.columns
    sequence.summary.update(
        name=scenario.name,
        seed=scenario.seed,
        version=__version__,
        finished_utc=now_utc(),
        identity=_identity(scenario, asked.single, done).to_dict(),
        requested=requested,
        interrupted=done < requested,
        **summarise_sequence(columns, scenario.sequence.step_s, sequence.judgement),
        unphysical=list(scenario.unphysical),
        catalogs=catalogs_of(scenario),
        elapsed_s=elapsed_s,
        median_ms={name: median(columns[f"{name}_ms"]) for name in ("render", "track")},
    )
    if scenario.heads:
        sequence.summary.update(heads=summarise_heads(columns, scenario), nees=fused_nees(columns))
    if runner.operated is not None:
        sequence.summary["operation"] = summarise_operation(runner.operated, columns, scenario.sequence.step_s)
    if runner.calibrated is not None:
        sequence.summary["in_flight_calibration"] = runner.calibrated.summarise(columns)
    if folder is None:
        return sequence
    return Sequence(scenario, table, sequence.summary, folder, _write(sequence, folder, views, asked))


def _tracked(
    runner: HeadsRunner | SequenceRunner, requested: int, animate: bool, progress: Progress | None
) -> tuple[pa.Table, list[FrameView]]:
    """Rows of the frames until the end or Ctrl-C, and their pictures for the animation."""
    pieces: list[pa.Table] = []
    rows: list[dict[str, Any]] = []
    views: list[FrameView] = []
    if progress:
        progress(0, requested)
    with stop_on_signal() as stop:
        for done, tracked in enumerate(runner.frames(), 1):
            rows.append(tracked.row)
            if animate:
                views.append(view_of(tracked))
            if len(rows) == _FLUSH_FRAMES:
                pieces.append(table_of(rows))
                rows = []
            if progress:
                progress(done, requested)
            if stop.is_set():
                break
    return pa.concat_tables([*pieces, *([table_of(rows)] if rows else [])]), views


def _write(sequence: Sequence, folder: Path, views: list[FrameView], asked: _Asked) -> tuple[str, ...]:
    """Write the result files atomically."""
    from simulator.study.pages.html import html_of
    from simulator.study.sequence.page import sequence_page

    files: dict[str, bytes | str] = {
        "sequence.parquet": parquet_bytes(sequence.frames, compression="zstd"),
        "sequence.json": json_text(sequence.summary),
        "scenario.resolved.yaml": f"# boresight {__version__}\n{sequence.scenario.to_yaml()}",
    }
    gif = gif_bytes(views, sequence.columns, sequence.scenario.name) if views else None
    files["sequence.html"] = html_of(sequence_page(sequence, gif))
    if gif is not None:
        files["sequence.gif"] = gif
        program = find_ffmpeg()
        if program is not None:
            files["sequence.mp4"] = mp4_bytes(views, sequence.columns, sequence.scenario.name, program)
    if asked.ccsds:
        files |= sequence_messages(sequence.scenario, sequence.columns, sequence.summary["finished_utc"])
    if asked.spice:
        files |= sequence_kernels(sequence.scenario, sequence.columns)
    write_files(folder, files)
    return tuple(files)
