"""Recommendations of the thesis (sections 4.2.2, 4.3.2 and 7.2), implemented: planet or star, raw pixels first, uniform
pixels."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.theses.detectors.round_regions import find_round_regions
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.blur import THESIS_SIGMA
from simulator.theses.greyling1995.segmentation import mars_diameters_arcsec
from simulator.theses.greyling1995.star_images import star_stamps
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.centroid import METHODS as CENTROIDERS
from startracker.centroid import Centroids
from startracker.core import FloatArray, IntArray
from startracker.detection import Background, Spots, estimate
from startracker.estimation import METHODS as ESTIMATORS
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification import match_groups
from startracker.identification.observed import Identification, Observed, as_prior
from startracker.settings import CentroidSettings
from startracker.solution import Status

PIXEL_ARCSEC = 10.0 / 512 * 3600.0
FALSE_PLANETS = 0.01
"""Fraction of the stars that the test may classify as planets."""
PRNU = 0.03
""""Several percent of the peak response", section 4.3.2."""
_RAW_SIGMA_PX = 1.0 / math.sqrt(6.0)
"""Position error of a brightest pixel on one axis: within half a pixel, and occasionally off by one pixel because of
noise."""
_STEP_PX = 1e-4


# ---------------------------------------------------------------------- a planet or a star
def disk_stamp(diameter_px: float, offset_px: float = 0.0, sigma_px: float = THESIS_SIGMA) -> FloatArray:
    """Image (5, 5) of a uniform disk (0: a star) through the defocused lens, integrated over the pixels, with the same
    sum as a star's. `offset_px` is along x from the centre of the central pixel."""
    if diameter_px == 0.0:
        return np.asarray(star_stamps([offset_px], sigma_px, integrated=True)[0])
    rings, turns = 6, 24
    radius = 0.5 * diameter_px * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
    way = np.stack([np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()], axis=1)
    path = (way, np.full(len(way), 1.0 / len(way)))
    return np.asarray(star_stamps([offset_px], sigma_px, path=path, integrated=True)[0])


def _direction(diameter_px: float, sigma_px: float, *, sigma_known: bool) -> FloatArray:
    """Difference between a disk and a star, (5, 5), orthogonal to changes of the star's unknowns.

    The unknowns are brightness, position, background and, if it is not calibrated, σ of the lens.
    """
    star = disk_stamp(0.0, 0.0, sigma_px)
    shift = (disk_stamp(0.0, _STEP_PX, sigma_px) - disk_stamp(0.0, -_STEP_PX, sigma_px)) / (2 * _STEP_PX)
    unknown = [star, shift, shift.T, np.ones_like(star)]
    if not sigma_known:
        unknown.append(disk_stamp(0.0, 0.0, sigma_px + _STEP_PX) - disk_stamp(0.0, 0.0, sigma_px - _STEP_PX))
    basis, _ = np.linalg.qr(np.stack([u.ravel() for u in unknown], axis=1))
    difference = (disk_stamp(diameter_px, 0.0, sigma_px) - star).ravel()
    return np.asarray(difference - basis @ (basis.T @ difference)).reshape(star.shape)


def planet_detectability(diameter_px: float, snr_db: float, *, sigma_known: bool = True) -> float:
    """Fraction of planets detected if 1 % of the stars are classified as planets: Φ(d' − z₀.₉₉), d' = |difference| /
    noise.

    The SNR is 20 log₁₀ of a star's brightest pixel over the standard deviation of a pixel. `sigma_known`: σ of the lens
    is calibrated; otherwise it is another unknown of the image.
    """
    direction = _direction(diameter_px, THESIS_SIGMA, sigma_known=sigma_known)
    separation = float(np.linalg.norm(direction)) / 10.0 ** (-snr_db / 20.0)
    return float(norm.cdf(separation - norm.isf(FALSE_PLANETS)))


def least_snr_db(diameter_px: float, share: float = 0.99, *, sigma_known: bool = True) -> float:
    """Minimum SNR, dB, at which this fraction of planets is detected."""
    length = float(np.linalg.norm(_direction(diameter_px, THESIS_SIGMA, sigma_known=sigma_known)))
    return 20.0 * math.log10((norm.ppf(share) + norm.isf(FALSE_PLANETS)) / length)


# ---------------------------------------------------------------------- raw pixels first
class Order(NamedTuple):
    """Results of one order of the stages: number of identified frames, and of those with a boresight error above one
    arcminute; centroids computed per frame; errors (S,) of the boresight of solved frames."""

    frames: int
    solved: int
    wrong: int
    centroids: float
    errors_arcsec: FloatArray


Matched = tuple[IntArray, IntArray]
"""Candidate and guide star of each pair."""


def _centroids_first(
    spots: Spots, measure: Callable[[Spots], Centroids], identify: Callable[..., Matched]
) -> tuple[FloatArray, IntArray, int]:
    """Centroids of all candidates, then identification: positions, guide stars, number of centroids computed."""
    found = measure(spots)
    seen, stars = identify(found.xy, found.flux, np.sqrt(np.trace(found.covariance, axis1=1, axis2=2) / 2.0))
    return found.xy[seen], stars, len(spots)


def _raw_pixels_first(
    spots: Spots, measure: Callable[[Spots], Centroids], identify: Callable[..., Matched]
) -> tuple[FloatArray, IntArray, int]:
    """Identification by brightest pixels, then centroids of the matched candidates."""
    peaks = np.stack([spots.x_peak, spots.y_peak], axis=1).astype(float)
    seen, stars = identify(peaks, spots.flux, np.full(len(spots), _RAW_SIGMA_PX))
    if not len(seen):
        return np.empty((0, 2)), stars, len(spots)
    return measure(spots.take(seen)).xy, stars, len(seen)


