"""What kind of detector has which effects: contradictions between the keys of the detector section."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from simulator.scenario.errors import Violation, impossible, unphysical

_CCD_ONLY = {
    "antiblooming": (1.0, "the pixels of a CMOS detector have no common channel along which charge could spill"),
    "cti_parallel": (0.0, "a CMOS detector reads each pixel where it is and transfers no charge"),
    "cti_serial": (0.0, "a CMOS detector reads each pixel where it is and transfers no charge"),
}


_SHUTTER_OF = {"rolling": ("cmos",), "frame_transfer": ("ccd_frame_transfer", "ccd_full_frame")}
"""Kinds that a shutter goes with, the usual one first; a full-frame CCD may be clocked out under light."""


def contradictions(values: Mapping[str, Any]) -> Iterator[Violation]:
    """Rules of the detector that do not hold.

    Parameters
    ----------
    values : mapping
        Dotted path to value, defaults included, as the rules of `simulator.scenario.physics` get them. A key that is
        missing raises `KeyError`, which stands for a value that is wrong in itself.
    """
    if values["detector.kind"] == "cmos":
        for key, (off, why) in _CCD_ONLY.items():
            value = values[f"detector.{key}"]
            if value != off:
                message = f"{value:g} with detector.kind: cmos, but {why}; use {off:g}, or kind: ccd_full_frame"
                yield impossible(f"detector.{key}", message)

    shutter, kind = values["detector.shutter"], values["detector.kind"]
    if shutter in _SHUTTER_OF and kind not in _SHUTTER_OF[shutter]:
        has = " and ".join(_SHUTTER_OF[shutter])
        message = f"{shutter} with detector.kind: {kind}, but only {has} can have such a shutter"
        yield impossible("detector.shutter", message + f"; use kind: {_SHUTTER_OF[shutter][0]}, or shutter: global")

    for key in ("hot_columns", "dead_columns"):
        if values[f"detector.{key}"] > values["detector.width"]:
            message = f"{values[f'detector.{key}']} is more than the {values['detector.width']} columns of the detector"
            yield impossible(f"detector.{key}", message + "; lower it")

    second, third = values["detector.nonlinearity"]
    signal = np.linspace(0.0, 1.0, 1001)
    if np.any(1.0 + 2.0 * second * signal + 3.0 * third * signal**2 <= 0.0):
        message = (
            f"[{second:g}, {third:g}] makes the signal fall where the charge grows, below the full well; "
            "use smaller numbers: a percent is 0.01"
        )
        yield unphysical("detector.nonlinearity", message)
