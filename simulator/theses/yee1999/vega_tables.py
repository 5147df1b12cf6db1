"""The Vega, Deneb and Sadr images: Tables 4.1 to 4.13 as printed and recomputed (section 4.2 of the thesis)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from simulator.theses.figures import draw
from simulator.theses.printed import Row, Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from simulator.theses.yee1999.picture import Analysis, Options, analyse, deneb, sadr, vega
from startracker.geometry.attitude import radec_to_direction
from startracker.identification.triad_search import TriadLimits
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


_CENTRE = ("307.90724", "46.43192")
_ROTATION_DEG = 0.11
"""Rotations are printed to 0.1°; the means of a group are those of unprinted values."""


def deneb_tables() -> Section:
    """Nine stars: 96 triads in 36 groups, of which the largest contains all nine."""
    found = analyse(deneb())
    arithmetic = found.match.tables.arithmetic
    close = np.array([combine_separation(arithmetic, found.picture.scale_deg, 8.0)])
    rows = [
        *table_rows("yee1999/deneb", {"combined_deg": arithmetic.separation_degrees(close)[0]}),
        *separation_rows(found, "Table 4.6", "Table 4.15"),
        *table_rows("yee1999/deneb_groups", _group_values(found) | {"largest": _largest_group(found)}),
        *vote_rows(found, "Table 4.9"),
        *attitude_rows(found, "Table 4.10", "4.2.2", _CENTRE),
    ]
    return Section("The Deneb image", rows, picture_figures(found, "fig_4_5_deneb", "table_4_7_rotations"))


def _group_values(found: Analysis) -> Values:
    """Table 4.7: sizes and mean rotations of the groups, independent of their order."""
    printed = printed_rows("table_4_7")
    sizes, means = (np.array(column) for column in zip(*found.groups, strict=True))
    rows = []
    for row in printed:
        off = np.abs((means - float(row["mean_deg"]) + 180.0) % 360.0 - 180.0)
        at = int(np.argmin(off))
        same = sizes[at] == int(row["triads"]) and off[at] <= _ROTATION_DEG
        why = "" if same else "one of the 96 triads differs from ours; they are not listed in the tables"
        rows.append(row | {"size": sizes[at], "nearest_deg": means[at], "same": same, "other": why})
    return {"triads": len(found.triads), "her_groups": len(printed), "our_groups": len(sizes), "groups": rows}


def _largest_group(found: Analysis) -> list[Values]:
    """Table 4.8: the triads of group 1."""
    ours = {tuple(row["hr"]): row["rotations_deg"] for row in found.triads if row["group"] == 1}
    rows = []
    for row in printed_rows("table_4_8"):
        stars = tuple(int(row[f"hr_{k}"]) for k in range(1, 10))
        rotations = [float(row[f"rotation_{n}_deg"]) for n in (1, 2)]
        named, verdict, why = stars, "differs", ""
        if stars in ours:
            verdict = "exact" if np.abs(np.array(ours[stars]) - rotations).max() <= _ROTATION_DEG else "close"
        else:  # a row of four stars: the triad of three of them with its rotations
            named = min(
                (hr for hr in ours if sum(a == b and a > 0 for a, b in zip(hr, stars, strict=True)) == 3),
                key=lambda hr: float(np.abs(np.array(ours[hr]) - rotations).max()),
            )
            why = "this row has four stars, but a triad has three: those with the printed rotations"
        texts = {"hers": _triad(stars, rotations), "ours": _triad(named, ours[named])}
        rows.append({"triad": row["triad"], "verdict": verdict, "four": why} | texts)
    return rows


def _triad(stars: Sequence[int], rotations_deg: Sequence[float]) -> str:
    """HR numbers and two rotations, as a table shows them."""
    return f"{', '.join(str(hr) for hr in stars if hr)}: {rotations_deg[0]:.1f}°, {rotations_deg[1]:.1f}°"


def sadr_tables() -> Section:
    """Three stars, two triads, and no match at a vote number of two."""
    found = analyse(sadr())
    misprint = "31.4° is a misprint for 176.8°, which Table 4.13 prints for the same triad"
    groups = []
    for printed, ours in zip(printed_rows("table_4_12"), found.triads, strict=True):
        hr = [int(printed[f"hr_{k}"]) for k in (1, 2, 3)]
        rotations = [float(printed[f"rotation_{n}_deg"]) for n in (1, 2)]
        off = np.abs(np.array(ours["rotations_deg"]) - rotations)
        same = hr == list(ours["hr"]) and off.max() <= _ROTATION_DEG
        texts = {"hers": _triad(hr, rotations), "ours": _triad(ours["hr"], ours["rotations_deg"])}
        groups.append({"group": printed["group"], "same": same, "misprint": "" if same else misprint} | texts)
    values = {
        "triads": len(found.triads),
        "groups": groups,
        "matched": sum(hr is not None for hr in found.matches),
        "trial_2": [
            {"number": number, "numbers": ", ".join(row[f"hr_{k}"] for k in range(1, 6))}
            for number, row in enumerate(printed_rows("table_4_13"), 1)
        ],
    }
    rows = [*separation_rows(found, "Table 4.11", "Table 4.16"), *table_rows("yee1999/sadr", values)]
    return Section("The Sadr image", rows, picture_figures(found, "fig_4_6_sadr"))


def recommendations() -> Section:
    """Recommendations of section 5.2 for the votes, tested on the three images."""
    tables = {"Vega": "table_4_4", "Deneb": "table_4_9"}
    images = []
    for name, picture in (("Vega", vega()), ("Deneb", deneb()), ("Sadr", sadr())):
        summed = analyse(picture)
        merged = analyse(picture, Options(limits=TriadLimits(reprocess_multiples=True)))
        limits = TriadLimits(vote_number=None)
        scaled = analyse(picture, Options(limits=limits))
        votes = [(vote["hr"], vote["frequency"]) for votes in merged.votes for vote in votes]
        printed = printed_rows(tables[name]) if name in tables else []
        lost = [str(hr) for hr, kept in zip(summed.matches, scaled.matches, strict=True) if hr and hr != kept]
        images.append(
            {
                "name": name,
                "hers": _multiples([(int(row["hr"]), int(row["frequency"])) for row in printed]),
                "merged": _multiples(votes),
                "matches": "the same" if summed.matches == merged.matches else "others",
                "needed": limits.votes_needed(len(picture.xy_px)),
                "stars": len(picture.xy_px),
                "lost": f"HR {', '.join(lost)} is no longer matched" if lost else "the same stars are matched",
            }
        )
    return Section("Votes as recommended", table_rows("yee1999/recommendations", {"images": images}))


def _multiples(votes: Sequence[tuple[int, int]]) -> str:
    """Votes of the multiple stars."""
    return ", ".join(f"{hr}: {frequency}" for hr, frequency in votes if hr > COMBINED_ID)
