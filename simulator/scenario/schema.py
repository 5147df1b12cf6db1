"""The scenario: every key a user may write, with unit, default and limits. A loaded scenario is frozen.

Sections that are parameters of the physics or settings of the tracker are those classes themselves; their limits are in
`LIMITS`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, FiniteFloat

from simulator.detector.parameters import CosmicRays, DisplacementDamage, Intensifier, RandomTelegraph, TimeTag, Video
from simulator.environment.parameters import Environment
from simulator.mission.parameters import (
    ForceModel,
    GroundTarget,
    Gyro,
    KeplerianElements,
    OrbitParameters,
    PointingParameters,
    RatePoint,
    Slew,
    Spin,
    Track,
    Waypoint,
    Waypoints,
)
from simulator.optics.displacement import CalibrationResidual
from simulator.optics.ghosts import Ghost
from simulator.optics.illumination import Vignetting
from simulator.optics.jitter import Jitter
from simulator.optics.pixel_response import IntraPixel
from simulator.optics.psf_model import FieldAberrations, PsfModel
from simulator.optics.tether import Tether
from simulator.scenario.schema_base import Count, Fraction, NonNegative, Positive, Section
from simulator.scenario.schema_camera import DetectorSection, OpticsSection
from simulator.scenario.schema_heads import HeadSection
from simulator.scenario.schema_sequence import SequenceSection
from simulator.scenario.schema_specification import SpecificationSection
from simulator.sky.catalogue_errors import CatalogueErrors
from simulator.sky.parameters import SatelliteParameters, SatelliteSize, Sky
from simulator.sky.star_counts import FAINTEST_V
from startracker.settings import (
    AnyIdentificationSettings,
    CentroidSettings,
    DetectionSettings,
    InFlightSettings,
    OperationSettings,
)

__all__ = ["LIMITS", "DetectorSection", "HeadSection", "OpticsSection", "ScenarioModel", "Section", "SequenceSection"]


def _utc(value: datetime) -> datetime:
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class FlightSection(Section):
    """The flight build of the tracker, as ``boresight export-c`` writes it."""

    arithmetic: Literal["fixed", "float"] = "fixed"
    """``fixed``: integers only; ``float``: attitudes and filter in single precision."""


class TrackerSection(Section):
    """The star tracker that solves the frames."""

    engine: Literal["reference", "flight"] = "reference"
    """Implementation that solves the frames: ``reference``, the tracker in Python with all its methods; ``flight``, the
    C that ``boresight export-c`` writes for the scenario's camera, compiled on this machine."""
    flight: FlightSection = FlightSection()
    """Settings of the flight build."""
    catalog: str = "hipparcos"
    """Catalogue of guide stars."""
    magnitude_limit: FiniteFloat = 6.5
    """Faintest guide star."""
    detector: str = "components"
    """``components``, ``region_growing``, ``clustering``, ``round_regions`` or ``first_regions``."""
    centroider: str = "moment"
    """``moment``, ``weighted_moment``, ``least_squares`` or ``maximum_likelihood``."""
    identifier: str = "adaptive"
    """``adaptive``, ``match_groups``, ``pyramid``, ``pattern_hash`` or ``triads``."""
    estimator: str = "field_fit"
    """``field_fit``, ``svd``, ``davenport``, ``quest``, ``esoq2``, ``triad``, ``star_pair`` or ``plate_constants``."""
    prior: bool = True
    """Give the tracker the attitude of the other sensors, with an error of up to `pointing.error_deg`; false: lost in
    space."""
    detection: DetectionSettings = DetectionSettings()
    """Settings of the detection."""
    centroid: CentroidSettings = CentroidSettings()
    """Settings of the centroiding."""
    identification: AnyIdentificationSettings = AnyIdentificationSettings()
    """Settings of the identification; settings that the `identifier` does not use are reported as errors."""
    catalogue_errors: CatalogueErrors = CatalogueErrors()
    """Errors of the tracker's catalogue relative to the sky."""
    in_flight_calibration: InFlightSettings = InFlightSettings()
    """Calibration in flight, in sequences."""


