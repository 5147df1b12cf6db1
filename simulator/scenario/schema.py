"""The scenario: every key a user may write, with unit, default and limits. A loaded scenario is frozen."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, FiniteFloat

from simulator.scenario.schema_base import Fraction, NonNegative, Positive, Section, Vector3
from simulator.scenario.schema_camera import (
    BaffleSection,
    CosmicRaySection,
    DetectorSection,
    FieldAberrationsSection,
    GhostSection,
    IntensifierSection,
    OpticsSection,
    PsfSection,
    ThermalSection,
    VideoSection,
    VignettingSection,
    ZernikeSection,
)
from simulator.scenario.schema_payload import SpinSection, TetherSection
from simulator.scenario.schema_sequence import (
    DropoutSection,
    GyroSection,
    RatePointSection,
    SequenceSection,
    SlewSection,
)
from startracker.settings import AnyIdentificationSettings, CentroidSettings, DetectionSettings, OperationSettings

__all__ = [
    "KNOB_LIMITS",
    "BaffleSection",
    "CosmicRaySection",
    "DetectorSection",
    "DropoutSection",
    "FieldAberrationsSection",
    "GhostSection",
    "GyroSection",
    "IntensifierSection",
    "JitterSection",
    "OpticsSection",
    "OrbitSection",
    "PointingSection",
    "PsfSection",
    "RatePointSection",
    "ScenarioModel",
    "Section",
    "SequenceSection",
    "SkySection",
    "SlewSection",
    "SpecificationSection",
    "SpinSection",
    "StudySection",
    "TetherSection",
    "ThermalSection",
    "TrackerSection",
    "VideoSection",
    "VignettingSection",
    "ZernikeSection",
]


def _utc(value: datetime) -> datetime:
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


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


class JitterSection(Section):
    """Random turning of the camera, during exposures and, in a sequence, between them."""

    rms_arcsec: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    """Root mean square of the angle about x, y, z; 0: none."""
    psd: Literal["white", "lorentz", "table"] = "lorentz"
    """Power spectrum: ``white`` up to the corner; ``lorentz``, 1/(1 + (f/corner)²) up to 8 corners; ``table``."""
    corner_hz: Positive = 10.0
    """Corner frequency."""
    table: str | None = None
    """CSV file (frequency_hz, psd) whose shape is taken for ``table``."""
    axes: Literal["camera", "body"] = "camera"
    """Axes of `rms_arcsec`."""


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
    spin: SpinSection = SpinSection()
    """Spin about an axis that stands still among the stars, in place of the local level; off without its rate."""
    jitter: JitterSection = JitterSection()
    """Jitter."""


class SkySection(Section):
    """What is in the sky and how it is seen."""

    catalog: str = "hipparcos"
    """``hipparcos`` or ``bsc5``."""
    magnitude_limit: FiniteFloat = 9.0
    """Faintest V that is drawn."""
    spectrum: str = "colour_sequence"
    """Spectra of the stars: ``colour_sequence`` (library spectra with the colours of real stars) or ``blackbody``."""
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
    background_model: Literal["constant", "leinert1998"] = "constant"
    """``constant``: `background_s10` everywhere; ``leinert1998``: zodiacal light and undrawn starlight by direction."""
    earth: bool = True
    """The Earth: it hides what is behind it, and its lit side and limb shine where they are in the field."""
    earth_albedo: Fraction = 0.3
    """Albedo of the Earth's surface and clouds, which scatter alike in all directions (Lambert)."""
    phases: bool = True
    """Draw the lit part of the Moon's and the planets' disks; false: uniform full disks."""


