"""Frame and truth.

`Frame` has only what is known on board: the image, the calibrated camera, the time, position and velocity of the
spacecraft, and the attitude of its other sensors. `FrameTruth` is a separate object, which the tracker never receives.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.display import described, html_card, quantity_range
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.images.picture import photograph
from startracker.observer import Observer


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure as known on board."""

    image: NDArray[np.generic]
    """(height, width): Digital numbers: uint16, or float64 if the scenario has no converter."""
    camera: Camera
    """The calibrated camera."""
    observer: Observer
    """Epoch of mid-exposure, barycentric position and velocity."""
    utc: str
    """Mid-exposure as stated by the camera, UTC, ISO 8601."""
    exposure_s: float
    """Exposure time."""
    saturation_dn: float
    """Digital number at saturation."""
    gain_e_per_dn: float
    """Electrons per digital number."""
    offset_dn: float
    """Digital number of a pixel without charge."""
    read_noise_e: float
    """Standard deviation of the read noise. Like the three values above it is from the calibration on the ground."""
    prior: Attitude | None = None
    """Attitude from other sensors."""
    prior_deg: float = 0.0
    """Half width of the uniform error of the prior about each axis."""
    scenario: str = ""
    """Name of the scenario; with `seed` and `index` sufficient to reproduce the frame."""
    seed: int = 0
    """Seed of the scenario."""
    index: int = 0
    """Index of the trial."""
    parameters: dict[str, float | int | str | bool] = field(default_factory=dict)
    """Every key of the scenario's camera, for the file header."""

    def __repr__(self) -> str:
        height, width = self.image.shape
        origin = f"{self.scenario} #{self.index}" if self.scenario else ""
        size = f"{width}×{height} px, {self.camera.fov_deg:.2f}° × {self.camera.fov_y_deg:.2f}°"
        return described("Frame", origin, size, f"{self.utc} UTC", f"exposure {self.exposure_s:g} s")

    def _repr_html_(self) -> str:
        """The image and a table of the values known on board, for notebooks."""
        height, width = self.image.shape
        camera = self.camera
        rows = {
            "scenario": f"{self.scenario}, index {self.index}, seed {self.seed}",
            "time": f"{self.utc} UTC",
            "exposure": f"{self.exposure_s:g} s",
            "field of view": f"{camera.fov_deg:.2f}° × {camera.fov_y_deg:.2f}°, {width}×{height} px",
            "gain": f"{self.gain_e_per_dn:.3g} e⁻/DN, read noise {self.read_noise_e:.3g} e⁻",
            "saturation": f"{self.saturation_dn:g} DN",
            "prior": f"{self.prior!r} to {self.prior_deg:g}°" if self.prior else "none",
        }
        return html_card("Frame", rows, photograph(self.image, f"frame of {self.scenario}"))


@dataclass(frozen=True, eq=False)
class TrueSources:
    """Stars and bodies in or near the field, as columns of equal length N."""

    id: NDArray[np.int64]
    """Catalogue number of a star or a satellite; 0 for bodies of the solar system."""
    name: NDArray[np.str_]
    """Star, body or satellite."""
    kind: NDArray[np.str_]
    """``star``, ``planet``, ``moon``, ``sun`` or ``satellite``."""
    xy: FloatArray
    """(N, 2): Pixel at mid-exposure for the true attitude."""
    image_xy: FloatArray
    """(N, 2): Mean of the rendered path over the exposure, which is the photocentre of the image. With a rolling
    shutter it is the mean over the exposure of the source's own rows. It differs from `xy` if the path is curved, or if
    these rows are exposed earlier or later than the middle one."""
    direction: FloatArray
    """(N, 3): Apparent direction, ICRS axes."""
    v_mag: FloatArray
    """(N,): V magnitude."""
    b_v: FloatArray
    """(N,): Colour index B − V."""
    electrons: FloatArray
    """(N,): Mean photo-electrons over the exposure."""
    variable: NDArray[np.bool_]
    """(N,): Whether the catalogue lists the star as variable (it is rendered with the catalogue's V); False for
    bodies."""

    def __len__(self) -> int:
        return len(self.id)

    def __repr__(self) -> str:
        kinds = zip(*np.unique(self.kind, return_counts=True), strict=True)
        content = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds)
        return described("TrueSources", content or "none", quantity_range("V", self.v_mag))

    @functools.cached_property
    def is_star(self) -> NDArray[np.bool_]:
        """Mask (N,) of stars."""
        return np.asarray(self.kind == "star")

    def joined(self, other: TrueSources) -> TrueSources:
        """These sources followed by others."""
        return TrueSources(*(np.concatenate([getattr(s, c.name) for s in (self, other)]) for c in fields(self)))

    def select(self, rows: NDArray[np.int64]) -> TrueSources:
        """Selection of sources by index array."""
        return TrueSources(**{column.name: getattr(self, column.name)[rows] for column in fields(self)})


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """True state at mid-exposure."""

    attitude: Attitude
    """ICRS to camera."""
    mounting: Attitude
    """True body to camera."""
    rate_camera_rad_s: FloatArray
    """(3,): Inertial angular velocity in camera axes."""
    t_s: float
    """Seconds after the scenario's epoch."""
    sources: TrueSources
    """All rendered sources on the detector."""
    mean_electrons: FloatArray | None = None
    """(height, width): Mean photo-electrons of sources and background, without noise and defects of the detector."""
    excluded: tuple[str, ...] = ()
    """Bodies within the baffle's exclusion angle."""
    time_tag_error_s: float = 0.0
    """Stated minus true time of mid-exposure."""
    particles_cm2_s: float = 0.0
    """Rate of charged particles through the surface of the detector."""
    mounting_rotation_rad: FloatArray | None = None
    """(3,): Thermo-elastic rotation vector of the mounting, camera axes, which `mounting` contains; None if there is
    none."""

    @property
    def attitude_at_tag(self) -> Attitude:
        """True attitude at the stated time, extrapolated at constant rate.

        Errors of an attitude are measured against it, because the tracker can only know the stated time. Orbital motion
        and the change of aberration during the error of the time are neglected (0.01″ in 1 s).
        """
        if self.time_tag_error_s == 0.0:
            return self.attitude
        turn = self.rate_camera_rad_s * self.time_tag_error_s
        return Attitude.from_rotation_vector(turn, "camera", "camera") @ self.attitude

    def __repr__(self) -> str:
        rate = f"{np.degrees(np.linalg.norm(self.rate_camera_rad_s)):.3g}°/s"
        excluded = f"excluded: {' '.join(self.excluded)}" if self.excluded else ""
        return described("FrameTruth", repr(self.attitude), rate, repr(self.sources), excluded)
