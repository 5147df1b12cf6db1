"""Run times: Tables 4.21 and C.1 to C.6, and version B on an emulated 68k.

Version B is the fixed-point program without the test of enclosed angles. That of the thesis also detects the stars in
the image and has no attitude; ours, the flight build from centroids, ends with a verified attitude and its covariance.
Both images have the same size, so that the difference of their times excludes the search for stars in the image.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from simulator.study.exported_c.build import Build
from simulator.study.exported_c.instructions import count_instructions
from simulator.study.exported_c.targets import M68K, native_compiler
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import printed_rows, sub_catalog
from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.integer_build import (
    MAX_SEPARATION_DEG,
    best_ms,
    match_floating,
    measured,
    picture_design,
    star_text,
)
from simulator.theses.yee1999.picture import Picture, deneb, vega
from startracker.flight.design import FlightDesign
from startracker.flight.export import flight_export
from startracker.settings import TriadSettings

_B = TriadSettings(enclosed_tolerance_deg=None)
_CLOCKS = 25e6
"""Clock rate of the MC68EN360RC25C of the thesis."""
_REPETITIONS = 100
_NAMES = {
    "floating, centre": "floating point, with the centre",
    "floating": "floating point, without the centre",
    "A": "fixed point, version A",
    "B": "fixed point, version B",
}
_WHERE = {
    "C.1": "Vega, Visual C++ 4.0",
    "C.2": "Vega, Visual C++ 5.0",
    "C.3": "Vega, MC68360",
    "C.4": "Deneb, Visual C++ 4.0",
    "C.5": "Deneb, Visual C++ 5.0",
    "C.6": "Deneb, MC68360",
}


def version_b(picture: Picture) -> FlightDesign:
    """Version B for the camera of an image."""
    return picture_design(picture, settings=_B)


def run_times() -> Section:
    """Rows of all tables."""
    values = {"trials": _trials()} | _here() | _emulated()
    return Section("Run times", table_rows("yee1999/run_times", values))


def _trials() -> list[Values]:
    """Averages and run times of the ten printed trials."""
    rows = []
    for row in printed_rows("tables_c"):
        mean = float(np.mean([float(row[f"trial_{n}"]) for n in range(1, 11)]))
        names = {"table": row["table"], "program": _WHERE[row["table"]], "version": _NAMES[row["version"]]}
        rows.append(names | {"texts": [row["average"], row["run_time"]], "means": [mean, mean / _REPETITIONS]})
    return rows


def _here() -> Values:
    """Table 4.21 on this machine: the Pentium II and its compilers are not available."""
    picture, stars = deneb(), sub_catalog(4)
    real = stars.tables(MAX_SEPARATION_DEG)
    coded = stars.tables(MAX_SEPARATION_DEG, FixedArithmetic())
    programs = (
        ("floating, centre", "2.317 s, 0.644 s", lambda: match_floating(picture, real)),
        ("floating", "2.286 s, 0.596 s", lambda: match_floating(picture, real, centre=False)),
        ("A", "1.430 s, 0.622 s", lambda: match_floating(picture, coded, centre=False)),
    )
    timed = [
        {"version": _NAMES[version], "hers": hers, "ms": best_ms(program, 3), "how": "Python"}
        for version, hers, program in programs
    ]
    how = "C, with a verified attitude"
    design = version_b(picture)
    data = star_text(picture.xy_px, design).encode()
    compiled = measured(flight_export(design), native_compiler(), lambda build: 1e3 * build.time_s(data, 20, "stars"))
    timed += [
        {"version": _NAMES["B"], "hers": "n/a, 0.464 s", "ms": found["measured"], "how": how} for found in compiled
    ]
    return {"timed": timed, "no_compiler": [] if compiled else [{}]}


def _instructions(build: Build, text: str) -> int:
    return count_instructions(build, text.encode(), "stars").total


def _emulated() -> Values:
    """Tables C.3 and C.6 in instructions of the emulated 68k."""
    seconds = {"Vega": 9.41, "Deneb": 23.66}
    rows: list[Values] = [
        {"where": where, "what": f"{name} on the 68k: {_NAMES['B']}", "clocks": f"{spent} s: {_million(spent)}"}
        for where, (name, spent) in zip(("Table C.3", "Table C.6"), seconds.items(), strict=True)
    ]
    between = _million(seconds["Deneb"] - seconds["Vega"])
    rows.append({"where": "Tables C.3, C.6", "what": "Deneb minus Vega", "clocks": between})
    missing = M68K.missing()
    if missing is not None:
        return {"not_emulated": [row | {"missing": missing} for row in rows], "emulated": [], "builds": []}
    builds: list[Values] = []
    for name, picture, hers in (("Vega", vega(), "4 MB"), ("Deneb", deneb(), "4 MB, its stars renumbered")):
        design = version_b(picture)
        stars = star_text(picture.xy_px, design)
        found = measured(flight_export(design), M68K, partial(_instructions, text=stars))
        builds += [{"name": name, "hers": hers} | values for values in found]
    vega_count, deneb_count = (values["measured"] for values in builds)
    counts = [vega_count, deneb_count, deneb_count - vega_count]
    how = (
        "instructions of an emulated CPU32, from the centroids to a verified attitude; in the thesis from the image "
        "to the names"
    )
    less = "84 triangles instead of 10; neither includes the search for stars in the image, which is the same in both"
    emulated = [
        row | {"millions": count / 1e6, "how": text}
        for row, count, text in zip(rows, counts, (how, how, less), strict=True)
    ]
    return {"not_emulated": [], "emulated": emulated, "builds": builds}


def _million(seconds: float) -> str:
    return f"{seconds * _CLOCKS / 1e6:.0f} million clocks"
