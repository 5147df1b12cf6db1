"""The guide-star database of a camera for identification.

Stars down to the magnitude limit with unresolved doubles merged, close pairs excluded from patterns, and a sorted list
of the pair separations that fit into the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker.catalog.doubles import merge_doubles
from startracker.catalog.sky_view import (
    FieldShape,
    SkyView,
    VoxelGrid,
    apparent_directions,
    field_shape,
    stars_in_cone,
    stars_on_image,
    voxel_grid,
)
from startracker.catalog.stars import StarCatalog
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.display import described
from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.observer import Observer
from startracker.settings import IdentificationSettings

RESOLVED_PX = 2.0
"""Two stars closer than this are not resolved (Greyling 1995, eq. 5.1)."""
PATTERN_STARS_IN_FIELD = 60
"""Maximum number of pattern stars in a circle around the field; fainter guide stars are only used for verification."""
MOST_PAIRS = 12e6
"""Expected number of pairs of pattern stars that fit into a field, above which fewer stars are pattern stars. Only deep
catalogues and fields of 1° to 4° reach it, where 60 stars in a field would make up to 5e7 pairs. The pairs of which the
default identifier has a list, of up to 0.6 of the field's diagonal, take 34 MB at 1° and 55 MB at 2° (`gaia` to
V = 10)."""
_FEWEST_PATTERN_STARS = 6
_ZONE_STARS = 20_000
"""Number of stars of a zone whose pairs are formed at once, if there are more than three zones."""
_PAIR_EPOCH_STEP = 5.0  # years; the fastest naked-eye star moves 18″ in half a step, the 100th fastest 2.5″


@dataclass(frozen=True, eq=False)
class PairList:
    """Pairs of stars sorted by separation."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    """Indices into a table of stars, (P,)."""
    separation_rad: NDArray[np.float32]
    """Ascending, (P,); relative precision 6e-8."""

    def __len__(self) -> int:
        return len(self.separation_rad)

    @classmethod
    def of(cls, directions: FloatArray, index: IntArray, max_rad: float, min_rad: float = 0.0) -> PairList:
        """Pairs of the stars `index` among unit vectors `directions` (N, 3), with `min_rad` ≤ separation ≤
        `max_rad`."""
        points = directions[index]
        if len(index) < 500:  # the cone of a prior: all pairs at once
            i, j = np.triu_indices(len(index), 1)
        elif len(index) < 3 * _ZONE_STARS:
            pairs = cKDTree(points).query_pairs(2.0 * math.sin(min(max_rad, math.pi) / 2.0), output_type="ndarray")
            i, j = pairs[:, 0], pairs[:, 1]
        else:
            return cls._of_zones(points, index, max_rad, min_rad)
        x, y, z = (points[i] - points[j]).T
        separation = 2.0 * np.arcsin(np.minimum(np.sqrt(x * x + y * y + z * z) / 2.0, 1.0))
        keep = np.flatnonzero((separation >= min_rad) & (separation <= max_rad))
        kept = separation[keep]
        # The default sort takes a tenth of the time of a stable one, which is needed only if separations are equal.
        order = np.argsort(kept)
        if (np.diff(kept[order]) == 0.0).any():
            order = np.argsort(kept, kind="stable")
        order = keep[order]
        first, second = index[i[order]].astype(np.int32), index[j[order]].astype(np.int32)
        return cls(first, second, separation[order].astype(np.float32))

    @classmethod
    def _of_zones(cls, points: FloatArray, index: IntArray, max_rad: float, min_rad: float) -> PairList:
        """As `of`, zone by zone from south to north, which keeps the intermediate arrays small."""
        chord = 2.0 * math.sin(min(max_rad, math.pi) / 2.0)
        northward = np.argsort(points[:, 2], kind="stable")
        z, first, second, separation = points[northward, 2], [], [], []
        for start in range(0, len(index), _ZONE_STARS):
            stop = min(start + _ZONE_STARS, len(index))
            # The second star of a pair is north of the first, by the largest separation at most.
            end = max(int(np.searchsorted(z, z[stop - 1] + chord, side="right")), stop)
            rows = northward[start:end]
            pairs = cKDTree(points[rows]).query_pairs(chord, output_type="ndarray")
            pairs = pairs[pairs.min(axis=1) < stop - start]
            # The order within a pair is that of brightness, as in one list of all.
            i, j = np.sort(rows[pairs], axis=1).T
            apart = 2.0 * np.arcsin(np.minimum(np.linalg.norm(points[i] - points[j], axis=1) / 2.0, 1.0))
            keep = (apart >= min_rad) & (apart <= max_rad)
            first.append(index[i[keep]].astype(np.int32))
            second.append(index[j[keep]].astype(np.int32))
            separation.append(apart[keep].astype(np.float32))
        apart = np.concatenate(separation)
        order = np.argsort(apart, kind="stable")
        return cls(np.concatenate(first)[order], np.concatenate(second)[order], apart[order])


def close_pairs(
    directions: FloatArray, v_mag: FloatArray, separation_rad: float, magnitude: float
) -> NDArray[np.bool_]:
    """Mask (N,) of stars whose measured position can be biased by a neighbour.

    A star is marked if there is another one within `separation_rad` that is brighter, or less than `magnitude` fainter
    (Greyling 1995, section 5.2.1: 0.08° and 0.77 mag).
    """
    marked = np.zeros(len(directions), dtype=bool)
    if len(directions) < 2 or separation_rad <= 0:
        return marked
    pairs = cKDTree(directions).query_pairs(2.0 * math.sin(separation_rad / 2.0), output_type="ndarray")
    fainter_by = v_mag[pairs[:, 1]] - v_mag[pairs[:, 0]]
    marked[pairs[fainter_by < magnitude, 0]] = True
    marked[pairs[-fainter_by < magnitude, 1]] = True
    return marked


def brightest_everywhere(directions: FloatArray, radius_rad: float, limit: int) -> NDArray[np.bool_]:
    """Mask (N,) of stars, given brightest first, with fewer than about `limit` brighter selected stars within
    `radius_rad`.

    The selection makes the density uniform, so that dense and sparse parts of the sky have the same number of patterns.
    The stars are processed in batches of increasing size; the number in a circle exceeds `limit` by at most the number
    in one batch.
    """
    n = len(directions)
    chosen = np.zeros(n, dtype=bool)
    chord = 2.0 * math.sin(min(radius_rad, math.pi) / 2.0)
    start = 0
    while start < n:
        stop = min(n, start + max(limit, start // 8))
        known = np.flatnonzero(chosen[:start])
        if len(known) == 0:
            chosen[start:stop] = True
        else:
            count = cKDTree(directions[known]).query_ball_point(directions[start:stop], chord, return_length=True)
            chosen[start:stop] = count < limit
        start = stop
    return chosen


def expected_pairs(stars: int, half_diagonal_rad: float) -> float:
    """Expected number of pairs within the diagonal of a field, of stars spread evenly over the sky."""
    return 0.25 * float(stars) ** 2 * (1.0 - math.cos(min(2.0 * half_diagonal_rad, math.pi)))


@dataclass(frozen=True, eq=False)
class GuideDatabase:
    """Guide stars of one camera at one epoch, in the apparent directions for one observer."""

    camera: Camera
    """Defines size and shape of the field."""
    catalog: StarCatalog
    """Guide stars, unresolved doubles merged, brightest first."""
    directions: FloatArray
    """Apparent unit vectors, ICRS axes, (G, 3)."""
    pattern: NDArray[np.bool_]
    """Stars used in patterns, (G,); the others are only used for verification."""
    epoch_jyear: float
    """Epoch of `directions`."""
    _field: tuple[float, float]
    _motion: list[FloatArray] = field(default_factory=list)
    _pairs: dict[tuple[float, float], PairList] = field(default_factory=dict)
    _grid: list[VoxelGrid] = field(default_factory=list)
    _shape: list[FieldShape] = field(default_factory=list)

    # ------------------------------------------------------------------ construction
    def __repr__(self) -> str:
        limit, epoch = f"to V {self.v_mag[-1]:.1f}" if len(self) else "", f"epoch {self.epoch_jyear:.2f}"
        return described("GuideDatabase", self.catalog.name, f"{len(self):,} guide stars {limit}", epoch)

    @classmethod
    def build(
        cls,
        catalog: StarCatalog,
        camera: Camera,
        magnitude_limit: float,
        settings: IdentificationSettings | None = None,
    ) -> GuideDatabase:
        """Database of a catalogue for a camera; cached in memory.

        Raises
        ------
        InputError
            If fewer than three stars are brighter than the limit.
        """
        chosen = settings or IdentificationSettings()
        return _build(catalog, camera, float(magnitude_limit), chosen.close_pair_deg, chosen.close_pair_magnitude)

    def apparent_to(self, observer: Observer | None) -> GuideDatabase:
        """The same stars in apparent directions for an observer: space motion, annual parallax and aberration of
        light."""
        if observer is None:
            return self
        years = observer.epoch_jyear - self.catalog.epoch_jyear
        position = np.zeros(3) if observer.position_au is None else observer.position_au
        velocity = np.zeros(3) if observer.velocity_km_s is None else observer.velocity_km_s
        parallax, beta = self.catalog.parallax_rad, velocity / SPEED_OF_LIGHT_KM_S
        start, motion = self._space_motion()
        directions = apparent_directions(start, motion, parallax, years, position, beta)
        return replace(self, directions=directions, epoch_jyear=observer.epoch_jyear)

    def rows_of(self, catalog_id: IntArray) -> IntArray:
        """Rows (M,) of stars by their numbers in the catalogue, which must be guide stars."""
        order = np.argsort(self.catalog.id, kind="stable")
        return np.asarray(order[np.searchsorted(self.catalog.id, catalog_id, sorter=order)])

    def _space_motion(self) -> list[FloatArray]:
        """Directions and space motion per Julian year at the catalogue's epoch, (3, G) each; cached."""
        if not self._motion:
            self._motion.extend(np.ascontiguousarray(axes.T) for axes in self.catalog.space_motion())
        return self._motion

    @property
    def motion_axes(self) -> FloatArray:
        """Space motion (3, G) of the unit vectors per Julian year, ICRS axes."""
        return self._space_motion()[1]

    def brightest(self, count: int) -> GuideDatabase:
        """The database with only the `count` brightest stars."""
        if count >= len(self):
            return self
        directions = self.directions[:count]
        return replace(
            self,
            catalog=self.catalog.select(np.arange(count)),
            directions=directions,
            pattern=self.pattern[:count],
            _motion=[],
            _pairs={},
            _grid=[],
        )

    # ------------------------------------------------------------------ properties
    def __len__(self) -> int:
        return len(self.directions)

    @property
    def v_mag(self) -> FloatArray:
        """Catalogue V (G,), ascending."""
        return self.catalog.v_mag

    @property
    def half_diagonal_rad(self) -> float:
        """Largest angle between the boresight and a corner of the image, rad."""
        return self._field[0]

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of the image, sr."""
        return self._field[1]

    @property
    def pairs(self) -> PairList:
        """All pairs of pattern stars over the whole sky that fit into the field; computed on first use.

        Separations between barycentric directions, valid within 2.5 years of `epoch_jyear`. Aberration changes them by
        at most 1e-4 of the separation, which matching must allow.
        """
        return self.pairs_within(1.0)

    def pairs_within(self, share: float) -> PairList:
        """As `pairs`, with separations up to a fraction of the field's diagonal."""
        epoch = _PAIR_EPOCH_STEP * round(self.epoch_jyear / _PAIR_EPOCH_STEP)
        if (epoch, share) not in self._pairs:
            index = np.flatnonzero(self.pattern)
            widest = min(2.0 * self.half_diagonal_rad * share, math.pi)
            self._pairs[epoch, share] = PairList.of(
                self.catalog.directions(epoch), index, widest, RESOLVED_PX * self.camera.pixel_rad
            )
        return self._pairs[epoch, share]

    def pairs_near(self, axis: FloatArray, radius_rad: float) -> PairList:
        """Pairs of pattern stars that can be in the field if the boresight is within `radius_rad` of a unit vector."""
        near = self.in_cone(axis, self.half_diagonal_rad + radius_rad)
        return PairList.of(self.directions, near[self.pattern[near]], min(2.0 * self.half_diagonal_rad, math.pi))

    @property
    def view(self) -> SkyView:
        """The stars and the field in the form that kernels read; grid and outline are computed on first use."""
        if not self._shape:
            self._shape.append(field_shape(self.camera))
        return SkyView(self.directions, self.v_mag, self.grid, self._shape[0], self.solid_angle_sr)

    @property
    def grid(self) -> VoxelGrid:
        """Spatial index of the stars for kernels; computed on first use."""
        if not self._grid:
            self._grid.append(voxel_grid(self.directions))
        return self._grid[0]

    def in_cone(self, axis: FloatArray, radius_rad: float) -> IntArray:
        """Indices of the guide stars within `radius_rad` of a unit vector, ascending (brightest first)."""
        x, y, z = map(float, axis)
        near = stars_in_cone(x, y, z, math.cos(min(radius_rad, math.pi)), self.directions, self.grid)
        near.sort()
        return np.asarray(near, dtype=np.int64)

    def in_field(
        self, matrix: FloatArray, margin_px: float = 0.0, camera: Camera | None = None
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Guide stars on the image of the camera (or another `camera`) at the attitude `matrix` (3, 3), ICRS to camera.

        Returns
        -------
        index (K,), vectors (K, 3) in the camera frame, pixels (K, 2); brightest first.
        """
        camera = camera or self.camera
        cosine = field_cosine(camera, margin_px)
        matrix = np.ascontiguousarray(matrix)
        found = stars_on_image(matrix, cosine, float(margin_px), self.directions, self.grid, camera.image_map)
        return found[0], found[1], found[2]


def field_cosine(camera: Camera, margin_px: float = 0.0) -> float:
    """Cosine of the largest angle between the boresight and a point of the image, enlarged by a margin."""
    return math.cos(min(camera.half_diagonal_rad + 1.5 * margin_px * camera.pixel_rad, math.pi))


def field_of(camera: Camera) -> tuple[float, float]:
    """Half diagonal (rad) and solid angle (sr) of a camera's image, with distortion.

    The solid angle is summed over a grid of 24 × 24 cells and is accurate to 1e-3.
    """
    x = np.linspace(-0.5, camera.width - 0.5, 25)
    y = np.linspace(-0.5, camera.height - 0.5, 25)
    grid = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(25, 25, 3)
    down, across = grid[1:, 1:] - grid[:-1, :-1], grid[:-1, 1:] - grid[1:, :-1]
    # Half the cross product of its diagonals is the area of a quadrilateral.
    area = 0.5 * np.linalg.norm(np.cross(down, across), axis=-1)
    half_diagonal = camera.half_diagonal_rad
    if not (math.isfinite(half_diagonal) and np.isfinite(area).any()):
        raise InputError("the camera's distortion cannot be inverted anywhere on the image: check its coefficients")
    return half_diagonal, float(np.nansum(area))


@lru_cache(maxsize=16)
def _build(
    catalog: StarCatalog, camera: Camera, magnitude_limit: float, close_deg: float, close_magnitude: float
) -> GuideDatabase:
    # Spectral types are unused, and half of the database's memory.
    source = catalog.provenance
    catalog = replace(catalog, spectral_type=np.full(len(catalog), ""), source=source)
    merged = merge_doubles(_deep_enough(catalog, magnitude_limit), min(RESOLVED_PX * camera.pixel_rad, 0.1))
    merged = merged.brighter_than(magnitude_limit)
    if len(merged) < 3:
        faintest = float(catalog.v_mag.min()) if len(catalog) else math.nan
        raise InputError(
            f"magnitude limit {magnitude_limit}: the catalogue {catalog.name} has {len(merged)} stars down to it; "
            f"give a fainter limit (its brightest star is V = {faintest:.2f})"
        )
    half_diagonal, solid_angle = field_of(camera)
    directions = merged.directions(merged.epoch_jyear)
    pattern = ~close_pairs(directions, merged.v_mag, math.radians(close_deg), close_magnitude)
    even = brightest_everywhere(directions[pattern], half_diagonal, PATTERN_STARS_IN_FIELD)
    pairs = expected_pairs(int(even.sum()), half_diagonal)
    if pairs > MOST_PAIRS:
        # The number of pairs grows with the square of the number of stars in a field.
        around = even.sum() * 0.5 * (1.0 - math.cos(half_diagonal))
        limit = max(math.floor(around * math.sqrt(MOST_PAIRS / pairs)), _FEWEST_PATTERN_STARS)
        even = brightest_everywhere(directions[pattern], half_diagonal, limit)
    pattern[np.flatnonzero(pattern)[~even]] = False
    return GuideDatabase(
        camera,
        merged,
        directions,
        pattern,
        merged.epoch_jyear,
        (half_diagonal, solid_angle),
    )


def _deep_enough(catalog: StarCatalog, magnitude_limit: float) -> StarCatalog:
    # Two equal stars merge into one that is 0.75 mag brighter, so fainter components must be included.
    return catalog.brighter_than(magnitude_limit + 0.8)
