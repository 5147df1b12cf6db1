"""Deep-sky objects by name: the Messier objects and bright NGC and IC objects, for annotated pictures."""

from __future__ import annotations

import functools
import math
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.names import data_lines

KINDS = {
    "Gx": "galaxy",
    "OC": "open cluster",
    "GC": "globular cluster",
    "PN": "planetary nebula",
    "Nb": "nebula",
    "CN": "cluster with nebula",
    "SNR": "supernova remnant",
    "As": "asterism, double star or star cloud",
}
"""Kinds of objects by their abbreviation."""


class DeepSkyObject(NamedTuple):
    """An object of the table ``data/deep_sky.txt``."""

    designation: str
    """Messier number, otherwise that of the NGC or IC."""
    other: str
    """NGC or IC number of a Messier object; empty if it has none."""
    kind: str
    """Key of `KINDS`."""
    ra_deg: float
    dec_deg: float
    """ICRS, to about an arcminute."""
    v_mag: float
    diameter_arcmin: float
    """Larger diameter."""
    constellation: str
    """IAU abbreviation."""
    name: str
    """Proper name, such as ``Orion Nebula``; empty if it has none."""

    @property
    def label(self) -> str:
        """Text on a picture: the designation, with the proper name if there is one."""
        return f"{self.designation} {self.name}".strip()


@functools.cache
def deep_sky_objects() -> tuple[DeepSkyObject, ...]:
    """All objects, Messier's first."""
    return tuple(_object(line) for line in data_lines("deep_sky.txt"))


@functools.cache
def deep_sky_directions() -> NDArray[np.float64]:
    """Unit vectors (N, 3), ICRS, of `deep_sky_objects`."""
    ra, dec = np.radians([(item.ra_deg, item.dec_deg) for item in deep_sky_objects()]).T
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)


def _object(line: str) -> DeepSkyObject:
    designation, other, kind, ra, dec, v_mag, diameter, constellation, name = (cell.strip() for cell in line.split(";"))
    hours, minutes = (float(part) for part in ra.split())
    match = re.fullmatch(r"([+-])(\d+) (\d+)", dec)
    if kind not in KINDS or match is None:
        raise ValueError(f"deep_sky.txt: cannot read the line of {designation}")
    dec_deg = math.copysign(int(match[2]) + int(match[3]) / 60.0, -1.0 if match[1] == "-" else 1.0)
    ra_deg = 15.0 * (hours + minutes / 60.0)
    return DeepSkyObject(designation, other, kind, ra_deg, dec_deg, float(v_mag), float(diameter), constellation, name)
