"""The server of a live mission: page and WebSocket by HTTP, and lines of JSON over TCP.

Needs the extra ``live``; its packages are imported when a server is made.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulator.checks import as_scenario
from simulator.live.answers import Error, dump
from simulator.live.http_connections import timed_protocol
from simulator.live.loop import MissionLoop
from simulator.live.mission import LiveMission
from simulator.live.protocol import LARGEST_MESSAGE_BYTES
from simulator.live.security import Access, is_host
from simulator.live.session import HELLO_S, Session, SessionEnded, no_hello
from simulator.live.stimulator import Stimulator
from simulator.live.stimulus import Stimulus
from simulator.live.tcp import LineServer
from simulator.scenario import Scenario
from startracker.arguments import of_kind
from startracker.errors import BoresightError, InputError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

__all__ = ["LiveServer", "ServerOptions", "serving"]

_PAGE = Path(__file__).parent / "page"
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; connect-src 'self' ws: wss:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_SHUTDOWN_S = 3


@dataclass(frozen=True)
class ServerOptions:
    """Addresses, access and pace of a server."""

    host: str = "127.0.0.1"
    """Address to bind to; other than a loopback one only with a token."""
    port: int = 8042
    """Port of HTTP and WebSocket; 0: any free one."""
    tcp_port: int | None = None
    """Port of TCP; 0: any free one; None: no TCP."""
    token: str = ""
    """Token that clients must have."""
    origins: tuple[str, ...] = ()
    """Origins of other pages that may connect."""
    recordings: Path = Path("recordings")
    """Folder in which recordings are made."""
    speed: float = 1.0
    """Factor on real time."""
    paused: bool = False
    """Begin paused."""
    lockstep: bool = False
    """Begin with external attitudes in lockstep."""
    stimulator: Stimulator | None = None
    """Calibrated display before a real tracker, whose pictures are sent on the channel ``stimulus``."""
    refresh_hz: float = 60.0
    """Pictures a second of real time for the display."""


class LiveServer:
    """Serves one live mission.

    Parameters
    ----------
    scenario : Scenario or path
        The scenario, or the name of an included one or of a file; its first frame is made before a client can connect,
        so that all kernels are compiled.
    options : ServerOptions
        Addresses, access and pace.

    Raises
    ------
    InputError
        If the extra ``live`` is not installed, a port is in use, an address needs a token, or the scenario cannot be
        served.
    """

    def __init__(self, scenario: Scenario | str | os.PathLike[str], options: ServerOptions = ServerOptions()) -> None:
        try:
            import starlette  # noqa: F401
            import uvicorn  # noqa: F401
            import websockets  # noqa: F401
        except ImportError as error:
            raise InputError(f"boresight serve needs {error.name}: pip install 'boresight[live]'") from None
        scenario, self.options = as_scenario(scenario), of_kind("options", options, ServerOptions)
        self.access = Access(options.host, options.token, options.origins)
        self._sockets = [_bound(options.host, options.port)]
        if options.tcp_port is not None:
            try:
                self._sockets.append(_bound(options.host, options.tcp_port))
            except InputError:
                self._sockets[0].close()
                raise
        try:
            LiveMission(scenario).step()
            self.mission = LiveMission(scenario)
        except BoresightError:
            self.close_sockets()
            raise
        self.port = int(self._sockets[0].getsockname()[1])
        """Port of HTTP and WebSocket."""
        self.tcp_port = int(self._sockets[1].getsockname()[1]) if len(self._sockets) > 1 else None
        """Port of TCP; None without."""
        self.loop: MissionLoop | None = None
        """Loop of the mission while `serve` runs."""
        self._stop: Callable[[], None] = lambda: None

    @property
    def url(self) -> str:
        """Address of the page."""
        host = f"[{self.options.host}]" if ":" in self.options.host else self.options.host
        return f"http://{host}:{self.port}/"

    def close_sockets(self) -> None:
        """Free the ports of a server that is not run."""
        for bound in self._sockets:
            bound.close()

    async def serve(self, started: Callable[[], None] = lambda: None) -> None:
        """Serve until `stop`; `started` is called when clients can connect."""
        import uvicorn

        options, running = self.options, asyncio.get_running_loop()
        display = None if options.stimulator is None else Stimulus(options.stimulator, options.refresh_hz)
        loop = MissionLoop(
            self.mission, options.recordings, speed=options.speed, paused=options.paused, stimulus=display
        )
        self.loop = loop
        if options.lockstep:
            await loop.use_source(external=True, lockstep=True)
        config = uvicorn.Config(
            self._application(loop),
            loop="asyncio",
            http=timed_protocol(),
            ws="websockets-sansio",
            lifespan="off",
            log_level="error",
            server_header=False,
            proxy_headers=False,
            ws_max_size=LARGEST_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=_SHUTDOWN_S,
        )
        server = _quiet(uvicorn.Server)(config)
        lines, line_server = LineServer(loop, self.access), None
        if self.tcp_port is not None:
            line_server = await asyncio.start_server(lines.serve, sock=self._sockets[1], limit=LARGEST_MESSAGE_BYTES)

        def stop() -> None:
            server.should_exit = True

        def stop_from_thread() -> None:
            running.call_soon_threadsafe(stop)

        self._stop = stop_from_thread
        making = asyncio.create_task(loop.run())
        making.add_done_callback(lambda _: stop())
        serving = asyncio.create_task(server.serve(sockets=self._sockets[:1]))
        try:
            while not server.started and not serving.done():
                await asyncio.sleep(0.005)
            started()
            await serving
        finally:
            await loop.close()
            if line_server is not None:
                line_server.close()
                await lines.close()
            await making

    def stop(self) -> None:
        """End `serve`, from any thread."""
        self._stop()

    # ------------------------------------------------------------------ HTTP and WebSocket
    def _application(self, loop: MissionLoop) -> Any:
        """The application: ``/``, ``/static``, ``/stimulator``, ``/healthz`` and ``/ws``."""
        from starlette.applications import Starlette
        from starlette.responses import JSONResponse
        from starlette.routing import Mount, Route, WebSocketRoute
        from starlette.staticfiles import StaticFiles

        async def health(_: Request) -> Response:
            return JSONResponse({"ok": True, "frame_rate_hz": loop.frame_rate_hz, "index": loop.mission.index})

        async def live(websocket: WebSocket) -> None:
            await _converse(websocket, loop, self.access)

        routes: list[Any] = [
            Route("/healthz", health),
            WebSocketRoute("/ws", live),
            Route("/", _page("index.html")),
            Route("/stimulator", _page("stimulator.html")),
            Route("/sky.json", _sky),
        ]
        if _PAGE.is_dir():
            routes.append(Mount("/static", StaticFiles(directory=_PAGE)))
        return _Guard(Starlette(routes=routes), self.access)


def _page(name: str) -> Any:
    async def page(_: Request) -> Response:
        from starlette.responses import FileResponse, PlainTextResponse

        if (_PAGE / name).is_file():
            return FileResponse(_PAGE / name)
        return PlainTextResponse(f"{name} is not part of this installation; the protocol is at /ws", 404)

    return page


def _sky(_: Request) -> Response:
    """Stars of the page's map; a function without async runs in a thread, as the first call reads the catalogue."""
    from starlette.responses import Response

    from simulator.live.bright_sky import bright_sky

    return Response(bright_sky(), media_type="application/json")


