"""Terms of ECSS-E-ST-60-20C used in a datasheet, what is measured for each, and how far the standard was read."""

from __future__ import annotations

from typing import NamedTuple

STANDARD = (
    "The terms are those of ECSS-E-ST-60-20C, Star sensor terminology and performance specification. The current "
    "revision is Rev.2 (15 May 2019). Definitions marked 'read' were taken from public extracts: clauses 3.2.8.2 to "
    "3.2.8.4 of Rev.1 (15 November 2008) and the bias in ECSS's glossary of Rev.2. All others are used as the "
    "literature on star trackers quotes them, and are marked 'second hand'. This page claims no conformance."
)
"""What the words of a datasheet rest on."""


class Term(NamedTuple):
    """A class of errors."""

    title: str
    meaning: str
    """What the class is."""
    method: str
    """How it is measured."""
    interpretation: str
    """Statistical interpretation."""
    source: str
    """Where its definition was read."""


INTERPRETATIONS = {
    "temporal": "fraction of the time, in one field and with one device",
    "ensemble": "fraction of the fields of the mission (or of units), at any time",
    "mixed": "fraction of random pairs of a field and a time",
}
"""Statistical interpretations of ECSS-E-ST-60-10C (15 November 2008), second hand."""

TERMS = {
    "bias": Term(
        "Bias",
        "constant error of the boresight reference frame after calibration",
        "mean over all frames of the scans of all fields",
        "ensemble",
        "read: Rev.1, 3.2.8.2; Rev.2, glossary",
    ),
    "thermo_elastic": Term(
        "Thermo-elastic error",
        "change of the bias with the temperature",
        "mean difference of the same trials at two temperatures of the lens",
        "temporal",
        "second hand",
    ),
    "fov_spatial": Term(
        "FOV spatial error",
        "repeatable error with spatial periods from a few pixels to the whole field",
        "common to passes over a field with other pixels and other positions of the stars within them",
        "mixed",
        "read: Rev.1, 3.2.8.3, where the period is the supplier's choice",
    ),
    "pixel_spatial": Term(
        "Pixel spatial error",
        "repeatable error by the position within the pixels: uneven pixels and interpolation",
        "common to two passes with the same pixels, without the FOV spatial error",
        "mixed",
        "read: Rev.1, 3.2.8.4",
    ),
    "temporal_noise": Term(
        "Temporal noise (NEA)",
        "error that differs between frames of the same field with the same device",
        "difference of two passes with the same pixels, divided by √2",
        "mixed",
        "second hand",
    ),
    "rate": Term(
        "Rate error",
        "error that depends on the angular rate",
        "frames at given rates about axes across the boresight",
        "mixed",
        "second hand",
    ),
    "aberration": Term(
        "Residual of the aberration",
        "error of the correction of the aberration of light",
        "directions of the simulated sky without light deflection against those that the tracker computes",
        "mixed",
        "second hand",
    ),
    "measurement_error": Term(
        "Measurement error",
        "error of the whole, in the conditions of the mission",
        "correct attitudes at random times and with random errors of pointing",
        "mixed",
        "second hand",
    ),
}
"""Classes by name in ``datasheet.json``."""
