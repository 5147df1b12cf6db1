"""Error budget: the same trials repeated with one effect switched off at a time.

All runs have the same seed, hence the same attitudes and, for the remaining effects, the same noise: differences
between runs are due to the effect. Classes are measured as well, with all effects of a class off at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.axes import CAMERA_AXES
from simulator.study.budget.effects import CLASSES, EFFECTS, Changes, Effect
from simulator.study.budget.outliers import ALL_ON, Outlier, find_outliers, lines_of
from simulator.study.intervals import moment_intervals, plain, wilson_interval
from simulator.study.specification.outcome import identified
from simulator.study.trials.arrow import as_array
from simulator.study.trials.engine import Progress, run_trials
from startracker.core import FloatArray
from startracker.errors import BoresightError, InputError


@dataclass(frozen=True)
class Contribution:
    """Contribution of an effect or a class to the error."""

    name: str
    kind: str
    """Effect and class."""
    rms_off_deg: dict[str, float]
    """Rms error by camera axis without it, degrees."""
    added_deg2: dict[str, float]
    """Contribution to the mean square error by axis, degrees²: that with it minus that without it, over the trials
    solved in both runs. Negative if the error is larger without the effect."""
    interval_deg2: dict[str, list[float | None]]
    """95 % bootstrap interval of the contribution, from paired trials; None at an end for too few trials."""
    trials: int
    """Trials solved in both runs, without outliers."""
    solved: int
    """Trials solved without the effect, without outliers."""

    def added_rms_deg(self, axis: str) -> float:
        """Signed square root of the contribution."""
        return _root(self.added_deg2[axis])


@dataclass(frozen=True)
class Budget:
    """Error budget of a scenario."""

    scenario: str
    """Name of the scenario."""
    seed: int
    trials: int
    """Seed and number of trials of every run."""
    solved: int
    """Trials correctly solved with all effects."""
    rms_deg: dict[str, float]
    """Rms error by camera axis with all effects, degrees."""
    mean_deg: dict[str, float]
    """Mean error (bias)."""
    effects: tuple[Contribution, ...]
    classes: tuple[Contribution, ...]
    """One effect off; all effects of a class off."""
    remainder: Contribution | None
    """All effects off at once: its `rms_off_deg` is the error of the algorithms alone. None if the scenario has no
    effect."""
    outliers: tuple[Outlier, ...] = ()
    """Outliers, which are excluded from all other values."""
    rms_with_outliers_deg: dict[str, float] | None = None
    """Rms error with all effects on over all solved trials, outliers and wrong attitudes included; None without any."""
    interrupted: bool = False
    """Whether it was interrupted before all runs were finished; the values present are complete."""

    def table(self) -> str:
        """The budget as text: one effect per line, arcseconds, sorted by the contribution about the first axis."""
        head = f"{'':34}" + "".join(f"{axis.replace('_', ' '):>26}" for axis in CAMERA_AXES)
        lines = [
            f"Error budget of {self.scenario}: {self.trials} trials, seed {self.seed}",
            "rms in arcseconds, 95 % intervals in brackets",
            head,
            f"{'all effects on':34}" + "".join(f"{self.rms_deg[axis] * 3600:>26.3f}" for axis in CAMERA_AXES),
        ]
        for title, rows in (
            ("contribution of each effect", self.effects),
            ("contribution of each class", self.classes),
        ):
            lines.append(title)
            lines += [_line(row) for row in sorted(rows, key=lambda row: -row.added_deg2[CAMERA_AXES[0]])]
        if self.remainder is not None:
            left = "".join(f"{self.remainder.rms_off_deg[axis] * 3600:>26.3f}" for axis in CAMERA_AXES)
            lines.append(f"{'all effects off':34}{left}")
        lines.append(
            "Contribution: square root of the mean square error with the effect minus that without it; negative if "
            "the error is larger without the effect. Contributions need not add up, as weights and star counts change."
        )
        lines += lines_of(self.outliers)
        if self.rms_with_outliers_deg:
            whole = "".join(f"{self.rms_with_outliers_deg[axis] * 3600:>26.3f}" for axis in CAMERA_AXES)
            lines.append(f"{'all effects on, outliers included':34}{whole}")
        if self.interrupted:
            lines.append("Interrupted: effects that are not listed were not computed.")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The budget as in ``budget.json``; angles in degrees."""
        return {
            "scenario": self.scenario,
            "seed": self.seed,
            "trials": self.trials,
            "solved": self.solved,
            "solved_interval95": list(wilson_interval(self.solved, self.trials)),
            "rms_deg": self.rms_deg,
            "mean_deg": self.mean_deg,
            "effects": [_entry(row) for row in self.effects],
            "classes": [_entry(row) for row in self.classes],
            "remainder": None if self.remainder is None else _entry(self.remainder),
            "rms_with_outliers_deg": self.rms_with_outliers_deg,
            "outliers": [outlier.to_dict() for outlier in self.outliers],
            "interrupted": self.interrupted,
        }


