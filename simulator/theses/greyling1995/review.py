"""Section 5.1.2, the review of recognition algorithms, as a test: every identifier of the tracker on the same fields.

The thesis names three techniques and chooses angular separations, of which it ranks three by the information that they
require: lines (Van Bezooijen), angles (Anderson) and triangles (Cox); Yee's triads are a fourth. Here each identifier
of the product is tested on the same simulated fields, with and without the attitude of the other sensors, and with
false stars.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from simulator.randomness import stream
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.identification import (
    TABLE_5_2,
    draw_field,
    guide_database,
    judge,
    thesis_identification,
)
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker._compiled import clock
from startracker.identification import METHODS
from startracker.settings import IdentificationSettings

LIMIT = 6.2
"""Faintest guide star, V."""

CASES: dict[str, tuple[int, bool]] = {
    "prior of 1°": (0, True),
    "prior, 8 false": (8, True),
    "prior, 30 false": (30, True),
    "lost in space": (0, False),
    "lost, 12 false": (12, False),
}
"""Number of false stars in the field, and whether the attitude of the other sensors is given, by name of the case."""

TECHNIQUES = {
    "adaptive": "lines, bounded triangles and a Bayes factor, chosen by the field",
    "match_groups": "lines: Van Bezooijen's groups with the settings of the thesis' program",
    "pyramid": "triangles and a fourth star: Mortari",
    "pattern_hash": "hashed shapes of four stars",
    "triads": "two separations and their rotations: Yee",
}


class Result(NamedTuple):
    """Results of an identifier for the fields of one case: numbers identified without a false pair, accepted with one,
    and in total; median time."""

    right: int
    wrong: int
    fields: int
    time_ms: float

    def words(self) -> str:
        """Text for a table."""
        return f"{100 * self.right / self.fields:.0f} %, {self.wrong} wrong, {self.time_ms:.2g} ms"


@cache
def review(fields: int = 2, names: Sequence[str] = tuple(METHODS)) -> dict[tuple[str, str], Result]:
    """Results by identifier and case, each on the same fields: `fields` in each of Table 5.2's six regions."""
    guide = guide_database(LIMIT)
    found = {}
    for case, (false, has_prior) in CASES.items():
        drawn = [
            draw_field(guide, hour, false, stream(1, f"greyling1995 review {hour:g} {false}", trial))
            for hour in TABLE_5_2
            for trial in range(fields)
        ]
        for name in names:
            settings = thesis_identification() if name == "match_groups" else IdentificationSettings()
            times, verdicts = [], []
            for k, (prior, observed, truth) in enumerate([drawn[0], *drawn]):  # the first one twice, for compilation
                start = clock()
                answer = METHODS[name](observed, guide, settings, prior if has_prior else None)
                if k:
                    times.append(1e3 * (clock() - start))
                    verdicts.append(judge(answer, truth))
            found[name, case] = Result(verdicts.count(True), verdicts.count(False), len(drawn), float(np.median(times)))
    return found


def section(fields: int = 2) -> Section:
    """A row for each identifier, and the figure of all cases."""
    found = review(fields)
    identifiers = [
        {
            "name": name,
            "cells": "; ".join(f"{case}: {found[name, case].words()}" for case in CASES),
            "technique": TECHNIQUES.get(name, "an identifier of another package"),
        }
        for name in METHODS
    ]
    # mean distance of the nearest star of a random field: 1 / (2 √n), for n stars per square degree
    nearest_deg = 0.5 / math.sqrt(len(guide_database(LIMIT)) / 41_252.96)
    values = {"identifiers": identifiers, "nearest_deg": nearest_deg} | _curves(found)
    return section_of("greyling1995/review", "Chapter 5.1.2: recognition algorithms", values)


def _curves(found: dict[tuple[str, str], Result]) -> Values:
    curves, wrong = [], []
    for name in METHODS:
        results = [found[name, case] for case in CASES]
        percents = [100 * result.right / result.fields for result in results]
        curves.append({"name": name, "percents": percents, "times_ms": [result.time_ms for result in results]})
        wrong += [
            {"at": (k, percent), "count": result.wrong}
            for k, (result, percent) in enumerate(zip(results, percents, strict=True))
            if result.wrong
        ]
    fields = next(iter(found.values())).fields
    cases = {"ticks": np.arange(len(CASES)), "cases": list(CASES)}
    return cases | {"curves": curves, "wrong": wrong, "fields": fields, "limit": LIMIT}
