"""Frames that do not change: repeated ones, and a static picture while the gyro measures a rotation.

A frozen camera, or a buffer or list that is sent twice, looks like a body at rest, with identical noise that does not
average out. Because of noise no two frames are identical to the last bit.

A frozen camera whose noise is fresh in every frame, such as one whose exposure is not triggered, shows the same sky for
ever. Its frames are not repeated (`repeats`), and a filter explains them by a bias of the gyro. But a bias has a stated
size. While the attitudes of the stars alone stay where they are, the gyro may show no more rotation than its stated
errors explain; what is beyond means that the picture is old, or that the gyro is wrong, and nothing shows which.
A picture that moves is believed, whatever the gyro says.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray, IntArray
from startracker.tracking.mekf import GyroNoise, Mekf, chi_square_limit, rotation_between

_FRAMES = 8
"""Number of frames remembered: more than the buffers of a camera driver."""
_STARS = 16
_HALF_PX = 3
"""7 × 7 pixels around each star are compared; elsewhere a driver may write counters or time stamps into the image."""
_STEPS = np.arange((2 * _HALF_PX + 1) ** 2) + (2 * _HALF_PX + 1) ** 2 // 2
_STEPS %= len(_STEPS)  # the star's own pixel comes first
_ROWS, _COLUMNS = _STEPS // (2 * _HALF_PX + 1) - _HALF_PX, _STEPS % (2 * _HALF_PX + 1) - _HALF_PX


class FrameMemory:
    """Recent frames used by the filter."""

    def __init__(self) -> None:
        self._lists: deque[tuple[float, bytes]] = deque(maxlen=_FRAMES)
        self._images: deque[tuple[float, tuple[int, ...], IntArray, IntArray, FloatArray]] = deque(maxlen=_FRAMES)

    def list_repeats(self, key: bytes) -> float | None:
        """Time of the frame with the same list (`list_key`); None if there is none."""
        return next((t_s for t_s, other in self._lists if other == key), None) if key else None

    def keep_list(self, t_s: float, key: bytes) -> None:
        """Remember a list that was used."""
        self._lists.append((t_s, key))

    def image_repeats(self, pixels: NDArray[Any] | None) -> float | None:
        """Time of the frame with the same pixels around its stars as this one (H, W); None if there is none."""
        if pixels is None:
            return None
        for t_s, shape, rows, columns, values in self._images:
            # one pixel is sufficient for nearly every new frame
            if pixels.shape != shape or pixels[rows[0], columns[0]] != values[0] == values[0]:
                continue
            # compared by bytes: NaN, which marks unusable pixels, then equals itself
            if pixels[rows, columns].astype(float).tobytes() == values.tobytes():
                return t_s
        return None

    def keep_image(self, t_s: float, pixels: NDArray[Any] | None, xy: FloatArray) -> None:
        """Remember the pixels of a used image around its identified stars, (N, 2)."""
        if pixels is None or not len(xy):
            return
        centre = np.rint(xy[:_STARS]).astype(np.int64)
        height, width = pixels.shape
        rows = np.minimum(np.maximum(centre[:, 1, None] + _ROWS, 0), height - 1).ravel()  # some are at the border
        columns = np.minimum(np.maximum(centre[:, 0, None] + _COLUMNS, 0), width - 1).ravel()
        self._images.append((t_s, pixels.shape, rows, columns, pixels[rows, columns].astype(float)))


def list_key(points: FloatArray) -> bytes:
    """Key of the coordinates (N, 2) of a list, independent of their order; empty for an empty list or another shape."""
    if points.ndim != 2 or points.shape[1] != 2:
        return b""
    pairs = np.ascontiguousarray(points, dtype=float).view(np.complex128)  # sorted by x, then by y
    return bytes(np.sort(pairs, axis=0).tobytes())


_STILL = 1e-4
"""Probability that the errors of two attitudes of one direction differ by more than the limit of a static picture."""
_LONGEST_S = 1e5
"""Longest step of one sample, s, over which a gyro is integrated here."""
_STATED, _CHANGED, _LEARNT = 4.0, 2.0, 8.0
"""Numbers of standard deviations. A bias is wrong beyond 4 of its stated ones, of which one of 16,000 is. One that has
been estimated from earlier frames is wrong if it has changed by 2 stated ones and by 8 of those of the estimate."""


class StandstillWatch:
    """The attitude from which the stars have not moved, and how far the gyro has.

    Parameters
    ----------
    noise : GyroNoise
        Stated errors of the gyro.
    """

    def __init__(self, noise: GyroNoise) -> None:
        self.noise = noise
        self.filter: Mekf | None = None
        """The filter when the stars were first where they are, propagated by the gyro alone since."""
        self._quat, self._covariance = np.zeros(4), np.zeros((3, 3))
        self._time_s = self._turn_rad = 0.0

    def forget(self) -> None:
        """Begin again with the next attitude."""
        self.filter = None

    def predict(self, dt: float, gyro_rad_s: FloatArray | None) -> None:
        """Propagate by a step; without a sample of the gyro nothing can be said."""
        if self.filter is None:
            return
        if gyro_rad_s is None or dt > _LONGEST_S:
            self.forget()
            return
        self.filter.predict(dt, gyro_rad_s)
        self._time_s += dt
        self._turn_rad += float(np.linalg.norm(gyro_rad_s)) * dt

    def _is_still(self, quat: FloatArray, covariance: FloatArray) -> bool:
        """Whether an attitude is the one from which the stars have not moved."""
        turn = rotation_between(self._quat, quat)
        return float(turn @ np.linalg.solve(self._covariance + covariance, turn)) < chi_square_limit(3, _STILL)

    def contradiction(self, quat: FloatArray, covariance: FloatArray) -> str:
        """Why an attitude of the stars alone, (4,) with its covariance (3, 3) in camera axes, contradicts the gyro;
        empty if it does not."""
        if self.filter is None or not self._is_still(quat, covariance):
            return ""
        noise, t = self.noise, self._time_s
        drift = (noise.bias_sigma_rad_s * t) ** 2 + noise.rate_random_walk**2 * t**3 / 3.0
        turn = rotation_between(self.filter.quat, quat)
        angle = math.hypot(*turn.tolist())
        if not angle > 0.0:
            return ""
        axis = turn / angle
        own = float(axis @ (self._covariance + covariance) @ axis)
        stated = math.sqrt(own + drift + noise.angle_random_walk**2 * t) + noise.scale_sigma * self._turn_rad
        learnt = math.sqrt(own + float(axis @ self.filter.attitude_covariance @ axis))
        if not (angle > _STATED * stated or (angle > _CHANGED * stated and angle > _LEARNT * learnt)):
            return ""
        return (
            f"the stars were static for {t:.3g} s while the gyro measured {math.degrees(angle):.3g}°, "
            f"{angle / stated:.1f} times its stated error: the picture is old, or the gyro wrong"
        )

    def add(self, mekf: Mekf, quat: FloatArray, covariance: FloatArray) -> None:
        """An attitude of the stars alone that was used, and the filter after it."""
        if self.filter is None or not self._is_still(quat, covariance):
            self.filter, self._quat, self._covariance = mekf.copy(), quat, covariance
            self._time_s = self._turn_rad = 0.0
