"""The Vega image: Tables 4.1 to 4.5 as printed and recomputed (section 4.2.1 of the thesis)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from simulator.theses.figures import draw
from simulator.theses.printed import Row, Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from simulator.theses.yee1999.picture import Analysis, analyse, vega
from startracker.attitude import radec_to_direction
from startracker.identification.triad_votes import COMBINED_ID, combine_separation, match_triads

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VEGA_CENTRE = ("278.45703", "37.24007")


def vega_tables(analysis: Analysis | None = None) -> Section:
    """Databases, separations, triads, votes, centre and residuals of the Vega image."""
    found = analysis or analyse(vega())
    rows = [
        *table_rows("yee1999/vega_databases", _database_values(found)),
        *separation_rows(found, "Table 4.1", "Table 4.14"),
        *table_rows("yee1999/vega_triads", _triad_values(found)),
        *vote_rows(found, "Table 4.4"),
        *attitude_rows(found, "Table 4.5", "4.2.1", VEGA_CENTRE),
        *table_rows("yee1999/vega_enclosed", _enclosed_values(found)),
    ]
    return Section("The Vega image", rows, picture_figures(found, "fig_4_4_vega", "table_4_2_rotations"))


def _database_values(found: Analysis) -> Values:
    tables = found.match.tables
    triangles = _closed_triangles(tables.first, tables.second, len(tables))
    combined = combine_separation(tables.arithmetic, found.picture.scale_deg, 8.0)
    return {
        "stars": len(found.catalog),
        "pairs": len(tables.separation),
        "angles": 3 * triangles,
        "triangles": triangles,
        "combined_deg": tables.arithmetic.separation_degrees(np.array([combined]))[0],
    }


def _closed_triangles(first: np.ndarray, second: np.ndarray, stars: int) -> int:
    """Triangles whose three sides are all among the pairs: trace(A³)/6 of their graph."""
    from scipy.sparse import coo_array

    link = coo_array((np.ones(len(first), dtype=np.int64), (first, second)), shape=(stars, stars)).tocsr()
    link = link + link.T
    return int((link @ link).multiply(link).sum()) // 6


def separation_rows(found: Analysis, where: str, centroids: str) -> list[Row]:
    """Separations of the image stars and number of catalogue pairs for each (Tables 4.1, 4.6, 4.11)."""
    pairs = [
        {"star": row["star"], "other": row["other"], "texts": [row["separation_deg"]], "degrees": [degrees],
         "printed": row["pairs"], "count": count}
        for row, degrees, count in zip(
            printed_rows(file_of(where)), found.separations_deg, found.match.pair_counts, strict=True
        )
    ]  # fmt: skip
    return table_rows("yee1999/picture", {"pairs": pairs, "table": where, "centroids": centroids})


def _triad_values(found: Analysis) -> Values:
    printed = printed_rows("table_4_2")
    groups = {int(key): list(members) for key, members in groupby(printed, key=lambda row: row["group"])}
    rows = []
    for group, members in groups.items():
        ours = {tuple(row["hr"]): row["rotations_deg"] for row in found.triads if row["group"] == group}
        theirs = {tuple(int(row[f"hr_{s}"]) for s in range(1, 6)): row for row in members}
        shared = theirs.keys() & ours.keys()
        off = [abs(ours[hr][n] - float(theirs[hr][f"rotation_{n + 1}_deg"])) for hr in shared for n in (0, 1)]
        off_deg = max(off, default=np.inf)
        rows.append(
            {
                "group": group,
                "size": len(theirs),
                "hers_deg": members[0]["group_mean_deg"],
                "found": len(ours),
                "mean_deg": found.groups[group - 1][1] if group <= len(found.groups) else np.nan,
                "shared": len(shared),
                "off_deg": off_deg,
                "same": len(shared) == len(theirs) == len(ours) and off_deg <= 0.1,
            }
        )
    counts = {"hers": len(printed), "ours": len(found.triads)}
    return counts | {"her_groups": len(groups), "our_groups": len(found.groups), "groups": rows}


def vote_rows(found: Analysis, where: str) -> list[Row]:
    """Candidate HR numbers of each image star, and their frequency (Tables 4.4, 4.9)."""
    combined = f"{COMBINED_ID:,} more than the number of the brightest: combined stars"
    rows = []
    for star, members in groupby(printed_rows(file_of(where)), key=lambda row: row["star"]):
        theirs = [(int(row["hr"]), int(row["frequency"]), row["v_mag"]) for row in members]
        ours = [(vote["hr"], vote["frequency"], f"{vote['v_mag']:.2f}") for vote in found.votes[int(star) - 1]]
        printed, computed = (", ".join(f"{hr}: {n}" for hr, n, _v in votes) for votes in (theirs, ours))
        same, multiple = sorted(theirs) == sorted(ours), combined if len(theirs) > 1 else ""
        rows.append({"star": star, "hers": printed, "ours": computed, "same": same, "multiple": multiple})
    return table_rows("yee1999/votes", {"votes": rows, "table": where})


def _enclosed_values(found: Analysis) -> Values:
    """Benefit of the enclosed-angle test, which the thesis doubts."""
    match = found.match
    without = match_triads(
        match.tables, found.picture.xy_px, match.scale_deg, replace(match.limits, enclosed_tolerance_deg=None)
    )
    best = without.best()
    same = best is not None and found.found is not None and np.array_equal(best.pairs, found.found.pairs)
    return {
        "excluded": len(without.triads) - len(match.triads),
        "all": len(without.triads),
        "tolerance_deg": match.limits.enclosed_tolerance_deg,
        "stars": "the same stars" if same else "other stars",
    }


def attitude_rows(found: Analysis, where: str, section: str, centre: tuple[str, str]) -> list[Row]:
    """Centre of the image, and the stars' coordinates by its plate constants (Tables 4.5, 4.10)."""
    plate = found.plate
    if plate is None or found.found is None:
        return []
    off = 3600.0 * np.abs(plate.center_deg - [float(text) for text in centre])
    seen, stars = found.found.pairs.T
    computed, catalog = plate.sky_deg(found.picture.xy_px[seen]), found.catalog.sky_deg[stars]
    rows = []
    for k, row in enumerate(printed_rows(file_of(where))):
        for axis, name in enumerate(("ra", "dec")):
            texts = [row[key] for key in (f"catalog_{name}_deg", f"{name}_deg", f"{name}_difference_deg")]
            values = [catalog[k, axis], computed[k, axis], abs(plate.residual_deg[k, axis])]
            greatest = max(abs(value - float(text)) for text, value in zip(texts, values, strict=True))
            shown = {"hers": ", ".join(texts), "ours": ", ".join(f"{value:.5f}" for value in values)}
            star = {"hr": row["hr"], "axis": ("RA", "Dec")[axis], "greatest": greatest, "same": greatest <= 2.1e-5}
            rows.append(star | shown)
    image = {"section": section, "centre": centre, "center_deg": plate.center_deg, "iterations": plate.iterations}
    near = {"off": off, "near": off.max() <= 0.05}
    return table_rows("yee1999/attitude", image | near | {"table": where, "stars": rows})


