"""The Vega image: Tables 4.1 to 4.5 as printed beside what comes out (thesis section 4.2.1)."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from simulator.theses.printed import Row, Section, Verdict, compare
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from simulator.theses.yee1999.picture import Analysis, analyse, vega
from simulator.theses.yee1999.rows import joined
from startracker.identification.triad_votes import COMBINED_ID, combine_separation, match_triads

__all__ = ["attitude_rows", "separation_rows", "vega_tables", "vote_rows"]

VEGA_CENTRE = ("278.45703", "37.24007")
_EDITION = "the 4th edition is not to be had; the 5th with its corrections stands in"


def vega_tables(analysis: Analysis | None = None) -> Section:
    """Databases, separations, triads, votes, centre and residuals of the Vega image."""
    found = analysis or analyse(vega())
    rows = [
        *_databases(found),
        *separation_rows(found, "Table 4.1", "Table 4.14"),
        *_triads(found),
        *vote_rows(found, "Table 4.4"),
        *attitude_rows(found, "Table 4.5", "4.2.1", VEGA_CENTRE),
    ]
    rows.append(_enclosed_test(found))
    from simulator.theses.yee1999.figures import triad_figure, vega_figure

    figures = {"fig_4_4_vega": lambda: vega_figure(found), "table_4_2_rotations": lambda: triad_figure(found)}
    return Section("The Vega image", rows, figures)


def _databases(found: Analysis) -> list[Row]:
    tables = found.match.tables
    triangles = _closed_triangles(tables.first, tables.second, len(tables))
    degrees = tables.arithmetic.separation_degrees(
        np.array([combine_separation(tables.arithmetic, found.picture.scale_deg, 8.0)])
    )
    why = "V ≤ 6.00, Dec 30° to 90°; " + _EDITION
    return [
        compare("4.2", "stars of the sub-catalogue", "1,266", len(found.catalog), why=why),
        compare("4.2", "pairs up to 12°", "33,851", len(tables.separation), why=_EDITION),
        compare(
            "4.2.5",
            "enclosed angles",
            "1,175,901",
            3 * triangles,
            why=f"three angles of each of {triangles:,} triangles with sides up to 12°",
        ),
        compare("4.2.1", "separation of stars that are one, τ = 8", "0.1732", float(degrees[0]), unit="°"),
    ]


def _closed_triangles(first: np.ndarray, second: np.ndarray, stars: int) -> int:
    """Triangles whose three sides are all among the pairs: trace(A³)/6 of the graph they make."""
    from scipy.sparse import coo_array

    link = coo_array((np.ones(len(first), dtype=np.int64), (first, second)), shape=(stars, stars)).tocsr()
    link = link + link.T
    return int((link @ link).multiply(link).sum()) // 6


def separation_rows(found: Analysis, where: str, centroids: str) -> list[Row]:
    """Separations of the image stars and how many catalogue pairs have each (Tables 4.1, 4.6, 4.11)."""
    rows = []
    for row, degrees, count in zip(
        printed_rows(file_of(where)), found.separations_deg, found.match.pair_counts, strict=True
    ):
        name = f"stars {row['star']} and {row['other']}"
        why = f"cos θ = cos χ cos ψ of the centroids of {centroids}"
        rows.append(joined(where, f"separation of {name}", [row["separation_deg"]], [degrees], unit="°", why=why))
        rows.append(compare(where, f"catalogue pairs of {name}", row["pairs"], float(count), why=_EDITION))
    return rows


def _triads(found: Analysis) -> list[Row]:
    printed = printed_rows("table_4_2")
    groups = {key: list(members) for key, members in groupby(printed, key=lambda row: row["group"])}
    rows = [
        compare("Table 4.2", "triads", str(len(printed)), len(found.triads)),
        compare("Table 4.2", "groups", str(len(groups)), len(found.groups)),
    ]
    for key, members in groups.items():
        ours = [row for row in found.triads if str(row["group"]) == key]
        theirs = {tuple(int(row[f"hr_{s}"]) for s in range(1, 6)): row for row in members}
        same = len(theirs.keys() & {tuple(row["hr"]) for row in ours})
        off = max(
            (
                abs(rotation - float(theirs[tuple(row["hr"])][f"rotation_{n}_deg"]))
                for row in ours
                if tuple(row["hr"]) in theirs
                for n, rotation in enumerate(row["rotations_deg"], 1)
            ),
            default=np.inf,
        )
        mean = found.groups[int(key) - 1][1] if int(key) <= len(found.groups) else np.nan
        verdict: Verdict = "exact" if same == len(theirs) == len(ours) and off <= 0.1 else "differs"
        rows.append(
            Row(
                "Table 4.2",
                f"group {key}: triads, mean rotation",
                f"{len(theirs)}, {members[0]['group_mean_deg']}°",
                f"{len(ours)}, {mean:.1f}°",
                verdict,
                f"{same} lists of HR numbers the same, rotations within {off:.2f}°",
            )
        )
    return rows


def vote_rows(found: Analysis, where: str) -> list[Row]:
    """HR numbers that each image star may be, and how often they are named (Tables 4.4, 4.9)."""
    rows = []
    for star, members in groupby(printed_rows(file_of(where)), key=lambda row: row["star"]):
        theirs = [(int(row["hr"]), int(row["frequency"]), row["v_mag"]) for row in members]
        ours = [(vote["hr"], vote["frequency"], f"{vote['v_mag']:.2f}") for vote in found.votes[int(star) - 1]]
        printed, computed = (", ".join(f"{hr}: {n}" for hr, n, _v in votes) for votes in (theirs, ours))
        verdict: Verdict = "exact" if sorted(theirs) == sorted(ours) else "differs"
        why = f"{COMBINED_ID:,} more than the brightest's number: stars that are one" if len(theirs) > 1 else ""
        rows.append(Row(where, f"votes of star {star}", printed, computed, verdict, why))
    return rows


def _enclosed_test(found: Analysis) -> Row:
    """What the enclosed-angle test is worth, which the thesis doubts."""
    match = found.match
    without = match_triads(
        match.tables, found.picture.xy_px, match.scale_deg, replace(match.limits, enclosed_tolerance_deg=None)
    )
    best = without.best()
    same = best is not None and found.found is not None and np.array_equal(best.pairs, found.found.pairs)
    return Row(
        "5.2",
        "triads that the enclosed-angle test excludes",
        "not that many",
        f"{len(without.triads) - len(match.triads)} of {len(without.triads)}",
        "differs",
        f"within {match.limits.enclosed_tolerance_deg:g}°; without it the largest group names "
        + ("the same stars" if same else "other stars"),
    )


def attitude_rows(found: Analysis, where: str, section: str, centre: tuple[str, str]) -> list[Row]:
    """Centre of the image, and the stars' coordinates by its plate constants (Tables 4.5, 4.10)."""
    plate = found.plate
    if plate is None or found.found is None:
        return []
    rows = []
    off = 3600.0 * np.abs(plate.center_deg - [float(text) for text in centre])
    rows.append(
        Row(
            section,
            "RA, Dec of the centre",
            ", ".join(f"{text}°" for text in centre),
            f"{plate.center_deg[0]:.5f}°, {plate.center_deg[1]:.5f}°",
            "exact" if off.max() <= 0.05 else "close",
            f"in {plate.iterations} iterations to 1″; {off[0]:.3f}″ and {off[1]:.3f}″ from the printed",
        )
    )
    computed = plate.sky_deg(found.picture.xy_px[found.found.pairs[:, 0]])
    for k, row in enumerate(printed_rows(file_of(where))):
        at = found.catalog.sky_deg[found.found.pairs[k, 1]]
        for axis, name in enumerate(("ra", "dec")):
            keys = (f"catalog_{name}_deg", f"{name}_deg", f"{name}_difference_deg")
            values = [at[axis], computed[k, axis], abs(plate.residual_deg[k, axis])]
            greatest = max(abs(value - float(row[key])) for key, value in zip(keys, values, strict=True))
            rows.append(
                Row(
                    where,
                    f"HR {row['hr']} {name.upper() if name == 'ra' else 'Dec'}: catalogue, computed, difference",
                    ", ".join(row[key] for key in keys) + "°",
                    ", ".join(f"{value:.5f}" for value in values) + "°",
                    "exact" if greatest <= 2.1e-5 else "close",
                    f"within {greatest:.1e}°; five decimals of catalogue and centroids leave 2e-5°",
                )
            )
    return rows
