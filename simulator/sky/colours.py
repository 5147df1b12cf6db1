"""Conversion of a catalogue's B−V and spectral type to the coordinates by which a spectrum is chosen."""

from __future__ import annotations

import functools
import math
import re

import numpy as np
from numpy.typing import NDArray

from simulator.sky.library import published_colours
from simulator.sky.spectra import LATE_GIANT
from startracker.core import FloatArray

GIANT_SHARE = (
    *((0.55, 0.0), (0.65, 0.34), (0.75, 0.41), (0.85, 0.78), (0.95, 0.96), (1.05, 0.98)),
    *((1.15, 0.99), (1.55, 1.0)),
)  # (B−V, share)
"""Fraction of giants and subgiants (M_V < 3.5, and < 4 from B−V = 0.8) among the Hipparcos stars brighter than V = 9,
at the centre of bins of 0.1 in B−V; 0 below 0.6, where F stars above the limit are dwarfs or have the colours of
dwarfs. From Hipparcos-2 parallaxes (van Leeuwen 2007)."""

_SHARE_B_V, _SHARE = np.array(GIANT_SHARE).T
_TYPE = re.compile(r"([OBAFGKMCSNRW])(\d(?:\.\d)?)?")
_CLASS = re.compile(r"(?<![IV])(I{1,3}|IV|V)(?![IV])")
_GIANTS = {"I", "II", "III"}
_DWARFS = {"V", "VI"}
_ORDER = "OBAFGKM"


@functools.lru_cache(maxsize=8192)
def parse_type(spectral_type: str) -> tuple[str, float, str]:
    """Letter, subtype and luminosity class of a spectral type in catalogue notation.

    The first type and the first class are used: 'K0IIIbCN-0.5' → ('K', 0.0, 'III'), 'A1Vn' → ('A', 1.0, 'V'),
    'gG9' → ('G', 9.0, 'III'), 'M1-2Ia-Iab' → ('M', 1.0, 'I'), 'F5III-IV' → ('F', 5.0, 'III'). The prefixes of old
    catalogues denote classes: d 'V', sd 'VI', g 'III', c 'I'. Empty or NaN if not given.
    """
    text = spectral_type.strip()
    prefix = re.match(r"(sd|d|g|c)(?=[OBAFGKM])", text)
    found = _TYPE.search(text)
    if found is None:
        return "", math.nan, ""
    subtype = float(found[2]) if found[2] else math.nan
    # The luminosity class follows the type. A class in the suffix takes precedence over the prefix of old catalogues.
    named = _CLASS.search(text, found.end())
    if named is not None:
        luminosity = named[1]
    else:
        luminosity = {"sd": "VI", "d": "V", "g": "III", "c": "I"}[prefix[1]] if prefix else ""
    return found[1], subtype, luminosity


def population_giant_share(b_v: FloatArray) -> FloatArray:
    """Fraction of giants among stars of this B−V with unknown class (`GIANT_SHARE`); 0 where B−V is NaN."""
    return np.asarray(np.where(np.isnan(b_v), 0.0, np.interp(b_v, _SHARE_B_V, _SHARE)))


def spectral_coordinates(b_v: FloatArray, spectral_type: NDArray[np.str_]) -> tuple[FloatArray, FloatArray]:
    """B−V and `giant` of stars for `simulator.sky.spectra.colour_sequence`.

    Parameters
    ----------
    b_v : (N,) array
        Colours; NaN where unknown.
    spectral_type : (N,) array of str
        Types; empty where unknown.

    Returns
    -------
    b_v : (N,) array
        If unknown, the colour of the type (dwarf or giant); NaN if the type is unknown as well.
    giant : (N,) array
        1 for the classes I, II and III, 0 for V and VI, 10 + subtype for M giants; for subgiants (IV) and unknown
        classes the fraction of giants among stars of this colour.
    """
    colour = np.array(b_v, dtype=float)
    share = np.full(len(colour), math.nan)
    # A catalogue has far fewer different types than stars, so each type is parsed once.
    typed = np.flatnonzero(spectral_type != "")
    texts, index = np.unique(np.asarray(spectral_type[typed], dtype=str), return_inverse=True)
    for i, text in enumerate(texts):
        letter, subtype, luminosity = parse_type(str(text))
        if not letter:
            continue
        rows = typed[index == i]
        # M dwarfs are so faint that a catalogue star of type M (or C, S, N, R) without a class is a giant.
        giant = luminosity in _GIANTS or (not luminosity and letter in "MCSNR")
        if giant or luminosity in _DWARFS:
            share[rows] = float(giant)
        if giant and letter == "M" and not math.isnan(subtype):
            share[rows] = min(LATE_GIANT[0] + subtype, LATE_GIANT[1])
        empty = rows[np.isnan(colour[rows])]
        if len(empty):
            colour[empty] = _colour_of_type(letter, subtype, giant)
    return colour, np.where(np.isnan(share), population_giant_share(colour), share)


def _colour_of_type(letter: str, subtype: float, giant: bool) -> float:
    """B−V of a type, interpolated between published types; 5 for a missing subtype. NaN for other letters."""
    if letter not in _ORDER:
        return math.nan
    at = _ORDER.index(letter) * 10 + (5.0 if math.isnan(subtype) else subtype)
    subtypes, colours = _subtypes("giants")
    if not giant or at < subtypes[0]:
        subtypes, colours = _subtypes("dwarfs")
    return float(np.interp(at, subtypes, colours))


@functools.cache
def _subtypes(kind: str) -> tuple[FloatArray, FloatArray]:
    """Published types as numbers, ten per letter, and their B−V."""
    pairs = []
    for name, colours in published_colours(kind).items():
        letter, subtype, _ = parse_type(name)
        pairs.append((_ORDER.index(letter) * 10 + subtype, colours["b_v"]))
    subtypes, b_v = np.array(sorted(pairs)).T
    return subtypes, b_v
