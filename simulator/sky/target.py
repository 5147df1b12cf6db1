"""Pointing targets: a direction, a star by name or number, or a body of the solar system."""

from __future__ import annotations

import difflib
import math

import numpy as np

from simulator.constants import RADIUS_KM
from simulator.mission.parameters import PointingParameters
from simulator.sky.instants import Bodies
from startracker.catalog.names import designation_rows, proper_names
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, direction_to_radec


def find_target(name: str, catalog: StarCatalog) -> str | int:
    """Name of a body, or row of a star in the catalogue, for a user's input.

    Case and spaces are ignored. Stars are given by IAU proper name (``Sirius``), Bayer or Flamsteed designation
    (``Alp CMa``, ``33 Psc``), or catalogue number (``HIP 32349``, ``HR 2491``, or the number alone).

    Raises
    ------
    InputError
        If there is neither a body nor a star of that name; suggests the closest one.
    """
    wanted = _folded(name)
    for body in RADIUS_KM:
        if _folded(body) == wanted:
            return body
    # A proper name leads to a designation, and a designation to a row; anything else may be a catalogue number.
    proper = {_folded(proper): star for star, proper in proper_names().items()}
    designated = designation_rows(catalog)
    rows = {_folded(star): row for star, row in designated.items()}
    row = rows.get(_folded(proper.get(wanted, wanted)))
    if row is not None:
        return row
    number = wanted.removeprefix("hip" if catalog.name in ("hipparcos", "gaia") else "hr")
    if number.lstrip("-").isdecimal() and len(numbered := np.flatnonzero(catalog.id == int(number))):
        return int(numbered[0])
    known = {_folded(spelled): spelled for spelled in (*designated, *proper_names().values(), *RADIUS_KM)}
    close = difflib.get_close_matches(wanted, known, n=1)
    hint = f"did you mean '{known[close[0]]}'?" if close else "write a name such as Sirius, 'Alp CMa' or '33 Psc'"
    raise InputError(
        f"'{name}' is neither a body ({', '.join(RADIUS_KM)}) nor a star of {catalog.name} within "
        f"sky.magnitude_limit; {hint}"
    )


def _folded(name: str) -> str:
    """Name in normalised form for comparison: without spaces and case."""
    return "".join(name.split()).casefold()


def attitude_towards(direction: FloatArray, parameters: PointingParameters) -> Attitude:
    """Camera attitude (ICRS → camera) with a direction (3,) at the given offset from the boresight."""
    ra, dec = (math.degrees(float(angle)) for angle in direction_to_radec(direction))
    centred = Attitude.from_radec_roll(ra, dec, parameters.target_roll_deg)
    x, y = (math.tan(math.radians(angle)) for angle in parameters.target_offset_deg)
    seen = np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    # The smallest rotation of the camera that moves the target from the boresight to `seen`. The sign is negative
    # because a rotation of the camera moves the image the other way.
    axis = np.cross([0.0, 0.0, 1.0], seen)
    sine = float(np.linalg.norm(axis))
    vector = -axis / sine * math.asin(sine) if sine > 0.0 else np.zeros(3)
    return Attitude.from_rotation_vector(vector, "camera", "camera") @ centred


def body_direction(name: str, bodies: Bodies) -> FloatArray:
    """Apparent direction (3,) of a body; `InputError` if the scenario does not render bodies."""
    found = np.flatnonzero(bodies.name == name)
    if not len(found):
        far = " and sky.earth: true (within a million km it is not a body of the sky)" if name == "Earth" else ""
        raise InputError(f"pointing.target: {name} is not rendered; set sky.planets: true{far}")
    return np.asarray(bodies.direction[found[0]])
