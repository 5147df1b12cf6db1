"""Dead and hot pixels and columns, the map of bad pixels, and which detector may have which effect."""

import numpy as np
import pytest
from scipy import stats

from simulator.build import detector_parameters
from simulator.detector.excess_noise import bunch_e, excess_noise_factor, signal_gain
from simulator.detector.parameters import CosmicRays, DetectorParameters, Intensifier, RandomTelegraph
from simulator.environment.coefficients import coefficient
from simulator.randomness import stream
from simulator.scenario.detector_rules import contradictions
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError
from tests.detectors import build_fixed_pattern, detect


def section(**keys):
    return DetectorSection(**({"width": 200, "height": 100, "pixel_pitch_um": 5.0, "exposure_s": 1.0} | keys))


def test_a_device_without_defects_has_an_empty_map():
    pattern = build_fixed_pattern(section(prnu=0.1, dark_current_e_s=10.0, dsnu=0.1), 1)
    assert pattern.dead is None
    assert pattern.hot is None
    assert pattern.bad_pixels((100, 200)).shape == (100, 200)
    assert not pattern.bad_pixels((100, 200)).any()


@pytest.mark.parametrize(
    "keys",
    [
        {"hot_columns": 2},
        {"hot_column_dark_e_s": 300.0},
        {"hot_pixel_fraction": 0.1},
        {"hot_pixel_dark_e_s": 300.0},
        {"hot_columns": 2, "hot_pixel_dark_e_s": 300.0},
        {"telegraph": {"pixel_fraction": 0.1}},
        {"telegraph": {"dark_e_s": 300.0}},
        {"displacement": {"interactions_per_pixel": 0.1}},
        {"displacement": {"dark_e_s": 300.0}},
    ],
)
def test_defects_need_both_a_number_and_a_current(keys):
    pattern = build_fixed_pattern(section(**keys), 1)
    assert (pattern.prnu, pattern.dark_e_s) == (1.0, 0.0)
    assert pattern.hot is pattern.dead is pattern.telegraph is None


def test_a_device_by_default_is_that_of_a_scenario():
    """A section without optional keys and parameters without them are one detector; its kinds of particles and defects
    have the figures of their sources (`docs/detector.md`), so that giving a rate or a share is enough."""
    size = {"width": 200, "height": 100}
    assert detector_parameters(section(**size)) == DetectorParameters(**size, pitch_um=(5.0, 5.0))
    rays, telegraph = CosmicRays(rate_cm2_s=1.0), RandomTelegraph(pixel_fraction=0.1)
    assert (rays.depth_um, rays.charge_e_um) == (10.0, 80.0)
    assert telegraph.low_s == coefficient("telegraph_low_time")
    assert telegraph.high_s == coefficient("telegraph_high_time")
    # a microchannel plate, with exponentially distributed gains: F² = 2 + 1/⟨g⟩ (Bell 1975)
    plate = DetectorParameters(**size, pitch_um=(5.0, 5.0), intensifier=Intensifier(gain=100.0))
    assert excess_noise_factor(plate) == pytest.approx(2.01, rel=1e-12)
    assert signal_gain(plate) == 100.0
    assert bunch_e(plate) == pytest.approx(201.0, rel=1e-12)


def test_dead_pixels_read_the_offset():
    detector = section(dead_pixel_fraction=0.02, dark_current_e_s=50.0, offset_dn=100.0, gain_e_per_dn=1.0)
    pattern = build_fixed_pattern(detector, 1)
    # Binomial: 20,000 × 0.02 = 400, σ 19.8; 4σ.
    assert abs(pattern.dead.sum() - 400) < 80
    frame = detect(np.full((100, 200), 1000.0), detector, pattern, lambda name: stream(1, name))
    assert np.all(frame.image[pattern.dead] == 100)
    assert frame.image[~pattern.dead].min() > 700
    assert np.array_equal(pattern.bad_pixels((100, 200)), pattern.dead)


