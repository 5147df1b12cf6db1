"""Errors of integer arithmetic: Fig. 3.1 and its crossover, Tables 4.14, 4.15 and 4.17, the Vega image in integers.

The pixels of the fixed-point centroids are not printed. Instead a star image is generated for each star: a Gaussian in
integer DN above the threshold, with a width of about τ, whose centroid is adjusted to the five printed decimals by
moving single DN. The running mean of 10.22 is then computed over these pixels in the order in which the program of the
thesis scans the image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simulator.theses.figures import section_of
from simulator.theses.printed import Row, Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.fixed_point.centroid import running_centroid
from simulator.theses.yee1999.fixed_point.formats import CENTROID, SEPARATION
from simulator.theses.yee1999.fixed_point.square_root import by_pythagoras, by_tables
from simulator.theses.yee1999.picture import PRINTED_MATCHES, Options, Picture, analyse, deneb, merged_name, sadr, vega
from startracker.core import FloatArray, IntArray
from startracker.identification.triad_search import image_pairs

_STEP_DEG, _LAST_DEG = 0.25, 22.5
"""Values of χ = ψ in Fig. 3.1."""


class Crossover(NamedTuple):
    """Errors of the two methods for a separation in integers, χ = ψ: floating point minus integers, NaN if a separation
    does not fit 6.10; the separations (N,) by eq. 2.4."""

    separation_deg: FloatArray
    pythagoras_deg: FloatArray
    tables_deg: FloatArray

    @property
    def at_deg(self) -> float:
        """The largest separation at which the error by Pythagoras' theorem does not exceed that of the tables."""
        better = np.abs(self.pythagoras_deg) <= np.abs(self.tables_deg)
        return float(self.separation_deg[better].max())

    @property
    def largest_error_deg(self) -> float:
        """Largest error of the combination, Pythagoras up to `at_deg` and the tables beyond."""
        used = np.where(self.separation_deg <= self.at_deg, self.pythagoras_deg, self.tables_deg)
        return float(np.nanmax(np.abs(used)))


def crossover() -> Crossover:
    """Separations for χ = ψ from 0.25° to 22.5° by Pythagoras' theorem and by the tables, as Fig. 3.1."""
    angle = np.arange(_STEP_DEG, _LAST_DEG + _STEP_DEG / 2, _STEP_DEG)
    coded = SEPARATION.encode(angle)
    true = np.degrees(np.arccos(np.cos(np.radians(angle)) ** 2))
    largest = float(SEPARATION.decode(SEPARATION.largest))
    errors = []
    for method, reach in ((by_pythagoras, np.sqrt(2.0) * angle), (by_tables, true)):
        out = np.full(len(angle), np.nan)
        fits = reach < largest
        out[fits] = true[fits] - SEPARATION.decode(method(coded[fits], coded[fits]))
        errors.append(out)
    return Crossover(true, *errors)


def integers() -> Section:
    """Rows and Fig. 3.1."""
    curve = crossover()
    images = ((vega(), "Table 4.17"), (deneb(), "Table 4.18"), (sadr(), "Table 4.19"))
    separations = [row for image in images for row in integer_separations(*image)]
    values = {
        "curve": curve,
        "widest": curve.separation_deg[-1],
        "separations": separations,
        "label": (curve.at_deg, -0.3),
    }
    return section_of("yee1999/integers", "Integer arithmetic", values | _matches())


def integer_separations(picture: Picture, where: str) -> list[Values]:
    """Separations in integers of 6.10 (Tables 4.17, 4.18, 4.19)."""
    arithmetic = FixedArithmetic()
    image = arithmetic.image(picture.xy_px, picture.scale_deg)
    coded = arithmetic.image_separations(image, *image_pairs(len(picture.xy_px)))
    rows = []
    for row, value in zip(printed_rows(file_of(where)), coded, strict=True):
        off = abs(round(float(row["fixed_deg"]) * SEPARATION.one) - int(value))
        why = f"{off} in the last of 10 bits; the format of the scale is not printed" if off else ""
        names = {"table": where, "star": row["star"], "other": row["other"], "texts": [row["fixed_deg"]]}
        rows.append(names | {"degrees": [float(arithmetic.separation_degrees(value))], "off": why})
    return rows


