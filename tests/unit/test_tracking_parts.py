"""What a tracking session is made of, each part against a plain twin."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest

from startracker.estimation.wahba import attitude_covariance
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.acceptance import log_chance
from startracker.observer import Observer, unknown_aberration
from startracker.tracker import StarTracker
from startracker.tracking import GyroNoise, RateNoise, TrackingSession
from startracker.tracking.candidates import Expected, Sky, measure_windows, window_half
from startracker.tracking.consistency import Scatter
from startracker.tracking.matching import Match, log_assignments, match_gated, spreads, track
from startracker.tracking.watched import WatchedFilter
from startracker.tracking.windows import cell_px, first_of_each, lay_out, to_image

CAMERA = Camera.from_fov(10.0, 256, 256)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(CAMERA, magnitude_limit=6.0, identifier="adaptive")


@pytest.mark.parametrize(
    "observer",
    [
        None,
        Observer(2026.3),
        Observer(2026.3, np.array([20.0, -15.0, 9.0]), np.array([0.5, -0.8, 0.2])),
    ],
)
def test_expected_stars_are_the_guides_on_the_image(tracker, observer):
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0).as_matrix()
    found = Sky(tracker.guide, tracker.camera.pixel_rad).expected(attitude, observer, 1000)
    guide = tracker.guide.apparent_to(observer)
    index, vectors, _ = guide.in_field(attitude)
    # the field's outline is drawn two pixels outside of the image
    assert set(index) <= set(found.index)
    assert set(found.index) <= set(guide.in_field(attitude, margin_px=3.0)[0])
    assert (np.diff(found.index) > 0).all()
    rows = np.searchsorted(found.index, index)
    np.testing.assert_allclose(found.predicted[rows], vectors, atol=1e-12)
    np.testing.assert_allclose(found.directions[rows], guide.directions[index], atol=1e-12)


def test_spread_is_the_attitudes_covariance_seen_across_the_star():
    """Against the sample covariance of 200,000 turned directions: 1 % is three standard errors."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3)) * 1e-4
    place = np.array([[0.1, -0.05, 0.99]])
    place /= np.linalg.norm(place)
    u, v, spread = spreads(place, root @ root.T)
    moved = np.cross(place, rng.normal(size=(200_000, 3)) @ root.T)
    sample = np.cov(moved @ u[0], moved @ v[0])
    np.testing.assert_allclose([sample[0, 0], sample[0, 1], sample[1, 1]], spread[0], atol=0.01 * sample.max())
    np.testing.assert_allclose([u[0] @ v[0], u[0] @ place[0], v[0] @ place[0]], 0.0, atol=1e-15)


def test_match_uses_no_star_twice_and_the_nearer_wins():
    predicted = np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0]])
    predicted /= np.linalg.norm(predicted, axis=1, keepdims=True)
    seen = predicted[[0, 0, 1]] + np.array([[3e-4, 0, 0], [1e-4, 0, 0], [0, 1e-4, 0]])
    match = Match(np.empty(3, np.int64), np.empty(3), np.empty(2, np.int64))
    count = match_gated(seen, np.full(3, 1e-4), predicted, spreads(predicted, np.eye(3) * 1e-12), 18.4, match)
    assert count == 2
    assert list(match.partner) == [-1, 0, 1]
    assert match.distance2[1:] == pytest.approx([1.0, 1.0], rel=1e-3)


def test_match_follows_the_common_rotation_not_the_nearest_star(tracker):
    """A prediction off by 25 px, of 10 px uncertainty: for each star there is a false one nearer than the true one."""
    rng = np.random.default_rng(2)
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0).as_matrix()
    expected = Sky(tracker.guide, tracker.camera.pixel_rad).expected(attitude, None, 40)
    turn = Attitude.from_rotation_vector([20 / CAMERA.fx, -15 / CAMERA.fx, 0.01], "camera", "camera").as_matrix()
    true = expected.predicted @ turn.T
    false = expected.predicted + rng.normal(size=true.shape) * 5.0 / CAMERA.fx
    false /= np.linalg.norm(false, axis=1, keepdims=True)
    seen = np.concatenate([true, false])
    sigma = np.full(len(seen), 0.15 / CAMERA.fx)
    p = np.eye(3) * (10.0 / CAMERA.fx) ** 2
    partner, delta, after, evidence = track(seen, sigma, expected.predicted, p, tracker.guide.solid_angle_sr)
    n = len(true)
    assert list(partner[:n]) == list(range(n))
    assert (partner[n:] >= 0).sum() == 0
    assert evidence > math.log(1e7)
    assert np.abs(delta - [20 / CAMERA.fx, -15 / CAMERA.fx, 0.01]).max() < 5.0 * math.sqrt(after.max())


