"""Who receives what: a newer frame replaces one that a slow client has not received, and is counted as missed."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from simulator.live.answers import (
    FrameHeader,
    ServerMessage,
    SolutionMessage,
    StateMessage,
    StimulusMessage,
    TruthMessage,
)
from simulator.live.images import Encoded
from simulator.live.protocol import Subscribe

__all__ = ["Hub", "Outgoing", "Published", "Subscriber"]

_MOST_REPLIES = 64
"""Replies that wait for a client; until it has read some, its next messages are not read."""


class Outgoing(NamedTuple):
    """A message for a client, with the bytes that follow it."""

    message: ServerMessage
    data: bytes = b""


@dataclass(frozen=True)
class Published:
    """All that there is of one frame."""

    index: int
    solution: SolutionMessage
    truth: TruthMessage | None
    """None if no client wants it."""
    frames: dict[str, tuple[FrameHeader, Encoded]]
    """By format, those that a client wants; empty without a frame."""
    stimulus: tuple[StimulusMessage, bytes] | None = None
    """None if no client wants it."""


class Subscriber:
    """Outbox of one client."""

    def __init__(self) -> None:
        self.wants: Subscribe | None = None
        """What the client has asked for; None before."""
        self.late_pictures = 0
        """Of a display, as it says."""
        self._replies: deque[Outgoing] = deque()
        self._newest: Published | None = None
        self._missed = 0
        self._state: StateMessage | None = None
        self._filled, self._room = asyncio.Event(), asyncio.Event()
        self._room.set()

    def wants_frame(self, index: int, channel: str) -> bool:
        """Whether the client is to receive a channel of a frame."""
        return self.wants is not None and channel in self.wants.channels and index % self.wants.every == 0

    def publish(self, published: Published) -> None:
        """Put a frame into the outbox, in place of one that is still there."""
        if any(self.wants_frame(published.index, channel) for channel in ("frame", "solution", "truth", "stimulus")):
            self._missed += self._newest is not None
            self._newest = published
            self._filled.set()

    def discard_frame(self) -> None:
        """Remove a frame that is still in the outbox; it counts as missed."""
        self._missed += self._newest is not None
        self._newest = None

    def put_state(self, state: StateMessage) -> None:
        """Put a state into the outbox."""
        if self.wants is not None and "state" in self.wants.channels:
            self._state = state
            self._filled.set()

    def reply(self, message: ServerMessage) -> None:
        """Put a reply into the outbox, before all frames."""
        self._replies.append(Outgoing(message))
        if len(self._replies) >= _MOST_REPLIES:
            self._room.clear()
        self._filled.set()

    async def room(self) -> None:
        """Wait until the client has read its replies."""
        await self._room.wait()

    async def take(self) -> list[Outgoing]:
        """Wait for messages, and take all that are there."""
        await self._filled.wait()
        return self.rest()

    def rest(self) -> list[Outgoing]:
        """Take all messages that are there."""
        self._filled.clear()
        taken = list(self._replies)
        self._replies.clear()
        self._room.set()
        if self._state is not None:
            taken.append(Outgoing(self._state))
            self._state = None
        if self._newest is not None:
            taken += self._of_frame(self._newest)
            self._newest, self._missed = None, 0
        return taken

    def _of_frame(self, published: Published) -> list[Outgoing]:
        """The subscribed channels of a frame."""
        taken = []
        index, missed = published.index, {"missed": self._missed}
        form = self.wants.frame_format if self.wants is not None else ""
        if self.wants_frame(index, "frame") and form in published.frames:
            header, encoded = published.frames[form]
            taken.append(Outgoing(header.model_copy(update=missed), encoded.data))
        if self.wants_frame(index, "solution"):
            taken.append(Outgoing(published.solution.model_copy(update=missed)))
        if published.truth is not None and self.wants_frame(index, "truth"):
            taken.append(Outgoing(published.truth.model_copy(update=missed)))
        if published.stimulus is not None and self.wants_frame(index, "stimulus"):
            message, pixels = published.stimulus
            taken.append(Outgoing(message.model_copy(update=missed), pixels))
        return taken


class Hub:
    """All subscribers."""

    def __init__(self) -> None:
        self.subscribers: set[Subscriber] = set()

    def formats(self, index: int) -> set[str]:
        """Formats in which a frame is wanted."""
        wanting = [s.wants for s in list(self.subscribers) if s.wants_frame(index, "frame")]
        return {wants.frame_format for wants in wanting if wants is not None}

    def wants(self, index: int, channel: str) -> bool:
        """Whether a client wants a channel of a frame."""
        return any(s.wants_frame(index, channel) for s in list(self.subscribers))

    def publish(self, published: Published) -> None:
        """Give a frame to all who want it."""
        for subscriber in self.subscribers:
            subscriber.publish(published)

    def discard_frames(self) -> None:
        """Remove the frames that clients have not received yet."""
        for subscriber in self.subscribers:
            subscriber.discard_frame()

    def put_state(self, state: StateMessage) -> None:
        """Give a state to all who want it."""
        for subscriber in self.subscribers:
            subscriber.put_state(state)
