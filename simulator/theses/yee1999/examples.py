"""Worked examples: databases of Cassiopeia (Tables 2.1, 2.2, 3.1, 3.2), the rotation-angle test (Figs. 2.3 to 2.5)."""

from __future__ import annotations

import math

import numpy as np

from simulator.theses.printed import Section, Verdict
from simulator.theses.tables import Values, table_rows, worst
from simulator.theses.yee1999.catalogue import printed_rows, sub_catalog
from simulator.theses.yee1999.fixed_point.formats import ANGLE
from simulator.theses.yee1999.picture import vega
from startracker.identification.arithmetic import FloatArithmetic
from startracker.identification.triad_tables import TriadTables


def cassiopeia() -> Section:
    """Sub-catalogue, separations and enclosed angles of HR 21, 168, 264, 403 and 542."""
    values = {"stars": _sub_catalogue(), "pairs": _separations(), "triads": _enclosed()}
    return Section("Databases of Cassiopeia", table_rows("yee1999/cassiopeia", values))


def _tables() -> TriadTables:
    """Pair database of the coordinates printed in Table 2.1."""
    rows = printed_rows("table_2_1")
    ra_deg = [15.0 * float(row["ra_h"]) for row in rows]
    dec_deg, v_mag = ([float(row[name]) for row in rows] for name in ("dec_deg", "v_mag"))
    return TriadTables.build(FloatArithmetic(), [int(row["hr"]) for row in rows], ra_deg, dec_deg, v_mag, 15.0)


def _sub_catalogue() -> list[Values]:
    stars = sub_catalog(4, 6.0)
    rows = []
    for row in printed_rows("table_2_1"):
        at = int(stars.indices([int(row["hr"])])[0])
        found = [stars.ra_deg[at] / 15.0, stars.dec_deg[at], stars.v_mag[at]]
        rows.append({"hr": row["hr"], "texts": [row["ra_h"], row["dec_deg"], row["v_mag"]], "found": found})
    return rows


def _separations() -> list[Values]:
    tables = _tables()
    degrees = tables.arithmetic.separation_degrees(tables.separation)
    found = {
        (int(tables.id[i]), int(tables.id[j])): d for i, j, d in zip(tables.first, tables.second, degrees, strict=True)
    }
    rows = []
    for at, row in enumerate(printed_rows("table_2_2")):
        pair = (int(row["first"]), int(row["second"]))
        order = "" if list(found)[at] == pair else "; at another position in the sorted list"
        rows.append({"pair": pair, "texts": [row["separation_deg"]], "found": [found[pair]], "order": order})
    return rows


def _enclosed() -> list[Values]:
    tables = _tables()
    index = {int(number): k for k, number in enumerate(tables.id)}
    rows = []
    for real, whole in zip(printed_rows("table_3_1"), printed_rows("table_3_2"), strict=True):
        numbers = [int(real[name]) for name in ("first", "second", "third")]
        stars = (np.array([index[number]]) for number in numbers)
        angles = [float(angle[0]) for angle in tables.arithmetic.catalog_enclosed(tables.sky, *stars)]
        text = [whole[f"angle_{n}"] for n in (1, 2, 3)]
        coded = [int(ANGLE.encode(angle)) for angle in angles]
        off = [abs(int(a) - b) for a, b in zip(text, coded, strict=True)]
        why = ""
        if any(off):
            angle = angles[next(k for k in range(3) if off[k])]
            why = f"; {angle:.6f}° × 64 = {64 * angle:.3f}: the printed value is just below the integer"
        verdicts: list[Verdict] = ["close" if step == 1 else "differs" if step else "exact" for step in off]
        rows.append(
            {
                "name": ", ".join(map(str, numbers)),
                "texts": [real[f"angle_{n}_deg"] for n in (1, 2, 3)],
                "angles": angles,
                "whole": ", ".join(text),
                "coded": ", ".join(map(str, coded)),
                "verdict": worst(verdicts),
                "off": why,
            }
        )
    return rows


_TOLERANCE_DEG = 5.0
_TRIADS = (
    ("Fig. 2.4", (7001, 7139, 7056), ("203.2", "211.0", "29.9", "28.2", "passes")),
    (
        "Fig. 2.5", (1063, 969, 1001),
        ("36.2", "22.2", "222.9", "199.4", "does not pass, as it is a mirror image"),
    ),
)  # fmt: skip
"""Figure, HR numbers, two directions and two rotation angles as printed, and the outcome of the test."""


def rotation_example() -> Section:
    """Directions of the vectors 1-2 and 1-3 in the image and in two catalogue triads, and the rotations between
    them."""
    image = _directions_deg(vega().xy_px[:3])
    directions = [
        {"star": star, "hers": text, "angle": angle}
        for star, text, angle in zip((2, 3), ("173.3", "182.8"), image, strict=True)
    ]
    triads = [_triad(*triad, image) for triad in _TRIADS]
    rows = table_rows("yee1999/rotations", {"image": directions, "triads": triads})
    return Section("Rotation angles of two triads", rows)


def _triad(figure: str, stars: tuple[int, int, int], hers: tuple[str, ...], image: list[float]) -> Values:
    catalog = sub_catalog(4, 6.0)
    sky = catalog.sky_deg[catalog.indices(list(stars))]
    # east is to the left; plain degrees, no cos δ
    theirs = _directions_deg(np.column_stack([-((sky[:, 0] - sky[0, 0] + 180.0) % 360.0 - 180.0), sky[:, 1]]))
    turns = [(there - here) % 360.0 for there, here in zip(theirs, image, strict=True)]
    apart = abs((turns[0] - turns[1] + 180.0) % 360.0 - 180.0)
    passes = apart <= _TOLERANCE_DEG
    image_turn, their_turn = ((b - a + 180.0) % 360.0 - 180.0 for a, b in (image, theirs))
    outcome = "passes" if passes else "does not pass"
    if not passes and image_turn * their_turn < 0.0:
        outcome += ", as it is a mirror image"
    found = {"theirs": theirs, "turns": turns, "apart": apart, "outcome": outcome}
    return {"figure": figure, "stars": stars, "hers": hers, "same": passes == (hers[-1] == "passes")} | found


def _directions_deg(points: np.ndarray) -> list[float]:
    """Directions of the vectors 1-2 and 1-3 of three points (3, 2), degrees from +x towards +y in [0, 360)."""
    return [math.degrees(math.atan2(*(point - points[0])[::-1])) % 360.0 for point in points[1:]]
