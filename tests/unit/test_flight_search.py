"""Identification of the flight build beside floating point, brute force and truth."""

import ctypes
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.flight_lists import FIELDS, null_list
from simulator.randomness import stream
from simulator.study.exported_c.targets import HOST
from startracker import Camera, StarTracker
from startracker.errors import InputError
from startracker.estimation.directions import focal_slopes, normal_equations
from startracker.flight import search_tables as tabled
from startracker.flight.apparent import epoch_of
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.export import SATURATED_PART
from startracker.flight.search_export import MOST_VOTES
from startracker.flight.search_plan import SEARCHES
from startracker.flight.search_tables import search_tables
from startracker.flight.stars import StarList
from startracker.geometry.distortion import Distortion
from startracker.identification import bayes_factor, clustering_null
from startracker.identification.bayes_factor import Matched, count_table, log_bayes_factor, log_magnitude_ratios
from startracker.identification.clustering_null import clustering_price, log_excess_density
from startracker.identification.verification import MOST_EXTRA
from startracker.inputs import SATURATED_SHARE
from startracker.observer import Observer
from startracker.settings import DetectionSettings, TriadSettings
from tests.helpers.flight_lists import random_fields
from tests.helpers.flight_stages import ONE, CompiledFlight, integers, matrix_of, pointer

