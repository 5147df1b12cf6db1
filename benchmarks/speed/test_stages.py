"""Each stage and the whole trial, at three sizes and three numbers of stars."""

from functools import cache

import numpy as np
import pytest

from benchmarks.speed.workload import SIZES, STARS, even_scenario, expose, renderer, scene
from simulator.study.star_tracker import build_tracker
from simulator.study.trials.trial import TrialRunner
from startracker import TrackingSession
from startracker.centroid import METHODS as CENTROIDERS
from startracker.detection import METHODS as DETECTORS
from startracker.detection import estimate
from startracker.estimation import wahba_svd
from startracker.identification import METHODS as IDENTIFIERS
from startracker.identification.observed import Observed
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings

ROUNDS = {512: 25, 1024: 12, 2048: 6}
KEPT = DetectionSettings(max_stars=1000)
MEASURED = CentroidSettings(flat_field_error=0.01)
NOISE_PX = 0.1
by_stars = pytest.mark.parametrize("stars", STARS)
by_size = pytest.mark.parametrize("size", SIZES)


@cache
def frame(size, stars, index=0):
    """Image as float32, and what a stage must know of it."""
    made = renderer(even_scenario(size, stars))
    readout = expose(made, scene(made, index), index)
    return np.asarray(readout.image, np.float32), readout.saturation_dn, readout.gain_e_per_dn


@cache
def tracker(stars):
    made = renderer(even_scenario(1024, stars))
    return build_tracker(made.scenario, made.camera)


@cache
def true_stars(stars, index=0):
    """Guide stars on the image: pixels, directions, flux, and the attitude."""
    made = renderer(even_scenario(1024, stars))
    matrix = scene(made, index).pointing.camera.as_matrix()
    guide = tracker(stars).guide
    which, _, xy = guide.in_field(matrix)
    return xy, guide.directions[which], 10.0 ** (-0.4 * guide.v_mag[which])


def measured(stars, index):
    """The same as a camera measures them."""
    xy, reference, flux = true_stars(stars, index % 4)
    return xy + NOISE_PX * np.random.default_rng(index).normal(size=xy.shape), reference, flux


def observed(stars, index):
    xy, reference, flux = measured(stars, index)
    camera = tracker(stars).camera
    return Observed(camera.unproject(xy), flux, np.full(len(xy), NOISE_PX * camera.pixel_rad)), reference


@by_stars
def test_scene(timed, stars):
    made = renderer(even_scenario(1024, stars))
    assert len(timed(lambda index: scene(made, index), lambda index: index, 40).rows)


@by_size
@by_stars
def test_render(timed, size, stars):
    made = renderer(even_scenario(size, stars))
    readout = timed(lambda given: expose(made, *given), lambda index: (scene(made, index), index), ROUNDS[size])
    assert readout.image.shape == (size, size)


@by_size
@by_stars
def test_detect(timed, size, stars):
    def find(given):
        pixels, saturation_dn, _ = given
        return DETECTORS["components"](pixels, estimate(pixels), KEPT, saturation_dn)

    assert len(timed(find, lambda _: frame(size, stars), ROUNDS[size])) > 0.5 * stars


@by_size
@by_stars
def test_centroid(timed, size, stars):
    def prepared(_):
        pixels, saturation_dn, gain = frame(size, stars)
        background = estimate(pixels)
        return pixels, background, DETECTORS["components"](pixels, background, KEPT, saturation_dn), gain

    def centroid(given):
        pixels, background, spots, gain = given
        return CENTROIDERS["maximum_likelihood"](pixels, background, spots, MEASURED, gain)

    assert len(timed(centroid, prepared, ROUNDS[size])) > 0.5 * stars


@by_stars
def test_identify(timed, stars):
    guide, settings = tracker(stars).guide, IdentificationSettings()
    found = timed(
        lambda given: IDENTIFIERS["adaptive"](given[0], guide, settings, None),
        lambda index: observed(stars, index),
        40 if stars < 1000 else 12,
    )
    assert str(found.status) == "solved"


@by_stars
def test_estimate(timed, stars):
    estimate_ = timed(
        lambda given: wahba_svd(given[0].vectors, given[1], given[0].sigma_rad),
        lambda index: observed(stars, index),
        100,
    )
    assert np.isfinite(estimate_.covariance).all()


@by_stars
def test_track(timed, stars):
    session = TrackingSession(tracker(stars))
    for start in range(3):
        session.update_centroids(measured(stars, 4 * start)[0], None, 0.1 * start)
    timed(
        lambda given: session.update_centroids(given[0], given[1], given[2]),
        lambda index: (*measured(stars, 4 * index)[::2], 0.1 * (index + 3)),
        200,
        20,
    )
    assert session.state.mode == "tracking"


@by_size
@by_stars
def test_trial(timed, size, stars):
    runner = TrialRunner(even_scenario(size, stars))
    row = timed(runner.run, lambda index: index, ROUNDS[size], 3)
    assert row["status"] in ("solved", "no_match", "ambiguous", "too_few_stars")