def test_assignments_against_the_sum_by_hand():
    """One match, two guide stars, three observed: depths 1 and 2, M of 0 or 1 (and 2), the best kept."""
    gain = math.log(1000.0)
    one = 1000.0 / 1 / 3 / 2.0  # D = 1: one guide star, three observed it could be, M in {0, 1}
    two = 1000.0 / 2 / 3 / 3.0
    found = log_assignments(np.array([gain]), np.array([0]), 3, 2)
    assert found == pytest.approx(math.log((one + two) / 2.0))
    # the second brightest cannot be seen at the depth of one star, where nothing matches: 1 / 2
    found = log_assignments(np.array([gain]), np.array([1]), 3, 2)
    assert found == pytest.approx(math.log((0.5 + two) / 2.0))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32, np.float32, np.float64])
def test_windows_hold_the_image_and_its_background(kind):
    rng = np.random.default_rng(4)
    image = rng.normal(100.0, 5.0, size=(90, 120)).astype(kind)
    x, y, half, columns = np.array([30, 60, 2]), np.array([40, 50, 88]), 9, 2
    mosaic, level, noise = lay_out(image, x, y, half, columns, 0.29)
    pitch = cell_px(half)
    assert mosaic.shape == level.shape == noise.shape == (2 * pitch, 2 * pitch)
    for m in range(3):
        gap = (pitch - 2 * half - 1) // 2
        row, column = m // columns * pitch + gap, m % columns * pitch + gap
        for j in range(2 * half + 1):
            for i in range(2 * half + 1):
                at = y[m] - half + j, x[m] - half + i
                inside = 0 <= at[0] < 90 and 0 <= at[1] < 120
                want = np.float32(image[at]) if inside else level[row, column]
                assert mosaic[row + j, column + i] == want
        place = to_image(np.array([[column + half, row + half + 0.25]]), x, y, half, columns)
        np.testing.assert_allclose(place, [[x[m], y[m] + 0.25]])
    cut = image[31:50, 21:40].astype(float)
    rim = np.concatenate([cut[:2].ravel(), cut[-2:].ravel(), cut[2:-2, :2].ravel(), cut[2:-2, -2:].ravel()])
    at = (pitch - 2 * half - 1) // 2
    assert level[at, at] == pytest.approx(np.median(rim))
    assert noise[at, at] == pytest.approx(1.4826 * np.median(np.abs(rim - np.median(rim))), rel=1e-6)


