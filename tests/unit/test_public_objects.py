"""Public objects as a person meets them: short descriptions, cards for notebooks, completion, one frame as a whole."""

import base64
import dataclasses
import importlib
import io
import re
import tomllib
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from PIL import Image

import startracker
from simulator import Renderer, Scenario, render, run
from startracker import (
    Attitude,
    Camera,
    InputError,
    Observer,
    Solution,
    StarField,
    StarTracker,
    Status,
    TrackingSession,
)
from startracker import calibrate as calibrate_camera
from startracker.catalog import load_catalog

LONGEST = 300
"""Characters of a description: three lines of a terminal."""


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("cubesat_ideal")


@pytest.fixture(scope="module")
def exposure(scenario):
    return render(scenario, index=0)


@pytest.fixture(scope="module")
def tracker(exposure):
    return StarTracker(exposure[0].camera, magnitude_limit=6.5)


@pytest.fixture(scope="module")
def solution(exposure, tracker):
    return tracker.solve(exposure[0])


@pytest.fixture(scope="module")
def study(scenario):
    return run(scenario, trials=4)


@pytest.fixture(scope="module")
def objects(scenario, exposure, tracker, solution, study):
    frame, truth = exposure
    session = TrackingSession(tracker)
    before = repr(session)
    session.update(frame, 0.0)
    stars = solution.stars
    field = StarField("one", stars.xy, frame.camera.width, frame.camera.height, stars.flux, observer=frame.observer)
    calibration = calibrate_camera([field], fov_deg=12.9)
    sections = {f"scenario.{name}": getattr(scenario, name) for name in dir(scenario) if not name.startswith("_")}
    return {
        "scenario": scenario,
        **{name: value for name, value in sections.items() if not callable(value)},
        "frame": frame,
        "truth": truth,
        "sources": truth.sources,
        "renderer": Renderer(scenario),
        "camera": frame.camera,
        "distortion": frame.camera.distortion,
        "observer": frame.observer,
        "tracker": tracker,
        "guide": tracker.guide,
        "catalog": load_catalog("hipparcos"),
        "solution": solution,
        "without observer": tracker.solve(frame.image),
        "unsolved": tracker.solve(np.zeros((3, 3))),
        "long reason": Solution(Status.NO_MATCH, "no match " * 200),
        "attitude": solution.attitude,
        "stars": stars,
        "steps": solution.steps,
        "session before": before,
        "session": session,
        "state": session.state,
        "filter": session._filter,
        "innovation": session.state.innovation,
        "calibration": calibration,
        "calibrated field": calibration.fields[0],
        "field": field,
        "image": startracker.LoadedImage(np.zeros((40, 60), np.float32), 255.0, {}, ("a note",)),
        "study": study,
        "columns": study.columns,
    }


def test_descriptions_are_one_short_line(objects):
    for name, value in objects.items():
        text = repr(value)
        assert len(text) <= LONGEST, f"{name}: {len(text)} characters: {text}"
        assert "\n" not in text, name
        assert not re.search(r"array\(|object at 0x", text), f"{name}: {text}"


def test_the_description_of_a_solution_says_what_matters(solution, tracker, exposure):
    text = repr(solution)
    found = re.fullmatch(
        r"Solution\(solved, RA ([\d.]+)°, Dec ([+-][\d.]+)°, roll ([\d.]+)°, (\d+) stars, σ ([\d.]+)″/([\d.]+)″\)", text
    )
    assert found, text
    ra, dec, roll, stars, across, about = map(float, found.groups())
    assert (ra, dec) == pytest.approx((solution.ra_deg, solution.dec_deg), abs=5e-5)
    assert (roll, stars) == pytest.approx((solution.roll_deg, solution.matched), abs=5e-3)
    assert (across, about) == pytest.approx(solution.sigma_arcsec[1:], abs=0.06)
    assert "aberration not corrected" in repr(tracker.solve(exposure[0].image))
    assert repr(tracker.solve(np.zeros((2, 2)))).startswith("Solution(bad_image, 'the image is 2×2 pixels")


