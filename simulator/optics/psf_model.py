"""Parameters of the PSF: model, width, constant and field-dependent aberrations."""

from __future__ import annotations

from dataclasses import dataclass

from startracker.display import changed_fields


@dataclass(frozen=True)
class Zernike:
    """Constant aberrations: Zernike coefficients (Noll 1976), waves rms at `PsfModel.wavelength_nm`."""

    defocus: float = 0.0
    """Z4; the peak-to-valley value is 3.46 times this."""
    astigmatism_oblique: float = 0.0
    """Z5, with the sine of twice the angle from columns to rows."""
    astigmatism: float = 0.0
    """Z6, with the cosine."""
    coma_y: float = 0.0
    """Z7: a tail along rows."""
    coma_x: float = 0.0
    """Z8: a tail along columns."""
    trefoil_y: float = 0.0
    """Z9, with the sine of three times the angle."""
    trefoil_x: float = 0.0
    """Z10, with the cosine."""
    spherical: float = 0.0
    """Z11."""


@dataclass(frozen=True)
class FieldAberrations:
    """Field-dependent aberrations: values at the image corners, h = 1 (h: distance from the image centre)."""

    coma_waves: float = 0.0
    """Radial coma, proportional to h; waves rms."""
    astigmatism_waves: float = 0.0
    """Radial astigmatism, proportional to h²; waves rms."""
    curvature_waves: float = 0.0
    """Defocus by field curvature, proportional to h²; waves rms."""
    rings: int = 4
    """Number of radial zones, in addition to the central one."""
    azimuths: int = 12
    """Number of azimuthal zones."""


@dataclass(frozen=True)
class PsfModel:
    """Shape of a star image without smear."""

    model: str = "gaussian"
    """``gaussian``, ``airy``, or ``diffraction`` for a lens with aberrations."""
    sigma_px: float | None = None
    """Standard deviation of the Gaussian, pixels along columns."""
    first_dark_ring_px: float | None = None
    """Radius of the first dark ring, pixels: defocus as a scaled pattern (Greyling 1995: 2.0). If omitted, an Airy
    image is diffraction-limited at `wavelength_nm`, and a Gaussian without `sigma_px` has the width that fits it."""
    wavelength_nm: float = 600.0
    """Effective wavelength of the diffraction."""
    polychromatic: bool = False
    """Airy and diffraction: sum the images of all wavelengths, weighted by the spectrum of each star."""
    zernike_waves: Zernike = Zernike()
    """Diffraction: constant aberrations."""
    defocus_um: float = 0.0
    """Diffraction: distance of the detector from the focus, in addition to `zernike_waves.defocus`."""
    field: FieldAberrations = FieldAberrations()
    """Diffraction: field-dependent aberrations."""

    __repr__ = changed_fields


ABERRATIONS = ("zernike_waves", "defocus_um", "field")
"""Keys of `PsfModel` that only diffraction images use."""
