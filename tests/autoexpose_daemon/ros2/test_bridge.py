"""`autoexpose ros2` as a process, met by another participant of DDS."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from random import SystemRandom
from typing import Any

import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN, frame_key
from autoexpose_daemon.messages.types import (
    BOOL,
    DIAGNOSTICS,
    EXPOSURE_INFO,
    IMAGE,
    STRING,
    TYPESTORE,
)
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.ros2.domain import Domain
from autoexpose_daemon.ros2.node import Node, dds_type
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, publishing, wait_until
from tests.autoexpose_daemon.scripted import scripted_daemon
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE

pytestmark = pytest.mark.wire

DOMAIN = SystemRandom().randint(100, LAST_ROS2_DOMAIN)
LOCAL = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_LOCALHOST_ONLY": "1"}
PLAIN = Qos(Policy.DataRepresentation(use_cdrv0_representation=True), Policy.History.KeepLast(100))
BEST_EFFORT, RELIABLE = Policy.Reliability.BestEffort, Policy.Reliability.Reliable(duration(seconds=1))
ENTITIES = "rmw_dds_common/msg/ParticipantEntitiesInfo"


@pytest.fixture(scope="module")
def participant() -> DomainParticipant:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", Domain(DOMAIN, local=True).cyclone_uri())
        return DomainParticipant(DOMAIN)


@contextlib.contextmanager
def bridge(at: str, *options: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    command = [*AUTOEXPOSE, "ros2", "--connect", at, *options]
    process = subprocess.Popen(
        command, env={**os.environ, **LOCAL, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("topics /rig/left/image_raw and others in ROS domain ")
            yield process
        finally:
            process.terminate()  # and it says goodbye
            process.wait(PATIENCE_S)


def subscribed(participant: DomainParticipant, name: str, kind: str, reliability: Any, store: Any = TYPESTORE) -> Any:
    topic = Topic(participant, name, dds_type(kind, store))
    return DataReader(participant, topic, qos=PLAIN + Qos(reliability))


def first(reader: DataReader[Any]) -> Any:
    """The next message of a reader."""
    taken: list[Any] = []

    def came() -> bool:
        taken.extend(message for message in reader.take(1) if isinstance(message, reader.topic.data_type))
        return bool(taken)

    wait_until(came, "a message")
    return taken[0]


@pytest.mark.parametrize("reliability", [BEST_EFFORT, RELIABLE], ids=["best effort", "reliable"])
def test_frames_arrive_as_the_daemon_sent_them(participant: DomainParticipant, reliability: Any) -> None:
    at = endpoint()
    options = ["--reliable"] if reliability is RELIABLE else []
    image = subscribed(participant, "rt/rig/left/image_raw", IMAGE, reliability)
    exposure = subscribed(participant, "rt/rig/right/exposure", EXPOSURE_INFO, reliability)
    with publishing(PublishConfig(listen=(at,)), period_s=0.1), bridge(at, *options) as process:
        taken, told = first(image), first(exposure)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert process.stdout is not None and process.stdout.read().startswith("sent: left/image_raw ")
    assert (taken.encoding, taken.width, taken.height) == ("mono8", 720, 540)
    assert len(taken.data) == 720 * 540 and len(set(taken.data)) == 1  # its number everywhere
    assert (told.exposure_time_us, told.gain_db, told.reason) == (1000.0, 6.0, "held")


def test_best_effort_is_what_is_offered_unless_asked_for(participant: DomainParticipant) -> None:
    at = endpoint()
    wanting = subscribed(participant, "rt/rig/left/image_raw", IMAGE, RELIABLE)
    content = subscribed(participant, "rt/rig/left/image_raw", IMAGE, BEST_EFFORT)
    with publishing(PublishConfig(listen=(at,)), period_s=0.1), bridge(at):
        for _ in range(5):
            first(content)
        assert wanting.take(1) == []


@pytest.mark.parametrize(("release", "store", "gid_bytes"), [("humble", "HUMBLE", 24), ("jazzy", "JAZZY", 16)])
def test_the_node_says_what_is_its_own_until_it_leaves(
    participant: DomainParticipant, release: str, store: str, gid_bytes: int
) -> None:
    known = get_typestore(getattr(Stores, f"ROS2_{store}"))
    latched = Qos(Policy.Durability.TransientLocal)
    topic = Topic(participant, "ros_discovery_info", dds_type(ENTITIES, known))
    reader = DataReader(participant, topic, qos=PLAIN + latched + Qos(RELIABLE))
    with bridge(endpoint(), "--control", ROS_DISTRO=release) as process:
        told = first(reader)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
        wait_until(lambda: not reader.get_matched_publications(), "the node to be gone")
    (node,) = told.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/rig", "autoexpose")
    assert len(node.writer_gid_seq) == 6 + 1 + 1  # of each camera three; diagnostics; answers
    assert len(node.reader_gid_seq) == 4
    assert {len(gid.data) for gid in [told.gid, *node.writer_gid_seq]} == {gid_bytes}
    assert bytes(told.gid.data)[:12] == bytes(node.writer_gid_seq[0].data)[:12]  # of one participant


def test_a_silent_daemon_is_stale_and_foreign_bytes_are_dropped(participant: DomainParticipant) -> None:
    at = endpoint()
    image = subscribed(participant, "rt/rig/left/image_raw", IMAGE, BEST_EFFORT)
    health = subscribed(participant, "rt/diagnostics", DIAGNOSTICS, RELIABLE)
    with open_session("peer", Endpoints(listen=[at])) as session, bridge(at) as process:
        publisher = session.declare_publisher(frame_key("rig", "left", "image"))
        wait_until(lambda: publisher.matching_status.matching, "the bridge")
        for foreign in (b"", b"\0", b"\xff" * 99, b"\0\1\0\0\xff\xff"):
            publisher.put(foreign)
        session.put("autoexpose/rig/middle/image", b"\0\1\0\0")
        session.put("autoexpose/rig/left/response", b"{}")
        session.put("**", b"\0\1\0\0")
        (entry,) = first(health).status
        assert (entry.level, entry.message) == (3, "nothing heard from the daemon")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr is not None
        said = process.stderr.read()
        assert said.count("is not of its type or finds no room, and is dropped") == 1
        assert "Traceback" not in said
    assert image.take(1) == []


@pytest.mark.parametrize("cdr", [b"", b"\0", b"\xff" * 99, b"\0\1\0\0\xff\xff", b"\0\7\0\0" + bytes(99)])
def test_what_is_no_message_is_counted_and_not_sent(cdr: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", "")
    writer = Node(Domain(DOMAIN, local=True), "rig").publisher("left/image_raw", IMAGE, frames=True)
    assert not writer.send(cdr)
    assert (writer.sent, writer.refused) == (0, 1)


def test_a_request_that_cannot_be_read_ends_nothing(participant: DomainParticipant) -> None:
    at = endpoint()
    kind = dds_type(STRING, TYPESTORE)
    policy = DataWriter(participant, Topic(participant, "rt/rig/control/policy", kind), PLAIN + Qos(RELIABLE))
    answers = subscribed(participant, "rt/rig/control/answer", STRING, RELIABLE)
    with bridge(at, "--control"):
        wait_until(policy.get_matched_subscriptions, "the bridge")
        wait_until(answers.get_matched_publications, "its answers")
        latin: Any = kind(data="")
        latin.serialize = lambda **_: b"\0\1\0\0\4\0\0\0\xff\xfe\xfd\0"
        policy.write(latin)
        assert first(answers).data == "nothing has changed: a message on control/policy cannot be read"
        policy.write(kind(data="fixed"))
        assert first(answers).data.startswith("nothing has changed: no answer for rig rig")


def test_requests_are_passed_on_and_answered(participant: DomainParticipant) -> None:
    at = endpoint()
    lock, policy = (
        DataWriter(
            participant, Topic(participant, f"rt/rig/control/{name}", dds_type(kind, TYPESTORE)), PLAIN + Qos(RELIABLE)
        )
        for name, kind in (("lock", BOOL), ("policy", STRING))
    )
    answers = subscribed(participant, "rt/rig/control/answer", STRING, RELIABLE)
    with scripted_daemon(None, publish={"listen": [at]}) as (daemon, _, seen), bridge(at, "--control"):
        wait_until(lambda: len(seen) > 5, "pairs")
        wait_until(lambda: lock.get_matched_subscriptions() and policy.get_matched_subscriptions(), "the bridge")
        wait_until(answers.get_matched_publications, "its answers")
        lock.write(dds_type(BOOL, TYPESTORE)(data=True))
        assert "exposure: locked at" in first(answers).data
        assert daemon.telemetry.requests.locked is not None
        policy.write(dds_type(STRING, TYPESTORE)(data="best"))
        assert first(answers).data.startswith("nothing has changed: ")
