"""The detector's chain: each effect off changes nothing, each draws from its own stream, each acts at its place."""

from functools import partial

import numpy as np
import pytest

from simulator.build import detector_parameters
from simulator.detector import CHARGE, READOUT, Detector, FixedPattern
from simulator.detector.fixed_pattern import dark_current_factor
from simulator.detector.pixels import apply_steps
from simulator.detector.readout import convert, detector_reset_noise_e, gain_e_per_dn, reset_noise_e, saturation_dn
from simulator.detector.steps import CONVERT, GAUSSIAN_NOISE, Step
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError
from tests.detectors import build_fixed_pattern, detect

ALL_ON = {
    "prnu": 0.02,
    "dark_current_e_s": 40.0,
    "dsnu": 0.3,
    "hot_pixel_fraction": 0.01,
    "hot_pixel_dark_e_s": 5000.0,
    "hot_columns": 2,
    "hot_column_dark_e_s": 300.0,
    "dead_pixel_fraction": 0.01,
    "dead_columns": 1,
    "cosmic_rays": {"rate_cm2_s": 40_000.0},
    "antiblooming": 0.3,
    "cti_parallel": 1e-4,
    "cti_serial": 2e-4,
    "nonlinearity": (0.02, -0.01),
    "read_noise_e": 8.0,
    "reset_capacitance_ff": 5.0,
    "offset_dn": 100.0,
}


def section(**keys):
    base = {"width": 48, "height": 32, "pixel_pitch_um": 5.5, "exposure_s": 0.5, "full_well_e": 20_000.0}
    return DetectorSection(**(base | keys))


def noiseless(**keys):
    return section(**({"shot_noise": False, "adc_bits": None} | keys))


def expose(detector, mean, seed=1, trial=0, asked=None):
    def streams(name):
        if asked is not None:
            asked.append(name)
        return stream(seed, name, trial)

    return detect(mean, detector, build_fixed_pattern(detector, seed), streams)


@pytest.fixture
def mean():
    image = np.full((32, 48), 15.3)
    image[10:13, 20:23] += [[50.0, 300.0, 50.0], [300.0, 3000.5, 300.0], [50.0, 300.0, 50.0]]
    return image


def test_everything_off_is_the_noiseless_image_to_the_bit(mean):
    asked = []
    kept = mean.copy()
    frame = expose(noiseless(), mean, asked=asked)
    assert frame.image.dtype == np.float64
    assert np.array_equal(frame.image, mean)
    assert np.array_equal(frame.electrons, mean)
    assert not frame.saturated.any()
    assert frame.gain_e_per_dn == 1.0
    assert frame.saturation_dn == 20_000.0
    assert asked == []
    frame.image[:] = 0  # what is handed out belongs to the caller alone
    assert np.array_equal(mean, kept)
    assert np.array_equal(frame.electrons, kept)


def test_pattern_of_a_perfect_device_is_scalar():
    pattern = build_fixed_pattern(section(), 1)
    assert (pattern.prnu, pattern.dark_e_s) == (1.0, 0.0)
    warm = build_fixed_pattern(section(dark_current_e_s=40.0, temperature_c=25.0), 1)
    assert (warm.prnu, warm.dark_e_s) == (1.0, 40.0)


def test_repeatable_and_different_each_trial(mean):
    detector = section(**ALL_ON)
    first, again, other = expose(detector, mean), expose(detector, mean), expose(detector, mean, trial=1)
    assert np.array_equal(first.image, again.image)
    assert not np.array_equal(first.image, other.image)
    assert first.image.dtype == np.uint16
    for one, two in [(1, 1), (1, 2)]:
        a, b = build_fixed_pattern(detector, one), build_fixed_pattern(detector, two)
        assert np.array_equal(a.prnu, b.prnu) == (one == two)
        assert np.array_equal(a.dark_e_s, b.dark_e_s) == (one == two)


def test_each_noise_is_its_own_stream(mean):
    """Read and reset noise are the same numbers whatever else is on: image − electrons shows them alone."""
    normal = np.empty(mean.shape)
    apply_steps(np.zeros(mean.shape), [Step(GAUSSIAN_NOISE, (1.0,), rng=stream(1, "read_noise", 0))], normal)
    for extra in ({}, {"shot_noise": True}, {"shot_noise": True, "prnu": 0.1, "dark_current_e_s": 100.0, "dsnu": 0.5}):
        frame = expose(noiseless(read_noise_e=8.0, **extra), mean)
        np.testing.assert_allclose(frame.image - frame.electrons, 8.0 * normal, rtol=0, atol=1e-11)
    both = expose(noiseless(read_noise_e=8.0, reset_capacitance_ff=5.0), mean)
    reset = expose(noiseless(reset_capacitance_ff=5.0), mean)
    np.testing.assert_allclose(both.image - reset.image, 8.0 * normal, rtol=0, atol=1e-11)


