"""The guide-star database of Greyling 1995, section 5.2.1: stars, lines between them, and zones along the path."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.catalog import StarCatalog, load_catalog
from startracker.catalog.guide import RESOLVED_PX
from startracker.core import IntArray
from startracker.geometry.attitude import radec_to_direction

BORESIGHT_DEC_DEG = 8.6
FIELD_DEG, SIDE_PX = 10.0, 512
SENSORS_DEG = 5.0
"""Accuracy of the other sensors, the program's default."""
BAND_DEG = 0.5 * FIELD_DEG + SENSORS_DEG
"""Half width in declination of the band around the path, as in `guide.m`."""

CLOSEST_DEG = 0.039
"""R_MinA."""
LONGEST_DEG = math.sqrt(2.0) * FIELD_DEG
PARTNERS = 30
"""Number of next stars in right ascension with which `guide.m` pairs each star."""

MAP_HALF_WIDTH_DEG, MAP_LONGEST_DEG, MAP_CLOSEST_DEG = 1.5 * FIELD_DEG, 14.147, 0.08
"""The matching program's map: WCat = 3 WFOV, RCatLimit, CloseR."""

TABLE_5_1 = {5.0: ("243", "8316"), 6.0: ("767", "16493"), 6.5: ("1248", "32290")}
"""Magnitude to the printed numbers of stars and lines."""

ZONES, ZONE_DAYS = 12, 30
ZONE_WIDTH_DEG, ZONE_HEIGHT_DEG = 14.0 + ZONE_DAYS * 1.0 + 2.0 * 1.0, 14.0 + 2.0 * 1.0
"""Eq. 5.5: field + days × daily motion + twice the other sensors' accuracy; in declination without the daily motion."""
DENSEST_ZONE = 3


