"""The field of view of the OEDIPUS-C camera (thesis section 4.3 and appendix D)."""

from __future__ import annotations

import numpy as np

from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from simulator.theses.yee1999.catalogue import SubCatalog, printed_rows, sub_catalog
from startracker.identification.arithmetic import FloatArithmetic

FOCAL_LENGTH_MM = 25.0
PIXELS = (588.02, 557.08)
PIXELS_PER_MM = (44.3991, 53.3618)
DIGITIZED_PX = (512, 480)
_TAU_PX = 15.0


def field_deg(width_mm: float, height_mm: float) -> tuple[float, float]:
    """Field across and down, degrees: eq. D.1 between the midpoints of opposite edges."""
    arithmetic = FloatArithmetic(exact=True)
    x, y = width_mm / 2.0, height_mm / 2.0
    # a millimetre at the centre is 1/f radians
    image = arithmetic.image([[-x, 0.0], [x, 0.0], [0.0, -y], [0.0, y]], [np.degrees(1.0 / FOCAL_LENGTH_MM)] * 2)
    across, down = arithmetic.image_separations(image, np.array([0, 2]), np.array([1, 3]))
    return float(across), float(down)


def cropped_field_deg(field: tuple[float, float]) -> tuple[float, float]:
    """Field of the digitised part, in proportion to the pixels as in the thesis."""
    across, down = (f * have / full for f, have, full in zip(field, DIGITIZED_PX, PIXELS, strict=True))
    return across, down


def video_field() -> Section:
    """Fields, sub-catalogue and Table D.1, with Fig. 4.10."""
    stars = sub_catalog(4, 5.0, 50.0)
    half_mm = [pixels / per_mm / 2.0 for pixels, per_mm in zip(PIXELS, PIXELS_PER_MM, strict=True)]
    field = field_deg(*(round(half, 4) * 2.0 for half in half_mm))
    cropped = cropped_field_deg(field)
    largest = max(
        abs(float(row["database_deg"]) - cropped[0] / field[0] * float(row["calculated_deg"]))
        for row in printed_rows("table_d_1")
    )
    values = {
        "stars": len(stars),
        "pairs": len(stars.tables(40.0).separation),
        "half_mm": half_mm,
        "field": field,
        "cropped": cropped,
        "combine": _TAU_PX * field[0] / DIGITIZED_PX[0],
        "table_d_1": _table_d_1(stars),
        "largest": largest,
        "within": largest < 0.34,
    }
    return section_of("yee1999/video_field", "The field of OEDIPUS-C", values | _differences(stars))


def database_separations(stars: SubCatalog) -> list[float]:
    """Separations of Table D.1's pairs in the sub-catalogue, degrees."""
    tables = stars.tables(40.0)
    pairs = np.array([stars.indices([int(row["first"]), int(row["second"])]) for row in printed_rows("table_d_1")])
    apart = tables.arithmetic.catalog_separations(tables.sky, pairs[:, 0], pairs[:, 1])
    return [float(value) for value in tables.arithmetic.separation_degrees(apart)]


def _table_d_1(stars: SubCatalog) -> list[Values]:
    rows = []
    for row, apart in zip(printed_rows("table_d_1"), database_separations(stars), strict=True):
        off = abs(apart - float(row["database_deg"]))
        found = [apart, apart - float(row["calculated_deg"])]
        why = "" if off <= 5e-5 else f"{off:.1e}° off: the edition"
        rows.append(row | {"texts": [row["database_deg"], row["difference_deg"]], "found": found, "edition": why})
    return rows


def _differences(stars: SubCatalog) -> Values:
    """Difference by true separation, and the remainder in the cropped field."""
    true = np.array(database_separations(stars))
    seen = np.array([float(row["calculated_deg"]) for row in printed_rows("table_d_1")])
    slope = float(true @ (true - seen) / (true @ true))
    line = np.array([0.0, true.max()])
    scaled = true - DIGITIZED_PX[0] / PIXELS[0] * seen
    return {"true": true, "off": true - seen, "scaled": scaled, "line": (line, slope * line), "slope": slope}
