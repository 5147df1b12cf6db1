"""Identification of the flight build beside floating point, brute force and truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.flight_lists import FIELDS, null_list
from simulator.randomness import stream
from startracker import Camera, StarTracker
from startracker.errors import InputError
from startracker.estimation.directions import focal_slopes, normal_equations
from startracker.flight import search_tables as tabled
from startracker.flight.apparent import FlightObserver, epoch_of
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.evidence import LOG_UP, log_down, log_sum, log_sum_up, weigh
from startracker.flight.evidence import Match as IntegerMatch
from startracker.flight.hypotheses import FlightPrior, Reason, pair_frame
from startracker.flight.search_plan import SEARCHES
from startracker.flight.search_tables import search_tables
from startracker.flight.solver import SATURATED_PART, FlightTracker
from startracker.flight.stars import StarList
from startracker.flight.verifying import _log_determinant, _normal, field_at, matched, verify
from startracker.flight.votes import MOST_VOTES, neighbours_of, separations, tolerance, vote_about
from startracker.geometry.distortion import Distortion
from startracker.identification import bayes_factor, clustering_null
from startracker.identification.bayes_factor import Matched, count_table, log_bayes_factor, log_magnitude_ratios
from startracker.identification.clustering_null import clustering_price, log_excess_density
from startracker.identification.verification import MOST_EXTRA
from startracker.inputs import SATURATED_SHARE
from startracker.observer import Observer
from startracker.settings import DetectionSettings, TriadSettings
from startracker.solution import Status
from tests.helpers.flight_lists import apparent_to, random_fields

pytestmark = pytest.mark.system

ONE = 1 << 30
REST = FlightObserver(np.zeros(3, np.int64))


@pytest.fixture(scope="module")
def star_tracker():
    camera = Camera(4545.5, 4545.5, 511.5, 511.5, 1024, 1024, Distortion(k1=-0.05))
    return StarTracker(camera, magnitude_limit=6.5)


@pytest.fixture(scope="module")
def tracker(star_tracker):
    numbers = DetectorNumbers(3.3, 13.0, 4083)
    return FlightTracker.build(FlightDesign(star_tracker.camera, star_tracker.guide, numbers, 0.9))


@pytest.fixture(scope="module")
def tables(tracker):
    return tracker.search_tables


def fields(star_tracker, kind, count, seed=1):
    return random_fields(star_tracker, "search", kind, count, seed)


def integers(matrix):
    return np.rint(matrix * ONE).astype(np.int64)


def test_constants_are_those_of_floating_point():
    assert tabled.WIDE_MAG == bayes_factor._WIDE_MAG
    assert tabled.WIDE_SHARE == bayes_factor._WIDE_SHARE
    assert tabled.FLOOR == bayes_factor._FLOOR
    assert tabled.EVEN == clustering_null._EVEN
    assert pytest.approx(1.0 / SATURATED_SHARE) == SATURATED_PART


def test_logarithms_are_bounds(tables):
    rng = stream(2, "logarithms")
    n = (2.0 ** rng.uniform(0.0, 62.0, 20_000)).astype(np.int64)
    exact = 4096.0 * np.array([math.log2(int(value)) for value in n])
    low = log_down(n, tables)
    assert (low <= exact + 1e-6).all()
    assert (low + LOG_UP >= exact).all()
    a, b = rng.integers(-400_000, 400_000, (2, 20_000))
    b = np.where(rng.random(20_000) < 0.5, a + rng.integers(-60_000, 60_000, 20_000), b)
    total = 4096.0 * np.logaddexp2(a / 4096.0, b / 4096.0)
    assert (log_sum(a, b, tables) <= total + 1e-6).all()
    assert (log_sum(a, b, tables) >= total - 33).all()  # a step of 1/64 of which one bit is half, and rounding
    assert (log_sum_up(a, b, tables) >= total - 1e-6).all()
    assert (log_sum_up(a, b, tables) <= total + 34).all()


def test_field_is_that_of_the_camera(star_tracker, tracker, tables):
    """Every guide star on the image but for those within 4 px of its edge: 2 px of the outline's margin, and 2 px of
    its table, which is linear between azimuths 1.4 degrees apart."""
    rng = stream(3, "fields")
    for _ in range(40):
        matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix *= np.linalg.det(matrix)
        found = set(field_at(integers(matrix), REST, 1000, tables).guide.tolist())
        inner = set(star_tracker.guide.in_field(matrix, -4.0)[0].tolist())
        outer = set(star_tracker.guide.in_field(matrix, 4.0)[0].tolist())
        assert inner <= found <= outer
        assert field_at(integers(matrix), REST, 7, tables).guide.tolist() == sorted(found)[:7]


def float_evidence(seen, field, rank, matrix, star_tracker):
    """log₂ B of the same match in floating point, with the integers' directions, variances and magnitudes."""
    n, depth = len(seen), len(field.guide)
    observed = seen.direction / np.linalg.norm(seen.direction, axis=1, keepdims=True)
    guide = field.direction / np.linalg.norm(field.direction, axis=1, keepdims=True)
    predicted = guide @ (matrix / ONE).T
    sigma = np.sqrt(seen.variance) / ONE
    away = np.linalg.norm(observed - predicted[rank], axis=1)
    distance = np.where(rank >= 0, away, np.inf)
    information, _ = normal_equations(observed, focal_slopes(observed), predicted, rank, sigma, 3)
    magnitude = seen.magnitude / 64.0 if seen.brightness else np.full(n, math.nan)
    ratios = log_magnitude_ratios(magnitude, rank, field.magnitude / 64.0)
    area = star_tracker.guide.solid_angle_sr
    value, _ = log_bayes_factor(
        Matched(distance, rank, sigma, ratios), information, depth, area, 0.01, count_table(n, 2 * n + MOST_EXTRA)
    )
    return (value - clustering_price(log_excess_density(observed, area), rank)) / math.log(2.0)


