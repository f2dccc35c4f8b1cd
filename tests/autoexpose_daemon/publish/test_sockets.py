"""The Unix sockets of rigs on one machine: who finds them, who may use them, and who must not listen there."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from autoexpose_daemon.client import RigClient
from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.client.status_client import FleetClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages import sockets
from autoexpose_daemon.messages.sockets import barrier, client_endpoints, daemon_endpoint, socket_of
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, SessionError, listened, open_session
from imaging.errors import AutoexposeError
from tests import REPOSITORY
from tests.autoexpose_daemon.publish.processes import Account, consumer, service
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, nothing, publishing, telling, told, wait_until
from tests.autoexpose_daemon.publish.test_publisher import certify
from tests.autoexpose_daemon.samples import EXPOSING
from tests.autoexpose_daemon.scripted import scripted_daemon
from tests.fakes import loopback_address

pytestmark = pytest.mark.wire

DAEMON = Account(61_001, 61_000)
MEMBER = Account(61_002, 61_002, (61_000,))
STRANGER = Account(61_003, 61_003)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def path_of(endpoint: str) -> Path:
    path = socket_of(endpoint)
    assert path is not None
    return path


def trouble_of(config: PublishConfig) -> str:
    """Why it does not publish."""
    with Publisher(config, ("left", "right"), nothing) as publisher:
        wait_until(lambda: publisher.tally.trouble, "the complaint")
        return publisher.tally.trouble


def test_a_daemon_and_a_client_meet_without_being_told_where(own_machine: Path) -> None:
    with RigClient() as client, publishing(PublishConfig()):  # the client waits for it
        assert client.next_set(PATIENCE_S) is not None
        path = own_machine / "user" / "autoexpose" / "rig.sock"
        assert (mode_of(path), mode_of(path.parent)) == (0o660, 0o700)
    assert not path.exists()


def test_rigs_of_one_machine_have_a_socket_each(own_machine: Path) -> None:
    with publishing(PublishConfig(rig="one")), publishing(PublishConfig(rig="two")):
        for rig in ("one", "two"):
            with RigClient(rig) as client:
                assert client.next_set(PATIENCE_S) is not None


def test_the_service_comes_first_and_nobody_takes_its_name(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = sockets.SYSTEM_FOLDER
    with publishing(PublishConfig()) as users:
        wait_until(lambda: users.tally.sent, "the user's daemon")
        folder.mkdir(0o750)
        monkeypatch.setenv("RUNTIME_DIRECTORY", str(folder))
        with publishing(PublishConfig()) as services, RigClient(name="seen") as client:
            wait_until(lambda: services.tally.sent, "the service")
            assert client.next_set(PATIENCE_S) is not None
            wait_until(lambda: services.tally.consumers.listed(0), "the consumer's report")
    with publishing(PublishConfig()):
        wait_until((folder / "rig.sock").exists, "the service")
        monkeypatch.delenv("RUNTIME_DIRECTORY")
        trouble = trouble_of(PublishConfig())
        assert str(os.getpid()) in trouble and str(folder / "rig.sock") in trouble and "publish.rig" in trouble
        assert not path_of(daemon_endpoint("rig")).exists()


def test_a_second_daemon_is_refused_until_the_first_one_ends(own_machine: Path) -> None:
    at = path_of(daemon_endpoint("rig"))
    with contextlib.ExitStack() as first:
        first.enter_context(publishing(PublishConfig()))
        wait_until(at.exists, "the first")
        with publishing(PublishConfig()) as second:
            wait_until(lambda: second.tally.trouble, "the complaint")
            assert f"process {os.getpid()} of the user " in second.tally.trouble and str(at) in second.tally.trouble
            first.close()
            wait_until(lambda: second.tally.sent, "the second")
            assert second.tally.trouble == ""


def test_what_a_killed_daemon_leaves_behind_does_not_keep_the_next_one_from_starting(socket_folder: Path) -> None:
    at = f"unixsock-stream/{socket_folder}/rig.sock"
    with consumer("patient", at) as patient:
        with service(socket_folder) as daemon:
            patient.wait_for_first()
            daemon.send_signal(signal.SIGKILL)
            daemon.wait()
        assert path_of(at).is_socket()
        with publishing(PublishConfig(listen=(at,))) as next_one:
            wait_until(lambda: next_one.tally.consumers.listed(0), "the consumer, which found it again")
            assert next_one.tally.trouble == ""


def test_files_and_folders_of_others_are_left_alone(own_machine: Path) -> None:
    path = path_of(daemon_endpoint("rig"))
    path.parent.mkdir()
    path.write_text("mine")
    assert str(path) in trouble_of(PublishConfig())
    assert path.read_text() == "mine"
    assert "/nowhere" in trouble_of(PublishConfig(listen=("unixsock-stream//nowhere/at/all.sock",)))


def test_a_path_that_is_too_long_for_a_socket_is_named(own_machine: Path) -> None:
    assert "x" * 100 in trouble_of(PublishConfig(rig="x" * 100))


def test_sockets_of_a_configuration_file_are_for_the_group_too(socket_folder: Path) -> None:
    path = socket_folder / "mine.sock"
    file = socket_folder / "zenoh.json5"
    for endpoints in (f'["unixsock-stream/{path}"]', f'{{peer: ["unixsock-stream/{path}"]}}'):
        file.write_text(f"{{listen: {{endpoints: {endpoints}}}}}")
        with publishing(PublishConfig(zenoh=file)) as publisher:
            wait_until(lambda publisher=publisher: publisher.tally.sent, "the session")
            assert mode_of(path) == 0o660


def test_where_a_session_listens() -> None:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", '{peer: ["tcp/127.0.0.1:0"], router: ["tcp/[::]:7447"]}')
    assert listened(config, "peer") == ["tcp/127.0.0.1:0"]
    assert listened(config, "client") == []


def test_folders(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = own_machine / "user"
    assert daemon_endpoint("a") == f"unixsock-stream/{session}/autoexpose/a.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/autoexpose:/run/other")
    assert daemon_endpoint("a") == "unixsock-stream//run/autoexpose/a.sock"
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setattr(sockets, "_TEMPORARY", own_machine)
    for value in ("", "relative", "/nowhere"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", value)
        assert daemon_endpoint("a") == f"unixsock-stream/{own_machine}/autoexpose-{os.geteuid()}/a.sock"
    services, own = client_endpoints("a")
    assert (services, own) == (f"unixsock-stream/{own_machine}/run/a.sock", daemon_endpoint("a"))
    assert mode_of(own_machine / f"autoexpose-{os.geteuid()}") == 0o700  # nobody else can make it now


def test_a_link_in_place_of_the_users_folder_is_not_followed(
    own_machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "_TEMPORARY", own_machine)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    (own_machine / f"autoexpose-{os.geteuid()}").symlink_to(own_machine / "user")
    assert len(client_endpoints("a")) == 1


def test_a_client_that_is_not_answered_names_the_rigs_that_there_are(own_machine: Path) -> None:
    with (
        publishing(PublishConfig(rig="scout")) as scout,
        pytest.raises(AutoexposeError, match=r"no answer for rig rig from .*rigs of this machine: scout"),
    ):
        wait_until(lambda: scout.tally.sent, "the other rig")
        with ControlClient():
            pass


def test_all_rigs_of_the_machine_are_found_also_later_ones(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autoexpose_daemon.client.status_client._LOOK_S", 0.05)

    def rigs() -> set[str]:
        return {line.rig for line in client.fleet.lines(0.0)}

    def daemon(rig: str) -> contextlib.AbstractContextManager[Publisher]:
        return telling(daemon_endpoint(rig), told(replace(EXPOSING, rig=rig)), rig)

    with FleetClient() as client:
        assert all("*.sock" in place for place in client.unanswered)
        with daemon("one"):
            wait_until(lambda: rigs() == {"one"}, "the first rig")
            with daemon("two"):
                wait_until(lambda: rigs() == {"one", "two"}, "both")


@contextlib.contextmanager
def bound(path: Path) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        yield


def test_a_socket_that_is_open_or_absent_is_no_matter_of_permissions(socket_folder: Path) -> None:
    path = socket_folder / "rig.sock"
    assert barrier(path) is None
    with bound(path):
        assert barrier(path) is None


@pytest.fixture
def service_folder(socket_folder: Path) -> Path:
    """As systemd makes it for the unit; skips where other users could not run this test's programs."""
    if os.geteuid() != 0:
        pytest.skip("only root may run processes of other users")
    python = [sys.executable, "-c", "import autoexpose_daemon.publish, zenoh"]
    if subprocess.run(python, cwd=REPOSITORY, capture_output=True, check=False, **STRANGER.starts()).returncode != 0:
        pytest.skip("other users may not read this checkout, or its Python")
    socket_folder.chmod(0o755)
    folder = socket_folder / "autoexpose"
    folder.mkdir()
    os.chown(folder, DAEMON.uid, DAEMON.gid)
    folder.chmod(0o750)
    return folder


