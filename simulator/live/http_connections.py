"""HTTP connections that end when they ask for nothing: uvicorn waits for the end of a request's headers for ever."""

from __future__ import annotations

import asyncio
from typing import Any

__all__ = ["REQUEST_S", "timed_protocol"]

REQUEST_S = 10.0
"""A connection on which no request is complete for so long is closed, whatever parts of one have arrived."""


def timed_protocol() -> type[asyncio.Protocol]:
    """uvicorn's protocol for HTTP/1.1 on h11, with a limit on the time that a request takes to arrive.

    uvicorn itself only limits the time between the end of an answer and the next byte (``timeout_keep_alive``).
    """
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class TimedProtocol(H11Protocol):  # type: ignore[misc]  # uvicorn is an optional package without types for mypy
        _deadline: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._set_deadline()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._set_deadline()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._set_deadline()

        def connection_lost(self, exc: Exception | None) -> None:
            self._clear_deadline()
            super().connection_lost(exc)

        def _set_deadline(self) -> None:
            """Start the time of the next request, unless it runs already; stop it while a request is answered."""
            answering = self.cycle is not None and not self.cycle.response_complete
            upgraded = self.transport.get_protocol() is not self  # to a WebSocket
            if answering or upgraded or self.transport.is_closing():
                self._clear_deadline()
            elif self._deadline is None:
                self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

        def _clear_deadline(self) -> None:
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

    return TimedProtocol