def budget(scenario: Scenario, trials: int, workers: int = 1, progress: Progress | None = None) -> Budget:
    """Error budget of a scenario: one Monte Carlo run with all effects, without each effect and class, and without any.

    Effects that the scenario does not have are skipped. Trials with an outlying error in any run, or a wrong attitude
    with all effects on, are excluded (`simulator.study.budget.outliers`).

    Parameters
    ----------
    scenario : Scenario
        The scenario; its seed is used for every run.
    trials : int
        Trials of each run, at least 2.
    workers : int
        Processes on this machine.
    progress : callable, optional
        Called with (trials finished, total trials) over all runs.

    Raises
    ------
    InputError
        For too few trials or no workers.
    BoresightError
        If it is interrupted before the first comparison, or no trial is solved.
    """
    if trials < 2:
        raise InputError(f"trials: an error budget needs at least 2 per run, not {trials}")
    effects = [(effect, changes) for effect in EFFECTS if (changes := effect.off(scenario))]
    groups = {kind: [pair for pair in effects if pair[0].kind == kind] for kind in CLASSES}
    groups = {kind: members for kind, members in groups.items() if members}
    runs: list[tuple[str, str, Changes]] = [(ALL_ON, "", {})]
    runs += [(effect.name, effect.kind, changes) for effect, changes in effects]
    runs += [(CLASSES[kind], kind, _joined(members)) for kind, members in groups.items() if len(members) > 1]
    if effects:
        runs.append(("everything", "", _joined(effects)))

    done = _errors_of_runs(scenario, [changes for _, _, changes in runs], trials, workers, progress)
    if len(done) < min(2, len(runs)):
        raise BoresightError("interrupted before the first effect was computed: no results")
    names = [name for name, _, _ in runs][: len(done)]
    singles_run = [effect.name for effect, _ in effects]
    errors_of, right_of, solved_of, bounds = zip(*done, strict=True)
    outliers = find_outliers(names, errors_of, right_of, solved_of, bounds[0], singles_run)
    kept = np.ones(trials, np.bool_)
    kept[[outlier.index for outlier in outliers]] = False
    base, right = done[0].errors, done[0].right & kept
    if not right.any():
        raise BoresightError("no trial was solved with all effects on: there is no error to analyse")
    rows = [
        _contribution(
            name, kind, done[0]._replace(right=right), result._replace(solved=result.solved & kept), scenario.seed
        )
        for (name, kind, _), result in zip(runs[1:], done[1:], strict=False)
    ]
    singles, many = rows[: len(effects)], rows[len(effects) : len(runs) - 2] if effects else []
    of_class = {row.kind: row for row in singles if len(groups[row.kind]) == 1} | {row.kind: row for row in many}
    return Budget(
        scenario.name,
        scenario.seed,
        trials,
        int(done[0].right.sum()),
        _by_axis(np.sqrt(np.mean(base[right] ** 2, axis=0))),
        _by_axis(base[right].mean(axis=0)),
        tuple(singles),
        tuple(replace(of_class[kind], name=CLASSES[kind]) for kind in CLASSES if kind in of_class),
        rows[-1] if effects and len(done) == len(runs) else None,
        outliers,
        _by_axis(np.sqrt(np.mean(base[done[0].solved] ** 2, axis=0))) if outliers else None,
        interrupted=len(done) < len(runs),
    )


