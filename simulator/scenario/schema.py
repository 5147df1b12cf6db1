"""The scenario: every key a user may write, with unit, default and limits. A loaded scenario is frozen."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from startracker.distortion import Distortion
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]
Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


def _utc(value: datetime) -> datetime:
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Section(BaseModel):
    """Base of every section: unknown keys are errors, values never change, numbers are numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, use_attribute_docstrings=True)


class OrbitSection(Section):
    """Circular orbit. The node is given by `raan_deg` or by `ltan_h`, not by both."""

    altitude_km: FiniteFloat = 800.0
    """Height above the equatorial radius."""
    inclination_deg: Annotated[FiniteFloat, Field(ge=0, le=180)] | Literal["auto"] = "auto"
    """Inclination; ``auto`` is sun-synchronous by J2."""
    ltan_h: Annotated[FiniteFloat, Field(ge=0, lt=24)] | None = None
    """Local mean solar time of the ascending node, hours; 22.5 where neither node key is given."""
    raan_deg: FiniteFloat | None = None
    """Right ascension of the ascending node at the epoch, true equator of date."""
    argument_of_latitude_deg: FiniteFloat = 0.0
    """Angle from the ascending node at the epoch."""
    propagator: Literal["j2", "sgp4"] = "j2"
    """``j2``: analytic circular orbit with secular J2; ``sgp4``: the same mean elements through SGP4."""


class PointingSection(Section):
    """How the camera is mounted and how the body is turned against the local level."""

    mounting: str | tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] = "orbit_normal"
    """Name of a mounting, or the quaternion (x, y, z, w) from body to camera."""
    target: str | Vector3 | None = None
    """Hold the camera on this instead of the local level: right ascension, declination, roll in degrees (ICRS), or the
    name of a star of the sky's catalogue (``Alp CMa``, ``HIP 32349``) or of a body (``Moon``, ``Jupiter``)."""
    target_offset_deg: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Where a named target stands in the image: degrees from the boresight along +x (columns) and +y (rows)."""
    target_roll_deg: FiniteFloat = 0.0
    """Roll of the camera on a named target."""
    offset_deg: Vector3 = (0.0, 0.0, 0.0)
    """Fixed attitude offset of the body from the local level: roll, pitch, yaw (rotation vector)."""
    error_deg: Annotated[FiniteFloat, Field(ge=0, le=180)] = 1.0
    """Half width of the random attitude offset a trial and axis: what the other sensors leave unknown."""
    rate_deg_s: Vector3 = (0.0, 0.0, 0.0)
    """Body rate about X, Y, Z on top of the turning of the local-level frame itself."""


class SkySection(Section):
    """What is in the sky and how it is seen."""

    catalog: str = "hipparcos"
    """``hipparcos`` or ``bsc5``."""
    magnitude_limit: FiniteFloat = 9.0
    """Faintest V that is drawn."""
    proper_motion: bool = True
    """Move the stars to the date."""
    parallax: bool = True
    """Annual parallax."""
    light_deflection: bool = True
    """Bending of light by the Sun."""
    aberration: bool = True
    """Annual and orbital aberration."""
    planets: bool = True
    """Planets, Moon and Sun from DE421."""
    background: bool = True
    """Diffuse background."""
    background_s10: NonNegative = 75.0
    """Its brightness in tenth-magnitude stars a square degree: zodiacal light 60 and scattered starlight 15."""


class PsfSection(Section):
    """Shape of a star's image, before smear."""

    model: str = "gaussian"
    """``gaussian`` or ``airy``."""
    sigma_px: Positive | None = None
    """Standard deviation of the Gaussian, pixels along columns."""
    first_dark_ring_px: Positive | None = None
    """Radius of the first dark ring, pixels: defocus as the thesis chooses it (2.0). Left out, an Airy image is
    diffraction-limited at `wavelength_nm`, and a Gaussian without `sigma_px` has the width that fits that Airy."""
    wavelength_nm: Positive = 600.0
    """Effective wavelength of the diffraction."""