def as_user(account: Account, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-B", "-c", "from autoexpose_daemon.cli import main; main()", *arguments]
    return subprocess.run(
        command, cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=False, **account.starts()
    )


def test_the_groups_members_get_frames_and_control_and_nobody_else_gets_anything(service_folder: Path) -> None:
    path = service_folder / "rig.sock"
    at = f"unixsock-stream/{path}"
    with service(service_folder, DAEMON):
        assert (mode_of(path), path.stat().st_uid, path.stat().st_gid) == (0o660, DAEMON.uid, DAEMON.gid)
        with consumer("member", at, account=MEMBER) as member, consumer("stranger", at, account=STRANGER) as stranger:
            member.wait_for_first()
            locked = as_user(MEMBER, "ctl", "--connect", at, "lock")
            assert (locked.returncode, "locked at" in locked.stdout) == (0, True), locked.stderr
            refused = as_user(STRANGER, "ctl", "--connect", at, "unlock")
            assert refused.returncode != 0
            assert f"{service_folder} is for members of the group {DAEMON.gid}" in refused.stderr
            shown = as_user(MEMBER, "ctl", "--connect", at, "show")
            assert "locked at" in shown.stdout
            assert member.result()["tally"]["pairs"] > 0
            assert stranger.result()["tally"]["pairs"] == 0


def test_in_an_open_folder_the_socket_itself_keeps_strangers_out(service_folder: Path) -> None:
    service_folder.chmod(0o755)
    at = f"unixsock-stream/{service_folder}/rig.sock"
    with service(service_folder, DAEMON):
        refused = as_user(STRANGER, "top", "--once", "--connect", at)
        assert refused.returncode != 0
        assert f"{service_folder}/rig.sock is for members of" in refused.stderr


def test_nobody_is_sent_into_a_group_that_is_shut_out_too(service_folder: Path) -> None:
    service_folder.chmod(0o700)
    refused = as_user(MEMBER, "ctl", "--connect", f"unixsock-stream/{service_folder}/rig.sock", "show")
    assert f"{service_folder} is for {DAEMON.uid} alone" in refused.stderr


def test_a_folder_of_another_user_is_not_used(service_folder: Path) -> None:
    os.chown(service_folder, STRANGER.uid, STRANGER.gid)
    with pytest.raises(SessionError, match=rf"{service_folder} belongs to another user, {STRANGER.uid}"):
        open_session("peer", Endpoints(listen=(f"unixsock-stream/{service_folder}/rig.sock",)))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a folder to another group")
def test_a_folder_may_give_the_socket_its_group(socket_folder: Path) -> None:
    """For a daemon in a container, which runs as root."""
    folder = socket_folder / "shared"
    folder.mkdir()
    os.chown(folder, 0, DAEMON.gid)
    folder.chmod(0o2750)
    path = folder / "rig.sock"
    with publishing(PublishConfig(listen=(f"unixsock-stream/{path}",))) as publisher:
        wait_until(lambda: publisher.tally.sent, "the session")
        assert (path.stat().st_gid, mode_of(path)) == (DAEMON.gid, 0o660)


@pytest.mark.needs("openssl")
def test_the_examples_let_other_machines_watch_and_the_group_do_all(socket_folder: Path) -> None:
    address, folder = loopback_address(), str(socket_folder)
    certify(socket_folder, address)
    daemons, desks = (
        (REPOSITORY / "examples" / name).read_text() for name in ("zenoh-robot.json5", "zenoh-desk.json5")
    )
    for old, new in (
        ("10.0.0.2", address),
        ("/run/autoexpose", folder),
        ("/etc/autoexpose/robot", f"{folder}/router"),
        ("/etc/autoexpose", folder),
    ):
        assert old in daemons
        daemons = daemons.replace(old, new)
    desks = desks.replace("10.0.0.2", address).replace("desk", f"{folder}/robot").replace('"ca', f'"{folder}/ca')
    file, desk = socket_folder / "zenoh.json5", socket_folder / "desk.json5"
    file.write_text(daemons)
    desk.write_text(desks)
    here = [f"unixsock-stream/{folder}/scout.sock"]
    with scripted_daemon(None, publish={"rig": "scout", "zenoh": str(file)}) as (daemon, _, _):
        with RigClient("scout", zenoh_file=desk, name="desk") as far, RigClient("scout", here, name="here") as near:
            assert far.next_set(PATIENCE_S) is not None
            assert near.next_set(PATIENCE_S) is not None
            publishing = daemon.telemetry.publishing
            assert publishing is not None
            wait_until(lambda: {*publishing.consumers.listed(0)} == {"desk", "here"}, "both reports")
        with ControlClient("scout", here) as control:
            assert control.lock().requests.locked is not None
        with ControlClient("scout", zenoh_file=desk) as control, pytest.raises(AutoexposeError, match="no answer"):
            control.unlock()
        assert daemon.telemetry.requests.taken == 1
