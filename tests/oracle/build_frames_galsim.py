"""Write data/frames_galsim.npz and data/frame_elongated_galsim.npz: star-camera frames rendered by GalSim (Rowe et al.
2015), for test_frames_galsim.py.

    python tests/oracle/build_frames_galsim.py            # needs galsim (extra: oracles); some minutes

Nothing of the simulator or of the tracker's geometry is used, but for the columns of the Hipparcos catalogue. Stars are
moved to the epoch by their proper motion, projected through a pinhole with the distortion of OpenCV's documentation
(calib3d), and drawn by GalSim through one of three PSFs, integrated over the pixels. GalSim adds Poisson noise of stars
and sky and Gaussian read noise. No parallax, no aberration. The PSFs have no coma: its shift is the same for all stars,
so that a frame cannot distinguish it from a rotation.

Each frame comes with the Fisher information of its attitude: for each star, from derivatives of the GalSim stamp by x,
y and flux under the noise of each pixel, flux marginalised; carried to the attitude by derivatives of the projection.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import numpy as np

SIZE = 256
FX, FY, CX, CY = 1042.0, 1045.0, 126.3, 129.1  # 14 degrees across
K1, K2, P1, P2, K3 = -0.8, 2.0, 2e-3, -1.5e-3, -1.0
EPOCH = 2026.0
CATALOG_EPOCH = 1991.25
FAINTEST, GUIDE_LIMIT = 8.0, 6.5  # V of the faintest star drawn, and of the faintest that the tracker uses
ZERO_POINT_E = 4e5  # electrons of a star of V = 0
SKY_E, READ_NOISE_E, E_PER_DN, BIAS_DN, FULL_DN = 20.0, 8.0, 4.0, 100, 16383
MODELS = ("airy", "aberrated", "moffat")
PER_MODEL = 12
SEED = 20261122
ELONGATED_SEED, ELONGATED = 4711, 42
"""An "aberrated" frame in which half of the stars are just longer, half just shorter, than twice their breadth."""
STEP = 0.02  # pixels, of the derivatives
TABLE_STEPS, TABLE_RADIUS = 8, 8  # of the tables of the PSFs: points a pixel, pixels


def psf_of(model: str) -> object:
    """A GalSim profile of flux 1; lengths in pixels."""
    import galsim

    if model == "airy":
        return galsim.Airy(lam_over_diam=1.2, obscuration=0.3)
    if model == "aberrated":  # waves rms, Noll: defocus, astigmatism, spherical
        waves = {4: 0.10, 5: 0.04, 6: -0.05, 11: 0.05}
        aberrations = [waves.get(noll, 0.0) for noll in range(12)]
        return galsim.OpticalPSF(lam_over_diam=1.1, aberrations=aberrations, obscuration=0.2)
    return galsim.Moffat(beta=3.0, fwhm=1.8)


def sky() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) at the epoch and V (N,)."""
    from startracker import load_catalog

    stars = load_catalog("hipparcos").brighter_than(FAINTEST)
    assert stars.epoch_jyear == CATALOG_EPOCH
    ra, dec = stars.ra_rad, stars.dec_rad
    u = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=1)
    u = u + (EPOCH - CATALOG_EPOCH) * (east * stars.pm_ra_rad_yr[:, None] + north * stars.pm_dec_rad_yr[:, None])
    return u / np.linalg.norm(u, axis=1, keepdims=True), stars.v_mag


def project(vectors: np.ndarray) -> np.ndarray:
    """Pixels (N, 2), the centre of the first pixel at (0, 0), of vectors (N, 3) in camera axes."""
    x, y = vectors[:, 0] / vectors[:, 2], vectors[:, 1] / vectors[:, 2]
    r2 = x * x + y * y
    radial = 1.0 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    xd = x * radial + 2.0 * P1 * x * y + P2 * (r2 + 2.0 * x * x)
    yd = y * radial + P1 * (r2 + 2.0 * y * y) + 2.0 * P2 * x * y
    return np.stack([FX * xd + CX, FY * yd + CY], axis=1)


def random_matrix(rng: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3) ICRS to camera, uniform: QR of a Gaussian matrix with the signs fixed (Mezzadri 2007)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def pixels_near(x: float, y: float, reach: int) -> tuple[int, int, int, int]:
    """First and last column, first and last row within `reach` of a star."""
    return (
        max(round(x) - reach, 0),
        min(round(x) + reach, SIZE - 1),
        max(round(y) - reach, 0),
        min(round(y) + reach, SIZE - 1),
    )


def stamp(psf, x: float, y: float, flux: float, bounds: tuple[int, int, int, int]) -> np.ndarray:
    """Electrons of a star in these pixels."""
    import galsim

    image = galsim.Image(galsim.BoundsI(*bounds), dtype=np.float64, scale=1.0)
    psf.withFlux(flux).drawImage(image=image, center=galsim.PositionD(x, y))  # integrated over pixels
    return image.array


def fisher_of_star(psf, x: float, y: float, flux: float) -> np.ndarray:
    """Fisher information (2, 2) of x and y, px⁻², with the flux unknown."""
    bounds = pixels_near(x, y, 8)
    light = stamp(psf, x, y, flux, bounds)
    by_x = (stamp(psf, x + STEP, y, flux, bounds) - stamp(psf, x - STEP, y, flux, bounds)) / (2.0 * STEP)
    by_y = (stamp(psf, x, y + STEP, flux, bounds) - stamp(psf, x, y - STEP, flux, bounds)) / (2.0 * STEP)
    slopes = np.stack([by_x, by_y, light / flux]).reshape(3, -1)
    variance = light.ravel() + SKY_E + READ_NOISE_E**2 + E_PER_DN**2 / 12.0  # the last is rounding's
    full = (slopes / variance) @ slopes.T
    return full[:2, :2] - np.outer(full[:2, 2], full[2, :2]) / full[2, 2]


