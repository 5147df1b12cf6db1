"""Predicted accuracy of a scenario's camera at many attitudes, and what the prediction leaves out.

The light of each star gives its centroid error (`simulator.study.coverage.sensitivity`), and the stars of each field
the attitude covariance P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (Shuster & Oh 1981). Nothing is rendered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.build import build_mounting
from simulator.mission.clock import Clock
from simulator.scenario import Scenario
from simulator.sky.colours import spectral_coordinates
from simulator.study.budget.effects import EFFECTS
from simulator.study.coverage.boresights import Boresights
from simulator.study.coverage.field_counts import accumulate_information, outline
from simulator.study.coverage.sensitivity import build_sensitivity, nominal_rate_rad_s
from simulator.study.specification.predicted import Predicted
from simulator.study.specification.requirements import specification_of
from startracker.catalog import load_catalog
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.guide import RESOLVED_PX
from startracker.catalog.sky_view import voxel_grid
from startracker.core import IntArray
from startracker.errors import InputError

LEAST_STARS = 2
"""Minimum number of stars of an attitude."""

_BLEND_MAG = 0.8
_CONTAINED = frozenset(
    {
        "shot noise", "read noise", "gain of the intensifier", "video noise", "quantisation", "sky background",
        "dark current", "dark non-uniformity", "response non-uniformity", "smear by rates",
    }
)  # fmt: skip
"""Effects of the error budget that the noise of a pixel or the image of a star contains."""
_EFFICIENT = ("least_squares", "maximum_likelihood")
"""Centroiders that come close to the Cramér–Rao bound."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Stars and accuracy at many attitudes."""

    magnitude_limit: float
    """Faintest star counted, V: the detection limit of the camera or the limit of the tracker's catalogue."""
    counts: IntArray
    """(N,): Stars used in the field at each attitude."""
    evidence: Predicted
    """Covariances at the attitudes with enough stars that violate no exclusion angle."""


def predict(scenario: Scenario, looks: Boresights, least_stars: int) -> Prediction:
    """Stars and accuracy of a scenario's camera at the given attitudes.

    Stars are counted if they are in the tracker's catalogue and detected by the camera; the brightest up to the
    tracker's maximum (`tracker.detection.max_stars`). Attitudes within an exclusion angle do not count.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    looks : Boresights
        N attitudes.
    least_stars : int
        Minimum number of stars for an attitude to be available, at least `LEAST_STARS`.

    Raises
    ------
    InputError
        If the tracker's catalogue has no star of its magnitude limit.
    """
    sensitivity = build_sensitivity(scenario)
    camera = sensitivity.camera
    known = scenario.tracker.magnitude_limit
    every = load_catalog(scenario.tracker.catalog).brighter_than(known + _BLEND_MAG)
    if len(every) == 0:
        raise InputError(f"no star of the catalogue is brighter than {known:g}")
    stars = merge_doubles(every, min(RESOLVED_PX * camera.pixel_rad, 0.1)).brighter_than(known)
    b_v, giant = spectral_coordinates(stars.b_v, stars.spectral_type)
    electrons = sensitivity.electrons_of(stars.v_mag, b_v, giant)
    rows = np.argsort(-electrons, kind="stable")
    rows = rows[electrons[rows] >= sensitivity.least_electrons]
    directions = stars.directions(float(Clock(scenario.epoch).jyear(0.0)))[rows]
    counts, information = accumulate_information(
        looks.matrices,
        directions,
        voxel_grid(directions),
        outline(camera),
        1.0 / sensitivity.sigma_rad(electrons[rows]) ** 2,
        scenario.tracker.detection.max_stars,
        np.ascontiguousarray(looks.nadir),
        looks.limb_cosine,
    )
    enough = (counts >= max(least_stars, LEAST_STARS)) & looks.allowed
    evidence = Predicted(
        np.asarray(np.linalg.inv(information[enough]), dtype=float),
        build_mounting(scenario).inverse.as_matrix(),
        int(looks.allowed.sum()),
        specification_of(scenario),
        math.degrees(float(np.linalg.norm(nominal_rate_rad_s(scenario)))),
    )
    return Prediction(min(sensitivity.magnitude_limit, known), counts, evidence)


def left_out(scenario: Scenario) -> tuple[str, ...]:
    """What a scenario contains and its prediction does not, as names for display."""
    names = [effect.name for effect in EFFECTS if effect.name not in _CONTAINED and effect.off(scenario)]
    if scenario.tracker.centroider not in _EFFICIENT:
        names.append(f"the centroider '{scenario.tracker.centroider}', less accurate than the bound")
    if scenario.detector.shutter == "rolling":
        names.append("rolling shutter")
    return (*names, "stars that are not detected or not identified")
