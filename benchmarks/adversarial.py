"""Point lists that are not a sky: how many are accepted, and the cost of the most expensive one.

python -m benchmarks.adversarial [--n 10000] [--kind WORD ...] [--camera NAME ...] [--workers 2] [--seed 1]
python -m benchmarks.adversarial --n 100000 --state FOLDER       (resumes an interrupted run)

Every list has its own random stream, keyed by (seed, kind, camera, index): `make(kind, camera, seed, index)` gives the
same list as in a run. Any accepted list is an error, and the exit status is then 1.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import stream
from startracker import Camera, StarTracker, load_catalog
from startracker.blind import solve_unknown_fov
from startracker.settings import IdentificationSettings

FloatArray = NDArray[np.float64]

FEWEST, MOST = 5, 60
"""Number of points of a list, log-uniform: chance matches are most likely in short lists."""
_CHUNK = 200
_LISTED = 20


@dataclass(frozen=True)
class Setup:
    """A camera and the magnitude limit of its guide stars."""

    fov_deg: float
    size_px: int
    magnitude_limit: float

    def camera(self) -> Camera:
        """The camera."""
        return Camera.from_fov(self.fov_deg, self.size_px, self.size_px)


SETUPS = {
    "15deg": Setup(15.0, 1024, 6.5),
    "10deg": Setup(10.0, 512, 6.5),
    "20deg": Setup(20.0, 512, 5.5),
}


# ---------------------------------------------------------------------- points
def uniform(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """Uniform over the image."""
    return rng.uniform(0.0, size, (n, 2))


def clump(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """One compact cluster, a disk or a Gaussian, with a radius of 0.5 % to 15 % of the image."""
    radius = size * math.exp(rng.uniform(math.log(0.005), math.log(0.15)))
    centre = rng.uniform(radius, size - radius, 2)
    if rng.random() < 0.5:
        return centre + 0.5 * radius * rng.standard_normal((n, 2))
    angle, distance = rng.uniform(0.0, 2.0 * math.pi, n), radius * np.sqrt(rng.random(n))
    return centre + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def pleiades_size(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """One cluster of the size of open clusters: radius 2 % to 10 % of the image."""
    radius = size * rng.uniform(0.02, 0.10)
    return rng.uniform(radius, size - radius, 2) + 0.6 * radius * rng.standard_normal((n, 2))


def clumps(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """Two to five clusters, with up to a third of the points uniform."""
    count, loose = int(rng.integers(2, 6)), int(rng.integers(0, n // 3 + 1))
    centres = rng.uniform(0.05 * size, 0.95 * size, (count, 2))
    radius = size * np.exp(rng.uniform(math.log(0.005), math.log(0.1), count))
    of = rng.integers(count, size=n - loose)
    return np.concatenate(
        [centres[of] + radius[of, None] * rng.standard_normal((n - loose, 2)), uniform(rng, loose, size)]
    )


def clump_and_field(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """A cluster of a third to nine tenths of the points, the rest uniform."""
    inside = max(int(n * rng.uniform(0.33, 0.9)), 3)
    return np.concatenate([clump(rng, inside, size), uniform(rng, n - inside, size)])


def grid(rng: np.random.Generator, n: int, size: float, jitter: float = 0.0) -> FloatArray:
    """A grid of random spacing, aspect ratio and angle; the n points nearest to its centre."""
    spacing = size * np.exp(rng.uniform(math.log(0.02), math.log(0.8 / math.sqrt(n)), 2 if rng.random() < 0.5 else 1))
    angle = rng.uniform(0.0, math.pi) if rng.random() < 0.7 else 0.0
    steps = np.arange(-12, 13)
    points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * spacing
    if rng.random() < 0.3:  # hexagonal
        points[:, 0] += 0.5 * spacing[0] * (np.repeat(steps, len(steps)) % 2)
    points = points[np.argsort(np.hypot(*points.T) + 1e-9 * rng.random(len(points)), kind="stable")[:n]]
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    middle = rng.uniform(0.3, 0.7, 2) * size
    return points @ turn.T + middle + jitter * float(spacing.min()) * rng.standard_normal((n, 2))


def grid_with_jitter(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """The same, with every point displaced by 0.1 % to 20 % of the spacing."""
    return grid(rng, n, size, math.exp(rng.uniform(math.log(0.001), math.log(0.2))))


def line(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """Along one line, regular or random, with a scatter of 0 to 10 px across it."""
    ends = rng.uniform(0.02 * size, 0.98 * size, (2, 2))
    at = np.linspace(0.0, 1.0, n) if rng.random() < 0.5 else rng.random(n)
    scatter = 0.0 if rng.random() < 0.3 else math.exp(rng.uniform(math.log(0.05), math.log(10.0)))
    return ends[0] + at[:, None] * (ends[1] - ends[0]) + scatter * rng.standard_normal((n, 2))


def lines(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """Two to six lines, parallel or not: satellite trains, blooming, rows of hot pixels."""
    count = int(rng.integers(2, 7))
    direction = np.repeat(rng.uniform(0.0, math.pi, 1), count) if rng.random() < 0.5 else rng.uniform(0, math.pi, count)
    middles, lengths = rng.uniform(0.1 * size, 0.9 * size, (count, 2)), size * rng.uniform(0.05, 0.9, count)
    of, at = rng.integers(count, size=n), rng.uniform(-0.5, 0.5, n)
    along = np.stack([np.cos(direction[of]), np.sin(direction[of])], axis=1)
    return middles[of] + (lengths[of] * at)[:, None] * along + rng.choice([0.0, 0.3, 2.0]) * rng.standard_normal((n, 2))


def arc(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """Along an arc or a full circle: edge of a lens flare, limb of the Moon."""
    radius = size * math.exp(rng.uniform(math.log(0.01), math.log(2.0)))
    span = min(rng.uniform(0.2, 2.0 * math.pi), 0.8 * size / radius)
    start = rng.uniform(0.0, 2.0 * math.pi)
    at = start + span * (np.linspace(0.0, 1.0, n) if rng.random() < 0.5 else rng.random(n))
    points = radius * np.stack([np.cos(at), np.sin(at)], axis=1)
    points += rng.uniform(0.3, 0.7, 2) * size - points.mean(axis=0)
    return points + rng.choice([0.0, 0.3, 2.0]) * rng.standard_normal((n, 2))


KINDS: dict[str, Callable[[np.random.Generator, int, float], FloatArray]] = {
    "uniform": uniform,
    "clump": clump,
    "cluster size": pleiades_size,
    "clumps": clumps,
    "clump and field": clump_and_field,
    "grid": grid,
    "grid with jitter": grid_with_jitter,
    "line": line,
    "lines": lines,
    "arc": arc,
}


@lru_cache(maxsize=4)
def _magnitudes(limit: float) -> FloatArray:
    return np.array(load_catalog("hipparcos").brighter_than(limit).v_mag)


def make(kind: str, name: str, seed: int, index: int) -> tuple[FloatArray, FloatArray | None]:
    """Points (N, 2), and signal (N,) or None, of one list."""
    rng = stream(seed, f"adversarial {kind} {name}", index)
    return drawn(rng, kind, name, int(math.exp(rng.uniform(math.log(FEWEST), math.log(MOST + 1)))))


def drawn(rng: np.random.Generator, kind: str, name: str, n: int) -> tuple[FloatArray, FloatArray | None]:
    """The same with n points, without those outside the image."""
    setup = SETUPS[name]
    size = setup.size_px - 1.0
    xy = KINDS[kind](rng, n, size)
    xy = xy[((xy >= 0.0) & (xy <= size)).all(axis=1)]
    brightness = rng.random()
    if brightness < 0.4:  # like stars, so that it does not distinguish them
        magnitudes = _magnitudes(setup.magnitude_limit)
        return xy, 10.0 ** (-0.4 * np.sort(magnitudes[rng.integers(len(magnitudes), size=len(xy))]))
    if brightness < 0.7:
        return xy, np.sort(rng.uniform(0.1, 1.0, len(xy)))[::-1].copy()
    return xy, None


# ---------------------------------------------------------------------- answers
@lru_cache(maxsize=8)
def tracker(name: str, identifier: str, rate: float) -> StarTracker:
    """The tracker of one camera."""
    setup = SETUPS[name]
    settings = IdentificationSettings(false_alarm_rate=rate)
    return StarTracker(
        setup.camera(), magnitude_limit=setup.magnitude_limit, identifier=identifier, identification=settings
    )


def run_chunk(identifier: str, kind: str, name: str, seed: int, rate: float, start: int, stop: int) -> dict[str, Any]:
    """Results of lists of one kind: counts by status, the most expensive list, the accepted lists."""
    counts: dict[str, int] = {}
    worst, accepted, spent = (0, -1), [], time.process_time()
    for index in range(start, stop):
        xy, flux = make(kind, name, seed, index)
        if identifier == "free_scale":
            size = SETUPS[name].size_px
            found = solve_unknown_fov(
                xy, size, size, flux=flux, identification=IdentificationSettings(false_alarm_rate=rate)
            )
        else:
            found = tracker(name, identifier, rate).solve_centroids(xy, flux)
        counts[str(found.status)] = counts.get(str(found.status), 0) + 1
        worst = max(worst, (getattr(found, "operations", 0), index))
        if found.solved:
            accepted.append({"index": index, "points": len(xy), "reason": found.reason})
    return {"counts": counts, "worst": worst, "accepted": accepted, "cpu_s": time.process_time() - spent}


def merge(state: dict[str, Any], new: dict[str, Any]) -> None:
    """Add the counts of a chunk to those of a kind."""
    for status, count in new["counts"].items():
        state["counts"][status] = state["counts"].get(status, 0) + count
    state["worst"] = max(tuple(state["worst"]), new["worst"])
    state["accepted"] += new["accepted"]
    state["cpu_s"] += new["cpu_s"]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if a list is accepted."""
    options = parser().parse_args(arguments)
    options.state.mkdir(parents=True, exist_ok=True)
    rows = [
        (kind, name)
        for kind in KINDS
        for name in options.camera
        if not options.kind or any(word == kind or (word not in KINDS and word in kind) for word in options.kind)
    ]
    total = accepted = 0
    with ProcessPoolExecutor(options.workers) as pool:
        for kind, name in rows:
            label = f"{options.identifier}-{kind}-{name}-{options.seed}-{options.rate:g}".replace(" ", "_")
            path = options.state / f"{label}.json"
            empty: dict[str, Any] = {"done": 0, "counts": {}, "worst": (0, -1), "accepted": [], "cpu_s": 0.0}
            state = json.loads(path.read_text()) if path.exists() else empty
            starts = iter(range(state["done"], options.n, _CHUNK))
            while batch := list(islice(starts, 4 * options.workers)):
                jobs = [
                    pool.submit(
                        run_chunk,
                        options.identifier,
                        kind,
                        name,
                        options.seed,
                        options.rate,
                        k,
                        min(k + _CHUNK, options.n),
                    )
                    for k in batch
                ]
                for job in jobs:
                    merge(state, job.result())
                state["done"] = min(batch[-1] + _CHUNK, options.n)
                draft = path.with_suffix(".draft")
                draft.write_text(json.dumps(state, indent=1))
                draft.replace(path)
            total, accepted = total + state["done"], accepted + len(state["accepted"])
            print(row_text(kind, name, state), flush=True)
            for case in state["accepted"][:_LISTED]:
                print(f"    accepted: list {case['index']}, {case['points']} points: {case['reason']}", flush=True)
    print(f"{total:,} lists, {accepted} accepted")
    expected = options.rate * total
    return int(accepted > expected + 3.0 * math.sqrt(expected))


