"""Sky coverage: number of stars in the field, over the whole sky or along a mission's path.

The counts at the attitudes of `simulator.study.coverage.boresights` give minima, percentiles and the availability,
which is the fraction of the sky or of the time with at least k stars.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa

from simulator.build import build_camera
from simulator.mission.clock import Clock
from simulator.scenario import Scenario
from simulator.study.coverage.boresights import (
    Boresights,
    Exclusion,
    along_path,
    everything_excluded,
    exclusion_of,
    exclusion_text,
    whole_sky,
)
from simulator.study.coverage.field_counts import circle, count_by_level, outline, solid_angle_sr
from simulator.study.coverage.prediction import left_out, predict
from simulator.study.coverage.sensitivity import build_sensitivity
from simulator.study.specification.verdicts import Judgement, judge
from startracker._version import __version__
from startracker.catalog import load_catalog
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.guide import RESOLVED_PX
from startracker.catalog.sky_view import FieldShape, voxel_grid
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.display import fields_repr
from startracker.errors import InputError

PERCENTILES = (0.1, 1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0)
MOST_STARS_ASKED = 12
_STARS_OF_ATTITUDE = 5
"""Stars that an attitude needs in the predicted verdict, as in `study design` by default."""
_MINIMA_LISTED = 20
_CURVE_STEP_MAG = 0.25
_BLEND_MAG = 0.8
"""Two merged stars of equal brightness are 0.75 mag brighter than one."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Stars in a field at many attitudes."""

    name: str
    """Name of the scenario."""
    boresights: Boresights
    """The N attitudes."""
    shape: FieldShape
    """The field."""
    magnitude_limit: float
    """Magnitude limit of the counts, V."""
    limit_reason: str
    """Origin of this limit."""
    counts: IntArray
    """(N,): Stars in the field."""
    limits: FloatArray
    """(L,): Magnitude limits of the curve, ascending."""
    curve: IntArray
    """(N, L): Stars in the field down to each of them."""
    sky_stars: int
    """Stars down to `magnitude_limit` over the whole sky."""
    exclusion: Exclusion = field(default_factory=Exclusion)
    """Exclusion angles."""
    judgement: Judgement | None = None
    """Predicted verdicts on the specification, where no exclusion angle is violated; None if the field or the stars are
    not the camera's own."""
    left_out: tuple[str, ...] = ()
    """What the scenario contains and the prediction does not."""

    __repr__ = fields_repr

    @property
    def allowed_counts(self) -> IntArray:
        """Counts at the attitudes that violate no exclusion angle."""
        return self.counts[self.boresights.allowed]

    def availability(self, stars: int) -> float:
        """Fraction of the sky or of the time with at least this number of stars and no exclusion angle violated."""
        return float(np.mean((self.counts >= stars) & self.boresights.allowed))

    def excluded_texts(self) -> list[str]:
        """What excludes attitudes: fraction, body, angle and its source."""
        what = "time" if self.boresights.kind == "path" else "sky"
        return [
            f"{100 * broken.mean():.2f} % of the {what} excluded by the {body.title()}, "
            + exclusion_text(body, getattr(self.exclusion, f"{body}_deg"), self.exclusion.sources.get(body, "as given"))
            for body, broken in self.boresights.excluded.items()
        ]

    def poorest(self) -> IntArray:
        """Attitudes with the fewest stars among those that violate no exclusion angle."""
        allowed = np.flatnonzero(self.boresights.allowed)
        return allowed[self.counts[allowed] == self.counts[allowed].min()] if len(allowed) else allowed

    def summary(self) -> dict[str, Any]:
        """What ``coverage.json`` holds."""
        looks, counts = self.boresights, self.allowed_counts
        area = solid_angle_sr(self.shape)
        poorest = self.poorest()
        ra, dec, roll = looks.ra_deg, looks.dec_deg, looks.roll_deg
        listed = poorest[:: max(1, math.ceil(len(poorest) / _MINIMA_LISTED))]
        some = len(counts) > 0
        return {
            "name": self.name,
            "version": __version__,
            "over": "time along the mission's path" if looks.kind == "path" else "the whole sky",
            "attitudes": len(looks),
            "rolls_per_direction": looks.rolls,
            "field_sr": area,
            "field_deg2": area / math.radians(1.0) ** 2,
            "magnitude_limit": self.magnitude_limit,
            "magnitude_limit_from": self.limit_reason,
            "stars_over_sky": self.sky_stars,
            "stars_if_spread_evenly": self.sky_stars * area / (4.0 * math.pi),
            "exclusion_deg": {body: getattr(self.exclusion, f"{body}_deg") for body in ("sun", "moon", "earth")},
            "exclusion_from": dict(self.exclusion.sources),
            "excluded_share": {body: float(np.mean(broken)) for body, broken in looks.excluded.items()},
            "excluded_share_any": float(np.mean(~looks.allowed)),
            "specification": self.judgement.by_name() if self.judgement else {},
            "verdict": self.judgement.to_dict() if self.judgement else None,
            "left_out": list(self.left_out),
            "stars": {
                "mean": float(counts.mean()) if some else None,
                "std": float(counts.std(ddof=1)) if len(counts) > 1 else None,
                "min": int(counts.min()) if some else None,
                "max": int(counts.max()) if some else None,
                "percentiles": {
                    f"p{p:g}": float(np.percentile(counts, p, method="inverted_cdf")) if some else None
                    for p in PERCENTILES
                },
            },
            "poorest_attitudes": len(poorest),
            "poorest": [
                {
                    "ra_deg": round(float(ra[i]), 4),
                    "dec_deg": round(float(dec[i]), 4),
                    "roll_deg": round(float(roll[i]), 4),
                }
                for i in listed
            ],
            "availability": {str(k): self.availability(k) for k in range(1, MOST_STARS_ASKED + 1)},
            "availability_where_allowed": {
                str(k): float(np.mean(counts >= k)) if some else None for k in range(1, MOST_STARS_ASKED + 1)
            },
            "magnitude_curve": [
                {"magnitude_limit": float(limit), **_curve_point(self.curve[looks.allowed, j])}
                for j, limit in enumerate(self.limits)
            ],
        }

    def to_table(self, scenario: Scenario) -> pa.Table:
        """One row per attitude: ``coverage.parquet``."""
        looks = self.boresights
        columns: dict[str, Any] = {"index": np.arange(len(looks))}
        if looks.kind == "path":
            clock = Clock(scenario.epoch)
            columns |= {"t_s": looks.t_s, "utc": [clock.isot(float(t)) for t in looks.t_s]}
        columns |= {"ra_deg": looks.ra_deg, "dec_deg": looks.dec_deg, "roll_deg": looks.roll_deg, "stars": self.counts}
        columns |= {f"excluded_{body}": broken for body, broken in looks.excluded.items()}
        return pa.table(columns)


