"""What cannot be is refused before it changes a filter: one error, and every state as before, to the last bit."""

import math

import numpy as np
import pytest
from two_heads import HEADS, NOISE, SIGMA, fly, in_order

from startracker.errors import InputError
from startracker.fusion import AlignedMekf, FusionFilter, Head
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, Mekf, RateNoise

P = np.diag(SIGMA**2)
A = Attitude([0.1, -0.4, 0.2, 0.8])
SKEW = P.copy()
SKEW[0, 1] += 0.5 * P[0, 0]
TIMES = np.linspace(0.0, 5.0, 11)
NOT_A_COVARIANCE = {
    "negative": -P,
    "indefinite": np.diag([1.0, 1.0, -1e-3]) * 1e-10,
    "zero": np.zeros((3, 3)),
    "NaN": np.where(np.eye(3) > 0, P, math.nan),
    "NaN on the diagonal": np.diag([math.nan, 1.0, 1.0]),
    "infinite": np.diag([math.inf, 1.0, 1.0]),
    "asymmetric": SKEW,
    "complex": P + 0j,
    "of too large variances": 1e300 * np.eye(3),
    "of too small variances": 1e-320 * np.eye(3),
    "of another shape": np.eye(2),
    "a vector": np.ones(3),
    "text": "P",
    "text inside": [["a"] * 3] * 3,
    "ragged": [[1.0], [1.0, 2.0], [3.0]],
    "None": None,
    "truth values": np.eye(3) > 0,
}
NOT_A_ROTATION = {
    "1e308": [1e308, 0.0, 0.0],
    "faster than any body": [0.0, 600.0, 0.0],
    "NaN": [0.0, math.nan, 0.0],
    "infinite": [0.0, 0.0, -math.inf],
    "complex": np.array([1j, 0.0, 0.0]),
    "of another shape": [0.0, 0.0],
    "a matrix": np.zeros((3, 3)),
    "text": "fast",
    "text inside": ["a", "b", "c"],
    "None": None,
}
NOT_A_RATE = NOT_A_ROTATION | {"faster than any body": [0.0, 1200.0, 0.0]}
NOT_A_TIME = {
    "NaN": math.nan,
    "infinite": math.inf,
    "1e300": 1e300,
    "text": "1",
    "None": None,
    "complex": 1j,
    "a list": [1.0],
}
NOT_A_HEAD = {"unknown": "c", "index": 2, "negative": -1, "None": None, "float": 0.0, "truth": True, "list": [0]}
NOT_AN_ATTITUDE = {
    "None": None,
    "a quaternion": [0.0, 0.0, 0.0, 1.0],
    "to the body": Attitude([0, 0, 0, 1], "icrs", "body"),
    "of a mounting": HEADS[0].mounting,
    "from the camera": A.inverse,
}


def bits(fusion):
    """Everything that a filter keeps, as bytes."""
    found = []
    for t_s in TIMES:
        mekf = fusion.estimate(float(t_s))
        found += [mekf.quat, mekf.bias_rad_s, mekf.scale, mekf.alignment_rad(1), mekf.full_covariance, mekf.rate_rad_s]
        found.append(np.frombuffer(repr(fusion.status(float(t_s))).encode(), np.uint8))
    counts = len(fusion._events), len(fusion._states), len(fusion._samples), fusion._base.t_s
    return counts, [np.asarray(array).tobytes() for array in found]


@pytest.fixture(scope="module")
def filled():
    """A filter with data, and what it keeps."""
    fusion = in_order(FusionFilter(HEADS, NOISE), fly(np.random.default_rng(1), TIMES, lambda k: (0, 1)))
    return fusion, bits(fusion)


