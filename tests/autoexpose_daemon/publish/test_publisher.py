"""Publisher and consumers over real sessions, in this process and in others, and through a router."""

from __future__ import annotations

import contextlib
import itertools
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.client import RigClient, StereoClient
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages import keys
from autoexpose_daemon.messages.client import ConsumerTally, response_to_json
from autoexpose_daemon.messages.frames import MessageWriter
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, SessionError, SessionHolder, open_session
from autoexpose_daemon.status.telemetry import DropReason, PublishTally
from drivers.log_throttle import LogThrottle
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.autoexpose_daemon.publish.processes import consumer, router, router_file
from tests.autoexpose_daemon.publish.steps import (
    DECISION,
    PATIENCE_S,
    SETTING,
    endpoint,
    nothing,
    pair,
    publishing,
    wait_until,
)
from tests.fakes import unique

pytestmark = pytest.mark.wire

ATTEMPTS = 5
"""What is promised holds where there is time for it; machines are busy, so the best of a few counts."""
PAIRS = 60
"""Several times what a connection holds of them."""


@pytest.fixture(params=["tcp", "socket"])
def at(request: pytest.FixtureRequest, socket_folder: Path) -> str:
    """An endpoint of one's own: what is promised holds over both."""
    return endpoint() if request.param == "tcp" else f"unixsock-stream/{socket_folder}/rig.sock"


def reported(publisher: Publisher, name: str) -> ConsumerTally:
    return publisher.tally.consumers.listed(time.monotonic_ns()).get(name, ConsumerTally())


def test_a_client_gets_pairs_as_they_were_taken_and_the_daemon_hears_of_it(at: str) -> None:
    with publishing(PublishConfig(listen=(at,))) as publisher, StereoClient(connect=[at], name="odometry") as client:
        for _, received in zip(range(60), client, strict=False):
            assert received.right is not None
            assert received.left.setting == received.right.setting == SETTING
            assert received.decision == DECISION
            for frame in (received.left, received.right):
                assert frame.frame_id == received.trigger
                assert np.all(frame.pixels == received.trigger % 256)
            assert abs(received.stamp_ns - time.time_ns()) < 10e9
        assert client.tally.pairs == 60
        wait_until(lambda: reported(publisher, "odometry").pairs >= 60, "the consumer's report")


def test_a_client_that_nobody_has_any_more_disconnects(at: str) -> None:
    with publishing(PublishConfig(listen=(at,))):
        client = StereoClient(connect=[at])
        for _ in client:
            break
        closed = client._inbox.session.closed
        assert not closed.is_set()
        del client
        wait_until(closed.is_set, "the client's end")


def test_a_client_waits_for_its_daemon_and_finds_the_next_one(at: str) -> None:
    with StereoClient(connect=[at]) as client:
        for _ in range(2):
            with publishing(PublishConfig(listen=(at,))):
                assert client.next_pair(PATIENCE_S) is not None
        client.close()
        assert client.next_pair() is None


def test_a_client_of_one_camera_is_sent_no_image_of_another() -> None:
    at, images = endpoint(), set()
    with RigClient(connect=[at], cameras=["right"]) as client:
        take = client._inbox.receive

        def note(key: str, data: bytes) -> None:
            images.update({key} if key.endswith("/image") else ())
            take(key, data)

        client._inbox.receive = note  # type: ignore[method-assign]
        with publishing(PublishConfig(listen=(at,))):
            sets = [client.next_set(PATIENCE_S) for _ in range(5)]
    assert [set(each.frames) for each in sets if each is not None] == 5 * [{"right"}]
    assert images == {keys.frame_key("rig", "right", "image")}


def test_a_client_of_normalised_frames_gets_no_pair_without_the_responses_of_its_cameras() -> None:
    at = endpoint()
    lens = Vignetting(720, 540, (359.5, 269.5), (-0.5,))
    left, right = response_to_json(ResponseFunction.linear(), lens), response_to_json(ResponseFunction.linear(8))
    key = keys.response_key("rig", "left")
    said = [{key: "damaged"}, {key: left}, {keys.response_key("rig", "right"): right}]
    turns = itertools.cycle(said)
    with (
        StereoClient(connect=[at], normalised=True) as client,
        publishing(PublishConfig(listen=(at,)), tell=lambda _last: next(turns)),
    ):
        pair = client.next_pair(PATIENCE_S)
        assert pair is not None
        assert {camera: response.black_level for camera, response in pair.responses.items()} == {"left": 0, "right": 8}
        assert pair.vignettings == {"left": lens}
        brighter = pair.normalised(pair.level + 1.0)
        assert np.all(brighter.left == min(2 * (pair.trigger % 256), 255))
        assert np.array_equal(pair.left.pixels, np.full((540, 720), pair.trigger % 256))


