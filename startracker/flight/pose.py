"""Tables of the attitude and covariance of a frame from its identified stars.

The steps of the C (`c/tracker_pose.c`) are those of `startracker.estimation.refine`: all stars of the list that agree
with guide stars of the field are matched again with the attitude of the identified ones, with gates from the median of
the residuals; then the fit (`c/tracker_pose_fit.c`) estimates the actual errors, and its gates select the stars of the
next fit, until they no longer change. Residuals are measured in pixels of the image, through the derivatives of the
grid table.

The fit estimates rotation, focal length and shears, averaged over models of their errors. The models, their priors and
the average are those of `startracker.estimation.pose`: a factor of all variances, a systematic error τ equal for all
stars, and the camera as calibrated, with a free focal length, or with shears as well. Left out are unequal axes of the
systematic error and errors that depend on the sub-pixel position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.errors import InputError
from startracker.estimation.pose import FOCAL_SIGMA, FREE_FOCAL_SIGMA, SHEAR_SIGMA, SYSTEMATIC
from startracker.flight.apparent import guide_motion
from startracker.flight.c_table import CTable
from startracker.flight.design import FlightDesign
from startracker.flight.directions import GridTables, grid_tables, slopes_of
from startracker.flight.integers import DIRECTION_BITS, Integers, rounded

POSE_MODULES = ("integers", "arithmetic", "linear", "directions", "pose_fit", "pose")
COVARIANCE_BITS = 60
"""Fraction bits of the covariance, square radians."""
PRIOR_BITS = 24
GRID = len(SYSTEMATIC)
_MODELS, _SIZES = (0.6, 0.3, 0.1), (3, 4, 6)
_UNKNOWN_PX = 0.15
"""Standard error of a star of unknown error."""
_MARGIN_PX, _MARGIN_RAD = 3.0, 2.5e-4
"""Guide stars up to this far outside the image may have a centroid on it; plus aberration."""
_MOST_FIELD = 250


class FitPriors(NamedTuple):
    """Priors in the units of the columns."""

    information: Integers
    """1/σ² of focal length and shears in each model, 24 fraction bits, (3, 3)."""
    model: Integers
    """log₂ of the prior of each model and of the densities at the centre of its unknowns' priors, 24 fraction bits."""
    systematic: Integers
    """log₂ of the prior of each systematic error, 24 fraction bits, (20,)."""


class PoseTables(NamedTuple):
    """Guide stars and constants of one camera."""

    guide: Integers
    """Directions of 2.30, brightest first, (G, 3)."""
    motion: Integers
    """Proper motions a year, unit vectors of 29 fraction bits, (G, 3)."""
    grid: GridTables
    priors: FitPriors
    radius_bits: int
    """The unit of rotations about the boresight and of the camera's unknowns: they move a star at 2^`radius_bits`
    pixels from the principal point by one pixel."""
    centre: Integers
    """Principal point, pixels of 16 fraction bits, (2,)."""
    floor: int
    unknown: int
    """Variances of the catalogue, and of a star of unknown error, square pixels of 36 fraction bits."""
    margin: int
    """Width of the border around the image, pixels of 16 fraction bits."""
    most_field: int
    """Largest number of guide stars that are compared with the stars, the brightest of the field."""


def pose_tables(design: FlightDesign) -> PoseTables:
    """Tables of a design.

    Raises
    ------
    InputError
        For a camera with a rolling shutter or a mirrored image, or one that `grid_tables` refuses.
    """
    camera, guide = design.camera, design.guide
    if camera.row_time_s:
        raise InputError("a flight build takes cameras with a global shutter; this one exposes its rows in turn")
    if camera.parity < 0:
        raise InputError(
            "a flight build takes images that are not mirrored; reverse the columns before it, with parity 1"
        )
    grid = grid_tables(design)
    _check_slopes(grid)
    radius_bits = math.ceil(math.log2(0.5 * math.hypot(camera.width, camera.height)))
    share = (1.0 - math.cos(camera.half_diagonal_rad)) / 2.0
    one = float(1 << 36)
    return PoseTables(
        rounded(guide.directions, DIRECTION_BITS),
        guide_motion(guide),
        grid,
        fit_priors(float(1 << radius_bits)),
        radius_bits,
        np.rint(np.array([camera.cx, camera.cy]) * 65536.0).astype(np.int64),
        round((guide.catalog.position_sigma_rad / camera.pixel_rad) ** 2 * one),
        round(_UNKNOWN_PX**2 * one),
        round((_MARGIN_PX + _MARGIN_RAD * camera.fx) * 65536.0),
        min(max(60, round(2.5 * share * len(guide)) + 30), _MOST_FIELD),
    )


def fit_priors(radius_px: float) -> FitPriors:
    """Priors for columns in units of a radius."""
    sigma = np.array(
        [[FOCAL_SIGMA] + [SHEAR_SIGMA] * 2, [FOCAL_SIGMA] + [SHEAR_SIGMA] * 2, [FREE_FOCAL_SIGMA] + [SHEAR_SIGMA] * 2]
    )
    information = 1.0 / (sigma * radius_px) ** 2
    model = [
        math.log2(share) + 0.5 * float(np.log2(information[m, : size - 3]).sum())
        for m, (share, size) in enumerate(zip(_MODELS, _SIZES, strict=True))
    ]
    falling = 0.75 ** (0.5 * np.arange(GRID - 1))
    systematic = np.log2(np.concatenate([[1.0], falling / falling.sum()]))
    one = float(1 << PRIOR_BITS)
    return FitPriors(*(np.rint(values * one).astype(np.int64) for values in (information, np.array(model), systematic)))


def _check_slopes(grid: GridTables) -> None:
    x, y = (np.linspace(0.0, n - 1.0, 20) * 65536.0 for n in grid.size)
    slopes = slopes_of(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.int64), grid)
    if np.linalg.det(slopes / 65536.0).min() < 0.55:
        raise InputError(
            "a flight build takes lenses that magnify the edge of the field less than 1.8 times in area over the "
            "centre, and nearly square pixels; use another lens model"
        )


def pose_constants(t: PoseTables) -> dict[str, int]:
    """Macros of the exported tables, without those of the grid."""
    return {
        "POSE_GUIDES": len(t.guide),
        "POSE_GRID": GRID,
        "POSE_RADIUS_BITS": t.radius_bits,
        "POSE_CENTRE_X": int(t.centre[0]),
        "POSE_CENTRE_Y": int(t.centre[1]),
        "POSE_FLOOR": t.floor,
        "POSE_UNKNOWN": t.unknown,
        "POSE_MARGIN": t.margin,
        "POSE_LEAST_COSINE": _least_cosine(t),
        "POSE_MAX_FIELD": t.most_field,
    }


def _least_cosine(t: PoseTables) -> int:
    """Cosine, 2.30, of the angle from the boresight within which the image and its border are."""
    u, v = (t.grid.half + t.margin).tolist()
    return math.floor(t.grid.focal / math.hypot(t.grid.focal, u, v) * (1 << 30)) - (1 << 10)


def pose_arrays(t: PoseTables) -> list[CTable]:
    """Arrays of the exported tables, without those of the grid and the guide stars."""
    return [
        CTable(
            "int64_t", "pose_information", "priors of focal length and shears, 24 fraction bits", t.priors.information
        ),
        CTable("int32_t", "pose_model", "log2 of the prior of each model, 24 fraction bits", t.priors.model),
        CTable("int32_t", "pose_systematic", "log2 of the prior of each systematic error", t.priors.systematic),
    ]
