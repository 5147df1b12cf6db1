"""Finding star images: background, then candidates by one of `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from startracker.detection.background import Background, as_image, estimate
from startracker.detection.components import find_components
from startracker.detection.defect_map import find_bad_pixels, mask_pixels
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.settings import DetectionSettings

__all__ = [
    "METHODS",
    "Background",
    "Detector",
    "Spots",
    "as_image",
    "estimate",
    "find_bad_pixels",
    "find_components",
    "mask_pixels",
]

Detector: TypeAlias = Callable[[Image, Background, DetectionSettings, float | None], Spots]
"""Signature of a detector: image (float32 or uint16), background, settings, saturation in DN or
None."""

METHODS: dict[str, Detector] = {"components": find_components}
"""Detectors by name; packages add theirs in the entry-point group ``boresight.detectors``, as the detectors of the two
theses are added (`simulator.theses.detectors`)."""


def __dir__() -> list[str]:
    return sorted(__all__)
