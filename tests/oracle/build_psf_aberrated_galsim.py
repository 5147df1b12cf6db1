"""Write data/psf_aberrated_galsim.npz: aberrated stars drawn by GalSim's OpticalPSF (Rowe et al. 2015), for
test_psf_aberrated.py.

    python tests/oracle/build_psf_aberrated_galsim.py            # needs galsim (extra: oracles)

Stamps of 31 × 31 pixels, flux 1, the polynomials' own centre (no shift to the centroid) at the given offset.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import numpy as np

CASES = [  # λN in pixels, central obscuration, Noll coefficients in waves rms
    (1.3, 0.0, {}),
    (1.3, 0.35, {}),
    (1.3, 0.0, {4: 0.25}),
    (0.9, 0.3, {4: 0.1, 8: 0.12}),
    (1.1, 0.0, {5: 0.08, 6: 0.1, 7: -0.07}),
    (1.0, 0.2, {9: 0.06, 10: 0.05, 11: 0.1}),
]
OFFSETS = [(0.0, 0.0), (0.31, -0.17)]
SIZE = 31


def draw() -> dict[str, np.ndarray]:
    import galsim

    params = galsim.GSParams(folding_threshold=5e-3, maximum_fft_size=16384)
    stamps = np.empty((len(CASES), len(OFFSETS), SIZE, SIZE))
    for c, (lambda_n, obscuration, noll) in enumerate(CASES):
        aberrations = np.zeros(12)
        for index, value in noll.items():
            aberrations[index] = value
        star = galsim.OpticalPSF(
            lam_over_diam=lambda_n, aberrations=aberrations, obscuration=obscuration, oversampling=2.0, pad_factor=10.0,
            gsparams=params,
        )  # fmt: skip
        for o, offset in enumerate(OFFSETS):
            image = galsim.Image(SIZE, SIZE, dtype=np.float64)
            star.drawImage(image=image, scale=1.0, offset=offset, method="auto")
            stamps[c, o] = image.array
    return {"stamps": stamps, "galsim": np.array(galsim.__version__)}


if __name__ == "__main__":
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "data" / "psf_aberrated_galsim.npz"
    made = draw()
    made["stamps"] = made["stamps"].astype(np.float32)
    np.savez_compressed(path, date=np.array(datetime.datetime.now(datetime.UTC).date().isoformat()), **made)
