"""Aberrated stamps against GalSim's OpticalPSF (Rowe et al. 2015): data/psf_aberrated_galsim.npz, written by
build_psf_aberrated_galsim.py (version and date are in the file).

1e-3 of the peak: GalSim samples a pupil with jagged edges; where there is no aberration it is 8e-4 off the exact Airy
pattern. Its image is ours turned by half a turn, as a wavefront's sign makes it.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from simulator.optics.lens import Lens
from simulator.optics.psf import aberrated
from simulator.optics.psf_model import PsfModel
from simulator.optics.pupil import mean_slope
from simulator.optics.splat import render_stars

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from build_psf_aberrated_galsim import CASES, OFFSETS, SIZE, draw  # noqa: E402

sys.path.remove(str(HERE))
STORED = np.load(HERE / "data" / "psf_aberrated_galsim.npz")["stamps"].astype(float)


@pytest.mark.parametrize("case", range(len(CASES)))
def test_pixels(case):
    lambda_n, hole, noll = CASES[case]
    coefficients = np.zeros(11)
    for index, value in noll.items():
        coefficients[index - 1] = value
    lens = Lens(lambda_n * 10.0 / 0.6, (10.0, 10.0), hole)
    (psf,) = aberrated(PsfModel(model="diffraction"), lens, coefficients, np.array([600.0]), np.ones((1, 1)))
    # GalSim leaves the polynomials where they are; our stars are at their measured centroids
    shift = 2.0 * mean_slope(coefficients[None], hole) * lambda_n - psf.geometric_px
    for offset, stamp in zip(OFFSETS, STORED[case], strict=True):
        ours = render_stars((SIZE, SIZE), SIZE // 2 - np.array([offset]) + shift, np.ones(1), [1e6], psf) / 1e6
        assert np.abs(ours[::-1, ::-1] - stamp).max() < 1e-3 * stamp.max()


@pytest.mark.slow
def test_stored_stamps_are_what_galsim_draws():
    pytest.importorskip("galsim")
    np.testing.assert_allclose(draw()["stamps"], STORED, atol=1e-6)
