"""Thermal change of the focal length since calibration.

    f(T) = f(T_ref) · (1 + α (T − T_ref))

α is the total relative change of the focal length per kelvin, from expansion of the glass and the barrel and the change
of the refractive index: tens of ppm/K uncorrected (an order of magnitude, not from a table), near 0 for athermal
lenses. The principal point and the distortion, which acts on normalised coordinates, do not change.

The sky is rendered with the true camera; the frame has the calibrated one, so that the tracker sees the error.

Validity: a uniform temperature (no gradients), linear in T. Source: D. S. Grey, "Athermalization of optical systems",
J. Opt. Soc. Am. 38 (1948) 542.
"""

from __future__ import annotations

from dataclasses import replace

from startracker.camera import Camera


def true_camera(calibrated: Camera, expansion_ppm_k: float, warmer_k: float) -> Camera:
    """Camera at a temperature `warmer_k` above that of its calibration; the same object if nothing changes."""
    change = expansion_ppm_k * 1e-6 * warmer_k
    if change == 0.0:
        return calibrated
    return replace(calibrated, fx=calibrated.fx * (1.0 + change), fy=calibrated.fy * (1.0 + change))
