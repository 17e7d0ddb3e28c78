"""A server of viser that answers only its own page.

A browser lets any open site connect to a local port, and viser's server (https://viser.studio), which is optional,
would answer it. So each request is first checked by the headers that browsers set and sites cannot change.
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import socket
import threading
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import rich

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.registry import optional_module

# Held while viser starts or stops a server. Meanwhile rich is quiet, by which viser prints, in a notebook to no stream.
_starting = threading.Lock()


@contextlib.contextmanager
def quiet_server(host: str = "127.0.0.1", port: int = 0) -> Iterator[Any]:
    """A `viser.ViserServer` without its messages, by default at a free port, which checks requests by `refusal`.

    `LieEDNNError` if viser is not installed, or the check cannot be put into its server.
    """
    viser = optional_module("viser")
    with _asking(host) as asked:
        server = viser.ViserServer(host=host, port=port, verbose=False)
    try:
        if not asked:
            raise LieEDNNError(f"viser {viser.__version__} starts its server in an unknown way; install viser 1.1")
        yield server
    finally:
        # The server waits for open connections, also for one that a browser holds unused: abort them after 0.3 s.
        for connection in [each for started in asked for each in list(started.server.handlers)]:
            connection.loop.call_soon_threadsafe(connection.loop.call_later, 0.3, connection.transport.abort)
        with _starting, patch.object(rich.get_console(), "quiet", True):
            server.stop()


def refusal(headers: Mapping[str, str], host: str) -> str:
    """Why a server that listens at ``host`` refuses a request with these headers; empty if it does not.

    ``Host`` must be a numeric address, the name of this machine, or ``host``: a site whose name was redirected to this
    machine (DNS rebinding) still sends its own name. ``Origin``, if given, must be the same: other sites have others.
    """
    asked = headers.get("Host", "")
    own = socket.gethostname().lower()
    if _name(asked) not in {"localhost", host.lower(), own, f"{own}.local"} and not _is_address(_name(asked)):
        return f"this page is not known as {asked!r}; open it at its address in numbers, or let it listen at that name"
    origin = headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc.lower() != asked.lower():
        return f"pages of {origin!r} may not connect to {asked!r}"
    return ""


def _name(netloc: str) -> str:
    with contextlib.suppress(ValueError):
        return urlsplit(f"//{netloc}").hostname or ""
    return ""


def _is_address(name: str) -> bool:
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return False


@contextlib.contextmanager
def _asking(host: str) -> Iterator[list[Any]]:
    """Let servers that start in the block check each request; yields the list of these servers.

    viser has no setting for this, but uses a server of websockets, which calls ``process_request`` first.
    """
    import websockets.asyncio.server as websockets_server

    asked = list[Any]()

    def serve_own_page(*args: Any, process_request: Any, **settings: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            if reason := refusal(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            return process_request(connection, request)

        quiet = logging.Logger("viser", logging.CRITICAL)  # a connection without a request is no error
        asked.append(serve(*args, process_request=process, logger=quiet, **settings))
        return asked[-1]

    with _starting, patch.object(rich.get_console(), "quiet", True):
        serve = websockets_server.serve
        with patch.object(websockets_server, "serve", serve_own_page):
            yield asked