def test_windows_find_what_the_whole_frame_finds(tracker):
    """Gaussian stars on a noisy frame: the windows' centroids are the whole frame's, within a tenth of their error."""
    rng = np.random.default_rng(5)
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0).as_matrix()
    expected = Sky(tracker.guide, tracker.camera.pixel_rad).expected(attitude, None, 40)
    centre = CAMERA.project(expected.predicted)
    rows, columns = np.mgrid[0:256, 0:256]
    image = rng.normal(100.0, 3.0, size=(256, 256))
    for x, y in centre:
        image += 900.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 0.9**2))
    half = window_half(tracker, expected, np.eye(3) * 1e-9, 0.0, 20)
    seen = measure_windows(image.astype(np.float32), tracker, expected, half, 0.0, 1.0, None, 1.0)
    inside = CAMERA.contains(centre, -8.0)
    apart = [np.sort(np.hypot(*(centre - c).T))[1] > 12.0 for c in centre]
    found = [np.hypot(*(seen.xy - c).T).min() for c in centre[inside & apart]]
    assert len(found) > 5
    # 900 over 3: some 0.01 px, plus what the widths measured on few stars leave
    assert max(found) < 0.06
    assert seen.windows == CAMERA.contains(np.rint(centre)).sum()
    assert seen.area_sr == pytest.approx(seen.windows * ((2 * half + 1) * CAMERA.pixel_rad) ** 2)
    assert seen.window_half_px == half
    np.testing.assert_array_equal(seen.window_xy, np.rint(centre)[CAMERA.contains(np.rint(centre))])
    wide = measure_windows(image, tracker, expected, 60, 0.0, 1.0, None, 1.0)
    assert wide.area_sr == tracker.guide.solid_angle_sr  # no more than the whole frame
    doubted = measure_windows(image, tracker, expected, half, 0.0, 3.0, None, 1.0)
    np.testing.assert_allclose(doubted.sigma_px, 3.0 * seen.sigma_px, rtol=1e-5)
    np.testing.assert_allclose(doubted.stated_px, seen.stated_px, rtol=1e-5)
    trusted = measure_windows(image, tracker, expected, half, 0.0, 0.3, None, 1.0)
    np.testing.assert_allclose(trusted.sigma_px, seen.stated_px, rtol=1e-5)
    np.testing.assert_allclose(seen.gate_px**2 - seen.stated_px**2, seen.gate_px[0] ** 2 - seen.stated_px[0] ** 2)
    assert window_half(tracker, expected, np.eye(3) * 1e-2, 0.0, 20) is None  # windows too large
    assert measure_windows(image, tracker, expected, None, 0.0, 1.0, None, 1.0) is None
    assert measure_windows(image[:10], tracker, expected, half, 0.0, 1.0, None, 1.0) is None
    swapped = measure_windows(image.astype(">f4"), tracker, expected, half, 0.0, 1.0, None, 1.0)
    np.testing.assert_allclose(swapped.xy, seen.xy)


def test_first_of_each():
    xy = np.array([[5.0, 5.0], [5.3, 5.3], [math.nan, 1.0], [-1.0, 4.0], [9.4, 9.4], [9.6, 9.0]])
    assert list(first_of_each(xy, 10.0, 10.0, 0.0, 0.75)) == [0, 4]
    assert list(first_of_each(xy, 10.0, 10.0, 2.0, 0.75)) == [0]


def test_scatter_tells_the_errors_size():
    """Errors three times as large as stated: 1000 residuals give that to 1/√(2·200), four of these allowed."""
    rng = np.random.default_rng(6)
    scatter = Scatter()
    assert scatter.factor == 1.0
    for _ in range(50):
        scatter.add(rng.normal(size=(10, 2)) * 0.45, np.full(10, 0.15))
    assert scatter.factor == pytest.approx(3.0 * math.sqrt(20 / 17), rel=4 / math.sqrt(400))
    scatter.begin(np.zeros((2, 2)), np.full(2, 0.15))
    assert scatter.factor > 0.8  # two stars agree with anything


def test_evidence_of_one_star_is_its_predicted_density():
    """ln B = ln(A N(z; 0, S) / 2), S the covariance of the star's predicted place: the integral over δ done exactly."""
    root = np.array([[3.0, 0.5, 1.0], [0.0, 2.0, -1.0], [1.0, 0.0, 20.0]]) * 1e-4
    p, sigma, area = root @ root.T, 2e-4, 0.03
    place = np.array([[0.05, 0.02, 1.0]]) / math.sqrt(0.05**2 + 0.02**2 + 1.0)
    seen = Attitude.from_rotation_vector([2e-4, -3e-4, 0.0], "camera", "camera").apply(place)
    u, v, spread = spreads(place, p)
    s = np.array([[spread[0, 0], spread[0, 1]], [spread[0, 1], spread[0, 2]]]) + sigma**2 * np.eye(2)
    z = np.array([seen[0] @ u[0], seen[0] @ v[0]])
    density = math.exp(-0.5 * z @ np.linalg.solve(s, z)) / (2.0 * math.pi * math.sqrt(np.linalg.det(s)))
    _, _, _, evidence = track(seen, np.array([sigma]), place, p, area)
    assert evidence == pytest.approx(math.log(area * density / 2.0), abs=2e-3)  # second order in δ


