"""Ecliptic and galactic frames, and their equators on the sky."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray

_OBLIQUITY_RAD = math.radians(84381.406 / 3600.0)
ECLIPTIC = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, math.cos(_OBLIQUITY_RAD), math.sin(_OBLIQUITY_RAD)],
        [0.0, -math.sin(_OBLIQUITY_RAD), math.cos(_OBLIQUITY_RAD)],
    ]
)
"""ICRS → mean ecliptic and equinox of J2000: obliquity 84381.406″ (IAU 2006); the frame bias of 0.02″ is neglected."""

GALACTIC = np.array(
    [
        [-0.0548755604162154, -0.8734370902348850, -0.4838350155487132],
        [0.4941094278755837, -0.4448296299600112, 0.7469822444972189],
        [-0.8676661490190047, -0.1980763734312015, 0.4559837761750669],
    ]
)
"""ICRS → galactic; ESA 1997, *The Hipparcos and Tycho Catalogues*, vol. 1, eq. 1.5.11."""


def equator_of(to_frame: FloatArray, points: int = 721) -> FloatArray:
    """Unit vectors (points, 3) along the equator of a frame, ICRS; rows of `to_frame` are its axes in ICRS."""
    t = np.linspace(0.0, 2.0 * np.pi, points)[:, None]
    return np.asarray(np.cos(t) * to_frame[0] + np.sin(t) * to_frame[1])
