"""Requirements, and the one function that judges them: against exact binomial values and brute-force mixtures."""

import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from scipy import stats

from simulator.scenario import Scenario
from simulator.study.specification.measured import Measured, Setting, setting_of
from simulator.study.specification.predicted import Predicted, across_percentile, axis_percentile
from simulator.study.specification.requirements import Requirement, Specification, specification_of
from simulator.study.specification.verdicts import (
    MET,
    NOT_MET,
    UNDECIDED,
    Estimate,
    Judgement,
    Verdict,
    frames_needed,
    judge,
)
from startracker.geometry.attitude import radec_to_direction

ARCSEC = 1 / 3600
AXES = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")


def frames(n, seed=1, sigma_deg=ARCSEC, **changes):
    """Columns of n solved frames with normal errors."""
    rng = np.random.default_rng(seed)
    columns = {"status": np.array(["solved"] * n, dtype=object), "wrong": np.zeros(n, bool), "rate_deg_s": np.zeros(n)}
    return columns | {f"error_{axis}_deg": rng.normal(0, sigma_deg, n) for axis in AXES} | changes


def verdicts(columns, specification, setting=Setting()):
    judged = judge(specification, Measured(columns, specification, setting))
    return judged, {each.requirement.name: each for each in judged.verdicts}


# ------------------------------------------------------------------ the section
def test_axes_of_body_and_camera_and_any_percentile(tmp_path):
    scenario = Scenario.load(
        "cubesat_ideal",
        {
            "specification.across_deg": 0.003,
            "specification.percentile": 95.0,
            "specification.errors": [{"axis": "across", "limit_deg": 0.001, "percentile": 68}],
            "specification.availability": 0.99,
            "specification.acquisition_s": 2.0,
            "specification.earth_exclusion_deg": 30.0,
            "specification.rate_deg_s": 1.0,
        },
    )
    found = specification_of(scenario)
    assert [each.name for each in found.requirements] == [
        "roll", "pitch", "yaw", "across", "across_p68", "availability", "acquisition",
    ]  # fmt: skip
    assert found.find("across_p68") == Requirement("across_p68", 0.001, 68.0, "across")
    assert found.find("roll").percent == 95.0
    assert (found.rate_deg_s, found.exclusion_deg) == (1.0, (("earth", 30.0),))
    (tmp_path / "again.yaml").write_text(scenario.to_yaml())
    assert specification_of(Scenario.load(tmp_path / "again.yaml")) == found


def test_defaults_are_those_of_a_specification_without_errors():
    of = dict.fromkeys(("roll", "pitch", "yaw"))
    bare = Scenario.load("cubesat_ideal", {f"specification.{axis}_deg": None for axis in of})
    limits = {each.name: each.limit for each in specification_of(bare).requirements}
    assert limits == {"roll": 0.025, "pitch": 0.286, "yaw": 0.025}
    one = Scenario.load(
        "cubesat_ideal", {f"specification.{axis}_deg": None for axis in of} | {"specification.across_deg": 0.01}
    )
    assert [each.name for each in specification_of(one).requirements] == ["across"]


# ------------------------------------------------------------------ verdicts
def test_frames_needed_by_the_exact_formulas():
    assert frames_needed(Requirement("roll", 1.0, 99.7, "roll")) == 1228  # 0.997^1228 = 0.02497, 0.997^1227 = 0.02504
    assert 0.997**1228 <= 0.025 < 0.997**1227
    for limit, name in ((0.999, "availability"), (0.001, "wrong_rate")):
        n = frames_needed(Requirement(name, limit))
        none = [stats.binomtest(0, k).proportion_ci(method="wilson").high for k in (n, n - 1)]
        assert none[0] <= 0.001 < none[1]


@pytest.mark.parametrize(
    ("requirement", "estimate", "expected"),
    [
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(0.9, 0.8, 0.99, 2000), MET),
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(0.9, 0.8, 1.01, 2000), UNDECIDED),
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(0.9, 0.8, None, 200), UNDECIDED),
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(1.3, 1.1, None, 200), NOT_MET),
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(None, None, None, 0), NOT_MET),
        (Requirement("roll", 1.0, 99.7, "roll"), Estimate(None, None, None, 0, "not predicted"), UNDECIDED),
        (Requirement("availability", 0.99), Estimate(1.0, 0.995, 1.0, 900), MET),
        (Requirement("availability", 0.99), Estimate(0.99, 0.97, 0.995, 900), UNDECIDED),
        (Requirement("availability", 0.99), Estimate(0.95, 0.93, 0.98, 900), NOT_MET),
        (Requirement("wrong_rate", 0.01), Estimate(0.0, 0.0, 0.009, 900), MET),
        (Requirement("wrong_rate", 0.01), Estimate(0.05, 0.03, 0.07, 900), NOT_MET),
    ],
)
def test_verdict_by_the_interval(requirement, estimate, expected):
    assert Verdict(requirement, estimate).verdict == expected


