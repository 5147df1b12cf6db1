"""Cosmic rays: how many, from where, how much charge; and what Hubble's camera saw.

Sources: arXiv:2006.00909 (peak of the South Atlantic Anomaly near 1100 protons cm⁻² s⁻¹); Particle Data Group (minimum
ionisation of silicon 1.664 MeV cm²/g); Riess 2002, ACS ISR 2002-07 (median of about 1000 electrons, few below 500, over
4 pixels for most). Seeds are fixed; 4σ or p > 1e-4 throughout.
"""

import numpy as np
import pytest
from scipy import stats
from scipy.ndimage import gaussian_filter

from simulator.build import detector_parameters
from simulator.detector.cosmic_rays import (
    add_tracks,
    draw_cosmic_rays,
    landau_quantile,
    mean_cosmic_rays,
    most_probable_loss_ev,
)
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect


def draw(section, rng):
    return draw_cosmic_rays(detector_parameters(section), section.exposure_s, rng)


def mean_number(section):
    return mean_cosmic_rays(detector_parameters(section), section.exposure_s)


def tc211(rate, **keys):
    """192 × 165 pixels of 13.75 × 16 µm, 0.2 s (Greyling 1995)."""
    base = {"width": 192, "height": 165, "pixel_pitch_um": (13.75, 16.0), "exposure_s": 0.2}
    return DetectorSection(**base, cosmic_rays={"rate_cm2_s": rate, **keys})


def many(depth=10.0, n=200_000):
    """Some 200,000 tracks."""
    detector = tc211(n / 0.2 / (192 * 165 * 13.75 * 16e-8), depth_um=depth)
    return detector, draw(detector, stream(1, "cosmic_rays", 0))


def test_fifteen_hits_in_the_anomaly_and_a_fiftieth_of_one_outside():
    assert mean_number(tc211(1100.0)) == pytest.approx(15.3, abs=0.1)
    assert mean_number(tc211(1.5)) == pytest.approx(0.021, abs=0.001)
    counts = np.array([len(draw(tc211(1100.0), stream(1, "cosmic_rays", k)).charge_e) for k in range(400)])
    # Poisson of 15.3: σ of the mean √(15.3/400); index of dispersion × (n − 1) is χ² with n − 1 degrees.
    assert abs(counts.mean() - 15.335) < 4 * np.sqrt(15.3 / 400)
    assert 1e-4 < stats.chi2.sf(399 * counts.var(ddof=1) / counts.mean(), 399) < 1 - 1e-4
    outside = sum(len(draw(tc211(1.5), stream(1, "cosmic_rays", k)).charge_e) for k in range(4000))
    assert abs(outside - 4000 * 0.02091) < 4 * np.sqrt(84)


