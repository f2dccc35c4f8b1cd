"""What the doctor says of who gets frames and may change the control."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.doctor import access
from autoexpose_daemon.doctor.access import judge_access
from autoexpose_daemon.doctor.facts import Diagnosis
from autoexpose_daemon.messages import sockets
from tests import REPOSITORY


@pytest.fixture
def folder(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The service's, on a machine where anna and ros are in its group."""
    folder = sockets.SYSTEM_FOLDER
    folder.mkdir()
    folder.chmod(0o750)
    monkeypatch.setattr(access, "SYSTEM_FOLDER", folder)
    monkeypatch.setattr(access, "_users", lambda _gid: ["anna", "ros"])
    return folder


@contextlib.contextmanager
def listening(path: Path, mode: int = 0o660) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        path.chmod(mode)
        listener.listen()
        yield


def only(publish: PublishConfig | None = None) -> Diagnosis:
    (finding,) = judge_access(publish)
    return finding


def test_a_socket_is_told_with_those_who_may_use_it(folder: Path) -> None:
    with listening(folder / "scout.sock"):
        finding = only()
        assert (finding.check, finding.severity, finding.fix) == ("socket", "ok", None)
        for fact in (str(folder / "scout.sock"), "srw-rw----", "drwxr-x---", "of the rig scout to ", "anna, ros"):
            assert fact in finding.sentence
        assert "no daemon" not in finding.sentence
    assert "no daemon listens there" in only().sentence


@pytest.mark.parametrize(("of_folder", "of_socket"), [(0o700, 0o660), (0o750, 0o640)])
def test_permissions_that_shut_the_group_out_are_seen(folder: Path, of_folder: int, of_socket: int) -> None:
    folder.chmod(of_folder)
    with listening(folder / "rig.sock", of_socket):
        assert only().sentence.endswith(" alone")


def test_a_group_without_members_is_told_how_to_get_some(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "_users", lambda _gid: [])
    with listening(folder / "rig.sock"):
        finding = only()
    assert finding.severity == "ok"
    assert finding.fix is not None and "usermod -aG" in finding.fix


def test_a_socket_for_everybody_is_a_warning(folder: Path) -> None:
    folder.chmod(0o755)
    with listening(folder / "rig.sock", 0o666):
        finding = only()
    assert finding.severity == "warning"
    assert "every user of this machine" in finding.sentence
    assert finding.fix == f"sudo chmod o-rwx {folder}"


def test_nothing_is_said_of_sockets_that_nobody_has_or_wants(folder: Path) -> None:
    assert list(judge_access(None)) == []
    assert str(folder) in only(PublishConfig()).sentence


@pytest.mark.parametrize(
    ("endpoint", "facts"),
    [
        ("tcp/127.0.0.1:7448", ["every user of this machine"]),
        ("tcp/localhost:7448", ["every user of this machine"]),
        ("tcp/[::1]:7448", ["every user of this machine"]),
        ("tcp/10.0.0.2:7448", ["everyone who can reach", "unencrypted"]),
        ("udp/0.0.0.0:7448", ["everyone who can reach", "unencrypted"]),
        ("tls/0.0.0.0:7448", ["everyone who can reach"]),
    ],
)
def test_an_open_port_is_a_warning(folder: Path, endpoint: str, facts: list[str]) -> None:
    finding = next(found for found in judge_access(PublishConfig(listen=(endpoint,))) if found.check == "network")
    assert finding.severity == "warning"
    assert all(fact in finding.sentence for fact in [endpoint, *facts])
    assert ("unencrypted" in finding.sentence) == ("unencrypted" in facts)
    assert finding.fix is not None and "publish" in finding.fix


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("access_control: {enabled: true, default_permission: 'deny'}", "access control"),
        ("transport: {link: {tls: {enable_mtls: true}}}", "certificates"),
        ("", "everyone who can reach"),
    ],
)
def test_zenohs_own_file_is_read(folder: Path, more: str, words: str) -> None:
    file, path = folder / "zenoh.json5", folder / "mine.sock"
    endpoints = f"['tls/0.0.0.0:7448', 'unixsock-stream/{path}']"
    file.write_text(f"{{listen: {{endpoints: {endpoints}}}, {more}}}")
    with listening(path):
        ours, network = judge_access(PublishConfig(zenoh=file))
    assert (ours.check, network.check) == ("socket", "network")
    assert network.severity == ("ok" if more else "warning")
    assert words in network.sentence
    file.write_text("{}")  # it leaves open where the daemon listens
    assert "network" not in {found.check for found in judge_access(PublishConfig(zenoh=file))}


def test_the_example_lets_in_others_with_certificates_only() -> None:
    _, network = judge_access(PublishConfig(zenoh=REPOSITORY / "examples/zenoh-robot.json5"))
    assert (network.check, network.severity) == ("network", "ok")
    assert "access control" in network.sentence and "tls/10.0.0.2:7448" in network.sentence


def test_a_router_decides_for_itself(folder: Path) -> None:
    *_, finding = judge_access(PublishConfig(connect=("tcp/10.0.0.1:7447",)))
    assert (finding.check, finding.severity) == ("network", "ok")
    assert "tcp/10.0.0.1:7447" in finding.sentence


def test_the_groups_users_are_found() -> None:
    assert "root" in access._users(0)
    assert access._users(61_000) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may run processes of other users")
def test_a_user_outside_the_group_is_told_how_to_get_in(folder: Path) -> None:
    folder.parent.chmod(0o755)
    program = (
        "from pathlib import Path; from autoexpose_daemon.messages import sockets; "
        f"sockets.SYSTEM_FOLDER = Path({str(folder)!r}); from autoexpose_daemon.doctor.access import judge_access; "
        "print(*judge_access(None))"
    )
    run = subprocess.run(
        [sys.executable, "-B", "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False,
        user=61_003, group=61_003, extra_groups=[],
    )  # fmt: skip
    if "PermissionError" in run.stderr or "ModuleNotFoundError" in run.stderr:
        pytest.skip("other users may not read this checkout, or its Python")
    assert "severity='warning'" in run.stdout, run.stderr
    assert str(folder) in run.stdout and "usermod -aG root 61003" in run.stdout