class TrackerSection(Section):
    """The star tracker that solves the frames."""

    catalog: str = "hipparcos"
    """Catalogue of guide stars."""
    magnitude_limit: FiniteFloat = 6.5
    """Faintest guide star."""
    detector: str = "components"
    """``components``, ``region_growing``, ``clustering``, ``round_regions`` or ``first_regions``."""
    centroider: str = "moment"
    """``moment``, ``weighted_moment``, ``least_squares`` or ``maximum_likelihood``."""
    identifier: str = "adaptive"
    """``adaptive``, ``match_groups``, ``pyramid``, ``pattern_hash``, ``triads`` or ``triads_integer``."""
    estimator: str = "svd"
    """``svd``, ``davenport``, ``quest``, ``esoq2``, ``triad``, ``star_pair`` or ``plate_constants``."""
    prior: bool = True
    """Give the tracker the attitude of the other sensors, good to `pointing.error_deg`; false: lost in space."""
    detection: DetectionSettings = DetectionSettings()
    """Knobs of the detection."""
    centroid: CentroidSettings = CentroidSettings()
    """Knobs of the centroiding."""
    identification: AnyIdentificationSettings = AnyIdentificationSettings()
    """Knobs of the identification; those that the `identifier` does not read are named when the scenario is loaded."""


class StudySection(Section):
    """The Monte Carlo run."""

    trials: Annotated[int, Field(ge=1)] = 500
    """Number of frames."""
    sampling: Literal["mission_year", "orbit", "sky"] = "mission_year"
    """``mission_year``: times spread over a year; ``orbit``: over one orbit, or one turn of a body that spins; ``sky``:
    random attitudes at the epoch."""
    sky_without_earth: bool = True
    """With `sampling: sky` and no `pointing.target`: leave the Earth out, which would hide a third of the sky; it then
    neither hides nor shines. False: as `sky.earth` says."""


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
    tether: TetherSection = TetherSection()
    """A tether before the camera; none without its diameter."""
    optics: OpticsSection
    """The lens."""
    detector: DetectorSection
    """The detector."""
    tracker: TrackerSection = TrackerSection()
    """The tracker."""
    study: StudySection = StudySection()
    """The study."""
    sequence: SequenceSection = SequenceSection()
    """The sequence of ``run --sequence``."""
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
        "threshold_dn": Positive | None,
    },
    CentroidSettings: {
        "window_px": Annotated[int, Field(ge=3, le=101)],
        "psf_sigma_px": Positive | None,
    },
    AnyIdentificationSettings: {
        "separation_tolerance_deg": Positive | None,
        "magnitude_tolerance": Positive,
        "min_stars": Annotated[int, Field(ge=2)],
        "max_stars": Annotated[int, Field(ge=2)] | None,
        "group_threshold": Count,
        "max_groups_per_star": Count,
        "close_pair_deg": NonNegative,
        "close_pair_magnitude": NonNegative,
        "false_alarm_rate": Annotated[FiniteFloat, Field(gt=0, lt=1)],
        "rotation_tolerance_deg": Positive,
        "grouping_tolerance_deg": Positive,
        "enclosed_tolerance_deg": Positive | None,
        "vote_number": Count,
        "max_centroids": Annotated[int, Field(ge=3)],
        "max_operations": Count,
        "max_operations_free_scale": Count,
    },
    OperationSettings: {
        "saturated_pixels": Annotated[int, Field(ge=0)],
        "shorten": Annotated[FiniteFloat, Field(gt=0, lt=1)],
        "shortest_exposure_s": Positive,
        "lengthen_below": Annotated[FiniteFloat, Field(ge=0, lt=1)],
        "exposure_step_s": NonNegative,
        "sun_share": Annotated[FiniteFloat, Field(gt=0, le=1)],
        "suspend_turn_deg": Positive,
        "longest_suspension_s": Positive,
        "clear_pixels": Count | None,
        "blemish_frames": Annotated[int, Field(ge=0)],
        "blemish_share": Annotated[FiniteFloat, Field(gt=0, le=1)],
        "blemish_sigma": Positive,
        "blemish_shift_px": Positive,
    },
}
"""Limits of the tracker's knobs, whose classes live in `startracker.settings` and know no pydantic."""
