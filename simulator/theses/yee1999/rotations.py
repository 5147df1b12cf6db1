"""The rotation-angle test by example: Figs. 2.3 to 2.5, a triad that passes and its mirror image that does not."""

from __future__ import annotations

import math

import numpy as np

from simulator.theses.printed import Row, Section, Verdict, compare
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.picture import vega

__all__ = ["rotation_example"]

_TOLERANCE_DEG = 5.0
_PASSES, _MIRRORED = (7001, 7139, 7056), (1063, 969, 1001)
_PRINTED = {_PASSES: ("203.2", "211.0", "29.9", "28.2"), _MIRRORED: ("36.2", "22.2", "222.9", "199.4")}


def rotation_example() -> Section:
    """Directions of the vectors 1-2 and 1-3 in the image and in two catalogue triads, and the rotations between."""
    image = _directions_deg(vega().xy_px[:3])
    why = "raw pixels of Table 4.14, counterclockwise from +x"
    rows = [
        compare("Fig. 2.3", f"direction of 1-{k} in the Vega image", text, angle, unit="°", form=".1f", why=why)
        for k, text, angle in zip((2, 3), ("173.3", "182.8"), image, strict=True)
    ]
    for figure, stars in (("Fig. 2.4", _PASSES), ("Fig. 2.5", _MIRRORED)):
        rows += _triad(figure, stars, image)
    return Section("Rotation angles of two triads", rows)


def _triad(figure: str, stars: tuple[int, int, int], image: list[float]) -> list[Row]:
    catalog = sub_catalog(4, 6.0)
    sky = catalog.sky_deg[catalog.places(list(stars))]
    # east is to the left; plain degrees, no cos δ
    theirs = _directions_deg(np.column_stack([-((sky[:, 0] - sky[0, 0] + 180.0) % 360.0 - 180.0), sky[:, 1]]))
    turns = [(there - here) % 360.0 for there, here in zip(theirs, image, strict=True)]
    printed = _PRINTED[stars]
    name = [f"HR {stars[0]} to {other}" for other in stars[1:]]
    rows = [
        compare(figure, f"direction of {n}", text, angle, unit="°", form=".1f", why="ΔDec over −ΔRA, no cos δ")
        for n, text, angle in zip(name, printed[:2], theirs, strict=True)
    ]
    rows += [
        compare(figure, f"rotation angle {k}", text, turn, unit="°", form=".1f")
        for k, text, turn in zip((1, 2), printed[2:], turns, strict=True)
    ]
    apart = abs((turns[0] - turns[1] + 180.0) % 360.0 - 180.0)
    passes = apart <= _TOLERANCE_DEG
    same: Verdict = "exact" if passes == (stars == _PASSES) else "differs"
    text = "passes" if stars == _PASSES else "does not pass, as it is a mirror image"
    turned = (image[1] - image[0] + 180.0) % 360.0 - 180.0
    mirrored = ((theirs[1] - theirs[0] + 180.0) % 360.0 - 180.0) * turned < 0.0
    computed = "passes" if passes else "does not pass" + (", as it is a mirror image" if mirrored else "")
    why = f"the rotations differ by {apart:.1f}°, {_TOLERANCE_DEG:g}° being allowed"
    rows.append(Row(figure, "rotation-angle test", text, computed, same, why))
    return rows


def _directions_deg(points: np.ndarray) -> list[float]:
    """Directions of the vectors 1-2 and 1-3 of three points (3, 2), degrees from +x towards +y in [0, 360)."""
    return [math.degrees(math.atan2(*(point - points[0])[::-1])) % 360.0 for point in points[1:]]
