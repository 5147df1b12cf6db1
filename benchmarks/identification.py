"""Lost-in-space benchmark from centroids: success rate, correctness and speed of each identifier.

python -m benchmarks.identification [--case WORD ...] [--identifier NAME ...] [--n 2000] [--peers] [--out FILE.md]
python -m benchmarks.identification --random-points 100000
python -m benchmarks.identification --million --state FOLDER     (a million random attitudes; --total for fewer,
    resumes an interrupted run, reports the largest number of operations)
python -m benchmarks.identification --failures                   (lists the scenes not identified)
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import ACCURACY, CASES, MILLION, RANDOM_SHARES, matching
from benchmarks.database import COLUMNS as DATABASE_COLUMNS
from benchmarks.database import database_row
from benchmarks.report import ACCURACY_COLUMNS, RATE_COLUMNS, SHORT, Table, accuracy_row, rate_row, show, write_markdown
from benchmarks.scenes import Case
from benchmarks.score import IDENTIFIED, WRONG, run_case
from benchmarks.solvers import PEERS, has_tetra3rs
from simulator.study.statistics import wilson_interval

SEED = 4
LISTED_STARS = 5
MOST_LISTED = 30
STEP = 10_000
NOT_JUDGED = "–"
NOTES = [
    "Lost in space, from centroids, the same default settings in every case; the scenes are those of",
    "`benchmarks/scenes.py`. Both solvers know their epoch; the tracker also that the observer is at rest.",
    "An accepted attitude is wrong if its error is more than 5 pixels across or 1° about the boresight, or more than",
    "ten times the Cramér–Rao bound if that is larger. CPU ms are those of the whole solve in one process; `ident. ms`",
    "are wall-clock milliseconds of identification alone. `under 4 true` is the fraction of scenes with fewer than",
    "four true stars, in which even the true pairs could not be verified; `of the others %` is the fraction identified",
    "of the rest.",
]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if a target is missed."""
    options = parser().parse_args(arguments)
    if options.peers and not has_tetra3rs():
        print("tetra3rs is not installed: pip install 'boresight[peers]'", file=sys.stderr)
        return 2
    with pool_of(options.workers) as pool:
        if options.million:
            return million(options.identifier[0], options.total, options.seed, pool, options.state)
        return table(options, pool)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.identification", description=__doc__.splitlines()[0])
    made.add_argument("--case", nargs="*", default=[], metavar="WORD", help="cases whose name contains a word")
    made.add_argument("--identifier", nargs="+", default=["adaptive"], help="identifiers by name")
    made.add_argument("--n", type=int, default=2000, help="scenes a case")
    made.add_argument("--seed", type=int, default=SEED)
    made.add_argument("--workers", type=int, default=1, help="processes; timings are cleanest with 1")
    made.add_argument("--peers", action="store_true", help="tetra3rs on the same scenes")
    made.add_argument("--failures", action="store_true", help="list the scenes not identified")
    made.add_argument("--random-points", type=int, metavar="N", help="N scenes of random points, only: most of few")
    made.add_argument("--million", action="store_true", help=f"the long run of '{MILLION.replace('%', '%%')}'")
    made.add_argument("--total", type=int, default=1_000_000, help="scenes of the long run")
    made.add_argument("--state", type=Path, default=Path("out/million"), help="folder of the long run's counts")
    made.add_argument("--out", type=Path, help="Markdown file to write")
    return made


def pool_of(workers: int) -> ProcessPoolExecutor | nullcontext[None]:
    """Process pool, or None for one process."""
    return ProcessPoolExecutor(workers) if workers > 1 else nullcontext(None)


