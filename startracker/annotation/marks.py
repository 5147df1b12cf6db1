"""Marks on an annotated picture: stars, deep-sky objects, planets, constellations and the grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from startracker.annotation.labels import Label, Labels
from startracker.annotation.sky import grid_lines, polyline
from startracker.catalog.bodies import body_directions
from startracker.catalog.gaia import MOST_HIP
from startracker.catalog.names import (
    constellation_lines,
    deep_sky_directions,
    deep_sky_objects,
    designation,
    proper_name,
)
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.observer import Observer, aberrate
from startracker.solution import Solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MATCHED, UNMATCHED, MISSING = "#56B4E9", "#E69F00", "#F0E442"
FIGURES, GRID, TEXT, DEEP_SKY, BODY = "#CC79A7", "#2FBF9B", "#f5f7fa", "#9BD18B", "#FF9166"
_MISSING_SHARE = 0.6
_LEAST_DEEP_SKY_POINTS, _LARGEST_KEPT_FREE, _BODY_POINTS = 9.0, 30.0, 13.0


class FieldOfStars:
    """A solved field, which projects the catalogue's stars and other directions onto its image."""

    def __init__(self, solution: Solution, catalog: StarCatalog, observer: Observer | None) -> None:
        assert solution.attitude is not None
        assert solution.camera is not None
        self.solution, self.catalog, self.observer = solution, catalog, observer
        self.attitude, self.camera = solution.attitude, solution.camera
        if observer is None:  # as in the tracker
            self.directions, _ = catalog.space_motion()
        else:
            self.directions = self.apparent(catalog.directions(observer.epoch_jyear, observer.position_au))

    def apparent(self, directions: FloatArray) -> FloatArray:
        """Directions (N, 3) with the aberration of the observer, if its velocity is known."""
        velocity = None if self.observer is None else self.observer.velocity_km_s
        return directions if velocity is None else aberrate(directions, velocity)

    def project(self, directions: FloatArray) -> FloatArray:
        """Pixels (N, 2) of directions; NaN for directions farther from the boresight than the corners of the image."""
        vectors = self.attitude.apply(directions)
        angle = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
        pixels = np.full((len(vectors), 2), np.nan)
        # Directions far outside the field may be projected back into it by the distortion polynomial.
        seen = angle <= self.camera.half_diagonal_rad
        pixels[seen] = self.camera.project(vectors[seen])
        return pixels

    def inside(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Mask of the pixels (N, 2) that are on the image."""
        return np.asarray(np.isfinite(pixels).all(axis=1) & self.camera.contains(pixels))

    def missing(self) -> FloatArray:
        """Pixels (N, 2) of catalogue stars as bright as most matched stars that have no detection."""
        limit = float(np.quantile(self.solution.stars.v_mag, _MISSING_SHARE))
        pixels = self.project(self.directions[self.catalog.v_mag <= limit])
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        pixels = pixels[self.camera.contains(pixels, -1.0)]
        radius_px = max(6.0, 0.006 * self.camera.width)  # the companion of a detected double is not missing
        far = np.array([np.hypot(*(self.solution.centroids - xy).T).min(initial=np.inf) > radius_px for xy in pixels])
        return np.asarray(pixels[far.astype(bool)])


def mark_others(ax: Axes, solution: Solution, labels: Labels) -> None:
    """Mark the detections without an identified star."""
    matched = {tuple(xy) for xy in (*solution.stars.xy, *solution.bodies.xy)}
    others = np.array([xy for xy in solution.centroids if tuple(xy) not in matched]).reshape(-1, 2)
    if len(others):
        ax.plot(*others.T, "s", ms=6, mfc="none", mec=UNMATCHED, mew=0.7, label=f"detected only ({len(others)})")
    for xy in others:
        labels.occupy(xy, 6.0)


def mark_stars(ax: Axes, field: FieldOfStars, labels: Labels, names: int) -> list[Label]:
    """Circle the identified stars and mark those that were expected; returns labels of at most `names` stars."""
    stars = field.solution.stars
    faintest = float(stars.v_mag.max(initial=0.0))
    # Diameter in points: 1.3 per magnitude, from 6 for the faintest star up to 18.
    diameter = np.clip(6.0 + 1.3 * (faintest - stars.v_mag), 6.0, 18.0)
    for chosen, style, label in (
        (stars.used, "-", "identified"),
        (~stars.used, ":", "identified, left out of the fit"),
    ):
        if chosen.any():
            ax.scatter(stars.xy[chosen, 0], stars.xy[chosen, 1], s=diameter[chosen] ** 2, facecolors="none",
                       edgecolors=MATCHED, linewidths=0.9, linestyles=style,
                       label=f"{label} ({np.count_nonzero(chosen)})", zorder=3)  # fmt: skip
    missing = field.missing()
    if len(missing):
        ax.plot(*missing.T, "D", ms=5, mfc="none", mec=MISSING, mew=0.8, ls="none",
                label=f"expected, not found ({len(missing)})", zorder=3)  # fmt: skip
    for xy, size in [*zip(stars.xy, diameter, strict=True), *((xy, 5.0) for xy in missing)]:
        labels.occupy(xy, size)
    order = np.argsort(stars.v_mag, kind="stable")
    proper = np.array([bool(proper_name(str(name))) for name in stars.name], dtype=bool)
    wanted = []
    for i in np.concatenate([order[proper[order]], order[~proper[order]]])[:names]:
        name = str(stars.name[i])
        text = proper_name(name) or designation(name) or _number(field.catalog, int(stars.catalog_id[i]))
        wanted.append(Label(stars.xy[i], diameter[i], text, TEXT, 7.5 if proper[i] else 6.5))
    return wanted


def mark_deep_sky(ax: Axes, field: FieldOfStars, labels: Labels) -> list[Label]:
    """Dashed circles of the size of the deep-sky objects in the field; returns their labels."""
    items = deep_sky_objects()
    pixels = field.project(field.apparent(deep_sky_directions()))
    wanted = []
    for i in np.flatnonzero(field.inside(pixels)):
        # The diameter in arc minutes over 120 is the radius in degrees.
        radius_px = math.radians(items[i].diameter_arcmin / 120.0) / field.camera.pixel_rad
        diameter = max(2.0 * radius_px * labels.points_per_pixel, _LEAST_DEEP_SKY_POINTS)
        ax.plot(*pixels[i], "o", ms=diameter, mfc="none", mec=DEEP_SKY, mew=0.9, ls="none", zorder=3)
        if diameter < _LARGEST_KEPT_FREE:
            labels.occupy(pixels[i], diameter)
        wanted.append(Label(pixels[i], diameter, items[i].label, DEEP_SKY, 7.5))
    if wanted:
        ax.plot([], [], "o", ms=8, mfc="none", mec=DEEP_SKY, mew=0.9, label="deep-sky objects")
    return wanted


def mark_bodies(ax: Axes, field: FieldOfStars, labels: Labels) -> list[Label]:
    """Mark planets, the Moon and the Sun, if the epoch is known and in the ephemeris; returns their labels."""
    if field.observer is None:
        return []
    try:
        bodies = body_directions(field.observer)
    except InputError:
        return []
    pixels = field.project(np.array(list(bodies.values())))
    wanted = []
    for name, xy in zip(bodies, pixels, strict=True):
        if field.inside(xy[None])[0]:
            ax.plot(*xy, "s", ms=_BODY_POINTS, mfc="none", mec=BODY, mew=1.1, zorder=3)
            labels.occupy(xy, _BODY_POINTS)
            wanted.append(Label(xy, _BODY_POINTS, name, BODY, 8.0))
    return wanted


def mark_constellations(ax: Axes, field: FieldOfStars) -> list[Label]:
    """Draw the constellation lines; returns the abbreviation of each constellation as a label."""
    pairs, names = constellation_lines(field.catalog)
    label: str | None = "constellations"
    seen: dict[str, list[FloatArray]] = {}
    for (one, other), name in zip(pairs, names, strict=True):
        path = polyline(field.directions[one], field.directions[other])
        pixels = field.project(path)
        if np.isfinite(pixels).all(axis=1).any():
            ax.plot(*pixels.T, color=FIGURES, lw=0.9, alpha=0.8, label=label, zorder=2)
            label = None
            seen.setdefault(str(name), []).append(pixels)
    wanted = []
    for name, lines in seen.items():
        pixels = np.concatenate(lines)
        pixels = pixels[field.inside(pixels)]
        if len(pixels):
            wanted.append(Label(pixels.mean(axis=0), 0.0, name, FIGURES, 8.0))
    return wanted


def mark_grid(ax: Axes, field: FieldOfStars, labels: Labels) -> None:
    """Draw lines of right ascension and declination with their values at the border."""
    for pixels, text in grid_lines(field.solution):
        ax.plot(*pixels.T, color=GRID, lw=0.5, alpha=0.6, zorder=1)
        inside = np.flatnonzero(field.camera.contains(pixels, -2.0))
        if len(inside):
            labels.at_border(pixels[inside], text, GRID)


def _number(catalog: StarCatalog, number: int) -> str:
    """Catalogue number with the catalogue's abbreviation."""
    if catalog.name == "gaia" and number > MOST_HIP:
        return f"Gaia DR3 {number}"
    if catalog.name in ("hipparcos", "gaia"):
        return f"HIP {number}" if number > 0 else f"HR {-number}"
    return f"HR {number}" if catalog.name == "bsc5" else str(number)