@pytest.mark.parametrize("kind", ["clean", "noise", "false stars", "few stars"])
def test_evidence_is_that_of_floating_point_and_never_above(star_tracker, tracker, tables, kind):
    """Within 0.1 bits a star and one for the rest: 1/64 bit of each table of counts, 1/16 of the crowding's steps."""
    compared = 0
    for one in fields(star_tracker, kind, 25):
        seen = apparent_to(tracker, one.stars)
        matrix = integers(one.matrix)
        field = field_at(matrix, REST, 2 * len(seen) + MOST_EXTRA, tables)
        predicted = (field.direction @ matrix.T) >> 30
        rank, square = matched(seen, predicted, 254016)
        star = np.flatnonzero(rank >= 0)
        if len(star) < 3:
            continue
        normal = _normal(seen, predicted, rank)
        match = IntegerMatch(star, rank[star], square[star], _log_determinant(normal, tables))
        evidence, _ = weigh(seen, match, field.magnitude, tables)
        exact = float_evidence(seen, field, rank, matrix, star_tracker)
        assert evidence / 4096.0 <= exact + 0.02  # the density of magnitudes beyond the widths that are averaged over
        assert evidence / 4096.0 >= exact - 1.0 - 0.1 * len(star)
        compared += 1
    assert compared > 15


def brute_force(pole, seen, sides, plan, t):
    """Guide stars that a pole may be, by loops over the neighbours' pairs, and how many neighbours agree."""
    near = neighbours_of(pole, 0, sides, plan, t)
    votes = {}
    for k, star in enumerate(near.star.tolist()):
        fainter = int(seen.magnitude[pole] - seen.magnitude[star])
        for pair in range(int(near.low[k]), int(near.high[k])):
            ends = int(t.first[pair]), int(t.second[pair])
            for a, b in (ends, ends[::-1]):
                if abs(fainter - int(t.magnitude[a] - t.magnitude[b])) <= t.magnitude_tolerance:
                    votes.setdefault(a, []).append((k, b))
    out = {}
    for a, listed in votes.items():
        for k, b in listed:
            agreeing = set()
            for m, c in listed:
                one, other = int(near.star[k]), int(near.star[m])
                apart = math.dist(t.guide[b].tolist(), t.guide[c].tolist())
                chord = int(sides.chord[one, other])
                allowed = int(tolerance(np.array(chord), sides.error[one, other], plan.sides))
                triangles = (seen.direction[[pole, one, other]] / ONE, t.guide[[a, b, c]] / ONE)
                observed, known = (np.linalg.det(corners) for corners in triangles)
                thin = abs(observed) * ONE <= allowed * chord / ONE + 2
                if m != k and abs(apart - chord) <= allowed and (thin or observed * known > 0):
                    agreeing.add(m)
            if len(agreeing) + 1 >= max(plan.need, out.get(a, 0)):
                out[a] = len(agreeing) + 1
    return out


