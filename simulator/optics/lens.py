"""Parameters of lens and detector that determine the image of a star."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lens:
    """Parameters of lens and detector that determine a star image, in addition to the PSF model."""

    f_number: float
    """Focal length over aperture."""
    pitch_um: tuple[float, float]
    """Pixel pitch along columns and rows, µm."""
    obscuration: float = 0.0
    """Diameter of the central obscuration over that of the aperture."""
    diffusion_um: float = 0.0
    """Standard deviation of the spreading of charge, µm."""
    contrast: float = 0.0
    """Contrast of the response across a pixel (`simulator.optics.pixel_response`)."""

    @property
    def aspect(self) -> float:
        """Pitch along columns over pitch along rows."""
        return self.pitch_um[0] / self.pitch_um[1]

    @property
    def diffusion_px(self) -> float:
        """Standard deviation of the spreading of charge, pixels along columns."""
        return self.diffusion_um / self.pitch_um[0]
