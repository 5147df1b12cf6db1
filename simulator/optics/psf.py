"""Point-spread functions integrated over pixels, tabulated so that rendering does not evaluate the optics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcinv

from simulator.optics import airy, diffraction
from simulator.optics.lens import Lens
from simulator.optics.measured import measured_centroid
from simulator.optics.pixel_response import gaussian_shares
from simulator.optics.psf_model import ABERRATIONS, PsfModel
from simulator.optics.psf_table import STRIDES, TAPER_PX, coarsest, join, least_radius, offsets, polyphase
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.settings.registry import lookup

SIGMA_PER_RING = 1.34985 / 3.831705970207512
"""σ of the Gaussian that fits the core of an Airy pattern, over the radius of its first dark ring: the minimax fit of
Greyling 1995, § 4.1. His 1.34985 is in units of the argument of [2J₁(v)/v]², whose first dark ring is at v = 3.8317:
σ = 0.3523 r_ring = 0.4297 λN. (His § 4.3.3 uses it as a number of pixels, which is the ring at 3.83 px, not at 2.)"""

WING_LIMIT_E = 0.02
"""A star is rendered outwards until a pixel gets fewer electrons than this."""

FLUX_LOSS = 1e-6
"""A Gaussian star is rendered at least to the radius outside which this fraction of its light remains."""

MIN_LAMBDA_N_PX = 1.0 / 12.0
"""A sharper Airy pattern is rendered with this value, to limit the size of tables. Diffraction scatters 0.36 λN of the
light out of the pixel of a centred star, so that this pixel gets at most 3 % too little."""

WING_RADIUS_PX = 512.0
"""End of the tables of the wings; 2 λN/(π² 512 px) of an Airy pattern is outside: 0.04 % at λN = 1 px."""

_LEAST_SIGMAS = math.sqrt(2.0) * float(erfcinv(FLUX_LOSS / 2.0))
"""Both axes lose at most `FLUX_LOSS` together: erfc(h/σ√2) ≤ FLUX_LOSS/2 on each."""

LEAST_SHARE = 1.5e-4
"""A star from a table, of any brightness, is rendered until a pixel gets less than this fraction of the maximum of the
brightest pixel."""

MAX_HALF_PX = 64
"""Maximum half width of the stamp of a table."""

_WING_STEP_PX = 0.125

_PHASES_PER_SIGMA, _MOST_PHASES = 8, 128
"""Half the phases per standard deviation of a tabulated Gaussian, and their maximum."""

_INTERPOLATION = 2e-4
"""Error of the interpolation between the phases of an aberrated image, relative to its peak."""


@dataclass(frozen=True, eq=False)
class Psf:
    """Image of a point source, integrated over pixels; normalised to 1 over the whole plane."""

    model: str
    """Name of the model."""
    sigma_px: float
    sigma_y_px: float
    """Standard deviation along columns and rows of the Gaussian, or of the one that fits the core of another model."""
    feature_px: float
    """Size of the finest structure, pixels, which determines the sampling of smeared paths."""
    core: NDArray[np.float64] | NDArray[np.float32] | None = None
    """(P, P, M, M), or None for an exact Gaussian. Fraction of the light in pixel (row j, column i) of the stamp,
    [b, a, j, i], for a star a phases to the right of and b phases below the centre; see `phases`."""
    phases: int = 1
    """Phases per pixel. Phase index a is the offset (a − P // 2)/phases pixels, and P covers −½ to +½ with margins for
    the interpolation."""
    wing: FloatArray | None = None
    """(W,): Fraction of the light in a pixel by its distance from the star, outside the stamp, in steps of
    `wing_step_px` (pixels along columns)."""
    drawn: FloatArray | None = None
    """(W,): Fraction of the light of a star rendered with wings to a radius, in steps of `wing_step_px`
    (`simulator.optics.psf_table.join`); NaN if it depends on the sub-pixel position."""
    wing_step_px: float = _WING_STEP_PX
    """Step of these tables."""
    aspect: float = 1.0
    """Pitch along columns over pitch along rows."""
    geometric_px: tuple[float, float] = (0.0, 0.0)
    """Position of the geometric centroid of an aberrated image relative to the star's, which is its measured centroid
    (`simulator.optics.measured.measured_centroid`), pixels along columns and rows."""

    __repr__ = fields_repr

    def __post_init__(self) -> None:
        for table in (self.core, self.wing, self.drawn):
            if table is not None:
                table.flags.writeable = False

    @property
    def core_half_px(self) -> int:
        """Pixels from the centre of the stamp of a table to its edge; 0 for a Gaussian, which has no table."""
        return 0 if self.core is None else self.core.shape[3] // 2

    def radius_px(self, electrons: ArrayLike) -> FloatArray:
        """Radius to which stars are rendered, pixels along columns: every pixel whose centre (for a Gaussian, edge) is
        inside.

        Until a pixel gets fewer than `WING_LIMIT_E` electrons; a Gaussian at least until `FLUX_LOSS` remains, a table
        at least until `LEAST_SHARE` and at most to `WING_RADIUS_PX`. For faint stars only the square stamp of the table
        is rendered (the radius is then that of the stamp); the wings of others end in a taper of width `TAPER_PX`
        outside this radius.

        Parameters
        ----------
        electrons : (N,) array
            Electrons of the stars.
        """
        e = np.asarray(electrons, dtype=float)
        if self.core is None or self.wing is None:
            limit_e = 2.0 * math.pi * self.sigma_px * self.sigma_y_px * WING_LIMIT_E
            return np.asarray(_gaussian_radius_px(e, limit_e, self.sigma_px))
        e = np.maximum(e, 1e-9)  # a star without electrons gets the smallest radius
        wanted = _reach(self._envelope, np.minimum(WING_LIMIT_E / e, LEAST_SHARE * self.peak), self.wing_step_px)
        half = self.core_half_px
        winged = np.clip(wanted, least_radius(half, self.aspect), WING_RADIUS_PX - TAPER_PX - 1.0)
        return np.where(wanted <= (half + 1) * min(1.0, 1.0 / self.aspect), half * min(1.0, 1.0 / self.aspect), winged)

    @cached_property
    def _envelope(self) -> FloatArray:
        """`_monotone` of the wings."""
        assert self.wing is not None
        return _monotone(self.wing)

    @cached_property
    def peak(self) -> float:
        """Fraction of the light in the central pixel of a centred star."""
        if self.core is None:
            scale = math.sqrt(8.0)
            return math.erf(1.0 / (scale * self.sigma_px)) * math.erf(1.0 / (scale * self.sigma_y_px))
        middle = self.core.shape[0] // 2
        return float(self.core[middle, middle].max())


def _gaussian_radius_px(electrons: FloatArray, limit_e: float, sigma_px: float) -> FloatArray:
    """Radius at which Gaussians with a peak of electrons / `limit_e` fall to the limit, with a minimum."""
    return sigma_px * np.maximum(_LEAST_SIGMAS, np.sqrt(2.0 * np.log(np.maximum(electrons / limit_e, 1.0))))


def _monotone(wing: FloatArray) -> FloatArray:
    """Monotone envelope of the rings of wings (W,), from outside to inside."""
    return np.maximum.accumulate(wing[::-1])


def _reach(envelope: FloatArray, share: ArrayLike, step_px: float) -> FloatArray:
    """Distance beyond which wings with a `_monotone` envelope stay below a fraction of the light per pixel."""
    return np.asarray((len(envelope) - np.searchsorted(envelope, share, side="left")) * step_px)


def build_psf(
    psf_model: PsfModel,
    f_number: float,
    pitch_um: tuple[float, float],
    obscuration: float = 0.0,
    diffusion_um: float = 0.0,
) -> Psf:
    """Point-spread function at the centre of the field, at `wavelength_nm`.

    `simulator.optics.psf_set.build_psf_set` includes colours and the rest of the field.

    Parameters
    ----------
    psf_model : PsfModel
        Model and width.
    f_number : float
        Focal length over aperture.
    pitch_um : (float, float)
        Pixel pitch along columns and rows, µm.
    obscuration : float
        Diameter of the central obscuration, as a fraction of the aperture's.
    diffusion_um : float
        Standard deviation of the spreading of charge, µm.

    Raises
    ------
    InputError
        For an unknown model, or keys that contradict each other.
    """
    return psf_of(psf_model, Lens(f_number, pitch_um, obscuration, diffusion_um))


def psf_of(psf_model: PsfModel, lens: Lens) -> Psf:
    """`build_psf` of a lens with its detector."""
    return lookup("psfs", PSFS, psf_model.model)(psf_model, lens)


def gaussian(psf_model: PsfModel, lens: Lens) -> Psf:
    """Gaussian integrated exactly over pixels (products of differences of the error function).

    σ is `sigma_px`, or fits the core of an Airy pattern with the first dark ring `first_dark_ring_px` or, by default,
    that of a clear aperture: σ = 0.3523 r_ring (`SIGMA_PER_RING`); charge diffusion is added in quadrature. The image
    is round on the detector: if pixels are not square, σ along rows is σ × pitch_x / pitch_y pixels. With a response
    across the pixels (`Lens.contrast`) the image is a table.
    """
    if psf_model.sigma_px is not None and psf_model.first_dark_ring_px is not None:
        raise InputError("a PSF takes sigma_px or first_dark_ring_px, not both")
    _no_aberrations(psf_model)
    sigma = psf_model.sigma_px or SIGMA_PER_RING * first_dark_ring_px(psf_model, lens)
    if lens.diffusion_um > 0.0:
        sigma = math.hypot(sigma, lens.diffusion_px)
    aspect = lens.aspect
    if lens.contrast != 0.0:
        return _tabulated_gaussian(sigma, aspect, lens.contrast)
    return Psf("gaussian", sigma, sigma * aspect, min(sigma, sigma * aspect), aspect=aspect)


def _tabulated_gaussian(sigma: float, aspect: float, contrast: float) -> Psf:
    """A Gaussian on pixels with a response, as a table: exact at its phases, 1e-6 of the peak between them."""
    finest, widest = sigma * min(1.0, aspect), sigma * max(1.0, aspect)
    half = min(math.ceil(_LEAST_SIGMAS * widest) + 1, MAX_HALF_PX)
    phases = min(2 * math.ceil(_PHASES_PER_SIGMA / finest), _MOST_PHASES)  # even, so that ±½ px are phases
    at = offsets(half, phases) / phases
    fine = np.outer(gaussian_shares(at, sigma * aspect, contrast), gaussian_shares(at, sigma, contrast))
    r = np.arange(0.0, WING_RADIUS_PX, _WING_STEP_PX)
    wing = np.exp(-0.5 * (r / sigma) ** 2) / (2.0 * math.pi * sigma**2 * aspect)
    core = polyphase(fine, half, phases)
    wing, drawn = join(core, phases, wing, _WING_STEP_PX, aspect, even=False)
    return Psf("gaussian", sigma, sigma * aspect, finest, core, phases, wing, drawn, aspect=aspect)


def airy_disk(psf_model: PsfModel, lens: Lens) -> Psf:
    """Airy pattern of a circular aperture, I(r) = π/(4λ²N²(1−ε²)) [2J₁(v)/v − ε² 2J₁(εv)/(εv)]², v = πr/(λN),
    integrated over pixels (Born & Wolf, § 8.6.2); ε is the central obscuration.

    The first dark ring is at 1.21967 λN for a clear aperture (`airy.first_ring`), or at `first_dark_ring_px`: defocus
    as a scaled pattern (Greyling 1995, § 4.1). Near the star the table is exact at `phases` offsets per pixel and
    interpolated between them (error below 5e-5 of the peak); further out it is the mean over a ring of one pixel width
    (`airy.annulus_share`). λN below `MIN_LAMBDA_N_PX` is replaced by this value.
    """
    if psf_model.sigma_px is not None:
        raise InputError("an Airy PSF takes first_dark_ring_px, not sigma_px; or set model: gaussian")
    _no_aberrations(psf_model)
    ring, aspect, hole = first_dark_ring_px(psf_model, lens), lens.aspect, lens.obscuration
    lambda_n = max(ring / airy.first_ring(hole), least_lambda_n_px(aspect))
    finest, widest = lambda_n * min(1.0, aspect), lambda_n * max(1.0, aspect)
    phases = 2 * max(2, math.ceil(6.0 / finest))  # twelve per period of the highest spatial frequency of the optics
    wing = airy.annulus_share(np.arange(0.0, WING_RADIUS_PX, _WING_STEP_PX), lambda_n, aspect, hole)
    blur = lens.diffusion_px, lens.contrast
    peak = airy.pixel_integrals(np.zeros(1), np.zeros(1), lambda_n, aspect, hole, *blur)[0, 0]
    half = stamp_half_px(math.ceil(4.0 * widest) + 3, wing, float(peak), aspect)
    offset = offsets(half, phases)
    positive = offset[offset >= 0] / phases
    quarter = airy.pixel_integrals(positive, positive, lambda_n, aspect, hole, *blur)
    core = polyphase(quarter[np.abs(offset)[:, None], np.abs(offset)], half, phases)
    wing, drawn = join(core, phases, wing, _WING_STEP_PX, aspect, even=lens.contrast == 0.0)
    sigma = math.hypot(SIGMA_PER_RING * ring, lens.diffusion_px)
    return Psf("airy", sigma, sigma * aspect, finest / 2.0, core, phases, wing, drawn, aspect=aspect)


def diffracted(psf_model: PsfModel, lens: Lens) -> Psf:
    """Diffraction image of a lens with aberrations at the centre of the field, at one wavelength; see
    `simulator.optics.pupil`."""
    coefficients = diffraction.axial_coefficients(psf_model, lens.f_number)
    return aberrated(psf_model, lens, coefficients, np.array([psf_model.wavelength_nm]), np.ones((1, 1)))[0]


def aberrated(
    psf_model: PsfModel, lens: Lens, coefficients: FloatArray, wavelengths_nm: FloatArray, weights: FloatArray
) -> list[Psf]:
    """PSFs of one wavefront for several spectra.

    The position of a star is the measured centroid of its image, for the mean of the spectra: a camera is calibrated
    with measured centroids, so that their shift by coma is part of its distortion. All spectra have the same geometric
    centroid, so that the measured centroid depends on the colour of a star.

    The core is exact at the phases of the table (1e-6 of the peak) and interpolated between them (2e-4 of the peak); it
    is stored in single precision. The wings are those of the aperture without aberrations, scaled by 1 + α/r² to
    conserve the light.

    Parameters
    ----------
    psf_model : PsfModel
        Model.
    lens : Lens
        Lens and detector.
    coefficients : (T,) array
        Zernike coefficients (Noll 1 … T), waves rms at `psf_model.wavelength_nm`: the same path at all wavelengths.
    wavelengths_nm : (K,) array
        Wavelengths.
    weights : (C, K) array
        Fraction of the electrons at each wavelength, for each spectrum; rows sum to 1.
    """
    if psf_model.sigma_px is not None or psf_model.first_dark_ring_px is not None:
        raise InputError(
            "a PSF of model diffraction, or a polychromatic one, has the width of its optics: leave sigma_px and "
            "first_dark_ring_px out; use defocus_um or zernike_waves for defocus"
        )
    aspect, hole = lens.aspect, lens.obscuration
    true_px = wavelengths_nm * 1e-3 * lens.f_number / lens.pitch_um[0]
    lambda_n = np.maximum(true_px, least_lambda_n_px(aspect))
    # The optical path is the same at all wavelengths. If λN is increased to its minimum, the waves are reduced, so that
    # the geometric image keeps its size.
    waves = np.outer(psf_model.wavelength_nm / wavelengths_nm * true_px / lambda_n, coefficients)
    finest, widest = float(lambda_n.min()) * min(1.0, aspect), float(lambda_n.max()) * max(1.0, aspect)
    spread = (diffraction.spread_px(waves, lambda_n, hole) + 3.0 * lens.diffusion_px) * max(1.0, aspect)
    margin = 4.0 * widest + 3.0
    if spread + margin > MAX_HALF_PX:
        raise InputError(
            f"the aberrations spread a star over {spread:.0f} pixels to each side; at most "
            f"{MAX_HALF_PX - margin:.0f} can be rendered: lower zernike_waves, defocus_um or field"
        )
    r = np.arange(0.0, WING_RADIUS_PX, _WING_STEP_PX)
    wings = weights @ np.array([airy.annulus_share(r, scale, aspect, hole) for scale in lambda_n])
    totals = weights @ np.array([float(airy.encircled_energy(r[-1] / scale, hole)) for scale in lambda_n])
    at_half_px = partial(diffraction.Images, waves, lambda_n, hole, aspect, lens.diffusion_px, lens.contrast)
    images, centre, half = _sized(at_half_px, spread + margin, weights, wings, aspect)
    phases = 12 * max(1, math.ceil(1.0 / finest))
    matrices = images.matrices(offsets(half, phases, max(STRIDES)) / phases, centre)
    psfs = []
    for spectrum, wing, total in zip(weights, wings, totals, strict=True):
        core, coarse = _coarse_core(images.shares(spectrum, *matrices), half, phases)
        joined, drawn = join(core, coarse, wing, _WING_STEP_PX, aspect, float(total), lens.contrast == 0.0)
        scale = float(spectrum @ lambda_n)
        sigma = math.hypot(SIGMA_PER_RING * airy.FIRST_RING * scale, lens.diffusion_px)
        feature = scale * min(1.0, aspect) / 2.0
        single = core.astype(np.float32)
        made = Psf("diffraction", sigma, sigma * aspect, feature, single, coarse, joined, drawn, aspect=aspect)
        psfs.append(replace(made, geometric_px=(-centre[0], -centre[1])))
    return psfs


def _sized(
    at_half_px: Callable[[int], diffraction.Images],
    extent_px: float,
    weights: FloatArray,
    wings: FloatArray,
    aspect: float,
) -> tuple[diffraction.Images, tuple[float, float], int]:
    """Images, their measured centroid, and half the side of the stamp about it, pixels.

    The second iteration uses the size that peak and centroid of the first one require.
    """
    half, room = math.ceil(extent_px), 1
    for _ in range(2):
        images = at_half_px(half + room)
        centre = measured_centroid(images, weights.mean(axis=0), half)
        away = max(abs(centre[0]), abs(centre[1]))
        coarse = images.matrices(np.arange(-half, half + 1.0))
        peaks = [float(images.shares(spectrum, *coarse).max()) for spectrum in weights]
        least = min(math.ceil(extent_px + away), MAX_HALF_PX)
        wanted = max(stamp_half_px(least, wing, peak, aspect) for wing, peak in zip(wings, peaks, strict=True))
        if wanted == half and away <= room:
            break
        half, room = wanted, math.ceil(away) + 1
    return images, centre, half


def _coarse_core(fine: FloatArray, half: int, phases: int) -> tuple[FloatArray, int]:
    """Core table from pixel integrals at `offsets` with the largest stride, and its number of phases: the fewest that
    the interpolation allows."""
    stride = coarsest(fine, phases, _INTERPOLATION)
    cut = (len(fine) - len(offsets(half, phases, stride))) // 2
    return polyphase(fine[cut : len(fine) - cut, cut : len(fine) - cut], half, phases, stride), phases // stride


def first_dark_ring_px(psf_model: PsfModel, lens: Lens) -> float:
    """Radius of the first dark ring in pixels along columns: the given one, or that of diffraction (1.21967 λN for a
    clear aperture)."""
    if psf_model.first_dark_ring_px is not None:
        return psf_model.first_dark_ring_px
    hole = lens.obscuration if psf_model.model != "gaussian" else 0.0
    return airy.first_ring(hole) * psf_model.wavelength_nm * 1e-3 * lens.f_number / lens.pitch_um[0]


def least_lambda_n_px(aspect: float) -> float:
    """Minimum λN (pixels along columns) of tables."""
    return max(MIN_LAMBDA_N_PX, MIN_LAMBDA_N_PX / aspect)


def stamp_half_px(least: int, wing: FloatArray, peak: float, aspect: float) -> int:
    """Half width of a stamp for the faintest stars without wings, at most `MAX_HALF_PX`."""
    reach = float(_reach(_monotone(wing), LEAST_SHARE * peak, _WING_STEP_PX)) * max(1.0, aspect)
    return min(max(4, least, math.ceil(reach) - 1), MAX_HALF_PX)


def _no_aberrations(psf_model: PsfModel) -> None:
    nothing = PsfModel()
    for key in ABERRATIONS:
        if getattr(psf_model, key) != getattr(nothing, key):
            raise InputError(f"a PSF of model {psf_model.model} takes no {key}; set model: diffraction")


PSFS: dict[str, Callable[[PsfModel, Lens], Psf]] = {
    "gaussian": gaussian,
    "airy": airy_disk,
    "diffraction": diffracted,
}
"""Models by name: (psf_model, lens) → Psf."""
