"""Options of ``boresight run``, ``render`` and ``sweep``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from simulator.cli.options import Dask, ScenarioFile, Seed, SetValues

Force = Annotated[
    bool,
    typer.Option("--force", help="Compute everything again, and replace results of another run that stand in DIR."),
]


@dataclass(frozen=True)
class RunRequest:
    """Run a Monte Carlo study: statistics on the terminal, trials.parquet, summary.json and report.html in DIR."""

    scenario: ScenarioFile
    trials: Annotated[
        int | None, typer.Option("--trials", metavar="N", help="In place of the scenario's number of trials.")
    ] = None
    seed: Seed = None
    set_values: SetValues = None
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            help="Processes on this machine; default: its cores. The rows do not depend on it.",
        ),
    ] = None
    dask: Dask = None
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results; default: out/NAME.")
    ] = None
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Make a finished run longer by its trials in DIR. Those of an interrupted run are taken over anyway.",
        ),
    ] = False
    force: Force = False
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence", help="Run the scenario's sequence instead: frames one after the other, in tracking mode."
        ),
    ] = False
    frames: Annotated[
        int | None, typer.Option("--frames", metavar="N", help="Of a sequence, in place of the scenario's number.")
    ] = None
    step_s: Annotated[
        float | None, typer.Option("--step-s", metavar="S", help="Of a sequence, in place of the scenario's step.")
    ] = None
    single: Annotated[
        bool, typer.Option("--single", help="Of a sequence: solve every frame alone too, to compare.")
    ] = False
    animate: Annotated[
        bool,
        typer.Option("--animate", help="Of a sequence: a GIF of the frames, and an MP4 where ffmpeg is installed."),
    ] = False


@dataclass(frozen=True)
class RenderRequest:
    """Render a frame; of several scenarios one each, --out and --preview then name folders."""

    scenarios: Annotated[
        list[Path],
        typer.Argument(metavar="SCENARIO...", help="Scenario YAMLs, or names of those that ship.", show_default=False),
    ]
    index: Annotated[int | None, typer.Option("--index", metavar="I", help="The frame of this trial; default 0.")] = (
        None
    )
    at: Annotated[
        str | None, typer.Option("--at", metavar="TIME", help="The frame at this UTC time (ISO 8601) instead.")
    ] = None
    pointing: Annotated[
        str | None,
        typer.Option("--pointing", metavar="RA,DEC,ROLL", help="Point the camera there (degrees, ICRS) instead."),
    ] = None
    seed: Seed = None
    set_values: SetValues = None
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FRAME.fits", help="Write image, camera and truth as FITS.")
    ] = None
    preview: Annotated[Path | None, typer.Option("--preview", metavar="FRAME.png", help="Write a picture.")] = None
    noiseless: Annotated[
        bool, typer.Option("--noiseless", help="Switch off every noise and flaw of the detector, and the background.")
    ] = False
    noiseless_plane: Annotated[
        bool, typer.Option("--noiseless-plane", help="Add the light before the detector to the FITS file (MEAN_E).")
    ] = False


@dataclass(frozen=True)
class SweepRequest:
    """Run a scenario at many values of its keys: one dataset, statistics of every point, plots, sweep.html in DIR."""

    scenario: ScenarioFile
    over: Annotated[
        list[str],
        typer.Option(
            "--over",
            metavar="PATH=VALUES",
            help="Values of a key: low:high:count, low:high:count,log or a list v1,v2,...; may be repeated.",
            show_default=False,
        ),
    ]
    lhs: Annotated[
        int | None,
        typer.Option("--lhs", metavar="N", help="A Latin hypercube of N points instead of the full grid."),
    ] = None
    trials: Annotated[
        int | None, typer.Option("--trials", metavar="N", help="Trials per point, in place of the scenario's.")
    ] = None
    seed: Seed = None
    set_values: SetValues = None
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", help="Processes on this machine; default: its cores."),
    ] = None
    dask: Dask = None
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results; default: out/NAME-sweep.")
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from an interrupted sweep in DIR; a finished one stays as it is.")
    ] = False
    force: Force = False
