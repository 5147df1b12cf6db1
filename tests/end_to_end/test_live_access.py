"""Who may connect to a live server, and hostile input: refused with a reason, while the mission goes on."""

import contextlib
import json
import socket
import time
import urllib.error
import urllib.request

import pytest
from live_client import lines, running, small, websocket
from websockets.exceptions import ConnectionClosed, InvalidStatus

from simulator.live import http_connections, session
from simulator.live import server as live_server
from simulator.live.protocol import LARGEST_MESSAGE_BYTES
from simulator.live.security import Access, TokenBucket, is_host
from simulator.live.server import LiveServer, ServerOptions
from startracker.errors import InputError

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A paused server, of which each test makes the frames that it needs."""
    with running(small("sequence.step_s=0.2"), paused=True, recordings=tmp_path_factory.mktemp("recordings")) as one:
        yield one


@pytest.fixture
def talk(server):
    with websocket(server) as one:
        one.hello()
        yield one
        one.command("source", attitude="scenario")


def repeat(times, call):
    for _ in range(times):
        call()


def still_serves(server):
    with websocket(server) as talk:
        talk.hello("solution")
        talk.send(type="command", name="step")
        talk.until("solution")


HOSTILE = [
    '{"type":"attitude","t_s":1,"quaternion":[NaN,0,0,1]}',
    '{"type":"attitude","t_s":Infinity,"quaternion":[0,0,0,1]}',
    "[" * 5000,
    "null",
    '"hello"',
    '{"type":"set","path":"__class__","value":1}',
    '{"type":"command","name":"record","folder":"../../etc"}',
    "\u0000\u0001\u0002",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_messages_are_refused_with_a_reason(server, talk, text):
    talk.send_raw(text)
    answer = talk.until("error")
    assert answer["code"] in ("malformed", "invalid")
    assert answer["reason"]
    still_serves(server)


def test_binary_messages_are_refused(server, talk):
    talk.send_raw(bytes(range(256)))
    assert "not binary" in talk.until("error")["reason"]
    still_serves(server)


def test_a_huge_message_ends_its_connection(server, talk):
    with websocket(server) as other:
        other.hello()
        other.send_raw("x" * (LARGEST_MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            other.until("reply")
        assert closed.value.rcvd.code == 1009  # message too big
    still_serves(server)


def test_a_flood_ends_its_connection(server, monkeypatch):
    monkeypatch.setattr(session, "BURST", 20.0)
    monkeypatch.setattr(session, "MESSAGES_PER_S", 1.0)
    with websocket(server) as talk:
        talk.hello()
        with pytest.raises(ConnectionClosed) as closed:
            repeat(200, lambda: talk.command("unblind"))
        assert closed.value.rcvd.code == 1008
        assert "messages a second" in closed.value.rcvd.reason
    monkeypatch.undo()
    still_serves(server)


def test_a_client_that_only_sends_nonsense_is_disconnected(server):
    with websocket(server) as talk:
        talk.hello()
        with pytest.raises(ConnectionClosed):
            repeat(2 * session.MOST_REFUSED, lambda: (talk.send_raw("nonsense"), talk.until("error")))
    still_serves(server)


@pytest.mark.parametrize("first", ["GET / HTTP/1.1", '{"type":"command","name":"pause"}', "", b"\xff\xfe\x00"])
def test_tcp_needs_a_hello_first(server, first):
    with lines(server) as talk:
        talk.send_raw(first if first else "{}")
        answer = talk.receive()
        assert answer["type"] == "error"
        assert answer["code"] in ("malformed", "invalid", "hello_first")
        assert not talk.receive_raw()  # closed
    still_serves(server)


def test_half_lines_and_long_lines_over_tcp(server):
    with lines(server) as talk:
        talk.hello()
        talk.socket.sendall(b'{"type":"command","na')
        talk.socket.sendall(b'me":"unblind","id":5}\n')
        assert talk.until("reply")["id"] == 5
        talk.socket.sendall(b'{"type":"half')
    with lines(server) as talk:
        talk.hello()
        talk.socket.sendall(b"x" * (LARGEST_MESSAGE_BYTES + 100))
        assert talk.until("error")["code"] == "malformed"
    still_serves(server)


def test_connections_that_are_dropped_are_forgotten(server):
    for _ in range(3):
        with lines(server) as talk:
            talk.hello("frame", frame_format="raw16")
            talk.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")  # reset
    deadline = time.monotonic() + 20.0
    while server.loop.hub.subscribers and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not server.loop.hub.subscribers
    still_serves(server)


def test_there_are_not_too_many_clients(server, monkeypatch):
    monkeypatch.setattr(session, "MOST_CLIENTS", 1)
    with websocket(server) as first:
        first.hello()
        with websocket(server) as second:
            assert second.ask(type="hello", protocol=1)["code"] == "busy"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1.evil.example", "file://"])
def test_pages_of_other_origins_may_not_connect(server, origin):
    with pytest.raises(InvalidStatus) as refused, websocket(server, origin=origin):
        pass
    assert refused.value.response.status_code == 403
    assert b"--origin" in refused.value.response.body
    still_serves(server)


def test_the_own_page_may_connect(server):
    with websocket(server, origin=server.url.rstrip("/")) as talk:
        talk.hello()


def test_a_name_that_was_redirected_to_this_machine_is_refused(server):
    request = urllib.request.Request(server.url, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request, timeout=30)
    assert refused.value.code == 403
    refused.value.close()


def asked(server, text):
    """What the server answers to bytes over HTTP before it closes the connection."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as connection:
        connection.sendall(text)
        return b"".join(iter(lambda: connection.recv(65536), b""))


