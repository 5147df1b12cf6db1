"""Centroiders, which measure the positions of star candidates, by name in `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from startracker.centroid.moments import first_moment
from startracker.centroid.psf_fit import least_squares, maximum_likelihood, weighted_moment
from startracker.centroid.result import Centroids
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.settings import CentroidSettings

__all__ = [
    "METHODS",
    "Centroider",
    "Centroids",
    "first_moment",
    "least_squares",
    "maximum_likelihood",
    "weighted_moment",
]

Centroider: TypeAlias = Callable[[Image, Background, Spots, CentroidSettings, float | None], Centroids]
"""Signature of a centroider: image (float32 or uint16), background, spots, settings, gain in electrons per DN or
None."""

METHODS: dict[str, Centroider] = {
    "moment": first_moment,
    "weighted_moment": weighted_moment,
    "least_squares": least_squares,
    "maximum_likelihood": maximum_likelihood,
}
"""Centroiders by name; packages register their own in the entry-point group ``boresight.centroiders``."""


def __dir__() -> list[str]:
    return sorted(__all__)
