"""What ``boresight study coverage`` and ``boresight study design`` print."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.cli.terminal import print_table
from simulator.cli.verdicts import coloured, outcome_cell, print_judgement
from simulator.study.coverage.boresights import everything_excluded
from simulator.study.design.search import PARAMETERS
from simulator.study.specification.requirements import Requirement
from simulator.study.texts import deg_text

if TYPE_CHECKING:
    from rich.console import Console

    from simulator.study.coverage.survey import Coverage
    from simulator.study.design.search import Design
    from simulator.study.design.verification import Verified


def print_coverage(result: Coverage, console: Console) -> None:
    """Exclusions, numbers of stars, availability, and the predicted verdict."""
    summary = result.summary()
    stars, what = summary["stars"], "time" if result.boresights.kind == "path" else "sky"
    console.print(
        f"{result.name}: stars to V = {result.magnitude_limit:.2f} ({result.limit_reason}) "
        f"in {summary['field_deg2']:.1f} square degrees, over {summary['over']}"
    )
    for text in result.excluded_texts():
        console.print(f"  {text}")
    if stars["min"] is None:
        others = "the options --sun-deg, --moon-deg and --earth-deg set other angles"
        console.print(f"  {everything_excluded(result.boresights, result.exclusion)}; {others}")
        if result.judgement:
            print_judgement(result.judgement, console)
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
    if result.judgement:
        print_judgement(result.judgement, console)
        _print_left_out(result.left_out, console)


def print_design(result: Design, console: Console) -> None:
    """Table of the values tried, and the smallest one predicted to meet the specification."""
    title, unit, _ = PARAMETERS[result.parameter]
    errors = [each for each in result.requirements if each.axis]
    rows = []
    for point in result.points:
        if point.impossible:
            rows.append((f"{point.value:.4g}", *["–"] * (3 + len(errors)), "[red]cannot be[/]"))
            continue
        verdict = coloured("met" if point.met else "not met")
        rows.append(
            (
                f"{point.value:.4g}",
                f"{point.magnitude_limit:.2f}",
                f"{point.stars_mean:.1f} ({point.stars_min})",
                *(deg_text(point.specification[each.name]["value_deg"]) for each in errors),
                f"{100 * (point.availability or 0.0):.2f} %",
                f"[bold]{verdict}[/]" if result.best and point.value == result.best.value else verdict,
            )
        )
    headings = (f"{title} \\[{unit}]", "to V", "stars (fewest)", *_titles(errors), "available", "predicted")
    specified = ", ".join(f"{each.title} {deg_text(each.limit)} at {each.percent:g} %" for each in errors)
    print_table(
        console,
        f"{result.name}: specified: {specified}; at least {result.least_stars} stars over "
        f"{100 * result.least_availability:g} % of the {'time' if result.over == 'path' else 'sky'}",
        headings,
        rows,
    )
    for point in result.points:
        if point.impossible:
            console.print(f"  {point.value:.4g}: {point.impossible}", markup=False)
    _print_left_out(result.left_out, console)
    if result.best is None:
        console.print(f"No {title} in this range is predicted to meet the specification.")
    else:
        console.print(f"Smallest {title} predicted to meet the specification: {result.best.value:.4g} {unit}")


def print_verified(verified: Verified, console: Console) -> None:
    """Runs of a design, and the value that they confirm."""
    title, unit, _ = PARAMETERS[verified.design.parameter]
    errors = [each for each in verified.design.requirements if each.axis]
    rows = []
    for run in verified.runs:
        found = {each.requirement.name: each for each in run.judgement.verdicts}
        rows.append((
            f"{run.value:.4g}",
            f"{run.solved} of {run.trials}",
            outcome_cell({"wrong": run.wrong, "inconsistent": run.inconsistent}),
            *(f"{deg_text(found[e.name].estimate.value)} ({_ratio(run.ratio[e.name])})" for e in errors),
            coloured(run.judgement.state),
        ))  # fmt: skip
    headings = (
        f"{title} \\[{unit}]", "solved", "wrong", *_titles(errors), "measured"
    )  # fmt: skip
    print_table(console, "verification: measured (measured / predicted)", headings, rows)
    answer = verified.answer
    last = answer or verified.runs[-1]
    print_judgement(last.judgement, console)
    first = verified.runs[0]
    if not first.accepted and first.contradictions:
        console.print(
            f"[red]The verification contradicts the prediction[/] at {title} {first.value:.4g} {unit}: "
            + "; ".join(first.contradictions)
        )
    if answer is None:
        console.print(f"[red]No {title} up to {max(run.value for run in verified.runs):.4g} {unit} is confirmed.[/]")
    elif answer is first:
        console.print(f"The verification does not contradict the prediction at {title} {answer.value:.4g} {unit}.")
    else:
        console.print(f"Smallest {title} {verified.confirmed} by {answer.trials} trials: {answer.value:.4g} {unit}")


def _titles(errors: list[Requirement]) -> list[str]:
    """Headings of errors, with their percentiles if these differ."""
    same = len({each.percent for each in errors}) == 1
    return [each.title if same else f"{each.title} {each.percent:g} %" for each in errors]


def _ratio(ratio: float | None) -> str:
    return "–" if ratio is None else f"{ratio:.2f} ×"


def _print_left_out(names: tuple[str, ...], console: Console) -> None:
    console.print(f"Not in the prediction: {', '.join(names)}.", markup=False)
