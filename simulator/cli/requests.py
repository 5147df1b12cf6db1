"""Options of the commands ``run``, ``render``, ``sweep``, ``datasheet``, ``solve``, ``calibrate`` and ``export-c``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from simulator.cli.options import (
    Catalog,
    Dask,
    ScenarioFile,
    ScenarioFiles,
    Seed,
    SetValues,
    complete_key,
    complete_scenario,
    option,
    switch,
)

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


PARITIES = {"seen": 1, "mirrored": -1, "both": None}


_CAMERA, _DRAWN, _LIST, _ANSWER = "Camera and sky", "Annotated picture", "Lists of centroids", "Output"


@dataclass(frozen=True)
class SolveRequest:
    """Solve images of the sky, or lists of centroids: direction and roll of the camera."""

    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IMAGE]...",
            help="PNG, TIFF, JPEG or FITS files, or folders; - reads standard input, sample is an included photograph.",
            show_default=False,
        ),
    ] = None
    fov_deg: Annotated[
        float | None,
        option("--fov", "DEG", "Field of view across the width, to a few per cent; default: determined.", _CAMERA),
    ] = None
    camera: Annotated[Path | None, option("--camera", "CAMERA.yaml", "Calibrated camera.", _CAMERA)] = None
    method: Annotated[
        str | None, option("--method", "NAME", "Identifier for a known camera; default: adaptive.", _CAMERA)
    ] = None
    estimator: Annotated[
        str | None,
        option("--estimator", "NAME", "Attitude estimator for a known camera; default: field_fit.", _CAMERA),
    ] = None
    catalog: Catalog = "hipparcos"
    magnitude_limit: Annotated[
        float | None,
        option(
            "--magnitude-limit", "V", "Magnitude of the faintest guide star; by default as the picture needs.", _CAMERA
        ),
    ] = None
    parity: Annotated[
        str | None,
        option("--parity", "SIDE", "seen, mirrored or both; default: the camera's, or both without one.", _CAMERA),
    ] = None
    lost_in_space: Annotated[
        bool, switch("--lost-in-space", "Ignore the prior attitude in a frame's header.", _CAMERA)
    ] = False
    time: Annotated[
        str | None, option("--time", "TIME", "Time of the image (UTC), for aberration and planets.", _CAMERA)
    ] = None
    bayer: Annotated[
        str | None, option("--bayer", "PATTERN", "The file is a raw mosaic: RGGB, BGGR, GRBG or GBRG.", _CAMERA)
    ] = None
    bad_pixels: Annotated[
        Path | None,
        option("--bad-pixels", "MAP", "Image of the same size; pixels that are not zero are ignored.", _CAMERA),
    ] = None
    annotate: Annotated[
        Path | None,
        option(
            "--annotate",
            "OUT.png",
            "Write an annotated picture (png, jpg, svg, pdf); for several images, a folder.",
            _DRAWN,
        ),
    ] = None
    grid: Annotated[bool, switch("--grid", "Draw lines of right ascension and declination.", _DRAWN)] = False
    constellations: Annotated[bool, switch("--constellations", "Draw constellation lines.", _DRAWN)] = False
    deep_sky: Annotated[
        bool, switch("--deep-sky/--no-deep-sky", "Mark Messier objects and bright NGC and IC objects.", _DRAWN)
    ] = True
    colour: Annotated[bool, switch("--colour", "Show identified stars of a grey image in their colours.", _DRAWN)] = (
        False
    )
    as_json: Annotated[bool, switch("--json", "Print one JSON object per image.", _ANSWER)] = False
    explain: Annotated[bool, switch("--explain", "Print what each stage found, tried and rejected.", _ANSWER)] = False
    pixels: Annotated[
        list[str] | None,
        option("--pixel", "X,Y", "Print right ascension and declination of a pixel; may be repeated.", _ANSWER),
    ] = None
    wcs: Annotated[
        Path | None,
        option("--wcs", "OUT.fits", "Write the image with world coordinates; for several images, a folder.", _ANSWER),
    ] = None
    centroids: Annotated[
        Path | None,
        option(
            "--centroids", "FILE.csv", "Solve a list (columns x, y and optionally flux) instead of an image.", _LIST
        ),
    ] = None
    size: Annotated[str | None, option("--size", "WxH", "Image size in pixels, for --centroids with --fov.", _LIST)] = (
        None
    )

    @property
    def sides(self) -> int | None:
        """Parity asked for: 1 as seen, -1 mirrored, None both."""
        return None if self.parity is None else PARITIES[self.parity]


@dataclass(frozen=True)
class CalibrateRequest:
    """Calibrate a camera from photographs of the sky: focal length, principal point, distortion, with uncertainties."""

    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="Photographs or frames of one camera with fixed focus and zoom, or folders of them.",
            show_default=False,
        ),
    ]
    out: Annotated[Path, option("--out", "CAMERA.yaml", "Camera file to write.")] = Path("camera.yaml")
    plot: Annotated[Path | None, option("--plot", "OUT.png", "Write a plot of the residuals.")] = None
    camera: Annotated[Path | None, option("--camera", "ROUGH.yaml", "Approximate camera, accurate to 5 %.")] = None
    fov_deg: Annotated[
        float | None, option("--fov", "DEG", "Field of view across the width, to 5 %; default: determined.")
    ] = None
    projection: Annotated[str, option("--projection", "NAME", "pinhole, fisheye, or auto (the better fit).")] = "auto"
    refraction: Annotated[
        bool, switch("--refraction", "Also fit differential atmospheric refraction (from the ground).")
    ] = False
    epoch_jyear: Annotated[
        float | None, option("--epoch", "YEAR", "Date of the images, such as 2026.2; default: the catalogue's epoch.")
    ] = None
    catalog: Catalog = "hipparcos"
    centroider: Annotated[str, option("--centroider", "NAME", "Centroiding method.")] = "least_squares"
    parameters: Annotated[
        str | None,
        option(
            "--parameters",
            "A,B,...",
            "Parameters to fit (f, aspect, cx, cy, k1 ...); default: as the images determine.",
        ),
    ] = None


_SCENARIO, _CAMERA = "Camera of a scenario", "Camera without a scenario"


@dataclass(frozen=True)
class ExportRequest:
    """Write the star tracker of one camera as C99 source with its tables, and print its memory and time.

    From rows of pixels to attitude, or from centroids. With --scenario for the camera of a scenario; without it from
    centroids, for a camera without distortion and the stars of the Bright Star Catalogue.
    """

    out: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the source.", show_default=False)]
    prefix: Annotated[str, option("--prefix", "NAME", "Prefix of all names in the C source.")] = "tracker"
    source: Annotated[
        str | None,
        option("--from", "KIND", "frames or centroids; default: frames with --scenario, else centroids."),
    ] = None
    arithmetic: Annotated[
        str | None,
        option(
            "--arithmetic",
            "KIND",
            "fixed: integers; float: attitude in single precision; default: as in the scenario, else fixed.",
        ),
    ] = None
    identifier: Annotated[
        str | None,
        option("--identifier", "NAME", "adaptive or triads; default: as in the scenario, else triads."),
    ] = None
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="SCENARIO",
            help="Scenario YAML, or an included scenario by name.",
            autocompletion=complete_scenario,
            rich_help_panel=_SCENARIO,
        ),
    ] = None
    set_values: SetValues = None
    size: Annotated[str, option("--size", "WxH", "Image size, pixels.", _CAMERA)] = "427x319"
    fov: Annotated[str, option("--fov", "WxH", "Field of view, degrees.", _CAMERA)] = "9.0130x6.9049"
    declination: Annotated[str, option("--declination", "A:B", "Range of declinations, degrees.", _CAMERA)] = "30:90"
    magnitude_limit: Annotated[float, option("--magnitude-limit", "V", "Magnitude of the faintest star.", _CAMERA)] = (
        6.0
    )
    false_alarm_rate: Annotated[
        float, option("--false-alarm-rate", "P", "Maximum false-alarm probability.", _CAMERA)
    ] = 1e-7
    tolerance_deg: Annotated[
        float | None,
        option("--tolerance", "DEG", "Triads: tolerance of separations; default: from the stars' errors.", _CAMERA),
    ] = None
    rotation_tolerance_deg: Annotated[
        float, option("--rotation-tolerance", "DEG", "Triads: tolerance of rotations and of their groups.", _CAMERA)
    ] = 5.0
    enclosed_tolerance_deg: Annotated[
        float, option("--enclosed-tolerance", "DEG", "Triads: tolerance of inner angles; 0: no test.", _CAMERA)
    ] = 1.0
    vote_number: Annotated[
        int, option("--vote-number", "N", "Triads: minimum number of votes for a star.", _CAMERA)
    ] = 2
    max_separation_deg: Annotated[float | None, typer.Option("--max-separation", hidden=True)] = None
    centroid_error_px: Annotated[float | None, typer.Option("--centroid-error", hidden=True)] = None
    resolution_px: Annotated[float | None, typer.Option("--resolution", hidden=True)] = None
    edition: Annotated[int | None, typer.Option("--edition", hidden=True)] = None