def test_dead_columns_are_whole_columns():
    pattern = build_fixed_pattern(section(dead_columns=3), 1)
    columns = pattern.dead.all(axis=0)
    assert columns.sum() == 3
    assert not pattern.dead[:, ~columns].any()
    assert np.array_equal(pattern.prnu, np.where(pattern.dead, 0.0, 1.0))
    assert pattern.dark_e_s == 0.0


def test_hot_columns_glow_evenly_and_exponentially_between_them():
    currents = []
    for seed in range(40):
        pattern = build_fixed_pattern(section(hot_columns=10, hot_column_dark_e_s=300.0, temperature_c=25.0), seed)
        assert pattern.hot.all(axis=0).sum() == pattern.hot.any(axis=0).sum() == 10
        assert np.all(pattern.dark_e_s == pattern.dark_e_s[:1])
        assert not pattern.dark_e_s[~pattern.hot].any()
        currents.extend(pattern.dark_e_s[0, pattern.hot[0]])
    assert stats.kstest(currents, stats.expon(scale=300.0).cdf).pvalue > 1e-4


def test_the_map_holds_all_defects():
    keys = {"hot_pixel_fraction": 0.01, "hot_pixel_dark_e_s": 100.0, "hot_columns": 1, "hot_column_dark_e_s": 10.0}
    pattern = build_fixed_pattern(section(**keys, dead_pixel_fraction=0.01, dead_columns=2), 1)
    assert np.array_equal(pattern.bad_pixels((100, 200)), pattern.hot | pattern.dead)
    assert np.all(pattern.dark_e_s[pattern.dead] == 0.0)
    assert np.all(pattern.dark_e_s[pattern.hot & ~pattern.dead] > 0.0)


@pytest.mark.parametrize("key", ["hot_columns", "dead_columns"])
def test_more_columns_than_there_are(key):
    keys = {key: 201, "hot_column_dark_e_s": 1.0}
    with pytest.raises(InputError, match=f"detector.{key} = 201 exceeds the 200 columns"):
        build_fixed_pattern(section(**keys), 1)
    assert [found[0] for found in contradictions(flat(section(**keys)))] == [f"detector.{key}"]


def flat(detector):
    return {f"detector.{key}": value for key, value in detector.model_dump().items()}


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        (
            {"antiblooming": 0.5},
            "0.5 with detector.kind: cmos, but charge cannot spill between the pixels of a CMOS detector",
        ),
        (
            {"cti_parallel": 1e-5},
            "1e-05 with detector.kind: cmos, but a CMOS detector transfers no charge between pixels",
        ),
        ({"cti_serial": 1e-5}, "use 0 or kind: ccd_full_frame"),
    ],
)
def test_what_a_cmos_detector_cannot_have(keys, line):
    found = list(contradictions(flat(section(**keys))))
    assert [key for key, _, _ in found] == [f"detector.{next(iter(keys))}"]
    assert line in found[0][1]
    assert not found[0][2]
    for kind in ("ccd_full_frame", "ccd_frame_transfer"):
        assert not list(contradictions(flat(section(kind=kind, **keys))))


@pytest.mark.parametrize(
    ("shutter", "kind", "right"),
    [
        ("rolling", "ccd_full_frame", "cmos"),
        ("frame_transfer", "cmos", "ccd_frame_transfer"),
    ],
)
def test_the_shutter_belongs_to_the_kind(shutter, kind, right):
    ((key, message, overridable),) = contradictions(flat(section(shutter=shutter, kind=kind)))
    assert (key, overridable) == ("detector.shutter", False)
    assert f"use kind: {right}, or shutter: global" in message
    assert not list(contradictions(flat(section(shutter=shutter, kind=right))))


def test_a_full_frame_detector_may_be_clocked_out_under_light():
    assert not list(contradictions(flat(section(shutter="frame_transfer", kind="ccd_full_frame"))))


def test_a_response_that_falls_is_refused():
    assert not list(contradictions(flat(section(nonlinearity=(-0.3, 0.05)))))
    found = list(contradictions(flat(section(nonlinearity=(-0.6, 0.0)))))
    assert found[0][0] == "detector.nonlinearity"
    assert found[0][2]
