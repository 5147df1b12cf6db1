"""Positions of the deep-sky objects against OpenNGC (pyongc 1.2.2, 2026), by build_deep_sky_openngc.py.

Tolerance: 1.2′, as positions are given to a minute of arc and a tenth of a minute of time (0.9′ at the equator, both
rounded), or a tenth of the diameter, as the centres of large objects are a matter of definition.
"""

import hashlib
import json
from importlib.resources import files
from pathlib import Path

from startracker.catalog.names import deep_sky_objects

CHECKED = json.loads((Path(__file__).parent / "data" / "deep_sky_openngc.json").read_text(encoding="utf-8"))


def test_the_table_is_the_one_that_was_compared():
    table = (files("startracker.catalog") / "data" / "deep_sky.txt").read_bytes()
    assert hashlib.sha256(table).hexdigest() == CHECKED["sha256"], "run tests/oracle/build_deep_sky_openngc.py"


def test_positions_agree():
    found = CHECKED["separation_arcmin"]
    assert set(found) == {item.designation for item in deep_sky_objects()}
    far = [
        (item.designation, found[item.designation])
        for item in deep_sky_objects()
        if found[item.designation] > max(1.2, 0.1 * item.diameter_arcmin)
    ]
    assert not far