@pytest.mark.parametrize("what", ["prnu", "dsnu", "gradient"])
def test_noise_stays_as_a_map_goes_to_zero(what):
    """The same seed draws the same noise with a map of next to nothing as without it: a pixel differs only where a
    change of 1e-7 of its mean crosses a step of its Poisson number or of the converter."""
    keys = {"width": 256, "height": 256, "dark_current_e_s": 10.0, "read_noise_e": 5.0, "gain_e_per_dn": 1.0}
    flat, faint = np.full((256, 256), 40.0), 1e-7
    without = detect(flat, section(**keys), FixedPattern(1.0, 5.0), partial(stream, 1), keep_charge=False)
    bump = 1.0 + faint * np.random.default_rng(1).standard_normal(flat.shape)
    light = flat * bump if what == "gradient" else flat
    pattern = FixedPattern(bump if what == "prnu" else 1.0, 5.0 * bump if what == "dsnu" else 5.0)
    mapped = detect(light, section(**keys), pattern, partial(stream, 1), keep_charge=False)
    assert np.mean(mapped.image != without.image) < 1e-3
    assert np.abs(mapped.image.astype(float) - without.image).max() <= 1


def test_the_fixed_patterns_are_their_own_streams():
    keys = ALL_ON | {"dead_pixel_fraction": 0.0, "dead_columns": 0}
    full = build_fixed_pattern(section(**keys), 3)
    assert np.array_equal(build_fixed_pattern(section(**(keys | {"dsnu": 0.0})), 3).prnu, full.prnu)
    no_hot = build_fixed_pattern(section(**(keys | {"hot_pixel_fraction": 0.0, "hot_columns": 0, "prnu": 0.0})), 3)
    no_dsnu = build_fixed_pattern(section(**(keys | {"dsnu": 0.0})), 3)
    ordinary = 40.0 * dark_current_factor(20.0, 25.0, 8.0)
    np.testing.assert_allclose(full.dark_e_s, no_hot.dark_e_s + (no_dsnu.dark_e_s - ordinary), rtol=1e-12)
    dead = build_fixed_pattern(section(**ALL_ON), 3)
    assert np.array_equal(dead.hot, full.hot)
    assert np.array_equal(dead.prnu[~dead.dead], full.prnu[~dead.dead])
    assert np.array_equal(dead.dark_e_s[~dead.dead], full.dark_e_s[~dead.dead])


@pytest.mark.parametrize(
    "off",
    [
        {"prnu": 0.0},
        {"dark_current_e_s": 0.0},
        {"dsnu": 0.0},
        {"hot_pixel_fraction": 0.0},
        {"hot_pixel_dark_e_s": 0.0},
        {"hot_columns": 0},
        {"hot_column_dark_e_s": 0.0},
        {"dead_pixel_fraction": 0.0},
        {"dead_columns": 0},
        {"cosmic_rays": {"rate_cm2_s": 0.0}},
        {"antiblooming": 1.0},
        {"cti_parallel": 0.0},
        {"cti_serial": 0.0},
        {"nonlinearity": (0.0, 0.0)},
        {"shot_noise": False},
        {"read_noise_e": 0.0},
        {"reset_capacitance_ff": 0.0},
    ],
    ids=lambda off: next(iter(off)),
)
def test_an_effect_that_is_off_asks_for_no_stream_and_leaves_the_other_noise(off, mean):
    asked = []
    mean[20:23, 30] = 60_000.0  # so that there is something to bloom
    frame = expose(section(**(ALL_ON | off)), mean, asked=asked)
    names = {"shot_noise", "cosmic_rays", "reset_noise", "read_noise"} - {
        next(iter(off)).replace("read_noise_e", "read_noise")
    }
    assert set(asked) == names - ({"reset_noise"} if "reset_capacitance_ff" in off else set())
    assert len(asked) == len(set(asked))
    assert not np.array_equal(frame.image, expose(section(**ALL_ON), mean).image)


def test_order_of_the_effects():
    names = [effect.name for effect in (*CHARGE, *READOUT)]
    assert names == [
        "intensifier",
        "photo_response",
        "dark_signal",
        "random_telegraph",
        "shot_noise",
        "cosmic_rays",
        "full_well",
        "charge_transfer",
        "reset_noise",
        "read_noise",
        "nonlinearity",
        "gain_offset",
        "video",
        "adc",
    ]


