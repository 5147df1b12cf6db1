"""Frames that replace the pictures of the thesis: rendered, detected by its detector, and solved by its method and
ours.

The pictures themselves are not available. `Shown` is the input of both methods from a rendered frame: the clusters of
bright pixels, in the order of the thesis (most pixels first) and its coordinates. The Vega image is reproduced here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simulator.frame import Frame, FrameTruth
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.star_tracker import build_tracker
from simulator.theses.detectors.clustering import find_clusters
from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from simulator.theses.yee1999.picture import PRINTED_MATCHES, VEGA_FOV_DEG, Analysis, Options, Picture, analyse, centred
from startracker.core import FloatArray, IntArray
from startracker.detection import estimate
from startracker.geometry.attitude import Attitude, radec_to_direction
from startracker.identification.triad_search import TriadLimits
from startracker.settings import DetectionSettings
from startracker.solution import Solution
from startracker.tracker import StarTracker


class Shown(NamedTuple):
    """A rendered frame and the star images found in it, most pixels first: centroids for the thesis' method, the same
    (N, 2) as columns and rows, and number of pixels (N,) of each."""

    frame: Frame
    truth: FrameTruth
    picture: Picture
    xy: FloatArray
    pixels: IntArray


def show(
    frame: Frame, truth: FrameTruth, detection: DetectionSettings, fov_deg: tuple[float, float], most: int = 12
) -> Shown:
    """Find up to a number of star images of a frame by clustering; `fov_deg` defines the scale of the thesis'
    method."""
    image = frame.image.astype(np.float32)
    background = estimate(image, detection.background_tile_px)
    spots = find_clusters(image, background, detection, frame.saturation_dn)
    order = np.argsort(-spots.pixels, kind="stable")[:most]
    assert spots.centre is not None
    size = (image.shape[1], image.shape[0])
    xy = spots.centre[order]
    return Shown(frame, truth, Picture(centred(xy, size, "corner"), size, fov_deg), xy, spots.pixels[order])


def off_deg(truth: Attitude, center_deg: FloatArray) -> float:
    """Angle between the true boresight and a centre (right ascension, declination), degrees."""
    direction = radec_to_direction(*np.radians(center_deg))
    across = float(np.linalg.norm(np.cross(direction, truth.boresight)))
    return math.degrees(math.atan2(across, float(direction @ truth.boresight)))


class SolvedFrame(NamedTuple):
    """A rendered frame, by its number from 1, solved by the thesis' method and by the star tracker."""

    image: int
    shown: Shown
    analysis: Analysis
    solution: Solution

    @property
    def hers_off_deg(self) -> float:
        """Distance of the centre of the thesis' method from the true boresight; NaN without a centre."""
        plate = self.analysis.plate
        return math.nan if plate is None else off_deg(self.shown.truth.attitude, plate.center_deg)

    @property
    def ours_off_deg(self) -> float:
        """The same for the tracker."""
        return tracker_off_deg(self.shown.truth.attitude, self.solution)

    @property
    def off_deg(self) -> tuple[float, float]:
        """Both."""
        return self.hers_off_deg, self.ours_off_deg


def solve_shown(image: int, shown: Shown, options: Options, tracker: StarTracker) -> SolvedFrame:
    """Solve a frame by both methods, the tracker from its pixels."""
    frame = shown.frame
    solution = tracker.solve(
        frame.image, observer=frame.observer, saturation_dn=frame.saturation_dn, gain_e_per_dn=frame.gain_e_per_dn
    )
    return SolvedFrame(image, shown, analyse(shown.picture, options), solution)


def tracker_off_deg(truth: Attitude, solution: Solution) -> float:
    """Angle between the true boresight and a solution's, degrees; NaN if it is not solved."""
    return off_deg(truth, np.array([solution.ra_deg, solution.dec_deg])) if solution.solved else math.nan


PRINTED_ERROR_DEG = 0.02
"""Uncertainty of the centre, as estimated in the thesis from the residuals."""
_FRAMES = 12