def table(options: argparse.Namespace, pool: ProcessPoolExecutor | None) -> int:
    """Tables of all selected cases."""
    scenes = dict.fromkeys(matching(options.case), options.n)
    if options.random_points is not None:
        scenes = {CASES[name]: round(options.random_points * share) for name, share in RANDOM_SHARES.items()}
    solvers = [*options.identifier, *(PEERS if options.peers else ())]
    rates: list[list[str]] = []
    accuracies: list[list[str]] = []
    failed: list[list[str]] = []
    for case, n in scenes.items():
        for solver in solvers:
            started = time.monotonic()
            rows = run_case(solver, case, n, options.seed, pool)
            rates.append(rate_row(case, solver, rows))
            judged = solver not in PEERS
            rates[-1][-1] = rates[-1][-1] if judged else NOT_JUDGED
            if case.name in ACCURACY:
                accuracies.append(accuracy_row(case, solver, rows))
                accuracies[-1][-1] = accuracies[-1][-1] if judged else NOT_JUDGED
            failed += failures(case, solver, rows)
            taken = f"{time.monotonic() - started:.0f} s"
            good, wrong = (int(np.count_nonzero(rows["outcome"] == name)) for name in (IDENTIFIED, WRONG))
            says = f"{case.name} · {solver}: {good} of {n}, {wrong} wrong, {np.median(rows['cpu_ms']):.2f} ms; {taken}"
            print(says, file=sys.stderr)
    tables: list[Table] = [("Identification", RATE_COLUMNS, rates)]
    if accuracies:
        tables.append(("Accuracy", ACCURACY_COLUMNS, accuracies))
    if options.out is not None:
        measured = [database_row(name) for name in options.identifier]
        tables.append(("Database for 10 degrees, to 6.5", DATABASE_COLUMNS, measured))
    if options.failures:
        title = f"Not identified, though {LISTED_STARS} or more true stars were there, and all that is wrong"
        tables.append((title, ["case", "solver", "wrong", "not identified"], failed))
    show(tables)
    if options.out is not None:
        write_markdown(options.out, "Identification", NOTES, tables)
    return int(any(row[-1] == SHORT for row in rates + accuracies))


def failures(case: Case, solver: str, rows: NDArray[np.void]) -> list[list[str]]:
    """One row listing solvable scenes that were not identified and all wrong ones; no row if there are none."""
    wrong = rows["outcome"] == WRONG
    missed = (rows["outcome"] != IDENTIFIED) & (rows["true_stars"] >= LISTED_STARS) & case.sky & ~wrong
    if solver in PEERS or not (wrong | missed).any():
        return []
    shown = [f"{row['index']} ({row['outcome']}, {row['true_stars']} stars)" for row in rows[missed][:MOST_LISTED]]
    left = int(np.count_nonzero(missed)) - len(shown)
    listed = ", ".join(shown) + (f", {left} more" if left > 0 else "")
    return [[case.name, solver, ", ".join(map(str, rows["index"][wrong])) or "–", listed or "–"]]


def million(identifier: str, total: int, seed: int, pool: ProcessPoolExecutor | None, folder: Path) -> int:
    """The long run: counts are written every ten thousand scenes, from which an interrupted run resumes."""
    case = CASES[MILLION]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{identifier}-{seed}.json"
    state = json.loads(path.read_text()) if path.exists() else {"done": 0, "outcomes": {}, "wrong": [], "cpu_s": 0.0}
    started, first = time.monotonic(), state["done"]
    while state["done"] < total:
        rows = run_case(identifier, case, min(STEP, total - state["done"]), seed, pool, start=state["done"])
        for name, count in zip(*np.unique(rows["outcome"], return_counts=True), strict=True):
            state["outcomes"][str(name)] = state["outcomes"].get(str(name), 0) + int(count)
        state["wrong"] += [int(k) for k in rows["index"][rows["outcome"] == WRONG]]
        state["cpu_s"] += float(rows["cpu_ms"].sum()) / 1e3
        costliest = rows[np.argmax(rows["operations"])]
        worst = [int(costliest["operations"]), int(costliest["index"])]
        state["worst"] = max(state.get("worst", [0, -1]), worst)
        state["done"] += len(rows)
        draft = path.with_suffix(".draft")
        draft.write_text(json.dumps(state, indent=1))
        draft.replace(path)
        a_second = (state["done"] - first) / (time.monotonic() - started)
        left_min = (total - state["done"]) / a_second / 60
        print(f"{state['done']:>9,} scenes, {a_second:.0f} a second, {left_min:.0f} min left: {state['outcomes']}")
        sys.stdout.flush()
    good = state["outcomes"].get(IDENTIFIED, 0)
    low, high = wilson_interval(good, state["done"])
    worst, index = state["worst"]
    print(f"the costliest solve took {worst / 1e6:.1f} million operations (scene {index})")
    print(
        f"{case.name}: {100 * good / state['done']:.3f} % identified (95 %: {100 * low:.3f} to {100 * high:.3f}), "
        f"{len(state['wrong'])} wrong, {1e3 * state['cpu_s'] / state['done']:.3f} ms of CPU a scene on average"
    )
    return int(bool(state["wrong"]) or (case.target is not None and good / state["done"] < case.target))


if __name__ == "__main__":
    sys.exit(main())
