"""Finding star images: background, then candidates by one of `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from startracker.detection.background import Background, as_image, estimate
from startracker.detection.clustering import find_clusters
from startracker.detection.components import find_components
from startracker.detection.defect_map import find_bad_pixels, mask_pixels
from startracker.detection.region_growing import grow_regions
from startracker.detection.round_regions import find_first_regions, find_round_regions
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.settings import DetectionSettings

__all__ = [
    "DETECTORS",
    "METHODS",
    "Background",
    "Detector",
    "Spots",
    "as_image",
    "estimate",
    "find_bad_pixels",
    "find_clusters",
    "find_components",
    "find_first_regions",
    "find_round_regions",
    "grow_regions",
    "mask_pixels",
]

Detector: TypeAlias = Callable[[Image, Background, DetectionSettings, float | None], Spots]
"""Signature of a detector: image (float32 or uint16), background, settings, saturation in DN or
None."""

METHODS: dict[str, Detector] = {
    "components": find_components,
    "region_growing": grow_regions,
    "clustering": find_clusters,
}
"""Detectors by name; packages add theirs in the entry-point group ``boresight.detectors``."""

DETECTORS: dict[str, Detector] = {
    **METHODS,
    "round_regions": find_round_regions,
    "first_regions": find_first_regions,
}
"""`METHODS`, and those with the rules of Greyling 1995 alone, which leave hot pixels and streaks in."""


def __dir__() -> list[str]:
    return sorted(__all__)