REFUSED = {
    **{f"covariance {name}": lambda f, p=p: f.add_attitude("a", 4.7, A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"late covariance {name}": lambda f, p=p: f.add_attitude(1, 1.3, A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"attitude {name}": lambda f, a=a: f.add_attitude("a", 4.7, a, P) for name, a in NOT_AN_ATTITUDE.items()},
    **{f"head {name}": lambda f, h=h: f.add_attitude(h, 4.7, A, P) for name, h in NOT_A_HEAD.items()},
    **{f"time {name}": lambda f, t=t: f.add_attitude("a", t, A, P) for name, t in NOT_A_TIME.items()},
    **{f"rotation {name}": lambda f, r=r: f.add_gyro(5.0, 5.5, r) for name, r in NOT_A_ROTATION.items()},
    **{f"start {name}": lambda f, t=t: f.add_gyro(t, 5.5, np.zeros(3)) for name, t in NOT_A_TIME.items()},
    **{f"end {name}": lambda f, t=t: f.add_gyro(5.0, t, np.zeros(3)) for name, t in NOT_A_TIME.items()},
    **{f"estimate at {name}": lambda f, t=t: f.estimate(t) for name, t in NOT_A_TIME.items()},
    **{f"status at {name}": lambda f, t=t: f.status(t) for name, t in NOT_A_TIME.items()},
    "interval backwards": lambda f: f.add_gyro(6.0, 5.0, np.zeros(3)),
    "interval of no length": lambda f: f.add_gyro(6.0, 6.0, np.zeros(3)),
    "interval too short for its rotation": lambda f: f.add_gyro(5.0, 5.0 + 1e-12, [1.0, 0.0, 0.0]),
    "overlap": lambda f: f.add_gyro(4.9, 5.2, np.zeros(3)),
    "second attitude at one time": lambda f: f.add_attitude("a", 5.0, A, P),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_refused_and_nothing_changed(filled, case):
    fusion, before = filled
    with pytest.raises(InputError) as error:
        REFUSED[case](fusion)
    assert "\n" not in str(error.value)
    assert bits(fusion) == before


def test_goes_on_as_if_nothing_had_been_refused():
    """The data of a flight with something that cannot be between every two of them."""
    flight = fly(np.random.default_rng(2), TIMES, lambda k: (0, 1))
    plain, disturbed = in_order(FusionFilter(HEADS, NOISE), flight), FusionFilter(HEADS, NOISE)
    refused = list(REFUSED.values())
    data = [(disturbed.add_gyro, one) for one in flight.gyro] + [(disturbed.add_attitude, one) for one in flight.seen]
    for k, (add, given) in enumerate(data):
        with pytest.raises(InputError):
            disturbed.add_attitude(("a", None)[k % 2], 1.0, None, list(NOT_A_COVARIANCE.values())[k % 17])
        add(*given)
    assert len(refused) > 80
    assert bits(disturbed)[1] == bits(plain)[1]


def test_attitudes_and_samples_in_other_number_types():
    """What a program may well have: integers, single precision, lists, a covariance with the rounding of a product."""
    flight = fly(np.random.default_rng(3), TIMES, lambda k: (0, 1))
    fusion = FusionFilter(HEADS, NOISE)
    rounded = P + 1e-9 * P[0, 0] * np.triu(np.ones((3, 3)), 1)
    fusion.add_attitude(np.int64(0), np.float32(0.0), flight.seen[0][2], rounded.tolist())
    fusion.add_gyro(0, 1, [0, 0, 0])
    assert fusion.add_attitude("b", 1, flight.seen[1][2], P.astype(np.float32)).outcome in ("used", "rejected")
    covariance = fusion.estimate(1).full_covariance
    np.testing.assert_array_equal(covariance, covariance.T)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FusionFilter("ab", NOISE), "list of Head"),
        (lambda: FusionFilter([HEADS[0], "b"], NOISE), "list of Head"),
        (lambda: FusionFilter(None, NOISE), "list of Head"),
        (lambda: FusionFilter(HEADS, None), "GyroNoise or RateNoise"),
        (lambda: FusionFilter(HEADS, NOISE, memory_s="long"), "memory_s"),
        (lambda: FusionFilter(HEADS, NOISE, memory_s=math.nan), "memory_s"),
        (lambda: FusionFilter(HEADS, NOISE, false_rejection=1.5), "false_rejection"),
        (lambda: FusionFilter(HEADS, NOISE, false_rejection="x"), "false_rejection"),
        (lambda: Head(3, HEADS[0].mounting), "name"),
        (lambda: Head("a", None), "body to camera"),
        (lambda: Head("a", HEADS[0].mounting, "x"), "alignment_sigma_rad"),
        (lambda: Head("a", HEADS[0].mounting, math.nan), "alignment_sigma_rad"),
        (lambda: Head("a", HEADS[0].mounting, 0.0, (1.0, 2.0)), "correlated_sigma_rad"),
        (lambda: Head("a", HEADS[0].mounting, 0.0, "abc"), "correlated_sigma_rad"),
        (lambda: Head("a", HEADS[0].mounting, correlation_s=0.0), "correlation_s"),
        (lambda: Head("a", HEADS[0].mounting, bending_sigma_rad=-1.0), "bending_sigma_rad"),
        (lambda: Head("a", HEADS[0].mounting, bending_s=math.inf), "bending_s"),
        (lambda: GyroNoise("x"), "angle_random_walk"),
        (lambda: GyroNoise(1j), "angle_random_walk"),
        (lambda: RateNoise(None), "acceleration"),
        (lambda: AlignedMekf(HEADS, 0, A, -P, NOISE), "positive definite"),
        (lambda: AlignedMekf(HEADS, 7, A, P, NOISE), "index"),
        (lambda: AlignedMekf(HEADS, 0, HEADS[0].mounting, P, NOISE), "icrs to camera"),
    ],
)
def test_what_no_filter_can_be_made_of(make, message):
    with pytest.raises(InputError, match=message):
        make()


