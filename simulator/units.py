"""Units by the ending of a name: of scenario keys, and of columns of results."""

from __future__ import annotations

from typing import NamedTuple


class Unit(NamedTuple):
    """A unit."""

    words: str
    """Text for display."""
    astropy: str | None
    """Name of the unit in ``astropy.units``; None if it has no such unit."""


UNITS = {
    "deg": Unit("degrees", "deg"),
    "deg2": Unit("square degrees", "deg2"),
    "deg_s": Unit("degrees/s", "deg/s"),
    "deg_s2": Unit("degrees/s²", "deg/s2"),
    "deg_s_sqrt_s": Unit("degrees/s/√s", "deg/s(3/2)"),
    "deg_h": Unit("degrees/h", "deg/h"),
    "deg_sqrt_h": Unit("degrees/√h", "deg/h(1/2)"),
    "arcsec": Unit("arcseconds", "arcsec"),
    "mas": Unit("milliarcseconds", "mas"),
    "mas_yr": Unit("milliarcseconds/yr", "mas/yr"),
    "km": Unit("km", "km"),
    "km_s": Unit("km/s", "km/s"),
    "mm": Unit("mm", "mm"),
    "um": Unit("µm", "um"),
    "um_k": Unit("µm/K", "um/K"),
    "nm": Unit("nm", "nm"),
    "px": Unit("pixels", "pix"),
    "days": Unit("days", "d"),
    "h": Unit("hours", "h"),
    "s": Unit("s", "s"),
    "ms": Unit("ms", "ms"),
    "us": Unit("µs", "us"),
    "years": Unit("years", "yr"),
    "cm2_s": Unit("1/cm²/s", "1/(cm2 s)"),
    "hz": Unit("Hz", "Hz"),
    "c": Unit("°C", "deg_C"),
    "ppm_k": Unit("ppm/K", None),
    "ff": Unit("fF", "fF"),
    "e": Unit("electrons", "electron"),
    "e_s": Unit("electrons/s", "electron/s"),
    "e_per_dn": Unit("electrons/DN", "electron/adu"),
    "per_krad_e_s": Unit("electrons/s/krad", None),
    "dn": Unit("DN", "adu"),
    "bits": Unit("bits", "bit"),
    "mag": Unit("magnitudes", "mag"),
    "s10": Unit("10th-magnitude stars per square degree", None),
}
"""Unit by ending, without the underscore."""


def unit_suffix(name: str) -> str:
    """The longest ending of a name, after its first underscore, that states a unit; empty if none does."""
    # Endings are tried from the longest, so that ``rate_deg_s`` is deg/s and not s.
    ending = name.partition("_")[2]
    while ending and ending not in UNITS:
        ending = ending.partition("_")[2]
    return ending
