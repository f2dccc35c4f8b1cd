"""Who may see the page, asked as a browser or a script would, of a page that waits for its daemon."""

from __future__ import annotations

import contextlib
import logging
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from autoexpose_daemon.page.access import COOKIE
from autoexpose_daemon.page.app import CROWDED
from autoexpose_daemon.page.pair_views import MOST_VIEWERS
from autoexpose_daemon.page.serve import OnceAMinute, serve
from imaging.errors import AutoexposeError
from tests.autoexpose_daemon.page.server import PageProcess, running_page
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE

TOKEN = "0123456789abcdef-token"
HTML = {"Accept": "text/html"}


@pytest.fixture(scope="module")
def open_page() -> Iterator[PageProcess]:
    with running_page("--connect", endpoint()) as page:
        yield page


@pytest.fixture(scope="module")
def locked_page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    file = tmp_path_factory.mktemp("token") / "token"
    file.write_text(TOKEN + "\n")
    with running_page("--connect", endpoint(), "--token-file", str(file)) as page:
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


def test_viewers_beyond_a_number_are_refused(open_page: PageProcess) -> None:
    with contextlib.ExitStack() as viewers:
        for _ in range(MOST_VIEWERS):
            viewers.enter_context(opened(open_page))
        assert live(open_page) == CROWDED
    wait_until(lambda: live(open_page) == 101, "a place to be free")


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


def test_who_hangs_up_during_the_login_leaves_no_traceback(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    with running_page("--connect", endpoint(), "--token-file", str(file)) as page:
        page.hang_up("/login")
        assert page.get("/login")[0] == 200
        assert page.stop() == 0
        assert "Traceback" not in page.log


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


def test_ctrl_c_ends_it_cleanly_while_somebody_watches() -> None:
    with (
        running_page("--connect", endpoint()) as page,
        connect(f"ws://{page.host}:{page.port}/live", proxy=None) as socket,
    ):
        socket.recv(10)
        assert page.stop() == 0
        assert "Traceback" not in page.log