def test_advice_is_the_number_of_frames_that_the_last_open_requirement_needs():
    """Of the requirements that are open, the one with the fewest frames and the one that needs the most decide; one
    about which nothing is known gives no number, and a decided specification no advice."""
    roll, share = Requirement("roll", 1.0, 99.7, "roll"), Requirement("wrong_rate", 0.01)
    needed = frames_needed(roll)
    assert needed > frames_needed(share)

    def advice(*frames, **more):
        estimates = [Estimate(0.9, 0.8, None, frames[0]), Estimate(0.0, 0.0, 0.02, frames[1])]
        open_ones = [Verdict(each, size) for each, size in zip((roll, share), estimates, strict=True)]
        return Judgement(tuple(open_ones), "measured", "trials", **more).advice

    assert advice(needed - 1, needed + 1) == f"run at least {needed} trials to decide"
    assert advice(needed + 1, needed - 1) == f"run at least {needed} trials to decide"
    assert advice(needed, needed) == advice(needed + 9, needed + 1) == "run more trials to decide"
    assert advice(9, 9, wrong=1, untested=("none",)).startswith("run at least")  # wrong ones have a limit of their own
    unknown = Verdict(roll, Estimate(None, None, None, 0, "not predicted"))
    met = Verdict(share, Estimate(0.0, 0.0, 0.005, 900))
    assert Judgement((unknown, met), "predicted", "trials").advice == ""
    assert Judgement((met,), "measured", "trials").advice == ""
    both = Judgement((unknown, Verdict(share, Estimate(0.0, 0.0, 0.02, 9))), "measured", "frames")
    assert both.advice == f"run at least {frames_needed(share)} frames to decide"


def test_percentile_interval_of_frames_is_the_exact_binomial_one():
    columns = frames(3000)
    _, found = verdicts(columns, Specification.of_limits({"cross_x": 1.0}, 95.0))
    ordered = np.sort(np.abs(columns["error_cross_x_deg"]))
    low, high = stats.binom.ppf([0.025, 0.975], 3000, 0.95).astype(int)
    estimate = found["cross_x"].estimate
    assert estimate.value == ordered[2849]  # 0.95 × 3000 = 2850th
    assert (estimate.low, estimate.high) == (ordered[low - 1], ordered[high])
    assert found["cross_x"].verdict == MET


def test_across_is_the_angle_between_the_boresights():
    """Rayleigh distribution: 99.7 % below σ √(−2 ln 0.003) = 3.409 σ; its density there gives the standard deviation
    √(p (1 − p) / n) / (3.409 × 0.003 / σ) = 0.0169 σ for 100,000 frames; four of them."""
    _, found = verdicts(frames(100_000), Specification.of_limits({"across": 4 * ARCSEC}))
    assert found["across"].estimate.value / ARCSEC == pytest.approx(math.sqrt(-2 * math.log(0.003)), abs=4 * 0.0169)
    assert found["across"].verdict == MET


def test_availability_and_wrong_rate_by_wilson():
    columns = frames(1000)
    columns["status"][:4] = "no_match"
    columns["wrong"][4] = True
    asked = Specification((Requirement("availability", 0.98), Requirement("wrong_rate", 0.01)))
    judged, found = verdicts(columns, asked)
    for name, number in (("availability", 995), ("wrong_rate", 1)):
        expected = stats.binomtest(number, 1000).proportion_ci(method="wilson")
        estimate = found[name].estimate
        assert (estimate.value, estimate.low, estimate.high) == pytest.approx((number / 1000, *expected), abs=1e-12)
    assert judged.state == MET  # a specified rate of wrong attitudes permits one
    judged, _ = verdicts(columns, Specification((Requirement("availability", 0.98),)))
    assert judged.state == NOT_MET
    assert judged.text == "Specification: not met: 1 wrong attitude"


def test_only_frames_at_the_specified_rate_are_judged():
    columns = frames(2000, rate_deg_s=np.repeat([0.1, 1.05], 1000))
    columns["error_cross_x_deg"][1000:] *= 3
    specification = replace(Specification.of_limits({"cross_x": 1.0}, 95.0), rate_deg_s=1.0)
    _, found = verdicts(columns, specification)
    assert found["cross_x"].estimate.frames == 1000
    assert found["cross_x"].estimate.value == np.sort(np.abs(columns["error_cross_x_deg"][1000:]))[949]
    judged, found = verdicts(columns, replace(specification, rate_deg_s=5.0))
    assert judged.state == UNDECIDED
    assert "no frame turns at the 5°/s of specification.rate_deg_s (within 10 %), but at 0.1 to 1.05°/s" in judged.text