class StudySection(Section):
    """The Monte Carlo run."""

    trials: Count = 500
    """Number of frames."""
    sampling: Literal["mission_year", "orbit", "span", "sky"] = "mission_year"
    """``mission_year``: times distributed over a year; ``orbit``: over one orbit, or one rotation of a spinning body;
    ``span``: from the epoch to the end of an ephemeris, the default of a file whose orbit or attitude is that of
    another file; ``sky``: random attitudes at the epoch."""
    sky_without_earth: bool = True
    """With `sampling: sky` and no `pointing.target`: omit the Earth, which would occult a third of the sky; it then
    neither occults stars nor emits light. False: as set by `sky.earth`."""


class ScenarioModel(Section):
    """A complete scenario."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    """Name; also the name of the default output folder."""
    description: str = ""
    """Short description for the report."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    """Seed of all random streams."""
    epoch: Annotated[datetime, AfterValidator(_utc)]
    """Start of the mission, UTC, ISO 8601."""
    orbit: OrbitParameters = OrbitParameters()
    """The orbit."""
    pointing: PointingParameters = PointingParameters()
    """Mounting and attitude."""
    sky: Sky = Sky()
    """The sky."""
    tether: Tether = Tether()
    """A tether in front of the camera; none without a diameter."""
    optics: OpticsSection
    """The lens."""
    detector: DetectorSection
    """The detector."""
    environment: Environment = Environment()
    """Radiation along the orbit, and ageing by it."""
    tracker: TrackerSection = TrackerSection()
    """The tracker."""
    study: StudySection = StudySection()
    """The study."""
    sequence: SequenceSection = SequenceSection()
    """The sequence of ``run --sequence``."""
    heads: tuple[HeadSection, ...] = ()
    """Several cameras, whose attitudes the sequence fuses with the gyro; a list. Each has its own values of lens,
    detector and tracker where it states them, and otherwise those of the scenario. The first head is the reference: the
    fused attitude is given in its axes. Without heads the spacecraft has the one camera of the scenario."""
    specification: SpecificationSection = SpecificationSection()
    """Required performance."""
    allow_unphysical: bool = False
    """Permit unphysical values; the report lists them."""


LIMITS: dict[type, dict[str, Any]] = {
    KeplerianElements: {
        "semi_major_axis_km": Positive | None,
        "eccentricity": Annotated[float, Field(ge=0, lt=1)],
        "inclination_deg": Annotated[float, Field(ge=0, le=180)],
    },
    ForceModel: {"zonal_degree": Annotated[int, Field(ge=0, le=6)]},
    OrbitParameters: {
        "inclination_deg": Annotated[float, Field(ge=0, le=180)] | Literal["auto"],
        "ltan_h": Annotated[float, Field(ge=0, lt=24)] | None,
        "propagator": Literal["auto", "j2", "sgp4", "kepler", "numerical"],
        "max_age_days": Positive,
    },
    Spin: {
        "axis_deg": tuple[float, Annotated[float, Field(ge=-90, le=90)]],
        "cone_deg": Annotated[float, Field(ge=0, lt=90)],
        "inertia_ratio": Annotated[float, Field(gt=0, le=2)],
    },
    PointingParameters: {"error_deg": Annotated[float, Field(ge=0, le=180)]},
    Jitter: {
        "rms_arcsec": tuple[NonNegative, NonNegative, NonNegative],
        "psd": Literal["white", "lorentz", "table"],
        "corner_hz": Positive,
        "axes": Literal["camera", "body"],
    },
    Waypoint: {"dec_deg": Annotated[float, Field(ge=-90, le=90)]},
    Waypoints: {"max_rate_deg_s": Positive, "acceleration_deg_s2": Positive},
    GroundTarget: {
        "latitude_deg": Annotated[float, Field(ge=-90, le=90)],
        "longitude_deg": Annotated[float, Field(ge=-180, le=360)],
        "height_km": Annotated[FiniteFloat, Field(ge=-12, le=1e6)],
    },
    Track: {"direction_deg": tuple[float, Annotated[float, Field(ge=-90, le=90)]]},
    RatePoint: {"at_s": NonNegative},
    Slew: {"max_rate_deg_s": Positive, "acceleration_deg_s2": Positive, "start_s": NonNegative},
    Gyro: {
        "angle_random_walk_deg_sqrt_h": Positive,
        "bias_deg_h": NonNegative,
        "bias_instability_deg_h": NonNegative,
        "bias_time_s": Positive,
        "scale_factor_ppm": Annotated[float, Field(ge=0, le=200_000)],
    },
    Sky: {
        "faint_magnitude_limit": Annotated[FiniteFloat, Field(le=FAINTEST_V)] | None,
        "background_s10": NonNegative,
        "background_model": Literal["constant", "leinert1998"],
        "earth_albedo": Fraction,
    },
    SatelliteSize: {
        "diameter_m": Positive | None,
        "albedo": Fraction | None,
        "standard_magnitude": FiniteFloat | None,
    },
    SatelliteParameters: {
        "diameter_m": Positive,
        "albedo": Fraction,
        "standard_magnitude": FiniteFloat | None,
        "max_age_days": Positive,
    },
    Tether: {"diameter_mm": NonNegative, "albedo": Fraction},
    FieldAberrations: {
        "rings": Annotated[int, Field(ge=1, le=32)],
        "azimuths": Annotated[int, Field(ge=4, le=64)],
    },
    PsfModel: {"sigma_px": Positive | None, "first_dark_ring_px": Positive | None, "wavelength_nm": Positive},
    CalibrationResidual: {"rms_px": NonNegative, "order": Annotated[int, Field(ge=2, le=16)]},
    IntraPixel: {"contrast": Fraction},
    Vignetting: {
        "mechanical_start_deg": Annotated[float, Field(ge=0, lt=180)],
        "mechanical_end_deg": Annotated[float, Field(gt=0, lt=180)] | None,
    },
    Ghost: {"flux": Fraction, "radius_px": Positive},
    CosmicRays: {"rate_cm2_s": NonNegative, "depth_um": Positive, "charge_e_um": Positive},
    DisplacementDamage: {"interactions_per_pixel": NonNegative, "dark_e_s": NonNegative},
    RandomTelegraph: {"pixel_fraction": Fraction, "dark_e_s": NonNegative, "low_s": Positive, "high_s": Positive},
    Environment: {
        "shield_mm": Annotated[FiniteFloat, Field(ge=0.1, le=100)],
        "age_years": Annotated[FiniteFloat, Field(ge=0, le=100)],
        "solar_proton_events": Annotated[FiniteFloat, Field(ge=0, le=20)],
        "depletion_um": Annotated[FiniteFloat, Field(gt=0, le=1000)],
        "dark_per_krad_e_s": NonNegative,
        "glass_path_mm": NonNegative,
        "glass_shield_mm": Annotated[FiniteFloat, Field(ge=0.1, le=100)],
    },
    Intensifier: dict.fromkeys(("gain", "gain_variance", "phosphor_sigma_px", "dark_e_s"), NonNegative),
    TimeTag: {"jitter_s": NonNegative},
    CatalogueErrors: {"position_mas": NonNegative, "proper_motion_mas_yr": NonNegative},
    Video: {"noise_dn": NonNegative, "line_blur_px": NonNegative},
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
    InFlightSettings: {
        **dict.fromkeys(("focal_length_ppm", "principal_point_px", "distortion_px", "psf_width_px"), Positive),
        **dict.fromkeys(("focal_length_drift_ppm_sqrt_h", "principal_point_drift_px_sqrt_h"), NonNegative),
        **dict.fromkeys(("distortion_drift_px_sqrt_h", "psf_width_drift_px_sqrt_h"), NonNegative),
        **dict.fromkeys(("field_px", "star_error_px", "shift_px"), NonNegative),
        "false_rejection": Annotated[FiniteFloat, Field(gt=0, lt=1)],
        "defect_frames": Annotated[int, Field(ge=0)],
        "defect_share": Annotated[FiniteFloat, Field(gt=0, le=1)],
        "defect_sigma": Positive,
        "defect_shift_px": Positive,
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
"""Types with limits of the keys of plain classes, where they differ from the annotation."""