def guide_stars(magnitude_limit: float, band_deg: float = BAND_DEG, closest_deg: float = CLOSEST_DEG) -> StarCatalog:
    """Guide stars by the rule of the thesis, sorted by right ascension: those closer than `band_deg` to the path.

    Of two stars closer than `closest_deg` the fainter one is excluded (Fig. 5.3; `guide.m` excludes the other); 0:
    none. The tracker's database merges them (`startracker.catalog.merge_doubles`).
    """
    catalog = load_catalog("bsc5").brighter_than(magnitude_limit)
    catalog = catalog.select(np.flatnonzero(np.abs(np.degrees(catalog.dec_rad) - BORESIGHT_DEC_DEG) < band_deg))
    catalog = catalog.select(np.argsort(catalog.ra_rad, kind="stable"))
    if closest_deg == 0.0:
        return catalog
    chord = 2.0 * math.sin(math.radians(closest_deg) / 2.0)
    pairs = cKDTree(radec_to_direction(catalog.ra_rad, catalog.dec_rad)).query_pairs(chord, output_type="ndarray")
    dimmer = np.where(catalog.v_mag[pairs[:, 0]] > catalog.v_mag[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    keep = np.ones(len(catalog), dtype=bool)
    keep[dimmer] = False
    return catalog.select(keep)


def lines(catalog: StarCatalog, partners: int | None = PARTNERS, start_ra_deg: float = 0.0) -> IntArray:
    """Lines (L, 2) between the stars of a catalogue that is sorted by right ascension, as in `guide.m`.

    Each star with the next `partners` ones in right ascension, in the plane of right ascension and declination without
    cos δ, up to √2 times the field; not across the end of the list, and the last star only with those near the end.
    Without `partners` each star is paired with all stars after it. Right ascensions are measured from `start_ra_deg`,
    so that a zone across 0 h is contiguous.
    """
    ra = (np.degrees(catalog.ra_rad) - start_ra_deg) % 360.0
    dec = np.degrees(catalog.dec_rad)
    found = []
    for step in range(1, len(catalog) if partners is None else min(partners + 1, len(catalog))):
        apart = np.hypot(ra[step:] - ra[:-step], dec[step:] - dec[:-step])
        first = np.flatnonzero((apart < LONGEST_DEG) & (apart > 0.0))
        found.append(np.stack([first, first + step], axis=1))
    return np.concatenate(found) if found else np.empty((0, 2), np.int64)


def map_lines(hour: float, magnitude_limit: float) -> int:
    """Number of lines in the matching program's map around a right ascension: ± 15° by ± 10°, plane, each pair once.

    Of two stars closer than 0.08° the fainter one is excluded. The program uses arrays of 1000 lines and counts each
    pair twice; this limit is not applied.
    """
    catalog = load_catalog("bsc5")
    ra = (np.degrees(catalog.ra_rad) - 15.0 * hour + 180.0) % 360.0 - 180.0
    dec = np.degrees(catalog.dec_rad)
    inside = (
        (catalog.v_mag < magnitude_limit)
        & (np.abs(dec - BORESIGHT_DEC_DEG) < BAND_DEG)
        & (np.abs(ra) < MAP_HALF_WIDTH_DEG)
    )
    x, y, v_mag = ra[inside], dec[inside], catalog.v_mag[inside]
    i, j = np.triu_indices(len(x), 1)
    apart = np.hypot(x[i] - x[j], y[i] - y[j])
    close = apart < MAP_CLOSEST_DEG
    gone = np.zeros(len(x), dtype=bool)
    gone[np.where(v_mag[i] > v_mag[j], i, j)[close]] = True
    return int(np.count_nonzero((apart < MAP_LONGEST_DEG) & ~close & ~gone[i] & ~gone[j]))


def zone(catalog: StarCatalog, ra_deg: float) -> StarCatalog:
    """Stars of the zone that starts at `ra_deg`, in order."""
    along = (np.degrees(catalog.ra_rad) - ra_deg) % 360.0
    inside = (along < ZONE_WIDTH_DEG) & (
        np.abs(np.degrees(catalog.dec_rad) - BORESIGHT_DEC_DEG) <= 0.5 * ZONE_HEIGHT_DEG
    )
    chosen = np.flatnonzero(inside)
    return catalog.select(chosen[np.argsort(along[chosen], kind="stable")])


def zone_counts() -> tuple[IntArray, IntArray]:
    """Stars to V = 6.5 and lines of each zone; zone k starts at right ascension 360°(k − 1)/12."""
    catalog = guide_stars(6.5)
    starts = [360.0 / ZONES * k for k in range(ZONES)]
    parts = [zone(catalog, start) for start in starts]
    counts = [len(lines(part, start_ra_deg=start)) for part, start in zip(parts, starts, strict=True)]
    return np.array([len(part) for part in parts]), np.array(counts)


def section() -> Section:
    """Section 5.2.1: rows, Table 5.1 and Figs. 5.2, 5.4 and 5.5."""
    values = _limit_values() | _table_values() | _zone_values() | _zone_map()
    return section_of("greyling1995/guide_stars", "Chapter 5.2: guide stars", values)


def _limit_values() -> Values:
    n = np.arange(2, 1300)
    possible, resolved_deg = 133 * 132 // 2, RESOLVED_PX / SIDE_PX * FIELD_DEG
    return {
        "resolved_deg": resolved_deg,
        "resolved_arcsec": 3600.0 * resolved_deg,
        "diagonal_deg": math.hypot(FIELD_DEG, FIELD_DEG),
        "possible": possible,
        "less_percent": 100 * (1 - 2682 / possible),
        "kept_percent": 100 * 2682 / possible,
        "bytes": 4 * 1248 + 4 * 32290,
        "one_byte_a_line": 4 * 1248 + 32290,
        "n": n,
        "every": n * (n - 1) / 2,
        "most": np.minimum(n * (n - 1) / 2, PARTNERS * n),
        "partners": PARTNERS,
    }


def _table_values() -> Values:
    rows = []
    for limit, (stars, pairs) in TABLE_5_1.items():
        catalog, before, most = guide_stars(limit), guide_stars(limit, closest_deg=0.0), int(stars) * PARTNERS
        above = f"; {stars} stars have at most {most} lines: {pairs} is not from this listing"
        printed = {"limit": limit, "stars": stars, "lines": pairs, "above": above if most < int(pairs) else ""}
        found = {"found": len(catalog), "before": len(before), "printed": (int(stars), int(pairs))}
        rows.append(printed | found | {"found_lines": len(lines(catalog)), "lines_before": len(lines(before))})
    everyone, kept = guide_stars(6.5, closest_deg=0.0), guide_stars(6.5)
    return {
        "limits": rows,
        "band_deg": BAND_DEG,
        "less": 100.0 * (1.0 - len(lines(kept)) / len(lines(everyone))),
        "left_out": len(everyone) - len(kept),
        "everyone": len(everyone),
    }


def _zone_values() -> Values:
    width, height = ZONE_WIDTH_DEG, ZONE_HEIGHT_DEG
    stars, pairs = zone_counts()
    everywhere = len(guide_stars(6.5))
    densest = int(np.argmax(stars))
    return {
        "zone": {"width": width, "height": height, "area": width * height},
        "zones": 365.2422 / ZONE_DAYS,
        "densest": densest + 1,
        "most_lines": pairs[densest],
        "most_possible": 159 * PARTNERS,
        "most_stars": stars[densest],
        "everywhere": everywhere,
        "band_mean": everywhere * width / 360.0,
        "zone_mean": stars.mean(),
        "zone_numbers": np.arange(1, ZONES + 1),
        "zone_stars": stars,
        "printed_densest": DENSEST_ZONE,
    }


def _zone_map() -> Values:
    """The zones, slightly separated, and the stars to V = 6.5."""
    catalog = guide_stars(6.5, 20.0)
    zones = []
    for k in range(ZONES):
        start, bottom = 360.0 / ZONES * k, BORESIGHT_DEC_DEG - 0.5 * ZONE_HEIGHT_DEG + (k % 3 - 1) * 0.5
        corners = {"corners": [(start, bottom), (start - 360.0, bottom)], "name": str(k + 1)}
        zones.append(corners | {"x": start + 15.0, "y": bottom + ZONE_HEIGHT_DEG + 2.4})
    stars = {"ra": np.degrees(catalog.ra_rad), "dec": np.degrees(catalog.dec_rad)}
    size = np.clip((7.0 - catalog.v_mag) ** 1.6 * 0.5, 0.3, 14.0)
    return {"map": stars | {"size": size}, "zone_corners": zones, "path": BORESIGHT_DEC_DEG}