pytestmark = [pytest.mark.system, pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")]

LOG_UP = 24
"""Largest error of ``tracker_log_down``: 4096 log₂(1 + 1/256), rounded up."""


@pytest.fixture(scope="module")
def star_tracker():
    camera = Camera(4545.5, 4545.5, 511.5, 511.5, 1024, 1024, Distortion(k1=-0.05))
    return StarTracker(camera, magnitude_limit=6.5)


@pytest.fixture(scope="module")
def design(star_tracker):
    return FlightDesign(star_tracker.camera, star_tracker.guide, DetectorNumbers(3.3, 13.0, 4083), 0.9)


@pytest.fixture(scope="module")
def flight(design, tmp_path_factory):
    return CompiledFlight(design, tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="module")
def tables(flight):
    return flight.tables.search


def fields(star_tracker, kind, count, seed=1):
    return random_fields(star_tracker, "search", kind, count, seed)


def test_constants_are_those_of_floating_point():
    assert tabled.WIDE_MAG == bayes_factor._WIDE_MAG
    assert tabled.WIDE_SHARE == bayes_factor._WIDE_SHARE
    assert tabled.FLOOR == bayes_factor._FLOOR
    assert tabled.EVEN == clustering_null._EVEN
    assert pytest.approx(1.0 / SATURATED_SHARE) == SATURATED_PART


def test_logarithms_are_bounds(flight):
    rng = stream(2, "logarithms")
    down, total, total_up = (getattr(flight.c, f"tracker_{name}") for name in ("log_down", "log_sum", "log_sum_up"))
    for function in (down, total, total_up):
        function.restype, function.argtypes = ctypes.c_int64, [ctypes.c_int64] * (1 if function is down else 2)
    for n in (2.0 ** rng.uniform(0.0, 62.0, 20_000)).astype(np.int64).tolist():
        exact = 4096.0 * math.log2(n)
        assert down(n) <= exact + 1e-6
        assert down(n) + LOG_UP >= exact
    a, b = rng.integers(-400_000, 400_000, (2, 20_000))
    b = np.where(rng.random(20_000) < 0.5, a + rng.integers(-60_000, 60_000, 20_000), b)
    for x, y, exact in zip(a.tolist(), b.tolist(), 4096.0 * np.logaddexp2(a / 4096.0, b / 4096.0), strict=True):
        # a step of 1/64 of which one bit is half, and rounding
        assert exact - 33 <= total(x, y) <= exact + 1e-6
        assert exact - 1e-6 <= total_up(x, y) <= exact + 34


def field_at(flight, matrix, most):
    """Number, direction and magnitude of the guide stars of a field."""
    found = flight.rows("stage_field", 5, matrix_of(matrix), most)
    return found[:, 0], found[:, 1:4], found[:, 4]


def test_field_is_that_of_the_camera(star_tracker, flight):
    """Every guide star on the image but for those within 4 px of its edge: 2 px of the outline's margin, and 2 px of
    its table, which is linear between azimuths 1.4 degrees apart."""
    rng = stream(3, "fields")
    flight.begin(fields(star_tracker, "clean", 1)[0].stars)
    for _ in range(40):
        matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix *= np.linalg.det(matrix)
        most = 2 * flight.design.detection.max_stars
        found = set(field_at(flight, integers(matrix), most)[0].tolist())
        inner = set(star_tracker.guide.in_field(matrix, -4.0)[0].tolist())
        outer = set(star_tracker.guide.in_field(matrix, 4.0)[0].tolist())
        assert len(found) < most
        assert inner <= found <= outer
        assert field_at(flight, integers(matrix), 7)[0].tolist() == sorted(found)[:7]


def float_evidence(seen, field, rank, matrix, star_tracker):
    """log₂ B of the same match in floating point, with the integers' directions, variances and magnitudes."""
    _, direction, magnitude_of = field
    n, depth = len(seen.index), len(direction)
    observed = seen.direction / np.linalg.norm(seen.direction, axis=1, keepdims=True)
    guide = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    predicted = guide @ (matrix / ONE).T
    sigma = np.sqrt(seen.variance) / ONE
    away = np.linalg.norm(observed - predicted[rank], axis=1)
    distance = np.where(rank >= 0, away, np.inf)
    information, _ = normal_equations(observed, focal_slopes(observed), predicted, rank, sigma, 3)
    magnitude = seen.magnitude / 64.0 if seen.brightness else np.full(n, math.nan)
    ratios = log_magnitude_ratios(magnitude, rank, magnitude_of / 64.0)
    area = star_tracker.guide.solid_angle_sr
    value, _ = log_bayes_factor(
        Matched(distance, rank, sigma, ratios), information, depth, area, 0.01, count_table(n, 2 * n + MOST_EXTRA)
    )
    return (value - clustering_price(log_excess_density(observed, area), rank)) / math.log(2.0)


@pytest.mark.parametrize("kind", ["clean", "noise", "false stars", "few stars"])
def test_evidence_is_that_of_floating_point_and_never_above(star_tracker, flight, kind):
    """Within 0.1 bits a star and one for the rest: 1/64 bit of each table of counts, 1/16 of the crowding's steps."""
    compared = 0
    for one in fields(star_tracker, kind, 25):
        seen, matrix = flight.begin(one.stars), integers(one.matrix)
        most = 2 * len(seen.index) + MOST_EXTRA
        field, out = field_at(flight, matrix, most), np.zeros(1 + len(seen.index), np.int64)
        count = flight.call("stage_weigh", out, matrix_of(matrix), most, 254016)
        if count < 3:
            continue
        evidence, rank = out[0], out[1:]
        assert count == np.count_nonzero(rank >= 0)
        exact = float_evidence(seen, field, rank, matrix, star_tracker)
        assert evidence / 4096.0 <= exact + 0.02  # the density of magnitudes beyond the widths that are averaged over
        assert evidence / 4096.0 >= exact - 1.0 - 0.1 * count
        compared += 1
    assert compared > 15


def tolerance(chord, error, plan):
    """Of a separation, 2.30: standard errors, and 1e-4 of it for aberration."""
    return ((error * plan.sides) >> 8) + ((chord * 107) >> 20)


def neighbours_of(pole, seen, plan, t):
    """The nearest stars that may vote for a pole, and their bins of guide pairs."""
    found = []
    for star in range(min(plan.among, len(seen.index))):
        chord = int(seen.chord[pole, star])
        allowed = tolerance(chord, int(seen.error[pole, star]), plan)
        if star != pole and chord >= 3 * allowed and chord - allowed <= t.longest:
            found.append((chord, star, chord - allowed, chord + allowed))
    last = len(t.bin_start) - 2
    for _, star, low, high in sorted(found)[: plan.neighbours]:
        first, beyond = (t.bin_start[min(end >> t.bin_shift, last) + k] for k, end in enumerate((low, high)))
        yield star, range(int(first), int(beyond))


def brute_force(pole, seen, plan, t):
    """Guide stars that a pole may be, by loops over the neighbours' pairs, and how many neighbours agree."""
    near = list(neighbours_of(pole, seen, plan, t))
    votes = {}
    for k, (star, pairs) in enumerate(near):
        fainter = int(seen.magnitude[pole] - seen.magnitude[star])
        for pair in pairs:
            ends = int(t.first[pair]), int(t.second[pair])
            for a, b in (ends, ends[::-1]):
                if abs(fainter - int(t.magnitude[a] - t.magnitude[b])) <= t.magnitude_tolerance:
                    votes.setdefault(a, []).append((k, b))
    out = {}
    for a, listed in votes.items():
        for k, b in listed:
            agreeing = set()
            for m, c in listed:
                one, other = near[k][0], near[m][0]
                apart = math.dist(t.guide[b].tolist(), t.guide[c].tolist())
                chord = int(seen.chord[one, other])
                allowed = tolerance(chord, int(seen.error[one, other]), plan)
                triangles = (seen.direction[[pole, one, other]] / ONE, t.guide[[a, b, c]] / ONE)
                observed, known = (np.linalg.det(corners) for corners in triangles)
                thin = abs(observed) * ONE <= allowed * chord / ONE + 2
                if m != k and abs(apart - chord) <= allowed and (thin or observed * known > 0):
                    agreeing.add(m)
            if len(agreeing) + 1 >= max(plan.need, out.get(a, 0)):
                out[a] = len(agreeing) + 1
    return out


def test_votes_are_those_of_brute_force(star_tracker, design, flight, tmp_path):
    """With room for the votes about every guide star, of which the default keeps the most frequent."""
    wide = flight.tables._replace(search=flight.tables.search._replace(most_kept=10**6))
    whole, plan, found = CompiledFlight(design, tmp_path / "c", wide), SEARCHES[0], 0
    for one in fields(star_tracker, "false stars", 2):
        seen = whole.begin(one.stars)
        for pole in range(3):
            got = whole.rows("stage_candidates", 5, pole, 0)
            expected = brute_force(pole, seen, plan, wide.search)
            rows = {row[1]: row[4] for row in got.tolist()}
            assert rows == dict(sorted(expected.items(), key=lambda item: (-item[1], item[0]))[:48])
            found += len(rows)
    assert found > 20


def test_more_votes_than_there_is_room_for(star_tracker, design, flight, tmp_path):
    """The passes over ranges of guide stars give what a single one does."""
    fewer = (("tracker_tables.h", f"SEARCH_MOST_VOTES {MOST_VOTES}", f"SEARCH_MOST_VOTES {MOST_VOTES // 4}"),)
    sliced, one = CompiledFlight(design, tmp_path / "c", replaced=fewer), fields(star_tracker, "clean", 1)[0]
    for build in (flight, sliced):
        build.begin(one.stars)
    whole = flight.rows("stage_candidates", 5, 0, 1)
    assert len(whole) > 0
    assert sliced.rows("stage_candidates", 5, 0, 1).tolist() == whole.tolist()
    assert sliced.solve_list(one.stars).counts["steps"] > flight.solve_list(one.stars).counts["steps"]


def angle_deg(matrix, truth):
    turn = matrix @ truth.T
    return math.degrees(math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8.0), 1.0)) * 2.0)


