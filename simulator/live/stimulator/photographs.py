"""Photographs of the patterns: which dot is where, and how bright each square is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simulator.live.stimulator.patterns import MARKERS, Pattern
from startracker.arguments import of_kind, real_number, text
from startracker.centroid import METHODS as CENTROIDERS
from startracker.core import FloatArray, IntArray
from startracker.detection import METHODS as DETECTORS
from startracker.detection.background import as_image
from startracker.errors import InputError
from startracker.front_end import Clock, find_stars
from startracker.geometry.camera import Camera
from startracker.inputs import GivenImage
from startracker.settings import CentroidSettings, DetectionSettings

_LEAST_SHARE = 0.6
"""Share of the dots that must be found, of those that lie in the camera's field."""
_GATE_CELLS = 0.25
_RING_PX = 2
_MOST_SHIFT = 0.15


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph by a calibrated camera.

    Parameters
    ----------
    name : str
        For messages.
    image : (H, W) array
        DN, divided by the camera's flat field where that is known.
    camera : Camera
    saturation_dn : float, optional
        From which value on pixels are saturated.
    """

    name: str
    image: NDArray[np.float32]
    camera: Camera
    saturation_dn: float | None = None

    def __post_init__(self) -> None:
        text("name", self.name)
        object.__setattr__(self, "image", as_image(self.image))
        if self.saturation_dn is not None:
            real_number("saturation_dn", self.saturation_dn, finite=False)
        of_kind("camera", self.camera, Camera)
        expected = (self.camera.height, self.camera.width)
        if self.image.shape != expected:
            raise InputError(
                f"{self.name}: has {self.image.shape[1]}×{self.image.shape[0]} pixels, the camera "
                f"{expected[1]}×{expected[0]}; give photographs of that camera at full size"
            )

    def refuse_saturated(self) -> None:
        """`InputError` if pixels are saturated: their brightness and the dots' centroids are wrong."""
        share = 0.0 if self.saturation_dn is None else float(np.mean(self.image >= self.saturation_dn))
        if share > 1e-4:
            raise InputError(f"{self.name}: {share:.2%} of its pixels are saturated; take it with a shorter exposure")


class Dots(NamedTuple):
    """Dots of a photograph: index (N, 2) in the lattice, pixels (N, 2), variance (N,) on one axis, px², and parity."""

    lattice: FloatArray
    xy: FloatArray
    variance_px2: FloatArray
    parity: int


class SquareFluxes(NamedTuple):
    """Flux (N,), DN, of the squares in the field, its variance without photon noise, and their rows in the pattern."""

    flux: FloatArray
    variance: FloatArray
    row: IntArray


def find_dots(photograph: Photograph, pattern: Pattern) -> Dots:
    """Detect, measure and identify the dots.

    Raises
    ------
    InputError
        If they are saturated, too few, or the three markers are not among them.
    """
    photograph.refuse_saturated()
    found = find_stars(
        GivenImage(photograph.image, saturation_dn=photograph.saturation_dn),
        DETECTORS["components"],
        CENTROIDERS["least_squares"],
        DetectionSettings(max_stars=3 * len(pattern.lattice)),
        CentroidSettings(),
        Clock(),
    )
    name = photograph.name
    if found.status is not None:
        raise InputError(f"{name}: {found.reason}; photograph the pattern dots")
    rays = photograph.camera.unproject(found.stars.xy)
    plane = rays[:, :2] / rays[:, 2:]
    if len(plane) < 12 or not np.isfinite(plane).all():
        raise InputError(f"{name}: only {len(plane)} dots were found; expose longer, or focus, and photograph dots")
    start = _markers(plane)
    if start is None:
        raise InputError(f"{name}: the three markers in the middle of the pattern were not found; all must be seen")
    index, known = _grown(plane, start)
    half = np.abs(pattern.lattice).max(axis=0)
    known &= (np.abs(index) <= half + 0.6).all(axis=1)
    rows = np.flatnonzero(known)
    if len(np.unique(index[rows], axis=0)) < len(rows):
        raise InputError(f"{name}: two dots have the same position in the lattice; is it one photograph of dots?")
    seen = _in_field(photograph.camera, index[rows], found.stars.xy[rows], pattern)
    if len(rows) < max(20, _LEAST_SHARE * seen):
        raise InputError(
            f"{name}: only {len(rows)} of about {seen:.0f} dots in the field were identified; "
            "expose longer, focus, or use a greater spacing or larger dots"
        )
    variance = found.stars.variance_px2
    assert variance is not None
    (ax, ay), (bx, by) = (plane[start[1]] - plane[start[0]]), (plane[start[2]] - plane[start[0]])
    return Dots(index[rows], found.stars.xy[rows], variance[rows], 1 if ax * by > ay * bx else -1)


