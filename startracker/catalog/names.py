"""Names of stars, constellation lines, and deep-sky objects.

``Alp1 Cen`` of `bsc5` becomes ``Rigil Kentaurus`` (proper name, IAU Catalog of Star Names) or ``α¹ Cen``.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.stars import StarCatalog
from startracker.files import included_lines

_LETTERS = (
    "Alp=α Bet=β Gam=γ Del=δ Eps=ε Zet=ζ Eta=η The=θ Iot=ι Kap=κ Lam=λ Mu=μ Nu=ν Xi=ξ Omi=ο Pi=π Rho=ρ Sig=σ Tau=τ "
    "Ups=υ Phi=φ Chi=χ Psi=ψ Ome=ω"
)
_GREEK = {name: letter for name, _, letter in (entry.partition("=") for entry in _LETTERS.split())}
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def designation(star_name: str) -> str:
    """Bayer designation with Greek letter and superscript ("α¹ Cen"); Flamsteed numbers ("61 Cyg") are unchanged."""
    words = star_name.split()
    if len(words) != 2:
        return star_name.strip()
    letter = words[0].rstrip("0123456789")
    if letter not in _GREEK:
        return " ".join(words)
    return f"{_GREEK[letter]}{words[0][len(letter) :].translate(_RAISED)} {words[1]}"


def proper_name(star_name: str) -> str:
    """Proper name of a star from its ``bsc5`` name ("Alp CMa" gives "Sirius"); empty if it has none."""
    return proper_names().get(" ".join(star_name.split()), "")


@functools.cache
def proper_names() -> dict[str, str]:
    """Proper names by designation."""
    entries = (
        entry.split("=")
        for line in included_lines("startracker.catalog", "star_names.txt")
        for entry in line.split(";")
    )
    return {star.strip(): name.strip() for star, name in entries}


def constellation_lines(catalog: StarCatalog) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """Constellation lines.

    Returns
    -------
    pairs : int array, shape (L, 2)
        Rows of both ends of each line in the catalogue. Lines to stars that the catalogue lacks are omitted.
    constellation : str array, shape (L,)
        IAU abbreviation.
    """
    row = designation_rows(catalog)
    pairs: list[tuple[int, int]] = []
    names: list[str] = []
    for line in included_lines("startracker.catalog", "constellations.txt"):
        own, chains = line.split(":")
        for chain in chains.split(";"):
            # A star without a constellation belongs to the constellation of its line.
            stars = [star.strip() if " " in star.strip() else f"{star.strip()} {own}" for star in chain.split(",")]
            for one, other in itertools.pairwise(stars):
                if one in row and other in row:
                    pairs.append((row[one], row[other]))
                    names.append(own)
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(names, dtype=np.str_)


def designation_rows(catalog: StarCatalog) -> dict[str, int]:
    """Row of each designation; a Bayer letter without superscript refers to the brightest such star."""
    rows: dict[str, int] = {}
    named = np.flatnonzero(catalog.star_name != "")
    # Brightest first, so that `setdefault` gives a designation to the brightest of its stars.
    for i in named[np.argsort(catalog.v_mag[named], kind="stable")]:
        letter, _, constellation = " ".join(str(catalog.star_name[i]).split()).partition(" ")
        rows.setdefault(f"{letter} {constellation}", int(i))
        # "Alp1 Cen" is also "Alp Cen", but the Flamsteed number of "61 Cyg" is not shortened.
        if not letter.isdigit():
            rows.setdefault(f"{letter.rstrip('0123456789')} {constellation}", int(i))
    return rows


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
    return tuple(_object(line) for line in included_lines("startracker.catalog", "deep_sky.txt"))


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
    # The sign is taken from the text, because −0° 12′ has zero degrees.
    dec_deg = math.copysign(int(match[2]) + int(match[3]) / 60.0, -1.0 if match[1] == "-" else 1.0)
    ra_deg = 15.0 * (hours + minutes / 60.0)
    return DeepSkyObject(designation, other, kind, ra_deg, dec_deg, float(v_mag), float(diameter), constellation, name)
