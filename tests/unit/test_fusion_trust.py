"""Which head is believed: a history for each, restarts, mountings that have jumped, pictures that stand still."""

import math

import numpy as np
import pytest
from moving_heads import AT_REST, GYRO, SIGMA, follow, three
from scipy.special import chdtri
from two_heads import ALONG_Z, ARCSEC, turned

from startracker.fusion import FusionFilter, Head
from startracker.fusion.state import Window
from startracker.fusion.windows import unseen_shift
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, RateNoise

LARGE = chdtri(3, 1e-6)
OFF = np.array([360.0, 0.0, 0.0])


@pytest.mark.parametrize("seed", range(3))
def test_head_that_was_outvoted_does_not_take_over_when_the_other_is_blinded(seed):
    """b is 0.1° off where 20″ are stated, and a is blinded for 10 s. Before: a restart on b, and a was rejected for
    ever, with an error of 359″ and a NEES of 10,866."""
    heads = [three()[0], Head("b", three()[1].mounting, 20.0 * ARCSEC)]
    found = follow(
        seed, 140, heads, lambda h, t: OFF if h == 1 else AT_REST, seen=lambda h, t: h == 1 or not 100 <= t < 110
    )
    assert not any(outcome == "restarted" for *_, outcome in found.outcomes)
    assert all(outcome in ("started", "used") for _, h, outcome in found.outcomes if h == 0)
    assert (found.nees < LARGE).all()
    assert found.error_arcsec[100:].max() < 20.0
    # with two heads nothing shows which of them is off, and that is said, also while only one of them sees
    assert set(found.states[3:]) == {"heads_disagree"}
    status = found.fusion.status(139.0)
    assert not status.trusted
    assert "head b has moved by about" in status.reason
    assert status.heads["b"].shift_rad == pytest.approx(360.0 * ARCSEC, rel=0.2)
    assert status.heads["a"].state == "consistent"


@pytest.mark.parametrize("wrong", [0, 1, 2])
@pytest.mark.parametrize("seed", range(2))
def test_of_three_heads_two_that_agree_are_believed(seed, wrong):
    """Also if it is the first, which started the filter and defines the axes of the body."""
    heads = [Head(head.name, head.mounting, 20.0 * ARCSEC) for head in three()]
    found = follow(seed, 60, heads, lambda h, t: OFF if h == wrong else AT_REST)
    assert (found.nees[5:] < LARGE).all()
    assert set(found.states[5:]) == {"head_flagged"}
    status = found.fusion.status(59.0)
    assert status.trusted
    assert [name for name, head in status.heads.items() if head.state == "moved"] == ["abc"[wrong]]


def test_mounting_that_jumps_is_its_own_fault():
    """The head had agreed with the prediction, and the other still does: the prediction shows which one it is."""
    found = follow(1, 120, three()[:2], lambda h, t: OFF if h == 1 and t >= 60.0 else AT_REST)
    assert [outcome for k, h, outcome in found.outcomes if h == 1 and 60 <= k < 64] == [
        "rejected",
        "rejected",
        "realigned",
        "used",
    ]
    assert set(found.states[:60]) == {"unverified"}
    assert set(found.states[63:]) == {"head_flagged"}
    assert (found.nees < LARGE).all()
    off = np.linalg.norm(found.fusion.estimate(119.0).alignment_rad(1)) / ARCSEC
    assert off == pytest.approx(360.0, abs=4.0 * 60.0)


def test_a_restart_keeps_what_is_known_of_the_gyro():
    """A jump of the only head is a restart: its attitude says nothing about the gyro. Before, the bias was as uncertain
    as at first."""
    found = follow(2, 200, three()[:1], lambda h, t: OFF if t >= 150.0 else AT_REST, noise=GYRO)
    outcomes = [outcome for k, _, outcome in found.outcomes if k >= 150]
    assert outcomes[:4] == ["rejected", "rejected", "restarted", "used"]
    sigma = [np.sqrt(np.diag(found.fusion.estimate(t_s).covariance))[3:] for t_s in (149.5, 152.0)]
    assert (sigma[1] < 1.1 * sigma[0]).all()
    assert (sigma[1] < 0.2 * GYRO.bias_sigma_rad_s).all()


