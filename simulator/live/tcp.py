"""The protocol as lines of JSON over TCP."""

from __future__ import annotations

import asyncio
import base64
import contextlib

from simulator.live.answers import Error, FrameHeader, StimulusMessage, dump
from simulator.live.hub import Outgoing
from simulator.live.loop import MissionLoop
from simulator.live.protocol import LARGEST_MESSAGE_BYTES
from simulator.live.security import Access
from simulator.live.session import HELLO_S, Session, SessionEnded, no_hello

__all__ = ["LineServer"]

_STALLED_S = 30.0
"""A client that has not taken a message for so long is disconnected."""


class LineServer:
    """Serves one mission on TCP connections.

    Parameters
    ----------
    loop : MissionLoop
        The mission.
    access : Access
        Rules of access.
    """

    def __init__(self, loop: MissionLoop, access: Access) -> None:
        self._loop, self._access = loop, access
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, from `asyncio.start_server`."""
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            with Session(self._loop, self._access) as session:
                sending = asyncio.create_task(_send_all(session, writer))
                try:
                    await self._receive_all(session, reader, sending)
                finally:
                    sending.cancel()
                    with contextlib.suppress(asyncio.CancelledError, OSError, TimeoutError):
                        await sending
                await _send(writer, session.subscriber.rest())
        except (OSError, TimeoutError):
            pass  # the client has gone
        except asyncio.CancelledError:
            pass  # the server closes
        finally:
            self._tasks.discard(task)
            writer.close()

    async def close(self) -> None:
        """Disconnect all clients."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    @staticmethod
    async def _receive_all(session: Session, reader: asyncio.StreamReader, sending: asyncio.Task[None]) -> None:
        """Messages until the client ends, or is to be disconnected."""
        while not sending.done():
            try:
                async with asyncio.timeout(None if session.greeted else HELLO_S):
                    line = await reader.readuntil(b"\n")
            except asyncio.IncompleteReadError:  # its end, perhaps within a line
                return
            except asyncio.LimitOverrunError:
                reason = f"the line has more than {LARGEST_MESSAGE_BYTES} bytes; disconnected"
                session.subscriber.reply(Error(code="malformed", reason=reason))
                return
            except TimeoutError:
                session.subscriber.reply(no_hello())
                return
            try:
                if line.strip():
                    await session.receive(line)
            except SessionEnded:
                return


async def _send_all(session: Session, writer: asyncio.StreamWriter) -> None:
    """What there is for a client, as fast as it takes it."""
    try:
        while True:
            await _send(writer, await session.subscriber.take())
    except (OSError, TimeoutError):
        writer.close()  # also ends the reading


async def _send(writer: asyncio.StreamWriter, batch: list[Outgoing]) -> None:
    for message, data in batch:
        whole = message
        if isinstance(message, FrameHeader | StimulusMessage) and data:
            whole = message.model_copy(update={"data": base64.b64encode(data).decode()})
        writer.write(dump(whole).encode() + b"\n")
        async with asyncio.timeout(_STALLED_S):  # wait_for of Python 3.11 may lose a cancellation
            await writer.drain()
