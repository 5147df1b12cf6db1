"""Compare startracker/catalog/data/deep_sky.txt with OpenNGC, and write how far each object is from its position there.

python tests/oracle/build_deep_sky_openngc.py     needs pyongc (pip install pyongc; OpenNGC is CC-BY-SA-4.0)

No value of OpenNGC is written, only separations, with the digest of the table that was compared.
"""

import hashlib
import json
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import astropy.units as u
from astropy.coordinates import SkyCoord
from pyongc.ongc import Dso

from startracker.catalog.names import deep_sky_objects

OUT = Path(__file__).parent / "data" / "deep_sky_openngc.json"
NAMES = {"ESO 56-115": "ESO056-115", "M102": "NGC5866"}  # OpenNGC takes M102 for M101


def main():
    separations = {}
    for item in deep_sky_objects():
        entry = Dso(NAMES.get(item.designation, item.designation.replace(" ", "")))
        there = SkyCoord(entry.ra, entry.dec, unit=(u.hourangle, u.deg))
        here = SkyCoord(item.ra_deg, item.dec_deg, unit=u.deg)
        separations[item.designation] = round(float(here.separation(there).arcmin), 2)
    table = files("startracker.catalog") / "data" / "deep_sky.txt"
    content = {
        "pyongc": version("pyongc"),
        "sha256": hashlib.sha256(table.read_bytes()).hexdigest(),
        "separation_arcmin": separations,
    }
    OUT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
