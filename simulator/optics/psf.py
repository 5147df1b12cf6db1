"""Point-spread functions integrated over pixels, laid down in tables: drawing a star evaluates no optics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcinv

from simulator.optics import airy
from simulator.scenario.schema import PsfSection
from startracker.errors import InputError
from startracker.registry import lookup

FloatArray = NDArray[np.float64]

SIGMA_PER_RING = 1.34985 / 3.831705970207512
"""σ of the Gaussian that fits the core of an Airy pattern, over the radius of its first dark ring: the minimax fit of
Greyling 1995, § 4.1. His 1.34985 is in units of the argument of [2J₁(v)/v]², whose first dark ring lies at v =
3.8317: σ = 0.3523 r_ring = 0.4297 λN. (Taken as pixels, as the thesis goes on to do, it belongs to a ring at 3.83 px,
not 2.)"""

WING_LIMIT_E = 0.02
"""A star is drawn outwards until a pixel gets fewer electrons than this."""

FLUX_LOSS = 1e-6
"""A Gaussian star is drawn at least so far out that no more than this share of it is left out."""

MIN_LAMBDA_N_PX = 1.0 / 12.0
"""An Airy pattern sharper than this is drawn at it, so that the tables stay small. Diffraction throws 0.36 λN of the
light out of the pixel of a centred star, so that such a pixel gets 3 % too little at the most."""

WING_RADIUS_PX = 512.0
"""Where the tables of the wings end; 2 λN/(π² 512 px) of an Airy pattern lies outside: 0.04 % at λN = 1 px."""

LEAST_SHARE = 1.5e-4
"""A star from a table, however faint, is drawn until a pixel gets less than this share of what the brightest can
get."""

TAPS = 4
"""Points of the Lagrange interpolation between phases; the kernel in `simulator.optics.splat` is written out for
four."""

_WING_STEP_PX = 0.125


@dataclass(frozen=True, eq=False)
class Psf:
    """Image of a point source, integrated over pixels; normalised to 1 over the whole plane.

    Parameters
    ----------
    model : str
        Its name.
    sigma_px, sigma_y_px : float
        Standard deviation along columns and rows of the Gaussian, or of the one that fits the core of another model.
    feature_px : float
        Finest structure that matters to how densely a smeared path must be sampled, pixels.
    core : (P, P, M, M) array or None
        None: an exact Gaussian. Otherwise share of the light in pixel (row j, column i) of the stamp, [b, a, j, i],
        for a star a phases right of and b phases below the centre; see `phases`.
    phases : int
        Phases a pixel. Phase index a stands for the offset (a − P // 2)/phases pixels, and P covers −½ to +½ with
        margins for the interpolation.
    wing : (W,) array
        Share of the light in a pixel by its distance from the star, outside the stamp, `wing_step_px` apart (pixels
        along columns).
    wing_step_px : float
        Step of that table.
    aspect : float
        Pitch along columns over pitch along rows.
    """

    model: str
    sigma_px: float
    sigma_y_px: float
    feature_px: float
    core: NDArray[np.float64] | None = None
    phases: int = 1
    wing: FloatArray | None = None
    wing_step_px: float = _WING_STEP_PX
    aspect: float = 1.0

    def __post_init__(self) -> None:
        for table in (self.core, self.wing):
            if table is not None:
                table.flags.writeable = False

    @property
    def core_half_px(self) -> int:
        """Pixels from the middle of the stamp of a table to its edge; 0 for a Gaussian, which has no table."""
        return 0 if self.core is None else self.core.shape[3] // 2

    def radius_px(self, electrons: ArrayLike) -> FloatArray:
        """How far out stars are drawn, pixels along columns; every pixel whose centre or, for a Gaussian, edge lies
        within.

        Until a pixel gets fewer than `WING_LIMIT_E` electrons; a Gaussian at least until `FLUX_LOSS` of it is left out,
        a table at least until `LEAST_SHARE` and at most to `WING_RADIUS_PX`.

        Parameters
        ----------
        electrons : (N,) array
            Electrons of the stars.
        """
        e = np.maximum(np.asarray(electrons, dtype=float), 1e-9)
        if self.core is None or self.wing is None:
            # both axes lose at most FLUX_LOSS together: erfc(h/σ√2) ≤ FLUX_LOSS/2 on each
            least = math.sqrt(2.0) * float(erfcinv(FLUX_LOSS / 2.0))
            peak = e / (2.0 * math.pi * self.sigma_px * self.sigma_y_px)
            faint = np.sqrt(2.0 * np.log(np.maximum(peak / WING_LIMIT_E, 1.0)))
            return np.asarray(self.sigma_px * np.maximum(least, faint))
        envelope = np.maximum.accumulate(self.wing[::-1])  # falling outwards, whatever the rings do
        middle = self.core.shape[0] // 2
        peak = self.core[middle, middle, self.core_half_px, self.core_half_px]
        beyond = np.searchsorted(envelope, np.minimum(WING_LIMIT_E / e, LEAST_SHARE * peak), side="left")
        return np.asarray((len(self.wing) - beyond) * self.wing_step_px)


def build_psf(section: PsfSection, f_number: float, pitch_um: tuple[float, float]) -> Psf:
    """Point-spread function of a scenario.

    Parameters
    ----------
    section : PsfSection
        Model and width.
    f_number : float
        Focal length over aperture.
    pitch_um : (float, float)
        Pixel pitch along columns and rows, µm.

    Raises
    ------
    InputError
        For an unknown model, or widths that contradict each other.
    """
    return lookup("psfs", PSFS, section.model)(section, f_number, pitch_um)


def gaussian(section: PsfSection, f_number: float, pitch_um: tuple[float, float]) -> Psf:
    """Gaussian integrated exactly over pixels (products of differences of the error function).

    σ is `sigma_px`, or fits the core of an Airy pattern with the first dark ring of `first_dark_ring_px`, or else of
    the diffraction: σ = 0.3523 r_ring (`SIGMA_PER_RING`). It is round on the detector: with pixels that are not
    square σ along rows is σ × pitch_x / pitch_y pixels.
    """
    if section.sigma_px is not None and section.first_dark_ring_px is not None:
        raise InputError("a PSF takes sigma_px or first_dark_ring_px, not both")
    sigma = section.sigma_px or SIGMA_PER_RING * first_dark_ring_px(section, f_number, pitch_um)
    aspect = pitch_um[0] / pitch_um[1]
    return Psf("gaussian", sigma, sigma * aspect, min(sigma, sigma * aspect), aspect=aspect)


def airy_disk(section: PsfSection, f_number: float, pitch_um: tuple[float, float]) -> Psf:
    """Airy pattern of a clear circular aperture, I(r) = π/(4λ²N²) [2J₁(v)/v]², v = πr/(λN), integrated over pixels.

    The first dark ring lies at 1.21967 λN, or where `first_dark_ring_px` puts it: defocus as the thesis models it, a
    pattern scaled up (Greyling 1995, § 4.1). Near the star the table is exact at `phases` offsets a pixel and
    interpolated between them (error below 5e-5 of the peak); further out the mean over a ring as wide as a pixel
    stands in (`airy.annulus_share`). λN below `MIN_LAMBDA_N_PX` is drawn at that.
    """
    if section.sigma_px is not None:
        raise InputError("an Airy PSF takes first_dark_ring_px, not sigma_px; or set model: gaussian")
    ring = first_dark_ring_px(section, f_number, pitch_um)
    aspect = pitch_um[0] / pitch_um[1]
    lambda_n = max(ring / airy.FIRST_RING, MIN_LAMBDA_N_PX, MIN_LAMBDA_N_PX / aspect)
    finest, widest = lambda_n * min(1.0, aspect), lambda_n * max(1.0, aspect)
    phases = 2 * max(2, math.ceil(6.0 / finest))  # twelve a period of the highest frequency the optics pass
    half = min(max(4, math.ceil(4.0 * widest) + 3), 64)
    core = _polyphase(half, phases, lambda_n, aspect)
    wing = airy.annulus_share(np.arange(0.0, WING_RADIUS_PX, _WING_STEP_PX), lambda_n, aspect)
    sigma = SIGMA_PER_RING * ring
    return Psf("airy", sigma, sigma * aspect, finest / 2.0, core, phases, wing, aspect=aspect)


def first_dark_ring_px(section: PsfSection, f_number: float, pitch_um: tuple[float, float]) -> float:
    """Radius of the first dark ring in pixels along columns: the chosen one, or 1.21967 λN of the diffraction."""
    if section.first_dark_ring_px is not None:
        return section.first_dark_ring_px
    return airy.FIRST_RING * section.wavelength_nm * 1e-3 * f_number / pitch_um[0]


def _polyphase(half: int, phases: int, lambda_n: float, aspect: float) -> FloatArray:
    """The core table [b, a, j, i] from pixel integrals on one fine grid."""
    margin = phases // 2 + TAPS // 2
    offsets = np.arange(-half * phases - margin, half * phases + margin + 1)
    quarter = airy.pixel_integrals(
        np.arange(offsets[-1] + 1) / phases, np.arange(offsets[-1] + 1) / phases, lambda_n, aspect
    )
    fine = np.abs(offsets)
    # a star a phases to the right leaves pixel i at i·phases − a from it
    index = np.arange(-half, half + 1)[None, :] * phases - np.arange(-margin, margin + 1)[:, None]
    where = fine[index + half * phases + margin]
    return np.ascontiguousarray(quarter[where[:, None, :, None], where[None, :, None, :]])


PSFS: dict[str, Callable[[PsfSection, float, tuple[float, float]], Psf]] = {"gaussian": gaussian, "airy": airy_disk}
"""Models by name: (section, f-number, (pitch_x, pitch_y) in µm) → Psf."""
