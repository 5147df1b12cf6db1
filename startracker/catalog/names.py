"""Readable names of stars, and constellation lines.

``Alp1 Cen`` of `bsc5` becomes ``Rigil Kentaurus`` (proper name, IAU Catalog of Star Names) or ``α¹ Cen``.
"""

from __future__ import annotations

import functools
import itertools
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.stars import StarCatalog

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
    entries = (entry.split("=") for line in data_lines("star_names.txt") for entry in line.split(";"))
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
    for line in data_lines("constellations.txt"):
        own, chains = line.split(":")
        for chain in chains.split(";"):
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
    for i in named[np.argsort(catalog.v_mag[named], kind="stable")]:
        letter, _, constellation = " ".join(str(catalog.star_name[i]).split()).partition(" ")
        rows.setdefault(f"{letter} {constellation}", int(i))
        if not letter.isdigit():
            rows.setdefault(f"{letter.rstrip('0123456789')} {constellation}", int(i))
    return rows


def data_lines(file: str) -> list[str]:
    """Lines of a text file of ``catalog/data``, without its comments."""
    text = (files("startracker.catalog") / "data" / file).read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]
