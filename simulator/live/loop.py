"""The loop of a live mission: when the next frame is made, and what clients ask of the mission in between.

Frames are rendered and solved in a thread of their own; everything else runs in the event loop and only waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from simulator.live import answers, protocol
from simulator.live.hub import Hub, Published
from simulator.live.images import encode
from simulator.live.messages import frame_header, solution_message, truth_message, welcome
from simulator.live.mission import LiveMission
from simulator.live.motion import Given
from simulator.live.protocol import ClientMessage, Refused
from simulator.live.stimulus import Stimulus
from startracker.errors import BoresightError

__all__ = ["MissionLoop"]

T = TypeVar("T")

_STATE_S = 0.25
_RATE_WINDOW_S = 2.0
_CHANNELS = ["frame", "solution", "truth", "state"]
_log = logging.getLogger(__name__)


class _Turn(NamedTuple):
    """What the next frame is made of."""

    due_s: float
    """When it was due, by `time.perf_counter`: in lockstep when its attitude arrived."""
    given: Given | None = None
    lockstep: bool = False
    made: asyncio.Future[str] | None = None
    """Set when the frame is made."""


class MissionLoop:
    """Runs a mission at its pace.

    Parameters
    ----------
    mission : LiveMission
        The mission; from now on only used in the loop's own thread.
    recordings : Path
        Folder in which recordings are made.
    speed : float
        Factor on real time.
    paused : bool
        Begin paused.
    stimulus : Stimulus, optional
        Display before a real tracker.
    """

    def __init__(
        self,
        mission: LiveMission,
        recordings: Path,
        *,
        speed: float = 1.0,
        paused: bool = False,
        stimulus: Stimulus | None = None,
    ) -> None:
        self.mission, self.hub, self.stimulus = mission, Hub(), stimulus
        self.speed, self.paused, self.lockstep = speed, paused, False
        self.late_frames, self.notice = 0, ""
        self.recordings = recordings
        self.recording_folder: Path | None = None
        self._values = mission.values()
        self._newest: Given | None = None
        self._queue: deque[_Turn] = deque()
        self._steps = 0
        self._due_s = time.perf_counter()
        self._made_s: deque[float] = deque(maxlen=4096)
        self._wake = asyncio.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="frames")
        self._pending: dict[str, tuple[float, list[asyncio.Future[str]]]] = {}
        self._applying: asyncio.Task[None] | None = None
        self._closing = False
        self._changing = False  # a frame decided on before a change of the source is not made after it

    # ------------------------------------------------------------------ the loop
    async def run(self) -> None:
        """Make frames until `close`."""
        states = asyncio.create_task(self._send_states())
        try:
            while not self._closing:
                turn = await self._next_turn()
                if turn is not None:
                    await self._make(turn)
        finally:
            states.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await states

    async def close(self) -> None:
        """End: the current frame is finished, and a recording is written."""
        self._closing = True
        self._refuse_queue("the server is closing")
        self._wake.set()
        if self.recording_folder is not None:
            with contextlib.suppress(Refused, BoresightError):
                await self._stop_recording()
        await asyncio.to_thread(self._worker.shutdown)

    async def _in_worker(self, call: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._worker, call, *arguments)

    async def _next_turn(self) -> _Turn | None:
        """Wait until a frame is due."""
        while not self._closing:
            self._wake.clear()
            wait_s = None
            if not self._changing and (not self.paused or self._steps):
                if self.lockstep:
                    if self._queue:
                        return self._queue.popleft()
                elif not self.is_waiting:
                    now_s, newest = time.perf_counter(), self._newest if self.mission.external else None
                    if self.paused:
                        return _Turn(now_s, newest)
                    wait_s = self._due_s - now_s
                    if wait_s <= 0.0:
                        return _Turn(self._due_s, newest)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
        return None

    async def _make(self, turn: _Turn) -> None:
        """Make a frame and publish it; a failure pauses the mission, or is reported to the client of the attitude."""
        self._steps = max(self._steps - 1, 0)
        try:
            published = await self._in_worker(self._frame, turn)
        except Exception as error:
            known = isinstance(error, (Refused, BoresightError))
            reason = str(error) if known else f"{type(error).__name__}: {error}"
            if not known:
                _log.exception("a frame could not be made")
            if turn.made is not None and not turn.made.done():
                refused = error if isinstance(error, Refused) else Refused("failed", reason)
                turn.made.set_exception(refused)
            else:
                self.paused, self.notice = True, " ".join(reason.split())
            return
        self.hub.publish(published)
        now_s = time.perf_counter()
        self._made_s.append(now_s)
        if turn.made is not None:
            if not turn.made.done():
                turn.made.set_result("")
        else:
            self._schedule(now_s)
        if self.mission.recording is not None and self.mission.recording.is_full:
            await self._stop_recording()
            self.notice = "the recording was full"

    def _schedule(self, now_s: float) -> None:
        """Time of the next frame; a mission that is late by more than a step does not catch up."""
        step_s = self.mission.step_s / self.speed
        self._due_s += step_s
        if now_s - self._due_s > step_s:
            self.late_frames += not self.paused
            self._due_s = now_s

    def _frame(self, turn: _Turn) -> Published:
        """In the worker: a frame and its messages, in the formats that are wanted."""
        mission, hub = self.mission, self.hub
        live = mission.step(turn.given, lockstep=turn.lockstep)
        frame, index = live.tracked.frame, live.index
        begun_s = turn.given.received_s if turn.given is not None else turn.due_s
        latency_ms = (time.perf_counter() - begun_s) * 1e3
        solution = solution_message(live, mission.camera.session, latency_ms)
        truth = truth_message(live) if hub.wants(index, "truth") else None
        frames = {}
        for form in hub.formats(index):
            if frame is None:
                break
            encoded = encode(frame, form)
            frames[form] = (frame_header(live, form, encoded), encoded)
        stimulus = None
        if self.stimulus is not None and hub.wants(index, "stimulus"):
            held = self.paused or self.lockstep
            stimulus = self.stimulus.message(live, 0.0 if held else mission.step_s, self.speed)
        return Published(index, solution, truth, frames, stimulus)

    # ------------------------------------------------------------------ what it says of itself
    @property
    def is_waiting(self) -> bool:
        """Whether the mission waits for an attitude."""
        return self.mission.external and (not self._queue if self.lockstep else self._newest is None)

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second over the last two seconds."""
        since_s = time.perf_counter() - _RATE_WINDOW_S
        return sum(made_s > since_s for made_s in self._made_s) / _RATE_WINDOW_S

    def welcome(self) -> answers.Welcome:
        """Answer to ``hello``."""
        return welcome(self.mission, [*_CHANNELS, *(["stimulus"] if self.stimulus is not None else [])])

    def state(self) -> answers.StateMessage:
        """Present state."""
        mission = self.mission
        return answers.StateMessage(
            running=not self.paused and not self.is_waiting,
            paused=self.paused,
            speed=self.speed,
            source="external" if mission.external else "scenario",
            lockstep=self.lockstep,
            t_s=mission.t_s,
            index=mission.index,
            blinded=mission.blinded,
            recording=None if self.recording_folder is None else str(self.recording_folder),
            clients=len(self.hub.subscribers),
            late_frames=self.late_frames,
            late_pictures=sum(subscriber.late_pictures for subscriber in self.hub.subscribers),
            frame_rate_hz=self.frame_rate_hz,
            notice=self.notice,
            parameters=self._values,
        )

    async def _send_states(self) -> None:
        """Send the state when it has changed."""
        before = None
        while True:
            await asyncio.sleep(_STATE_S)
            now = self.state()
            if now != before:
                self.hub.put_state(now)
                before = now

    # ------------------------------------------------------------------ what clients ask
    async def handle(self, message: ClientMessage) -> str:
        """Do what a client asks, and return the reply's detail; `Refused` if it cannot be done."""
        done = await self._handle(message)
        self._wake.set()
        return done

    async def _handle(self, message: ClientMessage) -> str:
        mission = self.mission
        match message:
            case protocol.GivenAttitude():
                return await self._take_attitude(message)
            case protocol.Set():
                return await self._set(message.path, message.value)
            case protocol.Pause():
                self.paused = True
                self._refuse_queue("the mission is paused")
            case protocol.Resume():
                self.paused, self._due_s, self.notice = False, time.perf_counter(), ""
            case protocol.Step():
                if not self.paused:
                    raise Refused("state", "step: the mission is running; pause it first")
                self._steps += 1
            case protocol.Speed():
                self.speed, self._due_s = message.factor, time.perf_counter()
            case protocol.Source():
                await self.use_source(external=message.attitude == "external", lockstep=message.lockstep)
            case protocol.Kick():
                await self._in_worker(mission.kick, message.rate_deg_s)
                self._values = mission.values()
            case protocol.Blind() | protocol.Unblind():
                if message.head is not None:
                    raise Refused("invalid", f"head: this mission has one camera, without a name; got '{message.head}'")
                mission.blinded = isinstance(message, protocol.Blind)
            case protocol.Seek():
                await self._in_worker(mission.seek, message.t_s)
                self._due_s = time.perf_counter()
            case protocol.Saa():
                at_s = await self._in_worker(mission.seek_anomaly)
                self._due_s, self._values = time.perf_counter(), mission.values()
                return f"t_s = {at_s:.9g} s, {mission.isot(at_s)} UTC"
            case protocol.Record():
                return await self._record(message.folder)
            case protocol.StopRecording():
                return await self._stop_recording()
            case _:
                raise Refused("state", f"{message.type}: not possible now")
        return ""

    async def _take_attitude(self, message: protocol.GivenAttitude) -> str:
        """An attitude from outside; in lockstep, the end of its frame."""
        received_s, mission = time.perf_counter(), self.mission
        if not mission.external:
            raise Refused("state", "attitude: the source is the scenario; send the command source first")
        if (message.t_s is None) == (message.time is None):
            raise Refused("invalid", "t_s: give either t_s or time")
        t_s = message.t_s
        if message.time is not None:
            try:
                t_s = mission.time_of(message.time)
            except BoresightError as error:
                raise Refused("invalid", str(error)) from None
        assert t_s is not None
        given = Given(t_s, message.quaternion, message.rate_deg_s, received_s)
        if not self.lockstep:
            if self._newest is not None and t_s <= self._newest.t_s:
                raise Refused("state", f"t_s: {t_s:.9g} s is not after {self._newest.t_s:.9g} s, the newest attitude's")
            if self._newest is None:
                self._due_s = received_s
            self._newest = given
            return ""
        if self.paused:
            raise Refused("state", "attitude: the mission is paused")
        made: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._queue.append(_Turn(received_s, given, True, made))
        self._wake.set()
        return await made

    def _refuse_queue(self, reason: str) -> None:
        """Refuse attitudes that wait for their frames."""
        while self._queue:
            made = self._queue.popleft().made
            if made is not None and not made.done():
                made.set_exception(Refused("state", f"attitude: {reason}"))

    async def use_source(self, *, external: bool, lockstep: bool) -> None:
        """Take attitudes from the scenario, or from outside; `Refused` while there is a recording."""
        if lockstep and not external:
            raise Refused("invalid", "lockstep: only with attitude 'external'")
        self._refuse_queue("the source has changed")
        changed = external != self.mission.external or lockstep != self.lockstep
        if changed:
            self._changing = True
            try:
                await self._in_worker(self._change_source, external)
            finally:
                self._changing = False
            self.hub.discard_frames()  # sent after replies, and at the times of the new source
        self.lockstep, self._newest, self._due_s = lockstep, None, time.perf_counter()

    def _change_source(self, external: bool) -> None:
        """In the worker: another source, or another way of external attitudes, for which the tracker starts again."""
        if external == self.mission.external:
            self.mission.use_source(external=False)
        self.mission.use_source(external=external)

    async def _set(self, path: str, value: float) -> str:
        """Change a parameter; values that arrive faster than the camera is rebuilt replace each other."""
        self.mission.table.check(path, value)
        done: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        waiting = self._pending.get(path, (value, []))[1]
        self._pending[path] = (value, [*waiting, done])
        if self._applying is None or self._applying.done():
            self._applying = asyncio.create_task(self._apply())
        return await done

    async def _apply(self) -> None:
        while self._pending:
            pending, self._pending = self._pending, {}
            for path, (value, waiting) in pending.items():
                refused: Exception | None = None
                try:
                    await self._in_worker(self.mission.set, {path: value})
                except Exception as error:
                    refused = error if isinstance(error, Refused) else Refused("failed", f"{path}: {error}")
                for done in waiting:
                    if done.done():
                        continue
                    if refused is None:
                        done.set_result("")
                    else:
                        done.set_exception(refused)
        self._values = self.mission.values()

    async def _record(self, name: str | None) -> str:
        folder = self.recordings / (name or time.strftime("live-%Y%m%d-%H%M%S"))
        if folder.exists():
            raise Refused("state", f"folder: {folder} exists; give another name")
        await self._in_worker(self.mission.record)
        self.recording_folder = folder
        return str(folder)

    async def _stop_recording(self) -> str:
        """Write the recording; `Refused` if there is none, it is too short, or the folder cannot be written."""
        recording = await self._in_worker(self.mission.stop_recording)
        folder, self.recording_folder = self.recording_folder, None
        assert folder is not None
        if len(recording) < 2:
            raise Refused("state", "stop_recording: fewer than two frames were recorded; nothing is written")
        try:
            await asyncio.to_thread(recording.write, folder)
        except (OSError, BoresightError) as error:
            raise Refused("failed", f"stop_recording: {error}") from None
        return f"{folder}: {len(recording)} frames; boresight run {folder}/scenario.yaml --sequence"
