"""Identification of the flight build in C compared with `StarTracker`, on the same lists of stars, lost in space.

nice python -m benchmarks.flight_tracker [--camera cubesat ...] [--identifier triads] [--n 420] [--rate 1e-7] [--seed 1]

For each camera and kind of field: lists that `StarTracker.solve_centroids` and the C solve, that only one of them does;
attitudes of the C off by more than 0.1 degrees (the Vega camera: 1 degree), which are wrong, and beyond 5 sigma of
their covariance; true stars with the number of another one, and false stars with a number; and its steps. Then lists
that are not a sky, all of whose solutions are wrong. Exit status 1 if anything is wrong.

Beyond 5 sigma is a squared error over the covariance above 31.8, of probability 5.7e-7 for a normal distribution (chi
squared, 3 degrees of freedom); the covariance is estimated from 2 n residuals and a prior worth 20, so that the error
follows Student's distribution of 17 + 2 n degrees of freedom, whose expected number is stated.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import f as fisher

from benchmarks.flight_lists import FIELDS, Field, field_list, null_list
from benchmarks.pattern_lists import PATTERNS
from simulator.randomness import stream
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.flight.design import camera_design
from startracker import Camera, StarTracker
from startracker.core import FloatArray, IntArray
from startracker.flight.design import IDENTIFIERS, DetectorNumbers, FlightDesign
from startracker.flight.export import flight_export
from startracker.flight.stars import StarList
from startracker.geometry.attitude import Attitude
from startracker.settings import IdentificationSettings
from startracker.settings.identification import settings_of

FIELDS_OF_VIEW = {"cubesat": (12.86, 7.0), "10 deg": (10.0, 7.0), "20 deg": (20.0, 6.0), "6 deg": (6.0, 7.6)}
"""Field of view across 1024 pixels, degrees, and magnitude limit of the guide stars."""
VEGA = ((427, 319), (9.238, 7.008), (30.0, 90.0), 6.0)
"""Camera of the Vega image of Yee 1999: size, field, declinations of the guide stars, magnitude limit."""
CAMERAS = (*FIELDS_OF_VIEW, "vega")
LARGEST_CHI2, LARGEST_DEG = 31.8, 0.1
LARGEST_VEGA_DEG = 1.0
"""A rotation of the Vega camera about its axis by 0.1 degrees moves the corner of the image by half a pixel, which is
within the errors of a few stars; one by 1 degree moves it by 5."""


class Judged(NamedTuple):
    """Faults of answers, or their sums: beyond 0.1 degrees; beyond 5 sigma, and the expected number; true stars with
    another one's number, false stars with a number."""

    far: int = 0
    beyond: int = 0
    expected: float = 0.0
    misnamed: int = 0
    named: int = 0


class Answer(NamedTuple):
    """A line of the C program."""

    status: str
    steps: int
    matrix: FloatArray | None
    covariance: FloatArray | None
    numbers: IntArray
    """Catalogue numbers (N,) of the list's stars, 0: none."""

    @classmethod
    def of_line(cls, line: str) -> Answer:
        status, _, *rest = line.split()
        values = dict(part.split("=") for part in rest)
        if status != "solved":
            return cls(status, int(values["steps"]), None, None, np.zeros(0, np.int64))
        matrix = Attitude(np.array(values["quaternion"].split(","), float)).as_matrix()
        covariance = np.array(values["covariance"].split(","), float).reshape(3, 3) / float(1 << 60)
        return cls(status, int(values["steps"]), matrix, covariance, np.array(values["numbers"].split(","), np.int64))

    def judged(self, one: Field, largest_deg: float = LARGEST_DEG) -> Judged:
        """Compared with the truth; errors beyond `largest_deg` are wrong."""
        if self.matrix is None or self.covariance is None:
            return Judged()
        turn = self.matrix @ one.matrix.T
        error = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        far = float(np.degrees(np.linalg.norm(error))) > largest_deg or float(np.trace(turn)) < 1.0
        named = self.numbers > 0
        freedom = 17 + 2 * np.count_nonzero(named)
        return Judged(
            int(far),
            int(far or float(error @ np.linalg.solve(self.covariance, error)) > LARGEST_CHI2),
            float(fisher.sf(LARGEST_CHI2 / 3.0 * freedom / (freedom - 2), 3, freedom)),
            int(np.count_nonzero(named & (one.number > 0) & (self.numbers != one.number))),
            int(np.count_nonzero(named & (one.number == 0))),
        )


def lists_text(lists: Sequence[StarList]) -> str:
    """Lists as the C program reads them."""
    rows = ("".join("{} {} {} {} {}\n".format(*star) for star in zip(*one, strict=True)) for one in lists)
    return "".join(row + "\n" for row in rows)


def solved_by(build: Build, lists: Sequence[StarList]) -> list[Answer]:
    """Answers of the C program."""
    lines = build.run(lists_text(lists).encode(), "stars").decode().splitlines()
    return [Answer.of_line(line) for line in lines]