def test_isotropic_flux_through_a_plane():
    detector, hits = many()
    shift_um = (hits.end_px - hits.start_px) * detector.pitch_um
    np.testing.assert_allclose(np.hypot(*shift_um.T) ** 2 + 10.0**2, hits.length_um**2, rtol=1e-9)
    assert stats.kstest((10.0 / hits.length_um) ** 2, "uniform").pvalue > 1e-4  # cos² θ
    azimuth = np.arctan2(shift_um[:, 1], shift_um[:, 0])
    assert stats.kstest(azimuth, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-4
    for axis, size in ((0, 192), (1, 165)):
        assert stats.kstest(hits.start_px[:, axis], stats.uniform(-0.5, size).cdf).pvalue > 1e-4


def test_most_probable_and_mean_charge():
    _, hits = many(n=2_000_000)
    along = hits.charge_e / hits.length_um
    counts, edges = np.histogram(along, np.arange(60.0, 110.0, 1.0))
    # Peak by a parabola through the bins within ±4 e⁻/µm; its error, about 0.1, and the skewness of Landau's peak, 0.5.
    near = np.abs(edges[:-1] + 0.5 - 80.0) < 4.0
    b, a = np.polyfit(edges[:-1][near] + 0.5, counts[near], 2)[:2]
    assert -a / (2 * b) == pytest.approx(80.0, abs=1.0)
    # Minimum ionisation: 1.664 × 2.329 MeV/cm over 3.65 eV = 106.2 e⁻/µm.
    assert abs(along.mean() - 106.2) < 4 * along.std() / np.sqrt(along.size) + 0.05
    # A muon straight through 25 µm: 2000 e⁻.
    assert np.median(along) * 25.0 == pytest.approx(2000.0, rel=0.15)
    assert along.min() > 55.0  # a sharp lower edge, as the camera sees it


def test_landau_variable():
    """Mode −0.22278, median 1.35578, the constants of CERNLIB's and PDG's Landau function."""
    assert landau_quantile(np.array([0.5]))[0] == pytest.approx(1.35578, abs=1e-5)
    p = np.linspace(0.05, 0.4, 35_001)
    density = np.diff(p) / np.diff(landau_quantile(p))
    assert landau_quantile(p[np.argmax(density) : np.argmax(density) + 1])[0] == pytest.approx(-0.22278, abs=5e-3)


def test_landau_width():
    """Full width at half maximum 4.02 ξ, ξ = 17.83 eV/µm (Particle Data Group), over 3.65 eV: 19.6 e⁻/µm; bins of 1."""
    _, hits = many(n=2_000_000)
    counts, edges = np.histogram(hits.charge_e / hits.length_um, np.arange(55.0, 130.0, 1.0))
    half = edges[:-1][counts > counts.max() / 2]
    assert half[-1] - half[0] + 1.0 == pytest.approx(4.018 * 17.83 / 3.65, abs=1.5)


def test_hubbles_camera():
    """A layer of 12 µm (the camera's are 13 to 17) and pixels of 15 µm, and a diffusion of 6 µm, both assumed.

    The chip's 80 e⁻/µm would be that of thick silicon; thin silicon has what Landau's theory gives for it. The median
    is held to 35 %, the pixels above 3 times the read noise of 5 e⁻ to 3 to 8: a sanity check, not a measurement.
    """
    layer_um = 12.0
    charge = most_probable_loss_ev(layer_um) / 3.65 / layer_um
    detector = DetectorSection(
        width=400,
        height=400,
        pixel_pitch_um=15.0,
        exposure_s=1.0,
        cosmic_rays={"rate_cm2_s": 1100.0, "depth_um": layer_um, "charge_e_um": charge},
    )
    hits = draw(detector, stream(2, "cosmic_rays", 0))
    assert np.median(hits.charge_e) == pytest.approx(1000.0, rel=0.35)
    assert np.mean(hits.charge_e < 500.0) < 0.03
    pixels = []
    for k in range(150):
        image = np.zeros((60 * 5, 60 * 5))  # five to the pixel, for the diffusion
        shift = np.array([150.0, 150.0]) + hits.start_px[k] * 5 % 5
        reach = (hits.end_px[k] - hits.start_px[k]) * 5
        add_tracks(image, shift[None], (shift + reach)[None], hits.charge_e[k : k + 1])
        spread = gaussian_filter(image, 6.0 / 15.0 * 5).reshape(60, 5, 60, 5).sum(axis=(1, 3))
        pixels.append((spread > 15.0).sum())
    assert 3 <= np.median(pixels) <= 8


def test_mean_charge_of_the_chain():
    """Charge a frame: hits × mean length (twice the depth) × 106.2 e⁻/µm, less what leaves at the edges."""
    detector = DetectorSection(
        width=256,
        height=256,
        pixel_pitch_um=10.0,
        exposure_s=1.0,
        shot_noise=False,
        full_well_e=1e9,
        adc_bits=None,
        cosmic_rays={"rate_cm2_s": 20_000.0},
    )
    pattern = build_fixed_pattern(detector, 1)
    dark = np.zeros((256, 256))
    sums = [detect(dark, detector, pattern, lambda name, k=k: stream(1, name, k)).electrons.sum() for k in range(200)]
    n = mean_number(detector)
    # Half a mean lateral reach (π/2 × 10 µm × 2/π per axis = 10 µm) is lost at each of 4 sides: 4 × 5 µm / 2560 µm.
    expected = n * 2 * 10.0 * 106.2 * (1 - 4 * 0.5 * 5.0 / 2560.0)
    assert np.mean(sums) == pytest.approx(expected, abs=4 * np.std(sums) / np.sqrt(200) + 0.005 * expected)
    assert detect(dark, detector, pattern, lambda name: stream(1, name, 0)).image.min() == 0.0