def test_frames_are_accepted_by_the_rule_of_identification(tracker):
    """The chance of a followed frame is `acceptance.log_chance` of its evidence, and `false_alarm_rate` the limit."""
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0)
    _, _, xy = tracker.guide.in_field(attitude.as_matrix())
    strict, loose = copy.copy(tracker), copy.copy(tracker)
    session = TrackingSession(tracker)
    session.reset(attitude, 0.01)
    followed = session._follow_centroids(xy[:1], None, None)
    seen, sigma = followed.seen, followed.seen.sigma_px * CAMERA.pixel_rad
    expected = followed.expected.predicted
    covariance = np.eye(3) * math.radians(0.01) ** 2
    *_, evidence = track(seen.vectors, sigma, expected, covariance, seen.area_sr)
    assert followed.log_chance == pytest.approx(log_chance(evidence), rel=1e-6)
    rate = math.exp(followed.log_chance)
    for other, share in ((strict, 0.99), (loose, 1.01)):
        other.identification = replace(tracker.identification, false_alarm_rate=share * rate)
        session = TrackingSession(other)
        session.reset(attitude, 0.01)
        found = session.update_centroids(xy[:1], None, 0.0)
        assert found.solved == (other is loose), found.reason
        assert session.state.matched == 1  # the filter takes the star in either way
        assert not found.solved or found.log_false_alarm == session.state.log_chance < 0.0


def test_windows_reach_as_far_as_the_prediction_and_the_streak():
    """4.3 standard deviations, half a centroid window and 5 px; half of the streak's length in addition."""
    expected = Expected(np.arange(2), np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0]]))
    tracker = StarTracker(Camera.from_fov(4.0, 512, 512), magnitude_limit=6.0)
    pixel = tracker.camera.pixel_rad
    sigma_px, side = 2.0, tracker.centroid.window_px // 2 + 5
    covariance = np.diag([1.0, 1.0, 0.0]) * (sigma_px * pixel) ** 2 / 2.0  # the length of the error, over both axes
    half = math.ceil(4.3 * sigma_px * (1.0 + 1e-4)) + side
    assert window_half(tracker, expected, covariance, 0.0, 60) == half
    assert window_half(tracker, expected, covariance, 0.0, half) == half
    assert window_half(tracker, expected, covariance, 0.0, half - 1) is None
    assert window_half(tracker, expected, covariance, 5.0, half) == half + 3
    assert window_half(tracker, expected, covariance, 10.0, half) == half + 5
    assert window_half(tracker, expected, covariance, 10.1, half) is None
    # at most half of the frame: 512² pixels over 2 (2 half + 1)²
    most = int((math.sqrt(512**2 / 4) - 1) / 2)
    wide = (most - side) / 4.3 / math.sqrt(2.0) * pixel
    assert window_half(tracker, expected, np.diag([1.0, 1.0, 0.0]) * (0.999 * wide) ** 2, 0.0, 1000) == most
    assert window_half(tracker, expected, np.diag([1.0, 1.0, 0.0]) * (1.003 * wide) ** 2, 0.0, 1000) is None


@pytest.mark.parametrize("octant", range(8))
@pytest.mark.parametrize(("x", "y"), [(0.02, 0.05), (0.6, 0.05), (1e-5, 0.6), (0.6, 1e-5), (0.6, 0.8 - 1e-11)])
def test_one_star_turns_an_uncertain_prediction_by_the_kalman_gain(octant, x, y):
    """A prediction of 0.5° and a star of 0.2″ in any direction, as whole-sky cameras have them."""
    signs = [1.0 - 2.0 * (octant >> n & 1) for n in range(3)]
    predicted = np.array(signs) * [x, y, math.sqrt(1.0 - x**2 - y**2)]
    covariance = np.diag([1.0, 2.0, 3.0]) * math.radians(0.5) ** 2
    across = np.cross(predicted, [0.3, -0.5, 0.8])
    seen = math.cos(1e-3) * predicted + math.sin(1e-3) * across / np.linalg.norm(across)
    partner, turn, _, evidence = track(seen[None], np.array([1e-6]), predicted[None], covariance, 1.0)
    assert partner.tolist() == [0]
    assert math.isfinite(evidence)
    # the displacement is p × δ, and δ = P Hᵀ (H P Hᵀ)⁻¹ of it; the second order is 1e-6
    h = np.cross(predicted, np.eye(3)).T
    expected = covariance @ h.T @ np.linalg.pinv(h @ covariance @ h.T, rcond=1e-9) @ (seen - predicted)
    assert np.abs(turn - expected).max() < 3e-6


