"""The filter of several heads: order of arrival, outliers, restarts, gaps, and input that cannot be."""

import math

import numpy as np
import pytest
from two_heads import ALONG_X, ALONG_Z, ARCSEC, HEADS, NOISE, SIGMA, error_of, fly, in_order, turned

from startracker.errors import InputError
from startracker.fusion import FusionFilter, Head
from startracker.geometry.attitude import Attitude
from startracker.tracking import Mekf, RateNoise

TIMES = np.linspace(0.0, 12.0, 25)


@pytest.fixture(scope="module")
def flight():
    return fly(np.random.default_rng(1), TIMES, lambda k: (0, 1) if k % 3 else (1,))


def state_of(fusion, t_s):
    mekf = fusion.estimate(t_s)
    return np.concatenate([mekf.quat, mekf.bias_rad_s, mekf.scale, mekf.alignment_rad(1), mekf.full_covariance.ravel()])


@pytest.mark.parametrize("seed", range(5))
def test_order_of_arrival_does_not_matter(flight, seed):
    expected = state_of(in_order(FusionFilter(HEADS, NOISE), flight), 12.0)
    rng, mixed = np.random.default_rng(seed), FusionFilter(HEADS, NOISE)
    data = [(mixed.add_gyro, sample) for sample in flight.gyro] + [(mixed.add_attitude, seen) for seen in flight.seen]
    for i in rng.permutation(len(data)):
        add, given = data[i]
        add(*given)
        mixed.estimate(float(rng.uniform(0.0, 12.0)))  # what is asked in between changes nothing
    np.testing.assert_array_equal(state_of(mixed, 12.0), expected)


def test_attitude_within_a_gyro_sample():
    """Divided in proportion: the same as two samples of half the rotation."""
    flight = fly(np.random.default_rng(2), TIMES, lambda k: (0, 1))
    pairs = list(zip(flight.gyro[::2], flight.gyro[1::2], strict=True))
    whole, halves = FusionFilter(HEADS, NOISE), FusionFilter(HEADS, NOISE)
    for (start, middle, one), (_, end, two) in pairs:
        whole.add_gyro(start, end, one + two)
        halves.add_gyro(start, middle, 0.5 * (one + two))
        halves.add_gyro(middle, end, 0.5 * (one + two))
    for seen in flight.seen:
        assert whole.add_attitude(*seen).outcome == halves.add_attitude(*seen).outcome
    np.testing.assert_allclose(state_of(whole, 12.0), state_of(halves, 12.0), rtol=1e-9, atol=1e-16)


def test_one_exact_head_is_the_filter_of_one_camera(flight):
    """With its axes for the body's: `Mekf`, to rounding."""
    fusion = FusionFilter([Head("a", ALONG_Z)], NOISE)
    alone = None
    for head, t_s, attitude, covariance in (s for s in flight.seen if s[0] == 0):
        fusion.add_attitude(head, t_s, attitude, covariance)
        if alone is None:
            alone, now_s = Mekf(attitude, covariance, NOISE), t_s
            continue
        for start, end, turn in flight.gyro:
            if now_s <= start < t_s:
                alone.predict(end - start, turn / (end - start))
                fusion.add_gyro(start, end, turn)
        alone.update_attitude(attitude, covariance)
        now_s = t_s
        found = fusion.estimate(t_s)
        np.testing.assert_allclose(found.quat, alone.quat, atol=1e-12)
        np.testing.assert_allclose(found.attitude_covariance, alone.attitude_covariance, rtol=1e-9, atol=1e-18)
    assert now_s > 11.0


def test_large_misalignments_are_recovered():
    """1° where 1° was allowed for: corrections are linearised again until nothing changes."""
    heads = (Head("a", ALONG_Z), Head("b", ALONG_X, math.radians(1.0)))
    flight = fly(np.random.default_rng(3), TIMES, lambda k: (0, 1), heads)
    found = in_order(FusionFilter(heads, NOISE), flight).estimate(12.0)
    error, sigma = found.alignment_rad(1) - flight.alignments[1], found.alignment_sigma_rad(1)
    assert np.abs(flight.alignments[1]).max() > math.radians(0.5)
    assert (sigma < 10 * ARCSEC).all()
    assert (np.abs(error) < 4.0 * sigma).all()
    assert found.mounting(1).angle_to(turned(ALONG_X, flight.alignments[1])) < 20 * ARCSEC


def test_head_that_starts_with_an_unknown_alignment():
    """The first attitude comes from it: the body is uncertain by its alignment, its own attitude is not."""
    fusion = FusionFilter(HEADS, NOISE)
    attitude, covariance = Attitude.from_radec_roll(10.0, 20.0, 30.0), np.diag(SIGMA**2)
    assert fusion.add_attitude("b", 0.0, attitude, covariance).outcome == "started"
    found = fusion.estimate(0.0)
    matrix = ALONG_X.as_matrix()
    body = matrix.T @ (covariance + np.eye(3) * HEADS[1].alignment_sigma_rad ** 2) @ matrix
    np.testing.assert_allclose(found.attitude_covariance, body, rtol=1e-12, atol=1e-22)
    np.testing.assert_allclose(found.head_covariance(1), covariance, rtol=1e-9, atol=1e-18)
    assert found.head_attitude(1).angle_to(attitude) < 1e-12
    # the other head tells the body, and through it the alignment
    camera = ALONG_Z @ found.attitude
    assert fusion.add_attitude("a", 1e-9, camera, covariance).outcome == "used"
    both = fusion.estimate(1e-9)
    np.testing.assert_allclose(np.diag(both.attitude_covariance), SIGMA**2, rtol=0.1)
    expected = covariance + matrix @ covariance @ matrix.T
    spread = np.linalg.inv(np.linalg.inv(expected) + np.eye(3) / HEADS[1].alignment_sigma_rad ** 2)
    np.testing.assert_allclose(both.alignment_sigma_rad(1), np.sqrt(np.diag(spread)), rtol=1e-6)


