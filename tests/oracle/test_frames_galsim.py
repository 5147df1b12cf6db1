"""Frames rendered by GalSim alone (Rowe et al. 2015, A&C 10, 121): data/frames_galsim.npz, written by
build_frames_galsim.py (its version and date are in the file).

The tracker's attitude against the frame's, by the covariance that it states (NEES), and by the Fisher information that
the builder computes from GalSim's star images.
"""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from startracker import Attitude, Camera, CentroidSettings, Distortion, Observer, StarTracker
from startracker.centroid.psf_model import PsfModel

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from build_frames_galsim import E_PER_DN, FULL_DN, GUIDE_LIMIT, MODELS, SIZE, TABLE_STEPS, draw  # noqa: E402

sys.path.remove(str(HERE))
STORED = dict(np.load(HERE / "data" / "frames_galsim.npz"))
FX, FY, CX, CY, K1, K2, P1, P2, K3 = STORED["camera"]
CAMERA = Camera(FX, FY, CX, CY, SIZE, SIZE, Distortion(k1=K1, k2=K2, p1=P1, p2=P2, k3=K3))
OBSERVER = Observer(float(STORED["epoch_jyear"]), np.zeros(3))  # at the barycentre, at rest
METHODS = ("moment", "weighted_moment", "least_squares", "maximum_likelihood")


def errors(tracker, model):
    """Error (3,) in camera axes, stated covariance and Fisher information (3, 3), and solution of each frame."""
    for k in np.flatnonzero(STORED["models"] == model):
        solution = tracker.solve(STORED["frames"][k], observer=OBSERVER, saturation_dn=FULL_DN, gain_e_per_dn=E_PER_DN)
        assert solution.solved, solution.reason
        error = Attitude.from_matrix(STORED["matrices"][k]).rotation_vector_to(solution.attitude)
        yield error, solution, k


@cache
def normalised(centroider, model):
    """Errors squared (n,) over the stated covariance."""
    tracker = StarTracker(CAMERA, magnitude_limit=GUIDE_LIMIT, centroider=centroider)
    squares = []
    for error, solution, k in errors(tracker, model):
        none_misidentified(tracker, solution, STORED["matrices"][k])
        squares.append(error @ np.linalg.solve(solution.covariance, error))
    return np.array(squares)


def none_misidentified(tracker, solution, matrix):
    """Every named star lies where the true attitude has it; blends with fainter stars move some by up to a pixel."""
    guide = tracker.guide.apparent_to(OBSERVER)
    row = {star: k for k, star in enumerate(guide.catalog.id)}
    true = CAMERA.project(guide.directions[[row[star] for star in solution.stars.catalog_id]] @ matrix.T)
    off = np.hypot(*(solution.stars.xy - true).T)
    assert off.max() < 3.0
    assert np.quantile(off, 0.9) < 1.0


@pytest.mark.parametrize("centroider", METHODS)
def test_the_covariance_is_inside_its_bounds(centroider):
    """The sum of n NEES is χ² of 3 n degrees of freedom where the covariance is true: 95 % of the means are within its
    2.5 % and 97.5 % quantiles over n, 2.25 and 3.85 for 36 frames."""
    nees = np.concatenate([normalised(centroider, model) for model in MODELS])
    low, high = chi2.ppf([0.025, 0.975], 3 * len(nees)) / len(nees)
    assert len(nees) == len(STORED["frames"])
    assert low <= nees.mean() <= high


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("centroider", METHODS)
def test_with_each_psf(centroider, model):
    """As above for a third of the frames; twelve tests of which each may fail by chance: one in 20 all together."""
    nees = normalised(centroider, model)
    tail = 0.025 / (len(METHODS) * len(MODELS))
    low, high = chi2.ppf([tail, 1.0 - tail], 3 * len(nees)) / len(nees)
    assert low <= nees.mean() <= high


def write_psf(model, folder):
    """File of GalSim's star image for the tracker."""
    table = STORED["psf_tables"][list(STORED["psf_models"]).index(model)].astype(float)
    y, x = (np.mgrid[: len(table), : len(table)] - len(table) // 2) / TABLE_STEPS
    core = table * (np.hypot(x, y) < 2.5)
    core /= core.sum()
    path = folder / f"{model}.npz"
    PsfModel(table, TABLE_STEPS, (np.sum(core * x * x), np.sum(core * y * y), np.sum(core * x * y))).save(path)
    return str(path)


@pytest.mark.parametrize("centroider", ["least_squares", "maximum_likelihood"])
def test_with_the_star_image_known_errors_are_near_the_fisher_bound(centroider, tmp_path):
    """An efficient estimate has errors whose squares over the bound are χ² of 3 degrees of freedom, with mean 3."""
    squares, nees = [], []
    for model in MODELS:
        settings = CentroidSettings(psf=write_psf(model, tmp_path))
        tracker = StarTracker(CAMERA, magnitude_limit=GUIDE_LIMIT, centroider=centroider, centroid=settings)
        for error, solution, k in errors(tracker, model):
            squares.append(error @ STORED["fisher"][k] @ error)
            nees.append(error @ np.linalg.solve(solution.covariance, error))
    low, high = chi2.ppf([0.025, 0.975], 3 * len(nees)) / len(nees)
    assert low <= np.mean(nees) <= high
    assert low <= np.mean(squares) <= 1.3**2 * 3.0  # errors of at most 1.3 times the bound


def test_stars_elongated_by_aberrations_are_no_satellites():
    """A common elongation that half of the stars have is the lens's, not a trail: the bright stars stay."""
    stored = np.load(HERE / "data" / "frame_elongated_galsim.npz")
    tracker = StarTracker(CAMERA, magnitude_limit=GUIDE_LIMIT)
    solution = tracker.solve(stored["frame"], observer=OBSERVER, saturation_dn=FULL_DN, gain_e_per_dn=E_PER_DN)
    assert solution.solved, solution.reason
    none_misidentified(tracker, solution, stored["matrix"])
    guide = tracker.guide.apparent_to(OBSERVER)
    row, _, _ = guide.in_field(stored["matrix"], -5.0, CAMERA)
    brightest = set(guide.catalog.id[row[:12]].tolist())
    assert len(brightest.intersection(solution.stars.catalog_id.tolist())) >= 10


@pytest.mark.slow
def test_stored_frames_are_what_galsim_draws():
    pytest.importorskip("galsim")
    drawn = draw(frames_per_model=1)
    first = [int(np.argmax(STORED["models"] == model)) for model in MODELS]
    # a pixel next to a step of the Poisson distribution may differ by one after another library's FFT
    assert np.mean(drawn["frames"] != STORED["frames"][first]) < 1e-3
    np.testing.assert_allclose(drawn["matrices"], STORED["matrices"][first], atol=1e-12)
    np.testing.assert_allclose(drawn["fisher"], STORED["fisher"][first], rtol=1e-4)
    np.testing.assert_allclose(drawn["psf_tables"], STORED["psf_tables"], atol=1e-6)