def _errors_of_runs(
    scenario: Scenario, changes: list[Changes], trials: int, workers: int, progress: Progress | None
) -> list[_Run]:
    """Errors of a run for each of the changes; fewer if interrupted."""
    done: list[_Run] = []
    for k, keys in enumerate(changes):

        def report(finished: int, _: int, before: int = k * trials) -> None:
            if progress:
                progress(before + finished, len(changes) * trials)

        found = run_trials(scenario.changed(keys), trials, workers=workers, progress=report)
        if found.interrupted:
            break
        done.append(_errors(found.table))
    return done


def _joined(members: list[tuple[Effect, Changes]]) -> Changes:
    joined: Changes = {}
    for _, changes in members:
        joined |= changes
    return joined


class _Run(NamedTuple):
    """Errors (n, 3) about the camera's axes, degrees, which trials are solved with the right stars
    (`simulator.study.specification.outcome.identified`), and solved, and the Cramér–Rao bounds (n, 3), degrees."""

    errors: FloatArray
    right: NDArray[np.bool_]
    solved: NDArray[np.bool_]
    bound: FloatArray


def _errors(table: Any) -> _Run:
    errors = np.stack([as_array(table[f"error_{axis}_deg"]) for axis in CAMERA_AXES], axis=1)
    solved = np.array([status == "solved" for status in table["status"].to_pylist()], dtype=bool)
    names = [f"bound_{axis}_deg" for axis in CAMERA_AXES]
    known = all(name in table.column_names for name in names)
    bound = np.stack([as_array(table[name]) for name in names], axis=1) if known else np.full_like(errors, math.nan)
    words = ("status", "wrong", "misidentified", "inconsistent", "inconsistent_cause")
    said = {word: np.array(table[word].to_pylist()) for word in words if word in table.column_names}
    return _Run(errors, identified(said), solved, bound)


def _contribution(name: str, kind: str, base: _Run, without: _Run, seed: int) -> Contribution:
    """Contribution of an effect: `base` with it, over the trials marked by `right`, `without` over solved trials."""
    # Both runs have the same stars and the same noise of every other effect, which cancels in the difference of squares
    # trial by trial; the difference of the two rms values would have the scatter of both.
    both = base.right & without.solved
    difference = base.errors[both] ** 2 - without.errors[both] ** 2
    added = difference.mean(axis=0) if both.any() else np.full(3, math.nan)
    intervals = moment_intervals(difference, seed)["mean"]
    errors = without.errors[without.solved]
    off = np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(3, math.nan)
    return Contribution(
        name,
        kind,
        _by_axis(off),
        _by_axis(added),
        {axis: plain(None if intervals is None else intervals[k]) for k, axis in enumerate(CAMERA_AXES)},
        int(both.sum()),
        int(without.solved.sum()),
    )


def _by_axis(values: FloatArray) -> dict[str, float]:
    return {axis: float(v) for axis, v in zip(CAMERA_AXES, values, strict=True)}


def _root(square: float) -> float:
    # Without a small effect the error may by chance be larger; the sign shows it.
    return math.copysign(math.sqrt(abs(square)), square)


def _line(row: Contribution) -> str:
    cells = []
    for axis in CAMERA_AXES:
        low, high = (None if v is None else _root(v) * 3600 for v in row.interval_deg2[axis])
        ends = "" if low is None or high is None else f" ({low:.3f} to {high:.3f})"
        cells.append(f"{f'{row.added_rms_deg(axis) * 3600:.3f}{ends}':>26}")
    return f"  {row.name:32}" + "".join(cells)


def _entry(row: Contribution) -> dict[str, Any]:
    return {
        "name": row.name,
        "class": row.kind,
        "trials": row.trials,
        "solved": row.solved,
        "axes": {
            axis: {
                "rms_off_deg": plain([row.rms_off_deg[axis]])[0],
                "added_rms_deg": plain([row.added_rms_deg(axis)])[0],
                "added_rms_interval95_deg": [None if v is None else _root(v) for v in row.interval_deg2[axis]],
            }
            for axis in CAMERA_AXES
        },
    }
