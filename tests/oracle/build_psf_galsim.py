"""Write data/psf_galsim.npz: stamps of Gaussian and Airy stars drawn by GalSim (Rowe et al. 2015), for
test_psf_galsim.py.

    python tests/oracle/build_psf_galsim.py            # needs galsim (extra: oracles)

Each stamp is 25 × 25 pixels, the star near its middle at a chosen offset; flux 1; GalSim draws by FFT with its accuracy
parameters tightened until the stamps change by less than 1e-6 of the peak.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import numpy as np

CASES = [  # model, first dark ring or sigma in pixels along columns, pitch_x / pitch_y
    ("gaussian", 0.5, 1.0),
    ("gaussian", 1.34985, 1.0),
    ("gaussian", 1.2, 0.859375),
    ("airy", 2.0, 1.0),
    ("airy", 0.8, 1.0),
    ("airy", 0.4, 1.0),
    ("airy", 1.5, 0.859375),
]
OFFSETS = [(0.0, 0.0), (0.31, -0.17), (-0.5, 0.42)]
SIZE = 25
FIRST_RING = 1.2196698912665045


def draw() -> dict[str, np.ndarray]:
    import galsim

    params = galsim.GSParams(
        folding_threshold=1e-3, maxk_threshold=1e-5, kvalue_accuracy=1e-8, maximum_fft_size=16384, stepk_minimum_hlr=400
    )
    stamps = np.empty((len(CASES), len(OFFSETS), SIZE, SIZE), dtype=np.float64)
    for c, (model, width, aspect) in enumerate(CASES):
        if model == "gaussian":
            star = galsim.Gaussian(sigma=width, flux=1.0, gsparams=params)
        else:
            star = galsim.Airy(lam_over_diam=width / FIRST_RING, flux=1.0, gsparams=params)
        wcs = galsim.JacobianWCS(1.0, 0.0, 0.0, 1.0 / aspect)  # unit: one column
        for o, offset in enumerate(OFFSETS):
            image = galsim.Image(SIZE, SIZE, dtype=np.float64)
            star.drawImage(image=image, wcs=wcs, offset=offset, method="fft" if model == "airy" else "auto")
            stamps[c, o] = image.array
    return {"stamps": stamps, "galsim": np.array(galsim.__version__)}


if __name__ == "__main__":
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "data" / "psf_galsim.npz"
    made = draw()
    made["stamps"] = made["stamps"].astype(np.float32)
    np.savez_compressed(path, date=np.array(datetime.datetime.now(datetime.UTC).date().isoformat()), **made)
