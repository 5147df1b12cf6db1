"""A photograph of unknown scale step by step: evidence by its formula, what is tried, and what is answered."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from startracker import Attitude, Camera, InputError, Status, blind, free_search
from startracker.blind import _bands, _check_arguments, _points_of_list, _variance_of
from startracker.free_search import FreeSearch, _about
from startracker.geometry.distortion import Distortion
from startracker.identification.clustering_null import log_excess_density
from startracker.identification.unknown_scale import free_scale
from startracker.identification.unknown_scale.free_scale import (
    FreeFit,
    _sane,
    depth,
    field_deg,
    grow,
    log_evidence,
    magnitude_density,
    magnitude_ratio,
    weigh,
    without_rational,
)
from startracker.identification.unknown_scale.quads import all_stars
from startracker.observer import Observer
from startracker.settings import IdentificationSettings

CAMERA = Camera.from_fov(20.0, 1000, 800)
ATTITUDE = Attitude.from_radec_roll(85.0, 5.0, 10.0)


@pytest.fixture(scope="module")
def guide():
    return all_stars("hipparcos").brightest(3000)


def field(guide, camera=CAMERA, count=30, noise=0.1, seed=1):
    """Positions of the brightest stars of a field, their rows in the guide stars, and magnitudes."""
    index, _, xy = guide.in_field(ATTITUDE.as_matrix(), 0.0, camera)
    rng = np.random.default_rng(seed)
    return xy[:count] + rng.normal(0.0, noise, (min(count, len(xy)), 2)), index[:count], guide.v_mag[index[:count]]


# ---------------------------------------------------------------------- evidence
@pytest.mark.parametrize("anchors", [2, 4])
def test_evidence_of_a_photograph(anchors):
    """Σ ln(d + (1 − d) gain) without the largest terms, for the best share of distractors, less ln of their number."""
    rng = np.random.default_rng(anchors)
    sigma, ratio = rng.uniform(0.5, 2.0, 12), rng.uniform(0.2, 3.0, 12)
    distance = np.where(np.arange(12) < 8, rng.rayleigh(1.0, 12), np.inf)
    found = log_evidence(distance, sigma, 8e5, 40, ratio, anchors)
    density = norm.pdf(distance, scale=sigma) / (math.sqrt(2.0 * math.pi) * sigma)
    sums = []
    for share in (0.1, 0.3, 0.6, 0.9):
        terms = sorted(np.log(share + (1.0 - share) * ratio * 8e5 / 40 * density))
        sums.append(sum(terms[: 12 - anchors]))
    assert found == pytest.approx(max(sums) - math.log(4.0))
    assert log_evidence(distance, sigma, 8e5, 0, ratio) == -math.inf
    assert log_evidence(distance, sigma, 8e5, 40, ratio) == log_evidence(distance, sigma, 8e5, 40, ratio, 2)


def test_magnitudes_of_a_photograph():
    """A core of 0.3 mag, three tenths in wings of 1.5 mag, and a floor; compared with the field's, from three stars."""
    difference = np.array([0.0, 0.2, -1.0, 5.0])
    expected = 0.7 * norm.pdf(difference, scale=0.3) + 0.3 * norm.pdf(difference, scale=1.5) + 1e-3
    np.testing.assert_allclose(magnitude_density(difference), expected)
    rng = np.random.default_rng(3)
    field_v, matched = rng.uniform(2.0, 7.0, 20), np.array([3.0, np.nan, 4.0, 5.5, np.nan])
    magnitude = np.array([-7.0, -5.0, -6.1, -4.6, -2.0])
    found = magnitude_ratio(magnitude, matched, field_v)
    seen = np.isfinite(matched)
    calibrated = magnitude - np.median((magnitude - matched)[seen])
    by_chance = magnitude_density(calibrated[seen][:, None] - field_v).mean(axis=1)
    np.testing.assert_allclose(found[seen], magnitude_density((calibrated - matched)[seen]) / by_chance)
    assert (found[~seen] == 1.0).all()
    matched[0] = np.nan
    assert (magnitude_ratio(magnitude, matched, field_v) == 1.0).all()


