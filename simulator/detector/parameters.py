"""Parameters of a detector; the defaults are a detector without the effect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class CosmicRays:
    """Charged particles that cross the detector."""

    rate_cm2_s: float = 0.0
    """Particles through a square centimetre of the surface a second; 0: none. About 1 to 1.7 in a low orbit, up to
    1100 in the South Atlantic Anomaly."""
    depth_um: float = 10.0
    """Depth of the silicon from which charge is collected."""
    charge_e_um: float = 80.0
    """Most probable charge along a micrometre of track; 80 e⁻/µm: fast singly charged particles."""


@dataclass(frozen=True)
class Intensifier:
    """An image intensifier before the detector: photocathode, electron multiplier, phosphor screen."""

    gain: float = 0.0
    """Mean electrons in the detector's pixels for one photo-electron of the photocathode, whose quantum efficiency
    `detector.quantum_efficiency` then is; 0: no intensifier."""
    gain_variance: float = 1.0
    """Variance of the gain of one photo-electron over the square of its mean; 1: exponential, a microchannel plate."""
    phosphor_sigma_px: float = 0.0
    """Standard deviation of the Gaussian by which phosphor screen and coupling spread the light of one photo-electron,
    pixels."""
    dark_e_s: float = 0.0
    """Electrons a pixel that leave the photocathode in the dark, a second (equivalent background illumination)."""


@dataclass(frozen=True)
class Video:
    """Analogue video between the amplifier and the converter: a line, a recorder."""

    noise_dn: float = 0.0
    """Noise, standard deviation; 0: none."""
    line_blur_px: float = 0.0
    """Standard deviation of the Gaussian by which the bandwidth spreads signal and noise along the lines, pixels."""


@dataclass(frozen=True, kw_only=True)
class DetectorParameters:
    """A detector and its readout, without its exposure: the keys of a scenario's ``detector`` section of these names,
    and `pitch_um`, the pixel pitch along columns and along rows. What each means is said there
    (`simulator.scenario.schema_camera.DetectorSection`)."""

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
