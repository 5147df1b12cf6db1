"""Rules of the ``sequence`` section: contradictory keys, and sequences beyond the ephemeris."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

from simulator.mission.spinning import LARGEST_STEP_DEG
from simulator.scenario.errors import Violation, impossible

MOST_FRAMES = 1_000_000
EPHEMERIS = (datetime(1899, 7, 30, tzinfo=UTC), datetime(2053, 10, 8, tzinfo=UTC))
"""Range of DE421 (Folkner et al. 2009), less one day at each end."""


def contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of the ``sequence`` section."""
    points = v["sequence.rates"]
    for before, after in pairwise(points):
        if after.at_s <= before.at_s:
            message = f"points must be in order of time; {after.at_s:g} s comes after {before.at_s:g} s"
            yield impossible("sequence.rates", message)
            break
    step_s = v["sequence.step_s"]
    # Upper limit of the rate: the largest values of its three parts, whatever their directions.
    fastest = math.hypot(*v["pointing.rate_deg_s"])
    fastest += max((math.hypot(p.roll_deg_s, p.pitch_deg_s, p.yaw_deg_s) for p in points), default=0.0)
    if any(v["sequence.slew.turn_deg"]):
        fastest += v["sequence.slew.max_rate_deg_s"]
    # Scenarios that are not run as a sequence may rotate at any rate, so the rule applies only if the section itself
    # has rates or a slew.
    if fastest * step_s > LARGEST_STEP_DEG and (points or any(v["sequence.slew.turn_deg"])):
        message = f"{step_s:g} s at {fastest:g}°/s is more than {LARGEST_STEP_DEG:g}° per step; use a shorter step"
        yield impossible("sequence.step_s", message)
    if v["sequence.recording"] is not None and v["heads"]:
        yield impossible("sequence.recording", "has the motion of one camera, and the scenario has heads; remove one")
    yield from _operation_contradictions(v)
    frames, start_s = v["sequence.frames"], v["sequence.start_s"]
    if frames > MOST_FRAMES:
        yield impossible(
            "sequence.frames", f"{frames} exceeds the maximum of {MOST_FRAMES}, which is limited by memory"
        )
        return
    first, last = EPHEMERIS
    epoch = v["epoch"]
    span_s = (last - first).total_seconds()
    for key, at_s in (("sequence.start_s", start_s), ("sequence.frames", start_s + frames * step_s)):
        # The first condition keeps timedelta from overflowing.
        if not abs(at_s) < span_s or not first <= epoch + timedelta(seconds=at_s) <= last - timedelta(days=2):
            yield impossible(key, "the sequence leaves the ephemeris DE421 (1899 to 2053)")
            return


def _operation_contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Rules of operation that would oscillate or never act."""
    if not v["sequence.operation.use"]:
        return
    lengthen, shorten = v["sequence.operation.lengthen_below"], v["sequence.operation.shorten"]
    if lengthen > shorten:
        message = f"{lengthen:g} is above shorten = {shorten:g}: a lengthened exposure could saturate and be shortened"
        yield impossible(
            "sequence.operation.lengthen_below", message + f" again in an endless cycle; use {shorten:g} or less"
        )
    exposure_s = v["detector.exposure_s"]
    for key in ("shortest_exposure_s", "exposure_step_s"):
        value = v[f"sequence.operation.{key}"]
        if value > exposure_s:
            message = (
                f"{value:g} s is longer than detector.exposure_s = {exposure_s:g} s, the maximum; use a shorter one"
            )
            yield impossible(f"sequence.operation.{key}", message)
