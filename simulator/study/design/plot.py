"""Plot of a design trade-off: accuracy, stars and availability by parameter."""

from __future__ import annotations

import itertools
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.design.search import PARAMETERS, Design
from simulator.study.design.verification import Verified
from simulator.study.plots import BLUE, GREEN, GREY, ORANGE, VERMILION, picture
from simulator.study.specification.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS = ((BLUE, "o", "-"), (ORANGE, "s", "--"), (GREEN, "^", ":"), (VERMILION, "D", "-."), (GREY, "v", "-"))


def design_plot(verified: Verified) -> Figure:
    """Predicted errors with their limits and the measured ones, stars in the field, and fraction of the attitudes with
    too few stars; below, what the prediction leaves out."""
    result = verified.design
    figure, grid = picture(1, 3, (12, 5.2))
    possible = [point for point in result.points if not point.impossible]
    value = np.array([point.value for point in possible])
    for ax in grid[0]:
        _parameter_axis(ax, result)
    _accuracy(grid[0, 0], verified, possible, value)
    stars = grid[0, 1]
    stars.plot(value, [point.stars_mean for point in possible], "o-", color=BLUE, ms=3.5, label="mean")
    stars.plot(value, [point.stars_min for point in possible], "s--", color=VERMILION, ms=3.5, label="fewest")
    stars.axhline(result.least_stars, color=GREY, lw=1.0, label=f"{result.least_stars} required")
    stars.set_ylabel("stars used in the field")
    stars.set_ylim(0, None)
    missing = grid[0, 2]
    share = np.array([100.0 * (1.0 - (point.availability or 0.0)) for point in possible])
    floor = 100.0 / result.attitudes
    missing.semilogy(value, np.maximum(share, 0.5 * floor), "o-", color=BLUE, ms=3.5, label="predicted")
    allowed = 100.0 * (1.0 - result.least_availability)
    if allowed > 0:
        missing.axhline(allowed, color=VERMILION, lw=1.2, label=f"{allowed:.3g} % allowed")
    missing.axhspan(0.4 * floor, floor, color="#eeeeee", label=f"none of {result.attitudes}")
    missing.set_ylim(0.4 * floor, 150.0)
    missing.set_ylabel(f"fraction of the {'time' if result.over == 'path' else 'sky'} with fewer stars [%]")
    for ax in grid[0]:
        ax.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)
    figure.suptitle(f"{result.name}: {_answer(verified)}", fontsize=10)
    contains = textwrap.fill(f"Not in the prediction: {', '.join(result.left_out)}.", 170)
    figure.supxlabel(contains, fontsize=7.5, color=GREY)
    return figure


def _answer(verified: Verified) -> str:
    """Title of the plot: the value found, and whether trials confirm it."""
    result = verified.design
    title, unit, _ = PARAMETERS[result.parameter]
    if result.best is None:
        return f"no {title} in this range is predicted to meet the specification"
    predicted = f"smallest {title} predicted to meet the specification: {result.best.value:.4g} {unit}"
    if not verified.runs:
        return predicted
    if verified.answer is None:
        return (
            f"{predicted}; contradicted by trials, and no value up to {verified.runs[-1].value:.4g} {unit} is confirmed"
        )
    return f"{predicted}; {verified.confirmed} by {verified.answer.trials} trials: {verified.answer.value:.4g} {unit}"


def _accuracy(ax: Axes, verified: Verified, possible: list[Any], value: Any) -> None:
    drawn: dict[float, list[str]] = {}
    errors = [each for each in verified.design.requirements if each.axis]
    for each, (colour, marker, line) in zip(errors, itertools.cycle(_LOOKS), strict=False):
        title = f"{each.title}, {each.percent:g} %"
        known = [point.specification.get(each.name, {}).get("value_deg") for point in possible]
        shown = np.array([np.nan if v is None else v * 3600.0 for v in known])
        ax.plot(value, shown, marker + line, color=colour, ms=3.5, label=f"{title}, predicted")
        for k, run in enumerate(verified.runs):
            judged = next(v for v in run.judgement.verdicts if v.requirement == each)
            _measured(ax, run.value, judged, (colour, marker), f"{title}, measured" if k == 0 else "")
        drawn.setdefault(each.limit, []).append(each.title)
    looks = dict(zip((each.limit for each in errors), itertools.cycle(_LOOKS), strict=False))
    for limit, titles in drawn.items():
        colour = looks[limit][0] if len(titles) == 1 else "black"
        label = f"{', '.join(dict.fromkeys(titles))} specified"
        ax.axhline(limit * 3600.0, color=colour, lw=1.1, linestyle=(0, (6, 2)), label=label)
    ax.set_yscale("log")
    ax.set_ylabel("error at its percentile [arcsec]")


def _measured(ax: Axes, value: float, judged: Verdict, look: tuple[str, str], label: str) -> None:
    """A measured percentile with its interval; an open upper end as an arrow."""
    colour, marker = look
    measured, low, high = judged.estimate[:3]
    if measured is None:
        return
    below, above = (0.0 if low is None else measured - low), (0.0 if high is None else high - measured)
    ax.errorbar(
        value, measured * 3600.0, yerr=[[below * 3600.0], [above * 3600.0]], fmt=marker, mfc="none", color=colour, ms=7,
        lw=1.2, capsize=2, lolims=high is None, label=label or None,
    )  # fmt: skip


def _parameter_axis(ax: Axes, result: Design) -> None:
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    values = [point.value for point in result.points]
    ax.set_xscale("log")
    ticks = _round_numbers(min(values), max(values))
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(ScalarFormatter())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("{} [{}]".format(*PARAMETERS[result.parameter]))
    if result.best is not None:
        ax.axvline(result.best.value, color=GREY, linestyle="--", lw=1.0, label=f"smallest, {result.best.value:.4g}")


def _round_numbers(low: float, high: float) -> list[float]:
    """1, 2, 5 times powers of ten within the range, and its ends if there are fewer than two."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [m * 10.0**d for d in decades for m in (1, 2, 5) if low * 0.999 <= m * 10.0**d <= high * 1.001]
    return ticks if len(ticks) > 1 else [low, high]