def test_bias_beyond_its_stated_size_is_learnt_where_the_picture_moves_and_said():
    """The gyro is off by 40 of its stated standard deviations from 60 s on: the stars are believed, and the status says
    what does not fit."""
    noise = GyroNoise(1e-5, 1e-7, 5e-5)
    rng, fusion = np.random.default_rng(3), FusionFilter([Head("a", ALONG_Z)], noise)
    body, states, errors = Attitude(rng.normal(size=4), "icrs", "body"), [], []
    for k in range(120):
        if k:
            turn = np.array([0.01, 0.0, 0.005])
            body = turned(body, turn)
            fusion.add_gyro(k - 1.0, k, turn + (np.array([0.0, 2e-3, 0.0]) if k > 60 else 0.0))
        fusion.add_attitude(0, float(k), turned(ALONG_Z @ body, SIGMA * rng.normal(size=3)), np.eye(3) * SIGMA**2)
        states.append(fusion.status(k).state)
        errors.append(fusion.estimate(k).attitude.angle_to(body) / ARCSEC)
    assert set(states[:60]) == {"consistent"}
    assert set(states[64:]) == {"gyro_disagrees"}
    assert max(errors[70:]) < 30.0
    assert "stars do not move as the gyro says" in fusion.status(119.0).reason


@pytest.mark.parametrize("heads", [1, 2])
def test_picture_that_stands_still_while_the_gyro_moves(heads):
    """From 60 s on head a shows the same sky with fresh noise. Its attitudes agree with one another, and not with the
    gyro, of 0.17°/s where a bias of 0.003°/s is stated: before, they restarted the filter at every third."""
    noise = GyroNoise(1e-5, 1e-7, 5e-5)
    rng, fusion = np.random.default_rng(4), FusionFilter(three()[:heads], noise)
    body, states, outcomes, errors = Attitude(rng.normal(size=4), "icrs", "body"), [], [], []
    for k in range(180):
        if k:
            turn = np.array([0.002, 0.001, 0.002])
            body = turned(body, turn)
            fusion.add_gyro(k - 1.0, k, turn + 1e-5 * rng.normal(size=3))
        if k <= 60:
            shown = body
        for h in range(heads):
            camera = fusion.heads[h].mounting @ (shown if h == 0 else body)
            update = fusion.add_attitude(h, float(k), turned(camera, SIGMA * rng.normal(size=3)), np.eye(3) * SIGMA**2)
            if h == 0:
                outcomes.append(update.outcome)
        states.append(fusion.status(k).state)
        errors.append(fusion.estimate(k).attitude.angle_to(body) / ARCSEC)
    assert set(outcomes[61:]) == {"rejected"}
    assert set(states[:60]) == {"consistent" if heads == 1 else "unverified"}
    if heads == 1:
        assert set(states[64:]) == {"gyro_disagrees"}
        assert "a picture may be frozen" in fusion.status(179.0).reason
    else:  # two that contradict each other, of which one agrees with the gyro
        assert set(states[64:]) == {"head_flagged"}
        assert max(errors) < 25.0


@pytest.mark.parametrize("seed", range(3))
def test_honest_bias_of_a_body_at_rest_is_no_contradiction(seed):
    found = follow(seed, 120, three()[:2], rate=lambda t_s: np.zeros(3))
    assert set(found.states) == {"unverified"}
    assert {outcome for *_, outcome in found.outcomes} == {"started", "used"}


