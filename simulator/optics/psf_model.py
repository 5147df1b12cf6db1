"""Plain parameters of a star's image: model, width, aberrations over the whole field and towards its corners."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Zernike:
    """Zernike coefficients (Noll 1976), waves rms at `PsfModel.wavelength_nm`."""

    defocus: float = 0.0
    astigmatism_oblique: float = 0.0
    astigmatism: float = 0.0
    coma_y: float = 0.0
    coma_x: float = 0.0
    trefoil_y: float = 0.0
    trefoil_x: float = 0.0
    spherical: float = 0.0


@dataclass(frozen=True)
class FieldAberrations:
    """Aberrations that grow with the distance from the centre: values at the corners, and zones of the field."""

    coma_waves: float = 0.0
    astigmatism_waves: float = 0.0
    curvature_waves: float = 0.0
    rings: int = 4
    azimuths: int = 12


@dataclass(frozen=True)
class PsfModel:
    """Shape of a star's image before smear.

    Parameters
    ----------
    model : str
        Key of `simulator.optics.psf.PSFS`.
    sigma_px, first_dark_ring_px : float or None
        Width as chosen; without either that of the diffraction at `wavelength_nm`.
    wavelength_nm : float
        Effective wavelength.
    polychromatic : bool
        Sum the images of all wavelengths by the spectrum of each star.
    zernike_waves, defocus_um, field : Zernike, float, FieldAberrations
        Aberrations of model ``diffraction``.
    """

    model: str = "gaussian"
    sigma_px: float | None = None
    first_dark_ring_px: float | None = None
    wavelength_nm: float = 600.0
    polychromatic: bool = False
    zernike_waves: Zernike = Zernike()
    defocus_um: float = 0.0
    field: FieldAberrations = FieldAberrations()