def test_the_evidence_of_a_field_is_the_best_of_three_widths(guide):
    """Matched within 4.5 widths to the guide stars of the field, at most twice the points and ten; with six at least,
    less the price of crowded points."""
    xy, rows, v_mag = field(guide, noise=0.5)
    rng = np.random.default_rng(4)
    xy = np.concatenate([xy, rng.uniform(0.0, 800.0, (10, 2))])
    magnitude = np.concatenate([v_mag - 12.0, rng.uniform(-8.0, -6.0, 10)])
    excess = log_excess_density(xy, 8e5)
    index, _, positions = guide.in_field(ATTITUDE.as_matrix(), 2.0, CAMERA)
    index, positions = index[: 2 * len(xy) + 10], positions[: 2 * len(xy) + 10]
    for used in (None, magnitude):
        values = {}
        for width in (0.3, 1.0, 3.0):
            away = np.hypot(*(xy[:, None] - positions).transpose(2, 0, 1))
            near = np.where(away.min(axis=1) <= 4.5 * width, away.argmin(axis=1), -1)
            if len(set(near[near >= 0])) < (near >= 0).sum():  # a guide star belongs to the nearest point
                for g in set(near[near >= 0]):
                    rivals = np.flatnonzero(near == g)
                    near[rivals[away[rivals, g] > away[rivals, g].min()]] = -1
            seen = near >= 0
            ratio = np.ones(len(xy))
            if used is not None:
                ratio = magnitude_ratio(used, np.where(seen, guide.v_mag[index[near]], np.nan), guide.v_mag[index])
            distance = np.where(seen, away[np.arange(len(xy)), near], np.inf)
            value = log_evidence(distance, np.full(len(xy), width), 8e5, len(index), ratio, 4) - math.log(3.0)
            price = max(0.0, *[row[seen].sum() for row in excess])
            values[width] = value - price, np.flatnonzero(seen)
        found, pairs = weigh(CAMERA, ATTITUDE.as_matrix(), xy, used, guide, 4, excess)
        best = max(values.values(), key=lambda one: one[0])
        assert found == pytest.approx(best[0], rel=1e-9)
        assert pairs[:, 0].tolist() == best[1].tolist()
        assert (pairs[pairs[:, 0] < 30, 1] == rows[pairs[pairs[:, 0] < 30, 0]]).mean() > 0.9
    nothing, none = weigh(CAMERA, ATTITUDE.as_matrix(), xy[:5], None, guide, 4, excess[:, :5])
    assert (nothing, none.shape) == (-math.inf, (0, 2))
    assert weigh(CAMERA, ATTITUDE.as_matrix(), field(guide, count=6, noise=0.0)[0], None, guide, 4, excess[:, :6])[
        1
    ].shape == (6, 2)


# ---------------------------------------------------------------------- lens and field
@pytest.mark.parametrize(
    ("stars", "height", "fov_deg"), [(30, 800, 20.0), (30, 2000, 20.0), (300, 800, 10.0), (5, 800, 60.0)]
)
def test_as_many_stars_as_three_times_the_density_of_the_image(stars, height, fov_deg):
    side = math.radians(fov_deg)
    area = side * side * min(height / 1000, 1.0)
    assert depth(stars, 1000, height, fov_deg) == max(500, int(3.0 * (stars + 5) * 4.0 * math.pi / area))


def test_the_field_across_the_width_has_its_distortion():
    for camera in (CAMERA, replace(CAMERA, distortion=Distortion(k1=-0.2)), replace(CAMERA, cx=300.0)):
        left, right = camera.unproject([[-0.5, camera.cy], [999.5, camera.cy]])
        assert field_deg(camera) == pytest.approx(math.degrees(2.0 * math.asin(np.linalg.norm(left - right) / 2.0)))


