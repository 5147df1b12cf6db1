"""Options of ``boresight run``, ``render``, ``sweep`` and ``datasheet``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from simulator.cli.options import Dask, ScenarioFile, ScenarioFiles, Seed, SetValues, complete_key, option, switch

Force = Annotated[
    bool,
    switch("--force", "Recompute everything, and replace results of another run in DIR."),
]

_SEQUENCES, _PICTURE = "Sequences", "Picture"


@dataclass(frozen=True)
class RunRequest:
    """Run a Monte Carlo study: statistics on the terminal, trials.parquet, summary.json and report.html in DIR."""

    scenario: ScenarioFile
    trials: Annotated[int | None, option("--trials", "N", "Number of trials; default: the scenario's.")] = None
    seed: Seed = None
    set_values: SetValues = None
    workers: Annotated[
        int | None,
        option("--workers", "N", "Processes on this machine; default: one per core. The rows do not depend on it."),
    ] = None
    dask: Dask = None
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME.")] = None
    resume: Annotated[
        bool,
        switch(
            "--resume",
            "Extend the finished run in DIR. An interrupted run is always continued.",
        ),
    ] = False
    force: Force = False
    sequence: Annotated[
        bool,
        switch("--sequence", "Run the scenario's sequence: consecutive frames in tracking mode.", _SEQUENCES),
    ] = False
    frames: Annotated[int | None, option("--frames", "N", "Number of frames; default: the scenario's.", _SEQUENCES)] = (
        None
    )
    step_s: Annotated[
        float | None, option("--step-s", "S", "Time between frames, seconds; default: the scenario's.", _SEQUENCES)
    ] = None
    single: Annotated[bool, switch("--single", "Also solve every frame separately, for comparison.", _SEQUENCES)] = (
        False
    )
    animate: Annotated[
        bool, switch("--animate", "Write a GIF of the frames, and an MP4 if ffmpeg is installed.", _SEQUENCES)
    ] = False
    ccsds: Annotated[
        bool,
        switch("--ccsds", "Write the trajectory as OEM, and true and estimated attitudes as AEM and ACM.", _SEQUENCES),
    ] = False
    spice: Annotated[
        bool,
        switch("--spice", "Write the trajectory as SPK, and true and estimated attitudes as CK kernels.", _SEQUENCES),
    ] = False


@dataclass(frozen=True)
class RenderRequest:
    """Render a frame. For several scenarios, --out and --preview are folders."""

    scenarios: ScenarioFiles
    index: Annotated[int | None, option("--index", "I", "Render the frame of this trial; default: 0.")] = None
    at: Annotated[str | None, option("--at", "TIME", "Render the frame at this time (UTC, ISO 8601).")] = None
    pointing: Annotated[
        str | None, option("--pointing", "RA,DEC,ROLL", "Point the camera in this direction (degrees, ICRS).")
    ] = None
    seed: Seed = None
    set_values: SetValues = None
    out: Annotated[Path | None, option("--out", "FRAME.fits", "Write image, camera and truth as FITS.")] = None
    preview: Annotated[
        Path | None, option("--preview", "FRAME.png", "Write a picture (png, jpg, svg, pdf).", _PICTURE)
    ] = None
    colour: Annotated[bool, switch("--colour", "Show the stars in their colours.", _PICTURE)] = False
    axes: Annotated[bool, switch("--axes", "Add pixel axes and names to the picture.", _PICTURE)] = False
    noiseless: Annotated[
        bool, switch("--noiseless", "Switch off all noise and defects of the detector, and the background.")
    ] = False
    noiseless_plane: Annotated[
        bool, switch("--noiseless-plane", "Add the mean photo-electrons to the FITS file (extension MEAN_E).")
    ] = False
    wcs: Annotated[
        Literal["astrometric", "apparent"],
        option(
            "--wcs", "FORM", "World coordinates of the FITS file: astrometric (no aberration) or apparent (with it)."
        ),
    ] = "astrometric"


@dataclass(frozen=True)
class SweepRequest:
    """Run a scenario for many values of its keys: dataset, statistics of every point, plots and sweep.html in DIR."""

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
    lhs: Annotated[int | None, option("--lhs", "N", "Use a Latin hypercube of N points instead of the full grid.")] = (
        None
    )
    trials: Annotated[int | None, option("--trials", "N", "Trials per point; default: the scenario's.")] = None
    seed: Seed = None
    set_values: SetValues = None
    workers: Annotated[int | None, option("--workers", "N", "Processes on this machine; default: one per core.")] = None
    dask: Dask = None
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-sweep.")] = None
    resume: Annotated[
        bool, switch("--resume", "Continue an interrupted sweep in DIR; a finished one is left unchanged.")
    ] = False
    force: Force = False


@dataclass(frozen=True)
class DatasheetRequest:
    """Measure a datasheet in the terms of ECSS-E-ST-60-20C: datasheet.json, .html and .pdf in DIR."""

    scenario: ScenarioFile
    quick: Annotated[bool, switch("--quick", "Use fewer frames, for a first result within a minute.")] = False
    eol_set: Annotated[
        list[str] | None,
        typer.Option(
            "--eol-set",
            metavar="PATH=VALUE",
            help="Override a key at the end of life, which adds a column; may be repeated.",
            autocompletion=complete_key,
        ),
    ] = None
    seed: Seed = None
    set_values: SetValues = None
    workers: Annotated[
        int | None,
        option(
            "--workers", "N", "Processes on this machine; default: one per core. The datasheet does not depend on it."
        ),
    ] = None
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-datasheet.")] = None
    force: Force = False
