"""Jitter: its variance, its periodogram and its means against the spectrum that was asked for; tolerances k·σ/√N."""

import numpy as np
import pytest
from scipy.signal import periodogram
from scipy.spatial.transform import Rotation

from simulator.optics.jitter import COMPONENTS, Jitter, Spectrum, draw_jitter, load_spectrum
from simulator.optics.jitter_series import JitterSeries, SampledJitter
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.smear import exposure_nodes, star_paths
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from startracker.errors import InputError
from startracker.geometry.camera import Camera

ARCSEC = np.pi / 648000.0
TABLE = "frequency_hz,psd\n# three lines of a reaction wheel\n0,1\n9,1\n10,40\n11,1\n30,0.2\n40,0\n"


def spectrum_of(name, tmp_path, corner_hz=5.0):
    (tmp_path / "wheel.csv").write_text(TABLE, encoding="utf-8")
    section = Jitter(rms_arcsec=(2.0, 3.0, 10.0), psd=name, corner_hz=corner_hz, table="wheel.csv")
    return section, load_spectrum(section, tmp_path)


@pytest.mark.parametrize("name", ["white", "lorentz", "table"])
def test_density_and_quantile_belong_together(name, tmp_path):
    _, spectrum = spectrum_of(name, tmp_path)
    f = np.linspace(0.0, spectrum.max_hz, 400_001)
    assert np.trapezoid(spectrum.per_hz(f), f) == pytest.approx(1.0, abs=1e-6)
    for share in (0.0, 0.1, 0.5, 0.93, 1.0):
        below = f[f <= spectrum.quantile(share)]
        assert np.trapezoid(spectrum.per_hz(below), below) == pytest.approx(share, abs=2e-4)
    assert spectrum.per_hz([-1.0, spectrum.max_hz * 1.001]).tolist() == [0.0, 0.0]


def test_lorentz_falls_by_half_at_its_corner(tmp_path):
    _, spectrum = spectrum_of("lorentz", tmp_path)
    assert spectrum.per_hz(5.0) == pytest.approx(0.5 * spectrum.per_hz(0.0))


@pytest.mark.parametrize("name", ["white", "lorentz", "table"])
def test_rms_and_periodogram(name, tmp_path):
    section, spectrum = spectrum_of(name, tmp_path)
    trials, span_s = 100, 2.0
    steps = int(np.ceil(2.5 * spectrum.max_hz * span_s))  # 1.25 times the Nyquist rate of the band
    t = (np.arange(steps) + 0.5) * span_s / steps - span_s / 2
    paths = np.array([draw_jitter(section, spectrum, stream(7, "jitter", k)).at(t) for k in range(trials)]) / ARCSEC
    rms = np.array(section.rms_arcsec)

    # a moment of each trial is one draw of N(0, rms²): its variance has the relative error √(2/N), 4 of which
    variance = (paths[:, 3] ** 2).mean(axis=0)
    np.testing.assert_allclose(variance, rms**2, rtol=4.0 * np.sqrt(2.0 / trials))
    # a mean of rms/√N, 4 of which
    assert (np.abs(paths[:, 3].mean(axis=0)) < 4.0 * rms / np.sqrt(trials)).all()
    # the axes are independent: correlation 1/√N
    assert np.abs(np.corrcoef(paths[:, 3].T) - np.eye(3)).max() < 4.0 / np.sqrt(trials)

    f = np.fft.rfftfreq(steps, span_s / steps)
    # what a Hann window of 2 s makes of the spectrum: its own response, 1.5 bins of 0.5 Hz wide, smooths the density
    fine = np.linspace(0.0, spectrum.max_hz, 4001)
    response = _hann(np.subtract.outer(f, fine) * span_s) + _hann(np.add.outer(f, fine) * span_s)
    smoothed = np.trapezoid(response * spectrum.per_hz(fine), fine, axis=1) * span_s
    for axis in range(3):
        _, power = periodogram(paths[..., axis], steps / span_s, window="hann", detrend=False, axis=-1)
        mean, expected = power.mean(axis=0), rms[axis] ** 2 * smoothed
        inside = (f > 2.0 / span_s) & (f < spectrum.max_hz - 2.0 / span_s)
        # each of N periodograms has an exponential distribution around what the lines in its reach add up to: relative
        # variance 1 + 2 H/n, with n lines a bin (Poisson at the worst) and H = ∫ response² = 0.48; 4.5 of its root/√N
        # for some 100 bins and 3 axes
        lines = COMPONENTS * spectrum.per_hz(f[inside]) / span_s
        allowed = 4.5 * np.sqrt((1.0 + 2.0 * 0.48 / lines) / trials)
        assert (np.abs(mean[inside] / expected[inside] - 1.0) < allowed).all()
        assert mean[f > spectrum.max_hz + 2.0 / span_s].max(initial=0.0) < 1e-3 * mean.max()


