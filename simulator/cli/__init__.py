"""The command ``boresight``: a face over the library, nothing of its own inside.

Each command's module loads where it is called, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.cli.export_command import export_c_command
from simulator.cli.study_command import study_app
from startracker._version import __version__
from startracker.errors import BoresightError

app = typer.Typer(
    name="boresight",
    help="A star camera in orbit, simulated; a star tracker that solves its frames, and real photographs of the sky.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(study_app, name="study")
app.command("export-c")(export_c_command)

ScenarioFile = Annotated[
    Path,
    typer.Argument(help="Scenario YAML, or one that ships (sunsat, cubesat, tc211, orbit, slew).", show_default=False),
]
ScenarioFiles = Annotated[
    list[Path],
    typer.Argument(metavar="SCENARIO...", help="Scenario YAMLs, or names of those that ship.", show_default=False),
]
Dask = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Run on the workers of the dask.distributed scheduler there instead."
    ),
]
SetValues = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Override a key, e.g. optics.aperture_mm=25; may be repeated."),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="S", help="In place of the scenario's seed.")]


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"boresight {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command("run")
def run_command(
    scenario: ScenarioFile,
    trials: Annotated[
        int | None, typer.Option("--trials", metavar="N", help="In place of the scenario's number of trials.")
    ] = None,
    seed: Seed = None,
    set_values: SetValues = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            help="Processes on this machine; default: its cores. The rows do not depend on it.",
        ),
    ] = None,
    dask: Dask = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results; default: out/NAME.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the trials that an interrupted run left in DIR.")
    ] = False,
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence", help="Run the scenario's sequence instead: frames one after the other, in tracking mode."
        ),
    ] = False,
    frames: Annotated[
        int | None, typer.Option("--frames", metavar="N", help="Of a sequence, in place of the scenario's number.")
    ] = None,
    step_s: Annotated[
        float | None, typer.Option("--step-s", metavar="S", help="Of a sequence, in place of the scenario's step.")
    ] = None,
    single: Annotated[
        bool, typer.Option("--single", help="Of a sequence: solve every frame alone too, to compare.")
    ] = False,
    animate: Annotated[
        bool,
        typer.Option("--animate", help="Of a sequence: a GIF of the frames, and an MP4 where ffmpeg is installed."),
    ] = False,
) -> None:
    """Run a Monte Carlo study: statistics on the terminal, trials.parquet, summary.json and report.html in DIR."""
    from simulator.cli.sequence_command import SequenceRequest, refuse_unused, run_sequence_command

    if sequence:
        refuse_unused({"--trials": trials, "--workers": workers, "--dask": dask, "--resume": resume}, sequence=True)
        request = SequenceRequest(scenario, frames, step_s, seed, set_values or [], single, animate, out)
        raise typer.Exit(run_sequence_command(request))
    only = {"--frames": frames, "--step-s": step_s, "--single": single, "--animate": animate}
    refuse_unused(only, sequence=False)
    from simulator.cli.run_command import run_study

    raise typer.Exit(run_study(scenario, trials, seed, set_values or [], workers, out, resume, dask))


@app.command("render")
def render_command(
    scenarios: ScenarioFiles,
    index: Annotated[
        int | None, typer.Option("--index", metavar="I", help="The frame of this trial; default 0.")
    ] = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="TIME", help="The frame at this UTC time (ISO 8601) instead.")
    ] = None,
    pointing: Annotated[
        str | None,
        typer.Option("--pointing", metavar="RA,DEC,ROLL", help="Point the camera there (degrees, ICRS) instead."),
    ] = None,
    seed: Seed = None,
    set_values: SetValues = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FRAME.fits", help="Write image, camera and truth as FITS.")
    ] = None,
    preview: Annotated[Path | None, typer.Option("--preview", metavar="FRAME.png", help="Write a picture.")] = None,
    noiseless: Annotated[
        bool, typer.Option("--noiseless", help="Switch off every noise and flaw of the detector, and the background.")
    ] = False,
    noiseless_plane: Annotated[
        bool, typer.Option("--noiseless-plane", help="Add the light before the detector to the FITS file (MEAN_E).")
    ] = False,
) -> None:
    """Render a frame; of several scenarios one each, --out and --preview then name folders."""
    from simulator.cli.render_command import render_frames

    raise typer.Exit(
        render_frames(scenarios, index, at, pointing, seed, set_values or [], out, preview, noiseless, noiseless_plane)
    )


@app.command("solve")
def solve_command(
    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IMAGE]...", help="PNG, TIFF, JPEG or FITS files, or folders of them.", show_default=False
        ),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option(
            "--fov", metavar="DEG", help="Field of view across the width, to a few per cent; default: found out."
        ),
    ] = None,
    camera: Annotated[Path | None, typer.Option("--camera", metavar="CAMERA.yaml", help="Calibrated camera.")] = None,
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Identifier, for a known camera; default: adaptive."),
    ] = None,
    catalog: Annotated[
        str, typer.Option("--catalog", metavar="NAME", help="Star catalogue: hipparcos or bsc5.")
    ] = "hipparcos",
    magnitude_limit: Annotated[
        float, typer.Option("--magnitude-limit", metavar="V", help="Faintest guide star.")
    ] = 6.5,
    centroids: Annotated[
        Path | None,
        typer.Option(
            "--centroids",
            metavar="FILE.csv",
            help="Solve a list of centroids (columns x, y and optionally flux) instead of an image.",
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", metavar="WxH", help="Image size in pixels, for --centroids with --fov.")
    ] = None,
    lost_in_space: Annotated[
        bool, typer.Option("--lost-in-space", help="Ignore the prior attitude in a frame's header.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object an image.")] = False,
    wcs: Annotated[
        Path | None, typer.Option("--wcs", metavar="OUT.fits", help="Write the image with its world coordinates.")
    ] = None,
    annotate: Annotated[
        Path | None, typer.Option("--annotate", metavar="OUT.png", help="Write the picture with its identified stars.")
    ] = None,
    grid: Annotated[bool, typer.Option("--grid", help="Lines of right ascension and declination on it.")] = False,
    constellations: Annotated[
        bool, typer.Option("--constellations", help="Lines of the constellations on it.")
    ] = False,
    pixel: Annotated[
        list[str] | None,
        typer.Option("--pixel", metavar="X,Y", help="Tell where this pixel looks; may be repeated."),
    ] = None,
    parity: Annotated[
        str | None,
        typer.Option(
            "--parity", metavar="SIDE", help="seen, mirrored or both; default: the camera's, or both without one."
        ),
    ] = None,
    bayer: Annotated[
        str | None,
        typer.Option("--bayer", metavar="PATTERN", help="The file is a raw mosaic: RGGB, BGGR, GRBG or GBRG."),
    ] = None,
    bad_pixels: Annotated[
        Path | None,
        typer.Option(
            "--bad-pixels", metavar="MAP", help="Image of the same size, not zero where a pixel is not to be used."
        ),
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Tell stage by stage what was found, tried and rejected.")
    ] = False,
) -> None:
    """Solve images of the sky, or lists of centroids: where did the camera look?"""
    from simulator.cli.solve_command import SolveRequest, solve_images

    request = SolveRequest(
        images=images or [],
        fov_deg=fov,
        camera=camera,
        method=method,
        catalog=catalog,
        magnitude_limit=magnitude_limit,
        centroids=centroids,
        size=size,
        lost_in_space=lost_in_space,
        as_json=as_json,
        wcs=wcs,
        annotate=annotate,
        explain=explain,
        grid=grid,
        constellations=constellations,
        pixels=tuple(pixel or ()),
        parity=parity,
        bayer=bayer,
        bad_pixels=bad_pixels,
    )
    raise typer.Exit(solve_images(request))


@app.command("calibrate")
def calibrate_command(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="Photographs or frames by one camera at one focus and zoom, or folders of them.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="CAMERA.yaml", help="Camera file to write.")] = Path(
        "camera.yaml"
    ),
    plot: Annotated[Path | None, typer.Option("--plot", metavar="OUT.png", help="Write a figure of residuals.")] = None,
    camera: Annotated[
        Path | None, typer.Option("--camera", metavar="ROUGH.yaml", help="What is known of the camera, to 5 %.")
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option("--fov", metavar="DEG", help="Field of view across the width, to 5 %; default: found out."),
    ] = None,
    projection: Annotated[
        str, typer.Option("--projection", metavar="NAME", help="pinhole, fisheye, or auto: what fits better.")
    ] = "auto",
    refraction: Annotated[
        bool, typer.Option("--refraction", help="Taken from the ground: fit the air's differential refraction along.")
    ] = False,
    epoch: Annotated[
        float | None,
        typer.Option("--epoch", metavar="YEAR", help="When taken, such as 2026.2; default: the catalogue's epoch."),
    ] = None,
    catalog: Annotated[
        str, typer.Option("--catalog", metavar="NAME", help="Star catalogue: hipparcos or bsc5.")
    ] = "hipparcos",
    centroider: Annotated[
        str, typer.Option("--centroider", metavar="NAME", help="How stars are measured.")
    ] = "least_squares",
    parameters: Annotated[
        str | None,
        typer.Option("--parameters", metavar="A,B,...", help="Fit these (f, aspect, cx, cy, k1 ...), not what tells."),
    ] = None,
) -> None:
    """Calibrate a camera from photographs of the sky: focal length, principal point, distortion, with uncertainties."""
    from simulator.cli.calibrate_command import CalibrateRequest, calibrate_images

    request = CalibrateRequest(
        images=images,
        out=out,
        plot=plot,
        camera=camera,
        fov_deg=fov,
        projection=projection,
        refraction=refraction,
        epoch_jyear=epoch,
        catalog=catalog,
        centroider=centroider,
        parameters=parameters,
    )
    raise typer.Exit(calibrate_images(request))


@app.command("sweep")
def sweep_command(
    scenario: ScenarioFile,
    over: Annotated[
        list[str],
        typer.Option(
            "--over",
            metavar="PATH=VALUES",
            help="Values of a key: low:high:count, low:high:count,log or a list v1,v2,...; may be repeated.",
            show_default=False,
        ),
    ],
    lhs: Annotated[
        int | None,
        typer.Option("--lhs", metavar="N", help="A Latin hypercube of N points instead of the full grid."),
    ] = None,
    trials: Annotated[
        int | None, typer.Option("--trials", metavar="N", help="Trials a point, in place of the scenario's.")
    ] = None,
    seed: Seed = None,
    set_values: SetValues = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", help="Processes on this machine; default: its cores."),
    ] = None,
    dask: Dask = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results; default: out/NAME-sweep.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the points that an interrupted sweep left in DIR.")
    ] = False,
) -> None:
    """Run a scenario at many values of its keys: one dataset, statistics of every point, plots, sweep.html in DIR."""
    from simulator.cli.sweep_command import run_sweep_command

    code = run_sweep_command(scenario, over, lhs, trials, seed, set_values or [], workers, out, resume, dask)
    raise typer.Exit(code)


@app.command("report")
def report_command(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder that `boresight run` left.", show_default=False)
    ],
    pdf: Annotated[bool, typer.Option("--pdf", help="Write report.pdf too.")] = False,
    budget: Annotated[
        Path | None,
        typer.Option("--budget", metavar="FILE", help="Error budget to take in: that of `boresight study budget`."),
    ] = None,
) -> None:
    """Write the report of a finished run again, from its files: report.html, and report.pdf for signing."""
    from simulator.cli.report_command import report_of_folder

    raise typer.Exit(report_of_folder(folder, pdf, budget))


@app.command("compare")
def compare_command(
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN_DIR...",
            help="Folders of boresight run, or of boresight sweep (all its points; DIR:3 for one).",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="PAGE.html", help="Page to write.")] = Path("comparison.html"),
) -> None:
    """Compare runs: what differs in their scenarios, errors with intervals, rates and times."""
    from simulator.cli.sweep_command import compare_runs

    raise typer.Exit(compare_runs(runs, out))


@app.command("validate")
def validate_command(
    scenarios: Annotated[list[Path], typer.Argument(metavar="SCENARIO...", show_default=False)],
) -> None:
    """Check scenarios: every mistake at once, each with file, line and key."""
    from simulator.cli.scenario_commands import validate

    raise typer.Exit(validate(scenarios))


@app.command("show")
def show_command(scenario: ScenarioFile, set_values: SetValues = None) -> None:
    """Print a scenario with every default spelled out."""
    from simulator.cli.scenario_commands import show

    raise typer.Exit(show(scenario, set_values or []))


@app.command("schema")
def schema_command() -> None:
    """Print the JSON schema of scenarios, for editors."""
    from simulator.cli.scenario_commands import schema

    raise typer.Exit(schema())


def main() -> None:
    """Entry point: every failure one clear line on standard error, status 2; never a traceback for a user's mistake."""
    sys.exit(_run(sys.argv[1:]))


def _run(arguments: list[str]) -> int:
    try:
        code: Any = app(args=arguments, standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except typer.TyperException as error:  # a wrong option or argument
        message = error.format_message() if hasattr(error, "format_message") else str(error)
        print(f"boresight: {' '.join(message.split())} (boresight --help tells more)", file=sys.stderr)
        return 2
    except BoresightError as error:
        print(error, file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        print("boresight: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