@pytest.mark.parametrize("kind", list(FIELDS))
def test_fields_as_star_tracker(star_tracker, flight, kind):
    """As many fields as `StarTracker` solves but for 1 %, rounded up; none wrong."""
    mine = theirs = 0
    for one in fields(star_tracker, kind, 12):
        theirs += star_tracker.solve_centroids(one.xy, one.flux, sigma_px=one.sigma_px).solved
        answer = flight.solve_list(one.stars)
        mine += answer.attitude is not None
        if answer.attitude is None:
            assert answer.numbers == ()
            continue
        assert angle_deg(answer.attitude.as_matrix(), one.matrix) < 0.1
        named = np.array(answer.numbers) > 0
        _, _, positions = star_tracker.guide.in_field(one.matrix, 5.0)
        near = np.linalg.norm(one.xy[named][:, None] - positions[None], axis=2).min(axis=1)
        assert near.max() < 3.0
    assert mine >= theirs - 1
    assert theirs >= 7


def test_statuses(star_tracker, design, flight, tmp_path):
    one = fields(star_tracker, "clean", 1)[0].stars
    assert flight.solve_list(one.take(np.arange(0))).status == "no_stars"
    assert flight.solve_list(one.take([0, 1])).status == "too_few_stars"
    assert flight.solve_list(one._replace(variance=one.variance * 0 + (26 << 26))).reason == "few_found"
    assert flight.solve_list(one._replace(variance=one.variance * 0)).status == "solved"
    assert flight.solve_list(one._replace(flux=one.flux * 0)).status == "solved"
    few = tuple(plan._replace(steps=0, poles=2) for plan in SEARCHES)
    tables = flight.tables._replace(search=flight.tables.search._replace(searches=few))
    null = null_list(star_tracker, "uniform", stream(5, "limit"))
    assert CompiledFlight(design, tmp_path / "c", tables).solve_list(null).status == "search_limit"


