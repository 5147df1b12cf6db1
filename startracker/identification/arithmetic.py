"""Array operations of identification by triads, in floating point (Yee 1999, sections 2.3 and 3).

`triad_search`, `triad_tables` and `triad_votes` are written once for every `Arithmetic`: floating point, documented in
`FloatArithmetic`, and the integers of the thesis (`simulator.theses.yee1999.fixed_point`). `Numbers` are arrays or
scalars in the format of an arithmetic; the algorithm only passes them on, sorts and compares them. There are two
formats: *separations* (her 6.10), and *angles* on a circle (her 10.6), in [0, `full_turn`) or, for differences, in
[−`full_turn`/2, `full_turn`/2). `image` and `sky` are the stars in the form that the arithmetic uses, including tables.
Index arrays `i`, `j`, `k` have equal shapes (P,), and so do the results.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.geometry.attitude import radec_to_direction

Numbers: TypeAlias = NDArray[Any]
"""Values in an arithmetic's own format: float64 degrees in floating point, int64 in the integers of the thesis."""


class Arithmetic(Protocol):
    """Operations of identification by triads; `FloatArithmetic` documents them."""

    @property
    def full_turn(self) -> Any:
        """360° in the format of angles."""
        ...

    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> Any:
        """Image stars."""
        ...

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> Any:
        """Catalogue stars."""
        ...

    def separation_of(self, degrees: float) -> Any:
        """A number of degrees as a separation."""
        ...

    def angle_of(self, degrees: float) -> Any:
        """A number of degrees as an angle."""
        ...

    def image_separations(self, image: Any, i: IntArray, j: IntArray) -> Numbers:
        """Separations of image stars."""
        ...

    def catalog_separations(self, sky: Any, i: IntArray, j: IntArray) -> Numbers:
        """Separations of catalogue stars."""
        ...

    def image_directions(self, image: Any, i: IntArray, j: IntArray) -> Numbers:
        """Directions from star i to star j in the image."""
        ...

    def catalog_directions(self, sky: Any, i: IntArray, j: IntArray) -> Numbers:
        """The same in the sky."""
        ...

    def rotations(self, catalog: Numbers, image: Numbers) -> Numbers:
        """Angles from image vectors to those of the catalogue."""
        ...

    def mean_rotations(self, first: Numbers, second: Numbers) -> Numbers:
        """Angles half-way between two rotations."""
        ...

    def image_enclosed(self, image: Any, i: IntArray, j: IntArray, k: IntArray) -> tuple[Numbers, Numbers, Numbers]:
        """Inner angles of triangles in the image."""
        ...

    def catalog_enclosed(self, sky: Any, i: IntArray, j: IntArray, k: IntArray) -> tuple[Numbers, Numbers, Numbers]:
        """The same in the sky."""
        ...

    def separations_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Whether separations differ by at most a tolerance."""
        ...

    def angles_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """The same of angles."""
        ...

    def group_mean(self, origin: Any, total: Any, count: int) -> Any:
        """Running mean of the rotations of a group."""
        ...

    def separation_degrees(self, separations: Numbers) -> FloatArray:
        """Separations in degrees."""
        ...

    def angle_degrees(self, angles: Numbers) -> FloatArray:
        """Angles in degrees."""
        ...


@dataclass(frozen=True, eq=False)
class FloatImage:
    """Image stars in floating point.

    Parameters
    ----------
    xy_px : (N, 2)
        x right, y up, relative to the image's centre, px.
    scale_deg : (2,)
        Degrees per pixel.
    """

    xy_px: FloatArray
    scale_deg: FloatArray


@dataclass(frozen=True, eq=False)
class FloatSky:
    """Catalogue stars in floating point.

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
        False: the geometry of Yee 1999. Image separations follow eq. 2.4 with constant degrees per pixel, enclosed
        angles of the image are planar, and catalogue vectors lie in a plane of plain degrees without cos δ (valid for
        small fields at low declination; her tolerances cover the rest). True: pixels are those of a tangent plane;
        separations follow eq. D.1, enclosed angles are those on the sphere, and catalogue vectors leave star i along
        great circles.
    """

    exact: bool = False

    @property
    def full_turn(self) -> float:
        """360° in the format of angles; its type is that of sums of angles."""
        return 360.0

    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> FloatImage:
        """Image stars from centroids (N, 2), x right and y up relative to the image's centre, and degrees per pixel
        (2,)."""
        xy, scale = np.array(xy_px, dtype=float), np.array(scale_deg, dtype=float)
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise InputError(f"centroids must be finite pairs (N, 2); got an array of shape {xy.shape}")
        if scale.shape != (2,) or not (np.isfinite(scale).all() and (scale > 0.0).all()):
            raise InputError(f"degrees per pixel must be two positive numbers; got {scale.tolist()}")
        return FloatImage(xy, scale)

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> FloatSky:
        """Catalogue stars from their coordinates (G,), with tables for separations up to the largest if the arithmetic
        needs them."""
        ra, dec = np.array(ra_deg, dtype=float), np.array(dec_deg, dtype=float)
        return FloatSky(ra, dec, radec_to_direction(np.radians(ra), np.radians(dec)))

    def separation_of(self, degrees: float) -> float:
        """A separation, such as a tolerance, in the format of separations."""
        return float(degrees)

    def angle_of(self, degrees: float) -> float:
        """An angle, such as a tolerance, in the format of angles."""
        return float(degrees)

    def image_separations(self, image: FloatImage, i: IntArray, j: IntArray) -> FloatArray:
        """Separations of image stars: eq. 2.4, or D.1 if the geometry is exact."""
        if self.exact:
            vectors = _tangent_vectors(image)
            return _vector_separations(vectors[i], vectors[j])
        chi, psi = np.radians((image.xy_px[i] - image.xy_px[j]) * image.scale_deg).T
        # sin² of the half angle, because the cosine itself loses the digits of small angles.
        half = np.sin(chi / 2.0) ** 2 + np.cos(chi) * np.sin(psi / 2.0) ** 2
        return np.asarray(np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))))

    def catalog_separations(self, sky: FloatSky, i: IntArray, j: IntArray) -> FloatArray:
        """Separations of catalogue stars: eq. 2.3, as 2 asin of half the chord."""
        return _vector_separations(sky.vectors[i], sky.vectors[j])

    def image_directions(self, image: FloatImage, i: IntArray, j: IntArray) -> FloatArray:
        """Angles of the vectors from star i to star j in pixels, counted from +x towards +y: atan2(Δy, Δx)."""
        step = image.xy_px[j] - image.xy_px[i]
        return np.asarray(np.degrees(np.arctan2(step[:, 1], step[:, 0])) % 360.0)

    def catalog_directions(self, sky: FloatSky, i: IntArray, j: IntArray) -> FloatArray:
        """Angles of the vectors from star i to star j, counted from decreasing right ascension towards north.

        atan2(Δδ, −Δα) with Δα within ±180°, or the bearing of the great circle at star i in the exact geometry.
        """
        east = (sky.ra_deg[j] - sky.ra_deg[i] + 180.0) % 360.0 - 180.0
        if not self.exact:
            return np.asarray(np.degrees(np.arctan2(sky.dec_deg[j] - sky.dec_deg[i], -east)) % 360.0)
        a, d, e = np.radians(east), np.radians(sky.dec_deg[i]), np.radians(sky.dec_deg[j])
        towards_east = np.cos(e) * np.sin(a)
        towards_north = np.cos(d) * np.sin(e) - np.sin(d) * np.cos(e) * np.cos(a)
        return np.asarray(np.degrees(np.arctan2(towards_north, -towards_east)) % 360.0)

    def rotations(self, catalog: Numbers, image: Numbers) -> FloatArray:
        """Angles in [0, `full_turn`) that rotate the image vectors counter-clockwise onto the catalogue's."""
        return np.asarray((catalog - image) % 360.0)

    def mean_rotations(self, first: Numbers, second: Numbers) -> FloatArray:
        """Angles in [0, `full_turn`) half-way between two rotations along the shorter arc."""
        # Half of a difference in [−180°, 180°) is on the shorter arc; the mean of the two angles may be on the longer
        # one.
        return np.asarray((first + _between(second, first) / 2.0) % 360.0)

    def image_enclosed(
        self, image: FloatImage, i: IntArray, j: IntArray, k: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inner angles at i, j and k of triangles of image stars: planar, or on the sphere in the exact geometry."""
        points = _tangent_vectors(image) if self.exact else image.xy_px
        return _inner_angles(points[i], points[j], points[k], self.exact)

    def catalog_enclosed(
        self, sky: FloatSky, i: IntArray, j: IntArray, k: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inner angles at i, j and k of the spherical triangles of catalogue stars (eqs. 2.5 to 2.7)."""
        return _inner_angles(sky.vectors[i], sky.vectors[j], sky.vectors[k], True)

    def separations_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Whether two separations differ by at most the tolerance."""
        return np.asarray(np.abs(first - second) <= tolerance)

    def angles_agree(self, first: Numbers, second: Numbers, tolerance: Any) -> NDArray[np.bool_]:
        """Whether two angles differ, on the shorter arc, by at most the tolerance."""
        return np.asarray(np.abs(_between(first, second)) <= tolerance)

    def group_mean(self, origin: Any, total: Any, count: int) -> float:
        """Running mean of a group in [0, `full_turn`): `origin` + `total` / `count`.

        `total` is the sum of the members' differences from the angle `origin`.
        """
        return float((origin + total / count) % 360.0)

    def separation_degrees(self, separations: Numbers) -> FloatArray:
        """Separations in degrees, for output."""
        return np.asarray(separations, dtype=float)

    def angle_degrees(self, angles: Numbers) -> FloatArray:
        """Angles in degrees, for output."""
        return np.asarray(angles, dtype=float)


def _between(first: Numbers, second: Numbers) -> Numbers:
    """Angle first − second in [−180, 180)."""
    return np.asarray((first - second + 180.0) % 360.0 - 180.0)


def _tangent_vectors(image: FloatImage) -> FloatArray:
    """Unit vectors (N, 3) of points on the plane tangent to the sphere at the image's centre."""
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
    """Angle at a vertex between two points, degrees; 0 if one of them is the vertex itself."""
    u, v = first - vertex, second - vertex
    dot = np.einsum("ij,ij->i", u, v)
    if not sphere:
        return np.asarray(np.degrees(np.arctan2(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]), dot)))
    # Tangents at the vertex are the two chords without their components along the vertex.
    along_u, along_v = np.einsum("ij,ij->i", u, vertex), np.einsum("ij,ij->i", v, vertex)
    sine = np.abs(np.einsum("ij,ij->i", vertex, np.cross(u, v)))
    return np.asarray(np.degrees(np.arctan2(sine, dot - along_u * along_v)))
