"""The command ``boresight``: a face over the library, nothing of its own inside.

Each command's module loads where it is called, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.cli.export_command import export_c_command
from simulator.cli.photograph_commands import calibrate_command, solve_command
from simulator.cli.study_command import study_app
from startracker._version import __version__
from startracker.compilation import progress
from startracker.errors import BoresightError, InputWarning

# Arrow's own allocator keeps some 10 to 20 MB of what it had once; workers get the variable with the environment
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")

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
Force = Annotated[
    bool,
    typer.Option("--force", help="Compute everything again, and replace results of another run that stand in DIR."),
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
        bool,
        typer.Option(
            "--resume",
            help="Make a finished run longer by its trials in DIR. Those of an interrupted run are taken over anyway.",
        ),
    ] = False,
    force: Force = False,
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
        request = SequenceRequest(scenario, frames, step_s, seed, set_values or [], single, animate, out, force)
        raise typer.Exit(run_sequence_command(request))
    only = {"--frames": frames, "--step-s": step_s, "--single": single, "--animate": animate}
    refuse_unused(only, sequence=False)
    from simulator.cli.run_command import run_study

    raise typer.Exit(run_study(scenario, trials, seed, set_values or [], workers, out, resume, dask, force))


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


app.command("solve")(solve_command)
app.command("calibrate")(calibrate_command)


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
        int | None, typer.Option("--trials", metavar="N", help="Trials per point, in place of the scenario's.")
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
        bool, typer.Option("--resume", help="Go on from an interrupted sweep in DIR; a finished one stays as it is.")
    ] = False,
    force: Force = False,
) -> None:
    """Run a scenario at many values of its keys: one dataset, statistics of every point, plots, sweep.html in DIR."""
    from simulator.cli.sweep_command import run_sweep_command

    code = run_sweep_command(scenario, over, lhs, trials, seed, set_values or [], workers, out, resume, dask, force)
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
    progress.announce("solve" if sys.argv[1:2] == ["solve"] else "run")
    sys.exit(_run(sys.argv[1:]))


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """What has no effect in a user's input, one line each on standard error."""
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                print(f"warning: {message}", file=sys.stderr)
            else:
                others(message, category, *where, **more)

        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


@_warnings_in_one_line()
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
