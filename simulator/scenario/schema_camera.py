"""The camera's sections of a scenario: lens and detector."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from simulator.detector.parameters import CosmicRays, DisplacementDamage, Intensifier, RandomTelegraph, TimeTag, Video
from simulator.optics.displacement import CalibrationResidual, LateralColour
from simulator.optics.ghosts import Ghost
from simulator.optics.illumination import Vignetting
from simulator.optics.pixel_response import IntraPixel
from simulator.optics.psf_model import PsfModel
from simulator.scenario.schema_base import Fraction, NonNegative, Positive, Section
from startracker.geometry.distortion import Distortion


class ThermalSection(Section):
    """Change of the lens since calibration, by temperature."""

    expansion_ppm_k: FiniteFloat = 0.0
    """Relative change of the focal length; 0: none."""
    decentring_um_k: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Motion of the lens relative to the detector along columns and rows, which displaces the whole image; [0, 0]:
    none."""
    reference_c: FiniteFloat = 20.0
    """Temperature for which `focal_length_mm` is given and at which the tracker's camera was calibrated."""
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] = 20.0
    """Mean temperature of the lens."""
    swing_k: NonNegative = 0.0
    """Amplitude of the temperature, which is `temperature_c` + `swing_k` · sin(2π t / `swing_period_s`) at the time t
    after the epoch."""
    swing_period_s: Positive = 6000.0
    """Period of the temperature, such as that of the orbit."""


class BaffleSection(Section):
    """The baffle in front of the lens: attenuation of the Sun, the Moon and the Earth outside the field."""

    pst: str | None = None
    """Point-source transmittance over the angle from the boresight: ``vane``, a model that reaches 1e-9 at the Sun's
    exclusion angle, or a CSV file (angle_deg, pst); null: no stray light."""
    sun_exclusion_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)] = 35.0
    """Exclusion angle of the Sun from the boresight."""
    moon_exclusion_deg: Annotated[FiniteFloat, Field(ge=0, lt=90)] = 20.0
    """Exclusion angle of the Moon."""
    earth_exclusion_deg: Annotated[FiniteFloat, Field(ge=0, lt=90)] = 25.0
    """Exclusion angle of the lit Earth."""


