"""Test lists for the integer tracker: simulated fields with disturbances, and lists that are not a sky."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["PATTERNS", "Camera", "Pattern", "Scene", "pattern_list", "scene"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Pattern = Literal["uniform", "clump", "clumps", "line", "grid", "ring", "pairs", "clump_and_field"]
PATTERNS: tuple[Pattern, ...] = ("uniform", "clump", "clumps", "line", "grid", "ring", "pairs", "clump_and_field")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: field of view (degrees) and size (pixels), horizontal and vertical."""

    fov_deg: tuple[float, float]
    size_px: tuple[int, int]

    @property
    def half(self) -> FloatArray:
        """Half the size (2,), pixels."""
        return np.array(self.size_px) / 2.0

    @property
    def focal_px(self) -> FloatArray:
        """Focal lengths (2,), pixels."""
        return np.asarray(self.half / np.tan(np.radians(self.fov_deg) / 2.0))

    @property
    def scale_deg(self) -> tuple[float, float]:
        """Degrees per pixel, horizontal and vertical, for the triads."""
        return self.fov_deg[0] / self.size_px[0], self.fov_deg[1] / self.size_px[1]


@dataclass(frozen=True, eq=False)
class Scene:
    """A list of centroids and the truth.

    Parameters
    ----------
    xy : (N, 2)
        Pixels, x right, y up from the centre, brightest first.
    star : int (N,)
        Index of the star, −1 for a false one.
    matrix : (3, 3)
        Rows: the camera's x (right), y (down), boresight.
    """

    xy: FloatArray
    star: IntArray
    matrix: FloatArray


def scene(
    directions: FloatArray,
    v_mag: FloatArray,
    camera: Camera,
    rng: np.random.Generator,
    declination_deg: tuple[float, float] = (-90.0, 90.0),
    false_stars: int = 0,
    missing: float = 0.0,
    noise_px: float = 0.1,
    max_stars: int = 12,
    scatter_mag: float = 0.2,
) -> Scene:
    """A field at a random attitude with the boresight uniform over the given declinations.

    Parameters
    ----------
    directions, v_mag : (G, 3), (G,)
        The sky, brightest first.
    false_stars : int
        Number of false stars, random in position and order.
    missing : float
        Fraction of the stars that are not detected.
    scatter_mag : float
        Scatter of the magnitudes, which changes the order.
    """
    low, high = np.sin(np.radians(declination_deg))
    z3, a = rng.uniform(low, high), rng.uniform(0.0, 2.0 * math.pi)
    z = np.array([math.sqrt(1.0 - z3 * z3) * math.cos(a), math.sqrt(1.0 - z3 * z3) * math.sin(a), z3])
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    matrix = np.stack([x, np.cross(z, x), z])
    half, focal = camera.half, camera.focal_px
    near = np.flatnonzero(directions @ z > math.cos(math.atan(math.hypot(*(half / focal)))) - 1e-3)
    body = directions[near] @ matrix.T
    xy = body[:, :2] / body[:, 2:] * focal * [1.0, -1.0]
    inside = (np.abs(xy) < half).all(axis=1) & (rng.random(len(near)) >= missing)
    star, xy = near[inside], xy[inside]
    order = np.argsort(v_mag[star] + rng.normal(0.0, scatter_mag, len(star)), kind="stable")[:max_stars]
    star, xy = star[order], xy[order] + rng.normal(0.0, noise_px, (len(order), 2))
    at = rng.integers(0, len(star) + 1, false_stars)
    xy = np.insert(xy, at, rng.uniform(-half, half, (false_stars, 2)), axis=0)
    star = np.insert(star, at, -1)
    keep = (np.abs(xy) < half).all(axis=1)
    return Scene(xy[keep], star[keep], matrix)