class OpticsSection(Section):
    """The lens."""

    focal_length_mm: Positive
    """Focal length."""
    aperture_mm: Positive
    """Diameter of the entrance pupil."""
    transmission: str | Fraction = 0.9
    """One number, the name of a curve that ships with boresight, or a CSV file (wavelength_nm, transmission)."""
    psf: PsfSection = PsfSection()
    """Image of a star."""
    distortion: Distortion = Distortion()
    """Brown–Conrady coefficients, OpenCV's names."""
    principal_point_offset_px: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Principal point minus the centre of the detector."""


class CosmicRaySection(Section):
    """Charged particles that cross the detector."""

    rate_cm2_s: NonNegative = 0.0
    """Particles through a square centimetre of the surface a second; 0: none. About 1 to 1.7 in a low orbit, up to
    1100 in the South Atlantic Anomaly."""
    depth_um: Positive = 10.0
    """Depth of the silicon from which charge is collected."""
    charge_e_um: Positive = 80.0
    """Most probable charge along a micrometre of track; 80 e⁻/µm: fast singly charged particles."""


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
    quantum_efficiency: str | Fraction = 0.5
    """One number, the name of a detector that ships with boresight, or a CSV file (wavelength_nm, qe)."""
    temperature_c: Annotated[FiniteFloat, Field(gt=-273.15)] = 20.0
    """Temperature of the detector."""
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
    """Mean dark current of a pixel of a hot column at `dark_reference_c`, exponentially distributed over the columns."""
    dead_pixel_fraction: Fraction = 0.0
    """Share of dead pixels, which collect neither light nor dark current."""
    dead_columns: Annotated[int, Field(ge=0)] = 0
    """Number of dead columns."""
    cosmic_rays: CosmicRaySection = CosmicRaySection()
    """Charged particles."""
    full_well_e: Positive = 30000.0
    """Full well; charge above it drains or blooms (`antiblooming`)."""
    antiblooming: Fraction = 1.0
    """Share of the charge above the full well that is drained; the rest spills along the column (CCD). 1: no blooming."""
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
    adc_bits: Annotated[int, Field(ge=1, le=16)] | None = 12
    """Resolution of the converter; null: none, the frame stays in fractions of a DN."""

    @property
    def pitch_um(self) -> tuple[float, float]:
        """Pixel pitch along columns and along rows."""
        pitch = self.pixel_pitch_um
        return pitch if isinstance(pitch, tuple) else (pitch, pitch)


class TrackerSection(Section):
    """The star tracker that solves the frames."""

    catalog: str = "hipparcos"
    """Catalogue of guide stars."""
    magnitude_limit: FiniteFloat = 6.5
    """Faintest guide star."""
    detector: str = "components"
    """``components`` or ``region_growing``."""
    centroider: str = "moment"
    """``moment``."""
    identifier: str = "match_groups"
    """``match_groups``."""
    estimator: str = "svd"
    """``svd`` or ``star_pair``."""
    prior: bool = True
    """Give the tracker the attitude of the other sensors, good to `pointing.error_deg`; false: lost in space."""
    detection: DetectionSettings = DetectionSettings()
    """Knobs of the detection."""
    centroid: CentroidSettings = CentroidSettings()
    """Knobs of the centroiding."""
    identification: IdentificationSettings = IdentificationSettings()
    """Knobs of the identification."""


class StudySection(Section):
    """The Monte Carlo run."""

    trials: Annotated[int, Field(ge=1)] = 500
    """Number of frames."""
    sampling: Literal["mission_year", "orbit", "sky"] = "mission_year"
    """``mission_year``: times spread over a year; ``orbit``: over one orbit; ``sky``: random attitudes at the epoch."""


class SpecificationSection(Section):
    """Required 3σ accuracy about the body axes."""

    roll_deg: Positive = 0.025
    """About X."""
    yaw_deg: Positive = 0.025
    """About Z."""
    pitch_deg: Positive = 0.286
    """About Y."""


class ScenarioModel(Section):
    """A whole scenario."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    """Name; also that of the default output folder."""
    description: str = ""
    """A sentence for the report."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    """Seed of every random stream."""
    epoch: Annotated[datetime, AfterValidator(_utc)]
    """UTC, ISO 8601."""
    orbit: OrbitSection = OrbitSection()
    """The orbit."""
    pointing: PointingSection = PointingSection()
    """Mounting and attitude."""
    sky: SkySection = SkySection()
    """The sky."""
    optics: OpticsSection
    """The lens."""
    detector: DetectorSection
    """The detector."""
    tracker: TrackerSection = TrackerSection()
    """The tracker."""
    study: StudySection = StudySection()
    """The study."""
    specification: SpecificationSection = SpecificationSection()
    """The accuracy asked for."""
    allow_unphysical: bool = False
    """Let physics pass that cannot be; the report repeats it."""


Count = Annotated[int, Field(ge=1)]
KNOB_LIMITS: dict[type, dict[str, Any]] = {
    DetectionSettings: {
        "threshold_sigma": Positive,
        "min_pixels": Count,
        "max_pixels": Count,
        "max_axis_ratio": Annotated[FiniteFloat, Field(ge=1)],
        "max_stars": Count,
        "background_tile_px": Annotated[int, Field(ge=4)],
        "search_step_px": Count,
    },
    CentroidSettings: {
        "window_px": Annotated[int, Field(ge=3, le=101)],
        "psf_sigma_px": Positive | None,
    },
    IdentificationSettings: {
        "separation_tolerance_deg": Positive | None,
        "magnitude_tolerance": Positive,
        "min_stars": Annotated[int, Field(ge=2)],
        "max_stars": Annotated[int, Field(ge=2)],
        "group_threshold": Count,
        "max_groups_per_star": Count,
        "close_pair_deg": NonNegative,
        "close_pair_magnitude": NonNegative,
        "false_alarm_rate": Annotated[FiniteFloat, Field(gt=0, lt=1)],
    },
}
"""Limits of the tracker's knobs, whose classes live in `startracker.settings` and know no pydantic."""
