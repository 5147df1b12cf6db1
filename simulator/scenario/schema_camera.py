"""The camera's sections of a scenario: lens, point spread function, detector."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from simulator.scenario.schema_base import Fraction, NonNegative, Positive, Section, Vector3
from startracker.distortion import Distortion


class ZernikeSection(Section):
    """Aberrations over the whole field: Zernike coefficients (Noll 1976), waves rms at `wavelength_nm`."""

    defocus: FiniteFloat = 0.0
    """Z4; peak to valley it is 3.46 times this."""
    astigmatism_oblique: FiniteFloat = 0.0
    """Z5, with the sine of twice the angle from columns to rows."""
    astigmatism: FiniteFloat = 0.0
    """Z6, with the cosine."""
    coma_y: FiniteFloat = 0.0
    """Z7: a tail along rows."""
    coma_x: FiniteFloat = 0.0
    """Z8: a tail along columns."""
    trefoil_y: FiniteFloat = 0.0
    """Z9, with the sine of three times the angle."""
    trefoil_x: FiniteFloat = 0.0
    """Z10, with the cosine."""
    spherical: FiniteFloat = 0.0
    """Z11."""


class FieldAberrationsSection(Section):
    """Aberrations that grow with the distance h from the centre of the image: their values at its corners (h = 1)."""

    coma_waves: FiniteFloat = 0.0
    """Coma along the radius, goes with h; waves rms."""
    astigmatism_waves: FiniteFloat = 0.0
    """Astigmatism about the radius, goes with h²; waves rms."""
    curvature_waves: FiniteFloat = 0.0
    """Defocus by the curvature of the field, goes with h²; waves rms."""
    rings: Annotated[int, Field(ge=1, le=32)] = 4
    """Zones along the radius, besides the one in the middle."""
    azimuths: Annotated[int, Field(ge=4, le=64)] = 12
    """Zones around."""


class PsfSection(Section):
    """Shape of a star's image, before smear."""

    model: str = "gaussian"
    """``gaussian``, ``airy``, or ``diffraction`` for a lens with aberrations."""
    sigma_px: Positive | None = None
    """Standard deviation of the Gaussian, pixels along columns."""
    first_dark_ring_px: Positive | None = None
    """Radius of the first dark ring, pixels: defocus as a scaled pattern (Greyling 1995: 2.0). Left out, an Airy image
    is diffraction-limited at `wavelength_nm`, and a Gaussian without `sigma_px` has the width that fits that Airy."""
    wavelength_nm: Positive = 600.0
    """Effective wavelength of the diffraction."""
    polychromatic: bool = False
    """Airy and diffraction: sum the images of all wavelengths, weighted by the spectrum of each star."""
    zernike_waves: ZernikeSection = ZernikeSection()
    """Diffraction: aberrations over the whole field."""
    defocus_um: FiniteFloat = 0.0
    """Diffraction: distance of the detector from the focus, on top of `zernike_waves.defocus`."""
    field: FieldAberrationsSection = FieldAberrationsSection()
    """Diffraction: aberrations that grow towards the corners."""


class VignettingSection(Section):
    """Loss of light towards the edge of the field."""

    natural: bool = False
    """Projected area of the pupil for stars, and with the solid angle of the pixels the cos⁴ law for the background."""
    mechanical_start_deg: Annotated[FiniteFloat, Field(ge=0, lt=180)] = 0.0
    """Angle off the axis up to which the barrel leaves the pupil open."""
    mechanical_end_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] | None = None
    """Angle from which it closes it; null: no mechanical vignetting."""
    polynomial: Vector3 = (0.0, 0.0, 0.0)
    """Measured: factor 1 + a1 ρ² + a2 ρ⁴ + a3 ρ⁶, ρ the undistorted image radius in focal lengths."""


class ThermalSection(Section):
    """Change of the focal length since calibration."""

    expansion_ppm_k: FiniteFloat = 0.0
    """Relative change of the focal length; 0: none."""
    reference_c: FiniteFloat = 20.0
    """Temperature at which `focal_length_mm` holds and the tracker's camera was calibrated."""
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] = 20.0
    """Temperature of the lens."""


class GhostSection(Section):
    """Second image by two reflections in the lens."""

    flux: Fraction
    """Share of the star's light."""
    scale: FiniteFloat
    """Distance from the principal point, against the star's; negative: on the other side."""
    radius_px: Positive
    """Radius of the even disk."""