_ORDERS = {"centroids first": _centroids_first, "raw pixels first": _raw_pixels_first}


@cache
def raw_pixels_first(frames: int = 12) -> dict[str, Order]:
    """The scenario with the rules of the thesis solved in both orders: centroids first, or brightest pixels first.

    With raw pixels the stars are identified by their brightest pixels, and centroids are only computed for matched
    ones.
    """
    scenario = Scenario.load("greyling1995")
    renderer, settings = Renderer(scenario), scenario.tracker
    camera = renderer.camera
    guide = GuideDatabase.build(load_catalog("bsc5"), camera, settings.magnitude_limit, settings.identification)
    results: dict[str, list[tuple[float, int]]] = {name: [] for name in _ORDERS}
    for index in range(frames):
        frame, truth = renderer.frame(index)
        image = np.asarray(frame.image, dtype=np.float32)
        background = estimate(image, settings.detection.background_tile_px)
        spots = find_round_regions(image, background, settings.detection)
        prior, sky = as_prior(frame.prior, frame.prior_deg), guide.apparent_to(frame.observer)
        measure = partial(_moments, image, background, settings.centroid)
        identify = partial(
            _matched, camera, partial(match_groups, guide=sky, settings=settings.identification, prior=prior)
        )
        for name, solve in _ORDERS.items():
            xy, stars, count = solve(spots, measure, identify)
            error = math.nan
            if len(stars):
                turned = ESTIMATORS["svd"](camera.unproject(xy), sky.directions[stars], np.full(len(stars), 1e-5))
                error = 3600.0 * _apart_deg(Attitude.from_matrix(turned.matrix), truth.attitude)
            results[name].append((error, count))
    return {name: _order(solved) for name, solved in results.items()}


def _moments(image: NDArray[np.float32], background: Background, settings: CentroidSettings, spots: Spots) -> Centroids:
    return CENTROIDERS["moment"](image, background, spots, settings, None)


def _matched(
    camera: Camera, identify: Callable[[Observed], Identification], xy: FloatArray, flux: FloatArray, sigma: FloatArray
) -> Matched:
    """Pairs of an identification from positions, errors in pixels; empty if not solved."""
    answer = identify(Observed(camera.unproject(xy), flux, sigma * camera.pixel_rad))
    seen, stars = answer.pairs.T if answer.status is Status.SOLVED else np.empty((2, 0), np.int64)
    return seen, stars


def _apart_deg(one: Attitude, other: Attitude) -> float:
    return math.degrees(math.acos(min(1.0, float(one.boresight @ other.boresight))))


def _order(results: list[tuple[float, int]]) -> Order:
    errors, counts = (np.array(column) for column in zip(*results, strict=True))
    solved = errors[np.isfinite(errors)]
    return Order(len(results), len(solved), int(np.count_nonzero(solved > 60.0)), float(counts.mean()), solved)


# ---------------------------------------------------------------------- equal pixels
def prnu_error_px(prnu: float = PRNU, sigma_px: float = THESIS_SIGMA, offset_px: float = 0.0) -> float:
    """Standard deviation of a first moment over 5 × 5, pixels, caused by non-uniform pixels: p √(Σ (i − m)² f²) / Σ
    f."""
    stamp = star_stamps([offset_px], sigma_px, integrated=True)[0]
    steps = np.arange(-2.0, 3.0)
    mean = (stamp * steps).sum() / stamp.sum()
    return float(prnu * np.sqrt(((steps - mean) ** 2 * stamp**2).sum()) / stamp.sum())


# ---------------------------------------------------------------------- the section
def section(frames: int = 12) -> Section:
    """Rows of the three recommendations, and the figure of the planet test."""
    mars = mars_diameters_arcsec()[1] / PIXEL_ARCSEC
    planets = {"Mars, 25″": mars, "Jupiter, 50″": 50.0 / PIXEL_ARCSEC, "Venus, 64″": 64.0 / PIXEL_ARCSEC}
    first, raw = raw_pixels_first(frames).values()
    values = {
        "planets": [
            {
                "name": name,
                "size": size,
                "percent": 100 * planet_detectability(size, 40.0),
                "known_db": least_snr_db(size),
                "unknown_db": least_snr_db(size, sigma_known=False),
            }
            for name, size in planets.items()
        ],
        "first": first,
        "first_arcsec": np.median(first.errors_arcsec),
        "raw": raw,
        "raw_arcsec": np.median(raw.errors_arcsec),
        "prnu_px": prnu_error_px(),
        "mapped_px": prnu_error_px(1.0 / math.sqrt(16 * 40_000)),
    }
    values |= {"curves": partial(_planet_curves, planets)}
    return section_of("greyling1995/recommendations", "Chapter 7.2: what the thesis recommends", values)


def _planet_curves(planets: dict[str, float]) -> Values:
    snr, sizes = np.arange(20.0, 101.0, 2.0), np.geomspace(0.1, 4.0, 30)
    found = [
        {
            "label": name if known else None,
            "percents": [100 * planet_detectability(size, s, sigma_known=known) for s in snr],
        }
        for name, size in planets.items()
        for known in (True, False)
    ]
    known, unknown = ([least_snr_db(s, sigma_known=which) for s in sizes] for which in (True, False))
    return {"snr_db": snr, "curves": found, "sizes": sizes, "known": known, "unknown": unknown}