@pytest.mark.parametrize(
    "host", ["[", "]", "[::1", "::1]", "[x]", "localhost:port", "localhost:99999", "a b", "a@localhost", "a/b", "½"]
)
@pytest.mark.parametrize("kind", ["page", "websocket"])
def test_a_host_that_is_not_a_name_is_refused_without_a_traceback(server, host, kind, caplog):
    asks = {
        "page": "Connection: close\r\n",
        "websocket": "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n",
    }
    answer = asked(server, f"GET /ws HTTP/1.1\r\nHost: {host}\r\n{asks[kind]}\r\n".encode("latin-1"))
    assert answer.startswith(b"HTTP/1.1 400"), answer
    assert not any(record.exc_info for record in caplog.records)


def test_hosts_with_ports_and_addresses_are_names():
    for host in ("", "localhost", "localhost:8042", "127.0.0.1:1", "[::1]", "[::1]:8042", "a_b.example"):
        assert is_host(host)


@pytest.mark.parametrize("path", ["static/%00", "static/" + 5000 * "a", "%00", "ws", "static/%ff"])
def test_strange_paths_are_not_found(server, path, caplog):
    answer = asked(server, f"GET /{path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
    assert answer.split()[1] in (b"404", b"400", b"426"), answer
    assert not caplog.records


@pytest.mark.parametrize(
    "begin",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: local",
        b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /heal",
        b"POST /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\nx",
    ],
    ids=["nothing", "half a header", "half a second header", "half a body"],
)
def test_requests_that_do_not_end_are_not_kept(server, begin, monkeypatch):
    monkeypatch.setattr(http_connections, "REQUEST_S", 0.5)
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as connection:
        connection.sendall(begin)
        started = time.monotonic()
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):
            while time.monotonic() - started < 10.0:
                connection.settimeout(0.1)
                try:
                    if not connection.recv(65536):
                        break
                except TimeoutError:  # bytes that arrive slowly do not begin the time anew
                    connection.sendall(b"a" if begin else b"")
        assert time.monotonic() - started < 5.0
    still_serves(server)


def test_a_websocket_without_a_hello_is_not_kept(server, monkeypatch):
    monkeypatch.setattr(live_server, "HELLO_S", 0.3)
    with websocket(server) as talk:
        assert talk.receive()["code"] == "hello_first"
        with pytest.raises(ConnectionClosed):
            talk.receive()
    still_serves(server)


def test_connections_in_use_outlive_the_limit(server, monkeypatch):
    monkeypatch.setattr(http_connections, "REQUEST_S", 0.5)
    monkeypatch.setattr(live_server, "HELLO_S", 0.5)
    with websocket(server) as talk:
        talk.hello("solution")
        time.sleep(1.0)
        talk.send(type="command", name="step")
        talk.until("solution")


def test_a_token_with_half_a_surrogate_pair_is_wrong():
    assert not Access("127.0.0.1", "secret").has_token("\ud800")


def test_health_and_headers(server):
    with urllib.request.urlopen(f"{server.url}healthz", timeout=30) as answer:
        assert json.loads(answer.read())["ok"]
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]


def test_files_outside_the_page_are_not_served(server):
    for path in ("static/../server.py", "static/%2e%2e/server.py", "static/..%2fserver.py", "server.py"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(server.url + path, timeout=30)
        assert refused.value.code == 404
        refused.value.close()


def test_a_token_is_needed_on_both_transports():
    with running(small(), paused=True, token="secret", origins=("https://bench.example",)) as server:
        for connection in (websocket, lines):
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1)["code"] == "token"
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1, token="wrong")["code"] == "token"
            with connection(server) as talk:
                assert talk.ask(type="hello", protocol=1, token="secret")["type"] == "welcome"
        with websocket(server, "ws?token=secret", origin="https://bench.example") as talk:
            assert talk.ask(type="hello", protocol=1)["type"] == "welcome"


def test_other_addresses_need_a_token():
    with pytest.raises(InputError, match="give a --token or BORESIGHT_TOKEN"):
        LiveServer(small(), ServerOptions(host="0.0.0.0", port=0))
    with pytest.raises(InputError, match=r"must look like https://example\.org"):
        Access("127.0.0.1", origins=("example.org",))
    for host in ("127.0.0.1", "localhost", "::1", "127.8.8.8"):
        assert Access(host).loopback
    assert not Access("192.168.1.4", "x").loopback


def test_a_bucket_refuses_what_is_beyond_its_rate(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    bucket = TokenBucket(10.0, 3.0)
    assert [bucket.take() for _ in range(4)] == [True, True, True, False]
    now[0] = 0.2
    assert [bucket.take() for _ in range(3)] == [True, True, False]
