"""Sequence of a spacecraft with several heads: each rendered and solved by itself, and fused with the gyro."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from simulator.frame import Frame
from simulator.mission.gyro import DEG_H, DEG_SQRT_H, GyroSamples, gyro_samples
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.study.process_noise import process_noise
from simulator.study.sequence.camera import LEAST_PRIOR_DEG, TrackedFrame
from simulator.study.sequence.columns import compared_columns, is_beyond, opening_columns, row_errors_deg, three_columns
from simulator.study.sequence.head_camera import BodyState, HeadCamera, scenario_of_head
from simulator.study.sequence.true_motion import jitter_at, start_pointing, states_at
from simulator.study.specification.outcome import UNKNOWN, outcome_of
from simulator.study.specification.requirements import specification_of
from startracker._compiled import clock
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.fusion import AlignedMekf, FusionFilter
from startracker.geometry.attitude import Attitude
from startracker.settings import TrackingSettings
from startracker.solution import Solution, Status

WAITING = "waiting"
"""Status of a row whose frames are solved but have not yet reached the filter, which has no attitude."""
_UNTRUSTED = ("heads_disagree", "gyro_disagrees")
"""States of the filter in which its attitude may be wrong by more than it states; the row has them as its status."""
_SETTINGS = TrackingSettings()
_PRIOR_SIGMAS = 5.0
_LEAST_MEMORY_S = 60.0
_SUMS = (
    *("stars_in_field", "bodies_in_field", "satellites_in_field"),
    *("stars_detected", "stars_matched", "stars_misidentified"),
)


class _HeadFrame(NamedTuple):
    """One frame of one head."""

    head: int
    frame: Frame | None
    solution: Solution
    columns: dict[str, Any]
    """Its columns; ``update`` is None until its attitude has reached the filter."""


class _Arrival(NamedTuple):
    """An attitude on its way to the filter, in the order of arrival."""

    arrival_s: float
    exposed_s: float
    head: int
    tag_s: float
    """Mid-exposure, as stated."""
    taken: _HeadFrame


class HeadsRunner:
    """Renders, solves and fuses the frames of a scenario with heads.

    Parameters
    ----------
    scenario : Scenario
        The scenario.

    Notes
    -----
    A row is one step of the sequence: the estimate of the filter at that time, from what has reached it by then, and
    the frames of all heads taken in this step. The estimate is given as the attitude of the first head.
    """

    operated = calibrated = None

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, section = scenario, scenario.sequence
        self.cameras = [HeadCamera(scenario, head) for head in scenario.heads]
        self.specification = specification_of(scenario)
        first = self.cameras[0].renderer
        self.clock = first.scenes.clock
        reference = scenario_of_head(scenario, scenario.heads[0])
        self.start = start_pointing(reference, first)
        self.grid_s = [k * section.step_s for k in range(section.frames)]
        self.states = self._states(reference)
        for head, camera in enumerate(self.cameras):
            camera.renderer.scenes.plan([self.exposed(head, k).t_s for k in range(section.frames)])
        self.gyro: GyroSamples | None = None
        self.ends_s = sorted(self.states)
        """Ends of the gyro's samples."""
        if section.gyro.use:
            bodies = [self.states[t_s].jittered(first.exposure_s) for t_s in self.ends_s]
            turns = np.reshape([a.rotation_vector_to(b) for a, b in pairwise(bodies)], (-1, 3))
            self.gyro = gyro_samples(section.gyro, turns, np.diff(self.ends_s), stream(scenario.seed, "gyro"))
        on_grid = states_at(reference, first.scenes, self.start, self.grid_s)
        shaking = jitter_at(reference, first.scenes, self.grid_s)
        self.noise = process_noise(section, on_grid, shaking, first.exposure_s)
        self.fusion: FusionFilter | None = None
        """The filter of the present pass, set by `frames`."""

    def _states(self, reference: Scenario) -> dict[float, BodyState]:
        """The body at the times of all rows and exposures."""
        offsets = {head.time_offset_s for head in self.scenario.heads} | {0.0}
        since_s = sorted({t_s + offset for t_s in self.grid_s for offset in offsets})
        scenes = self.cameras[0].renderer.scenes
        states = states_at(reference, scenes, self.start, since_s)
        to_body = self.start.mounting.inverse
        shaking = [path.in_axes(to_body.as_matrix()) for path in jitter_at(reference, scenes, since_s)]
        return {
            t_s: BodyState(
                t_s,
                state.t_s,
                to_body @ state.camera,
                to_body.apply(state.rate_camera_rad_s),
                shaking[k] if shaking else None,
            )
            for k, (t_s, state) in enumerate(zip(since_s, states, strict=True))
        }

    def exposed(self, head: int, k: int) -> BodyState:
        """The body at frame `k` of a head."""
        return self.states[self.grid_s[k] + self.scenario.heads[head].time_offset_s]

    def frames(self) -> Iterator[TrackedFrame]:
        """All rows in order; reproducible."""
        flight, rows = _Flight(self), deque[tuple[dict[str, Any], list[_HeadFrame]]]()
        self.fusion = flight.fusion
        offsets = [head.time_offset_s for head in self.scenario.heads]
        together = [h for h, offset in enumerate(offsets) if offset == 0.0]
        later = sorted((h for h in range(len(offsets)) if offsets[h] > 0.0), key=lambda h: offsets[h])
        for k, t_s in enumerate(self.grid_s):
            taken = [flight.take(h, k) for h in together]
            flight.receive(t_s)
            fused = flight.fused(k)
            taken += [flight.take(h, k) for h in later]
            rows.append((fused, sorted(taken, key=lambda one: one.head)))
            if k + 1 == len(self.grid_s):
                flight.receive(math.inf)
            while rows and all(one.columns["update"] is not None for one in rows[0][1]):
                yield self._tracked(*rows.popleft())

    def _tracked(self, fused: dict[str, Any], taken: list[_HeadFrame]) -> TrackedFrame:
        """A row with the columns of all heads, and the frame of the first."""
        solved = [one.columns for one in taken if one.solution.solved]
        row = dict(fused)
        known = math.isfinite(row["qw"])
        if solved and known:
            modes = [columns["mode"] for columns in solved]
            row["mode"] = "prior" if "prior" in modes else modes[0]
            if row["agreement"] in _UNTRUSTED:
                row |= {"status": row["agreement"], "reason": row["agreement_reason"]}
            else:
                row |= {"status": str(Status.SOLVED), "reason": row["agreement_reason"]}
        else:
            said = taken[0].columns
            row["mode"] = "coasting" if known else "none"
            row["status"] = WAITING if solved else said["status"]
            row["reason"] = "no attitude has reached the filter" if solved else said["reason"]
        row |= {name: sum(one.columns[name] for one in taken) for name in _SUMS}
        names = [self.cameras[one.head].name for one in taken]
        row["excluded"] = ", ".join(
            f"{name}: {one.columns['excluded']}"
            for name, one in zip(names, taken, strict=True)
            if one.columns["excluded"]
        )
        for name in ("render_ms", "track_ms"):
            row[name] = sum(one.columns[name] for one in taken)
        if row["status"] == str(Status.SOLVED):  # of the filter, which names no stars: those of the heads are theirs
            row |= outcome_of(0, row["nees"], row_errors_deg(row), self.specification)._asdict()
            causes = [one.columns["inconsistent_cause"] for one in taken if one.columns["inconsistent_cause"]]
            row["inconsistent_cause"] = (causes or [UNKNOWN])[0] if row["inconsistent"] else ""
        row["beyond_specification"] = row["status"] == str(Status.SOLVED) and row["beyond_specification"]
        for name, one in zip(names, taken, strict=True):
            row |= {f"head_{name}_{key}": value for key, value in one.columns.items()}
        return TrackedFrame(row, taken[0].frame, taken[0].solution, np.empty((0, 2)), 0)