def count_stars(
    stars: StarCatalog, shape: FieldShape, boresights: Boresights, limits: FloatArray, epoch_jyear: float = 2000.0
) -> IntArray:
    """Stars in the field down to each of L ascending magnitude limits, (N, L).

    Parameters
    ----------
    stars : StarCatalog
        Any catalogue; stars fainter than the last limit are not counted.
    shape : FieldShape
        Outline of the field.
    boresights : Boresights
        N attitudes.
    limits : (L,) array
        V, ascending.
    epoch_jyear : float
        Epoch of the star positions.
    """
    chosen = stars.brighter_than(float(limits[-1]))
    if len(chosen) == 0:
        return np.zeros((len(boresights), len(limits)), np.int64)
    directions = chosen.directions(epoch_jyear)
    by_level = count_by_level(
        boresights.matrices,
        directions,
        voxel_grid(directions),
        shape,
        np.searchsorted(limits, chosen.v_mag),
        len(limits),
        np.ascontiguousarray(boresights.nadir),
        boresights.limb_cosine,
    )
    return np.asarray(np.cumsum(by_level, axis=1))


def coverage(
    scenario: Scenario,
    count: int = 10_000,
    *,
    path: bool = False,
    rolls: int = 1,
    magnitude_limit: float | None = None,
    snr: float | None = None,
    circle_deg: float | None = None,
    exclusion: Exclusion | None = None,
) -> Coverage:
    """Stars in a scenario's field over the sky or along its path.

    Parameters
    ----------
    scenario : Scenario
        Its camera defines the field, its tracker's catalogue the stars; doubles closer than two pixels are merged.
    count : int
        Directions over the sky, or instants along the path.
    path : bool
        Along the mission's path, at the instants of its trials, instead of the whole sky.
    rolls : int
        Over the sky: rolls per direction.
    magnitude_limit : float, optional
        Faintest V counted; by default the faintest in the tracker's catalogue that the camera detects
        (`simulator.study.coverage.sensitivity`).
    snr : float, optional
        Minimum signal-to-noise ratio of a detected star; by default the tracker's threshold.
    circle_deg : float, optional
        A circular field of this radius instead of the camera's.
    exclusion : Exclusion, optional
        Exclusion angles; by default those of the specification, otherwise of the scenario's baffle, if any.

    Raises
    ------
    InputError
        For invalid values, or a scenario without a path.
    """
    if circle_deg is not None and not 0.0 < circle_deg <= 180.0:
        raise InputError(f"circle: the radius must be above 0 and at most 180 degrees, not {circle_deg:g}")
    if magnitude_limit is not None and not math.isfinite(magnitude_limit):
        raise InputError(f"magnitude limit: must be a number, not {magnitude_limit}")
    camera = build_camera(scenario)
    angles = exclusion or exclusion_of(scenario)
    looks = along_path(scenario, count, angles) if path else whole_sky(count, rolls, scenario, angles)
    own_stars = magnitude_limit is None and snr is None and circle_deg is None
    limit, reason = _limit(scenario, magnitude_limit, snr)
    every = load_catalog(scenario.tracker.catalog)
    top = _CURVE_STEP_MAG * math.ceil(max(limit + 1.0, 6.0) / _CURVE_STEP_MAG)
    deep = every.brighter_than(top + _BLEND_MAG)
    stars = merge_doubles(deep, min(RESOLVED_PX * camera.pixel_rad, 0.1)) if len(deep) else deep
    shape = outline(camera) if circle_deg is None else circle(circle_deg)
    grid = np.arange(2.0, top + 0.5 * _CURVE_STEP_MAG, _CURVE_STEP_MAG)
    limits = np.unique(np.append(grid, limit))
    counts = count_stars(stars, shape, looks, limits, float(Clock(scenario.epoch).jyear(0.0)))
    return Coverage(
        name=scenario.name,
        boresights=looks,
        shape=shape,
        magnitude_limit=limit,
        limit_reason=reason,
        counts=counts[:, int(np.searchsorted(limits, limit))],
        limits=limits,
        curve=counts,
        sky_stars=len(stars.brighter_than(limit)),
        exclusion=angles,
        judgement=_predicted(scenario, looks, angles) if own_stars else None,
        left_out=left_out(scenario) if own_stars else (),
    )


def _predicted(scenario: Scenario, looks: Boresights, angles: Exclusion) -> Judgement:
    evidence = predict(scenario, looks, _STARS_OF_ATTITUDE).evidence
    judged = judge(evidence.specification, evidence)
    return judged if looks.allowed.any() else replace(judged, untested=(everything_excluded(looks, angles),))


def _limit(scenario: Scenario, given: float | None, snr: float | None) -> tuple[float, str]:
    """Magnitude limit, and where it comes from."""
    if given is not None:
        return given, "given"
    detected = build_sensitivity(scenario, snr).magnitude_limit
    known = scenario.tracker.magnitude_limit
    if detected < known:
        return detected, "the camera's detection limit"
    return known, f"tracker.magnitude_limit (the camera detects stars to V = {detected:.2f})"


def _curve_point(counts: IntArray) -> dict[str, float | int | None]:
    if len(counts) == 0:
        return dict.fromkeys(("mean", "min", "p0.1", "p1", "max"))
    low, one = np.percentile(counts, [0.1, 1.0], method="inverted_cdf")
    return {
        "mean": float(counts.mean()),
        "min": int(counts.min()),
        "p0.1": float(low),
        "p1": float(one),
        "max": int(counts.max()),
    }