WEAK = {
    "intensifier": {"intensifier": {"gain": 0.5}},
    "dark_signal": {"dark_current_e_s": 0.01},
    "random_telegraph": {"telegraph": {"pixel_fraction": 0.01, "dark_e_s": 0.5}},
    "shot_noise": {"shot_noise": True},
    "cosmic_rays": {"cosmic_rays": {"rate_cm2_s": 0.3}},
    "charge_transfer": {"cti_serial": 1e-6},
    "reset_noise": {"reset_capacitance_ff": 0.01},
    "read_noise": {"read_noise_e": 0.3},
    "nonlinearity": {"nonlinearity": (0.0, 1e-3)},
    "video": {"video": {"line_blur_px": 0.4}},
}


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        *WEAK.items(),
        ("charge_transfer", {"cti_parallel": 1e-6}),
        ("nonlinearity", {"nonlinearity": (1e-3, 0.0)}),
        ("video", {"video": {"noise_dn": 0.4}}),
        ("dark_signal", {"hot_columns": 1, "hot_column_dark_e_s": 0.5}),
        ("dark_signal", {"displacement": {"interactions_per_pixel": 0.01, "dark_e_s": 0.5}}),
        ("photo_response", {"prnu": 1e-3}),
        ("photo_response", {"dead_columns": 1}),
        ("adc", {"adc_bits": 1, "gain_e_per_dn": 1.0}),
    ],
)
def test_an_effect_is_on_however_weak_it_is(name, keys):
    """A detector with one effect has that and what every detector has, so that nothing else takes time."""
    chosen = noiseless(**keys)
    parameters, pattern = detector_parameters(chosen), build_fixed_pattern(chosen, 1)
    on = {effect.name for effect in (*CHARGE, *READOUT) if effect.on(parameters, pattern)}
    assert on == {"full_well", "gain_offset", name}


@pytest.mark.parametrize("more", [{}, {"antiblooming": 0.5}])
@pytest.mark.parametrize("keep_charge", [False, True])
def test_a_detector_made_ready_reads_frame_after_frame(mean, more, keep_charge):
    """Nothing of one frame is left in the next, though some effects on whole frames change them in place."""
    chosen = section(**(ALL_ON | more))
    pattern = build_fixed_pattern(chosen, 3)
    ready = Detector(detector_parameters(chosen), pattern)
    for index in range(3):
        streams = partial(stream, 5, trial=index)
        read = ready.expose(mean + index, chosen.exposure_s, streams, keep_charge=keep_charge)
        alone = detect(mean + index, chosen, pattern, streams, keep_charge=keep_charge)
        assert np.array_equal(read.image, alone.image)
        assert (read.saturation_dn, read.gain_e_per_dn) == (alone.saturation_dn, alone.gain_e_per_dn)
        if keep_charge:
            assert np.array_equal(read.electrons, alone.electrons)
            assert np.array_equal(read.saturated, alone.saturated)


def test_response_acts_on_light_and_not_on_dark_current(mean):
    response = np.float32(1.1)
    pattern = FixedPattern(np.full(mean.shape, response), 7.0)
    frame = detect(mean, noiseless(), pattern, lambda name: stream(1, name))
    np.testing.assert_allclose(frame.electrons, float(response) * mean + 0.5 * 7.0, rtol=1e-15)


def test_a_pattern_may_be_one_number(mean):
    frame = detect(mean, noiseless(), FixedPattern(0.5, 3.0), lambda name: stream(1, name))
    np.testing.assert_allclose(frame.image, 0.5 * mean + 0.5 * 3.0, rtol=1e-15)


def test_hot_pixels_are_different_pixels():
    pattern = build_fixed_pattern(section(hot_pixel_fraction=1.0, hot_pixel_dark_e_s=100.0), 1)
    assert np.all(pattern.dark_e_s > 0)


def test_full_well_comes_before_the_read_noise(mean):
    mean[0, :] = 1e6
    frame = expose(noiseless(read_noise_e=10.0, shot_noise=True), mean)
    assert np.all(frame.electrons[0] == 20_000.0)
    assert frame.saturated[0].all()
    assert not frame.saturated[1:].any()
    assert 0 < (frame.image[0] > 20_000.0).sum() < 48


def test_automatic_gain_puts_the_full_well_at_the_top(mean):
    detector = section(shot_noise=False, offset_dn=95.0)
    assert gain_e_per_dn(detector) == pytest.approx(20_000.0 / 4000.0)
    mean[3, 4] = 20_000.0
    mean[3, 5] = 1e9
    frame = expose(detector, mean)
    assert frame.image[3, 4] == frame.image[3, 5] == 4095
    assert frame.saturated.sum() == 2
    assert frame.saturation_dn == 4095
    assert frame.image[0, 0] == round(95.0 + 15.3 / 5.0)


