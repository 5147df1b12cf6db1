"""A display, a collimator and a camera before it, by brute force: geometry by OpenCV, brightness by formulas, and every
lit display pixel a Gaussian image of its own. Nothing of the product is used."""

import math
from dataclasses import dataclass, field

import cv2
import numba
import numpy as np


@dataclass
class Bench:
    """Truth. Fluxes are relative to a star of magnitude 0."""

    size: tuple = (1280, 1024)
    focal_px: float = 5065.0  # 60.8 mm at 12 µm
    centre: tuple = (655.0, 498.0)
    k1: float = -0.12
    k2: float = 0.3
    tilt_deg: tuple = (1.5, -1.0)
    parity: int = 1
    magnitude: dict = field(default_factory=lambda: {"red": 0.9, "green": 0.1, "blue": 1.6})
    gamma: dict = field(default_factory=lambda: {"red": 2.25, "green": 2.2, "blue": 2.1})
    curve: object = None
    white_factor: float = 0.97
    black: float = 0.0
    # the camera: OpenCV's own parameters, size, width of its images, electrons
    camera_matrix: tuple = (4545.0, 4541.0, 508.0, 515.0)
    camera_lens: tuple = (-0.05, 0.02, 2e-4, -1e-4)
    camera_size: tuple = (1024, 1024)
    sigma_px: float = 0.8
    zero_e_s: float = 4.0e6
    gain: float = 2.0
    offset_dn: float = 100.0
    read_noise_e: float = 6.0
    sky_e: float = 20.0
    turn: tuple = (0.012, -0.009, 0.05)
    saturation_dn: float = 65535.0

    def relative(self, colour, level):
        """Analytic curve of one colour."""
        if self.curve is not None:
            return self.curve(np.asarray(level) / 255.0)
        return (np.asarray(level) / 255.0) ** self.gamma[colour]

    def uniformity(self, xy):
        """Brightness over the display, 1 at its middle: bright on one side, dim in the corners."""
        x, y = (2 * (xy + 0.5) / np.array(self.size) - 1).T
        return np.exp(0.05 * x - 0.03 * y - 0.06 * (x**2 + y**2) + 0.02 * x * y)

    def directions(self, xy):
        """Collimator-frame directions of display pixels, by OpenCV."""
        fx, (cx, cy) = self.focal_px, self.centre
        matrix = np.array([[fx, 0, cx], [0, fx, cy], [0, 0, 1.0]])
        lens = np.array([self.k1, self.k2, *[0.0] * 10, *np.radians(self.tilt_deg)])
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
        plane = cv2.undistortPoints(np.asarray(xy, float)[:, None], matrix, lens, criteria=stop)[:, 0]
        rays = np.column_stack([plane, np.ones(len(plane))])
        again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, lens)
        assert np.abs(again[:, 0] - xy).max() < 1e-9
        return rays / np.linalg.norm(rays, axis=1)[:, None] * [self.parity, 1, 1]

    def seen(self, rays):
        """Camera pixels of directions in the collimator's frame, by OpenCV."""
        fx, fy, cx, cy = self.camera_matrix
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        xy, _ = cv2.projectPoints(rays, np.asarray(self.turn, float), np.zeros(3), matrix, np.array(self.camera_lens))
        return xy[:, 0]

    def flux(self, xy, rgb):
        """Flux of display pixels (N, 2) with levels (N, 3)."""
        total = np.zeros(len(xy))
        for k, colour in enumerate(("red", "green", "blue")):
            if colour in self.magnitude:
                total += 10 ** (-0.4 * self.magnitude[colour]) * self.relative(colour, rgb[:, k])
        factor = self.white_factor if (rgb > 0).any(axis=0).sum() > 1 else 1.0  # less supply for each colour
        return factor * total * self.uniformity(xy)

    def photograph(self, image, exposure_s, rng, on=True):
        """Photograph (H, W), DN, of a display image (H, W, 3); `rng` None: without noise and rounding."""
        rows, columns = np.nonzero(image.any(axis=2))
        xy = np.column_stack([columns, rows]).astype(float)
        electrons = np.full(self.camera_size[::-1], self.sky_e * exposure_s)
        if len(xy):
            light = self.flux(xy, image[rows, columns].astype(int)) * self.zero_e_s * exposure_s
            deposit(electrons, self.seen(self.directions(xy)), light, self.sigma_px)
        if on and self.black:
            fx, fy, *_ = self.camera_matrix
            white = self.flux(np.array(self.size)[None] / 2, np.array([[255, 255, 255]]))[0]
            electrons += self.black * white * self.zero_e_s * exposure_s * self.focal_px**2 / (fx * fy)
        if rng is None:
            return electrons / self.gain + self.offset_dn
        noisy = rng.poisson(electrons) + rng.normal(0.0, self.read_noise_e, electrons.shape)
        return np.clip(np.round(noisy / self.gain + self.offset_dn), 0, self.saturation_dn)


@numba.njit
def _gaussian(at, sigma):
    """Part of a Gaussian in the pixel from at − 0.5 to at + 0.5."""
    low, high = (at - 0.5) / (sigma * math.sqrt(2.0)), (at + 0.5) / (sigma * math.sqrt(2.0))
    return 0.5 * (math.erf(high) - math.erf(low))


@numba.njit
def deposit(image, xy, light, sigma, half=5):
    """Add Gaussian images, integrated over the pixels."""
    height, width = image.shape
    down = np.empty(2 * half + 1)
    for n in range(len(xy)):
        if not (-half < xy[n, 0] < width + half and -half < xy[n, 1] < height + half):
            continue
        x0, y0 = round(xy[n, 0]), round(xy[n, 1])
        for k in range(2 * half + 1):
            down[k] = _gaussian(y0 - half + k - xy[n, 1], sigma)
        for x in range(max(x0 - half, 0), min(x0 + half + 1, width)):
            across = light[n] * _gaussian(x - xy[n, 0], sigma)
            for y in range(max(y0 - half, 0), min(y0 + half + 1, height)):
                image[y, x] += across * down[y - y0 + half]
