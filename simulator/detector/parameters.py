"""Parameters of a detector; by default effects are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class CosmicRays:
    """Charged particles that cross the detector."""

    rate_cm2_s: float = 0.0
    """Particles per square centimetre of the surface and second; 0: none. About 1 to 1.7 in a low orbit, up to 1100 in
    the South Atlantic Anomaly."""
    depth_um: float = 10.0
    """Depth of the silicon from which charge is collected."""
    charge_e_um: float = 80.0
    """Most probable charge per micrometre of track; 80 e⁻/µm for fast singly charged particles."""


@dataclass(frozen=True)
class DisplacementDamage:
    """Dark current of displacement damage: interactions of particles with atoms of the depleted silicon, randomly
    distributed over the pixels."""

    interactions_per_pixel: float = 0.0
    """Mean number of interactions in a pixel; 0: none."""
    dark_e_s: float = 0.0
    """Mean dark current of one interaction at `detector.dark_reference_c`, exponentially distributed."""

    @property
    def mean_e_s(self) -> float:
        """Mean dark current of a pixel by displacement damage."""
        return self.interactions_per_pixel * self.dark_e_s


@dataclass(frozen=True)
class RandomTelegraph:
    """Random telegraph pixels, whose dark current switches between two levels at random times."""

    pixel_fraction: float = 0.0
    """Fraction of the pixels; 0: none."""
    dark_e_s: float = 0.0
    """Mean difference between the levels at `detector.dark_reference_c`, exponentially distributed over the pixels."""
    low_s: float = 194.0
    """Mean time in the lower level."""
    high_s: float = 97.0
    """Mean time in the upper level."""

    @property
    def high_share(self) -> float:
        """Fraction of the time in the upper level."""
        return self.high_s / (self.low_s + self.high_s)


@dataclass(frozen=True)
class Intensifier:
    """An image intensifier before the detector: photocathode, electron multiplier, phosphor screen."""

    gain: float = 0.0
    """Mean electrons in the detector per photo-electron of the photocathode, to which `detector.quantum_efficiency`
    then refers; 0: no intensifier."""
    gain_variance: float = 1.0
    """Relative variance of the gain of one photo-electron; 1: exponential, as for a microchannel plate."""
    phosphor_sigma_px: float = 0.0
    """Standard deviation of the Gaussian blur by phosphor screen and coupling, pixels."""
    dark_e_s: float = 0.0
    """Dark emission of the photocathode, electrons per pixel and second (equivalent background illumination)."""


@dataclass(frozen=True)
class Video:
    """Analogue video link or recorder between amplifier and converter."""

    noise_dn: float = 0.0
    """Standard deviation of the noise; 0: none."""
    line_blur_px: float = 0.0
    """Standard deviation of the Gaussian blur of signal and noise along the lines by the bandwidth, pixels."""


@dataclass(frozen=True)
class TimeTag:
    """Error of the time that the camera states for mid-exposure: stated minus true."""

    offset_s: float = 0.0
    """Constant error."""
    jitter_s: float = 0.0
    """Standard deviation of a Gaussian error of each frame."""


@dataclass(frozen=True, kw_only=True)
class DetectorParameters:
    """A detector and its readout, without the exposure: keys of a scenario's ``detector`` section with these names, and
    `pitch_um`, the pixel pitch along columns and rows. They are documented in
    `simulator.scenario.schema_camera.DetectorSection`."""

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
    displacement: DisplacementDamage = DisplacementDamage()
    telegraph: RandomTelegraph = RandomTelegraph()
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
