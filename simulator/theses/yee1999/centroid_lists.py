"""Centroid lists of simulated fields."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray

NOISE_PX = 0.3
"""Standard deviation of each coordinate."""


def centroid_list(
    directions: FloatArray,
    v_mag: FloatArray,
    fov_deg: tuple[float, float],
    size_px: tuple[int, int],
    rng: np.random.Generator,
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
    return np.asarray(np.round(xy, 7))