def test_converter_below_the_full_well(mean):
    detector = section(shot_noise=False, gain_e_per_dn=1.0, adc_bits=10)
    frame = expose(detector, mean)
    assert frame.image.max() == 1023
    assert frame.saturated.sum() == 1
    assert frame.saturation_dn == 1023


def test_full_well_below_the_top_of_the_converter(mean):
    # 20000 / 7 + 100 = 2957.14 reads as 2957: the limit is rounded as the converter rounds.
    mean[:2] = 1e5
    detector = section(shot_noise=False, gain_e_per_dn=7.0, offset_dn=100.0)
    frame = expose(detector, mean)
    assert np.array_equal(frame.image >= frame.saturation_dn, frame.saturated)
    assert frame.saturated.sum() == 96


def test_saturated_pixels_are_found_through_the_read_noise(mean):
    # The limit lies 3σ below the full well: P(below) = 1.35e-3, so 2.1 of 1536 pixels, σ 1.4; at most 8 is 4σ.
    mean[:] = 1e6
    frame = expose(section(shot_noise=False, read_noise_e=30.0, offset_dn=50.0), mean)
    assert frame.saturated.all()
    assert (frame.image < frame.saturation_dn).sum() <= 8
    assert frame.saturation_dn < saturation_dn(section(offset_dn=50.0))


def test_no_full_well_hides_behind_no_converter(mean):
    mean[0, 0] = 3e4
    assert expose(noiseless(), mean).image[0, 0] == 20_000.0


def test_converter_rounds_and_clips():
    signal = np.array([-3.0, -0.4, 0.4, 0.6, 254.4, 254.6, 1e9])
    convert(signal, 255.0)
    assert signal.tolist() == [0, 0, 0, 1, 254, 255, 255]
    numbers = np.empty(1, dtype=np.uint16)
    apply_steps(np.array([7e4]), [Step(CONVERT, (65535.0,))], numbers)
    assert numbers.tolist() == [65535]


def test_shot_noise_off_reads_the_mean(mean):
    frame = expose(noiseless(dark_current_e_s=3.0, temperature_c=25.0), mean)
    np.testing.assert_allclose(frame.image, mean + 1.5, rtol=1e-15)


@pytest.mark.parametrize("keys", [{}, ALL_ON, ALL_ON | {"antiblooming": 1.0, "adc_bits": None}, {"shot_noise": False}])
def test_the_image_is_the_same_whether_the_charge_is_kept(keys, mean):
    detector = section(**keys)
    pattern = build_fixed_pattern(detector, 1)
    kept = detect(mean, detector, pattern, lambda name: stream(1, name, 0))
    quick = detect(mean, detector, pattern, lambda name: stream(1, name, 0), keep_charge=False)
    np.testing.assert_array_equal(quick.image, kept.image)
    assert quick.electrons is None
    assert quick.saturated is None


@pytest.mark.parametrize(("wrong", "line"), [(-1.0, "negative"), (np.nan, "not finite"), (np.inf, "not finite")])
def test_light_that_cannot_be(mean, wrong, line):
    mean[5, 5] = wrong
    with pytest.raises(InputError, match=line):
        expose(noiseless(), mean)


def test_sizes_that_do_not_fit(mean):
    with pytest.raises(InputError, match=r"mean_photo_e has the shape \(48, 32\)"):
        expose(section(), mean.T)
    other = build_fixed_pattern(section(width=64, prnu=0.01), 1)
    with pytest.raises(InputError, match=r"pattern.prnu has the shape \(32, 64\)"):
        detect(mean, section(), other, lambda name: stream(1, name))


def test_offset_that_fills_the_converter(mean):
    with pytest.raises(InputError, match="offset_dn = 255 leaves nothing of the 8 bits"):
        expose(section(adc_bits=8, offset_dn=255.0), mean)


def test_dark_signal_beyond_counting():
    with pytest.raises(InputError, match="raise dark_doubling_c"):
        build_fixed_pattern(section(dark_current_e_s=1.0, temperature_c=30.0, dark_doubling_c=1e-6), 1)
    assert build_fixed_pattern(section(temperature_c=30.0, dark_doubling_c=1e-6), 1).dark_e_s == 0.0


def test_reset_noise_of_a_section_is_in_femtofarad():
    noise = detector_reset_noise_e(section(reset_capacitance_ff=80.0, temperature_c=25.0))
    assert noise == pytest.approx(reset_noise_e(80e-15, 25.0), rel=1e-12)
    assert detector_reset_noise_e(section()) == 0.0