def _hann(bins):
    """Power response of a Hann window over its length, normalised to unit integral over the frequency in bins."""
    amplitude = np.sinc(bins) + 0.5 * np.sinc(bins - 1.0) + 0.5 * np.sinc(bins + 1.0)
    return amplitude**2 / 1.5


def test_mean_over_the_exposure_is_exact_and_taken_off(tmp_path):
    section, spectrum = spectrum_of("lorentz", tmp_path)
    path = draw_jitter(section, spectrum, stream(1, "jitter", 0))
    nodes, weights = exposure_nodes(400.0, 0.5)
    for exposure_s in (0.05, 1.3):
        mean = weights @ path.at(nodes * exposure_s / 2.0)
        np.testing.assert_allclose(path.mean(exposure_s), mean, rtol=0, atol=1e-12 * np.abs(mean).max())
        centred = path.centred(exposure_s)
        assert np.abs(centred.mean(exposure_s)).max() < 1e-20
        np.testing.assert_allclose(centred.at(0.1), path.at(0.1) - mean, rtol=1e-9)


def test_rate(tmp_path):
    section, spectrum = spectrum_of("white", tmp_path)
    path = draw_jitter(section, spectrum, stream(1, "jitter", 0))
    t = np.linspace(-100.0, 100.0, 20_001)
    rate = np.gradient(path.at(t), t, axis=0).std(axis=0)
    # 200 s of 5 Hz are 2,000 independent moments: 1/√(2 · 2000) = 1.6 %, 4 of which
    np.testing.assert_allclose(path.rms_rate_rad_s(), rate, rtol=0.064)


def test_body_axes(tmp_path):
    section = Jitter(rms_arcsec=(5.0, 0.0, 0.0), axes="body")
    mounting = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # body x is the boresight
    path = draw_jitter(section, load_spectrum(section), stream(1, "jitter", 0), mounting)
    turned = path.at(np.linspace(0, 1, 50))
    assert np.abs(turned[:, :2]).max() == 0.0
    assert turned[:, 2].std() > ARCSEC
    assert path.rms_rate_rad_s()[:2].tolist() == [0.0, 0.0]
    with pytest.raises(InputError, match="matrix"):
        draw_jitter(section, load_spectrum(section), stream(1, "jitter", 0))


