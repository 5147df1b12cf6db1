"""The Deneb and Sadr images: Tables 4.6 to 4.13 as printed beside what comes out (thesis sections 4.2.2 and 4.2.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulator.theses.printed import Row, Section, Verdict, compare
from simulator.theses.yee1999.catalogue import printed_rows
from simulator.theses.yee1999.figures import triad_figure, vega_figure
from simulator.theses.yee1999.picture import Analysis, Options, analyse, deneb, sadr, vega
from simulator.theses.yee1999.vega_tables import attitude_rows, separation_rows, vote_rows
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_votes import COMBINED_ID, combine_separation

__all__ = ["deneb_tables", "recommendations", "sadr_tables"]

_CENTRE = ("307.90724", "46.43192")
_ROTATION_DEG = 0.11
"""Rotations are printed to 0.1°; the means of a group are of values that are not printed."""


def deneb_tables() -> Section:
    """Nine stars: 96 triads in 36 groups, of which the largest names all nine."""
    found = analyse(deneb())
    arithmetic = found.match.tables.arithmetic
    close = np.array([combine_separation(arithmetic, found.picture.scale_deg, 8.0)])
    rows = [
        compare(
            "4.2.2", "separation of stars that are one", "0.1726", arithmetic.separation_degrees(close)[0], unit="°"
        ),
        *separation_rows(found, "Table 4.6", "Table 4.15"),
        *_groups(found),
        *_largest_group(found),
        *vote_rows(found, "Table 4.9"),
        *attitude_rows(found, "Table 4.10", "4.2.2", _CENTRE),
    ]
    figures = {"fig_4_5_deneb": lambda: vega_figure(found), "table_4_7_rotations": lambda: triad_figure(found)}
    return Section("The Deneb image", rows, figures)


def _groups(found: Analysis) -> list[Row]:
    """Table 4.7: sizes and mean rotations of the groups, whatever their order."""
    printed = printed_rows("table_4_7")
    rows = [
        compare("4.2.2", "triads", "96", len(found.triads)),
        compare("Table 4.7", "groups", str(len(printed)), len(found.groups)),
    ]
    sizes = np.array([size for size, _ in found.groups])
    means = np.array([mean for _, mean in found.groups])
    for row in printed:
        off = np.abs((means - float(row["mean_deg"]) + 180.0) % 360.0 - 180.0)
        nearest = int(np.argmin(off))
        size, mean = int(sizes[nearest]), float(means[nearest])
        same = size == int(row["triads"]) and off[nearest] <= _ROTATION_DEG
        verdict: Verdict = "exact" if same else "differs"
        why = "" if same else "one triad fewer and one more than ours among the 96, which her tables do not list"
        rows.append(
            Row(
                "Table 4.7",
                f"group {row['group']}: triads, mean rotation",
                f"{row['triads']}, {row['mean_deg']}°",
                f"{size}, {mean:.1f}°",
                verdict,
                why,
            )
        )
    return rows


def _largest_group(found: Analysis) -> list[Row]:
    """Table 4.8: the triads of group 1."""
    ours = {tuple(row["hr"]): row["rotations_deg"] for row in found.triads if row["group"] == 1}
    rows = []
    for row in printed_rows("table_4_8"):
        stars = tuple(int(row[f"hr_{k}"]) for k in range(1, 10))
        rotations = [float(row[f"rotation_{n}_deg"]) for n in (1, 2)]
        named = ", ".join(f"{hr}" for hr in stars if hr)
        verdict: Verdict = "differs"
        why = ""
        if stars in ours:
            off = np.abs(np.array(ours[stars]) - rotations).max()
            verdict = "exact" if off <= _ROTATION_DEG else "close"
            computed = f"{named}: {ours[stars][0]:.1f}°, {ours[stars][1]:.1f}°"
        else:  # a row of four stars: the triad of three of them that has its rotations
            three = min(
                (hr for hr in ours if sum(a == b and a > 0 for a, b in zip(hr, stars, strict=True)) == 3),
                key=lambda hr: float(np.abs(np.array(ours[hr]) - rotations).max()),
            )
            computed = f"{', '.join(str(n) for n in three if n)}: {ours[three][0]:.1f}°, {ours[three][1]:.1f}°"
            why = "four stars stand in this row, and a triad has three: those with the rotations printed"
        text = f"{named}: {rotations[0]:.1f}°, {rotations[1]:.1f}°"
        rows.append(Row("Table 4.8", f"triad {row['triad']} of group 1", text, computed, verdict, why))
    return rows


def sadr_tables() -> Section:
    """Three stars, two triads, and no match at a vote number of two."""
    found = analyse(sadr())
    rows = separation_rows(found, "Table 4.11", "Table 4.16")
    rows.append(compare("4.2.3", "triads", "2", len(found.triads)))
    for printed, ours in zip(printed_rows("table_4_12"), found.triads, strict=True):
        hr = tuple(int(printed[f"hr_{k}"]) for k in (1, 2, 3))
        rotations = [float(printed[f"rotation_{n}_deg"]) for n in (1, 2)]
        off = np.abs(np.array(ours["rotations_deg"]) - rotations)
        same = hr == tuple(ours["hr"]) and off.max() <= _ROTATION_DEG
        rows.append(
            Row(
                "Table 4.12",
                f"triad of group {printed['group']}",
                f"{', '.join(map(str, hr))}: {rotations[0]:.1f}°, {rotations[1]:.1f}°",
                f"{', '.join(map(str, ours['hr']))}: {ours['rotations_deg'][0]:.1f}°, {ours['rotations_deg'][1]:.1f}°",
                "exact" if same else "differs",
                "" if same else "31.4° is a misprint for 176.8°, which Table 4.13 prints for the same triad",
            )
        )
    matched = sum(hr is not None for hr in found.matches)
    rows.append(compare("4.2.3", "stars matched at a vote number of 2", "0", matched))
    rows += [
        Row(
            "Table 4.13",
            f"triad {number} of trial 2",
            ", ".join(row[f"hr_{k}"] for k in range(1, 6)),
            "–",
            "input missing",
            "the centroids of image stars 4 and 5, of 7 and 8 pixels, are not printed",
        )
        for number, row in enumerate(printed_rows("table_4_13"), 1)
    ]
    return Section("The Sadr image", rows, {"fig_4_6_sadr": lambda: vega_figure(found)})


def recommendations() -> Section:
    """What section 5.2 recommends for the votes, tried on the three images."""
    rows = []
    for name, picture in (("Vega", vega()), ("Deneb", deneb()), ("Sadr", sadr())):
        summed = analyse(picture)
        merged = analyse(picture, replace(Options(), limits=TriadLimits(reprocess_multiples=True)))
        counted = {
            vote["hr"]: vote["frequency"] for votes in merged.votes for vote in votes if vote["hr"] > COMBINED_ID
        }
        if counted:
            table = {"Vega": "table_4_4", "Deneb": "table_4_9"}[name]
            printed = [(row["hr"], row["frequency"]) for row in printed_rows(table) if int(row["hr"]) > COMBINED_ID]
            rows.append(
                Row(
                    "5.2",
                    f"{name}: votes of multiple stars, triads reprocessed",
                    ", ".join(f"{hr}: {n}" for hr, n in printed),
                    ", ".join(f"{hr}: {n}" for hr, n in counted.items()),
                    "open",
                    "printed is the sum over the members, computed counts each triad once; the matches are "
                    + ("the same" if summed.matches == merged.matches else "others"),
                )
            )
        limits = TriadLimits(vote_number=None)
        scaled = analyse(picture, replace(Options(), limits=limits))
        lost = [str(hr) for hr, kept in zip(summed.matches, scaled.matches, strict=True) if hr and hr != kept]
        stars = len(picture.xy_px)
        rows.append(
            Row(
                "5.2",
                f"{name}: vote number by the number of image stars",
                "2 for any number",
                f"{limits.votes_needed(stars)} for {stars} stars",
                "open",
                f"HR {', '.join(lost)} is matched no longer" if lost else "the same stars are matched",
            )
        )
    return Section("Votes as recommended", rows)
