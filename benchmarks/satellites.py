"""Frames with n sunlit satellites in the field: how many are solved, how many wrong.

python -m benchmarks.satellites [--trials 200] [--counts 0 1 2 5 10 20 50 100] [--scenario cubesat] [--json FILE]

Satellites are drawn within the circle that the field holds, with V uniform from 1 to 6 and angular rates against the
stars log-uniform from 0.02 to 2°/s; their frames go through the renderer and the tracker like all others. Trial i has
the same stars, attitude and noise at every count. The exit status is 1 if an attitude is wrong.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.sky.parameters import Sky
from simulator.sky.satellites import Look, Satellites
from simulator.study.intervals import wilson_interval
from simulator.study.trials.trial import TrialRunner

FloatArray = NDArray[np.float64]

COUNTS = (0, 1, 2, 5, 10, 20, 50, 100)
BRIGHTEST_V, FAINTEST_V = 1.0, 6.0
LEAST_DEG_S, MOST_DEG_S = 0.02, 2.0
_DISTANCE_KM = 500.0


class Crossing(NamedTuple):
    """A number of satellites within an angle of the boresight, in place of `simulator.sky.satellites.SatelliteList`."""

    count: int
    radius_rad: float

    def near(self, look: Look, _: Sky) -> Satellites:
        """Satellites of an exposure, keyed by its time."""
        rng, count = np.random.default_rng([self.count, round(look.t_s * 1e3)]), self.count
        away = np.arccos(1.0 - rng.uniform(0.0, 1.0 - math.cos(self.radius_rad), count))
        unit = _rotated(look.boresight, away, rng.uniform(0.0, math.tau, count))
        along = np.cross(unit, rng.normal(size=(count, 3)))
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        rate = np.radians(LEAST_DEG_S * (MOST_DEG_S / LEAST_DEG_S) ** rng.random(count))
        return Satellites(
            number=np.arange(1, count + 1),
            name=np.array([f"object {k + 1}" for k in range(count)], dtype=np.str_),
            path_km=_DISTANCE_KM * np.stack([unit, rate[:, None] * along], axis=1),
            rate_rad_s=rate,
            v_mag=rng.uniform(BRIGHTEST_V, FAINTEST_V, count),
            angular_radius_rad=np.full(count, 1e-6),
            illuminated_fraction=np.full(count, 0.7),
        )


def _rotated(axis: FloatArray, away: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) at angles (N,) from an axis and azimuths (N,) about it."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    side = np.cos(azimuth)[:, None] * across + np.sin(azimuth)[:, None] * other
    return np.asarray(np.cos(away)[:, None] * axis + np.sin(away)[:, None] * side)


def outcomes(scenario: Scenario, counts: tuple[int, ...], trials: int) -> list[dict[str, Any]]:
    """Statistics of every count."""
    runner, rows = TrialRunner(scenario), []
    camera = runner.renderer.camera
    radius_rad = 0.5 * min(camera.width, camera.height) * camera.pixel_rad
    for count in counts:
        runner.renderer.scenes.satellites = Crossing(count, radius_rad)
        done = [runner.run(index) for index in range(trials)]
        solved = [row for row in done if row["status"] == "solved"]
        across = np.array([math.hypot(row["error_cross_x_deg"], row["error_cross_y_deg"]) for row in solved]) * 3600.0
        rows.append(
            {
                "satellites": count,
                "trials": trials,
                "solved": len(solved),
                "solved_interval95": list(wilson_interval(len(solved), trials)),
                "wrong": sum(row["wrong"] for row in done),
                "misidentified": sum(row["stars_misidentified"] for row in done),
                "detected_mean": float(np.mean([row["stars_detected"] for row in done])),
                "matched_mean": float(np.mean([row["stars_matched"] for row in solved])) if solved else math.nan,
                "across_median_arcsec": float(np.median(across)) if solved else math.nan,
                "across_p99_arcsec": float(np.quantile(across, 0.99)) if solved else math.nan,
                "nees_mean": float(np.mean([row["nees"] for row in solved])) if solved else math.nan,
                "identification_ms": float(np.median([row["identification_ms"] for row in done])),
            }
        )
        print(_line(rows[-1]), flush=True)
    return rows


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['satellites']:4d} satellites: {row['solved']}/{row['trials']} solved, {row['wrong']} wrong, "
        f"{row['misidentified']} stars misidentified; {row['detected_mean']:.1f} detected, {row['matched_mean']:.1f} "
        f"matched; error across {row['across_median_arcsec']:.2f}″ (99 %: {row['across_p99_arcsec']:.2f}″), "
        f"NEES {row['nees_mean']:.2f}; identification {row['identification_ms']:.2f} ms"
    )


def main() -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--scenario", default="cubesat_ideal")
    parser.add_argument("--set", dest="values", nargs="*", default=[])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = outcomes(Scenario.load(given.scenario, given.values), tuple(given.counts), given.trials)
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return int(any(row["wrong"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
