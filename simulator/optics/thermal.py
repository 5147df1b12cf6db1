"""Thermal change of the focal length and of the principal point since calibration.

    f(T) = f(T_ref) · (1 + α (T − T_ref)),   c(T) = c(T_ref) + d (T − T_ref) / pitch

α is the total relative change of the focal length per kelvin, from expansion of the glass and the barrel and the change
of the refractive index: tens of ppm/K uncorrected (an order of magnitude, not from a table), near 0 for athermal
lenses. The distortion, which acts on normalised coordinates, does not change. d is the decentring of the lens relative
to the detector, µm/K along columns and rows: the whole image is displaced, which rotates the measured attitude by d/f.

The sky is rendered with the true camera, but the frame has the calibrated one, so that the change is an error for the
tracker.

The temperature is T = mean + swing · sin(2π t / period), with the time t since the epoch.

Validity: a uniform temperature (no gradients), linear in T. Source: D. S. Grey, "Athermalization of optical systems",
J. Opt. Soc. Am. 38 (1948) 542.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class LensTemperature:
    """Temperature of the lens over time, and its effect on the camera."""

    expansion_ppm_k: float = 0.0
    """Relative change of the focal length per kelvin, 1e-6."""
    decentring_px_k: tuple[float, float] = (0.0, 0.0)
    """Motion of the principal point per kelvin, pixels along columns and rows."""
    warmer_k: float = 0.0
    """Mean temperature above that of the calibration."""
    swing_k: float = 0.0
    """Amplitude of the periodic part."""
    period_s: float = 6000.0
    """Period of the periodic part."""

    def camera_at(self, calibrated: Camera, t_s: float) -> Camera:
        """Camera at a time, seconds after the epoch; the calibrated one if nothing changes."""
        swing_k = self.swing_k * math.sin(2.0 * math.pi * t_s / self.period_s)
        return true_camera(calibrated, self.expansion_ppm_k, self.warmer_k + swing_k, self.decentring_px_k)


def true_camera(
    calibrated: Camera,
    expansion_ppm_k: float,
    warmer_k: float,
    decentring_px_k: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """Camera at a temperature `warmer_k` above its calibration; the same object if nothing changes.

    Parameters
    ----------
    calibrated : Camera
        The camera at the temperature of its calibration.
    expansion_ppm_k : float
        Relative change of the focal length per kelvin, 1e-6.
    warmer_k : float
        Temperature above the temperature of the calibration.
    decentring_px_k : (float, float)
        Motion of the principal point per kelvin, pixels along columns and rows.
    """
    change = expansion_ppm_k * 1e-6 * warmer_k
    dx, dy = (per_k * warmer_k for per_k in decentring_px_k)
    if change == dx == dy == 0.0:
        return calibrated
    longer = 1.0 + change
    return replace(
        calibrated,
        fx=calibrated.fx * longer,
        fy=calibrated.fy * longer,
        cx=calibrated.cx + dx,
        cy=calibrated.cy + dy,
    )