def pattern_list(pattern: Pattern, camera: Camera, rng: np.random.Generator, count: int) -> FloatArray:
    """Up to `count` points (≤ count, 2) that are not a sky: pixels from the centre, in random order."""
    half = camera.half
    jitter = rng.normal(0.0, rng.choice([0.0, 0.1, 1.0]), (count, 2))
    center = rng.uniform(-half, half) * 0.7
    if pattern == "uniform":
        xy = rng.uniform(-half, half, (count, 2))
    elif pattern == "clump":
        xy = center + rng.normal(0.0, math.exp(rng.uniform(1.0, 4.6)), (count, 2))
    elif pattern == "clumps":
        centers = rng.uniform(-half, half, (3, 2)) * 0.8
        xy = centers[rng.integers(3, size=count)] + rng.normal(0.0, math.exp(rng.uniform(1.0, 3.5)), (count, 2))
    elif pattern == "clump_and_field":
        xy = rng.uniform(-half, half, (count, 2))
        part = max(count // 2, 2)
        xy[:part] = center + rng.normal(0.0, math.exp(rng.uniform(1.0, 4.0)), (part, 2))
    elif pattern == "line":
        a = rng.uniform(0.0, math.pi)
        along = rng.uniform(-half.max(), half.max(), count) if rng.random() < 0.5 else np.arange(count) * 25.0 - 140.0
        xy = center * 0.3 + along[:, None] * [math.cos(a), math.sin(a)] + jitter
    elif pattern == "grid":
        a, pitch = rng.uniform(0.0, math.pi), rng.uniform(15.0, 90.0, 2)
        columns = int(rng.integers(2, 5))
        cell = np.stack([np.arange(count) % columns, np.arange(count) // columns], axis=1)
        rotation = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        xy = (cell - cell.mean(axis=0)) * pitch @ rotation + center * 0.3 + jitter
    elif pattern == "ring":
        turn = np.arange(count) * 2.0 * math.pi / count + rng.uniform(0.0, 6.3)
        xy = rng.uniform(20.0, half.min()) * np.stack([np.cos(turn), np.sin(turn)], axis=1) + jitter
    else:
        first = rng.uniform(-half, half, ((count + 1) // 2, 2))
        xy = np.concatenate([first, first + rng.normal(0.0, 8.0, first.shape)])[:count]
    xy = xy[(np.abs(xy) < half - 0.5).all(axis=1)]
    return np.asarray(xy[rng.permutation(len(xy))])


@dataclass(frozen=True)
class Answer:
    """A parsed output line of the exported program.

    Parameters
    ----------
    status, reason : str
    number : int (N,)
        Catalogue numbers, 0: not matched.
    evidence : float
        log₂ of the Bayes factor.
    matrix : (3, 3) or None
    """

    status: str
    reason: str
    number: IntArray
    evidence: float
    matrix: FloatArray | None

    @classmethod
    def of_line(cls, line: str) -> Answer:
        """Parse a line."""
        status, reason, *rest = line.split()
        field = dict(word.split("=", 1) for word in rest)
        number = np.array([int(n) for n in field["numbers"].split(",") if n], dtype=np.int64)
        matrix = None
        if "matrix" in field:
            matrix = np.array([int(n) for n in field["matrix"].split(",")]).reshape(3, 3) / 2.0**30
        return cls(status, reason, number, int(field["evidence"]) / 4096.0, matrix)


def errors_px(answer: Answer, truth: Scene, camera: Camera, star_id: IntArray, directions: FloatArray) -> FloatArray:
    """Errors (3,) of a solution, pixels.

    The largest displacement of the image's corners by the attitude error; the largest distance of a named point from
    the position of its star at the true attitude, for single stars and for unresolved groups.
    """
    if answer.matrix is None:
        return np.zeros(3)
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * camera.half
    rays = np.column_stack([corners / camera.focal_px, np.ones(4)]) @ truth.matrix @ answer.matrix.T
    moved = rays[:, :2] / rays[:, 2:] * camera.focal_px - corners
    seen = np.flatnonzero(answer.number)
    row = {int(n): k for k, n in enumerate(star_id)}
    named = directions[[row[int(n) % 10_000] for n in answer.number[seen]]] @ truth.matrix.T
    at = named[:, :2] / named[:, 2:] * camera.focal_px * [1.0, -1.0]
    off = np.hypot(*(at - truth.xy[seen]).T)
    several = answer.number[seen] > 10_000
    return np.array([np.hypot(*moved.T).max(), off[~several].max(initial=0.0), off[several].max(initial=0.0)])