def test_cameras_of_impossible_names_are_logged_and_never_shown(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keys, "_SELDOM", LogThrottle(60.0))
    at = endpoint()
    with (
        publishing(PublishConfig(listen=(at,))),
        StereoClient(connect=[at]) as client,
        StatusClient(connect=[at]) as status,
    ):
        assert client.next_pair(PATIENCE_S) is not None
        with open_session("client", Endpoints(connect=[at])) as other:
            curve = response_to_json(ResponseFunction.linear())
            for message in MessageWriter("rig", 1).messages(pair(7, (4, 4)), {}, 7, 0):
                other.put(f"autoexpose/rig/Centre/{message.topic}", bytes(message.data))
            other.put("autoexpose/rig/Centre/response", curve)
            wait_until(lambda: "camera named 'Centre' are ignored" in caplog.text, "the log")
            # Again and again: a client's subscription may not have reached the other session yet.
            wait_until(lambda: other.put("autoexpose/rig/left/response", curve) or status.responses, "a response")
            assert set(status.responses) == {"left"}
            for _ in range(3):
                received = client.next_pair(PATIENCE_S)
                assert received is not None
                assert received.left.pixels.shape == (540, 720)


def test_rigs_do_not_mix(at: str) -> None:
    with (
        publishing(PublishConfig(rig="one", listen=(at,))),
        StereoClient("two", [at]) as two,
        StereoClient("one", [at]) as one,
    ):
        assert one.next_pair(PATIENCE_S) is not None
        assert two.next_pair(0.1) is None


def test_a_client_says_why_it_waits(at: str, caplog: pytest.LogCaptureFixture) -> None:
    with StereoClient(connect=[at]) as client:
        waiting = threading.Thread(target=client.next_pair)
        waiting.start()
        wait_until(lambda: "no frames yet" in caplog.text, "the complaint")
        assert at in caplog.text
    waiting.join()


def test_a_client_waits_no_longer_than_asked_for_a_daemon_that_is_not_there() -> None:
    with StereoClient(connect=[endpoint()]) as client:
        assert client.next_pair(0.05) is None


@pytest.mark.parametrize("names", [{"rig": "*"}, {"rig": "a/b"}, {"name": "a b"}, {"name": "a/b"}])
def test_names_that_cannot_be_are_refused(names: dict[str, str]) -> None:
    with pytest.raises(ConfigurationError, match="is not a valid"):
        StereoClient(**names)  # type: ignore[arg-type]


@pytest.mark.realtime
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_consumer_that_dies_or_stands_still_costs_the_others_nothing(at: str, end: signal.Signals) -> None:
    assert any(cost_to_others(at, end) == 0 for _ in range(ATTEMPTS))


def cost_to_others(at: str, end: signal.Signals) -> int:
    """What the publisher drops and another consumer loses of `PAIRS`, from when a first one dies or stands still."""
    with (
        publishing(PublishConfig(listen=(at,))) as publisher,
        consumer("victim", at) as victim,
        StereoClient(connect=[at]) as other,
    ):
        victim.wait_for_first()
        assert other.next_pair(PATIENCE_S) is not None
        before, dropped_before = other.tally, publisher.tally.dropped.total()
        victim.process.send_signal(end)
        for _, _received in zip(range(PAIRS), other, strict=False):
            pass
        assert other.tally.pairs - before.pairs == PAIRS
        return other.tally.lost - before.lost + publisher.tally.dropped.total() - dropped_before


def test_all_that_control_offers_is_accounted_for() -> None:
    with Publisher(PublishConfig(listen=(endpoint(),)), ("left", "right"), nothing) as publisher:
        wait_until(lambda: offer(publisher).sent, "the session")
        for number in range(1000):  # much faster than zenoh takes them
            publisher(ControlStep(StepInputs(pair(number, (4, 4))), DECISION))
    tally = publisher.tally
    assert tally.dropped[DropReason.BEHIND] > 0
    assert tally.offered == tally.sent + tally.dropped.total()


def test_a_program_that_does_not_close_its_client_ends_all_the_same(at: str) -> None:
    program = f"from autoexpose_daemon.client import StereoClient\nfor pair in StereoClient(connect=[{at!r}]): break"
    with publishing(PublishConfig(listen=(at,))):
        assert subprocess.run([sys.executable, "-c", program], timeout=PATIENCE_S, check=False).returncode == 0


def offer(publisher: Publisher) -> PublishTally:
    publisher(ControlStep(StepInputs(pair(0, (4, 4))), DECISION))
    return publisher.tally


