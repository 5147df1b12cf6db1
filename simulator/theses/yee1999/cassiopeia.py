"""Cassiopeia's five stars: the databases that the thesis prints as examples (Tables 2.1, 2.2, 3.1, 3.2)."""

from __future__ import annotations

import numpy as np

from simulator.theses.printed import Row, Section
from simulator.theses.yee1999.catalogue import printed_rows, sub_catalog
from simulator.theses.yee1999.rows import joined, worst
from startracker.fixed_point.formats import ANGLE
from startracker.identification.arithmetic import FloatArithmetic
from startracker.identification.triad_tables import TriadTables

__all__ = ["cassiopeia"]


def cassiopeia() -> Section:
    """Sub-catalogue, separations and enclosed angles of HR 21, 168, 264, 403 and 542."""
    return Section("Databases of Cassiopeia", [*_sub_catalogue(), *_separations(), *_enclosed()])


def _tables() -> TriadTables:
    """The pair database of the coordinates as Table 2.1 prints them."""
    rows = printed_rows("table_2_1")
    ra_deg = [15.0 * float(row["ra_h"]) for row in rows]
    dec_deg, v_mag = ([float(row[name]) for row in rows] for name in ("dec_deg", "v_mag"))
    return TriadTables.build(FloatArithmetic(), [int(row["hr"]) for row in rows], ra_deg, dec_deg, v_mag, 15.0)


def _sub_catalogue() -> list[Row]:
    stars = sub_catalog(4, 6.0)
    rows = []
    for row in printed_rows("table_2_1"):
        at = int(stars.places([int(row["hr"])])[0])
        printed = [row["ra_h"], row["dec_deg"], row["v_mag"]]
        computed = [stars.ra_deg[at] / 15.0, stars.dec_deg[at], stars.v_mag[at]]
        rows.append(joined("Table 2.1", f"HR {row['hr']}: RA [h], Dec [°], V [mag]", printed, computed))
    return rows


def _separations() -> list[Row]:
    tables = _tables()
    degrees = tables.arithmetic.separation_degrees(tables.separation)
    found = {
        (int(tables.id[i]), int(tables.id[j])): d for i, j, d in zip(tables.first, tables.second, degrees, strict=True)
    }
    rows = []
    for place, row in enumerate(printed_rows("table_2_2")):
        pair = (int(row["first"]), int(row["second"]))
        order = "" if list(found)[place] == pair else "; it stands elsewhere in the sorted list"
        rows.append(
            joined(
                "Table 2.2",
                f"separation of HR {pair[0]} and {pair[1]}",
                [row["separation_deg"]],
                [found[pair]],
                unit="°",
                why=f"from Table 2.1's coordinates{order}",
            )
        )
    return rows


def _enclosed() -> list[Row]:
    tables = _tables()
    place = {int(number): k for k, number in enumerate(tables.id)}
    rows, integer_rows = [], []
    for real, whole in zip(printed_rows("table_3_1"), printed_rows("table_3_2"), strict=True):
        numbers = [int(real[name]) for name in ("first", "second", "third")]
        i, j, k = (np.array([place[number]]) for number in numbers)
        angles = [float(angle[0]) for angle in tables.arithmetic.catalog_enclosed(tables.sky, i, j, k)]
        name = "HR " + ", ".join(map(str, numbers))
        printed = [real[f"angle_{n}_deg"] for n in (1, 2, 3)]
        rows.append(joined("Table 3.1", name, printed, angles, unit="°", why="from Table 2.1's coordinates"))
        text = [whole[f"angle_{n}"] for n in (1, 2, 3)]
        encoded = [int(ANGLE.encode(angle)) for angle in angles]
        same = [int(a) == b for a, b in zip(text, encoded, strict=True)]
        why = "truncated to 10.6"
        if not all(same):
            off = angles[same.index(False)]
            why += f"; {off:.6f}° × 64 = {64 * off:.3f}: hers came out just below the whole number"
        verdict = worst(
            [
                "exact" if s else "close" if abs(int(a) - b) <= 1 else "differs"
                for s, a, b in zip(same, text, encoded, strict=True)
            ]
        )
        integer_rows.append(Row("Table 3.2", name, ", ".join(text), ", ".join(map(str, encoded)), verdict, why))
    return rows + integer_rows
