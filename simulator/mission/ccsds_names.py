"""Names of centres and reference frames in messages of CCSDS (registries of SANA; 502.0-B-2, annex A), and the names
that this package uses for them."""

from __future__ import annotations

import re

from simulator.mission.ccsds import Item
from simulator.mission.trajectory import BARYCENTRE, CENTRES
from startracker.errors import InputError

FRAMES = {
    "ICRF": "icrf",
    "GCRF": "icrf",
    "EME2000": "eme2000",
    "J2000": "eme2000",
    "MOD": "mean_of_date",
    "TOD": "equator_of_date",
    "TEME": "teme",
    "TEMEOFDATE": "teme",
    "ITRF": "itrf",
    "TDR": "itrf",
    "GTOD": "itrf",
    "TIRS": "itrf",
}
"""Supported reference frames and their names in `simulator.mission.frames.to_frame`. The Earth-fixed frames TDR, GTOD
and TIRS differ from ITRF by polar motion, which is neglected."""
OF_EPOCH = {"MOE": "mean_of_date", "TOE": "equator_of_date", "TEMEOFEPOCH": "teme"}
"""Frames at a fixed date, which the message states as REF_FRAME_EPOCH."""
_REALISATION = re.compile(r"(ICRF|GCRF|ITRF)[-_ ]?\d{1,4}")
"""Realisations, such as ``ITRF2014``, ``ITRF-97`` and ``ICRF3``."""

_BARYCENTRES = {
    "SOLAR SYSTEM": BARYCENTRE,
    "EARTH MOON": "Earth-Moon barycentre",
    "EARTH": "Earth-Moon barycentre",
    "PLUTO": "Pluto barycentre",
    **{name.upper(): name for name in ("Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune")},
}
_CENTRES = {
    **{name.upper(): name for name in CENTRES if "barycentre" not in name},
    **{f"{name} BARYCENTER": centre for name, centre in _BARYCENTRES.items()},
    "SSB": BARYCENTRE,
    "EMB": "Earth-Moon barycentre",
}


def centre_of(item: Item) -> str:
    """One of `simulator.mission.trajectory.CENTRES` by the value of CENTER_NAME; `InputError` for any other."""
    # Messages write the names with spaces, hyphens or underscores, and in British or American spelling.
    name = " ".join(re.sub("[-_]", " ", item.value.upper()).split()).replace("BARYCENTRE", "BARYCENTER")
    if name not in _CENTRES:
        raise InputError(f"{item.position}: centre {item.value} is not supported; use {', '.join(CENTRES)}")
    return _CENTRES[name]


def centre_name(centre: str) -> str:
    """Value of CENTER_NAME for a centre. The centres of the outer planets are the barycentres of their systems."""
    if centre == "Earth-Moon barycentre":
        return "EARTH-MOON BARYCENTER"
    outer = ("Jupiter", "Saturn", "Uranus", "Neptune")
    return f"{centre.upper()} BARYCENTER" if centre in outer else centre.upper().replace("BARYCENTRE", "BARYCENTER")


def named_frame(name: str) -> str:
    """Name of a reference frame in `to_frame`; empty for a frame that is not supported or needs a date."""
    found = name.upper().strip()
    if match := _REALISATION.fullmatch(found):
        found = match[1]
    return FRAMES.get(found.removesuffix("_EARTH"), "")


def frame_of(item: Item, *, has_epoch: bool) -> str:
    """Name in `to_frame` of the value of REF_FRAME.

    Raises
    ------
    InputError
        For a frame that is not supported, or one that needs a date if the message does not have it (`has_epoch`).
    """
    of_epoch = OF_EPOCH.get(item.value.upper().strip().removesuffix("_EARTH"), "")
    if of_epoch and not has_epoch:
        raise InputError(f"{item.position}: frame {item.value} needs REF_FRAME_EPOCH, the date of its axes")
    frame = of_epoch or named_frame(item.value)
    if not frame:
        raise InputError(f"{item.position}: frame {item.value} is not supported; use {', '.join(FRAMES)}")
    return frame
