"""The fixed-point columns of Tables 4.14 and 4.15, from pixels with exact centroids equal to the floating-point
columns.

The pixels are not printed. Instead a star image is generated for each star: a Gaussian in integer DN above the
threshold, with a width of about τ, whose centroid is adjusted to the five printed decimals by moving single DN. The
running mean of 10.22 is then computed over these pixels in the order in which the program of the thesis scans the
image.
"""

from __future__ import annotations

import numpy as np

from simulator.theses.printed import Row
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from startracker.arrays import IntArray
from startracker.fixed_point.centroid import running_centroid
from startracker.fixed_point.formats import CENTROID

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
