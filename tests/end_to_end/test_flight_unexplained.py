"""The flight build asks what an attitude leaves unexplained, as `StarTracker` does: torn lists and images."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from benchmarks.doubtful_lists import FIELDS, doubtful_list
from benchmarks.integrity import is_wrong
from simulator.checks import load_scenario
from simulator.study.exported_c.targets import HOST
from simulator.study.flight.engine import FlightEngine
from simulator.study.flight.library import FlightLibrary, compiled_library
from simulator.study.trials.trial import TrialRunner, solve_frame
from startracker import Attitude, Camera, Observer, StarTracker, Status
from startracker.flight.design import DetectorNumbers, FlightDesign

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine (Debian: gcc)"),
]

CAMERA = Camera.from_fov(15.0, 1024, 1024)
BUILDS = [("fixed", "adaptive"), ("float", "adaptive"), ("fixed", "triads")]
LISTS = 12
UNEXPLAINED = "bright stars and bright guide stars are unexplained"
PLEIADES = Attitude([-0.243072916, -0.490397774, -0.836901087, 0.004706456])
"""Of the list in `tests/unit/data/pleiades_knot.csv`, by construction."""


@pytest.fixture(scope="module")
def reference():
    return StarTracker(CAMERA, magnitude_limit=6.5)


@pytest.fixture(scope="module")
def observer(reference):
    """Who sees the guide stars where the catalogue has them."""
    return Observer(reference.guide.epoch_jyear, np.zeros(3))


def engine_of(tracker, folder, arithmetic="fixed", identifier="adaptive"):
    numbers = DetectorNumbers(3.3, 13.0, 4083)
    design = FlightDesign(tracker.camera, tracker.guide, numbers, 0.9, arithmetic=arithmetic, identifier=identifier)
    return FlightEngine(design, tracker.guide, FlightLibrary(compiled_library(design, folder)))


@pytest.fixture(scope="module", params=BUILDS, ids=lambda build: "-".join(build))
def engine(request, reference, tmp_path_factory):
    return engine_of(reference, tmp_path_factory.mktemp("library"), *request.param)


def random_attitude(rng):
    return Attitude.from_radec_roll(rng.uniform(0.0, 360.0), rng.uniform(-60.0, 60.0), rng.uniform(0.0, 360.0))


def field(tracker, attitude, rng, noise_px=0.1):
    """Positions and fluxes of the guide stars of a field, brightest first."""
    index, _, xy = tracker.guide.in_field(attitude.as_matrix(), -5.0)
    xy = xy + noise_px * rng.standard_normal(xy.shape)
    kept = CAMERA.contains(xy)
    return xy[kept], 10.0 ** (-0.4 * tracker.guide.v_mag[index][kept])


def two_fields(tracker, rng, share):
    """The right of a share of the image's width is of another field."""
    attitude = random_attitude(rng)
    one, other = field(tracker, attitude, rng), field(tracker, random_attitude(rng), rng)
    here, there = one[0][:, 0] < share * CAMERA.width, other[0][:, 0] >= share * CAMERA.width
    xy, flux = (np.concatenate([a[here], b[there]]) for a, b in zip(one, other, strict=True))
    order = np.argsort(-flux)
    return xy[order], flux[order], attitude


def agrees(ours, theirs, attitude):
    """Whether both refuse, or both are right."""
    if ours.solved:
        assert ours.attitude.angle_to(attitude) < np.radians(0.02)
    return (ours.status, ours.solved) == (theirs.status, theirs.solved)


@pytest.mark.parametrize("number", range(LISTS))
def test_a_list_whose_halves_are_swapped_is_refused(engine, reference, observer, number):
    rng = np.random.default_rng(number)
    attitude = random_attitude(rng)
    xy, flux = field(reference, attitude, rng)
    torn = xy.copy()
    torn[:, 0] = np.where(xy[:, 0] < 511.5, xy[:, 0] + 512.0, xy[:, 0] - 512.0)
    whole = engine.solve_centroids(xy, flux, observer=observer)
    assert whole.solved
    refused = engine.solve_centroids(torn, flux, observer=observer)
    assert refused.status is Status.NO_MATCH
    assert refused.attitude is None
    assert UNEXPLAINED in refused.reason
    prior = engine.solve_centroids(torn, flux, prior=attitude, prior_deg=0.1, observer=observer)
    assert prior.status is Status.NO_MATCH


