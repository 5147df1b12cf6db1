"""Content of the report of a run: answer, tables and sentences.

Everything is taken from ``summary.json`` and ``trials.parquet``; quantities missing in older runs are omitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import AXES, AXIS_TITLES, BODY_AXES, CAMERA_AXES
from simulator.study.intervals import wilson_interval
from simulator.study.pages.page import Block, Table, Words, lead, paragraph
from simulator.study.pages.parts import unphysical_notes, verdict_table
from simulator.study.specification.outcome import identified, outcome_flags
from simulator.study.specification.verdicts import Judgement
from simulator.study.texts import fine_text, interval_text, percent_text

if TYPE_CHECKING:
    from simulator.scenario import Scenario

Columns = Mapping[str, NDArray[Any]]
MOST_OUTLIERS = 20
AT_THE_BOUND = 1.1
"""Maximum ratio of error to bound for the error to count as limited by the bound."""


@dataclass(frozen=True)
class Answer:
    """First lines of the report: verdict on the specification, margin, rates, limiting effects."""

    state: str
    """`MET`, `NOT_MET` or `UNDECIDED`."""
    verdict: str
    margin: str
    axes: Table
    rates: Table
    limits: tuple[str, ...]

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The answer as it is shown."""
        return (
            lead(Words(self.verdict, self.state), f" {self.margin}"),
            self.axes,
            self.rates,
            paragraph(Words("Limits.", "strong"), " ", " ".join(self.limits)),
        )


def answer_of(
    judged: Judgement, summary: Mapping[str, Any], columns: Columns, budget: Mapping[str, Any] | None = None
) -> Answer:
    """First lines of the report.

    Parameters
    ----------
    judged : Judgement
        Verdicts on the specification of the run.
    summary : mapping
        As in ``summary.json``.
    columns : mapping of arrays
        As in ``trials.parquet``.
    budget : mapping, optional
        As in ``budget.json``, if ``boresight study budget`` has been run.
    """
    n, solved, wrong = summary["trials"], summary["solved"], summary["wrong"]
    rates = []
    for name, count in (
        ("available (solved)", solved),
        ("correctly identified", int(identified(columns).sum())),
        ("misidentified", summary.get("misidentified", 0)),
        ("inconsistent", summary.get("inconsistent", 0)),
        ("wrong", wrong),
    ):
        between = interval_text(wilson_interval(count, n), percent_text)
        rates.append((name, f"{count} of {n}", percent_text(count / n) if n else "–", between))
    return Answer(
        state=judged.state,
        verdict=f"{judged.text}.",
        margin=_margin(judged),
        axes=verdict_table(judged),
        rates=Table(("rate", "frames", "fraction", "95 % interval"), tuple(rates)),
        limits=_limits(summary, columns, budget),
    )


def render_command(trial: str = "I") -> str:
    """Command that renders a trial again, in the results folder."""
    return f"boresight render scenario.resolved.yaml --index {trial} --preview trial-{trial}.png"


def notes_of(summary: Mapping[str, Any]) -> tuple[str, ...]:
    """What a reader must know first: unphysical values, and whether the run was interrupted."""
    notes = unphysical_notes(summary["unphysical"])
    if summary["interrupted"]:
        notes.append(f"This run was interrupted: {summary['trials']} of {summary['requested']} trials are included.")
    return tuple(notes)


def _margin(judged: Judgement) -> str:
    """Sentence on the requirement with the smallest margin."""
    known = [(verdict.margin, verdict.requirement.title) for verdict in judged.verdicts if verdict.margin]
    if not known:
        return "No frame was solved."
    margin, title = min(known)
    if margin >= 1:
        return f"Smallest margin: {title}, {margin:.3g}×."
    return f"Largest excess: {title}, {1 / margin:.3g}× the limit."


def interval_of(summary: Mapping[str, Any], axis: str, key: str) -> list[float | None] | None:
    """95 % interval of a statistic of ``errors_deg``, degrees; None if the run has none."""
    interval: list[float | None] | None = summary["errors_deg"][axis].get(f"{key}_interval95")
    return interval