class Target(NamedTuple):
    """A camera under test."""

    tracker: StarTracker
    """Solves the same lists."""
    sky: StarTracker
    """Its guide stars are those of the lists: the whole sky."""
    build: Build
    """The compiled flight build."""
    largest_deg: float = LARGEST_DEG
    """Errors beyond this are wrong."""


def make(name: str, identifier: str, rate: float, folder: Path) -> Target:
    """A camera with its flight build compiled in a folder."""
    if name == "vega":
        return make_vega(identifier, rate, folder)
    fov, limit = FIELDS_OF_VIEW[name]
    camera = Camera.from_fov(fov_deg=fov, width=1024, height=1024)
    tracker = StarTracker(camera, magnitude_limit=limit, identifier=identifier)
    settings = replace(tracker.identification, false_alarm_rate=rate)
    tracker.identification = settings
    numbers = DetectorNumbers(1.0, 10.0, 4095)
    design = FlightDesign(camera, tracker.guide, numbers, 0.9, identification=settings, identifier=identifier)
    return Target(tracker, tracker, compile_export(flight_export(design), folder))


def make_vega(identifier: str, rate: float, folder: Path) -> Target:
    """A build from centroids with the guide stars of a part of the sky; lists are of the whole sky."""
    size_px, fov_deg, declination_deg, limit = VEGA
    settings = settings_of(identifier, IdentificationSettings(false_alarm_rate=rate))
    design = camera_design(size_px, fov_deg, settings, identifier, "fixed", declination_deg, limit)
    tracker, sky = (
        StarTracker(
            design.camera, catalog=catalog, magnitude_limit=limit, identifier=identifier, identification=settings
        )
        for catalog in (design.guide.catalog, "bsc5")
    )
    return Target(tracker, sky, compile_export(flight_export(design), folder), LARGEST_VEGA_DEG)


class Compared(NamedTuple):
    """Lists that both solve, that only `StarTracker` does, that only the C does; faults; median and most steps."""

    both: int
    only_python: int
    only_c: int
    faults: Judged
    median: int
    most: int

    def __str__(self) -> str:
        far, beyond, expected, misnamed, named = self.faults
        counts = f"{self.both:6} {self.only_python:17} {self.only_c:7} {far:10} {beyond:12} {expected:9.4f}"
        return f"{counts} {misnamed:9} {named:6} {self.median:13,} {self.most:11,}"


COLUMNS = (
    "kind               lists   both  only StarTracker  only C  > 0.1 deg    > 5 sigma  expected  misnamed  false  "
)
COLUMNS += "median steps        most"


def compare_fields(target: Target, lists: Sequence[Field]) -> Compared:
    """Solve lists with both."""
    answers = solved_by(target.build, [one.stars for one in lists])
    both = np.zeros((2, 2), int)
    for one, answer in zip(lists, answers, strict=True):
        solution = target.tracker.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px)
        both[int(solution.solved), int(answer.status == "solved")] += 1
    faults = [answer.judged(one, target.largest_deg) for one, answer in zip(lists, answers, strict=True)]
    steps = [answer.steps for answer in answers]
    sums = Judged(*(sum(column) for column in zip(*faults, strict=True)))
    return Compared(int(both[1, 1]), int(both[1, 0]), int(both[0, 1]), sums, int(np.median(steps)), max(steps))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all kinds; returns 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--camera", choices=CAMERAS, action="append")
    parser.add_argument("--identifier", choices=IDENTIFIERS, default="adaptive")
    parser.add_argument("--n", type=int, default=420, help="lists of each kind of field")
    parser.add_argument("--null", type=int, default=100, help="lists of each kind that is not a sky")
    parser.add_argument("--rate", type=float, default=1e-7, help="false-alarm rate")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    wrong = 0
    for name in options.camera or CAMERAS:
        with tempfile.TemporaryDirectory() as folder:
            target = make(name, options.identifier, options.rate, Path(folder))
            build = target.build
            memory = f"tables {build.table_bytes:,}, code {build.code_bytes:,}, context {build.context_bytes:,}"
            print(f"{name}: bytes of {memory}")
            print(COLUMNS)
            for number, (kind, what) in enumerate(FIELDS.items()):
                rng = stream(options.seed, f"flight {name}", number)
                found = compare_fields(target, [field_list(target.sky, what, rng) for _ in range(options.n)])
                print(f"{kind:18} {options.n:5} {found}", flush=True)
                wrong += found.faults.far
            for number, pattern in enumerate(PATTERNS):
                rng = stream(options.seed, f"flight null {name}", number)
                answers = solved_by(build, [null_list(target.sky, pattern, rng) for _ in range(options.null)])
                solved = sum(answer.status == "solved" for answer in answers)
                most = max(answer.steps for answer in answers)
                print(f"{pattern:18} {options.null:5} {solved:6} {'':88} {most:11,}", flush=True)
                wrong += solved
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
