"""Outcome of a frame's attitude, and the likely cause if it contradicts its stated covariance, from the truth and the
residuals of the frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import chdtri

from simulator.frame import FrameTruth
from simulator.renderer import Renderer
from simulator.study.axes import CAMERA_AXES
from simulator.study.specification.outcome import CENTROIDS, DISPLACED, NO_OUTCOME, NOISE, UNKNOWN, outcome_of
from simulator.study.specification.requirements import Specification
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources, pixel_slopes
from startracker.core import FloatArray, IntArray
from startracker.solution import Solution

_EXPLAINED = 0.25
"""Displacements explain an error if they leave less than this fraction of its square: half of it."""
_BOUNDS = 5.0
"""Number of Cramér–Rao bounds within which noise explains an error."""
_RESIDUAL_TAIL = 1e-3
"""Probability of residuals that large if the errors of the centroids are as stated."""


NO_OUTCOME_COLUMNS: dict[str, Any] = {**NO_OUTCOME._asdict(), "inconsistent_cause": ""}
"""Columns of a frame without an attitude."""


def outcome_columns(
    renderer: Renderer,
    truth: FrameTruth,
    solution: Solution,
    stars_misidentified: int,
    nees: float,
    error_deg: Mapping[str, float],
    specification: Specification,
) -> dict[str, Any]:
    """Columns of a frame: ``misidentified``, ``inconsistent``, ``wrong`` (`simulator.study.specification.outcome`) and
    ``inconsistent_cause``.

    Parameters
    ----------
    renderer, truth, solution
        Renderer of the scenario, the frame's truth and its solution.
    stars_misidentified : int
        Number of stars that are not the ones named.
    nees : float
        Error squared, normalised by the covariance of the solution; NaN without one.
    error_deg : mapping
        Error by axis, degrees.
    specification : Specification
        Its limits on errors decide whether an inconsistent attitude is wrong.
    """
    if not solution.solved:
        return NO_OUTCOME_COLUMNS
    outcome, cause = outcome_of(stars_misidentified, nees, error_deg, specification), ""
    if outcome.inconsistent:
        cause = likely_cause(renderer, truth, solution, np.array([error_deg[axis] for axis in CAMERA_AXES]))
    return {**outcome._asdict(), "inconsistent_cause": cause}


def likely_cause(renderer: Renderer, truth: FrameTruth, solution: Solution, error_deg: FloatArray) -> str:
    """Likely cause of an inconsistent attitude (`simulator.study.specification.outcome.CAUSES`).

    The first that applies:

    - `DISPLACED`: the turn by displaced star images (`systematic_turn_deg`) explains most of the error's square,
      normalised by the stated covariance;
    - `CENTROIDS`: the squares of the residuals, normalised by the stated errors, exceed what these give in one frame of
      a thousand;
    - `NOISE`: the error is within five Cramér–Rao bounds about every axis, so that the covariance is too small;
    - otherwise `UNKNOWN`.

    Parameters
    ----------
    renderer, truth
        Renderer of the scenario, and the frame's truth.
    solution : Solution
        With a covariance.
    error_deg : (3,) array
        Rotation vector of the error in camera axes, degrees.
    """
    fitted = solution.stars.fitted
    stars = matched_sources(truth, fitted.xy)
    covariance = solution.covariance
    assert covariance is not None

    def squared(error: FloatArray) -> float:
        return float(error @ np.linalg.solve(covariance, error))

    turn_deg = systematic_turn_deg(renderer, truth, stars)
    if squared(error_deg - turn_deg) < _EXPLAINED * squared(error_deg):
        return DISPLACED
    stated = np.isfinite(fitted.sigma_px)
    freedom = 2 * int(stated.sum()) - 3
    chi2 = float(np.sum((fitted.residual_px[stated] / fitted.sigma_px[stated, None]) ** 2))
    if freedom > 0 and chi2 > chdtri(freedom, _RESIDUAL_TAIL):
        return CENTROIDS
    bound_deg = attitude_bound_deg(renderer, truth, stars)
    return NOISE if (np.abs(error_deg) <= _BOUNDS * bound_deg).all() else UNKNOWN  # False for a bound of NaN


def systematic_turn_deg(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Error of the attitude about the camera's axes (3,), degrees, without any noise.

    (Σ JᵀJ)⁻¹ Σ Jᵀd of displacements d from the positions of the calibrated camera, with equal weights, minus the rate
    times the error of the time. Zero for a camera without systematic errors.

    Parameters
    ----------
    renderer, truth
        Renderer of the scenario, and a frame's truth.
    stars : (N,) int array
        Rows of the true sources that the tracker used.
    """
    plane, sources = renderer.focal_plane.at(truth.t_s), truth.sources
    turn = -truth.rate_camera_rad_s * truth.time_tag_error_s
    if (plane.true_camera is not plane.camera or not plane.displacement.is_off) and len(stars) > 1:
        directions = truth.attitude.apply(sources.direction[stars])
        slopes = pixel_slopes(plane.camera, directions)
        displaced = sources.xy[stars] - plane.camera.project(directions)
        normal = np.einsum("nji,njk->ik", slopes, slopes)
        turn = turn + np.linalg.lstsq(normal, np.einsum("nji,nj->i", slopes, displaced), rcond=None)[0]
    return np.asarray(np.degrees(turn))