def test_votes_are_those_of_brute_force(star_tracker, tracker, tables):
    tables, plan = tables._replace(most_kept=10**6), SEARCHES[0]
    found = 0
    for one in fields(star_tracker, "false stars", 2):
        seen = apparent_to(tracker, one.stars)
        sides = separations(seen, tables)
        for pole in range(3):
            got = vote_about(pole, seen, sides, plan, 10**9, tables)
            expected = brute_force(pole, seen, sides, plan, tables)
            rows = {row[1]: row[4] for row in got.rows.tolist()}
            assert rows == dict(sorted(expected.items(), key=lambda item: (-item[1], item[0]))[:48])
            found += len(rows)
    assert found > 20


def test_more_votes_than_there_is_room_for(star_tracker, tracker, tables, monkeypatch):
    """The passes over ranges of guide stars give what a single one does."""
    seen = apparent_to(tracker, fields(star_tracker, "clean", 1)[0].stars)
    sides, plan = separations(seen, tables), SEARCHES[1]
    whole = vote_about(0, seen, sides, plan, 10**9, tables)
    looked = whole.steps
    monkeypatch.setattr("startracker.flight.votes.MOST_VOTES", MOST_VOTES // 4)
    sliced = vote_about(0, seen, sides, plan, 10**9, tables)
    assert sliced.rows.tolist() == whole.rows.tolist()
    assert sliced.steps > looked


def angle_deg(matrix, truth):
    turn = matrix @ truth.T
    return math.degrees(math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8.0), 1.0)) * 2.0)


@pytest.mark.parametrize("kind", list(FIELDS))
def test_fields_as_star_tracker(star_tracker, tracker, kind):
    """As many fields as `StarTracker` solves but for 1 %, rounded up; none wrong."""
    mine = theirs = 0
    for one in fields(star_tracker, kind, 12):
        theirs += star_tracker.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px).solved
        answer = tracker.solve_stars(one.stars)
        mine += answer.solved
        if not answer.solved:
            assert not answer.number.any()
            assert not answer.matrix.any()
            continue
        assert angle_deg(answer.attitude_matrix, one.matrix) < 0.1
        named = answer.number > 0
        _, _, positions = star_tracker.guide.in_field(one.matrix, 5.0)
        near = np.linalg.norm(one.xy[named][:, None] - positions[None], axis=2).min(axis=1)
        assert near.max() < 3.0
    assert mine >= theirs - 1
    assert theirs >= 7


def test_statuses(star_tracker, tracker, monkeypatch):
    one = fields(star_tracker, "clean", 1)[0].stars
    assert tracker.solve_stars(one.take(np.arange(0))).status is Status.NO_STARS
    assert tracker.solve_stars(one.take([0, 1])).status is Status.TOO_FEW_STARS
    assert tracker.solve_stars(one._replace(variance=one.variance * 0 + (26 << 26))).reason is Reason.FEW_FOUND
    assert tracker.solve_stars(one._replace(variance=one.variance * 0)).solved
    assert tracker.solve_stars(one._replace(flux=one.flux * 0)).solved
    few = tuple(plan._replace(steps=0, poles=2) for plan in SEARCHES)
    monkeypatch.setattr(tracker, "search_tables", tracker.search_tables._replace(searches=few))
    null = null_list(star_tracker, "uniform", stream(5, "limit"))
    assert tracker.solve_stars(null).status is Status.SEARCH_LIMIT


def test_prior_adds_evidence_and_is_checked(star_tracker, tracker):
    """Three stars, for which the whole sky is too large, are identified around a prior; a wrong one is contradicted."""
    accepted = alone = 0
    for one in fields(star_tracker, "clean", 5, seed=6):
        if len(one.xy) < 10:
            continue
        three = one.stars.take([0, 1, 2])
        prior = FlightPrior(integers(one.matrix), round(math.radians(0.5) * (1 << 28)))
        answer = tracker.solve_stars(three, prior=prior)
        accepted += answer.solved
        alone += tracker.solve_stars(three).solved
        if answer.solved:
            assert angle_deg(answer.attitude_matrix, one.matrix) < 0.2
            assert not answer.prior_contradicted
        elsewhere = FlightPrior(prior.matrix[[1, 2, 0]], prior.radius)
        contradicted = tracker.solve_stars(one.stars, prior=elsewhere)
        assert contradicted.solved
        assert contradicted.prior_contradicted
    assert accepted > alone


