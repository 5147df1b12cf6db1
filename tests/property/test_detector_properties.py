"""Units and limits of the detector, for any setting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.detector.readout import reset_noise_e
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect

POSITIVE = st.floats(1e-3, 1e4)
DETECTOR = st.fixed_dictionaries(
    {
        "exposure_s": st.floats(1e-3, 10.0),
        "temperature_c": st.floats(-60.0, 60.0),
        "shot_noise": st.booleans(),
        "dark_current_e_s": st.sampled_from([0.0, 0.5, 300.0]),
        "dsnu": st.sampled_from([0.0, 0.2, 3.0]),
        "prnu": st.sampled_from([0.0, 0.01, 1.5]),
        "hot_pixel_fraction": st.sampled_from([0.0, 0.05, 1.0]),
        "hot_pixel_dark_e_s": st.sampled_from([0.0, 1000.0]),
        "full_well_e": st.floats(10.0, 1e6),
        "read_noise_e": st.sampled_from([0.0, 12.0]),
        "reset_capacitance_ff": st.sampled_from([0.0, 10.0]),
        "gain_e_per_dn": st.one_of(st.just("auto"), st.floats(0.01, 1000.0)),
        "offset_dn": st.one_of(st.just(0.0), st.floats(0.0, 0.9)),
        "adc_bits": st.one_of(st.none(), st.integers(1, 16)),
    }
)


def make(**keys):
    return DetectorSection(**({"width": 24, "height": 16, "pixel_pitch_um": 5.0, "exposure_s": 1.0} | keys))


def expose(section, mean, seed=1):
    return detect(mean, section, build_fixed_pattern(section, seed), lambda name: stream(seed, name, 0))


@settings(deadline=None, max_examples=60)
@given(DETECTOR, st.floats(0.0, 1e5), st.integers(0, 1000))
def test_frame_keeps_its_limits(keys, level, seed):
    section = make(**keys)
    pattern = build_fixed_pattern(section, seed)
    assert np.min(pattern.prnu) >= 0.0
    assert np.min(pattern.dark_e_s) >= 0.0
    frame = expose(section, np.full((16, 24), level), seed)
    assert frame.electrons.min() >= 0.0
    assert frame.electrons.max() <= section.full_well_e
    assert frame.saturated.shape == frame.image.shape == (16, 24)
    assert np.all(frame.saturated[frame.electrons >= section.full_well_e])
    assert np.isfinite(frame.image).all()
    if section.adc_bits is None:
        assert frame.image.dtype == np.float64
    else:
        assert frame.image.dtype == np.uint16
        assert frame.image.max() <= 2**section.adc_bits - 1
        assert frame.saturation_dn <= 2**section.adc_bits - 1
        assert frame.saturation_dn == np.rint(frame.saturation_dn)
    if section.shot_noise:
        below = frame.electrons < section.full_well_e
        assert np.array_equal(frame.electrons[below], np.rint(frame.electrons[below]))


@settings(deadline=None, max_examples=60)
@given(DETECTOR, st.floats(0.0, 1e5))
def test_without_noise_it_is_a_formula(keys, level):
    off = {"shot_noise": False, "read_noise_e": 0.0, "reset_capacitance_ff": 0.0}
    section = make(**(keys | off))
    pattern = build_fixed_pattern(section, 1).single()
    frame = expose(section, np.full((16, 24), level))
    signal = level * np.float64(pattern.prnu) + section.exposure_s * np.float64(pattern.dark_e_s)
    signal = np.minimum(signal, section.full_well_e) / frame.gain_e_per_dn
    signal = np.broadcast_to(signal + section.offset_dn, (16, 24))
    if section.adc_bits is not None:
        signal = np.clip(np.rint(signal), 0, 2**section.adc_bits - 1)
    np.testing.assert_allclose(frame.image, signal, rtol=1e-12)
    assert np.array_equal(frame.image >= frame.saturation_dn, frame.saturated) or section.adc_bits is not None
    assert np.all(frame.image[frame.saturated] >= frame.saturation_dn)


@settings(deadline=None)
@given(POSITIVE, st.floats(-60, 60), st.floats(2, 12))
def test_dark_current_doubles_by_temperature(current, temperature, doubling):
    def dark(**keys):
        base = {
            "dark_current_e_s": current,
            "temperature_c": temperature,
            "dark_doubling_c": doubling,
            "dsnu": 0.3,
            "hot_pixel_fraction": 0.1,
            "hot_pixel_dark_e_s": 50.0,
        }
        return build_fixed_pattern(make(**(base | keys)), 5).dark_e_s

    np.testing.assert_allclose(dark(temperature_c=temperature + doubling), 2 * dark(), rtol=1e-9)
    scaled = dark(dark_current_e_s=3 * current, hot_pixel_dark_e_s=150.0)
    np.testing.assert_allclose(scaled, 3 * dark(), rtol=1e-12)
    at_reference = build_fixed_pattern(make(dark_current_e_s=current, temperature_c=25.0), 5)
    assert at_reference.dark_e_s == pytest.approx(current, rel=1e-12)


@settings(deadline=None)
@given(st.floats(0.0, 1e3), st.floats(1e-3, 10))
def test_dark_electrons_grow_with_the_exposure(current, exposure):
    keys = {"dark_current_e_s": current, "dsnu": 0.3, "temperature_c": 25.0, "shot_noise": False, "full_well_e": 1e9}
    none = np.zeros((16, 24))
    once, twice = (expose(make(**keys, exposure_s=t), none).electrons for t in (exposure, 2 * exposure))
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-12)


@given(st.floats(1e-16, 1e-9), st.floats(-200, 100))
def test_reset_noise_grows_with_the_roots(capacitance, temperature):
    noise = reset_noise_e(capacitance, temperature)
    assert reset_noise_e(4 * capacitance, temperature) == pytest.approx(2 * noise, rel=1e-12)
    kelvin = temperature + 273.15
    assert reset_noise_e(capacitance, 4 * kelvin - 273.15) == pytest.approx(2 * noise, rel=1e-12)


@settings(deadline=None)
@given(POSITIVE, st.floats(0.0, 100.0))
def test_gain_is_electrons_a_number(gain, offset):
    keys = {"shot_noise": False, "adc_bits": None, "offset_dn": offset, "gain_e_per_dn": gain}
    frame = expose(make(**keys), np.full((16, 24), 1000.0))
    np.testing.assert_allclose((frame.image - offset) * gain, 1000.0, rtol=1e-9, atol=1e-12 * gain * (offset + 1))
    assert frame.gain_e_per_dn == gain
