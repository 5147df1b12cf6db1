"""What a display shows of the sky: stars as small spots of grey levels, and what it cannot show, counted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.focal_plane import FocalPlane
from simulator.light import body_rates_e_s, star_rates_e_s
from simulator.live.stimulator.geometry import DisplayGeometry
from simulator.live.stimulator.photometry import DITHERING, Photometry
from simulator.scene import Scene
from startracker.arguments import of_kind, real_array, real_number, text, whole_number
from startracker.core import ARCSEC_RAD, FloatArray, IntArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, camera_attitude

FAINT_MAG = 0.1
"""A star whose displayed brightness is further from the one wanted is counted as too faint, or as clipped."""


_LEAST_PART = 1e-5
"""Pixels with less of a star's light stay black: together 2e-4 of it, symmetric about the star."""


class DisplayPicture(NamedTuple):
    """Lit pixels of a display, and the stars (M,) on it."""

    pixels: IntArray
    """Column and row (N, 2)."""
    rgb: NDArray[np.uint8]
    """Levels (N, 3)."""
    star: IntArray
    """Rows (M,) of the stars in what was given; the others are outside the display."""
    position: FloatArray
    """Display pixels (M, 2)."""
    magnitude: FloatArray
    shown_magnitude: FloatArray
    """As wanted and as the levels give it (infinite if nothing is lit), (M,)."""
    clipped: NDArray[np.bool_]
    """Stars with a pixel above the highest level, (M,)."""

    @property
    def faint(self) -> NDArray[np.bool_]:
        """Stars (M,) with a wrong brightness, as the steps between the levels are too coarse for them."""
        return ~self.clipped & ~(np.abs(self.shown_magnitude - self.magnitude) <= FAINT_MAG)


class Limit(NamedTuple):
    """How well stars of one magnitude are displayed, over positions within a pixel."""

    magnitude: float
    brightness_mag: float
    """Rms error of the brightness."""
    position_arcsec: float
    """Rms error of the centroid on one axis."""
    clipped: bool


@dataclass(frozen=True)
class Stimulator:
    """A calibrated display before a tracker.

    Parameters
    ----------
    geometry : DisplayGeometry
        Display and collimator.
    photometry : Photometry
        Its brightness.
    alignment : Attitude
        Collimator to the tracker's camera.
    spot_px : float
        Standard deviation of the Gaussian spot of a star, display pixels: the wider, the brighter the stars that can
        be shown, and the wider their images.
    dithering : str
        ``none``, ``spatial`` or ``temporal`` (`simulator.live.stimulator.photometry.DITHERING`).
    uncertainty : mapping of str to float
        Standard errors of the calibration by name.

    Raises
    ------
    InputError
        For a spot that is not from 0.3 to 10 pixels, or an unknown dithering.
    """

    geometry: DisplayGeometry
    photometry: Photometry
    alignment: Attitude
    spot_px: float = 0.6
    dithering: str = "spatial"
    uncertainty: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        of_kind("geometry", self.geometry, DisplayGeometry)
        of_kind("photometry", self.photometry, Photometry)
        of_kind("alignment", self.alignment, Attitude)
        of_kind("uncertainty", self.uncertainty, (Mapping,))
        real_number("spot_px", self.spot_px, finite=False)
        text("dithering", self.dithering)
        if not 0.3 <= self.spot_px <= 10.0:
            raise InputError(f"a spot must be from 0.3 to 10 display pixels; got {self.spot_px:g}")
        if self.dithering not in DITHERING:
            raise InputError(
                f"dithering must be {', '.join(DITHERING[:-1])} or {DITHERING[-1]}; got {self.dithering!r}"
            )

    def picture(
        self, attitude: Attitude, directions: ArrayLike, magnitude: ArrayLike, number: int = 0
    ) -> DisplayPicture:
        """Picture of stars for a commanded attitude of the tracker.

        Parameters
        ----------
        attitude : Attitude
            ICRS to camera.
        directions : (K, 3)
            Apparent directions of the stars, ICRS.
        magnitude : (K,)
            In the tracker's band (`point_sources`).
        number : int
            Of the picture, for temporal dithering.
        """
        turn = camera_attitude("attitude", attitude).as_matrix().T @ self.alignment.as_matrix()
        seen = real_array("directions", directions, (None, 3)) @ turn
        magnitude = real_array("magnitude", magnitude, (len(seen),))
        number = whole_number("number", number)
        ahead = np.flatnonzero(seen[:, 2] > 0.2)  # the lens model may fold back far outside the display
        position = self.geometry.to_pixels(seen[ahead])
        inside = self.geometry.collimator.contains(position)
        return self.spots(position[inside], magnitude[ahead[inside]], ahead[inside], number)

    def spots(self, position: FloatArray, magnitude: FloatArray, star: IntArray, number: int = 0) -> DisplayPicture:
        """Picture of stars at display pixels (M, 2)."""
        width, height = self.geometry.size
        near, weight = _spot(position, self.spot_px)
        x, y = near[..., 0], near[..., 1]
        kept = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (weight > _LEAST_PART)
        owner = np.broadcast_to(np.arange(len(position))[:, None], kept.shape)[kept]
        cell, part = (y * width + x)[kept], (weight * 10.0 ** (-0.4 * magnitude[:, None]))[kept]
        cells, where = np.unique(cell, return_inverse=True)
        wanted = np.bincount(where, part, len(cells)).astype(float)
        most = np.empty(len(cells), np.int64)
        most[where[np.argsort(part)]] = owner[np.argsort(part)]  # the last one written is the brightest
        pixels: IntArray = np.stack([cells % width, cells // width], axis=1).astype(np.int64)
        levels = self.photometry.quantised(pixels, wanted, most, self.dithering, number)
        given = np.bincount(owner, (part / np.maximum(wanted[where], 1e-300)) * levels.flux[where], len(position))
        with np.errstate(divide="ignore"):
            shown = -2.5 * np.log10(given)
        clipped = np.bincount(owner, (wanted > levels.most)[where], len(position)) > 0
        lit = levels.rgb.any(axis=1)
        return DisplayPicture(pixels[lit], levels.rgb[lit], star, position, magnitude, shown, clipped)

    def limits(self, magnitudes: ArrayLike, positions: int = 400) -> list[Limit]:
        """Errors of the displayed stars by magnitude, at evenly distributed positions within the middle pixel."""
        positions = whole_number("positions", positions, least=1, most=100_000)
        values = np.atleast_1d(real_array("magnitudes", magnitudes)).ravel().tolist()
        middle = np.array(self.geometry.size) // 2
        step = np.arange(positions)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]) % 1.0 - 0.5
        axes = self.geometry.to_directions(middle + np.array([[0.0, 0.0], [1.0, 0.0]]))
        pixel_arcsec = float(np.linalg.norm(axes[1] - axes[0])) / ARCSEC_RAD
        out = []
        for magnitude in values:
            brightness, centroid, clipped = np.empty(positions), np.empty((positions, 2)), False
            for n, at in enumerate(middle + step):
                one = self.spots(at[None], np.array([magnitude]), np.zeros(1, np.int64), n)
                flux = self.photometry.flux(one.pixels, one.rgb)
                brightness[n] = one.shown_magnitude[0] - magnitude
                centroid[n] = flux @ one.pixels / flux.sum() - at if flux.sum() > 0 else np.nan
                clipped |= bool(one.clipped[0])
            rms = float(np.sqrt(np.mean(centroid**2)))
            out.append(Limit(magnitude, float(np.sqrt(np.mean(brightness**2))), rms * pixel_arcsec, clipped))
        return out