@pytest.mark.parametrize(("x", "y"), [(0, 0), (59, 0), (0, 39), (59, 39), (1, 20), (30, 1)])
def test_windows_at_the_border_of_an_image(x, y):
    """Rows and columns 0 and last belong to it; the noise is at least 1e-5 of the brightest central pixel."""
    image = np.full((40, 60), 50.0, np.float32)
    image[y, x] = 1050.0
    half, columns = 4, 1
    mosaic, level, noise = lay_out(image, np.array([x]), np.array([y]), half, columns, 1e-6)
    gap = (cell_px(half) - 2 * half - 1) // 2
    padded = np.full((40 + 2 * half, 60 + 2 * half), 50.0, np.float32)
    padded[half:-half, half:-half] = image
    np.testing.assert_array_equal(mosaic[gap : gap + 9, gap : gap + 9], padded[y : y + 9, x : x + 9])
    assert (level == 50.0).all()
    np.testing.assert_allclose(noise, 1e-5 * 1000.0, rtol=1e-6)
    # of a centre outside the image, or not finite, nothing is known
    image[y, x] = math.nan
    _, _, noise = lay_out(image, np.array([x, -3]), np.array([y, 20]), half, 2, 1e-6)
    np.testing.assert_allclose(noise, 1e-6, rtol=1e-6)


def test_the_noise_of_a_window_is_at_least_most_of_the_common_one():
    """0.7 of the median over all windows; a window without any pixel has neither level nor noise of its own."""
    rng = np.random.default_rng(3)
    image = rng.normal(100.0, 5.0, (60, 200)).astype(np.float32)
    image[:, :40] = 100.0
    x, y = np.array([20, 80, 120, 160, 500]), np.full(5, 30)
    _, level, noise = lay_out(image, x, y, 6, 5, 0.1)
    pitch = cell_px(6)
    own = noise[0, ::pitch]
    common = np.median([0.0, *own[1:4], 0.0])
    np.testing.assert_allclose(own[[0, 4]], 0.7 * common, rtol=1e-5)
    assert level[0, 4 * pitch] == 0.0
    assert (own[1:4] > 3.0).all()


def test_the_attitude_of_the_stars_alone_has_their_covariance(tracker):
    """That of Wahba's problem with the measured errors; of two stars there is none."""
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0)
    _, _, xy = tracker.guide.in_field(attitude.as_matrix())
    xy = xy[CAMERA.contains(xy, -3.0)]
    for count in (2, 3, 6):
        session = TrackingSession(tracker)
        session.reset(attitude, 0.01)
        followed = session._follow_centroids(xy[:count], None, None)
        assert len(followed.stars) == count
        found = followed.star_attitude(CAMERA)
        if count < 3:
            assert found is None
            continue
        vectors = CAMERA.unproject(xy[:count])
        expected = attitude_covariance(vectors, followed.seen.sigma_px[followed.stars] * CAMERA.pixel_rad)
        np.testing.assert_allclose(found[1], expected, rtol=1e-6)
        assert Attitude(found[0]).angle_to(attitude) < 1e-5


def test_a_session_before_and_after_its_first_frame(tracker):
    """Nothing is known; then a whole frame is solved, lost in space; a reset forgets it."""
    session = TrackingSession(tracker)
    assert session.filter_attitude is session.covariance is session.rate_rad_s is session.bias_rad_s is None
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0)
    _, _, xy = tracker.guide.in_field(attitude.as_matrix())
    found = session.update_centroids(xy, None, 1.0)
    assert found.solved
    state = session.state
    assert (state.mode, state.solved, state.restarted, state.distrusted) == ("lost_in_space", True, True, False)
    assert (state.windows, state.innovation, state.matched) == (0, None, found.matched)
    assert session.filter_attitude.angle_to(attitude) < 1e-4
    assert session.bias_rad_s.tolist() == [0.0, 0.0, 0.0]
    again = session.update_centroids(xy + 0.01, None, 2.0)
    assert (again.solved, session.state.mode, session.state.restarted) == (True, "tracking", False)
    assert session.state.expected >= session.state.matched == again.matched > 0
    late = session.update_centroids(xy + 0.02, None, 2.0)
    assert (str(late.status), session.state.mode, late.attitude) == ("bad_time", "coasting", None)
    same = session.update_centroids(xy + 0.01, None, 3.0)
    assert (str(same.status), "as the one at 2.0 s" in same.reason) == ("stale", True)
    session.reset()
    assert session.filter_attitude is None