def test_frames_within_an_exclusion_angle_do_not_count():
    columns = frames(1000)
    columns["status"][:100] = "no_match"
    asked = Specification((Requirement("availability", 0.99),), exclusion_deg=(("sun", 30.0),))
    angles = {"sun": np.where(np.arange(1000) < 100, 20.0, 80.0)}
    judged, found = verdicts(columns, asked, Setting(angles_deg=angles))
    assert found["availability"].estimate.frames == 900
    assert judged.state == MET
    judged, _ = verdicts(columns, asked, Setting(angles_deg={"sun": np.zeros(1000)}))
    assert judged.text.endswith("every frame is excluded by specification.sun_exclusion_deg 30")


def test_angles_from_the_bodies_are_those_of_skyfield():
    """Sun and Moon from the spacecraft, geometric, from DE421 by Skyfield's own vectors; the orbit is ours."""
    from skyfield.api import load, load_file

    from simulator.build import build_orbit
    from simulator.constants import EARTH_RADIUS_KM

    scenario = Scenario.load(
        "cubesat_ideal", {f"specification.{body}_exclusion_deg": 10.0 for body in ("sun", "moon", "earth")}
    )
    t_s = np.array([0.0, 3000.0, 8.64e6])
    ra, dec = np.array([10.0, 200.0, 330.0]), np.array([-20.0, 5.0, 70.0])
    columns = {"t_s": t_s, "true_ra_deg": ra, "true_dec_deg": dec}
    found = setting_of(scenario, specification_of(scenario), columns).angles_deg
    bodies = load_file(str(files("skyfield_data") / "data" / "de421.bsp"))
    epoch = scenario.epoch
    r_km = build_orbit(scenario).state(t_s)[0]
    for k in range(3):
        time = load.timescale(builtin=True).utc(epoch.year, epoch.month, epoch.day, epoch.hour, epoch.minute, t_s[k])
        look = radec_to_direction(np.radians(ra[k]), np.radians(dec[k]))
        for body in ("sun", "moon"):
            towards = (bodies[body] - bodies["earth"]).at(time).position.km - r_km[k]
            angle = math.degrees(math.acos(np.dot(towards, look) / np.linalg.norm(towards)))
            assert found[body][k] == pytest.approx(angle, abs=1e-6)
        to_centre = math.degrees(math.acos(np.dot(-r_km[k], look) / np.linalg.norm(r_km[k])))
        limb = math.degrees(math.asin(EARTH_RADIUS_KM / np.linalg.norm(r_km[k])))
        assert found["earth"][k] == pytest.approx(to_centre - limb, abs=1e-9)
    bodies.close()


def test_acquisition_needs_a_tracker_that_is_lost_in_space():
    columns = frames(2000)
    columns["status"][:3] = "no_match"
    asked = Specification((Requirement("acquisition", 0.5, 99.0),))
    judged, found = verdicts(columns, asked, Setting(exposure_s=0.2))
    assert judged.state == UNDECIDED
    assert "tracker.prior: false" in found["acquisition"].text
    judged, found = verdicts(columns, asked, Setting(exposure_s=0.2, lost_in_space=True))
    assert judged.state == MET
    assert found["acquisition"].value_text == "99 % below 0.2 s"
    columns["status"][:60] = "no_match"  # 3 %: their time is not known, and beyond any limit
    judged, found = verdicts(columns, asked, Setting(exposure_s=0.2, lost_in_space=True))
    assert judged.state == NOT_MET
    assert found["acquisition"].value_text == "99 % below never"
    assert found["acquisition"].to_dict()["value_s"] is None


def test_correlated_frames_of_a_sequence_count_as_fewer():
    """A first-order process of correlation 0.9 has (1 − 0.9)/(1 + 0.9) = 1/19 of its frames as effective number."""
    rng, n = np.random.default_rng(5), 40_000
    columns = frames(n)
    for axis in ("cross_x", "cross_y", "about_boresight"):
        noise = rng.normal(0, ARCSEC, n)
        for k in range(1, n):
            noise[k] = 0.9 * noise[k - 1] + math.sqrt(1 - 0.81) * noise[k]
        columns[f"error_{axis}_deg"] = noise
    asked = Specification.of_limits({"cross_x": 3.2 * ARCSEC})
    alone, found = verdicts(columns, asked)
    assert alone.state == MET
    together, correlated = verdicts(columns, asked, Setting(step_s=1.0))
    # the integrated autocorrelation time of 19 is known to √(2 × 2 × 19 × few / n), some 10 %; the least of three
    assert correlated["cross_x"].estimate.frames == pytest.approx(n / 19, rel=0.25)
    assert correlated["cross_x"].estimate.value == found["cross_x"].estimate.value
    assert correlated["cross_x"].estimate.high > found["cross_x"].estimate.high
    assert together.state == UNDECIDED
    assert "independent frames to decide" in together.text


