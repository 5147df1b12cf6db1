"""Stamps against GalSim (Rowe et al. 2015, A&C 10, 121): data/psf_galsim.npz, written by build_psf_galsim.py (its
version and date are in the file).

Pixel values agree within 2e-4 of the peak, the accuracy asked of the optics; ours are good to 5e-5, GalSim's, drawn
by FFT, to about as much. The stamps are of 1, 1,000 and 1e6 electrons: the share drawn must not depend on the flux.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from build_psf_galsim import CASES, OFFSETS, SIZE, draw  # noqa: E402

sys.path.remove(str(HERE))
STORED = np.load(HERE / "data" / "psf_galsim.npz")["stamps"].astype(float)


def psf_of(model, width, aspect):
    given = {"sigma_px": width} if model == "gaussian" else {"first_dark_ring_px": width}
    return build_psf(PsfModel(model=model, **given), 2.0, (10.0 * aspect, 10.0))


@pytest.mark.parametrize("electrons", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("case", range(len(CASES)))
def test_pixels(case, electrons):
    psf = psf_of(*CASES[case])
    for offset, stamp in zip(OFFSETS, STORED[case], strict=True):
        xy = np.array([[SIZE // 2 + offset[0], SIZE // 2 + offset[1]]])
        ours = render_stars((SIZE, SIZE), xy, np.ones(1), [electrons], psf) / electrons
        assert np.abs(ours - stamp).max() < 2e-4 * STORED[case].max()


@pytest.mark.slow
def test_stored_stamps_are_what_galsim_draws():
    pytest.importorskip("galsim")
    np.testing.assert_allclose(draw()["stamps"], STORED, atol=1e-6)