class _Guard:
    """Refuses requests for other hosts and WebSockets of other origins, and adds the security headers."""

    def __init__(self, application: Any, access: Access) -> None:
        self._application, self._access = application, access

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        from starlette.datastructures import Headers, MutableHeaders
        from starlette.responses import PlainTextResponse

        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        refused, status = "", 403
        if not is_host(host):
            refused, status = f"'{host[:100]}' is not the name of a host\n", 400
        elif self._access.refuses_host(host):
            refused = f"host '{host[:100]}' is not this server\n"
        elif scope["type"] == "websocket" and self._access.refuses_origin(origin, host):
            refused = f"origin '{str(origin)[:100]}' may not connect; start the server with --origin\n"
        if refused:
            answer = PlainTextResponse(refused, status)
            if scope["type"] == "http":
                await answer(scope, receive, send)
                return
            await receive()
            await send({"type": "websocket.http.response.start", "status": status, "headers": answer.raw_headers})
            await send({"type": "websocket.http.response.body", "body": answer.body})
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        await self._application(scope, receive, with_headers)


async def _converse(websocket: WebSocket, loop: MissionLoop, access: Access) -> None:
    """One WebSocket, from its opening to its end."""
    from starlette.websockets import WebSocketDisconnect

    await websocket.accept()
    with Session(loop, access, websocket.query_params.get("token", "")) as session:
        sending = asyncio.create_task(_send_all(session, websocket))
        code, reason = 1000, ""
        try:
            while not sending.done():
                try:
                    async with asyncio.timeout(None if session.greeted else HELLO_S):
                        message = await websocket.receive()
                except TimeoutError:
                    session.subscriber.reply(no_hello())
                    code, reason = 1008, no_hello().reason
                    break
                if message["type"] == "websocket.disconnect":
                    return
                if message.get("text") is None:
                    session.subscriber.reply(Error(code="malformed", reason="messages are text, not binary"))
                    continue
                await session.receive(message["text"])
        except SessionEnded as ended:
            code, reason = 1008, str(ended)
        finally:
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError, OSError):
                await sending
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
            for outgoing in session.subscriber.rest():
                await websocket.send_text(dump(outgoing.message))
            await websocket.close(code, reason[:100])


async def _send_all(session: Session, websocket: WebSocket) -> None:
    """What there is for a client, as fast as it takes it."""
    while True:
        for message, data in await session.subscriber.take():
            await websocket.send_text(dump(message))
            if data:
                await websocket.send_bytes(data)


def _quiet(server: type[Any]) -> type[Any]:
    """uvicorn's server without its own handling of signals."""

    class Quiet(server):  # type: ignore[misc]
        @contextlib.contextmanager
        def capture_signals(self) -> Iterator[None]:
            yield

    return Quiet


def _bound(host: str, port: int) -> socket.socket:
    """Socket that is bound; `InputError` if it cannot be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio turns off Nagle's delay by it
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host.strip("[]"), port))
        bound.listen(128)
    except (OSError, OverflowError) as error:
        bound.close()
        advice = "; is a server running? choose another --port" if port else ""
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{host}:{port}: {reason}{advice}") from None
    bound.setblocking(False)
    return bound


@contextlib.contextmanager
def serving(scenario: Scenario, options: ServerOptions = ServerOptions(port=0)) -> Iterator[LiveServer]:
    """A server in a thread, for notebooks and tests; it ends with the context."""
    server, ready = LiveServer(scenario, options), threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            asyncio.run(server.serve(ready.set))
        except BaseException as error:
            failed.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=run, name="boresight serve")
    thread.start()
    ready.wait()
    try:
        if failed:
            raise failed[0]
        yield server
    finally:
        server.stop()
        thread.join()