def _matches() -> Values:
    """The matches in integers and those printed in section 4.2.1; 4.2.4.3 states that they are the same."""
    ours = analyse(vega(), Options(arithmetic=FixedArithmetic()))
    real = analyse(vega())
    return {
        "hers": ", ".join(map(str, PRINTED_MATCHES)),
        "ours": ", ".join(map(merged_name, ours.matches)),
        "same": tuple(ours.matches) == PRINTED_MATCHES,
        "triads": len(ours.triads),
        "real_triads": len(real.triads),
        "matches": "the same" if real.matches == ours.matches else "others",
    }


_THRESHOLD_DN, _PEAK_DN, _SIGMA_PX, _RADIUS_PX = 51, 150, 3.2, 8
_MORE_DN = 5000
"""Range in which the sum of DN is searched: some tens of values fit 2 coordinates with 5 decimals."""
_WITHIN_PX = 7e-5
"""The largest printed difference is 0.00006 px, with both columns rounded to 0.00001."""


def star_pixels(x_px: float, y_px: float) -> tuple[IntArray, IntArray, IntArray]:
    """Pixels x, y (right, up), row by row, and DN of a star whose centroid is within 5e-6 px of a position."""
    position = np.array([x_px, y_px])
    column, row = np.rint(position).astype(np.int64)
    reach = np.arange(-_RADIUS_PX, _RADIUS_PX + 1)
    y, x = (grid.ravel() for grid in np.meshgrid(row - reach, column + reach, indexing="ij"))
    light = np.exp(-((x - x_px) ** 2 + (y - y_px) ** 2) / (2.0 * _SIGMA_PX**2))
    dn = np.rint(_PEAK_DN * light).astype(np.int64)
    keep = dn > _THRESHOLD_DN
    x, y, dn = x[keep], y[keep], dn[keep]
    # a sum of DN for which the first moments are nearly integers
    sums = np.arange(dn.sum(), dn.sum() + _MORE_DN)
    moments = sums[:, None] * position
    total = int(sums[np.argmin((np.abs(moments - np.rint(moments)) / sums[:, None]).max(axis=1))])
    added = np.arange(total - int(dn.sum())) % len(dn)
    dn += np.bincount(added, minlength=len(dn))
    for axis, points in enumerate((x, y)):
        missing = int(np.rint(total * position[axis])) - int((points * dn).sum())
        # moving one DN to the adjacent pixel changes the moment by one
        there = {(int(u), int(v)): k for k, (u, v) in enumerate(zip(x, y, strict=True))}
        step = np.eye(2, dtype=np.int64)[axis] * (1 if missing > 0 else -1)
        moves = [(k, there.get((u + step[0], v + step[1]))) for (u, v), k in there.items()]
        inside = [(k, to) for k, to in moves if to is not None]
        for n in range(abs(missing)):
            source, target = inside[n % len(inside)]
            dn[source] -= 1
            dn[target] += 1
    return x, y, dn


def fixed_centroids() -> list[Row]:
    """One row per coordinate of the three images."""
    images = (("4.14", "Vega"), ("4.15", "Deneb"), ("4.16", "Sadr"))
    return table_rows("yee1999/fixed_centroids", {"columns": [c for table in images for c in _columns(*table)]})


def _columns(table: str, image: str) -> list[Values]:
    stars = printed_rows(file_of(f"Table {table}"))
    coded, exact, count = [], [], []
    for star in stars:
        x, y, dn = star_pixels(float(star["x"]), float(star["y"]))
        exact.append([(x * dn).sum() / dn.sum(), (y * dn).sum() / dn.sum()])
        coded.append(CENTROID.decode(running_centroid(x, y, dn)))
        count.append(len(dn))
    columns = []
    for axis, name in enumerate("xy"):
        ours = np.array(coded)[:, axis]
        texts = [star[f"{name}_fixed"] for star in stars]
        hers, floating = np.array(texts, float), np.array([float(star[name]) for star in stars])
        lost = (np.abs(np.array(exact)[:, axis]) - np.abs(ours)).round(7)
        columns.append(
            {
                "table": table,
                "image": image,
                "axis": name,
                "hers": ", ".join(texts),
                "ours": ", ".join(f"{value:.5f}" for value in ours),
                "near": np.abs(ours - hers).max() <= _WITHIN_PX and (lost >= 0.0).all(),
                "fewest": min(count),
                "most": max(count),
                "off_px": np.abs(floating - hers).max(),
                "lost_px": lost.max(),
            }
        )
    return columns