def test_interval_of_correlated_frames_covers_as_it_promises():
    """Upper and lower limits of the 90th percentile of a process of correlation 0.8 exclude the true one in at most
    2.5 % of 600 sequences each, up to four standard deviations, 4 √(0.025 × 0.975 / 600) = 2.5 %."""
    rng, n, runs = np.random.default_rng(2), 1500, 600
    noise = rng.normal(size=(runs, n))
    for k in range(1, n):
        noise[:, k] = 0.8 * noise[:, k - 1] + 0.6 * noise[:, k]
    true = stats.norm.ppf(0.95)
    asked, missed = Specification.of_limits({"cross_x": 1.0}, 90.0), np.zeros(2)
    for series in noise:
        columns = {"status": np.array(["solved"] * n), "wrong": np.zeros(n, bool)}
        columns |= {f"error_{axis}_deg": series for axis in ("cross_x", "cross_y", "about_boresight")}
        low, high = Measured(columns, asked, Setting(step_s=1.0)).estimate(asked.requirements[0])[1:3]
        missed += [low > true, high < true]
    assert (missed / runs < 0.05).all()


# ------------------------------------------------------------------ predictions
def test_percentile_of_a_mixture_against_a_sample():
    """Of 300 attitudes × 4,000 normal errors: the sample's quantile scatters by √(p q / n) / density; the density from
    the share within ±2 % of it."""
    rng = np.random.default_rng(3)
    shape = rng.normal(size=(300, 3, 3)) * rng.gamma(1.0, 1.0, 300)[:, None, None] * 1e-5
    covariance = shape @ shape.transpose(0, 2, 1)
    to_body = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    errors = np.einsum("nij,nkj->nki", shape, rng.normal(size=(300, 4_000, 3))).reshape(-1, 3)
    predicted = Predicted(covariance, to_body, 300, Specification.of_limits({"roll": 1.0}), 0.0)
    body = errors @ to_body.T
    samples = {"cross_x": errors[:, 0], "about_boresight": errors[:, 2], "roll": body[:, 0], "yaw": body[:, 2],
               "across": np.hypot(errors[:, 0], errors[:, 1])}  # fmt: skip
    for axis, values in samples.items():
        for percent in (68.0, 95.0, 99.7):
            magnitude = np.abs(np.degrees(values))
            expected = np.percentile(magnitude, percent)
            density = np.mean(np.abs(magnitude / expected - 1) < 0.02) / (0.04 * expected)
            spread = math.sqrt(percent / 100 * (1 - percent / 100) / len(magnitude)) / density
            assert predicted.percentile_deg(axis, percent) == pytest.approx(expected, abs=4 * spread), (axis, percent)


def test_percentiles_of_one_normal_distribution_are_exact():
    assert axis_percentile(np.array([4.0]), 99.7) == pytest.approx(2 * stats.norm.ppf(0.9985), rel=1e-8)
    assert across_percentile(np.diag([9.0, 9.0])[None], 95.0) == pytest.approx(3 * stats.rayleigh.ppf(0.95), rel=1e-8)
    # one axis without error is the one-dimensional case; the integrand is singular there, 64 directions give 1e-3
    assert across_percentile(np.diag([1.0, 1e-12])[None], 95.0) == pytest.approx(stats.norm.ppf(0.975), rel=2e-3)


def test_a_mixture_has_longer_tails_than_three_times_its_rms():
    variance = np.array([1.0] * 99 + [400.0])
    assert axis_percentile(variance, 99.7) > 1.5 * 3 * math.sqrt(variance.mean())


def test_prediction_at_another_rate_is_undecided():
    specification = replace(Specification.of_limits({"roll": 1.0}), rate_deg_s=1.0)
    evidence = Predicted(np.eye(3)[None] * 1e-12, np.eye(3), 1, specification, 0.06)
    judged = judge(specification, evidence)
    assert judged.state == UNDECIDED
    assert "set pointing.rate_deg_s" in judged.text
    judged = judge(specification, replace(evidence, rate_deg_s=1.02))
    assert judged.text.startswith("Specification: met (predicted): smallest margin roll")


@pytest.mark.parametrize(
    ("rate", "tested"), [(0.053, False), (0.055, True), (0.066, True), (0.067, False), (0.5, False)]
)
def test_a_prediction_at_another_rate_leaves_the_specified_one_untested(rate, tested):
    """Specified 0.06°/s: predictions from 0.054 to 0.066°/s hold for it, slower and faster ones do not."""
    specification = Specification((Requirement("roll", 1.0, 99.7, "roll"),), rate_deg_s=0.06)
    judged = judge(specification, Predicted(np.eye(3)[None] * 1e-12, np.eye(3), 1, specification, rate))
    assert (judged.untested == ()) == tested
    assert judged.state == (MET if tested else UNDECIDED)
