"""Brightest stars and constellation lines for the sky map of the page."""

from __future__ import annotations

import functools
import json

import numpy as np

from startracker.catalog import load_catalog
from startracker.catalog.names import constellation_lines, designation, proper_name
from startracker.images.star_colours import rgb_of_b_v

__all__ = ["bright_sky"]

_FAINTEST_MAG = 4.2
"""Some 500 stars: the figures of the constellations are recognised, and the map stays light."""
_NAMED_MAG = 2.5


@functools.cache
def bright_sky() -> bytes:
    """Stars brighter than V = 4.2 and the lines of the constellations, as JSON.

    Returns
    -------
    bytes
        ``{"stars": [{"ra_deg", "dec_deg", "magnitude", "colour", "name"}], "lines": [[[ra_deg, dec_deg], …]]}``: ICRS,
        J2000.0; colours as ``#rrggbb`` (sRGB, from B−V), names of the stars brighter than V = 2.5.
    """
    from colour.models import eotf_inverse_sRGB

    catalog = load_catalog("bsc5")
    ra_deg, dec_deg = np.degrees(catalog.ra_rad), np.degrees(catalog.dec_rad)
    rows = np.flatnonzero(catalog.v_mag < _FAINTEST_MAG)
    rows = rows[np.argsort(catalog.v_mag[rows], kind="stable")]
    encoded = eotf_inverse_sRGB(rgb_of_b_v(catalog.b_v[rows]))
    stars = [
        {
            "ra_deg": round(float(ra_deg[row]), 3),
            "dec_deg": round(float(dec_deg[row]), 3),
            "magnitude": round(float(catalog.v_mag[row]), 2),
            "colour": "#" + "".join(f"{round(255 * value):02x}" for value in colour),
            "name": _name(str(catalog.star_name[row])) if catalog.v_mag[row] < _NAMED_MAG else "",
        }
        for row, colour in zip(rows, encoded, strict=True)
    ]
    pairs, _ = constellation_lines(catalog)
    lines = [[[round(float(ra_deg[row]), 2), round(float(dec_deg[row]), 2)] for row in pair] for pair in pairs]
    return json.dumps({"stars": stars, "lines": lines}, separators=(",", ":")).encode()


def _name(star_name: str) -> str:
    return proper_name(star_name) or designation(star_name)
