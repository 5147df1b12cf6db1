"""Temperature: the lens is not as long as when it was calibrated.

    f(T) = f(T_ref) · (1 + α (T − T_ref))

α is the whole relative change of the focal length a kelvin: expansion of the glass and of the barrel, and the change of
the refractive index together; tens of ppm/K uncorrected (an order of magnitude, not from a table), near 0 for athermal
lenses. The principal point and
the distortion, which acts on normalised coordinates, stay.

The sky is drawn through the true camera; the frame carries the calibrated one, so that the tracker meets the error.

Validity: an even temperature (no gradients), linear in T. Source: D. S. Grey, "Athermalization of optical systems",
J. Opt. Soc. Am. 38 (1948) 542.
"""

from __future__ import annotations

from dataclasses import replace

from startracker.camera import Camera


def true_camera(calibrated: Camera, expansion_ppm_k: float, warmer_k: float) -> Camera:
    """Camera at a temperature `warmer_k` above that of its calibration; itself where nothing has changed."""
    change = expansion_ppm_k * 1e-6 * warmer_k
    if change == 0.0:
        return calibrated
    return replace(calibrated, fx=calibrated.fx * (1.0 + change), fy=calibrated.fy * (1.0 + change))
