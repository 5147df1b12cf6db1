"""The application ``boresight``: its commands and options. The commands only call the library.

Each command's module is imported when the command is called, which keeps ``--help`` fast.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.cli.catalog_command import catalog_app
from simulator.cli.live_request import ServeRequest
from simulator.cli.options import ScenarioFile, ScenarioFiles, SetValues, as_command, option, switch
from simulator.cli.requests import (
    CalibrateRequest,
    DatasheetRequest,
    ExportRequest,
    RenderRequest,
    RunRequest,
    SolveRequest,
    SweepRequest,
)
from simulator.cli.stimulate_command import stimulate_app
from simulator.cli.streams import OutputError, flush_output, output_failed, say
from simulator.cli.study_command import study_app
from simulator.cli.suggesting import SuggestingGroup, usage_error_line
from startracker._version import __version__
from startracker.errors import BoresightError, InputWarning

# Arrow's own allocator keeps some 10 to 20 MB of what it had once; workers get the variable with the environment
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")

app = typer.Typer(
    name="boresight",
    cls=SuggestingGroup,
    help="A simulator of a star camera in orbit, and a star tracker that solves its frames and photographs of the sky.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"boresight {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        from simulator.cli.welcome import welcome_text

        typer.echo(welcome_text())


def report_command(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Results folder of `boresight run`.", show_default=False)
    ],
    pdf: Annotated[bool, switch("--pdf", "Also write report.pdf.")] = False,
    budget: Annotated[
        Path | None, option("--budget", "FILE", "Error budget to include, from `boresight study budget`.")
    ] = None,
) -> None:
    """Write the report of a finished run again from its files: report.html and, with --pdf, report.pdf."""
    from simulator.cli.report_command import report_of_folder

    raise typer.Exit(report_of_folder(folder, pdf, budget))


def compare_command(
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN_DIR...",
            help="Results folders of boresight run, or of boresight sweep (all points; DIR:3 for one).",
            show_default=False,
        ),
    ],
    out: Annotated[Path, option("--out", "PAGE.html", "Page to write.")] = Path("comparison.html"),
) -> None:
    """Compare runs: differences of their scenarios, errors with intervals, rates and times."""
    from simulator.cli.sweep_command import compare_runs

    raise typer.Exit(compare_runs(runs, out))


def validate_command(scenarios: ScenarioFiles) -> None:
    """Check scenarios, and report every error with file, line and key."""
    from simulator.cli.scenario_commands import validate

    raise typer.Exit(validate(scenarios))


def show_command(scenario: ScenarioFile, set_values: SetValues = None) -> None:
    """Print a scenario with all defaults, and the values of the detector after the radiation of its age."""
    from simulator.cli.scenario_commands import show

    raise typer.Exit(show(scenario, set_values or []))


def schema_command() -> None:
    """Print the JSON schema of scenarios, for editors."""
    from simulator.cli.scenario_commands import schema

    raise typer.Exit(schema())


def warm_up_command() -> None:
    """Compile the kernels ahead of their first use, on all cores; once for an installation."""
    from simulator.cli.warm_up_command import warm_up

    raise typer.Exit(warm_up())


_SIMULATE, _SOLVE, _RESULTS = "Simulate", "Solve frames and photographs", "Results"
_SCENARIOS, _FLIGHT, _INSTALLATION = "Scenarios", "Flight software", "Installation"
_COMMANDS: tuple[tuple[str, Callable[..., None], str, str], ...] = (
    ("run", as_command(RunRequest, "run_command"), _SIMULATE, "boresight run cubesat --trials 200"),
    ("render", as_command(RenderRequest, "render_command"), _SIMULATE, "boresight render moon --preview moon.png"),
    ("sweep", as_command(SweepRequest, "sweep_command"), _SIMULATE,
     "boresight sweep cubesat --over optics.aperture_mm=6:24:7"),
    ("datasheet", as_command(DatasheetRequest, "datasheet_command"), _SIMULATE, "boresight datasheet cubesat --quick"),
    ("serve", as_command(ServeRequest, "serve_command"), _SIMULATE, "boresight serve cubesat"),
    ("solve", as_command(SolveRequest, "solve_command"), _SOLVE, "boresight solve photo.jpg --annotate solved.png"),
    ("calibrate", as_command(CalibrateRequest, "calibrate_command"), _SOLVE,
     "boresight calibrate *.tiff --out camera.yaml --plot fit.png"),
    ("report", report_command, _RESULTS, "boresight report out/cubesat --pdf"),
    ("compare", compare_command, _RESULTS, "boresight compare out/a out/b"),
    ("validate", validate_command, _SCENARIOS, "boresight validate my.yaml"),
    ("show", show_command, _SCENARIOS, "boresight show cubesat > my.yaml"),
    ("schema", schema_command, _SCENARIOS, "boresight schema > schema.json"),
    ("warm-up", warm_up_command, _INSTALLATION, "boresight warm-up"),
    ("export-c", as_command(ExportRequest, "c_source"), _FLIGHT, "boresight export-c tracker/ --scenario cubesat"),
)  # fmt: skip
"""Name, function, group and example of each command."""
for _name, _function, _group, _example in _COMMANDS:
    app.command(_name, rich_help_panel=_group, epilog=f"Example: {_example}")(_function)
app.add_typer(study_app, name="study", rich_help_panel=_SIMULATE)
app.add_typer(stimulate_app, name="stimulate", rich_help_panel=_SIMULATE)
app.add_typer(catalog_app, name="catalog", rich_help_panel=_INSTALLATION)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """What has no effect in a user's input, one line each on standard error."""
    with warnings.catch_warnings():
        others = warnings.showwarning
        printed: set[str] = set()  # a scenario's files are read by its check and again by its run

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                if str(message) in printed:
                    return
                printed.add(str(message))
                print(f"warning: {message}", file=sys.stderr)
            else:
                others(message, category, *where, **more)

        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


@_warnings_in_one_line()
def run_application(arguments: list[str]) -> int:
    """Run a command and return its exit status; a user's mistake is one line on standard error and status 2."""
    try:
        status = _status(arguments)
        flush_output()  # also after a mistake: what was printed before it may not fit on the device
        return status
    except OutputError as error:
        return output_failed(error.cause)
    except OSError as error:
        return output_failed(error)


def _status(arguments: list[str]) -> int:
    """Exit status of a command, with one line on standard error for a mistake."""
    try:
        code: Any = app(args=arguments, prog_name="boresight", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except typer.TyperException as error:  # a wrong option or argument
        say(usage_error_line(error))
        return 2
    except BoresightError as error:
        say(error)
        return 2
    except typer.Abort:  # an interrupt that no command handled
        raise KeyboardInterrupt from None