@pytest.mark.parametrize(("share", "there"), [(0.49, True), (0.51, False)])
def test_a_prediction_is_useful_within_a_quarter_of_the_diagonal(tracker, share, there):
    """Its uncertainty about all axes together, against half of the angle from the middle to a corner."""
    session = TrackingSession(tracker)
    sigma_deg = math.degrees(share * tracker.guide.half_diagonal_rad / math.sqrt(3.0))
    session.reset(Attitude.from_radec_roll(80.0, 5.0, 30.0), sigma_deg)
    assert (session._expect(None) is not None) is there


def test_the_motion_of_the_observer_that_is_not_known_is_in_the_covariance(tracker):
    """Added to that of the filter, and taken off what the tracker states."""
    watched = WatchedFilter(RateNoise(), 1e-6)
    assert (watched.distrusted, watched.without_observer) == (False, False)
    attitude, p = Attitude.from_radec_roll(80.0, 5.0, 30.0), np.diag([1.0, 2.0, 3.0]) * 1e-8
    watched.begin(attitude, p)
    np.testing.assert_allclose(watched.attitude_covariance, p)
    assert watched.own_covariance(attitude, p) is p
    watched.without_observer = True
    unknown = unknown_aberration(attitude.as_matrix())
    np.testing.assert_allclose(watched.attitude_covariance, p + unknown)
    np.testing.assert_allclose(watched.covariance[:3, :3], p + unknown)
    np.testing.assert_allclose(watched.own_covariance(attitude, p + unknown), p, atol=1e-20)


def test_stars_that_are_seen_are_watched_for_standing_still():
    watched = WatchedFilter(GyroNoise(), 1e-6)
    attitude, p = Attitude.from_radec_roll(80.0, 5.0, 30.0), np.eye(3) * 1e-10
    watched.begin(attitude, p)
    watched.add_star_attitude((attitude.quat, p))
    assert watched._still.filter is not None
    watched.add_star_attitude(None)  # of too few stars nothing is known
    assert watched._still.filter is None
    assert watched.contradiction(None) == ""
    assert WatchedFilter(RateNoise(), 1e-6).contradiction((attitude.quat, p)) == ""


@pytest.mark.parametrize("noise_px", [0.05, 0.6])
def test_a_frame_whose_errors_are_larger_than_stated_is_followed_with_all_stars(tracker, noise_px):
    """0.6 px on each axis where 0.15 px are stated: beyond 3.7 stated errors, and within 3.7 of those of the frame."""
    attitude = Attitude.from_radec_roll(80.0, 5.0, 30.0)
    _, _, xy = tracker.guide.in_field(attitude.as_matrix())
    inside = CAMERA.contains(xy, -3.0)
    xy = xy[inside] + noise_px * np.random.default_rng(1).normal(size=(inside.sum(), 2))
    session = TrackingSession(tracker)
    session.reset(attitude, 0.5)
    session._scatter._chi2 = 9.0 * session._scatter._freedom  # gates and weights for three times the stated errors
    followed = session._follow_centroids(xy, None, None)
    assert len(followed.stars) >= 0.8 * len(xy)
    assert len(followed.stars) > 6
    assert not followed.hides_a_part(CAMERA)  # of a list, what is not there was looked for
    # the same in windows, with the stars of one half only
    left = np.flatnonzero(followed.seen.xy[followed.stars][:, 0] < 110.0)
    half = replace(
        followed,
        seen=replace(followed.seen, windows=9),
        stars=followed.stars[left],
        partner=followed.partner[left],
    )
    whole = replace(followed, seen=replace(followed.seen, windows=9))
    assert not whole.hides_a_part(CAMERA)
    assert half.hides_a_part(CAMERA)
    assert not replace(half, seen=followed.seen).hides_a_part(CAMERA)
