"""Centroid lists of simulated fields, valid and invalid ones, for tests of an identification."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from startracker.core import FloatArray

NOISE_PX = 0.3
"""Standard deviation of each coordinate."""

ListKind = Literal["field", "false_stars", "few", "duplicates", "format_edge"]
KINDS: tuple[ListKind, ...] = ("field", "false_stars", "few", "duplicates", "format_edge")


def centroid_list(
    directions: FloatArray,
    v_mag: FloatArray,
    fov_deg: tuple[float, float],
    size_px: tuple[int, int],
    rng: np.random.Generator,
    kind: ListKind = "field",
    max_stars: int = 12,
) -> FloatArray:
    """Centroids (N, 2) of a field near a randomly chosen star, with random roll.

    The camera has no distortion and focal lengths given by field and size; x right and y up from the centre, brightest
    first.

    Parameters
    ----------
    directions, v_mag : array, shape (G, 3), (G,)
        Directions and magnitudes of the stars.
    fov_deg, size_px : (float, float), (int, int)
        Along columns and rows.
    rng : Generator
        Source of all random numbers.
    kind : str
        ``field``; ``false_stars``: one to three additional ones, anywhere in the order; ``few``: zero to three stars;
        ``duplicates``: the first stars repeated; ``format_edge``: coordinates scaled to the limits of 10.22 and beyond.
    max_stars : int
        Maximum number of stars, the brightest.
    """
    half = np.array(size_px) / 2.0
    focal = half / np.tan(np.radians(fov_deg) / 2.0)
    z = directions[rng.integers(len(directions))] + rng.normal(0.0, math.radians(fov_deg[1]) / 4.0, 3)
    z /= np.linalg.norm(z)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    y = np.cross(x, z)  # up: with z away from the eye, x right and y up are left-handed
    depth = directions @ z
    ahead = np.flatnonzero(depth > 0.5)
    points = np.stack([directions[ahead] @ x, directions[ahead] @ y], axis=1) / depth[ahead, None] * focal
    inside = (np.abs(points) < half).all(axis=1)
    seen = points[inside][np.argsort(v_mag[ahead][inside], kind="stable")][:max_stars]
    xy = seen + rng.normal(0.0, NOISE_PX, seen.shape)
    if kind == "false_stars":
        count = int(rng.integers(1, 4))
        xy = np.insert(xy, rng.integers(0, len(xy) + 1, count), rng.uniform(-half, half, (count, 2)), axis=0)
    elif kind == "few":
        xy = xy[: int(rng.integers(0, 4))]
    elif kind == "duplicates":
        xy = np.vstack([xy, xy[:2]])
    elif kind == "format_edge":
        xy = xy * rng.choice([2.4, 512.0 / np.abs(xy).max(initial=1.0), 40.0])
    return np.asarray(np.round(xy, 7))


def list_text(xy: FloatArray) -> str:
    """A list in the input format of the exported program: one star per line, followed by an empty line."""
    return "".join(f"{x:.7f} {y:.7f}\n" for x, y in xy) + "\n"
