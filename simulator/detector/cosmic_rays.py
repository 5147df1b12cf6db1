"""Charged particles that cross the detector: straight tracks of ionisation.

The number of particles has a Poisson distribution with mean rate × area × exposure. An isotropic flux crosses a plane
with a density proportional to cos θ in solid angle: cos²θ is uniform from 0 to 1, and the azimuth is uniform. The
length in the silicon is depth / cos θ. The charge along it follows the Landau distribution (Landau 1944; Particle Data
Group, "Passage of particles through matter") with the most probable value `charge_e_um` × length; its width ξ is
proportional to that value as for a minimum-ionising particle. Energetic knock-on electrons leave the layer, so the tail
is truncated such that the mean equals the mean loss of a minimum-ionising particle, 1.664 MeV cm²/g × 2.329 g/cm³
(Particle Data Group, atomic properties).

Valid for fast particles, which neither stop nor scatter in tens of micrometres. 80 e⁻/µm is for layers of some hundred
micrometres; by the same theory it is less in thin layers, 62 e⁻/µm in 15 µm (`most_probable_loss_ev`). Trapped protons
of 100 MeV ionise about three times as much. Charge diffusion is not modelled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulator.detector.parameters import CosmicRays, DetectorParameters
from startracker._compiled import kernel
from startracker.core import FloatArray

PAIR_ENERGY_EV = 3.65
"""Mean energy per electron-hole pair in silicon (Janesick 2001)."""
SILICON_XI_EV_UM = 17.83
"""ξ/x = (K/2) (Z/A) ρ for β = 1: 0.307075 / 2 MeV cm²/mol × 0.49848 mol/g × 2.329 g/cm³ (Particle Data Group)."""
LANDAU_MODE = -0.22278
"""Most probable value of the Landau variable λ."""
LANDAU_SHARE = 0.99615118
"""Fraction of the Landau distribution below the truncation at λ = 265, with which the mean is the mean loss: 26.2 e⁻/µm
above the most probable one. In 10 µm this is a knock-on electron of 47 keV, whose range is about 20 µm."""
_REFERENCE_E_UM = 80.0  # most probable charge to which ξ refers
_XI_SHARE = SILICON_XI_EV_UM / PAIR_ENERGY_EV / _REFERENCE_E_UM  # ξ relative to the most probable charge


@dataclass(frozen=True, eq=False)
class CosmicRayTracks:
    """Tracks of the cosmic rays of one exposure."""

    start_px: FloatArray
    """(N, 2): Points of entry into the sensitive layer, (x, y) in pixels."""
    end_px: FloatArray
    """(N, 2): Points of exit from it."""
    length_um: FloatArray
    """(N,): Length in the silicon."""
    charge_e: FloatArray
    """(N,): Electrons generated along the whole track, inside the detector or outside."""


def mean_cosmic_rays(detector: DetectorParameters, exposure_s: float, particles: CosmicRays | None = None) -> float:
    """Mean number of particles through the surface of the detector in an exposure; `particles` replaces the kind given
    by the detector's parameters."""
    pitch_x, pitch_y = detector.pitch_um
    area_cm2 = detector.width * pitch_x * detector.height * pitch_y * 1e-8
    return (particles or detector.cosmic_rays).rate_cm2_s * area_cm2 * exposure_s


def draw_cosmic_rays(
    detector: DetectorParameters, exposure_s: float, rng: np.random.Generator, particles: CosmicRays | None = None
) -> CosmicRayTracks:
    """Random tracks of the particles that enter the layer from either side, within the outline of the detector, in one
    exposure; `particles` replaces the kind given by the detector's parameters."""
    rays = particles or detector.cosmic_rays
    n = int(rng.poisson(mean_cosmic_rays(detector, exposure_s, rays)))
    # Five deviates per particle: x and y of the entry, sin²θ, azimuth, and charge.
    uniform = rng.random((n, 5))
    cos = np.sqrt(1.0 - uniform[:, 2])  # never 0, because deviates are below 1
    azimuth = math.tau * uniform[:, 3]
    start = uniform[:, :2] * (detector.width, detector.height) - 0.5
    reach_um = rays.depth_um * np.sqrt(uniform[:, 2]) / cos  # depth × tan θ
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    length = rays.depth_um / cos
    # Deviates below the truncated fraction give the truncated distribution, relative to its most probable value.
    deviate = landau_quantile(uniform[:, 4] * LANDAU_SHARE) - LANDAU_MODE
    charge = rays.charge_e_um * length * np.maximum(1.0 + _XI_SHARE * deviate, 0.0)
    return CosmicRayTracks(start, start + along * reach_um[:, None] / detector.pitch_um, length, charge)


