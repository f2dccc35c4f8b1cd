"""Clients that connect and say nothing, or too little, do not keep others from the page."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from autoexpose_daemon.page import serve as connection
from autoexpose_daemon.page.serve import Connection
from tests.autoexpose_daemon.publish.steps import wait_until

pytestmark = pytest.mark.wire

WHOLE = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
LARGE = b"x" * (32 << 20)


async def answer(request: Request) -> Response:
    return Response(LARGE) if request.url.path == "/large" else PlainTextResponse("here")


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Of a server whose connections take requests for 0.3 s, last 1 s, and are at most 20."""
    for name, value in (("ASKS_S", 0.3), ("LASTS_S", 1.0), ("MOST_CONNECTIONS", 20)):
        monkeypatch.setattr(connection, name, value)
    app = Starlette(routes=[Route("/{path:path}", answer)])
    server = uvicorn.Server(uvicorn.Config(app, http=Connection, log_config=None, timeout_graceful_shutdown=2))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        wait_until(lambda: server.started, "the server")
        yield listener.getsockname()[1]
        server.should_exit = True
        thread.join()


def get(port: int) -> str:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as client:
        client.request("GET", "/")
        return client.getresponse().read().decode()


def is_answered(port: int) -> bool:
    try:
        return get(port) == "here"
    except (ConnectionError, http.client.HTTPException):
        return False


@pytest.mark.parametrize("sent", [b"", WHOLE[:-2], b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\nx"])
def test_clients_that_do_not_finish_are_cut(port: int, sent: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
        client.sendall(sent)
        while client.recv(4096):
            pass


def test_a_client_that_does_not_read_is_cut(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
        client.sendall(WHOLE.replace(b"/ ", b"/large ", 1))
        threading.Event().wait(1.5)
        received = 0
        try:
            while piece := client.recv(1 << 20):
                received += len(piece)
        except ConnectionResetError:
            pass
        assert received < len(LARGE)


def test_a_crowd_that_says_nothing_passes(port: int) -> None:
    with ExitStack() as stack:
        for _ in range(100):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10))
        wait_until(lambda: is_answered(port), "an answer")


def test_a_connection_may_ask_again(port: int) -> None:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as client:
        for _ in range(3):
            client.request("GET", "/")
            assert client.getresponse().read() == b"here"