def picture_figures(found: Analysis, image: str, rotations: str = "") -> dict[str, Callable[[], Figure]]:
    """An image with its matches and, optionally, the rotations of its triads."""
    plan = "yee1999/vega_tables"
    drawn: dict[str, Callable[[], Figure]] = {image: lambda: draw(f"{plan}/image", _image(found))}
    return drawn | ({rotations: lambda: draw(f"{plan}/rotations", _rotations(found))} if rotations else {})


def _image(found: Analysis) -> Values:
    """Image stars, surrounding catalogue stars and matches, from the centroids."""
    half_px = np.array(found.picture.size_px) / 2.0
    catalog = []
    if found.plate is not None:
        # plate constants map half of the sky: only stars near the centre
        directions = radec_to_direction(*np.radians(found.catalog.sky_deg).T)
        near = np.flatnonzero(directions @ radec_to_direction(*np.radians(found.plate.center_deg)) > 0.8)
        xy = found.plate.image_xy(found.catalog.sky_deg[near])
        inside = (np.abs(xy) <= half_px).all(axis=1)
        size = 4.0 + 7.0 * np.clip(6.5 - found.catalog.v_mag[near[inside]], 0.0, None)
        catalog.append({"xy": xy[inside].T, "size": size})
    names = [f"{star + 1}" if hr is None else f"{star + 1}: HR {hr}" for star, hr in enumerate(found.matches)]
    stars = [{"at": tuple(xy), "name": name} for xy, name in zip(found.picture.xy_px, names, strict=True)]
    ranges = {"x_range": (-half_px[0], half_px[0]), "y_range": (-half_px[1], half_px[1])}
    return {"catalog": catalog, "image": found.picture.xy_px.T, "stars": stars} | ranges


def _rotations(found: Analysis) -> Values:
    """Table 4.2 as a figure: the two rotations of every triad by group, and the largest group."""
    largest = max(range(len(found.groups)), key=lambda g: found.groups[g][0], default=-1)
    triads = [{"x": row["rotations_deg"], "y": [row["group"]] * 2, "group": row["group"] - 1} for row in found.triads]
    groups = [
        {"text": f"{size} triad{'' if size == 1 else 's'}, mean {mean:.1f}°", "at": (mean, group + 1)}
        for group, (size, mean) in enumerate(found.groups)
    ]
    best, others = ([triad for triad in triads if (triad["group"] == largest) == same] for same in (True, False))
    count = len(groups)
    rows = {"rows": range(1, count + 1), "row_range": (0.3, count + 0.9)}
    return rows | {"best": best, "others": others, "groups": groups}