def test_none_draws_nothing():
    rng = stream(1, "jitter", 0)
    assert draw_jitter(Jitter(), Spectrum("white", 1.0, 1.0), rng) is None
    assert rng.random() == stream(1, "jitter", 0).random()
    assert COMPONENTS >= 100  # by the central limit, and for the lines of a periodogram to overlap


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read"),
        ("a,b\n1,x\n2,3\n", "two columns of numbers"),
        ("1,1\n1,2\n", "frequencies must be ascending"),
        ("0,0\n1,0\n", "not all 0"),
        ("0,-1\n1,3\n", "densities 0 or more"),
    ],
)
def test_tables_that_are_none(tmp_path, text, message):
    if text is not None:
        (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_spectrum(Jitter(psd="table", table="t.csv"), tmp_path)
    with pytest.raises(InputError, match=r"needs pointing\.jitter\.table"):
        load_spectrum(Jitter(psd="table"))


# ---------------------------------------------------------------- on the image
@pytest.mark.parametrize(
    ("rms_px", "rate_deg_s", "exposure_s", "steps"),
    [
        (0.003, (0, 0, 0), 0.1, 1000),
        (0.02, (0, 0, 0), 0.1, 1000),
        (0.5, (0, 0, 0), 0.1, 1000),
        (0.5, (0.3, 0.2, 0.0), 0.5, 1000),
        (2.0, (0, 0, 5.0), 0.2, 1000),
        (2.0, (0.1, 0, 0), 1.0, 20000),
    ],
)
@pytest.mark.parametrize("name", ["white", "lorentz"])
def test_smear_with_jitter_within_1e4_of_a_1000_step_sum(name, rms_px, rate_deg_s, exposure_s, steps):
    """Brute force with scipy's rotations; 20,000 steps where 1,000 would themselves be off by more."""
    camera = Camera.from_fov(10.0, 512, 512)
    psf = build_psf(PsfModel(model="gaussian", sigma_px=1.0), 2.0, (10.0, 10.0))
    rms = rms_px * camera.pixel_rad / ARCSEC
    section = Jitter(rms_arcsec=(rms, rms, 2 * rms), psd=name, corner_hz=10.0)
    path = draw_jitter(section, load_spectrum(section), stream(3, "jitter", 0))
    star, rate = camera.unproject([[100.3, 150.8]]), np.radians(rate_deg_s)
    xy, weights = star_paths(camera, star, rate, exposure_s, psf.feature_px, jitter=path)
    t = ((np.arange(steps) + 0.5) / steps - 0.5) * exposure_s
    turned = (Rotation.from_rotvec(-path.at(t)) * Rotation.from_rotvec(-np.multiply.outer(t, rate))).apply(star[0])
    brute_xy = camera.project(turned)[None]
    brute = render_stars((512, 512), brute_xy, np.full(steps, 1 / steps), [1e5], psf)
    ours = render_stars((512, 512), xy, weights, [1e5], psf)
    assert np.abs(ours - brute).max() < 1e-4 * brute.max()


@pytest.mark.parametrize("kind", ["series", "sequence"])
def test_smear_with_other_jitter_within_1e4_of_a_1000_step_sum(kind):
    """A time series of a wheel, and a frame far from the start of a sequence's realisation."""
    camera = Camera.from_fov(10.0, 512, 512)
    psf = build_psf(PsfModel(model="gaussian", sigma_px=1.0), 2.0, (10.0, 10.0))
    rms = 1.5 * camera.pixel_rad / ARCSEC
    section = Jitter(rms_arcsec=(rms, rms, 2 * rms), corner_hz=5.0)
    if kind == "series":
        t_s = np.arange(0.0, 3.0, 1.0 / 400.0)
        phases = 2.0 * np.pi * 40.0 * t_s[:, None] + np.arange(3)
        angles = np.sqrt(2.0) * ARCSEC * np.array(section.rms_arcsec) * np.sin(phases)
        path = SampledJitter(JitterSeries(t_s, angles, "wheel"), 1.5, np.eye(3)).centred(0.2)
    else:
        rng = stream(3, "jitter", 0)
        path = draw_jitter(section, load_spectrum(section), rng, over_sequence=True).shifted(4321.0).centred(0.2)
    star = camera.unproject([[100.3, 150.8]])
    xy, weights = star_paths(camera, star, [0.0, 0.001, 0.0], 0.2, psf.feature_px, jitter=path)
    t = ((np.arange(1000) + 0.5) / 1000 - 0.5) * 0.2
    rates = np.multiply.outer(t, [0.0, 0.001, 0.0])
    turned = (Rotation.from_rotvec(-path.at(t)) * Rotation.from_rotvec(-rates)).apply(star[0])
    brute = render_stars((512, 512), camera.project(turned)[None], np.full(1000, 1e-3), [1e5], psf)
    ours = render_stars((512, 512), xy, weights, [1e5], psf)
    assert np.abs(ours - brute).max() < 1e-4 * brute.max()


def test_truth_turned_by_the_mean_is_where_the_star_s_centroid_is():
    """A camera turned by φ sees v at R(−φ) v: the sign of `mean`, and that the rest leaves the centroid."""
    camera = Camera.from_fov(2.0, 512, 512)
    section = Jitter(rms_arcsec=(30.0, 30.0, 300.0), corner_hz=20.0)
    path = draw_jitter(section, load_spectrum(section), stream(5, "jitter", 0))
    star = camera.unproject([[400.0, 90.0]])
    xy, weights = star_paths(camera, star, [0, 0, 0], 0.2, 0.5, jitter=path)
    centroid = weights @ xy[0]
    turned = camera.project(Rotation.from_rotvec(-path.mean(0.2)).apply(star))[0]
    assert np.abs(centroid - [400.0, 90.0]).max() > 0.3
    np.testing.assert_allclose(centroid, turned, atol=1e-3)  # (300″)² of second order: 2e-6 rad · 200 px
    xy, weights = star_paths(camera, star, [0, 0, 0], 0.2, 0.5, jitter=path.centred(0.2))
    np.testing.assert_allclose(weights @ xy[0], [400.0, 90.0], atol=1e-3)


def test_comments_and_headers_of_a_table_may_be_indented(tmp_path):
    rows = "0.1, 2\n5, 1\n"
    (tmp_path / "plain.csv").write_text(rows)
    (tmp_path / "noted.csv").write_text(f"# measured on a shaker\n  # second mount\n\n  frequency_hz, psd\n  {rows}")
    plain, noted = (load_spectrum(Jitter(psd="table", table=name), tmp_path) for name in ("plain.csv", "noted.csv"))
    np.testing.assert_array_equal(noted.density, plain.density)
    assert noted.max_hz == plain.max_hz == 5.0
