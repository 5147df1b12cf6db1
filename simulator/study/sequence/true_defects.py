"""Defective pixels of a device, compared with those that a sensor has mapped."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulator.renderer import Renderer

BoolImage = NDArray[np.bool_]


def true_defects(renderer: Renderer, sigma: float) -> tuple[BoolImage, BoolImage]:
    """Definitely defective pixels, and pixels that may be classified as defective, (H, W).

    By the mean dark signal at the exposure of the scenario: above its median by twice `sigma` times the noise of a
    pixel (including the spread of the normal dark signal), or by half as much. Dead pixels read the offset like empty
    sky, and belong to the second group.
    """
    pattern, camera = renderer.detector.pattern, renderer.camera
    dark = np.broadcast_to(pattern.dark_e_s, (camera.height, camera.width)) * renderer.exposure_s
    middle = float(np.median(dark))
    spread = 1.4826 * float(np.median(np.abs(dark - middle)))
    limit = sigma * math.sqrt(renderer.scenario.detector.read_noise_e**2 + middle + spread**2)
    maybe = dark - middle > 0.5 * limit
    return np.asarray(dark - middle > 2.0 * limit), maybe if pattern.dead is None else maybe | pattern.dead


def compare_defects(renderer: Renderer, mapped: BoolImage, sigma: float) -> dict[str, int]:
    """Numbers of mapped pixels, of definitely defective ones, of those among the mapped, and of mapped sound ones."""
    certain, maybe = true_defects(renderer, sigma)
    return {
        "mapped": int(mapped.sum()),
        "certain": int(certain.sum()),
        "certain_mapped": int(np.sum(certain & mapped)),
        "sound_mapped": int(np.sum(mapped & ~maybe)),
    }