def _spot(position: FloatArray, sigma: float) -> tuple[IntArray, FloatArray]:
    """Pixels (M, K, 2) around positions (M, 2), and the parts (M, K) of a Gaussian in each, which sum to 1."""
    from scipy.special import ndtr

    half = math.ceil(4.0 * sigma)
    nearest = np.rint(position).astype(np.int64)
    reach = np.arange(-half, half + 1)
    offset = (nearest - position)[:, :, None] + reach
    part = ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma)
    part /= part.sum(axis=2, keepdims=True)
    near = np.stack(np.broadcast_arrays(reach[None, :], reach[:, None]), axis=-1).reshape(-1, 2)
    return nearest[:, None] + near, (part[:, 1, :, None] * part[:, 0, None, :]).reshape(len(position), -1)


def point_sources(scene: Scene, focal_plane: FocalPlane) -> tuple[FloatArray, FloatArray]:
    """Stars and planets of a scene as a display shows them: points, without what the tracker's own lens does to them.

    Returns
    -------
    apparent directions (N, 3), ICRS; magnitudes (N,) in the tracker's band: that of a dwarf with B−V = 0 that gives as
    many electrons. Hidden sources and disks wider than the tracker's pixel (Sun, Moon) are not among them.
    """
    of_kind("scene", scene, Scene)
    of_kind("focal_plane", focal_plane, FocalPlane)
    photometer, sky, bodies = focal_plane.photometer, focal_plane.sky, scene.bodies
    small = np.flatnonzero(2.0 * bodies.angular_radius_rad < focal_plane.camera.pixel_rad)
    rate = [
        star_rates_e_s(scene, photometer, sky),
        body_rates_e_s(scene, bodies, photometer, sky)[small],
    ]
    direction = np.concatenate([scene.star_directions, bodies.direction[small]])
    electrons_per_s = np.concatenate(rate)
    seen = electrons_per_s > 0.0
    standard = float(photometer.electrons_per_s(0.0, 0.0, 0.0))
    return direction[seen], -2.5 * np.log10(electrons_per_s[seen] / standard)
