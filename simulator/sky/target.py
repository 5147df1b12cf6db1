"""What a camera is told to hold: a direction, a star by name or number, a body of the solar system."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulator.scenario.schema import PointingSection
from simulator.sky.solar_system import RADIUS_KM, Bodies
from startracker.attitude import Attitude, direction_to_radec
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError

FloatArray = NDArray[np.float64]


def find_target(name: str, catalog: StarCatalog) -> str | int:
    """Name of a body, or row of a star in the catalogue, of what a user wrote.

    Capitals and spaces do not matter; ``HIP 32349``, ``HR 2491`` and a bare number are the catalogue's own numbers.

    Raises
    ------
    InputError
        When there is neither a body nor a star of that name.
    """
    wanted = "".join(name.split()).casefold()
    for body in RADIUS_KM:
        if body.casefold() == wanted:
            return body
    names = np.char.replace(np.char.lower(catalog.star_name.astype(str)), " ", "")
    rows = np.flatnonzero(names == wanted)
    number = wanted.removeprefix("hip" if catalog.name == "hipparcos" else "hr")
    if not len(rows) and number.lstrip("-").isdecimal():
        rows = np.flatnonzero(catalog.id == int(number))
    if not len(rows):
        raise InputError(
            f"pointing.target: '{name}' is no body ({', '.join(RADIUS_KM)}) and no star of the catalogue "
            f"{catalog.name} within sky.magnitude_limit; write a name such as 'Alp CMa' or '33 Psc', or RA, Dec, roll"
        )
    return int(rows[np.argmin(catalog.v_mag[rows])])


def attitude_towards(direction: FloatArray, section: PointingSection) -> Attitude:
    """Camera attitude (ICRS → camera) that puts a direction (3,) at the section's offset from the boresight."""
    ra, dec = (math.degrees(float(angle)) for angle in direction_to_radec(direction))
    centred = Attitude.from_radec_roll(ra, dec, section.target_roll_deg)
    x, y = (math.tan(math.radians(angle)) for angle in section.target_offset_deg)
    seen = np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    # the smallest turn of the camera that moves the target from the boresight to `seen`
    axis = np.cross([0.0, 0.0, 1.0], seen)
    sine = float(np.linalg.norm(axis))
    vector = -axis / sine * math.asin(sine) if sine > 0.0 else np.zeros(3)
    return Attitude.from_rotation_vector(vector, "camera", "camera") @ centred


def body_direction(name: str, bodies: Bodies) -> FloatArray:
    """Apparent direction (3,) of a body; `InputError` where the scenario draws no bodies."""
    found = np.flatnonzero(bodies.name == name)
    if not len(found):
        raise InputError(f"pointing.target: {name} is not drawn; set sky.planets: true")
    return np.asarray(bodies.direction[found[0]])