def test_lenses_that_are_sane(monkeypatch):
    """Below 150° and 0.11 of barrel, 0.5 of pincushion distortion in the farthest corner."""

    def pinhole(corner, bend=0.0, cx=499.5):
        focal = math.hypot(max(cx, 999 - cx), 399.5) / math.sqrt(corner)
        return replace(CAMERA, fx=focal, fy=focal, cx=cx, distortion=Distortion(k1=bend / corner))

    assert _sane(pinhole(13.9))
    assert not _sane(pinhole(14.1))
    for bend, good in ((-0.109, True), (-0.111, False), (0.499, True), (0.501, False)):
        assert _sane(pinhole(0.5, bend)) is good
        assert _sane(pinhole(0.5, bend, 100.0)) is good
        assert _sane(pinhole(0.5, bend, 900.0)) is good
    tall = replace(CAMERA, fx=1e3, fy=100.0, cy=300.0)
    assert (0.4995**2 + (499.0 / 100.0) ** 2 < 14.0) is _sane(tall)
    fisheye = Camera.from_fov(150.0, 1000, 800, projection="fisheye")
    for answer in (True, False):
        monkeypatch.setattr(free_scale, "is_one_to_one", lambda camera, answer=answer: camera is fisheye and answer)
        assert _sane(fisheye) is answer


def test_a_lens_without_its_denominator():
    rational = replace(CAMERA, distortion=Distortion(k1=-0.1, k2=0.01, k4=0.02, k5=0.03, k6=0.04))
    assert without_rational(rational).distortion == Distortion(k1=-0.1, k2=0.01)
    equidistant = Camera.from_fov(100.0, 1000, 800, projection="equidistant")
    assert without_rational(equidistant).projection == "fisheye"


def test_a_fit_grows_from_a_pattern(guide):
    """From a focal length and a roll that are off: only the surroundings of the pattern match at first."""
    truth = replace(CAMERA, distortion=Distortion(k1=-0.1))
    xy, rows, _ = field(guide, truth, 60)
    near = np.argsort(np.hypot(*(xy - [400.0, 400.0]).T))[:4]
    centre, extent = xy[near].mean(axis=0), 80.0
    start = replace(CAMERA, fx=CAMERA.fx * 1.005, fy=CAMERA.fy * 1.005)
    matrix = free_scale.attitude_of(start, xy[near], guide.directions[rows[near]])
    away = np.hypot(*(xy - centre).T)
    camera, found, covariance, rms, pairs = grow(
        start, matrix, xy, guide, centre, 2.0 + 0.012 * np.maximum(away, extent)
    )
    assert camera.fx == pytest.approx(truth.fx, rel=2e-3)
    assert camera.distortion.k1 == pytest.approx(-0.1, abs=0.05)
    assert math.degrees(Attitude.from_matrix(found).angle_to(ATTITUDE)) < 0.01
    assert rms == pytest.approx(0.1, rel=0.3)
    assert np.array_equal(rows[pairs[:, 0]], pairs[:, 1])
    assert len(pairs) == len(xy) > 30
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert grow(start, matrix, xy[near], guide, centre, np.full(4, 9.0)) is None
    far = Attitude.from_radec_roll(200.0, -60.0, 0.0).as_matrix()
    assert grow(start, far, xy, guide, centre, np.full(len(xy), 2.0)) is None


# ---------------------------------------------------------------------- the search
SETTINGS = IdentificationSettings(false_alarm_rate=1e-6)


def search(count=30, **changes):
    xy = np.random.default_rng(5).uniform(0.0, 799.0, (count, 2))
    values = {"flux": np.arange(count, 0.0, -1.0)} | changes
    return FreeSearch(
        xy,
        values.pop("flux"),
        1000,
        800,
        "hipparcos",
        values.pop("settings", SETTINGS),
        values.pop("observer", None),
        **values,
    )


def fit_of(evidence, stars=9, camera=CAMERA):
    pairs = np.column_stack([np.arange(stars), np.arange(stars)])
    return FreeFit(camera, ATTITUDE.as_matrix(), pairs, np.eye(3) * 1e-10, 0.3, evidence)


def test_long_lists_are_cut_to_the_brightest():
    variance = np.full(30, 0.01)
    cut = search(settings=replace(SETTINGS, max_centroids=20), variance_px2=variance)
    assert (len(cut.xy), len(cut.flux), len(cut.variance_px2), cut._excess.shape[1]) == (20, 20, 20, 20)
    np.testing.assert_array_equal(cut.flux, np.arange(30.0, 10.0, -1.0))
    plain = search(settings=replace(SETTINGS, max_centroids=20), flux=None)
    assert (len(plain.xy), plain.flux, plain.variance_px2) == (20, None, None)
    np.testing.assert_allclose(cut._excess, log_excess_density(cut.xy, 8e5))
    np.testing.assert_allclose(search()._magnitudes(), -2.5 * np.log10(np.arange(30.0, 0.0, -1.0)))
    assert plain._magnitudes() is None


