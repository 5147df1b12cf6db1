"""Patterns of four stars whose shape does not depend on scale, and their index over the whole sky.

The two stars farthest apart, A and B, define a frame with A = (0, 0) and B = (1, 1); the positions of the other two, C
and D, are the pattern's code (four numbers). The order of the stars is fixed by x_C ≤ x_D and x_C + x_D ≤ 1. Shift,
rotation and scale do not change the code; a mirrored image has the codes of the mirrored pattern.

Patterns consist of neighbours among stars selected evenly over the sky, on levels that differ in size by a factor √2,
so that the brightest stars of an image of any field occur on one of them.

Source: Lang, Hogg, Mierle, Blanton & Roweis 2010, AJ 139, 1782, sections 2.1 and 2.2.
"""

from __future__ import annotations

import functools
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker.catalog import cache, load_catalog
from startracker.catalog.guide import GuideDatabase, brightest_everywhere
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera

NEIGHBOURS = 6
STARS_IN_CIRCLE = 10
LEVEL_RADII_DEG = tuple(1.8 * math.sqrt(2.0) ** k for k in range(10))
_TRIPLES = np.array(list(combinations(range(NEIGHBOURS), 3)))
_EDGES = np.array(list(combinations(range(4), 2)))
"""Edges of a pattern; the edge opposite to the first is the last, and so on."""