def _markers(plane: FloatArray) -> IntArray | None:
    """Rows (3,) of corner, short and long end: dots in the middle of four others, at a right angle, legs 2 to 3."""
    tree = cKDTree(plane)
    distance = tree.query(plane, k=5)[0][:, 1:]
    cell = float(np.median(distance[:, 0]))
    middle = np.flatnonzero((distance[:, 3] < 0.85 * cell) & (distance[:, 0] > 0.55 * cell))
    if len(middle) != len(MARKERS):
        return None
    for corner in range(3):
        one, two = (row for k, row in enumerate(middle) if k != corner)
        legs = plane[[one, two]] - plane[middle[corner]]
        length = np.linalg.norm(legs, axis=1) / cell
        short = int(np.argmin(length))
        cosine = float(legs[0] @ legs[1]) / float(np.prod(length) * cell**2)
        if abs(cosine) < 0.3 and abs(length[short] - 2) < 0.4 and abs(length[1 - short] - 3) < 0.5:
            return np.array([middle[corner], (one, two)[short], (one, two)[1 - short]])
    return None


def _grown(plane: FloatArray, start: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Lattice index (N, 2) of each dot, grown from the markers outwards by a local affine map, and which are known."""
    index = np.full(plane.shape, np.nan)
    index[start] = MARKERS
    known = np.isin(np.arange(len(plane)), start)
    cell = float(np.linalg.norm(plane[start[1]] - plane[start[0]])) / 2
    while True:
        near, which = cKDTree(plane[known]).query(plane, k=min(12, int(known.sum())))
        fresh = np.flatnonzero(~known & (near[:, 0] < 1.3 * cell))
        before = int(known.sum())
        source, target = plane[known], index[known]
        for row in fresh:
            terms = np.column_stack([source[which[row]] - plane[row], np.ones(len(which[row]))])
            guess = np.linalg.lstsq(terms, target[which[row]], rcond=None)[0][2]
            whole = np.rint(guess)
            if np.abs(guess - whole).max() < _GATE_CELLS:
                index[row], known[row] = whole, True
        if int(known.sum()) == before:
            return index, known


def _in_field(camera: Camera, index: FloatArray, xy: FloatArray, pattern: Pattern) -> float:
    """Number of dots in the camera's field, by the affine map of those that were identified."""
    map_, *_ = np.linalg.lstsq(np.column_stack([index, np.ones(len(index))]), xy, rcond=None)
    everywhere = np.column_stack([pattern.lattice, np.ones(len(pattern.lattice))]) @ map_
    return float(camera.contains(everywhere, -3.0).sum())


def square_fluxes(photograph: Photograph, corners: FloatArray) -> SquareFluxes:
    """Flux of each square above its surroundings.

    Parameters
    ----------
    photograph : Photograph
        Of one of the patterns with squares.
    corners : (N, 4, 2)
        Pixels of the squares' corners in the photograph, from the geometry; NaN outside the field.

    Raises
    ------
    InputError
        If pixels are saturated, or the squares are too small, few, or not where they should be.
    """
    photograph.refuse_saturated()
    low, high = corners.min(axis=1), corners.max(axis=1)
    gap = 0.5 * (high - low)
    first, last = np.floor(low - 0.7 * gap), np.ceil(high + 0.7 * gap)
    size = np.array([photograph.camera.width, photograph.camera.height])
    inside = np.flatnonzero(((first >= 0) & (last < size)).all(axis=1))
    if len(inside) < 20:
        raise InputError(f"{photograph.name}: fewer than 20 squares are in the field; photograph the whole display")
    if float(np.median(gap[inside])) < 2 * _RING_PX:
        raise InputError(f"{photograph.name}: the squares are too small for this camera; use a greater spacing")
    boxes = zip(np.hstack([first, last])[inside].astype(int).tolist(), corners.mean(axis=1)[inside], strict=True)
    out = np.array(
        [_measured(photograph.image[y0 : y1 + 1, x0 : x1 + 1], c - (x0, y0)) for (x0, y0, x1, y1), c in boxes]
    )
    bright = out[:, 0] >= np.percentile(out[:, 0], 75)
    shift, half_gap = np.median(out[bright, 2:], axis=0), float(np.median(gap[inside]))
    if not np.abs(shift).max() < _MOST_SHIFT * half_gap:
        raise InputError(
            f"{photograph.name}: its squares are {np.abs(shift).max():.1f} px from where dots says; "
            "camera and display must not move between the photographs, nor may the patterns be mixed up"
        )
    return SquareFluxes(out[:, 0], out[:, 1], inside)


def _measured(box: NDArray[np.float32], centre: FloatArray) -> tuple[float, float, float, float]:
    """Flux of a square above the outermost pixels of its box, variance, and shift of its centroid from `centre`."""
    pixels = box.astype(float)
    ring = np.ones(box.shape, np.bool_)
    ring[_RING_PX:-_RING_PX, _RING_PX:-_RING_PX] = False
    sky, noise = float(np.mean(pixels[ring])), float(np.var(pixels[ring]))
    signal = np.where(ring, 0.0, pixels - sky)
    flux, lit = float(signal.sum()), int(box.size - ring.sum())
    y, x = np.indices(box.shape)
    shift = (
        float((signal * at).sum()) / flux - c if flux > 0 else np.nan for at, c in zip((x, y), centre, strict=True)
    )
    return flux, noise * lit * (1 + lit / ring.sum()), *shift