def test_aberration(star_tracker, tracker):
    """Stars seen by an observer at 30 km/s: with the velocity the attitude is that of the frame at rest; without, it is
    off by up to 20 arcseconds."""
    rng = stream(7, "aberration")
    one = fields(star_tracker, "clean", 3, seed=7)[2]
    index = star_tracker.guide.in_field(one.matrix)[0][:20]
    beta = rng.normal(size=3)
    beta *= 1e-4 / np.linalg.norm(beta)
    apparent = star_tracker.guide.directions[index] + beta
    apparent /= np.linalg.norm(apparent, axis=1, keepdims=True)
    xy = star_tracker.camera.project(apparent @ one.matrix.T)
    kept = star_tracker.camera.contains(xy)
    flux = 10.0 ** (-0.4 * star_tracker.guide.v_mag[index][kept] + 4.0)
    stars = StarList.of(xy[kept], flux, np.full(int(kept.sum()), 0.05**2))
    arcsec = [
        3600.0 * angle_deg(tracker.solve_stars(stars, velocity=velocity).attitude_matrix, one.matrix)
        for velocity in (integers(beta), None)
    ]
    assert arcsec[0] < 1.0 < arcsec[1] < 120.0


def test_proper_motion(star_tracker, tracker):
    """After 20 years Groombridge 1830 has moved by 141″ (7.06″ a year, Hipparcos), 3 px: 60 standard errors.
    With the epoch it is fitted, and the attitude of these exact positions is right to 0.02 px; without, it is not."""
    guide, camera = star_tracker.guide, star_tracker.camera
    later = guide.apparent_to(Observer(guide.epoch_jyear + 20.0))
    fast = int(np.flatnonzero(guide.catalog.id == 57939)[0])
    away = np.degrees(np.linalg.norm(later.directions[fast] - guide.directions[fast])) * 3600.0
    assert away == pytest.approx(20.0 * 7.06, abs=0.1)
    z = later.directions[fast] + [0.0, 0.02, 0.02]
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.3, -0.5, 0.8])
    x /= np.linalg.norm(x)
    truth = np.array([x, np.cross(z, x), z])
    index, _, xy = later.in_field(truth, 0.0, camera)
    index, xy = index[:60], xy[:60]
    assert fast in index
    stars = StarList.of(xy, 10.0 ** (-0.4 * guide.v_mag[index] + 4.0), np.full(len(xy), 0.05**2))
    here, epoch = list(index).index(fast), epoch_of(guide.epoch_jyear + 20.0)
    known, unknown = tracker.solve_stars(stars, epoch=epoch), tracker.solve_stars(stars)
    assert known.number[here] == 57939
    assert unknown.number[here] == 0
    assert known.used > unknown.used
    assert math.radians(angle_deg(known.attitude_matrix, truth)) < 0.02 * camera.pixel_rad
    with pytest.raises(InputError, match="within 100 years"):
        tracker.solve_stars(stars, epoch=1 << 16)


def test_verification_recovers_from_a_coarse_attitude(star_tracker, tracker, tables):
    one = fields(star_tracker, "clean", 4, seed=8)[3]
    seen = apparent_to(tracker, one.stars)
    sigma = math.sqrt(float(seen.variance[0])) / ONE
    for axis, errors in ((0, 20.0), (1, -20.0), (2, 100.0)):  # in stated errors, of a first gate of 63
        turn = Rotation.from_rotvec(np.eye(3)[axis] * errors * sigma).as_matrix()
        found = verify(integers(turn @ one.matrix), 0, seen, REST, tables)
        assert found.evidence > 40 * 4096
        error = Rotation.from_matrix(found.matrix / ONE @ one.matrix.T).as_rotvec()
        assert np.abs(error[:2]).max() < sigma
        assert abs(error[2]) < 20.0 * sigma  # about the boresight, by the field's lever


def test_frame_of_a_pair_is_orthonormal():
    rng = stream(9, "pairs")
    for separation in (1e-4, 0.01, 0.3):
        p = rng.normal(size=3)
        p /= np.linalg.norm(p)
        q = p + separation * np.cross(p, rng.normal(size=3))
        frame = pair_frame(integers(p), integers(q / np.linalg.norm(q))) / ONE
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=4e-9 / separation)  # the difference's last bit


def test_designs_that_are_refused(tracker):
    for changed, message in (
        ({"identifier": "triads", "identification": TriadSettings(max_stars=40)}, "max_stars to 3 to 24"),
        ({"detection": DetectionSettings(max_stars=200)}, "up to 120 stars"),
    ):
        with pytest.raises(InputError, match=message):
            search_tables(replace(tracker.design, **changed))
    with pytest.raises(InputError, match="velocities"):
        tracker.solve_stars(StarList.of([[1.0, 2.0]], [1.0], [0.01]), velocity=[1 << 21, 0, 0])