def test_a_wrong_attitude_is_rejected_and_three_restart(flight):
    fusion = in_order(FusionFilter(HEADS, NOISE), flight)
    before, alignment = state_of(fusion, 12.0), fusion.estimate(12.0).alignment_sigma_rad(1)
    truth, wrong, covariance = flight.attitudes[-1], Attitude.from_radec_roll(1.0, 2.0, 3.0), np.diag(SIGMA**2)
    fusion.add_gyro(12.0, 14.0, np.zeros(3))
    given = [wrong, ALONG_Z @ truth, wrong, wrong, wrong, wrong]
    outcomes = [fusion.add_attitude("a", 12.25 * (1.0 + 1e-3 * k), a, covariance).outcome for k, a in enumerate(given)]
    assert outcomes == ["rejected", "used", "rejected", "rejected", "restarted", "used"]
    np.testing.assert_array_equal(state_of(fusion, 12.0), before)
    found = fusion.estimate(13.0)
    assert found.attitude.angle_to(ALONG_Z.inverse @ wrong) < 60 * ARCSEC
    np.testing.assert_allclose(found.alignment_sigma_rad(1), alignment, rtol=0.05)


def test_gap_of_the_gyro_costs_certainty_and_a_late_sample_gives_it_back(flight):
    expected = state_of(in_order(FusionFilter(HEADS, NOISE), flight), 12.0)
    lacking = flight._replace(gyro=flight.gyro[:10] + flight.gyro[11:])
    fusion = in_order(FusionFilter(HEADS, NOISE), lacking)
    sigma = [np.trace(fusion.estimate(t_s).attitude_covariance) for t_s in TIMES[[10, 11]] - 1e-9]
    assert sigma[1] > 10.0 * sigma[0]
    fusion.add_gyro(*flight.gyro[10])
    np.testing.assert_array_equal(state_of(fusion, 12.0), expected)


def test_without_a_gyro():
    """A steady rate is estimated from both heads."""
    noise = RateNoise(1e-6, math.radians(2.0))
    rate = np.array([0.01, -0.005, 0.008])
    flight = fly(np.random.default_rng(4), TIMES, lambda k: (0, 1), rate=lambda t_s: rate)
    fusion = FusionFilter(HEADS, noise)
    for seen in flight.seen:
        assert fusion.add_attitude(*seen).outcome in ("started", "used")
    found = fusion.estimate(12.0)
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.rate_rad_s - rate) < 5.0 * sigma[3:]).all()
    assert (np.abs(flight.attitudes[-1].rotation_vector_to(found.attitude)) < 5.0 * sigma[:3]).all()
    assert (np.abs(error_of(flight, found)[-3:]) < 5.0 * found.alignment_sigma_rad(1)).all()


def test_memory(flight):
    """Data older than the memory are too late; what is kept gives the same."""
    whole, short = FusionFilter(HEADS, NOISE), FusionFilter(HEADS, NOISE, memory_s=3.0)
    in_order(whole, flight), in_order(short, flight)
    np.testing.assert_array_equal(state_of(whole, 12.0), state_of(short, 12.0))
    assert len(short._events) < len(whole._events) / 2
    head, _, attitude, covariance = flight.seen[0]
    assert short.add_attitude(head, 0.25, attitude, covariance).outcome == "too_late"
    short.add_gyro(-1.0, 0.0, np.zeros(3))
    begins_s = short._base.t_s
    for _ in range(2):  # what ends where the memory begins is not kept, and so overlaps nothing
        short.add_gyro(begins_s - 1.0, begins_s, np.zeros(3))
    np.testing.assert_array_equal(state_of(whole, 12.0), state_of(short, 12.0))
    with pytest.raises(InputError, match="memory"):
        short.estimate(1.0)
    assert whole.estimate(-1.0) is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda f: FusionFilter([], NOISE), "at least one head"),
        (lambda f: FusionFilter([HEADS[0], HEADS[0]], NOISE), "its own name"),
        (lambda f: FusionFilter(HEADS, NOISE, memory_s=0.0), "memory_s"),
        (lambda f: Head("a", ALONG_Z, -1.0), "alignment_sigma_rad"),
        (lambda f: Head("a", Attitude([0, 0, 0, 1])), "body to camera"),
        (lambda f: f.add_gyro(0.0, 0.0, np.zeros(3)), "positive length"),
        (lambda f: f.add_gyro(0.0, 1.0, [0.0, math.nan, 0.0]), "a gyro sample must be finite numbers"),
        (lambda f: (f.add_gyro(0.0, 1.0, np.zeros(3)), f.add_gyro(0.5, 1.5, np.zeros(3))), "overlap"),
        (lambda f: FusionFilter(HEADS, RateNoise()).add_gyro(0.0, 1.0, np.zeros(3)), "no gyro"),
        (lambda f: f.add_attitude("c", 0.0, Attitude([0, 0, 0, 1]), np.eye(3)), "unknown head"),
        (lambda f: f.add_attitude("a", 0.0, Attitude([0, 0, 0, 1]), -np.eye(3)), "positive definite"),
        (
            lambda f: f.add_attitude("a", math.nan, Attitude([0, 0, 0, 1]), np.eye(3)),
            "the time of an attitude must be a number",
        ),
        (lambda f: [f.add_attitude("a", 0.0, Attitude([0, 0, 0, 1]), np.eye(3)) for _ in range(2)], "two attitudes"),
    ],
)
def test_what_cannot_be_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        wrong(FusionFilter(HEADS, NOISE))