def test_distortions_that_are_assumed():
    """None, then strong barrel; of a poor field another with wider tolerance; of a known lens its own, twice."""
    assert search(21)._passes() == ((0.0, 1.0), (-0.06, 1.0))
    assert search(20)._passes() == ((0.0, 1.0), (-0.06, 1.0), (-0.04, 2.0))
    assert search(20, rough=CAMERA)._passes() == ((0.0, 1.0), (0.0, 2.0))
    assumed = search()._assumed(20.0, -1, -0.06)
    corner2 = (CAMERA.cx / CAMERA.fx) ** 2 + (CAMERA.cy / CAMERA.fy) ** 2
    assert assumed.distortion.k1 == pytest.approx(-0.06 / corner2)
    assert (assumed.parity, assumed.fx) == (-1, CAMERA.fx)
    assert search()._assumed(20.0, 1, 0.0) == CAMERA
    rough = replace(CAMERA, distortion=Distortion(k1=-0.1, k4=0.1))
    known = search(rough=rough)._assumed(55.0, -1, -0.06)
    assert known == replace(rough, parity=-1, distortion=Distortion(k1=-0.1))
    assert _about(CAMERA, 0.05) == pytest.approx(
        (0.95 * CAMERA.undistorted_fov_deg, CAMERA.undistorted_fov_deg, 1.05 * CAMERA.undistorted_fov_deg)
    )


def test_guide_stars_as_deep_as_needed():
    """A power of two, so that frames share them; exactly as many for the positions of an observer."""
    sky = all_stars("hipparcos")
    assert [len(search()._guide(sky, n)) for n in (500, 512, 513, 1)] == [512, 512, 1024, 1]
    assert len(search(observer=Observer(2025.0))._guide(sky, 513)) == 513


@pytest.mark.parametrize(
    ("evidence", "trials", "status", "words"),
    [
        (None, 7, Status.NO_MATCH, "30 stars detected; none of 7 similar patterns matches 6 of them"),
        (-1.0, 7, Status.NO_MATCH, "the best of 7 patterns matches 9 of 30 stars: no better than chance"),
        (math.log(7.0) - 0.01, 7, Status.NO_MATCH, "no better than chance"),
        (math.log(7.0) + 0.01, 7, Status.AMBIGUOUS, "false-alarm probability 1e+00, above the limit"),
        (math.log(7e6) - 0.01, 7, Status.AMBIGUOUS, "false-alarm probability 1e-06, above the limit"),
        (math.log(7e6) + 0.01, 7, Status.SOLVED, "answered"),
        (math.log(1e6) + 0.01, 0, Status.SOLVED, "answered"),
    ],
)
def test_the_verdict_on_the_best_fit(monkeypatch, evidence, trials, status, words):
    monkeypatch.setattr(
        FreeSearch, "_answer", lambda self, fit, sky: free_search.Solution(Status.SOLVED, "answered", attitude=ATTITUDE)
    )
    one = search(trials=trials)
    best = None if evidence is None else fit_of(evidence)
    found = one._verdict(best, None)
    assert (found.status, words in found.reason) == (status, True)
    cut = one._cut_short(best, None)
    if status is Status.SOLVED:
        assert cut.reason == "answered"
    else:
        assert cut.status is Status.SEARCH_LIMIT
        assert cut.reason.endswith(f"until then: {found.reason}")
        assert found.log_false_alarm == (one._log_chance(best) if status is Status.AMBIGUOUS else 0.0)


