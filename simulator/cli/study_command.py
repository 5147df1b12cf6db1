"""``boresight study NAME``: studies that answer one question each, in a registry by name.

A study is a command that returns the exit status, or raises it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.cli.checks import at_least
from simulator.cli.environment_command import environment_study
from simulator.cli.options import ScenarioFile, SetValues, as_command, option, switch
from simulator.cli.printed_command import PictureRequest, greyling1995_study
from simulator.cli.suggesting import SuggestingGroup
from simulator.cli.terminal import open_console, progress_bar

AlongPath = Annotated[bool, switch("--path", "Use the boresight path of the mission instead of the whole sky.")]
Force = Annotated[bool, switch("--force", "Replace results of another scenario, version or longer study in DIR.")]
Workers = Annotated[int, option("--workers", "N", "Processes on this machine.")]


def coverage_study(
    scenario: ScenarioFile,
    magnitude_limit: Annotated[
        float | None,
        option(
            "--magnitude-limit",
            "V",
            "Magnitude of the faintest star counted; default: that of the guide catalogue or of detection.",
        ),
    ] = None,
    snr: Annotated[
        float | None,
        option("--snr", "R", "Signal-to-noise ratio of the faintest detected star; default: the tracker's."),
    ] = None,
    circle_deg: Annotated[
        float | None, option("--circle-deg", "R", "Use a circular field of this radius instead of the camera's.")
    ] = None,
    sun_deg: Annotated[float | None, option("--sun-deg", "A", "Exclusion angle of the Sun.")] = None,
    moon_deg: Annotated[float | None, option("--moon-deg", "A", "Exclusion angle of the Moon.")] = None,
    earth_deg: Annotated[float | None, option("--earth-deg", "A", "Exclusion angle from the Earth's limb.")] = None,
    boresights: Annotated[
        int, option("--boresights", "N", "Directions over the sky, or instants along the path.")
    ] = 10_000,
    rolls: Annotated[int, option("--rolls", "N", "Number of rolls for each direction.")] = 1,
    path: AlongPath = False,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-coverage.")] = None,
    force: Force = False,
) -> int:
    """Stars in the field over the whole sky or along the path: map, minimum, availability."""
    from simulator.checks import load_scenario
    from simulator.cli.study_output import print_coverage
    from simulator.study.coverage.boresights import exclusion_of
    from simulator.study.coverage.maps import coverage_figures
    from simulator.study.coverage.survey import coverage
    from simulator.study.result_files import write_study
    from simulator.study.results_folder import study_folder

    loaded = load_scenario(scenario, set_values)
    exclusion = exclusion_of(loaded, {"sun": sun_deg, "moon": moon_deg, "earth": earth_deg})
    asked: dict[str, Any] = {
        "path": path,
        "rolls": rolls,
        "magnitude_limit": magnitude_limit,
        "snr": snr,
        "circle_deg": circle_deg,
        "exclusion": exclusion,
    }
    amounts = {"boresights": boresights}
    with study_folder("coverage", loaded, out, force, amounts, coverage=True, **asked) as (folder, identity):
        result = coverage(loaded, boresights, **asked)
        figures = coverage_figures(result)
        files = write_study(folder, "coverage", result.summary(), identity, figures, result.to_table(loaded))
    print_coverage(result, open_console())
    print(f"{folder}: {', '.join(files)}")
    return 0


def design_study(
    scenario: ScenarioFile,
    over: Annotated[str, option("--over", "PARAMETER", "optics.aperture_mm, field (degrees) or detector.exposure_s.")],
    low: Annotated[float, option("--from", "A", "Smallest value.")],
    high: Annotated[float, option("--to", "B", "Largest value.")],
    steps: Annotated[int, option("--steps", "N", "Number of values in the table.")] = 12,
    stars: Annotated[int, option("--stars", "K", "Number of stars that an attitude requires.")] = 5,
    availability: Annotated[
        float | None,
        option(
            "--availability",
            "P",
            "Fraction of the sky, or of the time, with enough stars; default: the specification's, otherwise 0.999.",
        ),
    ] = None,
    boresights: Annotated[int, option("--boresights", "N", "Number of attitudes.")] = 5000,
    path: AlongPath = False,
    verify_trials: Annotated[
        int | None,
        option(
            "--verify",
            "N",
            "Run this many trials of the value found, and of larger ones while they contradict it; 0: none; "
            "default: enough for a verdict, 1965 for 99.7 %.",
        ),
    ] = None,
    workers: Workers = 1,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-design.")] = None,
    force: Force = False,
) -> int:
    """Find the smallest aperture, field or exposure that meets the specification and an availability."""
    from simulator.checks import load_scenario
    from simulator.cli.study_output import print_design, print_verified
    from simulator.study.design.plot import design_plot
    from simulator.study.design.search import Search, Trade, design
    from simulator.study.design.verification import Verified, trials_for, verified_design
    from simulator.study.result_files import write_study
    from simulator.study.results_folder import study_folder

    at_least(0, verify=verify_trials)
    at_least(1, workers=workers)
    loaded = load_scenario(scenario, set_values)
    trials = trials_for(loaded) if verify_trials is None else verify_trials
    progress, console = open_console(error=True), open_console()
    trade = Trade(over, low, high, steps, stars, availability, boresights, path)
    asked: dict[str, Any] = {n: getattr(trade, n) for n in ("steps", "least_stars", "least_availability", "path")}
    asked |= {"design": (over, low, high)}
    amounts = {"boresights": boresights, "verification trials": trials}
    with study_folder("design", loaded, out, force, amounts, **asked) as (folder, identity):
        with progress.status("computing") as status:
            search = Search(loaded, trade, lambda done: status.update(f"computing: {done} values of {over}"))
            found = Verified(design(loaded, trade, search=search), ())
        print_design(found.design, console)
        if trials and found.design.best is not None:
            with progress.status("verifying") as status:

                def report(run: int, value: float) -> None:
                    status.update(f"verifying: run {run}, {trials} trials at {value:.4g}")

                found = verified_design(loaded, trade, trials, workers, search, report)
            print_verified(found, console)
        files = write_study(folder, "design", found.to_dict(), identity, {"design": design_plot(found)})
    print(f"{folder}: {', '.join(files)}")
    return 1 if found.design.best is None or found.contradicted else 0


def budget_study(
    scenario: ScenarioFile,
    trials: Annotated[int, option("--trials", "N", "Trials per run.")] = 200,
    workers: Workers = 1,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-budget.")] = None,
    force: Force = False,
) -> int:
    """Contribution of each effect, switched off one at a time, and of the classes of ECSS-E-ST-60-20C."""
    from dataclasses import replace

    from simulator.checks import load_scenario
    from simulator.study.budget.error_budget import budget
    from simulator.study.budget.plot import budget_figure
    from simulator.study.result_files import write_study
    from simulator.study.results_folder import standing, study_folder

    loaded = load_scenario(scenario, set_values)
    with study_folder("budget", loaded, out, force, {"trials": trials}, budget=True) as (folder, identity):
        with progress_bar(f"{loaded.name}: error budget", "trials") as progress:
            result = budget(loaded, trials, workers, progress=progress)
        print(result.table())
        if result.interrupted and not force and standing(folder, "budget"):
            print(f"{folder}: the previous budget is kept, as this one was interrupted")
            return 130
        stated = replace(identity, amounts={"trials": 0}) if result.interrupted else identity
        files = write_study(folder, "budget", result.to_dict(), stated, {"budget": budget_figure(result)})
    print(f"{folder}: {', '.join(files)}")
    return 130 if result.interrupted else 0


STUDIES: dict[str, Callable[..., int | None]] = {
    "coverage": coverage_study,
    "design": design_study,
    "budget": budget_study,
    "environment": environment_study,
    "greyling1995": greyling1995_study,
    "yee1999": as_command(PictureRequest, "yee_picture"),
}
"""Name of a study to its function."""


study_app = typer.Typer(
    cls=SuggestingGroup,
    help="Studies of a camera: sky coverage, design, error budget, radiation; two theses recomputed.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_EXAMPLES = {
    "coverage": "boresight study coverage cubesat",
    "design": "boresight study design cubesat --over optics.aperture_mm --from 3 --to 30",
    "budget": "boresight study budget cubesat --trials 200",
    "environment": "boresight study environment aged",
    "greyling1995": "boresight study greyling1995 --section chapter-4",
    "yee1999": "boresight study yee1999",
}
for _name, _function in STUDIES.items():
    study_app.command(_name, epilog=f"Example: {_EXAMPLES[_name]}")(_function)
