"""The two hypotheses of an image: what is measured, and in which order."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from startracker import Camera, front_end
from startracker.centroid.result import Centroids
from startracker.detection import Background, Spots
from startracker.errors import InputError
from startracker.front_end import (
    Clock,
    FoundStars,
    _background,
    _detect,
    _FrameStars,
    _lines,
    find_stars,
    star_hypotheses,
)
from startracker.inputs import (
    CheckedImage,
    GivenImage,
)
from startracker.settings import CentroidSettings, DetectionSettings
from startracker.solution import Status
from startracker.trace import Step


# ---------------------------------------------------------------------- stages
def spots_at(*xy, streak=(0.0, 0.0), **changes):
    xy = np.array(xy, float).reshape(-1, 2)
    x, y = np.rint(xy).astype(np.int64).T
    none, lines = np.zeros(len(xy), bool), np.tile(np.array(streak, float), (len(xy), 1))
    spots = Spots(x, y, np.ones(len(xy)), np.full(len(xy), 9), none, none, xy, lines)
    return replace(spots, **changes)


def centroids(image, background, spots, settings, gain):
    count = len(spots)
    covariance = np.tile(np.array([[0.01, 0.001], [0.001, 0.03]]), (count, 1, 1))
    return Centroids(spots.centre, spots.flux, covariance, np.arange(count) == 0, np.eye(2) * 1e-4, misfit=1.5)


def run(image, spots=None, camera=None, **given):
    spots = spots_at((5.0, 6.0), (20.0, 9.0)) if spots is None else spots
    trace = []
    found = list(
        star_hypotheses(
            GivenImage(image, **given),
            lambda *_: spots,
            centroids,
            DetectionSettings(),
            given.pop("centroid", CentroidSettings()),
            Clock(),
            camera,
            trace,
        )
    )
    return found, trace


def sky(seed=1, shape=(40, 60)):
    return np.random.default_rng(seed).normal(100.0, 2.0, shape).astype(np.float32)


@pytest.mark.parametrize(
    ("image", "status", "words"),
    [
        (np.zeros(4), Status.BAD_IMAGE, "two dimensions"),
        (np.full((4, 5), 7.0, np.float32), Status.SATURATED, "100 % of the pixels are at or above 7"),
        (np.zeros((4, 5)), Status.NO_STARS, "every pixel is 0"),
    ],
)
def test_images_without_stars(image, status, words):
    (found,), _ = run(image)
    assert (found.status, len(found.stars.xy)) == (status, 0)
    assert words in found.reason


def test_half_of_the_pixels_may_be_saturated():
    image = sky()
    image[:20] = 200.0  # half
    (found,), _ = run(image, saturation_dn=200.0)
    assert (found.status, found.saturated_share, found.saturation_dn) == (None, 0.5, 200.0)
    image[20, 0] = 200.0
    (found,), _ = run(image, saturation_dn=200.0)
    assert found.status is Status.SATURATED


def test_an_image_of_another_shape_than_the_camera():
    (found,), _ = run(sky(), camera=Camera.from_fov(10.0, 40, 60))
    assert (found.status, "the image is 60×40 pixels" in found.reason) == (Status.BAD_IMAGE, True)


def test_errors_of_a_stage_are_those_of_the_image():
    def fails(*_):
        raise InputError("this setting is wrong")

    found = list(star_hypotheses(GivenImage(sky()), fails, centroids, DetectionSettings(), CentroidSettings(), Clock()))
    assert [(one.status, one.reason) for one in found] == [(Status.BAD_IMAGE, "this setting is wrong")]


def test_stars_have_their_errors():
    """Variance on one axis is the mean of both; the error of the camera model is added to all, if there is any."""
    for model_px, more in ((0.0, 0.0), (0.2, 0.04)):
        settings = CentroidSettings(camera_model_px=model_px)
        stars = find_stars(
            GivenImage(sky()),
            lambda *_: spots_at((5.0, 6.0), (20.0, 9.0)),
            centroids,
            DetectionSettings(),
            settings,
            Clock(),
        )
        np.testing.assert_allclose(stars.stars.variance_px2, [0.02 + more] * 2)
        np.testing.assert_allclose(stars.stars.covariance_px2[1], [[0.01 + more, 0.001], [0.001, 0.03 + more]])
        np.testing.assert_array_equal(stars.stars.common_px2, np.eye(2) * 1e-4)
        assert (stars.saturated, stars.trailed, stars.stars.misfit) == (1, False, 1.5)
        assert stars.stars.light.threshold_sigma == DetectionSettings().threshold_sigma
        np.testing.assert_array_equal(stars.stars.light.image, sky())


def test_a_frame_of_hot_pixels_is_searched_again_without_them():
    """The mask changes the background, so that both stages run again; what was masked is counted."""
    rng = np.random.default_rng(5)
    image = sky(shape=(120, 160))
    y, x = rng.integers(1, 119, 400), rng.integers(1, 159, 400)
    image[y, x] = 900.0
    hot = len(np.unique(y * 160 + x))
    seen = []

    def detect(pixels, background, settings, saturation):
        seen.append((pixels, background))
        crowd = len(seen) == 1
        return spots_at((5.0, 6.0), rejected={"hot pixel": 5 if crowd else 0, "streak": 2})

    found = CheckedImage(image, 0.0, 900.0, 0.0, 900.0)
    clock = Clock()
    pixels, background, spots = _detect(found, detect, DetectionSettings(), None, clock)
    assert len(seen) == 2
    assert seen[0][0] is image
    assert np.isfinite(seen[1][0]).all()  # filled for the detector
    assert np.isnan(pixels).sum() == spots.rejected["hot pixel"] > 0.9 * hot
    assert spots.rejected["streak"] == 2
    assert background is seen[1][1] is not seen[0][1]
    assert set(clock.laps) == {"background", "detection"}
    gaps = replace(found, gaps=True, pixels=np.where(image > 800.0, np.float32(np.nan), image))
    seen[:] = [None]
    pixels, _, spots = _detect(gaps, detect, DetectionSettings(), None, Clock())
    assert np.isfinite(seen[1][0]).all()
    assert np.isnan(pixels).sum() == hot
    assert spots.rejected["hot pixel"] == 0


def test_a_background_follows_structure_where_there_is_some():
    y, x = np.mgrid[:200, :240]
    smooth = sky(shape=(200, 240))
    assert len(_background(smooth, DetectionSettings()).level_plane.lines) == 3  # tiles of 64 px
    waves = smooth + 60.0 * np.sin(x / 8.0) * np.sin(y / 8.0)
    assert len(_background(waves.astype(np.float32), DetectionSettings()).level_plane.lines) == 50  # bins of 4 px


def test_times_of_stages(monkeypatch):
    now = iter([10.0, 10.0, 10.5, 12.0, 15.0])
    monkeypatch.setattr(front_end, "clock", lambda: next(now))
    clock = Clock(start=next(now), last=next(now))
    clock.lap("one")
    clock.lap("two")
    assert clock.laps == {"one": 500.0, "two": 1500.0}
    assert clock.times_ms() == {"one": 500.0, "two": 1500.0, "total": 5000.0}


# ---------------------------------------------------------------------- points and trails
CAMERA = Camera.from_fov(10.0, 60, 40)


def frame_of(spots, camera=CAMERA):
    image = sky()
    flat = Background(np.full_like(image, 100.0), np.full_like(image, 2.0))
    found = CheckedImage(image, 90.0, 110.0, 0.0, 110.0)
    settings = DetectionSettings(), CentroidSettings()
    return _FrameStars(GivenImage(image), found, image, flat, spots, centroids, *settings, Clock(), camera, [])


class Fake:
    """The parts of the front end that fit trails, replaced by answers."""

    def __init__(self, monkeypatch, *, trails, win=True):
        self.known, self.searched, self.compared = [], 0, []
        stars = centroids(None, None, spots_at((30.0, 20.0), (29.5, 19.5)), None, None)
        self.trails = SimpleNamespace(centroids=stars, motion=np.array([3.0, 4.0, 0.01])) if trails else None
        monkeypatch.setattr(front_end, "find_trails", self._find)
        monkeypatch.setattr(front_end, "find_trailed", self._search)
        monkeypatch.setattr(front_end, "mid_exposure", lambda trails, camera: trails.centroids)
        monkeypatch.setattr(front_end, "trails_win", self._win)
        self.win = win

    def _find(self, image, background, settings, saturation, gain, lines, direction, camera):
        self.known.append(lines)
        return self.trails

    def _search(self, *_):
        self.searched += 1
        return spots_at((1.0, 2.0), streak=(6.0, 8.0))

    def _win(self, centre, lengths, *_):
        self.compared.append((centre, lengths))
        return self.win


STREAKS = {"streak": (6.0, 2.0)}


@pytest.mark.parametrize(
    ("spots", "trails", "win", "order"),
    [
        (spots_at((5, 6), (9, 9)), True, True, [False, True]),  # nothing points to trails
        (spots_at((5, 6), (9, 9)), False, True, [False]),
        (spots_at((5, 6), (9, 9), direction_rad=0.3), True, True, [True, False]),
        (spots_at((5, 6), (9, 9), direction_rad=0.3), True, False, [False, True]),
        (spots_at((5, 6), (9, 9), direction_rad=0.3), False, True, [False]),
        (spots_at((5, 6), rejected={"streak": 4}), True, True, [True, False]),
        (spots_at((5, 6), rejected={"streak": 3}), True, True, [False, True]),
        (spots_at(*[(5, 6)] * 24, rejected={"streak": 5}), True, True, [False, True]),  # a quarter of the stars
        (spots_at(*[(5, 6)] * 24, rejected={"streak": 6}), True, True, [True, False]),
        (spots_at((5, 6), rejected={"streak": 9}, other=spots_at((1, 1), **STREAKS)), True, True, [False, True]),
        (spots_at((5, 6), **STREAKS), True, False, [True, True]),  # its own measure of the same streaks
        (spots_at((5, 6), **STREAKS), False, False, [True, True]),  # as the detector found them
    ],
)
def test_the_more_likely_hypothesis_comes_first(monkeypatch, spots, trails, win, order):
    Fake(monkeypatch, trails=trails, win=win)
    found = list(frame_of(spots).hypotheses())
    assert [one.trailed for one in found] == order


def test_points_beside_streaks_are_those_of_the_detector(monkeypatch):
    Fake(monkeypatch, trails=True)
    other = spots_at((1.0, 2.0), (3.0, 4.0), (5.0, 6.0))
    first, second = frame_of(spots_at((5, 6), other=other, **STREAKS)).hypotheses()
    assert (first.trailed, second.trailed) == (True, False)
    np.testing.assert_array_equal(second.stars.xy, other.centre)
    np.testing.assert_array_equal(first.stars.xy, [[30.0, 20.0], [29.5, 19.5]])


def test_without_a_camera_there_is_one_hypothesis(monkeypatch):
    fake = Fake(monkeypatch, trails=True)
    (found,) = frame_of(spots_at((5, 6), direction_rad=0.3), None).hypotheses()
    assert not found.trailed
    assert not fake.known
    (found,) = frame_of(spots_at((5, 6), **STREAKS), None).hypotheses()
    assert found.trailed


def test_trails_start_from_what_the_detector_knows(monkeypatch):
    """Its streaks, or those of its other hypothesis, or those of a search at half the threshold; none if it only knows
    a direction."""
    for spots, searched, lines in (
        (spots_at((5, 6), **STREAKS), 0, [[5.0, 6.0, 3.0, 1.0]]),
        (spots_at((5, 6), other=spots_at((7, 8), **STREAKS)), 0, [[7.0, 8.0, 3.0, 1.0]]),
        (spots_at((5, 6)), 1, [[1.0, 2.0, 3.0, 4.0]]),
        (spots_at((5, 6), direction_rad=0.3), 0, np.empty((0, 4))),
    ):
        fake = Fake(monkeypatch, trails=True)
        assert frame_of(spots).trails is fake.trails
        assert fake.searched == searched
        np.testing.assert_array_equal(fake.known[0], lines)
    for nothing in (None, replace(spots_at((5, 6)), streak=None), replace(spots_at((5, 6), **STREAKS), centre=None)):
        assert _lines(nothing).shape == (0, 4)
    assert _lines(spots_at((5, 6))).shape == (0, 4)


def test_trails_are_compared_by_their_lengths_at_their_places(monkeypatch):
    """Motion (a − c y, b + c x) about the middle of the image, (29.5, 19.5)."""
    fake = Fake(monkeypatch, trails=True)
    assert frame_of(spots_at((5, 6), direction_rad=0.3))._trails_win()
    centre, lengths = fake.compared[0]
    np.testing.assert_array_equal(centre, [[30.0, 20.0], [29.5, 19.5]])
    np.testing.assert_allclose(lengths, [[3.0 - 0.01 * 0.5, 4.0 + 0.01 * 0.5], [3.0, 4.0]])
    frame = frame_of(spots_at((5, 6)))
    list(frame.hypotheses())
    steps = [step for step in (part() for part in frame.trace) if isinstance(step, Step)]
    assert "2 trails with a common motion, 5.0 px at the image centre" in [step.text for step in steps]


def test_what_an_image_that_cannot_be_used_holds():
    none = FoundStars()
    assert none.stars.xy.shape == (0, 2)
    assert (len(none.stars.flux), len(none.stars.variance_px2)) == (0, 0)
    assert (none.trailed, none.saturated, none.status, none.saturated_share) == (False, 0, None, 0.0)