def searched(monkeypatch, one, fits, bands=((10.0, 11.0, 12.0), (20.0, 22.0, 24.0)), sides=(1, -1)):
    """Run the search with one pattern for each band and side, of which each has a fit; what was tried."""
    tried, answers = [], iter(fits)

    def candidates(xy, camera, index, low, high, widen):
        tried.append(
            (
                round(camera.undistorted_fov_deg, 6),
                camera.parity,
                camera.distortion.k1 != 0.0,
                round(low, 6),
                round(high, 6),
                widen,
            )
        )
        yield camera, np.zeros((2, 4), np.int64), np.zeros(2), 50.0

    monkeypatch.setattr(free_scale, "candidates", candidates)
    monkeypatch.setattr(free_search, "quad_index", lambda catalog: None)
    monkeypatch.setattr(FreeSearch, "_try", lambda *_: next(answers))
    best, cut_short = one._best(bands, sides, all_stars("hipparcos").brightest(500))
    return best, cut_short, tried


def test_bands_and_sides_are_searched_in_turn(monkeypatch):
    one = search()
    best, cut_short, tried = searched(monkeypatch, one, [None, fit_of(3.0), fit_of(2.0), None] + [None] * 4)
    assert (best.log_evidence, cut_short, one.trials, one.operations) == (3.0, False, 8, 8 * 50_000)
    assert [row[:3] for row in tried] == [
        (fov, side, bent) for bent in (False, True) for fov in (11.0, 22.0) for side in (1, -1)
    ]
    assert tried[0][3:] == (round(10.0 / 11.0, 6), round(12.0 / 11.0, 6), 1.0)
    poor = search(20)
    assert len(searched(monkeypatch, poor, [None] * 12)[2]) == 12


def test_a_search_ends_beyond_doubt_or_after_a_pass_that_is_accepted(monkeypatch):
    limit = math.log(1e6)
    one = search()
    _, _, tried = searched(monkeypatch, one, [None, fit_of(limit + math.log(2.0) + 7.01)])
    assert len(tried) == 2
    one = search()
    _, _, tried = searched(monkeypatch, one, [fit_of(limit + math.log(4.0) + 5.0), None, None, None])
    assert len(tried) == 4
    one = search()
    best, _, tried = searched(monkeypatch, one, [fit_of(limit), fit_of(limit), None, None] + [None] * 4)
    assert len(tried) == 8
    assert best.log_evidence == limit


def test_a_search_ends_with_its_operations(monkeypatch):
    one = search(settings=replace(SETTINGS, max_operations_free_scale=100_000))
    best, cut_short, _ = searched(monkeypatch, one, [fit_of(1.0), None, None])
    assert (best.log_evidence, cut_short, one.operations, one.trials) == (1.0, True, 100_000, 2)


def test_few_stars_are_not_searched():
    for count, status in ((0, Status.NO_STARS), (5, Status.TOO_FEW_STARS)):
        found = search(count).run(((10.0, 11.0, 12.0),), (1,))
        assert (found.status, found.operations) == (status, 0)
        assert f"{count} stars detected; 6 are needed" in found.reason


def test_a_pattern_that_does_not_agree_with_its_attitude_is_not_grown(monkeypatch, guide):
    """By more than 2 px and 3 % of its extent, or if a star is beyond the fold of the lens."""
    xy, rows, v_mag = field(guide)
    one = FreeSearch(xy, 10.0 ** (-0.4 * v_mag), 1000, 800, "hipparcos", SETTINGS, None)
    pattern, extent, gates = np.stack([np.arange(4), rows[:4]]), 100.0, []

    def grown(camera, matrix, points, guides, centre, gate):
        gates.append(gate)
        return camera, ATTITUDE.as_matrix(), np.eye(3), 0.5, None

    monkeypatch.setattr(free_scale, "grow", grown)
    centre = xy[:4].mean(axis=0)
    found = one._try(CAMERA, pattern, centre, extent, guide.directions, guide)
    np.testing.assert_allclose(gates[0], 2.0 + 0.012 * np.maximum(np.hypot(*(xy - centre).T), 100.0))
    assert one.operations == 500_000 + 10 * 30 * 70
    value, pairs = weigh(CAMERA, ATTITUDE.as_matrix(), xy, one._magnitudes(), guide, 4, one._excess)
    assert (found.log_evidence, found.rms_px) == (value, 0.5)
    np.testing.assert_array_equal(found.pairs, pairs)
    for stretch, tried in ((1.0, True), (60.0, False)):
        one.xy = xy.copy()
        one.xy[0] += stretch
        before = len(gates)
        one._try(CAMERA, pattern, centre, extent, guide.directions, guide)
        assert (len(gates) > before) is tried
    folded = replace(CAMERA, distortion=Distortion(k1=-60.0))
    assert not np.isfinite(folded.unproject(xy[:4])).all()
    before = len(gates)
    assert one._try(folded, pattern, centre, extent, guide.directions, guide) is None
    assert len(gates) == before
    monkeypatch.setattr(free_scale, "grow", lambda *_: None)
    one.xy = xy
    assert one._try(CAMERA, pattern, centre, extent, guide.directions, guide) is None


