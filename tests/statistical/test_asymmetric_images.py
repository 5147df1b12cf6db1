"""Whether the covariance of an attitude is true where star images are asymmetric, or so far out of focus that they are
rings. The normalised error squared has mean 3 and variance 6 where the covariance is true."""

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.trials.trial import TrialRunner

DIFFRACTION = ("optics.psf.model=diffraction", "optics.psf.sigma_px=null", "detector.hot_pixel_fraction=0")
F4 = (*DIFFRACTION, "optics.aperture_mm=6.25", "detector.pixel_pitch_um=3.0")
COMA = "optics.psf.zernike_waves.coma_x=0.1"
F2 = (*DIFFRACTION, "optics.aperture_mm=12.5")


def zernike(name, waves):
    return f"optics.psf.zernike_waves.{name}={waves}"


CASES = {
    "f/4, 3 um, in focus": F4,
    "coma of 0.1 at f/4": (*F4, COMA),
    "coma of 0.1 along y at f/4": (*F4, zernike("coma_y", 0.1)),
    "coma of 0.1 along both axes at f/4": (*F4, COMA, zernike("coma_y", 0.1)),
    "coma of 0.2 at f/4": (*F4, zernike("coma_x", 0.2)),
    "coma of 0.2 at f/2": (*F2, zernike("coma_x", 0.2)),
    "coma of 0.2 at f/1.4": (*DIFFRACTION, zernike("coma_x", 0.2)),
    "trefoil of 0.1 at f/4": (*F4, zernike("trefoil_x", 0.1)),
    "astigmatism of 0.15 at f/4": (*F4, zernike("astigmatism", 0.15)),
    "defocus of 80 um": (*DIFFRACTION, "optics.psf.defocus_um=80"),
    "coma of 0.05 at f/4": (*F4, "optics.psf.zernike_waves.coma_x=0.05"),
    "coma out of focus at f/4": (*F4, COMA, "optics.psf.defocus_um=20"),
    "coma of 0.1 at f/1.4": (*DIFFRACTION, COMA),
    "defocus of 20 um": (*DIFFRACTION, "optics.psf.defocus_um=20"),
    "defocus of 60 um": (*DIFFRACTION, "optics.psf.defocus_um=60"),
}
TOO_CAUTIOUS = {"coma of 0.3 at f/1.4": (*DIFFRACTION, zernike("coma_x", 0.3))}
"""Mean NEES of 2.2 over 80 frames, 2.45 over 200."""


def normalised_errors(overrides, trials, seed):
    """NEES of the solved trials."""
    nees = all_errors(overrides, trials, seed)
    assert np.isfinite(nees).mean() > 0.9
    return nees[np.isfinite(nees)]


def all_errors(overrides, trials, seed):
    runner = TrialRunner(Scenario.load("cubesat_ideal", [*overrides, f"seed={seed}"]))
    return np.array([runner.run(k)["nees"] for k in range(trials)])


@pytest.mark.parametrize(
    ("name", "trials"), [("coma of 0.1 at f/4", 40), ("defocus of 60 um", 24), ("coma of 0.3 at f/1.4", 30)]
)
def test_asymmetric_and_ring_images(name, trials):
    """25, 18 and 9 before: a bias of 0.14 px of faint stars, a star's position on a ring of its image, and an ellipse
    turned by the positions of nine stars in their pixels, which moved all stars across the coma."""
    nees = normalised_errors((CASES | TOO_CAUTIOUS)[name], trials, 77)
    assert nees.mean() < 3.0 + 4.0 * np.sqrt(6.0 / len(nees))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CASES))
def test_the_covariance_is_true_within_a_third(name):
    """Limits of the requirement, 2.4 to 4; the mean of 200 is good to 0.17."""
    nees = normalised_errors(CASES[name], 200, 31)
    assert 2.4 < nees.mean() < 4.0


APERTURES = {1.4: (), 2.0: F2[3:], 2.8: ("optics.aperture_mm=8.93", "detector.pixel_pitch_um=3.0"), 4.0: F4[3:]}


def random_lens(rng):
    """A lens: f/1.4 and f/2 with 5.5 µm pixels, f/2.8 and f/4 with 3 µm; coma of 0.05 to 0.3 waves in any direction,
    and with even odds each up to 60 µm of defocus, 0.15 waves of astigmatism and 0.1 waves of trefoil."""
    aperture = APERTURES[float(rng.choice([1.4, 2.0, 2.8, 4.0]))]
    coma, angle = np.exp(rng.uniform(np.log(0.05), np.log(0.3))), rng.uniform(0.0, 2.0 * np.pi)
    defocus = rng.uniform(0.0, 60.0) * (rng.random() < 0.5)
    astigmatism, trefoil = rng.uniform(0.0, 0.15) * (rng.random() < 0.5), rng.uniform(0.0, 0.1) * (rng.random() < 0.5)
    turned = rng.uniform(0.0, 2.0 * np.pi, 2)
    waves = {"coma_x": coma * np.cos(angle), "coma_y": coma * np.sin(angle)}
    waves |= {"astigmatism": astigmatism * np.cos(turned[0]), "astigmatism_oblique": astigmatism * np.sin(turned[0])}
    waves |= {"trefoil_x": trefoil * np.cos(turned[1]), "trefoil_y": trefoil * np.sin(turned[1])}
    aberrations = [zernike(name, f"{value:.4f}") for name, value in waves.items()]
    return (*DIFFRACTION, *aperture, f"optics.psf.defocus_um={defocus:.1f}", *aberrations)


@pytest.mark.slow
def test_lenses_that_calibrated_nothing():
    """The errors that the correction states were read off 24 lenses of another seed (`random_lens`, seed 1).

    Limits of the requirement for the mean of all frames, give or take three of its standard errors, √(6/480). Single
    lenses may have single frames far outside: the mean of one is 6.4, with one frame of 67.
    """
    rng = np.random.default_rng(2)
    nees = np.concatenate([all_errors(random_lens(rng), 20, 1000 + k) for k in range(24)])
    assert np.isfinite(nees).mean() > 0.9
    error = np.sqrt(6.0 / len(nees))
    assert 2.4 - 3.0 * error < np.nanmean(nees) < 4.0 + 3.0 * error