def vega_frames(frames: int = _FRAMES, scenario: Scenario | None = None) -> list[SolvedFrame]:
    """Frames of ``xybion.yaml`` with independent noise, detected, identified and solved.

    The thresholds of another scenario are used for both methods.
    """
    scenario = scenario or Scenario.load("xybion")
    renderer, settings = Renderer(scenario), scenario.tracker
    tracker = build_tracker(scenario, renderer.camera)
    options = Options(magnitude_limit=settings.magnitude_limit, edition=5, limits=limits_of(scenario))
    shown = (show(*renderer.frame(index), settings.detection, VEGA_FOV_DEG) for index in range(frames))
    return [solve_shown(image, one, options, tracker) for image, one in enumerate(shown, 1)]


def limits_of(scenario: Scenario) -> TriadLimits:
    """Thresholds of the thesis' method from a scenario's tracker; τ is that of the clustering."""
    chosen, tau = scenario.tracker.identification, scenario.tracker.detection.cluster_radius_px
    plain = TriadLimits()
    return TriadLimits(
        separation_tolerance_deg=chosen.separation_tolerance_deg or plain.separation_tolerance_deg,
        rotation_tolerance_deg=chosen.rotation_tolerance_deg,
        enclosed_tolerance_deg=chosen.enclosed_tolerance_deg,
        grouping_tolerance_deg=chosen.grouping_tolerance_deg,
        vote_number=chosen.vote_number,
        combine_px=plain.combine_px if tau is None else tau,
    )


def section(frames: int = _FRAMES) -> Section:
    """From the pixels of a rendered Vega image to its centre (section 4.2.1)."""
    seen = vega_frames(frames)
    first = seen[0]
    identified = [number for number in first.analysis.matches if number is not None]
    methods = ("method of the thesis", "the tracker (`identifier: triads`)")
    off = np.array([frame.off_deg for frame in seen]).T
    values = {
        "found": len(first.shown.pixels),
        "hers": ", ".join(map(str, PRINTED_MATCHES)),
        "identified": ", ".join(map(str, identified)),
        "shared": len(set(PRINTED_MATCHES) & set(identified)),
        "printed": len(PRINTED_MATCHES),
        "errors": [{"method": method} | _errors(off_deg) for method, off_deg in zip(methods, off, strict=True)],
    }
    title = "The Vega image reproduced: from the pixels of the rendered camera to the centre"
    return section_of("yee1999/rendered_vega", title, values | _clusters(first) | _centres(seen))


def _errors(off_deg: FloatArray) -> Values:
    found = off_deg[np.isfinite(off_deg)]
    rms = float(np.sqrt(np.mean(found**2))) if len(found) else np.nan
    return {"rms": rms, "most": np.max(found, initial=0.0), "solved": len(found), "frames": len(off_deg)}


def _clusters(vega: SolvedFrame) -> Values:
    """The frame with its clusters numbered by size, and the HR numbers of matched ones."""
    clusters = []
    for number, ((x, y), match) in enumerate(zip(vega.shown.xy, vega.analysis.matches, strict=True), start=1):
        shift, align = (-11, "right") if x > 0.75 * vega.shown.picture.size_px[0] else (11, "left")
        star = {"centre": (x, y), "x": x + shift, "y": y, "align": align, "hr": match, "number": number}
        clusters.append(star | {"text": f"{number}" if match is None else f"{number}: HR {match}"})
    matched, others = ([c for c in clusters if (c["hr"] is None) == none] for none in (False, True))
    return {"image": vega.shown.frame.image, "matched": matched, "others": others}


def _centres(frames: Sequence[SolvedFrame]) -> Values:
    """Errors of the centres, arcseconds, by the thesis' method and by the tracker."""
    truth = frames[0].shown.truth.attitude
    methods = []
    for centres in (
        [f.analysis.plate.center_deg for f in frames if f.analysis.plate is not None],
        [(f.solution.ra_deg, f.solution.dec_deg) for f in frames if f.solution.solved],
    ):
        points = np.array(centres, dtype=float).reshape(-1, 2)
        east = (points[:, 0] - truth.ra_deg) * np.cos(np.radians(truth.dec_deg)) * 3600.0
        methods.append({"east": east, "north": (points[:, 1] - truth.dec_deg) * 3600.0})
    box = PRINTED_ERROR_DEG * 3600.0
    return {"methods": methods, "box": (box * np.array([-1, 1, 1, -1, -1]), box * np.array([-1, -1, 1, 1, -1]))}