# ---------------------------------------------------------------------- arguments
def test_fields_and_parities_that_are_searched():
    assert _bands(None, 0.05) == free_scale.FOV_BANDS_DEG
    assert _bands(20.0, 0.1) == ((18.0, 20.0, pytest.approx(22.0)),)
    for fov_deg in (0.5, 120.0, None):
        _check_arguments(fov_deg, 0.05, None, None)
    for wrong in (
        (0.49, 0.05, None, None),
        (120.1, 0.05, None, None),
        (20.0, 0.0, None, None),
        (20.0, 1.0, None, None),
        (20.0, 0.05, 0, None),
        (20.0, 0.05, 2, None),
        (20.0, 0.05, None, CAMERA),
    ):
        with pytest.raises(InputError):
            _check_arguments(*wrong)
    for parity in (1, -1, None):
        _check_arguments(None, 0.99, parity, CAMERA if parity else None)


def test_lists_of_centroids_with_their_variances():
    xy = np.array([[10.0, 10.0], [np.nan, 4.0], [30.0, 10.0], [10.0, 10.0], [50.0, 20.0]])
    flux, variance = [3.0, 9.0, 5.0, 1.0, 4.0], [0.1, 0.2, 0.3, 0.4, 0.5]
    points = _points_of_list(xy, flux, variance, 100, 80)
    assert (points.width, points.height) == (100, 80)
    np.testing.assert_array_equal(points.xy, [[30.0, 10.0], [50.0, 20.0], [10.0, 10.0]])
    assert points.variance_px2.tolist() == [0.3, 0.5, 0.1]  # of repeated positions the first
    assert points.flux.tolist() == [5.0, 4.0, 3.0]
    assert _points_of_list(xy, None, None, 100, 80).variance_px2 is None
    for width, height in ((None, 80), (100, None), (0, 80), (100, 0)):
        with pytest.raises(InputError):
            _points_of_list(xy, flux, variance, width, height)
    assert _points_of_list(np.array([[0.0, 0.0]]), None, None, 1, 1).xy.tolist() == [[0.0, 0.0]]
    for bad in ([0.1] * 4, [0.1, 0.2, 0.3, 0.4, 0.0], [0.1, 0.2, 0.3, 0.4, np.inf], [np.nan] * 5):
        with pytest.raises(InputError):
            _variance_of(np.array([2, 4, 0]), len(xy), bad)


def test_what_a_search_of_a_photograph_is_given(monkeypatch):
    """The band and parity of a camera, or those that are stated; both parities else."""
    asked = []

    def run(self, bands, sides):
        asked.append((bands, sides, self.rough))
        return free_search.Solution(Status.NO_MATCH, "why")

    monkeypatch.setattr(FreeSearch, "run", run)
    xy = np.random.default_rng(6).uniform(0.0, 799.0, (20, 2))
    blind.solve_unknown_fov(xy, 1000, 800)
    blind.solve_unknown_fov(xy, 1000, 800, fov_deg=20.0, parity=-1)
    mirrored = replace(CAMERA, parity=-1)
    blind.solve_unknown_fov(xy, 1000, 800, camera=mirrored, fov_error=0.01)
    fov = CAMERA.undistorted_fov_deg
    assert asked == [
        (free_scale.FOV_BANDS_DEG, (1, -1), None),
        (((19.0, 20.0, 21.0),), (-1,), None),
        (((0.99 * fov, fov, 1.01 * fov),), (-1,), mirrored),
    ]
    with pytest.raises(InputError, match="the camera has 1000×800 pixels, the image 900×800"):
        blind.solve_unknown_fov(xy, 900, 800, camera=CAMERA)