class BaffleSection(Section):
    """The baffle before the lens: what it lets through of the Sun, the Moon and the Earth beside the field."""

    pst: str | None = None
    """Point-source transmittance over the angle from the boresight: ``vane``, a model that reaches 1e-9 at the Sun's
    exclusion angle, or a CSV file (angle_deg, pst); null: no stray light."""
    sun_exclusion_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)] = 35.0
    """Nearest the Sun may come to the boresight."""
    moon_exclusion_deg: Annotated[FiniteFloat, Field(ge=0, lt=90)] = 20.0
    """Nearest the Moon may come to the boresight."""
    earth_exclusion_deg: Annotated[FiniteFloat, Field(ge=0, lt=90)] = 25.0
    """Nearest the lit Earth may come to the boresight."""


class OpticsSection(Section):
    """The lens."""

    focal_length_mm: Positive
    """Focal length."""
    aperture_mm: Positive
    """Diameter of the entrance pupil."""
    transmission: str | Fraction = 0.9
    """One number, the name of a curve that ships with boresight, or a CSV file (wavelength_nm, transmission)."""
    obscuration: Annotated[FiniteFloat, Field(ge=0, lt=0.9)] = 0.0
    """Diameter of a central obscuration over that of the aperture; 0: none."""
    psf: PsfSection = PsfSection()
    """Image of a star."""
    distortion: Distortion = Distortion()
    """Coefficients, OpenCV's names: Brown–Conrady's for a pinhole, k1 to k4 of its fisheye model for a fisheye."""
    projection: Literal["pinhole", "fisheye", "equidistant", "equisolid"] = "pinhole"
    """``pinhole``: r = f tan θ; ``fisheye``: r = f θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸); or ideal, without
    coefficients: ``equidistant``, r = f θ; ``equisolid``, r = 2 f sin(θ/2)."""
    principal_point_offset_px: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Principal point minus the centre of the detector."""
    vignetting: VignettingSection = VignettingSection()
    """Vignetting."""
    thermal: ThermalSection = ThermalSection()
    """Temperature."""
    ghosts: tuple[GhostSection, ...] = ()
    """Ghosts: a list of {flux, scale, radius_px}."""
    baffle: BaffleSection = BaffleSection()
    """The baffle; without its `pst` there is no stray light."""


class CosmicRaySection(Section):
    """Charged particles that cross the detector."""

    rate_cm2_s: NonNegative = 0.0
    """Particles through a square centimetre of the surface a second; 0: none. About 1 to 1.7 in a low orbit, up to
    1100 in the South Atlantic Anomaly."""
    depth_um: Positive = 10.0
    """Depth of the silicon from which charge is collected."""
    charge_e_um: Positive = 80.0
    """Most probable charge along a micrometre of track; 80 e⁻/µm: fast singly charged particles."""


class IntensifierSection(Section):
    """An image intensifier before the detector: photocathode, electron multiplier, phosphor screen."""

    gain: NonNegative = 0.0
    """Mean electrons in the detector's pixels for one photo-electron of the photocathode, whose quantum efficiency
    `detector.quantum_efficiency` then is; 0: no intensifier."""
    gain_variance: NonNegative = 1.0
    """Variance of the gain of one photo-electron over the square of its mean; 1: exponential, a microchannel plate."""
    phosphor_sigma_px: NonNegative = 0.0
    """Standard deviation of the Gaussian by which phosphor screen and coupling spread the light of one photo-electron,
    pixels."""
    dark_e_s: NonNegative = 0.0
    """Electrons a pixel that leave the photocathode in the dark, a second (equivalent background illumination)."""


class VideoSection(Section):
    """Analogue video between the amplifier and the converter: a line, a recorder."""

    noise_dn: NonNegative = 0.0
    """Noise, standard deviation; 0: none."""
    line_blur_px: NonNegative = 0.0
    """Standard deviation of the Gaussian by which the bandwidth spreads signal and noise along the lines, pixels."""


class DetectorSection(Section):
    """The detector and its readout."""

    kind: Literal["cmos", "ccd_full_frame", "ccd_frame_transfer"] = "cmos"
    """Which effects make sense: charge blooms and is transferred in CCDs alone."""
    width: Annotated[int, Field(ge=16, le=16384)]
    """Columns."""
    height: Annotated[int, Field(ge=16, le=16384)]
    """Rows."""
    pixel_pitch_um: Positive | tuple[Positive, Positive]
    """Pitch; two values for pixels that are not square (along columns, along rows)."""
    exposure_s: Positive
    """Exposure time."""
    shutter: Literal["global", "rolling", "frame_transfer"] = "global"
    """``rolling``: rows are exposed one after another; ``frame_transfer``: charge is moved through the image under
    light."""
    line_time_us: NonNegative = 10.0
    """From row to row: of a rolling shutter, or of the transfer."""
    transfer_smear: Literal["both", "after"] = "both"
    """Light falls on moving charge before (clearing) and after the exposure, or after it alone."""
    quantum_efficiency: str | Fraction = 0.5
    """One number, the name of a detector that ships with boresight, or a CSV file (wavelength_nm, qe)."""
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] = 20.0
    """Temperature of the detector."""
    charge_diffusion_um: NonNegative = 0.0
    """Standard deviation of the Gaussian by which charge spreads in the silicon before it is gathered."""
    intensifier: IntensifierSection = IntensifierSection()
    """The image intensifier; without its `gain` there is none."""
    shot_noise: bool = True
    """Poisson statistics of the light and of the dark current; off: their means."""
    dark_current_e_s: NonNegative = 0.0
    """Mean dark current a pixel at `dark_reference_c`."""
    dark_reference_c: FiniteFloat = 25.0
    """Temperature at which the dark current is given."""
    dark_doubling_c: Positive = 8.0
    """Temperature rise that doubles the dark current."""
    dsnu: NonNegative = 0.0
    """Dark signal non-uniformity: standard deviation of the dark current over the pixels, relative to its mean."""
    prnu: NonNegative = 0.0
    """Photo response non-uniformity: relative standard deviation."""
    hot_pixel_fraction: Fraction = 0.0
    """Share of hot pixels."""
    hot_pixel_dark_e_s: NonNegative = 0.0
    """Mean dark current of a hot pixel at `dark_reference_c`, exponentially distributed, on top of the ordinary one."""
    hot_columns: Annotated[int, Field(ge=0)] = 0
    """Number of hot columns."""
    hot_column_dark_e_s: NonNegative = 0.0
    """Mean dark current of a pixel of a hot column at `dark_reference_c`, exponentially distributed over columns."""
    dead_pixel_fraction: Fraction = 0.0
    """Share of dead pixels, which collect neither light nor dark current."""
    dead_columns: Annotated[int, Field(ge=0)] = 0
    """Number of dead columns."""
    cosmic_rays: CosmicRaySection = CosmicRaySection()
    """Charged particles."""
    full_well_e: Positive = 30000.0
    """Full well; charge above it drains or blooms (`antiblooming`)."""
    antiblooming: Fraction = 1.0
    """Share of the charge above the full well that is drained; the rest spills along the column (CCD). 1: none."""
    cti_parallel: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = 0.0
    """Share of the charge left behind in each transfer along a column (CCD)."""
    cti_serial: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = 0.0
    """Share of the charge left behind in each transfer along the serial register (CCD)."""
    readout_corner: Literal["top_left", "top_right", "bottom_left", "bottom_right"] = "top_left"
    """Corner of the output node, to which charge is transferred; ``top_left`` is pixel (0, 0)."""
    read_noise_e: NonNegative = 0.0
    """Read noise, standard deviation."""
    reset_capacitance_ff: NonNegative = 0.0
    """Capacitance of the output node, whose reset (kTC) noise stays in the frame; 0: correlated double sampling."""
    nonlinearity: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Relative departure from a straight line at the full well, of second and of third order: (c2, c3)."""
    gain_e_per_dn: Positive | Literal["auto"] = "auto"
    """Electrons a digital number; ``auto`` puts the full well at the top of the converter."""
    offset_dn: NonNegative = 0.0
    """Digital offset, so that noise is not cut off at zero."""
    video: VideoSection = VideoSection()
    """The analogue video signal."""
    adc_bits: Annotated[int, Field(ge=1, le=16)] | None = 12
    """Resolution of the converter; null: none, the frame stays in fractions of a DN."""

    @property
    def pitch_um(self) -> tuple[float, float]:
        """Pixel pitch along columns and along rows."""
        pitch = self.pixel_pitch_um
        return pitch if isinstance(pitch, tuple) else (pitch, pitch)
