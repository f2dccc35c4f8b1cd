"""Who may see the page and press its buttons, asked as a browser or a script would, and who is cut off."""

from __future__ import annotations

import http.client
import json
import logging
import os
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from autoexpose_daemon.page import serve as connection
from autoexpose_daemon.page.access import COOKIE
from autoexpose_daemon.page.serve import Connection, OnceAMinute, serve
from imaging.errors import AutoexposeError
from tests.autoexpose_daemon.page.browser import browser
from tests.autoexpose_daemon.page.server import PageProcess, running_page
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.scripted import FRONT_AND_REAR, scripted_daemon
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE

pytestmark = pytest.mark.wire

TOKEN = "0123456789abcdef-token"
HTML = {"Accept": "text/html"}


@pytest.fixture(scope="module")
def open_page() -> Iterator[PageProcess]:
    with running_page("--connect", endpoint()) as page:
        yield page


@pytest.fixture(scope="module")
def token_file(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("token") / "token"
    file.write_text(TOKEN + "\n")
    return str(file)


@pytest.fixture(scope="module")
def locked_page(token_file: str) -> Iterator[PageProcess]:
    with running_page("--connect", endpoint(), "--token-file", token_file) as page:
        yield page


def live(page: PageProcess, **headers: str) -> int:
    """Status of opening the web socket, or the code that closes it; 101 is success."""
    try:
        with connect(f"ws://{page.host}:{page.port}/live", additional_headers=headers, proxy=None) as socket:
            assert '"status"' in socket.recv(10)
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code
    except ConnectionClosedError as closed:
        assert closed.rcvd is not None
        return closed.rcvd.code


def test_this_machine_may_look(open_page: PageProcess) -> None:
    status, body, headers = open_page.get("/")
    assert (status, "<title>autoexpose</title>" in body) == (200, True)
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert open_page.get("/", {"Host": f"localhost:{open_page.port}"})[0] == 200
    assert open_page.get("/static/page.js")[0] == 200
    assert open_page.get("/static/../access.py")[0] == 404
    assert live(open_page) == 101


NOT_THIS_MACHINE = (
    "evil.example", "evil.example:8420", "", "localhost.evil.example", "[", "[::1]evil.example", "10.0.0.1",
    "evil.example@127.0.0.1", "127.0.0.1@evil.example", "127.0.0.1#.evil.example", "127.0.0.1?evil.example",
    "127.0.0.1/evil.example", "127.0.0.1:evil.example", "127.0.0.1 evil.example", "127.0.0.1:842000",
)  # fmt: skip


def test_a_name_that_suddenly_means_this_machine_is_refused(open_page: PageProcess) -> None:
    for host in NOT_THIS_MACHINE:
        status, body, _ = open_page.get("/", {"Host": host})
        assert (status, "127.0.0.1 and localhost only" in body) == (403, True), host


def test_whatever_comes_over_the_web_socket_leaves_no_traceback() -> None:
    with running_page("--connect", endpoint()) as page:
        for nonsense in (b"\xff\xfe", b"\xe2\x82"):
            for _ in range(2):
                with opened(page) as socket, pytest.raises(ConnectionClosedError, match="invalid frame payload data"):
                    socket.send(nonsense, text=True)
                    while True:
                        socket.recv(10)
        with opened(page) as socket, pytest.raises(ConnectionClosedError, match="message too big"):
            socket.send("n" * 2000)
            while True:
                socket.recv(10)
        with opened(page) as socket:
            for message in (b"\x00\xff", b"", "", "next"):
                socket.send(message)
            for _ in range(3):
                assert '"status"' in socket.recv(10)
        assert page.get("/")[0] == 200
        assert page.stop() == 0
        assert "Traceback" not in page.log
        assert page.log.count("Invalid UTF-8") == 1


def opened(page: PageProcess) -> ClientConnection:
    return connect(f"ws://{page.host}:{page.port}/live", proxy=None)


def test_the_same_nonsense_is_said_once_a_minute() -> None:
    now_s = 0.0
    passes = OnceAMinute(lambda: now_s).filter
    invalid, crash = record("Invalid HTTP request received."), record("Exception in ASGI application", KeyError("text"))
    assert [passes(invalid), passes(invalid), passes(record("something else"))] == [True, False, True]
    now_s = 61.0
    assert [passes(invalid), passes(crash), passes(crash)] == [True, True, True]
    assert crash.exc_info is not None


def record(message: str, error: Exception | None = None) -> logging.LogRecord:
    info = None if error is None else (type(error), error, None)
    return logging.LogRecord("uvicorn.error", logging.ERROR if error else logging.WARNING, "", 1, message, (), info)


def test_another_sites_script_gets_no_pictures(open_page: PageProcess) -> None:
    assert live(open_page, Origin="http://evil.example") == 403
    assert live(open_page, Origin=f"http://{open_page.host}:1") == 403
    assert live(open_page, Origin="null") == 403
    assert live(open_page, Origin=open_page.url) == 101


def test_without_the_token_there_is_nothing(locked_page: PageProcess) -> None:
    for path in ("/", "/live", "/metrics", "/nothing"):
        status, _, headers = locked_page.get(path)
        assert (status, headers["WWW-Authenticate"]) == (401, "Bearer"), path
    assert locked_page.get("/", {"Authorization": f"Bearer {TOKEN}x"})[0] == 401
    assert locked_page.get("/", {"Cookie": f"{COOKIE}={TOKEN}"})[0] == 401
    assert locked_page.get("/", {"Authorization": "Bearer t\u00f6ken"})[0] == 401
    assert "autoexpose_up" in locked_page.get("/metrics", {"Authorization": f"Bearer {TOKEN}"})[1]
    assert live(locked_page) == 403
    assert live(locked_page, Authorization=f"Bearer {TOKEN}") == 101
    assert locked_page.get("/", {"Authorization": f"Bearer {TOKEN}", "Host": "robot.example"})[0] == 200


def test_a_browser_logs_in(locked_page: PageProcess) -> None:
    status, _, headers = locked_page.get("/", HTML)
    assert (status, headers["Location"]) == (303, "/login")
    assert 'type="password"' in locked_page.get("/login")[1]
    status, _, headers = locked_page.ask("POST", "/login", HTML, "token=guess")
    assert (status, headers["Location"], headers["Set-Cookie"]) == (303, "/login?wrong", None)
    status, _, headers = locked_page.ask("POST", "/login", HTML, f"token={TOKEN}")
    assert (status, headers["Location"]) == (303, "/")
    cookie = headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert TOKEN not in cookie
    assert locked_page.get("/", HTML | {"Cookie": cookie.partition(";")[0]})[0] == 200
    assert live(locked_page, Cookie=cookie.partition(";")[0], Origin=locked_page.url) == 101
    assert live(locked_page, Cookie=cookie.partition(";")[0], Origin="http://evil.example") == 403
    assert locked_page.ask("POST", "/login", {"Origin": "http://evil.example"}, f"token={TOKEN}")[0] == 403
    assert locked_page.ask("POST", "/login", {}, "x" * 5000)[0] == 413


@pytest.mark.parametrize(
    ("rig", "host", "token_file", "words"),
    [
        ("rig", "0.0.0.0", None, ["--host 0.0.0.0 makes the page visible to others", "--token-file FILE"]),
        ("rig", "0.0.0.0", "missing", ["missing cannot be read", "openssl rand -hex 32 > "]),
        ("rig", "0.0.0.0", "short", ["short has fewer than 16 characters"]),
        ("rig", "203.0.113.1", "good", ["cannot listen on 203.0.113.1 port 8420"]),
        ("rig", "no.such.host.invalid", "good", ["cannot listen on no.such.host.invalid", "no address for that name"]),
        ("a/b", "127.0.0.1", None, ["a/b is not a valid name for a rig"]),
    ],
)
def test_what_cannot_be_is_named(tmp_path: Path, rig: str, host: str, token_file: str | None, words: list[str]) -> None:
    (tmp_path / "short").write_text("hunter2\n")
    (tmp_path / "good").write_text(TOKEN)
    with pytest.raises(AutoexposeError) as caught:
        serve(rig, [endpoint()], host, 8420, None if token_file is None else tmp_path / token_file)
    for word in words:
        assert word in str(caught.value)


def test_a_port_that_is_taken_is_one_sentence(open_page: PageProcess) -> None:
    taken = subprocess.run(
        [*AUTOEXPOSE, "page", "--port", str(open_page.port)], capture_output=True, text=True, timeout=60, check=False
    )
    sentence = f"the page cannot listen on 127.0.0.1 port {open_page.port}: Address already in use"
    assert (taken.returncode, taken.stderr) == (1, f"autoexpose: {sentence}\n")


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


LOCK = '{"locked": true}'
WITH_TOKEN = {"Authorization": f"Bearer {TOKEN}"}


def test_only_who_has_the_token_may_ask_and_only_for_what_there_are_buttons(
    open_page: PageProcess, locked_page: PageProcess
) -> None:
    def asked(body: str, **headers: str) -> tuple[int, str]:
        return locked_page.ask("POST", "/control", headers, body)[:2]

    assert open_page.ask("POST", "/control", {}, LOCK)[0] == 404
    assert asked(LOCK)[0] == 401
    assert asked(LOCK, **WITH_TOKEN, Origin="http://evil.example")[0] == 403
    assert locked_page.ask("GET", "/control", WITH_TOKEN)[0] == 405
    for body in ("", "{}", "[]", "{", '{"shot": {"exposure_time_us": 1}}', '{"by": "user"}', "[" * 1000):
        status, words = asked(body, **WITH_TOKEN)
        assert (status, "give a JSON object with some of" in words) == (400, True), body
    assert asked(json.dumps({"policy": "x" * 2000}), **WITH_TOKEN)[0] == 413
    status, words = asked(LOCK, **WITH_TOKEN)
    assert status == 409 and "no answer for rig rig" in words
    locked_page.hang_up("/control", WITH_TOKEN)
    assert locked_page.get("/login")[0] == 200
    assert "Traceback" not in locked_page.log


@pytest.mark.needs("chromium")
def test_what_is_pressed_applies(token_file: str) -> None:
    at = endpoint()
    with (
        running_page("--connect", at, "--token-file", token_file) as page,
        browser() as tab,
        scripted_daemon(publish={"listen": [at]}) as (daemon, _, _),
    ):
        asked = daemon.telemetry.requests
        tab.open(f"{page.url}/login")
        tab.value(f"document.querySelector('input').value = '{TOKEN}'; document.querySelector('form').submit()")
        tab.wait_for("document.getElementById('buttons')?.checkVisibility()", "buttons")
        tab.value("document.getElementById('lock').click()")
        wait_until(lambda: asked.locked is not None and asked.latest == "lock, asked by page", "the lock")
        tab.wait_for("document.getElementById('lock').innerText === 'unlock'", "the lock on the page")
        assert tab.text("#asked") == "lock, asked by page"
        status, words, _ = page.ask("POST", "/control", WITH_TOKEN, '{"ev_stops": 9}')
        assert (status, words) == (409, "ev_stops: 9.0 is out of bounds: give -3 to 3 stops\n")
        for _ in range(2):  # sooner than a status shows the first
            tab.value("document.getElementById('darker').click()")
        wait_until(lambda: asked.ev_stops == -1.0, "the compensation")
        tab.value(
            "(() => { const choice = document.getElementById('policies'); choice.value = 'neves2009';"
            "choice.dispatchEvent(new Event('change')); })()"
        )
        wait_until(lambda: daemon.tuning.config.control.policy == "neves2009", "the policy")
        tab.wait_for("document.querySelector('.policy').innerText.includes('by neves2009')", "the policy on the page")
        if "PAGE_SCREENSHOTS" in os.environ:
            tab.screen(1300, 900)
            tab.screenshot(Path(os.environ["PAGE_SCREENSHOTS"]) / "page-buttons.png")
        tab.value("document.getElementById('reset').click()")
        wait_until(lambda: asked.locked is None and not asked.changed, "the configuration")
        assert tab.complaints == []


@pytest.mark.needs("chromium")
def test_buttons_are_for_the_chosen_group_or_for_all(token_file: str) -> None:
    at = endpoint()
    with (
        running_page("--connect", at, "--token-file", token_file) as page,
        browser() as tab,
        scripted_daemon(publish={"listen": [at]}, cameras=FRONT_AND_REAR) as (daemon, _, _),
    ):
        front, rear = (daemon.groups[name].tally.requests for name in ("front", "rear"))

        def choose(group: str) -> None:
            tab.value(
                f"(() => {{ const choice = document.getElementById('group'); choice.value = '{group}';"
                "choice.dispatchEvent(new Event('change')); })()"
            )

        def press(button: str) -> None:
            tab.value(f"document.getElementById('{button}').click()")

        tab.open(f"{page.url}/login")
        tab.value(f"document.querySelector('input').value = '{TOKEN}'; document.querySelector('form').submit()")
        tab.wait_for("document.getElementById('group')?.checkVisibility()", "the choice of a group")
        assert tab.value("[...document.getElementById('group')].map(({ value }) => value)") == [
            *("all groups", "front", "rear")
        ]
        choose("rear")
        press("darker")
        wait_until(lambda: rear.ev_stops == -0.5, "the compensation")
        tab.wait_for("document.getElementById('ev').innerText.includes('0.50')", "the compensation on the page")
        assert (front.ev_stops, rear.latest) == (0.0, "EV -0.5 of group rear, asked by page")
        choose("all groups")
        assert tab.text("#ev") == "EV differs"
        assert tab.value("document.getElementById('darker').disabled")
        press("lock")
        wait_until(lambda: front.locked is not None and rear.locked is not None, "the lock")
        tab.wait_for("document.getElementById('lock').innerText === 'unlock'", "the lock on the page")
        assert tab.text("#asked") == "lock of group front, asked by page; lock of group rear, asked by page"
        choose("front")
        press("lock")
        wait_until(lambda: front.locked is None, "the end of the lock")
        assert rear.locked is not None
        tab.wait_for("document.querySelector('[data-group=rear] .policy').innerText.includes('locked at')", "the rest")
        assert tab.complaints == []
