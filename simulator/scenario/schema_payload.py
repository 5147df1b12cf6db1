"""Sections of a scenario for a spinning payload: its motion, and the tether before its camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat

from simulator.scenario.schema_base import Fraction, NonNegative, Section, Vector3


class SpinSection(Section):
    """Free spin of a body with two equal moments of inertia: its axis of symmetry, body +Z, cones about the angular
    momentum, which stands still."""

    rate_deg_s: FiniteFloat = 0.0
    """Angular velocity about body +Z; 0: no spin, the body holds the local level or `pointing.target`."""
    axis_deg: tuple[FiniteFloat, Annotated[FiniteFloat, Field(ge=-90, le=90)]] = (0.0, 90.0)
    """Right ascension and declination of the axis that stands still (ICRS)."""
    phase_deg: FiniteFloat = 0.0
    """Turn of the body about its +Z at the epoch, from where, with `cone_phase_deg` 0, its +X points east."""
    cone_deg: Annotated[FiniteFloat, Field(ge=0, lt=90)] = 0.0
    """Half angle of the cone on which +Z goes about that axis."""
    cone_phase_deg: FiniteFloat = 0.0
    """Where on the cone +Z is at the epoch: its position angle, north through east, from the axis."""
    inertia_ratio: Annotated[FiniteFloat, Field(gt=0, le=2)] = 0.1
    """Moment of inertia about +Z over that across it: below 1 a rod, above a disk. The cone turns this many times as
    fast as the body (over the cosine of `cone_deg`)."""


class TetherSection(Section):
    """A straight, matt tether that is fixed to the camera, in the light of Sun and Moon."""

    diameter_mm: NonNegative = 0.0
    """Diameter; 0: none."""
    near_m: Vector3 = (0.0, 0.0, 1.0)
    """Its near end in camera axes: along columns, along rows, ahead."""
    far_m: Vector3 = (0.0, 0.0, 1000.0)
    """Its far end."""
    albedo: Fraction = 0.5
    """Share of the light that it scatters, in all directions alike (Lambert)."""
