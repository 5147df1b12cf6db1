"""``boresight study NAME``: studies that answer one question each, in a registry by name.

A study is a command that returns the exit status, or raises it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from simulator.cli.checks import at_least
from simulator.cli.environment_command import environment_study
from simulator.cli.options import ScenarioFile, SetValues, as_command, option, switch
from simulator.cli.printed_command import PictureRequest, greyling1995_study
from simulator.cli.suggesting import SuggestingGroup
from simulator.cli.terminal import open_console, print_table, progress_bar

if TYPE_CHECKING:
    from rich.console import Console

    from simulator.study.coverage.survey import Coverage
    from simulator.study.design.search import Design, Verification

__all__ = ["STUDIES", "study_app"]

AlongPath = Annotated[bool, switch("--path", "Along the mission's boresight path in place of the whole sky.")]
Force = Annotated[bool, switch("--force", "Replace results of another scenario, version or longer study in DIR.")]
Workers = Annotated[int, option("--workers", "N", "Processes on this machine.")]


def coverage_study(
    scenario: ScenarioFile,
    magnitude_limit: Annotated[
        float | None,
        option(
            "--magnitude-limit",
            "V",
            "Faintest star counted; default: the faintest that the tracker knows and the camera detects.",
        ),
    ] = None,
    snr: Annotated[
        float | None, option("--snr", "R", "Signal-to-noise ratio of a detection; default: the tracker's.")
    ] = None,
    circle_deg: Annotated[
        float | None, option("--circle-deg", "R", "A circular field of this radius in place of the camera's.")
    ] = None,
    sun_deg: Annotated[float | None, option("--sun-deg", "A", "Exclusion angle of the Sun.")] = None,
    moon_deg: Annotated[float | None, option("--moon-deg", "A", "Exclusion angle of the Moon.")] = None,
    earth_deg: Annotated[float | None, option("--earth-deg", "A", "Exclusion angle from the Earth's limb.")] = None,
    boresights: Annotated[
        int, option("--boresights", "N", "Directions over the sky, or instants along the path.")
    ] = 10_000,
    rolls: Annotated[int, option("--rolls", "N", "Rolls tried at each direction.")] = 1,
    path: AlongPath = False,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-coverage.")] = None,
    force: Force = False,
) -> int:
    """Stars in the field over the whole sky or along the path: map, minima, availability."""
    from simulator.checks import load_scenario
    from simulator.study.coverage.boresights import Exclusion
    from simulator.study.coverage.files import RESULT_FILES, write_coverage
    from simulator.study.coverage.survey import baffle_exclusion, coverage
    from simulator.study.results_folder import Identity, results_folder, scenario_sha256

    loaded = load_scenario(scenario, set_values)
    baffle = baffle_exclusion(loaded)
    given = {"sun_deg": sun_deg, "moon_deg": moon_deg, "earth_deg": earth_deg}
    exclusion = Exclusion(**{name: getattr(baffle, name) if angle is None else angle for name, angle in given.items()})
    asked: dict[str, Any] = {
        "path": path,
        "rolls": rolls,
        "magnitude_limit": magnitude_limit,
        "snr": snr,
        "circle_deg": circle_deg,
        "exclusion": exclusion,
    }
    sha256 = scenario_sha256(loaded, coverage=True, **asked)
    identity = Identity("coverage", loaded.name, loaded.seed, sha256, {"boresights": boresights})
    with results_folder(out or Path("out") / f"{loaded.name}-coverage", identity, force=force) as folder:
        result = coverage(loaded, boresights, **asked)
        write_coverage(result, loaded, folder, identity)
    _print_coverage(result, [name.removesuffix("_deg") for name in given if given[name] is None], open_console())
    print(f"{folder}: {', '.join(RESULT_FILES)}")
    return 0


def design_study(
    scenario: ScenarioFile,
    over: Annotated[str, option("--over", "PARAMETER", "optics.aperture_mm, field (degrees) or detector.exposure_s.")],
    low: Annotated[float, option("--from", "A", "Smallest value tried.")],
    high: Annotated[float, option("--to", "B", "Largest value tried.")],
    steps: Annotated[int, option("--steps", "N", "Values of the table.")] = 12,
    stars: Annotated[int, option("--stars", "K", "Stars that an attitude needs.")] = 5,
    availability: Annotated[
        float, option("--availability", "P", "Share of the sky, or of the time, that must have them.")
    ] = 0.999,
    boresights: Annotated[int, option("--boresights", "N", "Attitudes looked at.")] = 5000,
    path: AlongPath = False,
    verify_trials: Annotated[int, option("--verify", "N", "Run so many trials of the value found; 0: none.")] = 0,
    workers: Workers = 1,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-design.")] = None,
    force: Force = False,
) -> int:
    """The smallest aperture, field or exposure that meets the specification and an availability."""
    from simulator.checks import load_scenario
    from simulator.study.design.files import write_design
    from simulator.study.design.search import Trade, design, verify
    from simulator.study.results_folder import Identity, results_folder, scenario_sha256

    at_least(0, verify=verify_trials)
    at_least(1, workers=workers)
    loaded = load_scenario(scenario, set_values)
    progress, console = open_console(error=True), open_console()
    trade = Trade(over, low, high, steps, stars, availability, boresights, path)
    asked = {name: getattr(trade, name) for name in ("steps", "least_stars", "least_availability", "path")}
    sha256 = scenario_sha256(loaded, design=(over, low, high), **asked)
    amounts = {"boresights": boresights, "verification trials": verify_trials}
    identity = Identity("design", loaded.name, loaded.seed, sha256, amounts)
    checked = None
    with results_folder(out or Path("out") / f"{loaded.name}-design", identity, force=force) as folder:
        with progress.status("computing") as status:
            result = design(loaded, trade, lambda done: status.update(f"computing: {done} values of {over}"))
        _print_design(result, console)
        if verify_trials and result.best is not None:
            with progress.status(f"verifying: {verify_trials} trials"):
                checked = verify(loaded, result, verify_trials, workers)
            _print_verification(result, checked, console)
        write_design(result, checked, folder, identity)
    print(f"{folder}: design.json, design.png")
    return 1 if result.best is None or (checked and checked.contradictions) else 0


def budget_study(
    scenario: ScenarioFile,
    trials: Annotated[int, option("--trials", "N", "Trials of each run.")] = 200,
    workers: Workers = 1,
    set_values: SetValues = None,
    out: Annotated[Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-budget.")] = None,
    force: Force = False,
) -> int:
    """What makes up the error: effects switched off one at a time, and the classes of ECSS-E-ST-60-20C."""
    from dataclasses import replace

    from simulator.checks import load_scenario
    from simulator.study.budget.error_budget import budget
    from simulator.study.budget.plot import budget_figure
    from simulator.study.plots import save_bytes
    from simulator.study.result_files import json_text, write_files
    from simulator.study.results_folder import Identity, results_folder, scenario_sha256, standing

    loaded = load_scenario(scenario, set_values)
    sha256 = scenario_sha256(loaded, budget=True)
    identity = Identity("budget", loaded.name, loaded.seed, sha256, {"trials": trials})
    with results_folder(out or Path("out") / f"{loaded.name}-budget", identity, force=force) as folder:
        with progress_bar(f"{loaded.name}: error budget", "trials") as progress:
            result = budget(loaded, trials, workers, progress=progress)
        print(result.table())
        if result.interrupted and not force and standing(folder, "budget"):
            print(f"{folder}: keeps the budget that was there, as this one was interrupted")
            return 130
        if result.interrupted:
            identity = replace(identity, amounts={"trials": 0})
        values = result.to_dict() | {"identity": identity.to_dict()}
        write_files(folder, {"budget.json": json_text(values), "budget.png": save_bytes(budget_figure(result))})
    print(f"{folder}: budget.json, budget.png")
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
    help="Studies that answer one question each: coverage, design, error budget, radiation; two printed works.",
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


def _exclusion_text(body: str, angle_deg: float, of_baffle: bool) -> str:
    """An exclusion angle and where it comes from."""
    from simulator.scenario.fields import all_keys

    where = "of its limb" if body == "earth" else "of its centre"
    path = f"optics.baffle.{body}_exclusion_deg"
    default = next(key.default for key in all_keys() if key.path == path)
    source = f"{path}, {'the default' if angle_deg == default else 'as set'}" if of_baffle else f"--{body}-deg"
    return f"within {angle_deg:g}° {where} ({source})"


def _print_coverage(result: Coverage, of_baffle: Sequence[str], console: Console) -> None:
    summary = result.summary()
    stars, what = summary["stars"], "time" if result.boresights.kind == "path" else "sky"
    console.print(
        f"{result.name}: stars to V = {result.magnitude_limit:.2f} ({result.limit_reason}) "
        f"in {summary['field_deg2']:.1f} square degrees, over {summary['over']}"
    )
    for body, share in summary["excluded_share"].items():
        angle = _exclusion_text(body, summary["exclusion_deg"][body], body in of_baffle)
        console.print(f"  {100 * share:.2f} % of the {what} excluded by the {body.title()}, {angle}")
    if stars["min"] is None:
        console.print("  everything is excluded; the options --sun-deg, --moon-deg and --earth-deg set other angles")
        return
    low = summary["poorest"][0]
    console.print(
        f"  mean {stars['mean']:.2f} (spread evenly: {summary['stars_if_spread_evenly']:.2f}), "
        f"fewest {stars['min']} at RA {low['ra_deg']:.2f}° Dec {low['dec_deg']:+.2f}° roll {low['roll_deg']:.1f}°"
        + (f" and {summary['poorest_attitudes'] - 1} more" if summary["poorest_attitudes"] > 1 else "")
        + f", most {stars['max']}"
    )
    rows = [
        (f"at least {k}", f"{100 * summary['availability'][k]:.2f} %", f"{100 * share:.2f} %")
        for k, share in summary["availability_where_allowed"].items()
    ]
    print_table(console, f"share of the {what}", ("stars", "available", "where not excluded"), rows)


def _print_design(result: Design, console: Console) -> None:
    from simulator.study.design.search import PARAMETERS
    from simulator.study.statistics import BODY_AXES, deg_text

    title, unit, _ = PARAMETERS[result.parameter]
    rows = []
    for point in result.points:
        if point.impossible:
            rows.append((f"{point.value:.4g}", *["–"] * 6, "[red]cannot be[/]"))
            continue
        verdict = "[green]met[/]" if point.met else "[red]not met[/]"
        rows.append(
            (
                f"{point.value:.4g}",
                f"{point.magnitude_limit:.2f}",
                f"{point.stars_mean:.1f} ({point.stars_min})",
                *(deg_text(point.three_sigma_deg[axis]) for axis in BODY_AXES),
                f"{100 * (point.availability or 0.0):.2f} %",
                f"[bold]{verdict}[/]" if result.best and point.value == result.best.value else verdict,
            )
        )
    headings = (
        f"{title} \\[{unit}]",
        "to V",
        "stars (fewest)",
        *(f"3σ {axis}" for axis in BODY_AXES),
        "available",
        "",
    )
    specified = ", ".join(f"{axis} {deg_text(limit)}" for axis, limit in result.specification_deg.items())
    print_table(
        console,
        f"{result.name}: 3σ to meet: {specified}; at least {result.least_stars} stars over "
        f"{100 * result.least_availability:g} % of the {'time' if result.over == 'path' else 'sky'}",
        headings,
        rows,
    )
    for point in result.points:
        if point.impossible:
            console.print(f"  {point.value:.4g}: {point.impossible}", markup=False)
    if result.best is None:
        console.print(f"No {title} in this range meets everything.")
    else:
        console.print(f"Smallest {title} predicted to meet everything: {result.best.value:.4g} {unit}")


def _print_verification(result: Design, checked: Verification, console: Console) -> None:
    from simulator.study.design.search import PARAMETERS
    from simulator.study.statistics import BODY_AXES, deg_text

    rows = []
    for axis in BODY_AXES:
        measured, predicted = checked.three_sigma_deg[axis], checked.predicted_deg[axis]
        ratio = f"{measured / predicted:.2f}" if measured is not None and predicted else "–"
        specified = deg_text(result.specification_deg[axis])
        rows.append((axis, deg_text(predicted), deg_text(measured), ratio, deg_text(checked.p997_deg[axis]), specified))
    title = f"{checked.trials} trials, {checked.solved} solved, {checked.wrong} wrong"
    print_table(console, title, ("3σ", "predicted", "measured", "ratio", "99.7 % below", "specified"), rows)
    name, unit, _ = PARAMETERS[result.parameter]
    value = result.best.value if result.best else math.nan
    if checked.contradictions:
        console.print(
            f"[red]The verification contradicts the prediction[/]: at {name} {value:.4g} {unit} "
            + "; ".join(checked.contradictions)
        )
    else:
        console.print(f"The verification does not contradict the prediction at {name} {value:.4g} {unit}.")