MEKF = {
    **{f"update {name}": lambda m, p=p: m.update_attitude(A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"head {name}": lambda m, p=p: m.update_head(0, A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"reset {name}": lambda m, p=p: m.reset(A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"restart {name}": lambda m, p=p: m.restart(0, A, p) for name, p in NOT_A_COVARIANCE.items()},
    **{f"attitude {name}": lambda m, a=a: m.update_attitude(a, P) for name, a in NOT_AN_ATTITUDE.items()},
    **{f"attitude of head {name}": lambda m, a=a: m.update_head(0, a, P) for name, a in NOT_AN_ATTITUDE.items()},
    **{f"reset to {name}": lambda m, a=a: m.reset(a, P) for name, a in NOT_AN_ATTITUDE.items()},
    **{f"rate {name}": lambda m, r=r: m.predict(0.1, r) for name, r in NOT_A_RATE.items() if r is not None},
    **{f"rate of the reset {name}": lambda m, r=r: m.reset(A, P, r) for name, r in NOT_A_RATE.items() if r is not None},
    **{f"step {name}": lambda m, t=t: m.predict(t, np.zeros(3)) for name, t in NOT_A_TIME.items() if t != 1e300},
    "step backwards": lambda m: m.predict(-1.0, np.zeros(3)),
    "second sigma": lambda m: m.reset(A, P, None, -1.0),
    "index of a head": lambda m: m.update_head(2, A, P),
    "index that is a name": lambda m: m.update_head("a", A, P),
    "directions complex": lambda m: m.update_vectors(np.eye(3) + 0j, np.eye(3), 1e-5),
    "directions of text": lambda m: m.update_vectors("abc", np.eye(3), 1e-5),
    "reference NaN": lambda m: m.update_vectors(np.eye(3), np.eye(3) * math.nan, 1e-5),
    "sigma of text": lambda m: m.update_vectors(np.eye(3), np.eye(3), "x"),
    "sigma None": lambda m: m.update_vectors(np.eye(3), np.eye(3), None),
}


OF_HEADS = ("head", "restart", "attitude of head", "index")


@pytest.mark.parametrize("kind", ["one camera", "heads"])
@pytest.mark.parametrize("case", list(MEKF))
def test_filter_refuses_and_is_as_before(case, kind):
    if kind == "one camera":
        if case.startswith(OF_HEADS):
            return
        mekf = Mekf(A, P, NOISE)
    else:
        if case in ("attitude to the body", "reset to to the body"):  # that is what it estimates
            return
        mekf = AlignedMekf(HEADS, 0, A, P, NOISE)
    mekf.predict(0.1, [1e-3, 0.0, 0.0])

    def kept():
        return [mekf.quat.tobytes(), mekf._covariance.tobytes(), mekf.rate_rad_s.tobytes(), mekf.bias_excess]

    before = kept()
    with pytest.raises(InputError) as error:
        MEKF[case](mekf)
    assert "\n" not in str(error.value)
    assert kept() == before


def test_losing_confidence_multiplies_the_covariance():
    mekf = Mekf(A, P, NOISE)
    before = mekf.covariance
    mekf.distrust(10.0)
    np.testing.assert_allclose(mekf.covariance, 10.0 * before, rtol=1e-15)
