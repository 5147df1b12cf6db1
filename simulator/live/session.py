"""One client, on any transport: its messages in order, and their replies."""

from __future__ import annotations

import logging

from simulator.live.answers import Error, Reply
from simulator.live.hub import Subscriber
from simulator.live.loop import MissionLoop
from simulator.live.protocol import GivenAttitude, Hello, Refused, Shown, Subscribe, parse
from simulator.live.security import Access, TokenBucket

__all__ = ["HELLO_S", "MOST_CLIENTS", "Session", "SessionEnded", "no_hello"]

_log = logging.getLogger(__name__)

HELLO_S = 10.0
"""A client that has not said hello by then is disconnected."""
MOST_CLIENTS = 32
"""Clients at a time."""
MESSAGES_PER_S, BURST = 1000.0, 2000.0
"""Messages of a client a second in the long run, and in a burst."""
MOST_REFUSED = 50
"""Refused messages in a row, after which a client is disconnected."""


class SessionEnded(Exception):
    """The client is to be disconnected; the reason is in the last message."""


def no_hello() -> Error:
    """Last message to a client that has not said hello in time."""
    return Error(code="hello_first", reason=f"no hello within {HELLO_S:g} s; disconnected")


class Session:
    """A client from ``hello`` to its end; a context that joins and leaves the hub.

    Parameters
    ----------
    loop : MissionLoop
        The mission.
    access : Access
        Rules of access.
    token : str
        Token from the address of a WebSocket.
    """

    def __init__(self, loop: MissionLoop, access: Access, token: str = "") -> None:
        self.loop, self.subscriber = loop, Subscriber()
        self.greeted = False
        """Whether the client has said ``hello`` with a valid token."""
        self._access, self._token = access, token
        self._bucket, self._refused = TokenBucket(MESSAGES_PER_S, BURST), 0

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.hub.subscribers.discard(self.subscriber)

    async def receive(self, text: str | bytes) -> None:
        """One message; `SessionEnded` if the client is to be disconnected."""
        await self.subscriber.room()
        try:
            if not self._bucket.take():
                raise Refused("rate", f"more than {MESSAGES_PER_S:g} messages a second; disconnected")
            await self._handle(text)
            self._refused = 0
        except Refused as refused:
            self.subscriber.reply(Error(id=refused.message_id, code=refused.code, reason=refused.reason))
            self._refused += 1
            if refused.code in ("rate", "token", "busy") or not self.greeted or self._refused >= MOST_REFUSED:
                raise SessionEnded(refused.reason) from None

    async def _handle(self, text: str | bytes) -> None:
        message = parse(text)
        try:
            if isinstance(message, Hello):
                self._greet(message)
                return
            if not self.greeted:
                raise Refused("hello_first", "the first message must be a hello")
            if isinstance(message, Subscribe):
                self.subscriber.wants = message
                self.subscriber.put_state(self.loop.state())
                detail = ""
            elif isinstance(message, Shown):
                self.subscriber.late_pictures, detail = message.late, ""
            else:
                detail = await self.loop.handle(message)
        except Refused as refused:
            refused.message_id = message.id
            raise
        except Exception as error:  # a defect of ours ends neither the session nor the loop
            _log.exception("a message could not be handled")
            raise Refused("failed", f"{type(error).__name__}: {error}", message.id) from None
        if message.id is not None or not isinstance(message, GivenAttitude | Shown):
            self.subscriber.reply(Reply(id=message.id, detail=detail))

    def _greet(self, hello: Hello) -> None:
        if not self._access.has_token(hello.token or self._token):
            raise Refused("token", "the token is missing or wrong")
        if not self.greeted and len(self.loop.hub.subscribers) >= MOST_CLIENTS:
            raise Refused("busy", f"the server has {MOST_CLIENTS} clients, the maximum; try again later")
        self.greeted = True
        self.loop.hub.subscribers.add(self.subscriber)
        self.subscriber.reply(self.loop.welcome())
