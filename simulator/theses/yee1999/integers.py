"""Errors of integer arithmetic: Fig. 3.1 and its crossover, Tables 4.14 and 4.17, the Vega image in integers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from simulator.theses.yee1999.catalogue import file_of, printed_rows
from simulator.theses.yee1999.picture import PRINTED_MATCHES, Options, Picture, analyse, deneb, merged_name, sadr, vega
from startracker.arrays import FloatArray
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.formats import SEPARATION
from startracker.fixed_point.square_root import by_pythagoras, by_tables
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
