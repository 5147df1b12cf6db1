"""Region growing (Greyling 1995, section 4.2): search pattern, and success rate with noise and alien objects."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from simulator.constants import RADIUS_KM
from simulator.mission.clock import Clock
from simulator.optics.psf import Psf
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from simulator.sky.ephemeris import barycentric_position_au
from simulator.theses.detectors.region_growing import grow_objects, grow_regions
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.blur import THESIS_SIGMA
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.core import AU_KM, FloatArray
from startracker.detection import Background, Spots, estimate
from startracker.settings import DetectionSettings

Rule: TypeAlias = Literal["first", "brightest", "tracker"]

SIDE_PX = 512
STARS_SOUGHT = 8
FULL_SCALE_DN = 255.0
"""Full scale of an 8-bit converter."""

MIN_PIXELS, MAX_PIXELS = 7, 36
THRESHOLD_DN = FULL_SCALE_DN * math.exp(-MAX_PIXELS / (2.0 * math.pi * THESIS_SIGMA**2))
"""The thesis states that the threshold is crucial, but not its value; `grow.m` uses every pixel above 0. At this
threshold, 5.8 DN, a star that just reaches full scale has 36 pixels above it, 2πσ² ln(I₀/T), and is still accepted."""

_STARS, _CLEARANCE_PX = 12, 24.0
_FAINTEST, _BRIGHTEST = 0.15, 0.8
_NEAR_PX = 2.0
_MANY = 20_000

SNR_DB = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0, 28.0, 29.0, 30.0, 31.0, 32.0, 33.0, 34.0, 35.0, 40.0, 50.0, 60.0)


class Success(NamedTuple):
    """Results of a set of frames: fraction of stars found, fraction of frames in which all eight objects are stars, and
    number per frame of the eight objects that are not stars. The SNR is full scale over the amplitude of the noise."""

    snr_db: float
    frames: int
    stars_found: float
    clean: float
    false_objects: float


def thesis_settings(threshold: float) -> DetectionSettings:
    """The thesis' limits: 7 to 36 pixels, second moments within 0.7 to 1.3, every third pixel."""
    return DetectionSettings(
        threshold_sigma=threshold,
        min_pixels=MIN_PIXELS,
        max_pixels=MAX_PIXELS,
        max_axis_ratio=1.3 / 0.7,
        max_stars=_MANY,
        search_step_px=3,
        reject_hits=False,
        isolation=0.0,
    )


