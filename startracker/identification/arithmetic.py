"""The array operations that identification by triads is made of, apart from the algorithm that puts them in order.

`triads` and `triad_tables` are written once over the protocol `Arithmetic`; here it is carried out in floating point,
in `startracker.fixed_point` in integers. Numbers that an arithmetic hands out (`Numbers`) are arrays or scalars of its
own format, and the algorithm only passes them on, sorts and compares them: two quantities of one kind (two separations,
two angles) compare as the values they stand for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import InputError

__all__ = ["Arithmetic", "FloatArithmetic", "FloatImage", "FloatSky", "Numbers"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Numbers: TypeAlias = NDArray[Any]
"""Values in an arithmetic's own format: float64 degrees in floating point, int64 in the integer build."""


class Arithmetic(Protocol):
    """What the triad pipeline computes with (Yee 1999, sections 2.3 and 3).

    Two formats are told apart: *separations* (her 6.10) and *angles* on a circle (her 10.6), the second in
    [0, `full_turn`) or, as differences, in [−`full_turn`/2, `full_turn`/2). `image` and `sky` are whatever this
    arithmetic makes of the stars and needs again, tables included. Index arrays `i`, `j`, `k`, ... have equal shapes
    (P,), and so have the results.
    """

    @property
    def full_turn(self) -> Any:
        """360° in the format of angles, a Python number; its type is that of sums of angles."""
        ...

    # ------------------------------------------------------------------ what goes in
    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> Any:
        """Image stars from centroids (N, 2), x right and y up from the image's centre, and degrees a pixel (2,)."""
        ...

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> Any:
        """Catalogue stars from their coordinates (G,), with the tables for separations up to the largest."""
        ...

    def separation_of(self, degrees: float) -> Any:
        """A separation, such as a tolerance, in the format of separations (a scalar)."""
        ...

    def angle_of(self, degrees: float) -> Any:
        """An angle, such as a tolerance, in the format of angles (a scalar)."""
        ...

    # ------------------------------------------------------------------ separations
    def image_separations(self, image: Any, i: IntArray, j: IntArray) -> Numbers:
        """Separations of image stars: cos θ = cos χ cos ψ (eq. 2.4)."""
        ...

    def catalog_separations(self, sky: Any, i: IntArray, j: IntArray) -> Numbers:
        """Separations of catalogue stars (eq. 2.3)."""
        ...

    # ------------------------------------------------------------------ rotation angles
    def image_directions(self, image: Any, i: IntArray, j: IntArray) -> Numbers:
        """Angles of the vectors from star i to star j, from +x towards +y, in raw pixels."""
        ...

    def catalog_directions(self, sky: Any, i: IntArray, j: IntArray) -> Numbers:
        """Angles of the vectors from star i to star j, from decreasing right ascension towards north."""
        ...

    def rotations(self, catalog: Numbers, image: Numbers) -> Numbers:
        """Counter-clockwise angles in [0, `full_turn`) that turn the image vectors into the catalogue's."""
        ...

    def mean_rotations(self, first: Numbers, second: Numbers) -> Numbers:
        """Angles in [0, `full_turn`) half-way between two rotations, on the shorter way round."""
        ...

    # ------------------------------------------------------------------ enclosed angles
    def image_enclosed(self, image: Any, i: IntArray, j: IntArray, k: IntArray) -> tuple[Numbers, Numbers, Numbers]:
        """Inner angles at i, j and k of the triangles of image stars, planar in raw pixels."""
        ...

    def catalog_enclosed(self, sky: Any, i: IntArray, j: IntArray, k: IntArray) -> tuple[Numbers, Numbers, Numbers]:
        """Inner angles at i, j and k of the spherical triangles of catalogue stars (eqs. 2.5 to 2.7)."""
        ...

    # ------------------------------------------------------------------ comparisons and means
    def separations_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Whether two separations differ by the tolerance at most."""
        ...

    def angles_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Whether two angles differ, on the shorter way round, by the tolerance at most."""
        ...

    def group_mean(self, origin: Any, total: Any, count: int) -> Any:
        """Running mean of a group: `origin` + `total` / `count` in [0, `full_turn`).

        `total` is the sum of the members' differences from the angle `origin`.
        """
        ...

    # ------------------------------------------------------------------ what comes out
    def separation_degrees(self, separations: Numbers) -> FloatArray:
        """Separations in degrees, to print."""
        ...

    def angle_degrees(self, angles: Numbers) -> FloatArray:
        """Angles in degrees, to print."""
        ...


