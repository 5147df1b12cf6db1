"""Section 3.3 and Figs. 3.4 to 3.8: number of stars along the path of the boresight.

The thesis counts stars in rectangles in right ascension and declination, ± half their width each, without cos δ; the
tables below do the same, and the last row shows the true square field of the camera, counted by the product.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from simulator.build import build_camera
from simulator.checks import load_scenario
from simulator.study.coverage.boresights import along_path
from simulator.study.coverage.field_counts import outline
from simulator.study.coverage.survey import count_stars
from simulator.theses.figures import draw, section_of
from simulator.theses.greyling1995.path import DECLINATION_DEG
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.catalog import load_catalog
from startracker.core import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WINDOW_DEG, WIDE_WINDOW_DEG = 10.0, 12.0
CELL_DEG = 5.0
"""Side of a cell of Fig. 3.4."""

MAP_DEC_DEG = (-25.0, 40.0)
"""Declinations of Fig. 3.4 in our version: the vicinity of the path."""

SPARSE_RA_DEG = ((320.0, 75.0), (150.0, 210.0))
"""Right ascensions named in section 3.3.2 as the most sparsely populated."""

WERTZ_COUNTS = {3.0: 187, 4.0: 556, 5.0: 1660, 6.0: 5146, 7.0: 15095, 8.0: 44700}
"""Table 3.3, stars of the whole sky by limiting magnitude, as printed."""


@cache
def _bright_stars() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Right ascension and declination, degrees, and V of the Bright Star Catalogue."""
    stars = load_catalog("bsc5")
    return np.degrees(stars.ra_rad), np.degrees(stars.dec_rad), np.asarray(stars.v_mag)


def window_counts(
    magnitude_limit: float,
    window_deg: float = WINDOW_DEG,
    step_deg: float = 1.0,
    declination_deg: float = DECLINATION_DEG,
) -> tuple[FloatArray, IntArray]:
    """Stars in a window moved along a parallel of declination, as counted in the thesis.

    The window is `window_deg` wide in right ascension (no cos δ) and in declination. Returns its centres in right
    ascension (N,), degrees from 0 in steps, and the stars at each (N,).
    """
    ra, dec, v = _bright_stars()
    ra = np.sort(ra[(v <= magnitude_limit) & (np.abs(dec - declination_deg) <= window_deg / 2)])
    centre = np.arange(0.0, 360.0, step_deg)
    around = np.concatenate([ra - 360.0, ra, ra + 360.0])
    last = np.searchsorted(around, centre + window_deg / 2, side="right")
    first = np.searchsorted(around, centre - window_deg / 2, side="left")
    return centre, np.asarray(last - first)


def cell_counts() -> tuple[FloatArray, FloatArray, IntArray]:
    """Stars in cells of 5° × 5°: edges in right ascension and declination, counts (declination, right ascension)."""
    ra, dec, _ = _bright_stars()
    ra_edges = np.arange(0.0, 360.0 + CELL_DEG, CELL_DEG)
    dec_edges = np.arange(MAP_DEC_DEG[0], MAP_DEC_DEG[1] + CELL_DEG, CELL_DEG)
    counts, _, _ = np.histogram2d(dec, ra, bins=(dec_edges, ra_edges))
    return ra_edges, dec_edges, counts.astype(np.int64)


def section() -> Section:
    """Stellar density along the path."""
    along = {
        f"V{limit}_{step}deg": partial(_along_the_path, float(limit), float(step))
        for limit in (5, 6, 7)
        for step in (1, 5)
    }
    values = _catalogue_values() | _sparse_values() | _window_values() | _camera_values() | _cells() | _minima()
    return section_of("greyling1995/density", "Chapter 3.3: stellar density along the path", values | {"along": along})


def _catalogue_values() -> Values:
    """Table 3.3 and the two included catalogues."""
    bright, hipparcos = _bright_stars()[2], np.asarray(load_catalog("hipparcos").v_mag)
    ends = "; the Bright Star Catalogue ends at V ≈ 6.5"
    return {
        "wertz": [
            {
                "limit": limit,
                "stars": printed,
                "own": int(np.sum(bright <= limit)),
                "deep": int(np.sum(hipparcos <= limit)),
                "ends": ends if limit > 6.5 else "",
            }
            for limit, printed in WERTZ_COUNTS.items()
        ]
    }


def _sparse_values() -> Values:
    """Check of the ranges named as sparse in section 3.3.2: stars per window of 10°, down to V = 6."""
    ra, counts = window_counts(6.0)
    sparse = np.zeros(len(ra), dtype=bool)
    for low, high in SPARSE_RA_DEG:
        sparse |= (ra - low) % 360.0 <= (high - low) % 360.0
    inside, outside = counts[sparse].mean(), counts[~sparse].mean()
    return {
        "inside": inside,
        "outside": outside,
        "sparser": inside < outside,
        "lowest": counts.min(),
        "low_ra": ra[counts.argmin()],
    }


