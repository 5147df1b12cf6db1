"""The guide-star database of Greyling 1995, section 5.2.1: stars, lines between them, and zones along the path."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.printed import Row, Section, compare, new_figure
from startracker.attitude import radec_to_direction
from startracker.catalog import StarCatalog, load_catalog
from startracker.catalog.guide import RESOLVED_PX, PairList

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["guide_stars", "lines", "section", "zone", "zone_counts"]

FloatArray = NDArray[np.float64]

BORESIGHT_DEC_DEG = 8.6
FIELD_DEG, SIDE_PX = 10.0, 512
BAND_DEG = 9.8
"""Half width in declination of the band about the path: fitted to Table 5.1; the thesis does not give it."""

CLOSEST_DEG, SHORTEST_DEG, LONGEST_DEG = 0.039, 0.8, 14.14
"""R_MinA, R_min and R_max."""

TABLE_5_1 = {5.0: ("243", "8316"), 6.0: ("767", "16493"), 6.5: ("1248", "32290")}
"""Magnitude to the printed numbers of stars and lines."""

ZONES, ZONE_DAYS = 12, 30
DENSEST_ZONE = 3


def guide_stars(
    magnitude_limit: float,
    band_deg: float = BAND_DEG,
    closest_deg: float = CLOSEST_DEG,
    dec_deg: float = BORESIGHT_DEC_DEG,
) -> StarCatalog:
    """Guide stars by the thesis' rule, sorted by right ascension.

    Parameters
    ----------
    magnitude_limit : float
        Faintest V.
    band_deg, dec_deg : float
        Stars within `band_deg` of the declination `dec_deg`.
    closest_deg : float
        Of two stars closer than this the dimmer is left out (Fig. 5.3); 0: none. The tracker's own database joins
        them (`startracker.catalog.merge_doubles`).
    """
    catalog = load_catalog("bsc5").brighter_than(magnitude_limit)
    catalog = catalog.select(np.flatnonzero(np.abs(np.degrees(catalog.dec_rad) - dec_deg) <= band_deg))
    catalog = catalog.select(np.argsort(catalog.ra_rad, kind="stable"))
    if closest_deg == 0.0:
        return catalog
    chord = 2.0 * math.sin(math.radians(closest_deg) / 2.0)
    pairs = cKDTree(_directions(catalog)).query_pairs(chord, output_type="ndarray")
    dimmer = np.where(catalog.v_mag[pairs[:, 0]] > catalog.v_mag[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    keep = np.ones(len(catalog), dtype=bool)
    keep[dimmer] = False
    return catalog.select(keep)


def lines(catalog: StarCatalog, shortest_deg: float = SHORTEST_DEG, longest_deg: float = LONGEST_DEG) -> PairList:
    """Lines between guide stars: pairs with a separation from `shortest_deg` to `longest_deg`."""
    everyone = np.arange(len(catalog), dtype=np.int64)
    return PairList.of(_directions(catalog), everyone, math.radians(longest_deg), math.radians(shortest_deg))


def zone(catalog: StarCatalog, ra_deg: float, width_deg: float = 46.0, height_deg: float = 16.0) -> StarCatalog:
    """Stars of the zone that starts at `ra_deg`, `width_deg` long and `height_deg` high about the path."""
    along = (np.degrees(catalog.ra_rad) - ra_deg) % 360.0 < width_deg
    return catalog.select(along & (np.abs(np.degrees(catalog.dec_rad) - BORESIGHT_DEC_DEG) <= 0.5 * height_deg))


def zone_size_deg(
    field_deg: float = 14.0, days: int = ZONE_DAYS, day_deg: float = 1.0, sensors_deg: float = 1.0
) -> tuple[float, float]:
    """Length and height of a zone (eq. 5.5): field + days × daily motion + twice the other sensors' accuracy."""
    return field_deg + days * day_deg + 2.0 * sensors_deg, field_deg + 2.0 * sensors_deg