def _limits(summary: Mapping[str, Any], columns: Columns, budget: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Sentences on the limits of the accuracy: ratio to the bound, largest contributions, stars."""
    said = []
    if bound := summary.get("bound_ratio"):
        parts = []
        for axis in CAMERA_AXES:
            interval = interval_text(bound[axis]["interval95"], _ratio_text)
            parts.append(
                f"{_ratio_text(bound[axis]['ratio'])} {AXIS_TITLES[axis][0]}{f' ({interval})' if interval else ''}"
            )
        worst = max(bound[axis]["ratio"] for axis in CAMERA_AXES)
        said.append(f"Ratio of the rms error to the Cramér–Rao bound of the same stars: {', '.join(parts)}.")
        said.append(
            "The error is limited by photon and detector noise; no other processing would be noticeably more accurate."
            if worst <= AT_THE_BOUND
            else f"Up to {100 * (1 - 1 / worst):.0f} % of the error is not photon and detector noise, but due to the "
            "processing or to effects missing in the tracker's camera model."
        )
    if nees := summary.get("nees"):
        low, high = nees["bounds95"]
        finding = "is consistent" if nees["inside"] else "is too large" if nees["mean"] < low else "is too small"
        said.append(
            f"The stated covariance {finding}: mean normalised error squared (NEES) {nees['mean']:.3f}, "
            f"expected {low:.3f} to {high:.3f} for {nees['freedom']} axes."
        )
    if inconsistent := summary.get("inconsistency"):
        said.append(f"{inconsistent['text']}.")
    if largest := _largest(budget):
        said.append(f"Largest contributions to the mean square error across the boresight: {largest}.")
    solved = np.asarray(columns["status"] == "solved")
    if solved.any():
        stars = np.asarray(columns["stars_matched"], dtype=float)[solved]
        field_stars = np.asarray(columns["stars_in_field"], dtype=float)[solved]
        residual = np.asarray(columns["residual_rms_px"], dtype=float)[solved]
        said.append(
            f"On average {stars.mean():.1f} of {field_stars.mean():.1f} stars in the field are matched "
            f"(minimum {int(stars.min())}); centroid residual {np.sqrt(np.nanmean(residual**2)):.3f} px rms."
        )
    return tuple(said)


def accuracy_table(summary: Mapping[str, Any]) -> Table:
    """Errors about each axis, with intervals."""
    rows = []
    for axis in AXES:
        e = summary["errors_deg"][axis]
        cells = [AXIS_TITLES[axis][0]]
        for key in ("mean", "std", "rms"):
            interval = interval_text(interval_of(summary, axis, key))
            cells.append(fine_text(e[key]) + (f" ({interval})" if interval else ""))
        rows.append((*cells, *(fine_text(e[key]) for key in ("p50", "p95", "p997", "max"))))
    note = (
        "The error is the rotation vector from the true to the estimated attitude, over all solved trials, wrong ones "
        "included. An attitude is misidentified if a star is not the one that it names, inconsistent if its error "
        "exceeds 5σ of the stated covariance, and wrong if it is misidentified, or inconsistent and beyond the "
        "specification as well; " + _beyond(summary)
    )
    if any(interval_of(summary, axis, "rms") for axis in AXES):
        note += " 95 % bootstrap intervals in brackets."
    return Table(
        ("axis", "mean", "std", "rms", "median", "95th percentile", "99.7th percentile", "max"), tuple(rows), note=note
    )


def _beyond(summary: Mapping[str, Any]) -> str:
    count = summary.get("beyond_specification", 0)
    verb = "is" if count == 1 else "are"
    return f"{count or 'none'} of the attitudes {verb} off by more than ten times the specification."


def outlier_positions(columns: Columns, summary: Mapping[str, Any]) -> list[tuple[int, str]]:
    """Positions of notable trials, with the reason: wrong, not solved, inconsistent, then outlying errors."""
    index = np.asarray(columns["index"])
    misidentified, inconsistent, wrong = outcome_flags(columns)
    failed = np.flatnonzero(np.asarray(columns["status"]) != "solved")
    found = {int(i): "wrong: misidentified" if misidentified[i] else "wrong" for i in np.flatnonzero(wrong).tolist()}
    found |= {int(i): str(columns["status"][i]) for i in failed}
    for row in np.flatnonzero(inconsistent & ~wrong).tolist():
        found.setdefault(row, "inconsistent")
    for entry in summary.get("outliers", ()):
        i = int(np.searchsorted(index, entry["index"]))  # rows are in order of index
        if i < len(index) and index[i] == entry["index"]:
            found.setdefault(i, entry["why"])
    return list(found.items())


def outliers_table(summary: Mapping[str, Any], columns: Columns, anchors: Mapping[str, str] | None = None) -> Table:
    """Notable trials, the first `MOST_OUTLIERS`; those in `anchors` lead to their frame in the page."""
    found = outlier_positions(columns, summary)
    shown = [i for i, _ in found[:MOST_OUTLIERS]]
    texts = [[why for _, why in found[:MOST_OUTLIERS]]]
    if shown:  # one column at a time, as each is read from its file
        for name in ("index", "utc", "stars_matched", "reason"):
            texts.append([str(value) or "–" for value in columns[name][shown]])
        for axis in BODY_AXES:
            texts.append([fine_text(float(value)) for value in columns[f"error_{axis}_deg"][shown]])
    what, index, utc, stars, reason, *errors = texts if shown else [[]] * 8
    rows = list(zip(index, utc, what, *errors, stars, reason, strict=True))
    note = "" if found else "None: every frame was solved, none wrong, and there are no outlying errors. "
    every = len(found) + max(0, summary.get("outliers_count", 0) - len(summary.get("outliers", ())))
    if every > MOST_OUTLIERS:
        note = f"The first {MOST_OUTLIERS} of {every}; all are in trials.parquet. "
    note += "To render any trial again, run in the folder of this report, with I its index:"
    links = tuple((anchors or {}).items())
    return Table(("trial", "UTC", "what", *BODY_AXES, "stars", "reason"), tuple(rows), (1, 2, 7), note, links)


def method_text(scenario: Scenario, summary: Mapping[str, Any]) -> str:
    """How the numbers came about."""
    sampling = {
        "mission_year": "at times distributed over a year of the mission",
        "orbit": "distributed over one rotation" if scenario.pointing.spin.rate_deg_s else "distributed over one orbit",
        "span": "at times distributed over the span of the ephemeris",
        "sky": "at random attitudes over the whole sky",
    }[scenario.study.sampling]
    many = summary["workers"] > 1
    return (
        f"{summary['trials']} frames {sampling} were rendered from the scenario below and solved by the tracker, which "
        "has no access to the truth; the resulting attitudes were compared with the true ones. All random numbers "
        f"depend only on the seed, {summary['seed']}, and the index of the trial. boresight {summary['version']}, "
        f"{summary['trials_per_second']:.1f} trials per second on {summary['workers']} process{'es' if many else ''} "
        f"(median {summary['median_ms']['render'] or 0:.1f} ms to render, {summary['median_ms']['solve'] or 0:.1f} ms "
        "to solve)."
    )


def _ratio_text(ratio: float | None) -> str:
    return "–" if ratio is None else f"{ratio:.3f}"


def budget_table(budget: Mapping[str, Any]) -> Table:
    """Contributions of effects and classes from `Budget.to_dict`, largest first."""
    rows = []
    for what, entries in (("effect", budget["effects"]), ("class", budget["classes"])):
        for entry in sorted(entries, key=_added_across, reverse=True):
            rows.append((entry["name"], what, *(_added_text(entry["axes"][axis]) for axis in CAMERA_AXES)))
    if budget["remainder"] is not None:
        left = (fine_text(budget["remainder"]["axes"][axis]["rms_off_deg"]) for axis in CAMERA_AXES)
        rows.append(("remaining error", "all effects", *left))
    rows.append(("total error", "none", *(fine_text(budget["rms_deg"][axis]) for axis in CAMERA_AXES)))
    note = (
        f"From {budget['trials']} trials with one effect switched off at a time (seed {budget['seed']}): square root "
        "of its contribution to the mean square error, 95 % interval in brackets; negative if the error is larger "
        "without it. Classes as in ECSS-E-ST-60-20C. Contributions need not add up."
    )
    names = tuple(AXIS_TITLES[axis][0] for axis in CAMERA_AXES)
    return Table(("contribution", "switched off", *names), tuple(rows), (1,), note)


def _added_text(of_axis: Mapping[str, Any]) -> str:
    interval = interval_text(of_axis["added_rms_interval95_deg"])
    return fine_text(of_axis["added_rms_deg"]) + (f" ({interval})" if interval else "")


def _added_across(entry: Mapping[str, Any]) -> float:
    """Contribution of an effect to the mean square error across the boresight, both axes together, degrees²."""
    added = (entry["axes"][axis]["added_rms_deg"] or 0.0 for axis in CAMERA_AXES[:2])
    return sum(math.copysign(rms * rms, rms) for rms in added)


def _largest(budget: Mapping[str, Any] | None) -> str:
    """The three largest effects across the boresight with an interval above 0, as fractions of the mean square
    error."""
    if budget is None:
        return ""
    whole = sum(budget["rms_deg"][axis] ** 2 for axis in CAMERA_AXES[:2])
    sure = [
        (_added_across(entry) / whole, entry["name"])
        for entry in budget["effects"]
        if all((entry["axes"][axis]["added_rms_interval95_deg"][0] or 0.0) > 0.0 for axis in CAMERA_AXES[:2])
    ]
    return ", ".join(f"{name} {100 * share:.0f} %" for share, name in sorted(sure, reverse=True)[:3])