def test_prior_adds_evidence_and_is_checked(star_tracker, flight):
    """Three stars, for which the whole sky is too large, are identified around a prior; a wrong one is contradicted."""
    accepted = alone = 0
    for one in fields(star_tracker, "clean", 5, seed=6):
        if len(one.xy) < 10:
            continue
        three = one.stars.take([0, 1, 2])
        matrix, radius = integers(one.matrix), round(math.radians(0.5) * (1 << 28))
        answer = flight.solve_list(three, prior=(matrix, radius))
        accepted += answer.attitude is not None
        alone += flight.solve_list(three).attitude is not None
        if answer.attitude is not None:
            assert angle_deg(answer.attitude.as_matrix(), one.matrix) < 0.2
            assert not answer.counts["contradicted"]
        contradicted = flight.solve_list(one.stars, prior=(matrix[[1, 2, 0]], radius))
        assert contradicted.status == "solved"
        assert contradicted.counts["contradicted"]
    assert accepted > alone


def test_aberration(star_tracker, flight):
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
        3600.0 * angle_deg(flight.solve_list(stars, velocity=velocity).attitude.as_matrix(), one.matrix)
        for velocity in (integers(beta), None)
    ]
    assert arcsec[0] < 1.0 < arcsec[1] < 120.0
    too_fast = flight.solve_list(stars, velocity=[(1 << 20) + 1, 0, 0])
    assert too_fast == flight.solve_list(stars)


def test_proper_motion(star_tracker, flight):
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
    known, unknown = flight.solve_list(stars, epoch=epoch), flight.solve_list(stars)
    assert known.numbers[here] == 57939
    assert unknown.numbers[here] == 0
    assert known.counts["used"] > unknown.counts["used"]
    assert math.radians(angle_deg(known.attitude.as_matrix(), truth)) < 0.02 * camera.pixel_rad
    assert flight.solve_list(stars, epoch=1 << 16) == unknown  # two thousand years away


def test_verification_recovers_from_a_coarse_attitude(star_tracker, flight):
    one = fields(star_tracker, "clean", 4, seed=8)[3]
    seen = flight.begin(one.stars)
    sigma = math.sqrt(float(seen.variance[0])) / ONE
    for axis, errors in ((0, 20.0), (1, -20.0), (2, 100.0)):  # in stated errors, of a first gate of 63
        turn = Rotation.from_rotvec(np.eye(3)[axis] * errors * sigma).as_matrix()
        found = np.zeros(10, np.int64)
        flight.call("stage_verify", found, matrix_of(integers(turn @ one.matrix)), 0)
        assert found[0] > 40 * 4096
        error = Rotation.from_matrix(found[1:].reshape(3, 3) / ONE @ one.matrix.T).as_rotvec()
        assert np.abs(error[:2]).max() < sigma
        assert abs(error[2]) < 20.0 * sigma  # about the boresight, by the field's lever


def test_frame_of_a_pair_is_orthonormal(flight):
    rng = stream(9, "pairs")
    for separation in (1e-4, 0.01, 0.3):
        p = rng.normal(size=3)
        p /= np.linalg.norm(p)
        q = p + separation * np.cross(p, rng.normal(size=3))
        ends, frame = [integers(p), integers(q / np.linalg.norm(q))], np.zeros((3, 3), np.int64)
        assert flight.c.stage_pair_frame(*map(pointer, ends), pointer(frame))
        frame = frame / ONE
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=4e-9 / separation)  # the difference's last bit


def test_designs_that_are_refused(design):
    for changed, message in (
        ({"identifier": "triads", "identification": TriadSettings(max_stars=40)}, "max_stars to 3 to 24"),
        ({"detection": DetectionSettings(max_stars=200)}, "up to 120 stars"),
    ):
        with pytest.raises(InputError, match=message):
            search_tables(replace(design, **changed))
