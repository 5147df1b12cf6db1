"""The Deneb and Sadr images: Tables 4.6 to 4.13 as printed and recomputed (sections 4.2.2 and 4.2.3 of the thesis)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import printed_rows
from simulator.theses.yee1999.picture import Analysis, Options, analyse, deneb, sadr, vega
from simulator.theses.yee1999.vega_tables import attitude_rows, picture_figures, separation_rows, vote_rows
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_votes import COMBINED_ID, combine_separation

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