class _Page(HTMLParser):
    """Collects what a card refers to, and checks that its tags are closed."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.text = [], [], ""

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def card(value):
    page = _Page()
    page.feed(value._repr_html_())
    assert not page.open
    assert all(link.startswith("data:") for link in page.links), "a card must not need other files"
    assert "<script" not in value._repr_html_()
    # colours of text and background are the notebook's own, in light and in dark
    assert re.findall(r"(?<![-\w])(?:color|background):([^;\"]+)", value._repr_html_()) in (
        [],
        ["inherit", "transparent", "transparent"],
    )
    return page


def test_the_card_of_a_frame_shows_its_stars(exposure):
    frame, truth = exposure
    page = card(frame)
    assert frame.utc in page.text
    (link,) = page.links
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(link.partition(",")[2]))), dtype=float)
    brightest = truth.sources.xy[np.argmax(truth.sources.electrons)]
    row, column = (brightest[::-1] * shown.shape[0] / frame.image.shape[0]).astype(int)
    assert shown[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].max() > 200  # white
    assert np.median(shown) < 60  # the sky is dark
    assert len(frame._repr_html_()) < 200_000


def test_the_card_of_a_solution_charts_its_stars(solution, tracker):
    text = card(solution).text
    assert "corrected" in text
    assert "Tabit" in text  # the brightest star of the field by name
    dots = re.findall(r"<circle", solution._repr_html_())
    assert len(dots) == len(solution.centroids) + len(solution.stars) + 2  # and the key
    assert "<svg" not in tracker.solve(np.zeros((2, 2)))._repr_html_()


def test_the_card_of_a_study_answers_with_a_chart(study):
    page = card(study)
    assert study._repr_html_().count("<polyline") == 3
    for axis in ("roll", "pitch", "yaw"):
        assert axis in page.text
    assert "undecided" in page.text  # four trials decide nothing


def test_what_a_card_quotes_is_escaped():
    text = Solution(Status.NO_MATCH, "a < b & <script>alert(1)</script>")._repr_html_()
    assert "<script" not in text
    assert "a &lt; b &amp;" in text


def test_a_card_without_a_single_finite_pixel():
    image = startracker.LoadedImage(np.full((30, 30), np.nan, np.float32))
    assert "data:image/jpeg" in image._repr_html_()


STAGES = (
    *("calibration", "catalog", "centroid", "detection", "estimation"),
    *("fusion", "identification", "tracking", "trails"),
)
PACKAGES = ["simulator", "startracker", "simulator.scenario", *(f"startracker.{stage}" for stage in STAGES)]


@pytest.mark.parametrize("name", PACKAGES)
def test_completion_lists_the_public_names_only(name):
    package = importlib.import_module(name)
    assert dir(package) == sorted(package.__all__)
    assert all(getattr(package, public) is not None for public in package.__all__)


def test_completion_of_a_scenario_lists_keys_and_its_own_methods(scenario):
    names = dir(scenario)
    assert {"optics", "detector", "load", "changed", "to_yaml"} <= set(names)
    assert not [name for name in names if name.startswith(("model_", "_")) or name in ("json", "parse_obj", "copy")]
    assert "focal_length_mm" in dir(scenario.optics)


def test_packages_state_that_they_are_typed():
    for package in ("simulator", "startracker"):
        assert files(package).joinpath("py.typed").is_file()
    build = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    assert build["targets"]["wheel"]["packages"] == ["simulator", "startracker"]


def test_a_frame_brings_what_is_known_of_it(exposure, tracker, solution):
    frame, _ = exposure
    given = {"observer": frame.observer, "saturation_dn": frame.saturation_dn, "gain_e_per_dn": frame.gain_e_per_dn}
    by_hand = tracker.solve(frame.image, prior=frame.prior, prior_deg=frame.prior_deg, **given)
    assert np.array_equal(solution.attitude.quat, by_hand.attitude.quat)
    assert np.array_equal(solution.covariance, by_hand.covariance)
    assert solution.observer is frame.observer
    other = Observer(2000.0)
    assert tracker.solve(frame, observer=other).observer is other
    assert frame.prior is not None
    blind = tracker.solve(frame.image, **given)
    wrong = Attitude.from_radec_roll(frame.prior.ra_deg, -frame.prior.dec_deg, 0.0)
    assert by_hand.log_false_alarm < blind.log_false_alarm  # fewer attitudes to choose from: the evidence differs
    for made, same in (
        (tracker.solve(frame), by_hand),
        (tracker.solve(frame, prior_deg=frame.prior_deg), by_hand),
        (tracker.solve(frame, lost_in_space=True), blind),
        (tracker.solve(dataclasses.replace(frame, prior=None)), blind),
    ):
        assert np.array_equal(made.attitude.quat, same.attitude.quat)
        assert made.log_false_alarm == same.log_false_alarm
    assert tracker.solve(frame, prior=wrong).prior_contradicted
    assert not tracker.solve(frame).prior_contradicted
    with pytest.raises(InputError, match="exclude each other"):
        tracker.solve(frame, prior=wrong, lost_in_space=True)
    session = TrackingSession(tracker)
    session.update(frame, 0.0)
    tracked = session.update(dataclasses.replace(frame, image=frame.image + np.uint16(1)), 0.1)
    assert tracked.solved
    assert tracked.aberration_corrected
    with pytest.raises(InputError, match=r"startracker\.Observer\(.*got 'here'"):
        tracker.solve(frame.image, observer="here")


def test_without_an_observer_the_covariance_includes_the_aberration(exposure, tracker, solution):
    frame, truth = exposure
    for given in ({}, {"time": frame.observer.epoch_jyear}):
        blind = tracker.solve(frame.image, saturation_dn=frame.saturation_dn, **given)
        assert not blind.aberration_corrected
        assert "aberration (up to 26″) is not corrected" in startracker.explain.as_text(blind.steps)
        error = truth.attitude.rotation_vector_to(blind.attitude)
        assert error @ np.linalg.solve(blind.covariance, error) < 12.0  # χ² of 3 degrees of freedom
        assert max(blind.sigma_arcsec[:2]) > 10.0
    assert max(solution.sigma_arcsec[:2]) < 1.0
    assert "aberration" not in startracker.explain.as_text(solution.steps)


def test_a_solution_as_coordinates_of_astropy(exposure, solution):
    frame, _ = exposure
    assert solution.skycoord.separation(solution.attitude.skycoord).arcsec == 0.0
    assert np.allclose(solution.rotation.as_matrix(), solution.attitude.as_matrix())
    xy = solution.stars.xy[:5]
    by_wcs = solution.wcs.pixel_to_world(*xy.T)
    radec = solution.radec_of(xy)
    off = by_wcs.separation(coordinates(radec)).arcsec
    assert off.max() < 0.05  # the error of the polynomials
    # catalogue positions, without aberration: those of the true stars, to the frame's centroid errors
    catalog = load_catalog("hipparcos")
    row = {int(number): k for k, number in enumerate(catalog.id)}
    chosen = [row[int(number)] for number in solution.stars.catalog_id[:5]]
    truth_deg = startracker.geometry.attitude.direction_to_radec(
        catalog.directions(frame.observer.epoch_jyear, frame.observer.position_au)[chosen]
    )
    assert coordinates(np.degrees(truth_deg).T).separation(by_wcs).arcsec.max() < 5.0
    assert solution.pixel_of(by_wcs) == pytest.approx(xy, abs=0.01)
    assert Solution(Status.NO_MATCH, "").skycoord is None
    with pytest.raises(InputError, match="not solved"):
        _ = Solution(Status.NO_MATCH, "").wcs


def coordinates(radec_deg):
    from astropy.coordinates import SkyCoord

    return SkyCoord(*np.asarray(radec_deg).T, unit="deg")


def test_the_sample_photograph_is_solved():
    """It ships with the package, so that the first photograph of a reader needs no download."""
    file = startracker.sample_photo()
    assert file.stat().st_size < 500_000
    image = startracker.read_image(file)
    found = startracker.solve_unknown_fov(image)
    rendered = startracker.Attitude.from_radec_roll(83.0, 1.0, 12.0)
    assert np.degrees(found.attitude.angle_to(rendered)) < 0.03  # aberration, 20″, and 14″ of centroids
    assert found.fov_deg == pytest.approx(42.54, abs=0.02)
    assert "Rigel" in found._repr_html_()


def test_studies_as_tables(study, monkeypatch):
    table = study.to_astropy()
    assert len(table) == study.summary["trials"]
    assert table["error_roll_deg"].unit == u.deg
    assert table["rate_deg_s"].unit == u.deg / u.s
    assert table["residual_rms_px"].unit == u.pix
    assert table["solve_ms"].unit == u.ms
    assert table["status"].unit is None
    assert table.meta["seed"] == 1
    assert np.array_equal(np.asarray(table["error_roll_deg"]), study.columns["error_roll_deg"])
    pandas = pytest.importorskip("pandas")
    frame = study.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == table.colnames
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(InputError, match=r"pandas is not installed: pip install pandas"):
        study.to_pandas()


def test_scenarios_take_quantities(scenario):
    changed = {"optics.aperture_mm": 2 * u.cm, "detector.exposure_s": 150 * u.ms, "detector.width": np.int64(512)}
    loaded = Scenario.load("cubesat_ideal", changed)
    assert (loaded.optics.aperture_mm, loaded.detector.exposure_s, loaded.detector.width) == (20.0, 0.15, 512)
    assert scenario.changed(changed) == loaded
    assert (
        Scenario.load("cubesat_ideal", ["optics.aperture_mm=20", "detector.exposure_s=0.15", "detector.width=512"])
        == loaded
    )
    with pytest.raises(InputError, match=r"^optics\.aperture_mm: is in 's'; it must be in mm[^\n]*$"):
        Scenario.load("cubesat_ideal", {"optics.aperture_mm": 2 * u.s})
    with pytest.raises(InputError, match=r"optics\.aperture_mm is in 's'; it must be in mm"):
        scenario.changed({"optics.aperture_mm": 2 * u.s})


def test_quantities_of_the_tracker(exposure, tracker, solution):
    assert Camera.from_fov(600 * u.arcmin, 512, 512) == Camera.from_fov(10.0, 512, 512)
    with pytest.raises(InputError, match=r"fov_deg is in 'm'; it must be in deg"):
        Camera.from_fov(10 * u.m, 512, 512)
    session = TrackingSession(tracker, exposure_s=200 * u.ms)
    assert session.exposure_s == pytest.approx(0.2)
    session.reset(solution.rotation, 6 * u.arcmin, [0.0, 0.0, 0.06] * u.deg / u.s)
    assert session.rate_rad_s == pytest.approx([0.0, 0.0, np.radians(0.06)])
    assert session.update(exposure[0], 500 * u.ms).solved
    with pytest.raises(InputError, match=r"t_s is in 'm'; it must be in s"):
        session.update(exposure[0], 3 * u.m)
    with pytest.raises(InputError, match=r"prior=Attitude\.from_skycoord"):
        tracker.solve(exposure[0], prior=solution.skycoord)
    assert tracker.solve(exposure[0], prior=solution.rotation, prior_deg=0.5 * u.deg).solved
