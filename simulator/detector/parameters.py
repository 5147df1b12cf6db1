"""Plain parameters of a detector, as its physics takes them; defaults are a detector without the effect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class CosmicRays:
    """Flux of charged particles, depth of the sensitive silicon, most probable charge along a track."""

    rate_cm2_s: float = 0.0
    depth_um: float = 10.0
    charge_e_um: float = 80.0


@dataclass(frozen=True)
class Intensifier:
    """Image intensifier: mean gain (0: none), its relative variance, spread by the phosphor, electrons in the dark."""

    gain: float = 0.0
    gain_variance: float = 1.0
    phosphor_sigma_px: float = 0.0
    dark_e_s: float = 0.0


@dataclass(frozen=True)
class Video:
    """Analogue video: noise, and standard deviation of the blur along the lines."""

    noise_dn: float = 0.0
    line_blur_px: float = 0.0


@dataclass(frozen=True, kw_only=True)
class DetectorParameters:
    """A detector and its readout, without its exposure.

    Parameters
    ----------
    width, height : int
        Columns and rows.
    pitch_um : (float, float)
        Pixel pitch along columns and along rows.
    temperature_c : float
        Temperature of the detector.
    intensifier, cosmic_rays, video : Intensifier, CosmicRays, Video
        Each off by default.
    shot_noise : bool
        Poisson statistics of the light and of the dark current; off: their means.
    prnu, dsnu : float
        Standard deviation of the response and of the dark current over the pixels, relative to their means.
    dark_current_e_s, dark_reference_c, dark_doubling_c : float
        Mean dark current of a pixel at the reference temperature, and the rise that doubles it.
    hot_pixel_fraction, hot_pixel_dark_e_s, hot_columns, hot_column_dark_e_s : float, float, int, float
        Hot pixels and columns: how many, and their mean dark current at the reference temperature.
    dead_pixel_fraction, dead_columns : float, int
        Pixels and columns that collect neither light nor dark current.
    full_well_e, antiblooming : float
        Full well, and share of the charge above it that is drained; the rest spills along the column.
    cti_parallel, cti_serial, readout_corner : float, float, str
        Share of the charge left behind in each transfer, and where the output node is.
    read_noise_e, reset_capacitance_ff : float
        Read noise, and capacitance of an output node without correlated double sampling (0: with it).
    nonlinearity : (float, float)
        Relative departure from a straight line at the full well, of second and third order.
    gain_e_per_dn : float or ``auto``
        Electrons a DN; ``auto`` puts the full well at the top of the converter.
    offset_dn : float
        Digital offset.
    adc_bits : int or None
        Resolution of the converter; None: none.
    """

    width: int
    height: int
    pitch_um: tuple[float, float]
    temperature_c: float = 20.0
    intensifier: Intensifier = Intensifier()
    shot_noise: bool = True
    dark_current_e_s: float = 0.0
    dark_reference_c: float = 25.0
    dark_doubling_c: float = 8.0
    dsnu: float = 0.0
    prnu: float = 0.0
    hot_pixel_fraction: float = 0.0
    hot_pixel_dark_e_s: float = 0.0
    hot_columns: int = 0
    hot_column_dark_e_s: float = 0.0
    dead_pixel_fraction: float = 0.0
    dead_columns: int = 0
    cosmic_rays: CosmicRays = CosmicRays()
    full_well_e: float = 30000.0
    antiblooming: float = 1.0
    cti_parallel: float = 0.0
    cti_serial: float = 0.0
    readout_corner: str = "top_left"
    read_noise_e: float = 0.0
    reset_capacitance_ff: float = 0.0
    nonlinearity: tuple[float, float] = (0.0, 0.0)
    gain_e_per_dn: float | Literal["auto"] = "auto"
    offset_dn: float = 0.0
    video: Video = Video()
    adc_bits: int | None = 12