@dataclass(frozen=True, eq=False)
class FloatImage:
    """Image stars as floating point has them.

    Parameters
    ----------
    xy_px : (N, 2)
        x right, y up, from the image's centre.
    scale_deg : (2,)
        Degrees a pixel.
    """

    xy_px: FloatArray
    scale_deg: FloatArray


@dataclass(frozen=True, eq=False)
class FloatSky:
    """Catalogue stars as floating point has them.

    Parameters
    ----------
    ra_deg, dec_deg : (G,)
    vectors : (G, 3)
    """

    ra_deg: FloatArray
    dec_deg: FloatArray
    vectors: FloatArray


@dataclass(frozen=True)
class FloatArithmetic:
    """Float64, in degrees.

    Parameters
    ----------
    exact : bool
        False: the geometry of Yee 1999. Image separations by eq. 2.4 with constant degrees a pixel, enclosed angles of
        the image planar, catalogue vectors in a plane of plain degrees without cos δ (exact for small fields at low
        declination; her tolerances cover the rest). True: pixels are those of a tangent plane; separations by eq. D.1,
        enclosed angles on the sphere, catalogue vectors as great circles leave star i.
    """

    exact: bool = False

    @property
    def full_turn(self) -> float:
        """360."""
        return 360.0

    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> FloatImage:
        """See `Arithmetic.image`."""
        xy, scale = np.array(xy_px, dtype=float), np.array(scale_deg, dtype=float)
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise InputError(f"centroids must be finite pairs (N, 2); got an array of shape {xy.shape}")
        if scale.shape != (2,) or not (np.isfinite(scale).all() and (scale > 0.0).all()):
            raise InputError(f"degrees a pixel must be two positive numbers; got {scale.tolist()}")
        return FloatImage(xy, scale)

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> FloatSky:
        """See `Arithmetic.sky`; floating point needs no tables."""
        ra, dec = np.array(ra_deg, dtype=float), np.array(dec_deg, dtype=float)
        a, d = np.radians(ra), np.radians(dec)
        return FloatSky(ra, dec, np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)]))

    def separation_of(self, degrees: float) -> float:
        """As it is."""
        return float(degrees)

    def angle_of(self, degrees: float) -> float:
        """As it is."""
        return float(degrees)

    def image_separations(self, image: FloatImage, i: IntArray, j: IntArray) -> FloatArray:
        """Eq. 2.4, or D.1 where the geometry is exact."""
        if self.exact:
            vectors = _tangent_vectors(image)
            return _vector_separations(vectors[i], vectors[j])
        chi, psi = np.radians((image.xy_px[i] - image.xy_px[j]) * image.scale_deg).T
        # sin² of the half angle, as the cosine itself says little of small ones
        half = np.sin(chi / 2.0) ** 2 + np.cos(chi) * np.sin(psi / 2.0) ** 2
        return np.asarray(np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))))

    def catalog_separations(self, sky: FloatSky, i: IntArray, j: IntArray) -> FloatArray:
        """Eq. 2.3 as 2 asin of half the chord."""
        return _vector_separations(sky.vectors[i], sky.vectors[j])

    def image_directions(self, image: FloatImage, i: IntArray, j: IntArray) -> FloatArray:
        """Angle atan2(Δy, Δx)."""
        step = image.xy_px[j] - image.xy_px[i]
        return np.asarray(np.degrees(np.arctan2(step[:, 1], step[:, 0])) % 360.0)

    def catalog_directions(self, sky: FloatSky, i: IntArray, j: IntArray) -> FloatArray:
        """Angle atan2(Δδ, −Δα), Δα within ±180°; where the geometry is exact that of the great circle at star i."""
        east = (sky.ra_deg[j] - sky.ra_deg[i] + 180.0) % 360.0 - 180.0
        if not self.exact:
            return np.asarray(np.degrees(np.arctan2(sky.dec_deg[j] - sky.dec_deg[i], -east)) % 360.0)
        a, d, e = np.radians(east), np.radians(sky.dec_deg[i]), np.radians(sky.dec_deg[j])
        towards_east = np.cos(e) * np.sin(a)
        towards_north = np.cos(d) * np.sin(e) - np.sin(d) * np.cos(e) * np.cos(a)
        return np.asarray(np.degrees(np.arctan2(towards_north, -towards_east)) % 360.0)

    def rotations(self, catalog: Numbers, image: Numbers) -> FloatArray:
        """Catalogue minus image."""
        return np.asarray((catalog - image) % 360.0)

    def mean_rotations(self, first: Numbers, second: Numbers) -> FloatArray:
        """Mean of both, the second taken on the first's side of the circle."""
        return np.asarray((first + _between(second, first) / 2.0) % 360.0)

    def image_enclosed(
        self, image: FloatImage, i: IntArray, j: IntArray, k: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Planar, or on the sphere where the geometry is exact."""
        points = _tangent_vectors(image) if self.exact else image.xy_px
        return _inner_angles(points[i], points[j], points[k], self.exact)

    def catalog_enclosed(
        self, sky: FloatSky, i: IntArray, j: IntArray, k: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angles between the great circles."""
        return _inner_angles(sky.vectors[i], sky.vectors[j], sky.vectors[k], True)

    def separations_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Compare |first − second|."""
        return np.asarray(np.abs(first - second) <= tolerance)

    def angles_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Compare the shorter way round."""
        return np.asarray(np.abs(_between(first, second)) <= tolerance)

    def group_mean(self, origin: Any, total: Any, count: int) -> float:
        """See `Arithmetic.group_mean`."""
        return float((origin + total / count) % 360.0)

    def separation_degrees(self, separations: Numbers) -> FloatArray:
        """As they are."""
        return np.asarray(separations, dtype=float)

    def angle_degrees(self, angles: Numbers) -> FloatArray:
        """As they are."""
        return np.asarray(angles, dtype=float)


def _between(first: Numbers, second: Numbers) -> Numbers:
    """Angle first − second in [−180, 180)."""
    return np.asarray((first - second + 180.0) % 360.0 - 180.0)


def _tangent_vectors(image: FloatImage) -> FloatArray:
    """Unit vectors (N, 3) of points of the plane that touches the sphere at the image's centre."""
    x, y = (image.xy_px * np.radians(image.scale_deg)).T
    vectors = np.column_stack([x, y, np.ones_like(x)])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _vector_separations(first: FloatArray, second: FloatArray) -> FloatArray:
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))))


def _inner_angles(
    a: FloatArray, b: FloatArray, c: FloatArray, sphere: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles (P,) at a, b and c of triangles of points (P, 2) of a plane or unit vectors (P, 3) of a sphere."""
    return _angle_at(a, b, c, sphere), _angle_at(b, a, c, sphere), _angle_at(c, a, b, sphere)


def _angle_at(vertex: FloatArray, first: FloatArray, second: FloatArray, sphere: bool) -> FloatArray:
    """Angle between the ways from a vertex to two points, 0 where one of them is the vertex itself."""
    u, v = first - vertex, second - vertex
    dot = np.einsum("ij,ij->i", u, v)
    if not sphere:
        return np.asarray(np.degrees(np.arctan2(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]), dot)))
    # tangents at the vertex: what the vertex's own direction leaves of the two chords
    along_u, along_v = np.einsum("ij,ij->i", u, vertex), np.einsum("ij,ij->i", v, vertex)
    sine = np.abs(np.einsum("ij,ij->i", vertex, np.cross(u, v)))
    return np.asarray(np.degrees(np.arctan2(sine, dot - along_u * along_v)))
