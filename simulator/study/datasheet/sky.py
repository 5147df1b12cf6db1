"""Sky coverage, exclusion angles, and availability over the orbit and the year."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.constants import TROPICAL_YEAR_S
from simulator.scenario import Scenario
from simulator.study.coverage.survey import Coverage, coverage
from simulator.study.datasheet.sheet import Amounts, Estimate, Quantity, cross_square_deg2, mean_of, proportion
from startracker.core import ARCSEC_PER_DEG, Columns

STARS_NEEDED = (3, 5)
"""Numbers of detectable catalogue stars for which the coverage is stated."""

BINS = 12
"""Bins of the orbit and of the year."""

FEWEST_STARS_OF_A_TREND = 15
"""Minimum number of attitudes for a point of the error against the number of stars."""


def sky_coverage(scenario: Scenario, amounts: Amounts) -> list[Quantity]:
    """Stars in the field and exclusion, over the whole sky and, if the attitude follows a path, along it."""
    quantities = _covered(coverage(scenario, amounts.directions), "sky", "directions of the sky")
    if scenario.study.sampling != "sky" or scenario.pointing.target is not None:
        found = coverage(scenario, amounts.directions, path=True)
        quantities += _covered(found, "path", "instants of the mission")
    return quantities


def _covered(found: Coverage, name: str, where: str) -> list[Quantity]:
    counts, count = found.allowed_counts, len(found.boresights)
    method = f"{count} {where}; stars to V = {found.magnitude_limit:.2f}: {found.limit_reason}"
    quantities = [
        Quantity(
            f"coverage_{name}_{stars}",
            f"At least {stars} stars, share of the {where} not excluded",
            proportion(counts >= stars),
            interpretation="ensemble",
            method=method,
        )
        for stars in STARS_NEEDED
    ]
    for body in ("sun", "moon", "earth"):
        angle = getattr(found.exclusion, f"{body}_deg")
        seen = found.boresights.excluded.get(body, np.zeros(count, dtype=bool))
        limb = " of its limb" if body == "earth" else ""
        source = f"optics.baffle.{body}_exclusion_deg" if angle else "no baffle in the scenario (optics.baffle.pst)"
        quantities.append(
            Quantity(
                f"excluded_{name}_{body}",
                f"Excluded by the {body.title()}, share of the {where}",
                proportion(seen),
                interpretation="ensemble",
                method=f"boresight within {angle:g}°{limb}; {source}; {count} {where}",
            )
        )
    return quantities


def availability(columns: Columns) -> dict[str, list[dict[str, Any]]]:
    """Points of plots from the trials: share of correct attitudes over orbit and year, error against stars."""
    right = columns["right"]
    year = (columns["t_s"] / TROPICAL_YEAR_S) % 1.0
    return {
        "orbit": _binned(columns["orbit_argument_deg"] % 360.0 / 360.0, right, 360.0),
        "year": _binned(year, right, 12.0),
        "stars": _against_stars(columns),
    }


def _binned(share: NDArray[Any], right: NDArray[Any], scale: float) -> list[dict[str, Any]]:
    number = np.minimum((share * BINS).astype(int), BINS - 1)
    points = []
    for k in range(BINS):
        members = right[number == k]
        if len(members):
            points.append({"value": (k + 0.5) / BINS * scale, "available": list(proportion(members))})
    return points


def _against_stars(columns: Columns) -> list[dict[str, Any]]:
    """Mean square error per axis across the boresight, in groups of equal size by the number of stars."""
    right = columns["right"]
    stars = columns["stars_matched"][right]
    squares = cross_square_deg2(columns)[right] * ARCSEC_PER_DEG**2
    groups = min(8, len(stars) // FEWEST_STARS_OF_A_TREND)
    points = []
    for members in np.array_split(np.argsort(stars, kind="stable"), groups) if groups else ():
        power = mean_of(squares[members])
        size = Estimate(*(None if part is None else float(np.sqrt(max(part, 0.0))) for part in power))
        points.append({"value": float(stars[members].mean()), "cross_rms_arcsec": list(size)})
    return points
