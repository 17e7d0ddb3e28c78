"""Who may ask a server of viser: its own page and programs of this machine's user, not pages of other sites."""

import contextlib
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from importlib.util import find_spec

import pytest
import rich
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.rendering.viser_server import quiet_server, refusal

pytestmark = pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed")
PROTOCOL = f"viser-v{version('viser')}" if find_spec("viser") else ""


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:9", "[::1]:8080", "192.168.0.7:8080", "Box.lab:80"])
def test_its_own_page_is_answered_by_whatever_name_of_its_own(host):
    # As a tunnel does: another port than that at which the server listens.
    for origin in (f"http://{host}", f"https://{host}".lower()):
        assert refusal({"Host": host, "Origin": origin}, "box.lab") == ""
    assert refusal({"Host": host}, "box.lab") == ""
    assert refusal({"Host": socket.gethostname()}, "0.0.0.0") == ""


@pytest.mark.parametrize(
    ("host", "origin", "why"),
    [
        ("127.0.0.1:8080", "http://evil.example", "pages of 'http://evil.example' may not connect"),
        ("127.0.0.1:8080", "http://127.0.0.1:8081", "may not connect"),  # another server of this machine
        ("127.0.0.1:8080", "http://127.0.0.1:8080.evil.example", "may not connect"),
        ("127.0.0.1:8080", "null", "pages of 'null'"),  # a file, or a frame in a sandbox
        # A site whose name leads to this machine meanwhile: of the same origin, but not by a name of its own.
        ("evil.example:8080", "http://evil.example:8080", "not known as 'evil.example:8080'"),
        ("evil.example:8080", None, "not known as"),
        ("127.0.0.1.evil.example", None, "not known as"),
        ("", None, "not known as ''"),
        ("[", None, "not known as"),
    ],
)
def test_pages_of_other_sites_are_refused(host, origin, why):
    headers = {"Host": host} if origin is None else {"Host": host, "Origin": origin}
    assert why in refusal(headers, "127.0.0.1")


def test_its_messages_are_seen_nowhere_and_servers_start_in_several_threads(capsys, monkeypatch):
    def serve(_):
        with quiet_server() as server:
            return server.get_port()

    before = sys.stdout
    with ThreadPoolExecutor(3) as threads:
        assert all(threads.map(serve, range(9)))
    assert sys.stdout is before
    assert capsys.readouterr().out == ""
    # In a notebook rich writes to no stream.
    monkeypatch.setattr(rich.get_console(), "is_jupyter", True)
    shown = []
    monkeypatch.setattr("rich.jupyter.display", lambda *_: shown.append(_))
    serve(0)
    assert shown == []


def test_a_page_of_another_origin_gets_no_byte_of_the_scene():
    with quiet_server() as server:
        address = f"127.0.0.1:{server.get_port()}"

        def ask(**headers):
            return connect(f"ws://{address}", subprotocols=[PROTOCOL], **headers)

        with ask(origin=f"http://{address}") as own, ask() as program:
            assert own.recv()
            assert program.recv()
        with pytest.raises(InvalidStatus, match="HTTP 403") as refused:
            ask(origin="http://evil.example")
        assert b"'http://evil.example' may not connect" in refused.value.response.body
        # Sites' scripts cannot read what another origin's server answers; but by a name of their own they could.
        with socket.create_connection(("127.0.0.1", server.get_port())) as raw:
            raw.sendall(b"GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n")
            answer = b"".join(iter(lambda: raw.recv(65536), b""))
        assert answer.startswith(b"HTTP/1.1 403 ")
        assert b"<html" not in answer


def test_it_stops_whatever_connections_a_browser_holds(caplog):
    with contextlib.ExitStack() as held:
        with quiet_server() as server:
            address = "127.0.0.1", server.get_port()
            _, kept = (held.enter_context(socket.create_connection(address)) for _ in range(2))
            kept.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert kept.recv(15) == b"HTTP/1.1 200 OK"
            begin = time.monotonic()
        assert time.monotonic() - begin < 4.0
    assert not caplog.records


def test_a_viser_that_starts_otherwise_is_not_let_run_unasked(monkeypatch):
    with quiet_server() as server:
        kind = type(server)
    stopped = []

    class Otherwise(kind):
        def __init__(self, **settings):
            pass

        def stop(self):
            stopped.append(self)

    monkeypatch.setattr("viser.ViserServer", Otherwise)
    with pytest.raises(LieEDNNError, match="starts its server in an unknown way"), quiet_server():
        pass
    assert stopped