def test_an_endpoint_in_use_is_named_and_tried_again() -> None:
    at = endpoint()
    address, port = at.removeprefix("tcp/").split(":")
    config = PublishConfig(listen=(at,))
    with contextlib.ExitStack() as stack:
        blocker = stack.enter_context(socket.create_server((address, int(port))))
        publisher = stack.enter_context(publishing(config))
        wait_until(lambda: publisher.tally.trouble, "the complaint")
        assert at in publisher.tally.trouble
        assert "in use" in publisher.tally.trouble
        blocker.close()
        wait_until(lambda: publisher.tally.sent, "the endpoint to be taken")
        assert publisher.tally.trouble == ""
        assert publisher.tally.dropped[DropReason.NOT_OPEN] > 0


def test_nothing_listens_beyond_this_machine() -> None:
    at = endpoint()
    with publishing(PublishConfig(listen=(at,))), StereoClient(connect=[at], name=unique("c")) as client:
        assert client.next_pair(PATIENCE_S) is not None
        assert {address for address in listening_addresses() if not address.startswith("127.")} == set()


def listening_addresses() -> set[str]:
    """Of the sockets of this process that listen, or wait for datagrams, read from the kernel's tables."""
    own = set()
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            own.add(str(entry.readlink()).removeprefix("socket:[").removesuffix("]"))
    addresses = set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == state and fields[9] in own:
                packed = bytes.fromhex(fields[1].split(":")[0])
                addresses.add(socket.inet_ntoa(packed[::-1]) if len(packed) == 4 else packed.hex())
    return addresses


def test_a_client_may_be_closed_by_any_of_its_threads() -> None:
    """By the one in which the garbage collector finds it forgotten."""
    closed_in_time: list[bool] = []
    holder = SessionHolder("peer", Endpoints(), lambda _session: None, lambda _trouble: None)
    thread = threading.Thread(target=lambda: closed_in_time.append(holder.close()))
    holder._threads = [thread]
    thread.start()
    thread.join()
    assert closed_in_time
    assert holder.closed.is_set()


def test_a_process_takes_part_through_a_router(tmp_path: Path) -> None:
    at = endpoint()
    with (
        router(router_file(tmp_path, at)),
        publishing(PublishConfig(listen=(), connect=(at,))) as publisher,
        consumer("far", at) as far,
    ):
        far.wait_for_first()
        wait_until(lambda: "far" in publisher.tally.consumers.listed(time.monotonic_ns()), "its report")
        assert far.result()["tally"]["pairs"] > 0


def certify(folder: Path, address: str) -> None:
    """Keys and certificates of an authority, of a router at an address, and of a robot."""

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    new_key = ["-newkey", "rsa:2048", "-nodes"]
    openssl("req", "-x509", *new_key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj", "/CN=authority")
    for name, alternative in (("router", f"IP:{address}"), ("robot", "DNS:robot")):
        openssl("req", *new_key, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (folder / f"{name}.ext").write_text(f"subjectAltName={alternative}\n")
        openssl(
            *("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"),
            *("-days", "2", "-extfile", f"{name}.ext", "-out", f"{name}.pem"),
        )


@pytest.mark.needs("openssl")
def test_tls_both_ways(tmp_path: Path) -> None:
    at = endpoint().replace("tcp/", "tls/")
    certify(tmp_path, at.removeprefix("tls/").split(":")[0])
    authority = {"root_ca_certificate": str(tmp_path / "ca.pem"), "enable_mtls": True}

    def tls(end: str, name: str) -> dict[str, Any]:
        pair = {
            f"{end}_private_key": str(tmp_path / f"{name}.key"),
            f"{end}_certificate": str(tmp_path / f"{name}.pem"),
        }
        return {"link": {"tls": authority | pair}}

    robot, stranger = tmp_path / "robot.json5", tmp_path / "stranger.json5"
    ends = {"connect": {"endpoints": [at]}, "listen": {"endpoints": []}}
    robot.write_text(json.dumps(ends | {"transport": tls("connect", "robot")}))
    anonymous = {"link": {"tls": {"root_ca_certificate": str(tmp_path / "ca.pem")}}}
    stranger.write_text(json.dumps(ends | {"transport": anonymous}))
    with (
        router(router_file(tmp_path, at, transport=tls("listen", "router"))),
        publishing(PublishConfig(rig="rig", zenoh=robot)),
        consumer("far", file=robot) as far,
    ):
        far.wait_for_first()
        assert far.result()["tally"]["pairs"] > 0
        with pytest.raises(SessionError):
            open_session("client", Endpoints(file=stranger))
