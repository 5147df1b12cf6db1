"""OEDIPUS-C (section 4.3, appendix D): the field of its camera, and one rotation of the spinning payload in
``oedipus.yaml``, rendered and solved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from simulator.scenario import Scenario
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.star_tracker import build_tracker
from simulator.theses.figures import figures, section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import SubCatalog, printed_rows, sub_catalog
from simulator.theses.yee1999.picture import Options
from simulator.theses.yee1999.rendered import SolvedFrame, limits_of, off_deg, show, solve_shown
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


WRONG = (22,)
"""Images in which the program of the thesis matched wrong stars (appendix D.3)."""
FAILED = (*WRONG, 24)
"""The same, and the image with correctly matched stars whose centre diverged from an initial estimate off by several
degrees."""
PRINTED_ERROR_DEG = 0.1
_FULL_FIELD_MM = (13.2440, 10.4396)
_DEC_RANGE_DEG, _MAX_SEPARATION_DEG, _MOST_STARS = (50.0, 90.0), 40.0, 7
_RIGHT_DEG = 0.5
"""Limit of the boresight error for correct stars: five times the error stated in the thesis."""


def flight_frames(images: Sequence[int] | None = None) -> list[SolvedFrame]:
    """Images of the rotation in ``oedipus.yaml``, by their numbers from 1, each solved independently."""
    scenario = Scenario.load("oedipus")
    runner = SequenceRunner(scenario)
    options = Options(
        edition=5,
        magnitude_limit=scenario.tracker.magnitude_limit,
        dec_range_deg=_DEC_RANGE_DEG,
        max_separation_deg=_MAX_SEPARATION_DEG,
        limits=limits_of(scenario),
    )
    fov_deg = cropped_field_deg(field_deg(*_FULL_FIELD_MM))
    out, tracker = [], build_tracker(scenario, runner.renderer.camera)
    for image in images or range(1, len(runner.states) + 1):
        state = runner.states[image - 1]
        frame, truth = runner.renderer.frame(
            image - 1, at_s=state.t_s, attitude=state.camera, rate_camera_rad_s=state.rate_camera_rad_s
        )
        shown = show(frame, truth, scenario.tracker.detection, fov_deg, _MOST_STARS)
        out.append(solve_shown(image, shown, options, tracker))
    return out


def section(images: Sequence[int] | None = None) -> Section:
    """The track of the boresight over one rotation (section 4.3, appendix D.3, Fig. 4.11)."""
    frames = flight_frames(images)
    values = _values(frames) | _track(frames) | {f"image_{f.image}": partial(_image, f) for f in frames}
    drawn = figures("yee1999/rendered_flight", values)
    for name, image in (("fig_4_8_rendered", 6), ("fig_4_9_rendered", 7)):
        if f"image_{image}" not in values:
            del drawn[name]
    rows = table_rows("yee1999/rendered_flight", values)
    return Section("OEDIPUS-C reproduced: one rotation of the spinning payload", rows, drawn)


def _values(frames: Sequence[SolvedFrame]) -> Values:
    printed = {int(row["image"]): row for row in printed_rows("table_d_2")}
    wrong = sum(f.image in WRONG for f in frames)
    right = sum(bool(printed[f.image]["hr"]) for f in frames) - wrong
    hers, ours = (np.array([getattr(f, name) for f in frames]) for name in ("hers_off_deg", "ours_off_deg"))
    apart = [
        off_deg(f.shown.truth.attitude, np.array([float(row["ra_deg"]), float(row["dec_deg"])]))
        for f in frames
        if (row := printed[f.image])["ra_deg"]
    ]
    coordinate = math.sqrt(float(np.mean(np.square(apart))) / 2.0) if apart else math.nan
    methods = (
        (
            hers, "images with correctly and wrongly identified stars, by the thesis' method",
            "printed: real pictures, with the tether painted over; computed: with the tether, and assumed noise",
        ),
        (
            ours, "the same by the tracker (`identifier: triads`)",
            "another video; up to 12 stars, exact geometry, acceptance by probability",
        ),
    )  # fmt: skip
    return {
        "methods": [
            {
                "method": method,
                "video": video,
                "right": np.count_nonzero(off <= _RIGHT_DEG),
                "wrong": np.count_nonzero(off > _RIGHT_DEG),
            }
            for off, method, video in methods
        ],
        "hers": (right, wrong),
        "total": len(frames),
        "failed": [_failed(f) for f in frames if f.image in FAILED],
        "largest": np.nanmax(ours),
        "coordinate": coordinate,
        "fitted": coordinate <= PRINTED_ERROR_DEG,
    }


def _failed(f: SolvedFrame) -> Values:
    """An image in which the program of the thesis failed."""
    hers = "wrong matches" if f.image in WRONG else "correct matches, but the centre diverged"
    if not f.solution.solved:
        return {"image": f.image, "hers": hers, "ours": "not solved", "note": f.solution.reason}
    ours = f"{len(f.solution.stars)} stars, off by {f.ours_off_deg:.3f}°"
    return {
        "image": f.image,
        "hers": hers,
        "ours": ours,
        "note": "another video; the program of the thesis failed here, ours does not",
    }


def _track(frames: Sequence[SolvedFrame]) -> Values:
    """Declination by right ascension: printed, by the thesis' method and by the tracker."""
    truth = np.array([(f.shown.truth.attitude.ra_deg, f.shown.truth.attitude.dec_deg) for f in frames])
    printed = np.array([(float(r["ra_deg"]), float(r["dec_deg"])) for r in printed_rows("table_d_2") if r["ra_deg"]])
    hers = [f.analysis.plate.center_deg for f in frames if f.analysis.plate is not None and f.hers_off_deg < _RIGHT_DEG]
    ours = {f.image: (f.solution.ra_deg, f.solution.dec_deg) for f in frames if f.solution.solved}
    solved, failed = (
        [{"image": str(image), "at": at} for image, at in ours.items() if (image in FAILED) == hard]
        for hard in (False, True)
    )
    return {
        "truth": truth.T,
        "printed": printed.T,
        "error": PRINTED_ERROR_DEG,
        "her_centres": np.array(hers).reshape(-1, 2).T,
        "our_centres": np.array(list(ours.values())).reshape(-1, 2).T,
        "solved": solved,
        "hard": failed,
    }


def _image(flight: SolvedFrame) -> Values:
    """A rendered image with the names of the tracker's stars."""
    named, width = flight.solution.stars, flight.shown.picture.size_px[0]
    stars = []
    for (x, y), number in zip(named.xy, named.catalog_id, strict=True):
        shift, align = (-12, "right") if x > 0.85 * width else (12, "left")
        stars.append({"x": x, "y": y, "beside": x + shift, "align": align, "hr": f"{number}"})
    return {"frame": flight.shown.frame.image, "image": flight.image, "stars": stars}
