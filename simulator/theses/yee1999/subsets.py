"""An open question of the thesis: is the mean of the attitudes of all three-star subsets better than one fit to all?

Section 5.2 asks this question, after Beattie et al., who averaged. It can be answered without a simulation: the
least-squares fit of n linear equations *is* a mean of the solutions of all subsets of as many equations as there are
unknowns, each weighted by its squared determinant (Jacobi 1841, Journal für die reine und angewandte Mathematik 22,
285). Here a subset's determinant is twice the area of its triangle: the plain mean gives a narrow triangle the same
weight as a wide one, the single fit weights them by the square of their areas. By the Gauss–Markov theorem no linear
unbiased estimator is better than the fit if all stars have the same error.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, VEGA_SIZE_PX, Analysis, analyse, vega
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.estimation.plate import solve_plate

_NOISE_PX = 0.3
_FIELDS = 200
_STARS = (3, 4, 5, 6, 8, 10)
_SEED = 1999


class Subsets(NamedTuple):
    """Centres (S, 2) of all solved three-star subsets, right ascension and declination, areas (S,) of their triangles
    in the image, and the centre (2,) of the single fit."""

    stars: IntArray
    center_deg: FloatArray
    area: FloatArray
    fit_deg: FloatArray

    def mean_deg(self, power: float = 0.0) -> FloatArray:
        """Mean of the centres (2,), weighted by a power of the area: 0 is the plain mean, 2 is Jacobi's."""
        weight = self.area**power
        offset = (self.center_deg - self.fit_deg + 180.0) % 360.0 - 180.0
        return np.asarray(self.fit_deg + (weight @ offset) / weight.sum())

    def off_arcsec(self, center_deg: ArrayLike) -> float:
        """Angle between a centre and that of the single fit; small angles, arcseconds."""
        step = (np.asarray(center_deg) - self.fit_deg + 180.0) % 360.0 - 180.0
        return float(3600.0 * np.hypot(step[0] * np.cos(np.radians(self.fit_deg[1])), step[1]))


def triangle_areas(xy: ArrayLike, stars: IntArray) -> FloatArray:
    """Areas (S,) of the triangles of stars (S, 3) with positions (N, 2)."""
    a, b, c = (np.asarray(xy, dtype=float)[stars[:, k]] for k in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def subset_centers(xy: ArrayLike, sky_deg: ArrayLike) -> Subsets:
    """Plate constants of all subsets of three stars, and of all stars, from centroids (N, 2) relative to the centre of
    the image and right ascensions and declinations (N, 2); collinear subsets are excluded.

    Raises
    ------
    InputError
        As `solve_plate` for all stars.
    """
    image, sky = np.asarray(xy, dtype=float), np.asarray(sky_deg, dtype=float)
    fit = solve_plate(image, sky, tolerance_deg=1e-9)
    stars, centers = [], []
    for chosen in combinations(range(len(image)), 3):
        try:
            centers.append(solve_plate(image[list(chosen)], sky[list(chosen)], tolerance_deg=1e-9).center_deg)
        except InputError:
            continue
        stars.append(chosen)
    index = np.array(stars, dtype=np.int64).reshape(-1, 3)
    return Subsets(index, np.array(centers).reshape(-1, 2), triangle_areas(image, index), fit.center_deg)


def three_star_subsets(analysis: Analysis | None = None) -> Section:
    """The Vega image's ten subsets, and random fields of known centre."""
    errors = mean_errors()
    fields = [
        {"stars": stars, "rms": rms, "worse": rms[1] / rms[0], "rigid_worse": rms[4] / rms[3]}
        for stars, rms in errors.items()
    ]
    values = {"vega": _vega_values(analysis or analyse(vega())), "fields": fields}
    curves = {"stars": list(errors), "rms": np.array(list(errors.values())).T}
    return section_of("yee1999/subsets", "Three stars at a time, or all together", values | curves)


def _vega_values(found: Analysis) -> list[Values]:
    if found.found is None:
        return []
    pairs = found.found.pairs
    subsets = subset_centers(found.picture.xy_px[pairs[:, 0]], found.catalog.sky_deg[pairs[:, 1]])
    off = [subsets.off_arcsec(center) for center in subsets.center_deg]
    return [
        {
            "least": min(off),
            "most": max(off),
            "subsets": len(off),
            "stars": len(pairs),
            "plain_deg": subsets.mean_deg(),
            "plain_arcsec": subsets.off_arcsec(subsets.mean_deg()),
            "jacobi_arcsec": subsets.off_arcsec(subsets.mean_deg(2.0)),
        }
    ]


def mean_errors(
    stars: tuple[int, ...] = _STARS, fields: int = _FIELDS, noise_px: float = _NOISE_PX
) -> dict[int, FloatArray]:
    """Root mean square errors of the centre, arcseconds, over random fields of the Vega camera.

    Stars are uniform over the image; centroids have normal errors. Near the tangent point the projection is linear, so
    that a single step of plate constants about the true centre is sufficient: subsets are solved as linear equations.

    Returns a row by number of stars, (5,): with plate constants the single fit, the plain mean of all three-star
    subsets, and their mean weighted by squared area; with shift and rotation only (known scale) the single fit and the
    plain mean.
    """
    rng = np.random.default_rng(_SEED)
    scale = 3600.0 * np.array(VEGA_FOV_DEG) / VEGA_SIZE_PX
    out = {}
    for n in stars:
        subsets = np.array(list(combinations(range(n), 3)))
        squared = np.zeros((fields, 5))
        for field in range(fields):
            true = rng.uniform(-0.5, 0.5, (n, 2)) * VEGA_SIZE_PX
            seen = true + rng.normal(0.0, noise_px, (n, 2))
            sky = true * scale
            design = np.column_stack([seen, np.ones(n)])
            fit = np.linalg.lstsq(design, sky, rcond=None)[0][2]
            each = np.linalg.solve(design[subsets], sky[subsets])[:, 2]
            weight = triangle_areas(seen, subsets) ** 2
            rigid = [
                _rigid_centers(seen[chosen], (true - seen)[chosen]) * scale for chosen in (np.arange(n)[None], subsets)
            ]
            centers = (fit, each.mean(axis=0), weight @ each / weight.sum(), *(part.mean(axis=0) for part in rigid))
            squared[field] = [center @ center for center in centers]
        out[n] = np.sqrt(squared.mean(axis=0))
    return out


def _rigid_centers(xy: FloatArray, shift: FloatArray) -> FloatArray:
    """Shift of the origin (S, 2) by least squares of a small rotation and shift, for sets of stars (S, K, 2).

    shift = c + ω (−y, x): with means subtracted, ω = Σ (x Δy − y Δx) / Σ (x² + y²) and c = mean shift − ω (−ȳ, x̄).
    """
    middle, mean = xy.mean(axis=1), shift.mean(axis=1)
    p, d = xy - middle[:, None], shift - mean[:, None]
    turn = (p[..., 0] * d[..., 1] - p[..., 1] * d[..., 0]).sum(axis=1) / (p**2).sum(axis=(1, 2))
    return np.asarray(mean - turn[:, None] * np.stack([-middle[:, 1], middle[:, 0]], axis=1))