def add_cosmic_rays(
    electrons: FloatArray,
    detector: DetectorParameters,
    exposure_s: float,
    rng: np.random.Generator,
    particles: Sequence[CosmicRays] | None = None,
) -> FloatArray:
    """Add the charge of cosmic rays to an image (H, W), electrons, in place; the charge is not rounded. `particles`
    replaces the kind given by the detector's parameters."""
    for rays in (detector.cosmic_rays,) if particles is None else particles:
        tracks = draw_cosmic_rays(detector, exposure_s, rng, rays)
        add_tracks(electrons, tracks.start_px, tracks.end_px, tracks.charge_e)
    return electrons


def most_probable_loss_ev(thickness_um: float) -> float:
    """Most probable energy loss of a fast (βγ ≫ 100) singly charged particle in silicon, eV.

    Δp = ξ [ln(2 m c² ξ / (ħω_p)²) + 0.200], with m c² = 510,999 eV and the plasma energy ħω_p = 31.05 eV (Particle Data
    Group, Landau–Vavilov–Bichsel; the limit in which the density effect has levelled it off, 5 % above the minimum).
    """
    xi = SILICON_XI_EV_UM * thickness_um
    return xi * (math.log(2 * 510_998.95 * xi / 31.05**2) + 0.2)


def landau_quantile(probability: FloatArray) -> FloatArray:
    """Quantiles (N,) of the Landau variable λ.

    The Landau distribution is a stable distribution with location 0 and scale π/2; SciPy's has the scale 1:
    λ = (π/2) x + ln(π/2).
    """
    from scipy.stats import landau

    quantile: FloatArray = 0.5 * math.pi * landau.ppf(probability) + math.log(0.5 * math.pi)
    return quantile


@kernel
def add_tracks(image: FloatArray, start: FloatArray, end: FloatArray, charge: FloatArray) -> None:
    """Distribute straight tracks over the pixels they cross, by length, in place (Amanatides & Woo 1987).

    Parameters
    ----------
    image : (H, W) float64
        Electrons; charge outside is lost.
    start, end : (N, 2) float64
        Ends (x, y), pixels; pixel (0, 0) extends from −0.5 to 0.5.
    charge : (N,) float64
        Electrons along each whole track.
    """
    rows, columns = image.shape
    for k in range(charge.size):
        x, y = start[k, 0] + 0.5, start[k, 1] + 0.5
        dx, dy = end[k, 0] - start[k, 0], end[k, 1] - start[k, 1]
        column, row = math.floor(x), math.floor(y)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        # t runs from 0 to 1 along the track. next_x and next_y are the t of the next grid line in each direction,
        # each_x and each_y the intervals of t between grid lines; infinite for a track parallel to them.
        each_x = abs(1.0 / dx) if dx != 0.0 else math.inf
        each_y = abs(1.0 / dy) if dy != 0.0 else math.inf
        next_x = (column + 1 - x if dx > 0 else x - column) * each_x if dx != 0.0 else math.inf
        next_y = (row + 1 - y if dy > 0 else y - row) * each_y if dy != 0.0 else math.inf
        t = 0.0
        while t < 1.0:
            leave = min(next_x, next_y, 1.0)
            if 0 <= column < columns and 0 <= row < rows:
                image[row, column] += charge[k] * (leave - t)
            elif (
                (column < 0 and dx <= 0)
                or (column >= columns and dx >= 0)
                or (row < 0 and dy <= 0)
                or (row >= rows and dy >= 0)
            ):
                # The track is outside and leads away; one that starts outside may still enter the image.
                break
            t = leave
            if next_x < next_y:
                column += step_x
                next_x += each_x
            else:
                row += step_y
                next_y += each_y
