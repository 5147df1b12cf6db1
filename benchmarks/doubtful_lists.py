"""Lists of stars that do not fit the camera they are given with: open clusters and wrong focal lengths, torn lists.

A list is a real field of stars, seen by a camera whose focal length is wrong by up to 10 %, or with another fault of
`KINDS`. Its true attitude is known, except where the fault leaves none (`WITHOUT_TRUTH`). Every list has its own
random stream, keyed by (seed, group, index): `doubtful_list(group, index)` gives the same list as in a run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import stream
from startracker import Camera, load_catalog
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.stars import StarCatalog
from startracker.geometry.attitude import quat_to_matrix, radec_to_direction, rotation_vector_to_matrix

FloatArray = NDArray[np.float64]

SIZE_PX = 1024
CLUSTERS = {
    "Pleiades": (56.75, 24.12),
    "Hyades": (66.75, 15.87),
    "Praesepe": (130.10, 19.67),
    "Coma Berenices": (186.00, 26.00),
    "alpha Persei": (51.08, 48.98),
    "IC 2602": (160.70, -64.40),
}
"""Right ascension and declination of the open clusters, degrees (ICRS)."""
FIELDS = ((5.0, 8.0), (7.0, 7.5), (10.0, 6.5), (15.0, 6.5), (20.0, 6.0), (25.0, 5.5), (30.0, 5.5), (40.0, 5.0))
"""Fields of view, degrees, and the magnitude limits of their guide stars, V: 20 to 90 stars in a field."""
MOST_FOCAL_ERROR = 0.10
NOISE_PX, NOISE_MAG = 0.1, 0.15
KINDS = (
    "focal length",
    "few stars",
    "false stars",
    "missing stars",
    "occulted",
    "torn",
    "mirrored",
    "errors misstated",
    "distortion",
    "magnitudes shuffled",
    "two fields",
    "wrong prior",
)
"""Faults of random fields; each that leaves a true attitude comes with a wrong focal length in every second list."""
WITHOUT_TRUTH = ("torn", "mirrored", "two fields")
GROUPS = ("clusters", "others")


@dataclass(frozen=True, eq=False)
class DoubtfulList:
    """One list.

    Parameters
    ----------
    kind : str
        Name of the cluster, or of the fault.
    field : int
        Row of `FIELDS`.
    xy, flux : array (N, 2), (N,)
        Pixels, and signal (1 at magnitude 0), brightest first.
    sigma_px : float, optional
        Stated standard error; None: not stated.
    matrix : array (3, 3), optional
        Truth: ICRS to camera. None: no attitude is right.
    focal : float
        Truth: factor of the focal length against the camera's.
    prior : array (3, 3), optional
        Attitude given as a prior of 1°, or from which a session starts.
    mode : float
        Uniform from 0 to 1: chooses the tracker and its settings.
    """

    kind: str
    field: int
    xy: FloatArray
    flux: FloatArray
    sigma_px: float | None
    matrix: FloatArray | None
    focal: float
    prior: FloatArray
    mode: float


def camera_of(field: int) -> Camera:
    """The camera as the tracker knows it."""
    return Camera.from_fov(FIELDS[field][0], SIZE_PX, SIZE_PX)


@lru_cache(maxsize=len(FIELDS))
def _sky(field: int) -> tuple[StarCatalog, FloatArray]:
    """Catalogue of a field, doubles closer than two pixels merged, and its directions."""
    _, limit = FIELDS[field]
    separation = 2.0 * camera_of(field).pixel_rad
    catalog = merge_doubles(load_catalog("hipparcos").brighter_than(limit + 0.8), separation).brighter_than(limit)
    return catalog, catalog.directions(catalog.epoch_jyear)


def doubtful_list(group: str, index: int, seed: int = 1) -> DoubtfulList:
    """List `index` of a group of `GROUPS`, independent of other lists."""
    rng = stream(seed, f"doubtful {group}", index)
    field = int(rng.integers(len(FIELDS)))
    if group == "clusters":
        kind = list(CLUSTERS)[int(rng.integers(len(CLUSTERS)))]
        matrix = _towards(rng, field, CLUSTERS[kind])
        focal = 1.0 + rng.uniform(-MOST_FOCAL_ERROR, MOST_FOCAL_ERROR)
    else:
        kind = KINDS[int(rng.integers(len(KINDS)))]
        matrix = _random_rotation(rng)
        focal = 1.0 + rng.uniform(-MOST_FOCAL_ERROR, MOST_FOCAL_ERROR) * (kind == KINDS[0] or rng.random() < 0.5)
    if kind in WITHOUT_TRUTH:
        focal = 1.0
    noise = NOISE_PX * math.exp(rng.uniform(-1.0, 2.0)) if kind == "errors misstated" else NOISE_PX
    xy, v_mag = _stars(rng, field, matrix, focal, noise, kind)
    if kind == "two fields":  # each half of the image shows another one
        other_xy, other_v = _stars(rng, field, _random_rotation(rng), focal, noise, kind)
        left, right = xy[:, 0] < 0.5 * SIZE_PX, other_xy[:, 0] >= 0.5 * SIZE_PX
        xy, v_mag = np.concatenate([xy[left], other_xy[right]]), np.concatenate([v_mag[left], other_v[right]])
    magnitude = v_mag + NOISE_MAG * rng.standard_normal(len(v_mag))
    if kind == "magnitudes shuffled":
        magnitude = rng.permutation(magnitude)
    order = np.argsort(magnitude, kind="stable")
    xy, flux = xy[order], 10.0 ** (-0.4 * magnitude[order])
    if kind == "few stars":
        few = int(rng.integers(3, 9))
        xy, flux = xy[:few], flux[:few]
    chance = rng.random()
    stated = None if chance < 0.2 else NOISE_PX
    return DoubtfulList(
        kind,
        field,
        xy,
        flux,
        stated,
        None if kind in WITHOUT_TRUTH else matrix,
        focal,
        _prior(rng, matrix, 8.0 if kind == "wrong prior" else 0.5),
        float(rng.random()),
    )


def _random_rotation(rng: np.random.Generator) -> FloatArray:
    quat = rng.standard_normal(4)
    matrix: FloatArray = quat_to_matrix(quat / math.sqrt(float(quat @ quat)))
    return matrix


def _towards(rng: np.random.Generator, field: int, radec_deg: tuple[float, float]) -> FloatArray:
    """A random attitude that has a direction of the sky on the inner 80 % of the image."""
    across = 0.8 * math.tan(math.radians(0.5 * FIELDS[field][0]))
    x, y = rng.uniform(-across, across, 2)
    seen = np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    target, roll = radec_to_direction(*np.radians(radec_deg)), rng.uniform(0.0, 2.0 * math.pi)
    axis = np.cross(target, seen)
    turn = rotation_vector_to_matrix(axis / np.linalg.norm(axis) * math.atan2(np.linalg.norm(axis), target @ seen))
    matrix: FloatArray = rotation_vector_to_matrix(seen * roll) @ turn
    if float((matrix @ target) @ seen) < 0.999:  # the sense of the rotation is that of the frame, not of the vector
        matrix = rotation_vector_to_matrix(seen * roll) @ turn.T
    return matrix


def _prior(rng: np.random.Generator, matrix: FloatArray, off_deg: float) -> FloatArray:
    prior: FloatArray = rotation_vector_to_matrix(np.radians(off_deg) * rng.uniform(-1.0, 1.0, 3)) @ matrix
    return prior


def _stars(
    rng: np.random.Generator, field: int, matrix: FloatArray, focal: float, noise: float, kind: str
) -> tuple[FloatArray, FloatArray]:
    """Measured positions (N, 2) and V of the stars of a field, with the fault of its kind."""
    camera, (catalog, directions) = camera_of(field), _sky(field)
    near = directions @ matrix[2] > math.cos(math.radians(0.95 * FIELDS[field][0]))
    vectors, v_mag = directions[near] @ matrix.T, np.array(catalog.v_mag[near])
    offset = focal * camera.fx * vectors[:, :2] / vectors[:, 2:]
    if kind == "distortion":
        radius2 = np.sum((offset / (0.5 * SIZE_PX)) ** 2, axis=1)
        offset = offset * (1.0 + rng.uniform(-0.03, 0.03) * radius2)[:, None]
    xy = offset + (camera.cx, camera.cy) + noise * rng.standard_normal(offset.shape)
    if kind == "mirrored":
        xy[:, 0] = SIZE_PX - 1.0 - xy[:, 0]
    kept = camera.contains(xy)
    dropped = rng.uniform(0.0, 0.6) if kind == "missing stars" else rng.choice([0.0, 0.0, 0.1, 0.2])
    kept &= rng.random(len(xy)) >= dropped
    if kind == "occulted":
        angle = rng.uniform(0.0, 2.0 * math.pi)
        along = (xy - (camera.cx, camera.cy)) @ (math.cos(angle), math.sin(angle))
        kept &= along < rng.uniform(-0.3, 0.3) * SIZE_PX
    xy, v_mag = xy[kept], v_mag[kept]
    if kind == "torn":
        xy[:, 0] = np.where(xy[:, 0] < 0.5 * SIZE_PX - 0.5, xy[:, 0] + 0.5 * SIZE_PX, xy[:, 0] - 0.5 * SIZE_PX)
    false = int(rng.integers(1, 40)) if kind == "false stars" else int(rng.integers(0, 4))
    if false:
        xy = np.concatenate([xy, rng.uniform(-0.5, SIZE_PX - 0.5, (false, 2))])
        v_mag = np.concatenate([v_mag, np.array(catalog.v_mag)[rng.integers(len(catalog.v_mag), size=false)]])
    return xy, v_mag