def quad_codes(points: FloatArray, quads: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """Codes of patterns in a plane.

    Parameters
    ----------
    points : (Q, 4, 2)
        The stars of each pattern in a plane, whose scale does not matter.
    quads : (Q, 4)
        Their indices.

    Returns
    -------
    codes (Q, 4): x_C, y_C, x_D, y_D; indices (Q, 4) in the order A, B, C, D; distance AB (Q,). NaN if two stars
    coincide.
    """
    one, other = _EDGES.T
    square = ((points[:, one] - points[:, other]) ** 2).sum(axis=2)
    longest = square.argmax(axis=1)
    order = np.concatenate([_EDGES[longest], _EDGES[::-1][longest]], axis=1)
    corners = np.take_along_axis(points, order[:, :, None], axis=1)
    # As complex numbers, z → z · (1 + i) / u with u = B − A maps A to 0 and B to 1 + i.
    ux, uy = (corners[:, 1] - corners[:, 0]).T[:, :, None]
    vx, vy = np.moveaxis(corners[:, 2:] - corners[:, :1], 2, 0)
    u2 = np.take_along_axis(square, longest[:, None], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along, across = (vx * ux + vy * uy) / u2, (vy * ux - vx * uy) / u2
    codes = np.stack([along - across, along + across], axis=2)
    turn = codes[:, :, 0].sum(axis=1) > 1.0
    codes[turn], order[turn] = 1.0 - codes[turn], order[turn][:, [1, 0, 2, 3]]
    turn = codes[:, 0, 0] > codes[:, 1, 0]
    codes[turn], order[turn] = codes[turn][:, ::-1], order[turn][:, [0, 1, 3, 2]]
    return codes.reshape(-1, 4), np.take_along_axis(quads, order, axis=1), np.sqrt(u2[:, 0])


def neighbour_quads(vectors: FloatArray, index: IntArray) -> IntArray:
    """Patterns (Q, 4) of each star of `index` with three of its six nearest neighbours; each set once, sorted."""
    count = min(NEIGHBOURS + 1, len(index))
    if count < 4:
        return np.empty((0, 4), dtype=np.int64)
    _, near = cKDTree(vectors[index]).query(vectors[index], k=count)
    triples = _TRIPLES[_TRIPLES.max(axis=1) < count - 1]
    quads = np.concatenate(
        [np.broadcast_to(near[:, :1, None], (len(index), len(triples), 1)), near[:, 1 + triples]], axis=2
    ).reshape(-1, 4)
    quads = np.sort(quads, axis=1)
    key = ((quads[:, 0] * len(index) + quads[:, 1]) * len(index) + quads[:, 2]) * len(index) + quads[:, 3]
    _, first = np.unique(key, return_index=True)
    return np.asarray(index[quads[first]], dtype=np.int64)


def sky_codes(vectors: FloatArray, quads: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """`quad_codes` of unit vectors (N, 3): each pattern in its own tangent plane, as seen from inside the sphere.

    The plane is tangent to the sphere at the pattern's centre. Images are projected in the same way, so that patterns
    far from the boresight of a wide field keep their shape. The distance AB is an angle, rad.
    """
    stars = vectors[quads]  # (Q, 4, 3)
    centre = stars.sum(axis=1)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    # Any axis perpendicular to the line of sight will do, because codes do not depend on rotation.
    helper = np.where(np.abs(centre[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x_axis = np.cross(helper, centre)
    x_axis /= np.linalg.norm(x_axis, axis=1, keepdims=True)
    y_axis = np.cross(centre, x_axis)
    depth = np.einsum("qsi,qi->qs", stars, centre)
    points = np.stack([np.einsum("qsi,qi->qs", stars, x_axis), np.einsum("qsi,qi->qs", stars, y_axis)], axis=2)
    codes, order, _ = quad_codes(points / depth[:, :, None], quads)
    chord = np.linalg.norm(vectors[order[:, 0]] - vectors[order[:, 1]], axis=1)
    return codes, order, 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))


@dataclass(frozen=True, eq=False)
class QuadIndex:
    """Patterns of the whole sky.

    Parameters
    ----------
    codes : float32 (Q, 4)
    quads : int32 (Q, 4)
        Stars A, B, C, D.
    baseline_rad : float32 (Q,)
        Angle AB, rad.
    """

    codes: NDArray[np.float32]
    quads: NDArray[np.int32]
    baseline_rad: NDArray[np.float32]
    tree: cKDTree

    def __len__(self) -> int:
        return len(self.quads)

    @classmethod
    def of(cls, codes: NDArray[np.float32], quads: NDArray[np.int32], baseline_rad: NDArray[np.float32]) -> QuadIndex:
        """Index of the given arrays."""
        return cls(codes, quads, baseline_rad, cKDTree(codes, leafsize=32, balanced_tree=False, compact_nodes=False))

    def candidates(
        self, codes: FloatArray, tolerance: FloatArray, low_rad: FloatArray, high_rad: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Patterns with a code within `tolerance` (Q,) of `codes` (Q, 4) and an angle AB between the limits (Q,).

        Returns
        -------
        index of the query, index of the pattern, distance of the codes; nearest first.
        """
        near = self.tree.query_ball_point(codes, tolerance)
        lengths = np.array([len(rows) for rows in near], dtype=np.int64)
        query = np.repeat(np.arange(len(codes)), lengths)
        found = np.array([k for rows in near for k in rows], dtype=np.int64)
        fits = (self.baseline_rad[found] >= low_rad[query]) & (self.baseline_rad[found] <= high_rad[query])
        query, found = query[fits], found[fits]
        distance = np.linalg.norm(self.codes[found] - codes[query], axis=1)
        order = np.argsort(distance / tolerance[query], kind="stable")
        return query[order], found[order], distance[order]


def build_quads(
    directions: FloatArray, radii_deg: tuple[float, ...] = LEVEL_RADII_DEG
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]:
    """Codes, stars and angles AB of the patterns of all levels.

    Parameters
    ----------
    directions : (G, 3)
        Unit vectors, brightest first.
    radii_deg : tuple of float
        One level for each: stars with fewer than ten brighter ones within this radius.
    """
    tables = []
    for radius_deg in radii_deg:
        index = np.flatnonzero(brightest_everywhere(directions, math.radians(radius_deg), STARS_IN_CIRCLE))
        codes, quads, baseline = sky_codes(directions, neighbour_quads(directions, index))
        good = np.isfinite(codes).all(axis=1)
        tables.append((codes[good].astype(np.float32), quads[good].astype(np.int32), baseline[good].astype(np.float32)))
    return (
        np.concatenate([t[0] for t in tables]),
        np.concatenate([t[1] for t in tables]),
        np.concatenate([t[2] for t in tables]),
    )


_CODE_LOW, _CODE_STEP = -0.5, 2.0**-15
"""C and D are no farther from A and B than A and B from each other, √2, so that codes lie within (1 ± √3)/2 = −0.37 to
1.37, and up to 0.05 beyond, because the plane stretches the sky."""


def pack_quads(codes: NDArray[np.float32], quads: NDArray[np.int32]) -> dict[str, NDArray[Any]]:
    """Arrays of half the size, for a file: codes to 1.5e-5 (1/400 of the tolerance), stars in 18 bits.

    The angles AB are omitted, because they follow from the stars' positions.
    """
    steps = np.round((codes - _CODE_LOW) / _CODE_STEP).astype(np.uint16)
    high = np.zeros(len(quads), dtype=np.uint8)
    for star in range(4):
        high |= (quads[:, star] >> 16 << 2 * star).astype(np.uint8)
    return {"codes": steps, "low": (quads & 0xFFFF).astype(np.uint16), "high": high}


def unpack_quads(stored: Mapping[str, NDArray[Any]], directions: FloatArray) -> QuadIndex:
    """Index of packed arrays whose stars have the directions (G, 3)."""
    codes = (stored["codes"] * np.float32(_CODE_STEP) + np.float32(_CODE_LOW)).astype(np.float32)
    high = stored["high"].astype(np.int32)
    quads = np.stack([stored["low"][:, k].astype(np.int32) | (high >> 2 * k & 3) << 16 for k in range(4)], axis=1)
    positions = directions.astype(np.float32)
    chord = np.linalg.norm(positions[quads[:, 0]] - positions[quads[:, 1]], axis=1)
    baseline = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    return QuadIndex.of(codes, quads, baseline.astype(np.float32))


_MAGNITUDE_LIMIT = 9.0
_REFERENCE = Camera.from_fov(4.0, 1024, 1024)  # the finest: doubles closer than 28″ are one
_CACHE_KEY = "quads-2"


@functools.lru_cache(maxsize=16)
def brightest_stars(catalog: str | StarCatalog, depth: int) -> GuideDatabase:
    """The `depth` brightest of `all_stars`."""
    return all_stars(catalog).brightest(depth)


@functools.cache
def all_stars(catalog: str | StarCatalog) -> GuideDatabase:
    """Guide stars to V = 9 for every field, brightest first."""
    return GuideDatabase.build(
        load_catalog(catalog) if isinstance(catalog, str) else catalog, _REFERENCE, _MAGNITUDE_LIMIT
    )


@functools.cache
def quad_index(catalog: str | StarCatalog) -> QuadIndex:
    """Patterns of the whole sky; computed in about two seconds, then cached in the user's folder (24 MB)."""
    stars = all_stars(catalog)
    # The name includes a checksum of the stars' positions, because another edition of the catalogue needs another
    # index.
    mark = zlib.crc32(np.ascontiguousarray(stars.directions).tobytes())
    key = f"{_CACHE_KEY}-{mark:08x}"
    stored = cache.load_arrays(key)
    if stored is None or not {"codes", "low", "high"} <= stored.keys():
        codes, quads, _ = build_quads(stars.directions)
        stored = pack_quads(codes, quads)
        cache.store_arrays(key, stored)
    return unpack_quads(stored, stars.directions)
