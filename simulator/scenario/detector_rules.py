"""Rules of the ``detector`` section: effects that a kind of detector does not have, and contradictory keys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from simulator.scenario.errors import Violation, impossible, unphysical

CCD_ONLY = {
    "antiblooming": (1.0, "charge cannot spill between the pixels of a CMOS detector"),
    "cti_parallel": (0.0, "a CMOS detector transfers no charge between pixels"),
    "cti_serial": (0.0, "a CMOS detector transfers no charge between pixels"),
}
"""Keys of the effects that a CMOS detector does not have: the value that turns them off, and the reason."""
SHUTTER_OF = {"rolling": ("cmos",), "frame_transfer": ("ccd_frame_transfer", "ccd_full_frame")}
"""Kinds of detector that can have a shutter, the usual one first; a full-frame CCD may be read out under light."""


def contradictions(values: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of the detector section.

    Parameters
    ----------
    values : mapping
        Dotted path to value, defaults included, as for the rules of `simulator.scenario.physics`. A missing key raises
        `KeyError`: its value is invalid and already reported.
    """
    if values["detector.kind"] == "cmos":
        for key, (off, why) in CCD_ONLY.items():
            value = values[f"detector.{key}"]
            if value != off:
                message = f"{value:g} with detector.kind: cmos, but {why}; use {off:g} or kind: ccd_full_frame"
                yield impossible(f"detector.{key}", message)

    shutter, kind = values["detector.shutter"], values["detector.kind"]
    if shutter in SHUTTER_OF and kind not in SHUTTER_OF[shutter]:
        has = " and ".join(SHUTTER_OF[shutter])
        message = f"{shutter} with detector.kind: {kind}, which only {has} can have"
        yield impossible("detector.shutter", message + f"; use kind: {SHUTTER_OF[shutter][0]}, or shutter: global")

    for key in ("hot_columns", "dead_columns"):
        if values[f"detector.{key}"] > values["detector.width"]:
            message = f"{values[f'detector.{key}']} is more than the {values['detector.width']} columns of the detector"
            yield impossible(f"detector.{key}", message + "; decrease it")

    # The derivative of S (1 + c₂ s + c₃ s²) must be positive up to the full well, s = 1.
    second, third = values["detector.nonlinearity"]
    signal = np.linspace(0.0, 1.0, 1001)
    if np.any(1.0 + 2.0 * second * signal + 3.0 * third * signal**2 <= 0.0):
        message = (
            f"[{second:g}, {third:g}] makes the signal decrease with charge below the full well; "
            "use smaller values (1 % is 0.01)"
        )
        yield unphysical("detector.nonlinearity", message)


def telegraph_times(values: Mapping[str, Any]) -> Iterator[Violation]:
    """The levels of random telegraph pixels must outlast the exposure; `values` as in `contradictions`."""
    # The detector uses the level at mid-exposure for the whole exposure (`simulator.detector.telegraph`).
    telegraph = {name: values[f"detector.telegraph.{name}"] for name in ("low_s", "high_s")}
    shortest = min(telegraph, key=lambda name: telegraph[name])
    if values["detector.telegraph.pixel_fraction"] > 0 and values["detector.exposure_s"] > 0.1 * telegraph[shortest]:
        message = (
            f"{telegraph[shortest]:g} s is less than ten exposures of {values['detector.exposure_s']:g} s, in which "
            "the level of a pixel is taken as constant; use a longer time"
        )
        yield unphysical(f"detector.telegraph.{shortest}", message)
