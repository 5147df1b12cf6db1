"""Tables of the integer verification (`startracker.fixed_point.verification`), computed in floating point.

The priors are those of `startracker.identification.bayes_factor`. Each entry is rounded in the direction in which the
Bayes factor is smaller. So the factor B in integers and the exact one b of the same matches satisfy B ≤ b, and the
probability that a list without stars reaches B ≥ t is 1/t at most (Markov's inequality, because b has mean one).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.special import gammaln

from startracker.arguments import pair, real_number
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.fixed_point.evidence import LOG_BITS, PLANE_BITS, Tables
from startracker.fixed_point.vectors import DIRECTION
from startracker.fixed_point.verification import MOST_EXTRA
from startracker.geometry.attitude import radec_to_direction
from startracker.identification.bayes_factor import DISTRACTORS, SCALE_LOG_PRIOR, SCALES, SEEN, count_table

MAX_POINTS = 24
"""Number of the brightest points of a list that are verified."""
_WIDTHS = 5
"""Number of `SCALES` over which B is averaged: 0.4 to 4 times the stated error."""
_GATES = (18.0, 9.0, 4.5)
"""Radii of the matching in stated errors: 4.5 times the widths 4, 2 and 1."""
_SPREAD = 1.0 / 64.0
"""Least determinant of the second moments of the matched points, relative to that of a uniformly filled image: an
eighth of the area. A round clump needs a radius of a fifth of the image's side."""
_MOST_FOCAL_PX, _MOST_ERROR_PX = 65536.0, 5.0
"""Limits within which the products fit into 64 bits."""
_CUT_WIDTHS = 16.0