class _Flight:
    """One pass through a sequence: the filter, and the attitudes on their way to it."""

    def __init__(self, runner: HeadsRunner) -> None:
        self.runner = runner
        heads, section = runner.scenario.heads, runner.scenario.sequence
        longest_s = max(head.delay_s + head.time_offset_s for head in heads)
        self.fusion = FusionFilter(
            [camera.filter_head for camera in runner.cameras],
            runner.noise,
            false_rejection=_SETTINGS.false_rejection,
            memory_s=max(_LEAST_MEMORY_S, 2.0 * longest_s + 10.0 * section.step_s),
        )
        self._arriving: list[_Arrival] = []
        self._samples = 0
        self._restarted = False

    def receive(self, now_s: float) -> None:
        """Give the filter what has arrived up to a time: samples of the gyro, and attitudes."""
        ends, gyro = self.runner.ends_s, self.runner.gyro
        while gyro is not None and self._samples + 1 < len(ends) and ends[self._samples + 1] <= now_s:
            start_s, end_s = ends[self._samples : self._samples + 2]
            self.fusion.add_gyro(start_s, end_s, gyro.rates_rad_s[self._samples] * (end_s - start_s))
            self._samples += 1
        while self._arriving and self._arriving[0].arrival_s <= now_s:
            arrived = heapq.heappop(self._arriving)
            solution, columns = arrived.taken.solution, arrived.taken.columns
            assert solution.attitude is not None
            assert solution.covariance is not None
            update = self.fusion.add_attitude(arrived.head, arrived.tag_s, solution.attitude, solution.covariance)
            columns["update"] = update.outcome
            if update.innovation is not None:
                columns["innovation_distance2"] = update.innovation.distance2
            self._restarted |= update.outcome == "restarted"

    def take(self, head: int, k: int) -> _HeadFrame:
        """Frame `k` of a head, solved; its attitude is on its way."""
        runner = self.runner
        camera, state = runner.cameras[head], runner.exposed(head, k)
        columns: dict[str, Any] = {"elapsed_s": state.since_s, "mode": "none"}
        nothing = {"update": "", "innovation_distance2": math.nan}
        if not camera.sees(state.since_s):
            columns |= camera.missing() | nothing | {"render_ms": 0.0, "track_ms": 0.0}
            return _HeadFrame(head, None, Solution(Status.NO_STARS, "no frame"), columns)
        self.receive(state.since_s)
        prior, prior_deg = self._prior(head, k)
        started = clock()
        frame, truth = camera.take(k, state)
        rendered = clock()
        solution = camera.solve(frame, prior, prior_deg)
        solved = clock()
        columns |= camera.columns(frame, truth, solution) | nothing
        columns |= {"render_ms": (rendered - started) * 1e3, "track_ms": (solved - rendered) * 1e3}
        taken = _HeadFrame(head, frame, solution, columns)
        if solution.attitude is not None and solution.covariance is not None:
            near = prior is not None and not solution.prior_contradicted
            columns |= {"mode": "prior" if near else "lost_in_space", "update": None}
            tag_s = state.since_s + truth.time_tag_error_s
            arrival_s = state.since_s + runner.scenario.heads[head].delay_s
            heapq.heappush(self._arriving, _Arrival(arrival_s, state.since_s, head, tag_s, taken))
        return taken

    def _prior(self, head: int, k: int) -> tuple[Attitude | None, float]:
        """What is known of the attitude of a head at its exposure, and its largest error, degrees."""
        runner = self.runner
        mekf = self.fusion.estimate(runner.exposed(head, k).since_s)
        if mekf is not None:
            sigma_deg = math.degrees(math.sqrt(float(np.trace(mekf.head_covariance(head)))))
            width_deg = max(_PRIOR_SIGMAS * sigma_deg, LEAST_PRIOR_DEG)
            return (mekf.head_attitude(head), width_deg) if width_deg <= _SETTINGS.prior_limit_deg else (None, 1.0)
        if k or not runner.cameras[head].scenario.tracker.prior:
            return None, 1.0
        body = runner.start.mounting.inverse @ runner.start.prior
        known = runner.cameras[head].filter_head.mounting @ body
        return known, max(runner.scenario.pointing.error_deg, LEAST_PRIOR_DEG)

    # ------------------------------------------------------------------ columns
    def fused(self, k: int) -> dict[str, Any]:
        """Columns of the filter at the time of a row."""
        runner = self.runner
        state, reference = runner.states[runner.grid_s[k]], runner.cameras[0]
        exposure_s = reference.renderer.exposure_s
        jittered = state._replace(body=state.jittered(exposure_s), rate_rad_s=state.jittered_rate_rad_s(exposure_s))
        seen, rotation_rad = reference.motion(jittered), reference.rotation_rad(state)
        true = seen.camera
        mekf = self.fusion.estimate(state.since_s)
        estimate = None if mekf is None else mekf.head_attitude(0)
        row = opening_columns(k, state.since_s, state.t_s, runner.clock.isot(state.t_s))
        covariance = None if mekf is None else mekf.head_covariance(0)
        row |= compared_columns(true, estimate, covariance, seen.camera @ jittered.body.inverse, rotation_rad)
        row["beyond_specification"] = is_beyond(row, runner.specification)
        row |= self._rates(seen.rate_camera_rad_s, mekf)
        row |= self._gyro_errors(state.since_s, mekf)
        for head, camera in enumerate(runner.cameras):
            row |= _alignment_columns(camera, head, mekf)
        status = self.fusion.status(state.since_s)
        row |= {"agreement": status.state, "agreement_reason": status.reason}
        row |= {f"head_{name}_agreement": head.state for name, head in status.heads.items()}
        row |= {"restarted": self._restarted, "distrusted": False, "windows": 0, "stars_expected": 0}
        self._restarted = False
        return row

    def _rates(self, true_rad_s: FloatArray, mekf: AlignedMekf | None) -> dict[str, float]:
        """True and estimated rate of the first head."""
        section = self.runner.scenario.sequence
        rate = sigma = None
        if mekf is not None and (self._samples or not section.gyro.use):
            to_camera = mekf.mounting(0).as_matrix()
            rate, variance = to_camera @ mekf.rate_rad_s, mekf.covariance[3:, 3:]
            if section.gyro.use:
                step_s = self.runner.ends_s[self._samples] - self.runner.ends_s[self._samples - 1]
                white = (section.gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H) ** 2 / step_s
                variance = variance + white * np.eye(3)
            sigma = np.sqrt(np.diag(to_camera @ variance @ to_camera.T))
        return three_columns("rate", "deg_s", true_rad_s, rate, sigma, math.degrees(1.0))

    def _gyro_errors(self, since_s: float, mekf: AlignedMekf | None) -> dict[str, float]:
        """True and estimated bias and scale factors of the gyro, body axes; empty without one."""
        gyro = self.runner.gyro
        if gyro is None:
            return {}
        true = gyro.biases_rad_s[self.runner.ends_s.index(since_s)]
        bias = None if mekf is None else mekf.bias_rad_s
        sigma = None if mekf is None else np.sqrt(np.diag(mekf.covariance)[3:])
        columns = three_columns("bias", "deg_h", true, bias, sigma, 1.0 / DEG_H)
        if self.runner.scenario.sequence.gyro.scale_factor_ppm:
            scale = None if mekf is None else mekf.scale
            sigma = None if mekf is None else mekf.scale_sigma
            columns |= three_columns("scale", "ppm", gyro.scale, scale, sigma, 1e6)
        return columns


def _alignment_columns(camera: HeadCamera, head: int, mekf: AlignedMekf | None) -> dict[str, float]:
    """True and estimated alignment of a head about its own axes; empty for an exact mounting."""
    if not camera.head.alignment_sigma_arcsec:
        return {}
    found = None if mekf is None else mekf.alignment_rad(head)
    sigma = None if mekf is None else mekf.alignment_sigma_rad(head)
    columns = three_columns("alignment", "arcsec", camera.misalignment_rad, found, sigma, 1.0 / ARCSEC_RAD)
    return {f"head_{camera.name}_{name}": value for name, value in columns.items()}