def fisher_of_attitude(psf, seen: np.ndarray, flux: np.ndarray) -> np.ndarray:
    """Fisher information (3, 3), rad⁻², of a small rotation of the camera, from stars (N, 3) in camera axes."""
    total = np.zeros((3, 3))
    points = project(seen)
    slopes = np.empty((len(seen), 2, 3))
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = 1e-5
        slopes[:, :, axis] = (project(seen - np.cross(turn, seen)) - project(seen + np.cross(turn, seen))) / 2e-5
    for (x, y), electrons, slope in zip(points, flux, slopes, strict=True):
        total += slope.T @ fisher_of_star(psf, x, y, electrons) @ slope
    return total


def render(model: str, matrix: np.ndarray, seed: int, stars: tuple[np.ndarray, np.ndarray]):
    """Frame (H, W) uint16 and its Fisher information (3, 3)."""
    import galsim

    directions, v_mag = stars
    seen = directions @ matrix.T
    near = np.flatnonzero(seen[:, 2] > np.cos(np.radians(12.0)))
    xy = project(seen[near])
    on_image = np.all((xy > -12.0) & (xy < SIZE + 11.0), axis=1)
    near, xy = near[on_image], xy[on_image]
    flux = ZERO_POINT_E * 10.0 ** (-0.4 * v_mag[near])
    psf = psf_of(model)
    electrons = np.full((SIZE, SIZE), SKY_E)
    for (x, y), light in zip(xy, flux, strict=True):
        first_x, last_x, first_y, last_y = bounds = pixels_near(x, y, 12 if light < 2e3 else 40 if light < 1e5 else 120)
        electrons[first_y : last_y + 1, first_x : last_x + 1] += stamp(psf, x, y, light, bounds)
    image = galsim.Image(np.maximum(electrons, 0.0), scale=1.0)
    rng = galsim.BaseDeviate(seed)
    image.addNoise(galsim.PoissonNoise(rng))
    image.addNoise(galsim.GaussianNoise(rng, sigma=READ_NOISE_E))
    frame = np.clip(np.rint(image.array / E_PER_DN + BIAS_DN), 0, FULL_DN).astype(np.uint16)
    guide = (v_mag[near] <= GUIDE_LIMIT) & np.all((xy > 2.0) & (xy < SIZE - 3.0), axis=1)
    return frame, fisher_of_attitude(psf, seen[near[guide]], flux[guide])


def frame_of(seed: int, m: int, k: int, stars: tuple[np.ndarray, np.ndarray]):
    """Attitude (3, 3), frame (H, W) and Fisher information (3, 3) of a frame with the m-th PSF."""
    matrix = random_matrix(np.random.default_rng([seed, m, k]))
    return matrix, *render(MODELS[m], matrix, seed + 1000 * m + k, stars)


def elongated() -> dict[str, np.ndarray]:
    """Frame (H, W) and attitude (3, 3) of the elongated stars."""
    matrix, frame, _ = frame_of(ELONGATED_SEED, MODELS.index("aberrated"), ELONGATED, sky())
    return {"frame": frame, "matrix": matrix}


def psf_table(model: str) -> np.ndarray:
    """Share of a star's light in a pixel by its distance from the star, TABLE_STEPS points a pixel, (n, n)."""
    import galsim

    points = 2 * TABLE_STEPS * TABLE_RADIUS + 1
    image = galsim.Image(points, points, dtype=np.float64, scale=1.0 / TABLE_STEPS)
    galsim.Convolve(psf_of(model), galsim.Pixel(1.0)).drawImage(image=image, method="no_pixel")
    return image.array * TABLE_STEPS**2


def draw(frames_per_model: int = PER_MODEL) -> dict[str, np.ndarray]:
    """Frames (N, H, W), attitudes (N, 3, 3) ICRS to camera, Fisher informations (N, 3, 3), the PSF's name (N,);
    and the PSFs' tables."""
    import galsim

    stars, frames, matrices, fisher, models = sky(), [], [], [], []
    for m, model in enumerate(MODELS):
        for k in range(frames_per_model):
            matrix, frame, information = frame_of(SEED, m, k, stars)
            frames.append(frame)
            fisher.append(information)
            matrices.append(matrix)
            models.append(model)
    return {
        "frames": np.array(frames),
        "matrices": np.array(matrices),
        "fisher": np.array(fisher),
        "models": np.array(models),
        "psf_models": np.array(MODELS),
        "psf_tables": np.array([psf_table(model) for model in MODELS]).astype(np.float32),
        "camera": np.array([FX, FY, CX, CY, K1, K2, P1, P2, K3]),
        "epoch_jyear": np.array(EPOCH),
        "galsim": np.array(galsim.__version__),
    }


if __name__ == "__main__":
    folder = Path(__file__).parent / "data"
    np.savez_compressed(folder / "frame_elongated_galsim.npz", **elongated())
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else folder / "frames_galsim.npz"
    np.savez_compressed(path, date=np.array(datetime.datetime.now(datetime.UTC).date().isoformat()), **draw())
