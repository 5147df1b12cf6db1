"""Stray light of the Sun, the Moon and the Earth outside the field through a baffle.

Off by default: without `optics.baffle.pst` in the scenario there is no stray light, as for a perfect baffle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.curves import read_points
from startracker.core import FloatArray
from startracker.files import CURVE_BYTES, read_text

BEYOND_EXCLUSION_PST = 1e-9
"""Point-source transmittance of ``vane`` outside its exclusion angle: attenuations "on the order of 10⁹ for angles
larger than the pre-defined exclusion angle" (Haghshenas & Johari 2014, Proc. SPIE 9264, 92641R); Donati 1990 (Proc.
SPIE 1165) requires "approximately 10⁻⁹" of a baffle for stars of V = 6."""

IN_FIELD_PST = 1e-3
"""Point-source transmittance of ``vane`` on the boresight, at the start of its slope: assumed, scatter and ghosts of a
clean lens. A tracker is not required to work inside the exclusion angle."""


@dataclass(frozen=True, eq=False)
class Baffle:
    """Point-source transmittance over the angle from the boresight, and the exclusion angles."""

    angle_rad: FloatArray
    """(N,): Angles from the boresight, ascending from 0."""
    pst: FloatArray
    """(N,): Point-source transmittance; its logarithm is interpolated linearly, and it is zero beyond the last
    angle."""
    exclusion_rad: dict[str, float]
    """Exclusion angle by name of body (``Sun``, ``Moon``, ``Earth``), within which no performance is required."""

    def transmittance(self, angle_rad: ArrayLike) -> FloatArray:
        """Irradiance on the detector over irradiance by the same source on the aperture at normal incidence."""
        angle = np.asarray(angle_rad, dtype=float)
        # Measured and modelled curves fall by decades; between their points the logarithm is nearly linear.
        value = np.exp(np.interp(angle, self.angle_rad, np.log(self.pst)))
        return np.asarray(np.where(angle <= self.angle_rad[-1], value, 0.0))

    def within_exclusion(self, names: Iterable[str], boresight: ArrayLike, directions: ArrayLike) -> list[str]:
        """Names of the bodies of which any part (for the Earth any lit element) is within its exclusion angle.

        Parameters
        ----------
        names : (N,) str
            From `simulator.sky.earth.stray_sources`, as are `directions`.
        boresight : array_like, shape (3,)
            Unit vector, in the axes of the directions.
        directions : array_like, shape (N, 3)
            Unit vectors.
        """
        angle = _off_axis(boresight, directions)
        found = {
            str(name) for name, off in zip(names, angle, strict=True) if off < self.exclusion_rad.get(str(name), 0.0)
        }
        return sorted(found)


def build_baffle(
    pst: str | None,
    sun_exclusion_deg: float,
    moon_exclusion_deg: float,
    earth_exclusion_deg: float,
    base_dir: str | Path | None = None,
) -> Baffle | None:
    """Baffle of a scenario; None, and so no stray light, if `pst` is None.

    ``pst: vane`` is a model: log PST falls linearly with the angle from 10⁻³ on the boresight to 10⁻⁹ at the Sun's
    exclusion angle, is constant to 90° and zero beyond. Anything else is a CSV file with the header ``angle_deg,pst``,
    ascending angles from 0 and values above 0 and up to 1; lines that start with ``#`` are comments.

    Parameters
    ----------
    pst : str or None
        Point-source transmittance: ``vane`` or a CSV file.
    sun_exclusion_deg, moon_exclusion_deg, earth_exclusion_deg : float
        Exclusion angles.
    base_dir : path, optional
        Base folder of a relative path.

    Raises
    ------
    InputError
        For a missing or invalid file (with its line).
    """
    if pst is None:
        return None
    exclusion = {
        "Sun": math.radians(sun_exclusion_deg),
        "Moon": math.radians(moon_exclusion_deg),
        "Earth": math.radians(earth_exclusion_deg),
    }
    if pst == "vane":
        points = [(0.0, IN_FIELD_PST), (sun_exclusion_deg, BEYOND_EXCLUSION_PST), (90.0, BEYOND_EXCLUSION_PST)]
        table = np.array(points)
    else:
        path = Path(base_dir or ".") / pst
        text = read_text(path, CURVE_BYTES, "optics.baffle.pst is 'vane' or a CSV file angle_deg,pst")
        table = read_points(text, str(path), "angle_deg,pst", "an angle and a transmittance", _fault)
    return Baffle(np.radians(table[:, 0]), table[:, 1], exclusion)


def stray_light_e_s_pixel(
    baffle: Baffle | None,
    boresight: ArrayLike,
    directions: ArrayLike,
    rate_e_s: ArrayLike,
    aperture_area_cm2: float,
    pixel_area_cm2: float,
) -> float:
    """Electrons per second in every pixel from sources outside the field.

    The rate is Σ PST(θᵢ) · (Nᵢ/A) · a. Nᵢ are the electrons per second of source i if the camera pointed at it, and A
    is the area of the aperture, so that Nᵢ/A is the irradiance on the aperture (in electrons, transmission and quantum
    efficiency included); a is the area of a pixel. PST is the usual ratio of the mean irradiance on the detector to
    that on the aperture at normal incidence (Breault in the *Handbook of Optics*; ECSS-E-HB-60-10), here without the
    transmission of the lens, which N already contains. The light is uniform over the detector; real stray light has
    gradients and ghosts.

    Parameters
    ----------
    baffle : Baffle or None
        None: no stray light, 0.
    boresight : array_like, shape (3,)
        Unit vector, in the axes of the directions.
    directions : array_like, shape (N, 3)
        Sources, unit vectors (`simulator.sky.earth.stray_sources`).
    rate_e_s : array_like, shape (N,)
        Their electrons per second through the whole aperture (`Photometer.electrons_per_s`).
    aperture_area_cm2, pixel_area_cm2 : float
        Areas of the entrance pupil and of a pixel.
    """
    if baffle is None:
        return 0.0
    share = baffle.transmittance(_off_axis(boresight, directions))
    return float(share @ np.asarray(rate_e_s, dtype=float)) / aperture_area_cm2 * pixel_area_cm2


def _off_axis(boresight: ArrayLike, directions: ArrayLike) -> FloatArray:
    cosine = np.asarray(directions, dtype=float).reshape(-1, 3) @ np.asarray(boresight, dtype=float)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _fault(angle_deg: float, pst: float, before: float | None) -> str:
    ascending = angle_deg == 0.0 if before is None else angle_deg > before
    if not (ascending and angle_deg <= 180.0):
        return f"angles must be ascending from 0 to at most 180 degrees; found {angle_deg:g}"
    return "" if 0.0 < pst <= 1.0 else f"a transmittance lies above 0 and up to 1; found {pst:g}"
