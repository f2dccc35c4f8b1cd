"""The domain of ROS 2, diagnostics, and `autoexpose ros2` as a process, met by another participant of DDS."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from random import SystemRandom
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN, frame_key
from autoexpose_daemon.messages.types import (
    BOOL,
    CAMERA_INFO,
    DIAGNOSTICS,
    EXPOSURE_INFO,
    FLOAT64,
    IMAGE,
    ODOMETRY,
    STRING,
    TRACKED_CELLS,
    TYPESTORE,
)
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.ros2.bridge import ERROR, OK, STALE, WARN, diagnostics
from autoexpose_daemon.ros2.domain import Domain
from autoexpose_daemon.ros2.node import Node, dds_type
from autoexpose_daemon.status.document import CameraStatus, Status
from autoexpose_daemon.status.states import State
from imaging.errors import ConfigurationError
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, publishing, wait_until
from tests.autoexpose_daemon.samples import EXPOSING
from tests.autoexpose_daemon.scripted import scripted_daemon
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE


@pytest.mark.parametrize(
    ("environment", "domain"),
    [
        ({}, Domain(0, "jazzy")),
        ({"ROS_DOMAIN_ID": "", "ROS_DISTRO": ""}, Domain(0, "jazzy")),
        ({"ROS_DOMAIN_ID": "42", "ROS_DISTRO": "humble"}, Domain(42, "humble")),
        ({"ROS_LOCALHOST_ONLY": "1"}, Domain(local=True)),
        ({"ROS_LOCALHOST_ONLY": "0"}, Domain()),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, Domain(local=True)),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", "ROS_STATIC_PEERS": "10.0.0.2"}, Domain()),
        ({"ROS_STATIC_PEERS": "10.0.0.2; localhost;"}, Domain(peers=("10.0.0.2", "127.0.0.1"))),
        ({"ROS_STATIC_PEERS": "10.0.0.2", "ROS_LOCALHOST_ONLY": "1"}, Domain(local=True)),
        (
            {"ROS_STATIC_PEERS": "10.0.0.2", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            Domain(multicast=False, peers=("10.0.0.2",)),
        ),
        ({"ROS_DISTRO": "lyrical"}, Domain(release="lyrical")),
    ],
)
def test_the_variables_of_ros_2_are_followed(environment: dict[str, str], domain: Domain) -> None:
    assert Domain.from_environment(environment) == domain


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "233", "set it to a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "set it to a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "\u0663", "set it to a number from 0 to 232"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "set it to one of SUBNET"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "which hides the topics from everyone"),
    ],
)
def test_others_are_refused_in_a_sentence(variable: str, value: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{variable} is .*{words}"):
        Domain.from_environment({variable: value})


DOMAINS = [Domain(), Domain(local=True), Domain(peers=("10.0.0.2",)), Domain(multicast=False, peers=("10.0.0.2",))]


@pytest.mark.parametrize("domain", DOMAINS)
def test_cyclone_gets_xml_and_what_the_user_configured_after_it(domain: Domain) -> None:
    ours, theirs = domain.cyclone_uri("file:///etc/cyclone.xml").rsplit(",", 1)
    root = ElementTree.fromstring(ours)
    assert theirs == "file:///etc/cyclone.xml"
    assert domain.cyclone_uri() == ours
    interfaces = [interface.get("name") for interface in root.iter("NetworkInterface")]
    assert interfaces == (["lo"] if domain.local else [])
    here = () if domain.multicast and not domain.local else ("127.0.0.1",)
    assert tuple(peer.get("Address") for peer in root.iter("Peer")) == (*here, *domain.peers)
    assert [index.text for index in root.iter("ParticipantIndex")] == ["auto"]  # or peers would not find it


def test_a_peer_that_is_not_known_is_left_out_and_named(caplog: pytest.LogCaptureFixture) -> None:
    domain = Domain.from_environment({"ROS_STATIC_PEERS": "nobody.invalid;10.0.0.2;" + "x" * 300})
    assert domain.peers == ("10.0.0.2",)
    assert "'nobody.invalid' is not known here" in caplog.text


def test_nodes_announced_themselves_in_another_form_before_iron() -> None:
    early = [release for release in ("foxy", "humble", "iron", "jazzy", "lyrical") if Domain(release=release).early]
    assert early == ["foxy", "humble"]


def shown(status: Status | None) -> dict[str, Any]:
    """The entries by name."""
    message: Any = TYPESTORE.deserialize_cdr(diagnostics("scout", status, 1_700_000_000_000_000_005), DIAGNOSTICS)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 5)
    return {entry.name: entry for entry in message.status}


def test_a_rig_that_exposes_is_ok_with_its_figures() -> None:
    entries = shown(EXPOSING)
    assert list(entries) == ["scout: exposure", "scout: left camera", "scout: right camera"]
    assert {entry.level for entry in entries.values()} == {OK}
    values = {pair.key: pair.value for pair in entries["scout: exposure"].values}
    assert values["policy"] == "belief"
    assert values["exposure time us"] == "1100"
    assert entries["scout: left camera"].hardware_id == "FakeCam L1"


@pytest.mark.parametrize(
    ("state", "level"), [(State.STARTING, WARN), (State.DEGRADED, WARN), (State.FAILED, ERROR), (State.EXPOSING, OK)]
)
def test_a_state_has_a_level_and_its_reasons(state: State, level: int) -> None:
    rig = shown(replace(EXPOSING, state=state, reasons=("left camera gone", "no triggers")))["scout: exposure"]
    assert (rig.level, rig.message) == (level, f"{state}: left camera gone; no triggers")


def test_cameras_that_are_gone_or_do_not_fit_show() -> None:
    cameras = {"left": CameraStatus(None, None, None, None), "right": CameraStatus("C R", None, None, "other lens")}
    entries = shown(replace(EXPOSING, cameras=cameras))
    assert (entries["scout: left camera"].level, entries["scout: left camera"].message) == (ERROR, "gone")
    assert (entries["scout: right camera"].level, entries["scout: right camera"].message) == (WARN, "other lens")


def test_silence_is_stale() -> None:
    (entry,) = shown(None).values()
    assert (entry.level, entry.message) == (STALE, "nothing heard from the daemon")


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


def filled(kind: Any) -> Any:
    """A message with other content in each field, of rosbags' classes."""
    name, of = kind
    if name.name == "NAME":
        return TYPESTORE.types[of](*(filled(field) for _, field in TYPESTORE.fielddefs[of][1]))
    if name.name == "BASE":
        return "words" if of[0] == "string" else of[0] == "bool" or 7
    (inner, what), count = of
    if inner.name == "BASE" and what[0] != "string":
        return np.arange(count or 5).astype({"char": "uint8", "byte": "uint8"}.get(what[0], what[0]))
    return [filled((inner, what)) for _ in range(count or 2)]


def plain(value: Any) -> Any:
    """A message of either kind as lists and numbers."""
    if isinstance(value, IdlStruct):
        return [plain(getattr(value, name)) for name in type(value).__annotations__]
    if hasattr(value, "__msgtype__"):
        return [plain(getattr(value, name)) for name, _ in TYPESTORE.fielddefs[value.__msgtype__][1]]
    if isinstance(value, np.ndarray | list | tuple | bytes):
        return [plain(each) for each in value]
    return value


@pytest.mark.parametrize(
    "name", [IMAGE, CAMERA_INFO, EXPOSURE_INFO, DIAGNOSTICS, ODOMETRY, TRACKED_CELLS, BOOL, FLOAT64, STRING]
)
def test_messages_have_the_same_bytes_for_cyclone(name: str) -> None:
    message = filled((type("", (), {"name": "NAME"}), name))
    cdr = bytes(TYPESTORE.serialize_cdr(message, name))
    read = dds_type(name, TYPESTORE).deserialize(cdr)
    assert plain(read) == plain(message)
    written = read.serialize(use_version_2=False)
    assert written.rstrip(b"\0") == cdr.rstrip(b"\0")