def test_rate_that_was_assumed_is_given_up_after_three():
    """Without a gyro: the body turns otherwise than assumed, and both heads say so."""
    rng, fusion = np.random.default_rng(5), FusionFilter(three()[:2], RateNoise(1e-6, 1e-4))
    body, outcomes = Attitude(rng.normal(size=4), "icrs", "body"), []
    for k in range(60):
        body = turned(body, np.array([0.0, 0.02, 0.0]) if k > 20 else np.zeros(3))
        for h, head in enumerate(fusion.heads):
            camera = turned(head.mounting @ body, SIGMA * rng.normal(size=3))
            outcomes.append(fusion.add_attitude(h, float(k), camera, np.eye(3) * SIGMA**2).outcome)
    assert "restarted" in outcomes[42:50]
    assert set(outcomes[-40:]) == {"used"}
    assert fusion.estimate(59.0).attitude.angle_to(body) < 60.0 * ARCSEC


def test_status_before_the_first_attitude_and_after():
    fusion = FusionFilter(three(), GYRO)
    assert fusion.status(0.0).state == "no_attitude"
    assert not fusion.status(0.0).trusted
    fusion.add_attitude("b", 0.0, Attitude([0, 0, 0, 1]), np.eye(3) * SIGMA**2)
    status = fusion.status(math.pi)
    assert status == ("consistent", "", status.heads)
    assert [head.state for head in status.heads.values()] == ["no_attitude", "consistent", "no_attitude"]


def windows(*frames, sigma=SIGMA):
    return [Window(factor=np.eye(3) * sigma, frames=count) for count in frames]


def test_the_motion_that_is_not_seen_is_that_of_a_ramp_with_this_chi_square():
    """A ramp to D fitted to white noise: the slope over N frames has the variance 12 v/(N T²), here by a fit."""
    count, chi2 = 200, 21.1
    time = np.arange(count) - 0.5 * (count - 1)
    slope_sigma = np.sqrt(2.0) * SIGMA / np.sqrt(np.sum(time**2))
    end = np.sqrt(chi2) * slope_sigma * count
    assert unseen_shift(windows(count, count), chi2) == pytest.approx(0.75 * end, rel=1e-3)


@pytest.mark.parametrize(
    ("frames", "ratio"), [((400, 400), 0.5), ((100, 400), 1.0), ((100, 100, 100), math.sqrt(0.75))]
)
def test_more_frames_and_more_heads_show_smaller_motions(frames, ratio):
    """What two heads of 100 frames leave unseen, times √(100/N), of the frames that both have; the mean of two other
    heads has half the variance of one."""
    assert unseen_shift(windows(*frames), 20.0) == pytest.approx(ratio * unseen_shift(windows(100, 100), 20.0))


def test_one_head_has_nothing_to_be_compared_with():
    assert unseen_shift(windows(1000), 20.0) == unseen_shift(windows(1000, 0), 20.0) == math.inf


def test_heads_are_verified_by_frames_or_by_a_stated_motion():
    """Two heads of 5″ at 1 Hz, and a gyro of 2″/√s, which know the attitude to 2.3″: motions are seen by then from
    0.75 √(12 · 21.1 · 60/N)″ on, √2 of that after 800 frames. Head b moves by 0.2″/s from 900 s on: that is suspected
    at a probability of 1e-4 before it is found at 1e-6."""
    found = follow(5, 980, three()[:2], lambda h, t: np.full(3, 0.2 * max(t - 900.0, 0.0) * h))
    verified = found.states.index("consistent")
    assert 600 < verified < 900
    assert found.states[899] == "consistent"
    assert found.fusion.status(920.0) == ("consistent", "", found.fusion.status(920.0).heads)
    moving = found.states[900:]
    flagged = next(k for k, state in enumerate(moving) if state not in ("consistent", "unverified"))
    assert "unverified" in moving[:flagged]
    early = follow(5, 20, three()[:2]).fusion.status(19.0)
    assert not early.trusted
    assert "which so few attitudes do not show" in early.reason
    assert set(follow(5, 20, three(bending_sigma_rad=ARCSEC)[:2]).states) == {"consistent"}