def _scene(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Image (512, 512), DN, of twelve stars of random position and brightness (peaks 0.15 to 0.8 of full scale), and
    their positions (12, 2)."""
    positions: list[FloatArray] = []
    while len(positions) < _STARS:
        position = rng.uniform(16.0, SIDE_PX - 17.0, 2)
        if all(np.hypot(*(position - other)) > _CLEARANCE_PX for other in positions):
            positions.append(position)
    xy = np.array(positions)
    peak = rng.uniform(_FAINTEST, _BRIGHTEST, _STARS) * FULL_SCALE_DN
    psf = Psf("gaussian", THESIS_SIGMA, THESIS_SIGMA, THESIS_SIGMA)
    return render_stars((SIDE_PX, SIDE_PX), xy[:, None], np.ones(1), peak / psf.peak, psf), xy


def success_rate(
    snr_db: float,
    frames: int = 10,
    *,
    rule: Rule = "first",
    aliens: bool = False,
) -> Success:
    """Success of region growing on random frames of 10° × 10°.

    `snr_db` is 20 log₁₀ of full scale over the amplitude A of the noise, uniform between ±A. The objects kept are the
    first eight in reading order, as in the thesis; the eight brightest; or those with the tracker's settings:
    background and noise measured on the frame, threshold at five times the noise. Alien objects are smaller than 7 or
    larger than 36 pixels: ten hot pixels, ten short tracks, and the Moon.
    """
    amplitude = FULL_SCALE_DN * 10.0 ** (-snr_db / 20.0)
    found, clean, false = 0, 0, 0
    for trial in range(frames):
        image, xy = _scene(stream(1, "greyling1995 field", trial))
        rng = stream(1, "greyling1995 field noise", trial)
        if aliens:
            xy = _add_aliens(image, xy, stream(1, "greyling1995 aliens", trial))
        image += rng.uniform(-amplitude, amplitude, image.shape)
        spots = _objects(np.clip(np.rint(image), 0.0, FULL_SCALE_DN), rule)
        order = np.lexsort((spots.x_peak, spots.y_peak)) if rule == "first" else np.arange(len(spots))
        kept = order[:STARS_SOUGHT]
        away = np.hypot(spots.x_peak[kept, None] - xy[:, 0], spots.y_peak[kept, None] - xy[:, 1])
        right = int(np.count_nonzero(away.min(axis=1, initial=np.inf) < _NEAR_PX))
        found += right
        false += len(kept) - right
        clean += right == STARS_SOUGHT
    return Success(snr_db, frames, found / (STARS_SOUGHT * frames), clean / frames, false / frames)


def _objects(image: FloatArray, rule: Rule) -> Spots:
    """Objects of a digitised frame, with the threshold of the thesis or the tracker's settings."""
    frame = image.astype(np.float32)
    if rule == "tracker":
        return grow_regions(frame, estimate(frame), DetectionSettings(), FULL_SCALE_DN)
    background = Background(np.zeros_like(frame), np.ones_like(frame))
    return grow_regions(frame, background, thesis_settings(THRESHOLD_DN), FULL_SCALE_DN)


def _add_aliens(image: FloatArray, xy: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Add hot pixels, tracks of 2 to 6 pixels and a Moon of 0.5° to an image; returns the positions of unaffected
    stars."""
    radius = 0.25 / 10.0 * SIDE_PX
    rows, columns = np.mgrid[:SIDE_PX, :SIDE_PX]
    centre = rng.uniform(40.0, SIDE_PX - 41.0, 2)
    image[np.hypot(columns - centre[0], rows - centre[1]) <= radius] = FULL_SCALE_DN
    for k in range(20):
        x, y = rng.integers(16, SIDE_PX - 16, 2)
        if np.hypot(xy[:, 0] - x, xy[:, 1] - y).min() < _CLEARANCE_PX or np.hypot(*(centre - (x, y))) < 2.0 * radius:
            continue
        length = 1 if k < 10 else int(rng.integers(2, 7))
        image[y, x : x + length] = FULL_SCALE_DN
    return np.asarray(xy[np.hypot(*(xy - centre).T) > radius + _CLEARANCE_PX])


def mars_diameters_arcsec() -> tuple[float, float]:
    """Minimum and maximum apparent diameter of Mars from the Earth over 17 years from 1990, from DE421."""
    clock = Clock(datetime(1990, 1, 1, tzinfo=UTC))
    t_s = np.arange(0.0, 365.25 * 17, 5.0) * 86_400.0
    away_au = barycentric_position_au("Mars", clock, t_s) - barycentric_position_au("Earth", clock, t_s)
    diameter = 2.0 * np.degrees(np.arcsin(RADIUS_KM["Mars"] / AU_KM / np.linalg.norm(away_au, axis=1))) * 3600.0
    return float(diameter.min()), float(diameter.max())


def section(frames: int = 10) -> Section:
    """Section 4.2: rows, and a figure of the success rate by SNR, with the given number of random frames per SNR."""
    values = _pattern_values() | _success_values(frames) | _alien_values()
    return section_of("greyling1995/segmentation", "Chapter 4.2: star detection by region growing", values)


def _pattern_values() -> Values:
    """Pixels examined by the detector: all in an empty image of 512 × 512, and in a small one with a bright pixel."""
    formula = ((SIDE_PX - 2) / 3) ** 2
    empty = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    side = 21
    level, limit = np.zeros((side, side), np.float32), np.ones((side, side), np.float32)
    looked = np.zeros((side, side))
    for row, column in np.ndindex(side, side):
        image = np.zeros((side, side), np.float32)
        image[row, column] = 10.0
        looked[row, column] = len(grow_objects(image, level, limit, 3, np.inf)[0])
    return {
        "formula": formula,
        "visited": int(grow_objects(empty, empty, empty + 1.0, 3, np.inf)[1]),
        "percent": 100.0 * formula / SIDE_PX**2,
        "looked": np.argwhere(looked).T + 1,
    }


def _success_values(frames: int) -> Values:
    rates = [success_rate(snr, frames) for snr in SNR_DB]
    ours = [success_rate(snr, frames, rule="tracker") for snr in SNR_DB]
    odd = success_rate(60.0, frames, aliens=True)
    return {
        "frames": frames,
        "quiet_percent": 100 * min(rate.clean for rate in rates if rate.snr_db >= 40.0),
        "knee": _half(rates),
        "own": _half(ours),
        "threshold_dn": THRESHOLD_DN,
        "alien_percent": 100 * odd.clean,
        "odd": odd,
        "snr_db": SNR_DB,
        "clean": [100 * rate.clean for rate in rates],
        "found": [100 * rate.stars_found for rate in rates],
        "ours": [100 * rate.clean for rate in ours],
    }


def _half(rates: list[Success]) -> float:
    """SNR at which half of the frames are without error, interpolated."""
    return float(np.interp(0.5, [rate.clean for rate in rates], [rate.snr_db for rate in rates]))


def _alien_values() -> Values:
    least, most = mars_diameters_arcsec()
    radius_px = 0.5 * most / (10.0 / SIDE_PX * 3600.0)
    return {
        "mars_arcsec": (least, most),
        "mars_px": 2 * radius_px,
        "sigma": THESIS_SIGMA,
        "wider": math.sqrt(THESIS_SIGMA**2 + 0.25 * radius_px**2),
        "cosmic_mv": 2000 * 1.4e-3,
    }