class OpticsSection(Section):
    """The lens."""

    focal_length_mm: Positive
    """Focal length."""
    aperture_mm: Positive
    """Diameter of the entrance pupil."""
    transmission: str | Fraction = 0.9
    """A number, the name of an included curve, or a CSV file (wavelength_nm, transmission)."""
    obscuration: Annotated[FiniteFloat, Field(ge=0, lt=0.9)] = 0.0
    """Diameter of a central obscuration relative to the aperture; 0: none."""
    psf: PsfModel = PsfModel()
    """Image of a star."""
    distortion: Distortion = Distortion()
    """Coefficients with OpenCV's names: Brown–Conrady for a pinhole, k1 to k4 of its fisheye model for a fisheye."""
    projection: Literal["pinhole", "fisheye", "equidistant", "equisolid"] = "pinhole"
    """``pinhole``: r = f tan θ; ``fisheye``: r = f θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸); or ideal, without
    coefficients: ``equidistant``, r = f θ; ``equisolid``, r = 2 f sin(θ/2)."""
    principal_point_offset_px: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Principal point minus the centre of the detector."""
    calibration_residual: CalibrationResidual = CalibrationResidual()
    """Smooth error that remains after the calibration of the camera, not known to the tracker."""
    lateral_colour: LateralColour = LateralColour()
    """Lateral chromatic aberration."""
    vignetting: Vignetting = Vignetting()
    """Vignetting."""
    thermal: ThermalSection = ThermalSection()
    """Temperature."""
    ghosts: tuple[Ghost, ...] = ()
    """Ghosts: a list of {flux, scale, radius_px}."""
    baffle: BaffleSection = BaffleSection()
    """The baffle; without its `pst` there is no stray light."""


class DetectorSection(Section):
    """The detector and its readout."""

    kind: Literal["cmos", "ccd_full_frame", "ccd_frame_transfer"] = "cmos"
    """Kind of detector, which determines the possible effects: only CCDs bloom and transfer charge."""
    width: Annotated[int, Field(ge=16, le=16384)]
    """Columns."""
    height: Annotated[int, Field(ge=16, le=16384)]
    """Rows."""
    pixel_pitch_um: Positive | tuple[Positive, Positive]
    """Pitch; two values for pixels that are not square (along columns, along rows)."""
    exposure_s: Positive
    """Exposure time."""
    shutter: Literal["global", "rolling", "frame_transfer"] = "global"
    """``rolling``: rows are exposed one after the other; ``frame_transfer``: charge is transferred through the image
    under light."""
    line_time_us: NonNegative = 10.0
    """Delay from row to row, of a rolling shutter or of the transfer."""
    transfer_smear: Literal["both", "after"] = "both"
    """Transfer under light before (clearing) and after the exposure, or only after it."""
    time_tag: TimeTag = TimeTag()
    """Error of the time stated for mid-exposure, by which the attitude of a frame refers to another moment."""
    quantum_efficiency: str | Fraction = 0.5
    """A number, the name of an included detector, or a CSV file (wavelength_nm, qe)."""
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] = 20.0
    """Temperature of the detector."""
    charge_diffusion_um: NonNegative = 0.0
    """Standard deviation of the Gaussian spreading of charge in the silicon before collection."""
    intra_pixel: IntraPixel = IntraPixel()
    """Sensitivity across a pixel."""
    intensifier: Intensifier = Intensifier()
    """Image intensifier; none without a `gain`."""
    shot_noise: bool = True
    """Poisson statistics of the light and of the dark current; false: mean values."""
    dark_current_e_s: NonNegative = 0.0
    """Mean dark current per pixel at `dark_reference_c`."""
    dark_reference_c: FiniteFloat = 25.0
    """Reference temperature of the dark current."""
    dark_doubling_c: Positive = 8.0
    """Temperature increase that doubles the dark current."""
    dsnu: NonNegative = 0.0
    """Dark signal non-uniformity: standard deviation of the dark current relative to its mean."""
    prnu: NonNegative = 0.0
    """Photo response non-uniformity: relative standard deviation."""
    hot_pixel_fraction: Fraction = 0.0
    """Fraction of hot pixels."""
    hot_pixel_dark_e_s: NonNegative = 0.0
    """Mean dark current of a hot pixel at `dark_reference_c`, exponentially distributed, in addition to the normal
    one."""
    hot_columns: Annotated[int, Field(ge=0)] = 0
    """Number of hot columns."""
    hot_column_dark_e_s: NonNegative = 0.0
    """Mean dark current of a pixel of a hot column at `dark_reference_c`, exponentially distributed over columns."""
    dead_pixel_fraction: Fraction = 0.0
    """Fraction of dead pixels, which collect neither light nor dark current."""
    dead_columns: Annotated[int, Field(ge=0)] = 0
    """Number of dead columns."""
    displacement: DisplacementDamage = DisplacementDamage()
    """Dark current by displacement damage."""
    telegraph: RandomTelegraph = RandomTelegraph()
    """Random telegraph pixels."""
    cosmic_rays: CosmicRays = CosmicRays()
    """Charged particles."""
    full_well_e: Positive = 30000.0
    """Full well; charge above it drains or blooms (`antiblooming`)."""
    antiblooming: Fraction = 1.0
    """Fraction of the charge above the full well that is drained; the rest blooms along the column (CCD). 1: no
    blooming."""
    cti_parallel: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = 0.0
    """Fraction of the charge left behind in each transfer along a column (CCD)."""
    cti_serial: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = 0.0
    """Fraction of the charge left behind in each transfer along the serial register (CCD)."""
    readout_corner: Literal["top_left", "top_right", "bottom_left", "bottom_right"] = "top_left"
    """Corner of the output node; ``top_left`` is pixel (0, 0)."""
    read_noise_e: NonNegative = 0.0
    """Standard deviation of the read noise."""
    reset_capacitance_ff: NonNegative = 0.0
    """Capacitance of the output node, whose reset (kTC) noise stays in the frame; 0: correlated double sampling."""
    nonlinearity: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Relative deviation from linearity at the full well, of second and third order: (c2, c3)."""
    gain_e_per_dn: Positive | Literal["auto"] = "auto"
    """Electrons per DN; ``auto``: the full well corresponds to the maximum of the converter."""
    offset_dn: NonNegative = 0.0
    """Digital offset, so that noise is not clipped at zero."""
    video: Video = Video()
    """The analogue video signal."""
    adc_bits: Annotated[int, Field(ge=1, le=16)] | None = 12
    """Resolution of the converter; null: no rounding, pixel values are fractions of a DN."""

    @property
    def pitch_um(self) -> tuple[float, float]:
        """Pixel pitch along columns and along rows."""
        pitch = self.pixel_pitch_um
        return pitch if isinstance(pitch, tuple) else (pitch, pitch)