@pytest.mark.parametrize("share", [0.5, 0.7, 0.8])
def test_lists_of_two_fields_are_refused_where_the_reference_refuses_them(engine, reference, observer, share):
    """At 0.8 a fifth of the image is of another field; if that has few stars it is accepted by both. One list in
    twelve may be decided otherwise, where the limits are met by a single star."""
    rng, same, refused, another = np.random.default_rng(100), 0, 0, 0
    for _ in range(LISTS):
        xy, flux, attitude = two_fields(reference, rng, share)
        xy, flux = xy[:60], flux[:60]
        ours = engine.solve_centroids(xy, flux, observer=observer)
        same += agrees(ours, reference.solve_centroids(xy, flux, sigma_px=0.1, observer=observer), attitude)
        refused += ours.status is Status.NO_MATCH
        another += "another field" in ours.reason
    assert same >= LISTS - 1
    assert refused >= (LISTS - 1 if share == 0.5 else LISTS // 3)
    assert another > 0 or share < 0.8


def test_of_fifteen_bright_stars_eight_that_are_elsewhere(engine, reference, observer):
    """On one side of the image, which is refused unless most stars there are matched; and anywhere, as false stars."""
    refused = 0
    for number in range(LISTS):
        rng = np.random.default_rng(200 + number)
        attitude = random_attitude(rng)
        xy, flux = field(reference, attitude, rng)
        xy, flux = xy[:20], flux[:20]
        right = np.argsort(xy[:15, 0])[-8:]
        side, anywhere = xy.copy(), xy.copy()
        side[right] = rng.uniform((float(xy[right, 0].min()), 20.0), 1003.0, (8, 2))
        anywhere[rng.permutation(15)[:8]] = rng.uniform(20.0, 1003.0, (8, 2))
        for moved in (side, anywhere):
            ours = engine.solve_centroids(moved, flux, observer=observer)
            theirs = reference.solve_centroids(moved, flux, sigma_px=0.1, observer=observer)
            assert theirs.solved or not ours.solved
            assert agrees(ours, theirs, attitude) or engine.design.identifier == "triads"  # which finds fewer
            assert moved is side or UNEXPLAINED not in ours.reason
            refused += not ours.solved
    assert refused >= LISTS // 2


def test_hidden_and_added_stars_are_no_contradiction(engine, reference, observer):
    """Half of the image without stars, as the Moon or the Earth leave it; false stars brighter than all; a clump."""
    for number in range(LISTS):
        rng = np.random.default_rng(300 + number)
        attitude = random_attitude(rng)
        xy, flux = field(reference, attitude, rng)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        kept = (xy - 511.5) @ (np.cos(angle), np.sin(angle)) < 0.0
        lists = [(xy[kept], flux[kept])]
        for false in (rng.uniform(0.0, 1023.0, (15, 2)), rng.uniform(0.0, 200.0, (15, 2))):
            lists.append((np.concatenate([false, xy]), np.concatenate([np.full(15, 2.0 * flux[0]), flux])))
        for one in lists:
            ours = engine.solve_centroids(*one, observer=observer)
            assert agrees(ours, ours, attitude)
            assert ours.solved or engine.design.identifier == "triads", ours.reason
            assert UNEXPLAINED not in ours.reason


def test_a_knot_of_stars_and_a_wrong_focal_length(engine, observer):
    """Lists of open clusters, seen by cameras whose focal length is up to 10 % off: a knot fixes neither roll nor
    scale, and of its field most bright stars are unmatched. List 46 was accepted 0.2° and 7 σ off."""
    fields = [row[0] for row in FIELDS]
    given = [one for one in (doubtful_list("clusters", index) for index in range(60)) if fields[one.field] == 15.0]
    assert len(given) > 4
    for one in given:
        solution = engine.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px or 0.15, observer=observer)
        assert not is_wrong(one, solution)[0]
    knot = np.loadtxt(Path(__file__).parents[1] / "unit" / "data" / "pleiades_knot.csv")
    solution = engine.solve_centroids(knot[:, :2], knot[:, 2])
    assert not solution.solved or solution.attitude.angle_to(PLEIADES) < np.radians(0.02)


@pytest.fixture(scope="module")
def runner():
    return TrialRunner(load_scenario("cubesat_ideal", ["tracker.engine=flight", "study.sampling=sky"]))


@pytest.mark.parametrize("number", range(6))
def test_an_image_torn_at_half_its_width_is_refused(runner, number):
    frame, _ = runner.renderer.frame(number)
    assert solve_frame(runner.tracker, frame).solved
    torn = np.roll(frame.image, frame.image.shape[1] // 2, axis=1)
    refused = runner.tracker.solve(torn, observer=frame.observer)
    assert refused.status is Status.NO_MATCH
    assert refused.attitude is None


def test_an_image_of_two_fields_is_refused(runner):
    """Of which the left is of one frame and the right of another one."""
    frames = [runner.renderer.frame(number)[0] for number in range(4)]
    half = frames[0].image.shape[1] // 2
    for one, other in pairwise(frames):
        image = np.concatenate([one.image[:, :half], other.image[:, half:]], axis=1)
        assert runner.tracker.solve(image, observer=one.observer).status is Status.NO_MATCH