def zone_counts(magnitude_limit: float = 6.5, zones: int = ZONES) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stars and lines of each zone; zone k starts at right ascension 360°(k − 1)/zones."""
    catalog = guide_stars(magnitude_limit)
    width, height = zone_size_deg()
    parts = [zone(catalog, 360.0 / zones * k, width, height) for k in range(zones)]
    return np.array([len(part) for part in parts]), np.array([len(lines(part)) for part in parts])


def _directions(catalog: StarCatalog) -> FloatArray:
    return radec_to_direction(catalog.ra_rad, catalog.dec_rad)


def section() -> Section:
    """Section 5.2.1: rows, Table 5.1 and Figs. 5.2, 5.4 and 5.5."""
    figures: dict[str, Callable[[], Figure]] = {
        "fig_5_2_lines": _lines_figure,
        "fig_5_4_zones": _zones_figure,
        "fig_5_5_zone_stars": partial(_zone_stars_figure, 6.5),
    }
    return Section(
        "Chapter 5.2: guide stars", [*_limit_rows(), *_table_rows(), *_storage_rows(), *_zone_rows()], figures
    )


def _limit_rows() -> list[Row]:
    n = 133
    possible = n * (n - 1) // 2
    return [
        compare("eq. 5.1", "closest resolved stars", "0.039", RESOLVED_PX / SIDE_PX * FIELD_DEG, unit="°"),
        Row("§ 5.2.1", "the same, in the selection of guide stars", "3 arc seconds",
            f"{3600.0 * RESOLVED_PX / SIDE_PX * FIELD_DEG:.0f} arc seconds", "differs", "by its own eq. 5.1"),
        compare("§ 5.2.1", "longest separation in the field", "14.1414", math.hypot(FIELD_DEG, FIELD_DEG), unit="°",
                why="10 √2 = 14.1421"),
        compare("eq. 5.2", "lines between 133 stars", "8778", possible),
        Row("§ 5.2.1", "2682 lines instead of 8778", "about 30 % less", f"{100 * (1 - 2682 / possible):.1f} % less",
            "differs", f"2682 is {100 * 2682 / possible:.1f} % of 8778: less by the rest"),
    ]  # fmt: skip


def _table_rows() -> list[Row]:
    rows = []
    for limit, (stars, pairs) in TABLE_5_1.items():
        catalog = guide_stars(limit)
        n, printed = len(catalog), int(stars)
        share = 200 * int(pairs) / (printed * (printed - 1))
        rows.append(
            compare(
                "Table 5.1", f"guide stars, V ≤ {limit:g}", stars, n,
                why=f"Bright Star Catalogue, declination {BORESIGHT_DEC_DEG}° ± {BAND_DEG}° (fitted), dimmer "
                f"ones of pairs closer than {CLOSEST_DEG}° left out",
            )
        )  # fmt: skip
        rows.append(
            compare(
                "Table 5.1", f"lines, V ≤ {limit:g}", pairs, len(lines(catalog)),
                why=f"{SHORTEST_DEG}° to {LONGEST_DEG}°; printed {share:.1f} % of all pairs of its stars, here "
                f"{200 * len(lines(catalog)) / (n * (n - 1)):.1f} %: the share "
                "cannot fall as stars join, so the printed ratios contradict n²",
            )
        )  # fmt: skip
    everyone = len(guide_stars(6.5, closest_deg=0.0))
    without = len(lines(guide_stars(6.5, closest_deg=0.0)))
    less = 100.0 * (1.0 - len(lines(guide_stars(6.5))) / without)
    rows.append(
        compare("§ 5.2.1", "lines saved by leaving out close stars", "5", less, unit="%", form=".1f",
                why=f"{everyone - len(guide_stars(6.5))} of {everyone} stars left out")
    )  # fmt: skip
    return rows


def _storage_rows() -> list[Row]:
    stars, pairs = 1248, 32290
    return [
        Row(
            "§ 5.2.1", "storage of 1248 stars and 32290 lines", "37282 bytes", f"{4 * stars + 4 * pairs} bytes",
            "exact" if 4 * stars + 4 * pairs == 37282 else "differs",
            f"37282 = 4 × 1248 + 32290 = {4 * stars + pairs}: two 16-bit coordinates a star but one byte a line, which "
            "cannot hold two star numbers up to 1248; nor do 360° × 1000 go into 16 bits",
        )
    ]  # fmt: skip


def _zone_rows() -> list[Row]:
    width, height = zone_size_deg()
    stars, pairs = zone_counts()
    everywhere = len(guide_stars(6.5))
    densest = int(np.argmax(stars))
    return [
        Row("eq. 5.5", "zone", "46° × 16°, 736 square degrees",
            f"{width:g}° × {height:g}°, {width * height:g} square degrees", "exact"),
        compare("§ 5.2.1", "zones of a year", "12", 365.2422 / ZONE_DAYS, form=".2f",
                why="30 days each; the boresight moves 0.9856° a day"),
        compare("Fig. 5.5", "zone with most stars", str(DENSEST_ZONE), densest + 1,
                why="zone 1 starts at 0 h; RA 60° to 106°, the Milky Way from Taurus to Gemini"),
        compare("Fig. 5.5", "its stars, V ≤ 6.5", "159", float(stars[densest]), form=".0f",
                why=f"159 is the mean number in 46° of the whole band of ±{BAND_DEG}°, {everywhere} × 46/360 = "
                f"{everywhere * width / 360.0:.1f}; the mean zone of 46° × 16° has {stars.mean():.0f}"),
        compare("Fig. 5.5", "its lines", "5844", float(pairs[densest]), form=",.0f",
                why=f"5844 is {200 * 5844 / (159 * 158):.0f} % of the pairs of 159 stars; here "
                f"{200 * pairs[densest] / (stars[densest] * (stars[densest] - 1)):.0f} %"),
    ]  # fmt: skip


def _lines_figure() -> Figure:
    figure, axes = new_figure(1, 1, (5.8, 4.0))
    n = np.arange(2, 1300)
    axes.plot(n, n * (n - 1) / 2, color=INK, label="N (N − 1)/2, eq. 5.2")
    for (limit, (stars, pairs)), marker in zip(TABLE_5_1.items(), "osD", strict=True):
        catalog = guide_stars(limit)
        axes.plot(len(catalog), len(lines(catalog)), marker, color=BLUE, markersize=7, label=f"here, V ≤ {limit:g}")
        axes.plot(
            int(stars), int(pairs), marker, color=VERMILION, markerfacecolor="none", markersize=9,
            label=f"Table 5.1, V ≤ {limit:g}",
        )  # fmt: skip
    axes.plot(133, 2682, "^", color=ORANGE, markersize=8, label="133 stars, as printed")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(10, 2000)
    axes.set_ylim(30, 3e6)
    axes.set_xlabel("stars")
    axes.set_ylabel("lines")
    axes.set_title("Fig. 5.2  Number of lines against points")
    axes.legend(loc="upper left")
    return figure


def _zones_figure() -> Figure:
    from matplotlib.patches import Rectangle

    figure, axes = new_figure(1, 1, (7.6, 3.2))
    catalog = guide_stars(6.5, 20.0)
    size = np.clip((7.0 - catalog.v_mag) ** 1.6 * 0.5, 0.3, 14.0)
    axes.scatter(np.degrees(catalog.ra_rad), np.degrees(catalog.dec_rad), s=size, color=INK, linewidths=0)
    width, height = zone_size_deg()
    for k in range(ZONES):
        colour, line = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."))[k % 3]
        bottom = BORESIGHT_DEC_DEG - 0.5 * height + (k % 3 - 1) * 0.5
        for start in (360.0 / ZONES * k, 360.0 / ZONES * k - 360.0):
            axes.add_patch(
                Rectangle((start, bottom), width, height, fill=False, edgecolor=colour, linestyle=line, linewidth=1.2)
            )
        axes.text(360.0 / ZONES * k + 15.0, bottom + height + 2.4, str(k + 1), color=colour, ha="center", va="center",
                  bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
    axes.axhline(BORESIGHT_DEC_DEG, color=SOFT, linestyle=":", linewidth=0.9)
    axes.set_xlim(360.0, 0.0)
    axes.set_ylim(-12.0, 30.0)
    axes.set_xticks(range(0, 361, 30))
    axes.set_xlabel("right ascension [°]")
    axes.set_ylabel("declination [°]")
    axes.set_title("Fig. 5.4  Catalogue zones (drawn a little apart), stars to V = 6.5")
    return figure


def _zone_stars_figure(magnitude_limit: float) -> Figure:
    figure, axes = new_figure(1, 1, (5.8, 3.6))
    stars, _pairs = zone_counts(magnitude_limit)
    axes.bar(np.arange(1, ZONES + 1), stars, color=BLUE, width=0.7, label="here")
    axes.plot(
        DENSEST_ZONE, 159, "*", color=VERMILION, markersize=13, markeredgecolor=INK, label="printed: 159 in zone 3"
    )
    axes.axhline(float(stars.mean()), color=SOFT, linestyle="--", label=f"mean {stars.mean():.0f}")
    axes.set_xticks(range(1, ZONES + 1))
    axes.set_xlabel("zone")
    axes.set_ylabel("stars")
    axes.set_title(f"Fig. 5.5  Number of stars in zones, V ≤ {magnitude_limit:g}")
    axes.legend(loc="upper right")
    return figure