def _window_values() -> Values:
    (ra, five), (_, coarse), (_, six) = window_counts(5.0), window_counts(5.0, step_deg=5.0), window_counts(6.0)
    fewest = {limit: window_counts(limit)[1].min() for limit in (5.5, 6.0, 6.5, 7.0, 7.5)}
    wide = [str(window_counts(limit, WIDE_WINDOW_DEG)[1].min()) for limit in (5.0, 6.0, 6.5, 7.0)]
    growth = np.diff(list(fewest.values())).astype(float)
    at = ra[six == six.min()]
    return {
        "five": {"fewest": five.min(), "empty": np.sum(five == 0), "points": len(five), "mean": five.mean()},
        "most_5": five.max(),
        "most_5_ra": ra[five.argmax()],
        "coarse": {"fewest": coarse.min(), "empty": np.sum(coarse == 0), "points": len(coarse), "mean": coarse.mean()},
        "fewest_60": fewest[6.0],
        "fewest_65": fewest[6.5],
        "fewest_70": fewest[7.0],
        "limit_between": fewest[6.0] < 3 <= fewest[6.5],
        "sparse_from": at[0],
        "sparse_to": at[-1],
        "mean_6": six.mean(),
        "most_6": six.max(),
        "wide_fewest": ", ".join(wide),
        "growth": growth,
        "departs": growth[1] > 0 and growth[2:].sum() <= growth[1],
    }


def _camera_values() -> Values:
    """The true field of sunsat.yaml, 10° square on the sky, at all rolls of the orbit."""
    scenario = load_scenario("sunsat", ["pointing.error_deg=0"])
    limits = np.array([5.0, 6.0, 6.5])
    counts = count_stars(load_catalog("bsc5"), outline(build_camera(scenario)), along_path(scenario, 1500), limits)
    return {"fewest": counts.min(axis=0), "field_means": ", ".join(f"{m:.1f}" for m in counts.mean(axis=0))}


def _cells() -> Values:
    """The stars around the path, and the square of the density in cells of 5° × 5°."""
    ra, dec, v = _bright_stars()
    ra_edges, dec_edges, counts = cell_counts()
    grid = np.meshgrid((ra_edges[1:] + ra_edges[:-1]) / 2, (dec_edges[1:] + dec_edges[:-1]) / 2)
    edges = [DECLINATION_DEG - WINDOW_DEG / 2, DECLINATION_DEG + WINDOW_DEG / 2]
    stars = {"ra": ra, "dec": dec, "size": 0.5 * (8.5 - v) ** 1.4, "path": DECLINATION_DEG, "edges": edges}
    return stars | {"grid": grid, "squared": (counts / CELL_DEG**2) ** 2, "dec_range": MAP_DEC_DEG}


def density_figure(magnitude_limit: float, step_deg: float, window_deg: float = WINDOW_DEG) -> Figure:
    """Figs. 3.5 to 3.7: stars per square degree in the window along the path, V down to `magnitude_limit`."""
    shown = _along_the_path(magnitude_limit, step_deg, window_deg)
    return draw("greyling1995/density/fig_3_5a_V5_1deg", {"along": {"V5_1deg": shown}})


def _along_the_path(magnitude_limit: float, step_deg: float, window_deg: float = WINDOW_DEG) -> Values:
    ra, counts = window_counts(magnitude_limit, window_deg, step_deg)
    density = counts / window_deg**2
    fewest = density == density.min()
    return {
        "limit": magnitude_limit,
        "window": window_deg,
        "step": step_deg,
        "ra": np.append(ra, 360.0),
        "density": np.append(density, density[0]),
        "fewest": counts.min(),
        "at": ra[fewest],
        "least": density[fewest],
        "points": len(ra),
        "three": 3.0 / window_deg**2,
        "top": 1.25 * float(density.max()),
    }


def _minima() -> Values:
    """Minimum density along the path by magnitude limit, for both windows and both steps."""
    limits = np.arange(5.0, 7.51, 0.25)
    least = {
        (window, step): [window_counts(limit, window, step)[1].min() / window**2 for limit in limits]
        for window in (WINDOW_DEG, WIDE_WINDOW_DEG)
        for step in (1.0, 5.0)
    }
    curves = [{"window": window, "step": step, "least": counts} for (window, step), counts in least.items()]
    return {"limits": limits, "curves": curves, "three": [3.0 / WINDOW_DEG**2, 3.0 / WIDE_WINDOW_DEG**2]}