@dataclass(frozen=True)
class IntegerCamera:
    """Pinhole camera of the integer tracker, and its criterion of acceptance.

    Parameters
    ----------
    size_px, fov_deg : (int, int), (float, float)
        Across and down, pixels and degrees.
    centroid_error_px : float
        Standard error of a centroid on one axis; 0.4 to 4 times this is allowed.
    false_alarm_rate : float
        Probability that a list without stars is accepted.
    resolution_px : float
        Stars closer than this are not separated in the image.
    """

    size_px: tuple[int, int]
    fov_deg: tuple[float, float]
    centroid_error_px: float = 0.3
    false_alarm_rate: float = 1e-7
    resolution_px: float = 3.0

    def __post_init__(self) -> None:
        pair("size_px", self.size_px)
        pair("fov_deg", self.fov_deg)
        for name in ("centroid_error_px", "false_alarm_rate", "resolution_px"):
            real_number(name, getattr(self, name), finite=False)
        if not (all(0 < n <= 1022 for n in self.size_px) and all(0.0 < a < 90.0 for a in self.fov_deg)):
            raise InputError(
                f"the integer tracker's images have up to 1022 pixels a side, which 10.22 holds, and fields below 90°; "
                f"got {self.size_px} pixels, {self.fov_deg} degrees"
            )
        if not 0.01 <= self.centroid_error_px <= _MOST_ERROR_PX:
            raise InputError(
                f"the centroid error must be 0.01 to {_MOST_ERROR_PX:g} px, not {self.centroid_error_px:g}"
            )
        if not 1e-15 <= self.false_alarm_rate <= 0.1:
            raise InputError(f"the false-alarm rate must be 1e-15 to 0.1, not {self.false_alarm_rate:g}")
        if not 0.0 <= self.resolution_px <= 20.0:
            raise InputError(f"the resolution must be 0 to 20 px, not {self.resolution_px:g}")
        across, down = self.focal_px
        if max(across, down) >= _MOST_FOCAL_PX or not 0.25 <= across / down <= 4.0:
            raise InputError(
                f"focal lengths of {across:.0f} and {down:.0f} px: the integer tracker holds less than "
                f"{_MOST_FOCAL_PX:.0f} px, and a ratio of 1/4 to 4; check field and size"
            )

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths across and down, px."""
        x, y = (n / 2.0 / math.tan(math.radians(a) / 2.0) for n, a in zip(self.size_px, self.fov_deg, strict=True))
        return x, y

    @property
    def scale_deg(self) -> tuple[float, float]:
        """Degrees per pixel across and down, with which separations are measured."""
        return self.fov_deg[0] / self.size_px[0], self.fov_deg[1] / self.size_px[1]


@dataclass(frozen=True, eq=False)
class GuideStars:
    """Stars as the camera resolves them, brightest first.

    Parameters
    ----------
    directions : (G, 3)
        Unit vectors; for stars that the camera does not separate, the mean weighted by their light.
    first : int (G,)
        Index of each in the sub-catalogue; for several stars, that of the brightest.
    several : bool (G,)
        Whether it is a blend of several stars.
    of_star : int (N,)
        Guide star to which each star of the sub-catalogue belongs.
    """

    directions: FloatArray
    first: IntArray
    several: NDArray[np.bool_]
    of_star: IntArray


def merged_stars(ra_deg: ArrayLike, dec_deg: ArrayLike, v_mag: ArrayLike, resolution_rad: float) -> GuideStars:
    """Guide stars of a sub-catalogue; chains of stars with separations below the resolution are merged."""
    vectors = radec_to_direction(np.radians(np.asarray(ra_deg, float)), np.radians(np.asarray(dec_deg, float)))
    flux = 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))
    label = np.arange(len(vectors))
    near = cKDTree(vectors).query_pairs(resolution_rad) if len(vectors) else set()
    for i, j in sorted(near):
        low, high = sorted((label[i], label[j]))
        label[label == high] = low
    _, of_star, count = np.unique(label, return_inverse=True, return_counts=True)
    light = np.bincount(of_star, weights=flux)
    mean = np.column_stack([np.bincount(of_star, weights=flux * vectors[:, k]) for k in range(3)])
    directions: FloatArray = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    first = np.full(len(count), -1, dtype=np.int64)
    for star in np.argsort(flux, kind="stable"):  # the brightest comes last
        first[of_star[star]] = star
    order = np.argsort(-light, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return GuideStars(directions[order], first[order], count[order] > 1, rank[of_star])


def verification_tables(camera: IntegerCamera, guide: GuideStars) -> Tables:
    """Constants and tables for one camera and its guide stars."""
    across, down = camera.focal_px
    ratio, one, unit = across / down, 1 << PLANE_BITS, 1 << LOG_BITS
    half = np.array([camera.size_px[0] / 2.0, camera.size_px[1] / 2.0 * ratio])
    widths = SCALES[:_WIDTHS] * camera.centroid_error_px
    area = 4.0 * half[0] * half[1]
    # The normal matrix on the sphere is that of the plane, times at most this factor for each of the three angles.
    stretch = 1.0 + float((half**2).sum()) / across**2
    log_volume = (
        1.5 * math.log2(2.0 * math.pi)
        - math.log2(8.0 * math.pi**2)
        + 3.0 * np.log2(widths)
        + SCALE_LOG_PRIOR[:_WIDTHS] / math.log(2.0)
        - 2.0 * math.log2(across)
        - 3.0 * math.log2(stretch)
        + PLANE_BITS  # of the lever, whose root is taken in units of the plane
    )
    depths = 2 * MAX_POINTS + MOST_EXTRA
    return Tables(
        guide=DIRECTION.encode(guide.directions, rounded=True),
        focal=round(across * one),
        ratio=round(ratio * (1 << 20)),
        half=np.ceil(half * one).astype(np.int64),
        gates=np.array([math.ceil((g * camera.centroid_error_px * one) ** 2) for g in _GATES], dtype=np.int64),
        same=math.ceil(_GATES[0] * camera.centroid_error_px / across * (1 << 30)),
        same_roll=math.ceil(_GATES[0] * camera.centroid_error_px / float(half.max()) * (1 << 30)),
        spread=math.ceil(_SPREAD * (area / 12.0) ** 2),
        log_area=int(_down(math.log2(area) + 2 * PLANE_BITS)),
        log_pi=int(_down(math.log2(math.pi))),
        log_cell=_up(np.log2(2.0 * math.pi * widths**2) + 2 * PLANE_BITS),
        quadratic=np.ceil(unit * (1 << 32) / math.log(2.0) / (2.0 * (widths * one) ** 2)).astype(np.int64),
        farthest=np.floor((_CUT_WIDTHS * widths * one) ** 2).astype(np.int64),
        log_volume=_down(log_volume),
        log_table=_down(np.log2(1.0 + np.arange(256) / 256.0)),
        sum_table=_down(np.log2(1.0 + 2.0 ** -(np.arange(1, 16 * 12 + 1) / 16.0))),
        distracting=_down(_log2_distracting()),
        seeing=_down(_log2_seeing(depths)),
        total=_totals(depths),
        threshold=int(_up(-math.log2(camera.false_alarm_rate))),
    )


def _log2_distracting() -> FloatArray:
    k = np.arange(MAX_POINTS + 1)
    terms = [math.log(weight) - mean + k * math.log(mean) for mean, weight in DISTRACTORS]
    return np.asarray(np.logaddexp.reduce(terms, axis=0) / math.log(2.0))


def _log2_seeing(depths: int) -> FloatArray:
    m, unseen = np.arange(MAX_POINTS + 1)[:, None], np.arange(depths + 1)[None, :]
    terms = [math.log(weight) + m * math.log(p) + unseen * math.log1p(-p) for p, weight in SEEN]
    return np.asarray(np.logaddexp.reduce(terms, axis=0) / math.log(2.0))


def _totals(depths: int) -> IntArray:
    """log₂ of n! times the probability of n stars, rounded up; zero, so that nothing is accepted, without guide
    stars."""
    out = np.zeros((MAX_POINTS + 1, depths + 1), dtype=np.int64)
    for n in range(3, MAX_POINTS + 1):
        out[n, 1:] = _up((count_table(n, depths).log_total[1:] + gammaln(n + 1.0)) / math.log(2.0))
    return out


def _down(value: ArrayLike) -> IntArray:
    """Fixed-point numbers with `LOG_BITS` bits of fraction, rounded down."""
    return np.asarray(np.floor(np.asarray(value) * (1 << LOG_BITS)), dtype=np.int64)


def _up(value: ArrayLike) -> IntArray:
    """Fixed-point numbers with `LOG_BITS` bits of fraction, rounded up."""
    return np.asarray(np.ceil(np.asarray(value) * (1 << LOG_BITS)), dtype=np.int64)
