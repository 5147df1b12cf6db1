"""The exposure: integration of electron rates over the time for which the shutter is open.

Light arrives at the focal plane as rates in electrons per second, and only this module converts them to electrons. The
rate of static light is multiplied by the exposure time, that of a moving source by the time spent at each position of
its path, and in a frame transfer by the time for which the charge stays in each row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from simulator.optics.drift import Drift, drifting_paths
from simulator.optics.jitter_series import JitterMotion
from simulator.optics.shutter import frame_transfer_smear, rolling_paths
from simulator.optics.smear import star_paths
from startracker.core import FloatArray
from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class Shutter:
    """How the detector is exposed."""

    kind: Literal["global", "rolling", "frame_transfer"] = "global"
    """``global``; ``rolling``: row by row; ``frame_transfer``: charge is shifted through the illuminated image."""
    line_time_s: float = 0.0
    """Time from row to row of a rolling shutter, or of the transfer."""
    transfer_direction: Literal["up", "down"] = "up"
    """``up``: charge leaves past row 0; ``down``: past the last row."""
    transfer_smear: Literal["both", "after"] = "both"
    """Smear ``both`` before and after the exposure, or only ``after`` it."""


class Motion(NamedTuple):
    """Rotation of the camera during an exposure."""

    rate_rad_s: FloatArray
    """(3,): Inertial angular velocity in camera axes."""
    jitter: JitterMotion | None = None
    """Rotation relative to the mean attitude, as a function of the time from mid-exposure; None for none."""


class Paths(NamedTuple):
    """Positions of N sources on the image at K moments of an exposure."""

    xy: FloatArray
    """(N, K, 2): Pixels at K moments; NaN where a path is not computed."""
    weights: FloatArray
    """(K,): Fraction of the exposure of each moment."""
    electrons: FloatArray
    """(N,): Electrons of each source over the exposure."""


@dataclass(frozen=True)
class Exposure:
    """One exposure."""

    start_s: float
    """Seconds after the scenario's epoch; of the middle row for a rolling shutter."""
    duration_s: float
    """Exposure time."""
    shutter: Shutter = Shutter()
    """How the detector is exposed."""

    @classmethod
    def about(cls, middle_s: float, duration_s: float, shutter: Shutter) -> Exposure:
        """Exposure from the time of mid-exposure."""
        return cls(middle_s - 0.5 * duration_s, duration_s, shutter)

    @property
    def middle_s(self) -> float:
        """Seconds after the scenario's epoch."""
        return self.start_s + 0.5 * self.duration_s

    def electrons(self, rate_e_s: FloatArray) -> FloatArray:
        """Electrons of static light, from electrons per second; any shape, a new array."""
        return np.multiply(rate_e_s, self.duration_s)

    def paths(
        self,
        camera: Camera,
        directions: FloatArray,
        electrons: FloatArray,
        motion: Motion,
        feature_px: float,
        margin_px: float,
        drift: Drift | None = None,
    ) -> Paths:
        """Positions of sources during the exposure, and their electrons.

        Parameters
        ----------
        camera : Camera
            Projection.
        directions : (N, 3) array
            Unit vectors in camera axes at mid-exposure.
        electrons : (N,) array
            Electrons of the sources if static.
        motion : Motion
            Rotation of the camera.
        feature_px, margin_px : float
            Finest structure of the PSF, and margin around the image in which paths are computed.
        drift : Drift, optional
            Motion of the sources themselves, in camera axes.
        """
        # `Paths` of a global shutter have the same moments for all sources. With a rolling shutter each source is
        # exposed at the time of its own rows, so its share of the electrons depends on how fast it crosses them.
        sampling = (feature_px, margin_px, motion.jitter)
        if self.shutter.kind != "rolling":
            if drift is not None:
                return Paths(*drifting_paths(camera, drift, motion.rate_rad_s, self.duration_s, *sampling), electrons)
            xy, weights = star_paths(camera, directions, motion.rate_rad_s, self.duration_s, *sampling)
            return Paths(xy, weights, electrons)
        line_s = self.shutter.line_time_s
        sources = directions if drift is None else drift
        xy, weights, share = rolling_paths(camera, sources, motion.rate_rad_s, self.duration_s, line_s, *sampling)
        return Paths(xy, weights, electrons * share)

    def add_transfer_smear(self, mean_e: FloatArray) -> None:
        """Add the transfer smear of the image (H, W), in place; only for frame transfer."""
        shutter = self.shutter
        if shutter.kind == "frame_transfer":
            mean_e += frame_transfer_smear(
                mean_e, self.duration_s, shutter.line_time_s, shutter.transfer_direction, shutter.transfer_smear
            )