def row_text(kind: str, name: str, state: dict[str, Any]) -> str:
    """One line of the report."""
    says = ", ".join(f"{count} {status}" for status, count in sorted(state["counts"].items()))
    worst, index = state["worst"]
    each_ms = 1e3 * state["cpu_s"] / max(state["done"], 1)
    return (
        f"{kind:<17} {name:<6} {state['done']:>8,} lists: {len(state['accepted'])} accepted ({says}); "
        f"at most {worst / 1e6:.1f} million operations (list {index}), {each_ms:.1f} ms of CPU each"
    )


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.adversarial", description=__doc__.splitlines()[0])
    made.add_argument("--n", type=int, default=1000, help="lists of each kind and camera")
    made.add_argument("--kind", nargs="*", default=[], metavar="WORD", help="kinds whose name contains a word")
    made.add_argument("--camera", nargs="*", default=["15deg"], choices=list(SETUPS))
    made.add_argument("--identifier", default="adaptive", help="identifier by name, or free_scale")
    made.add_argument("--rate", type=float, default=1e-7, help="false_alarm_rate of the settings")
    made.add_argument("--seed", type=int, default=1)
    made.add_argument("--workers", type=int, default=1)
    made.add_argument("--state", type=Path, default=Path("out/adversarial"), help="folder of the counts")
    return made


if __name__ == "__main__":
    sys.exit(main())
