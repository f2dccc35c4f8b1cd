"""The rig in ROS 2: its keys, and real sessions; for ROS 2 nodes stands plain zenoh, set up as rmw_zenoh does it."""

from __future__ import annotations

import contextlib
import json
import queue
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages.frames import read_exposure_info, read_image
from autoexpose_daemon.messages.keys import DEFAULT, LATCHED
from autoexpose_daemon.messages.types import CAMERA_INFO, EXPOSURE_INFO, IMAGE, ODOMETRY, TWIST, TYPESTORE
from autoexpose_daemon.publish.ros2_keys import Attachments, Ros2Node, Ros2Topic, key_of_topic
from tests.autoexpose_daemon.publish.processes import router, router_file
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, publishing, wait_until
from tests.fakes import loopback_address

pytestmark = pytest.mark.wire

OUR_NODE = ("%rig", "autoexpose")
GRAPH = {("NN", "%", *OUR_NODE)} | {
    ("MP", "%", *OUR_NODE, f"%rig%{camera}%{topic}")
    for camera in ("left", "right")
    for topic in ("image_raw", "camera_info", "exposure")
}


@contextlib.contextmanager
def node(connect: str) -> Iterator[zenoh.Session]:
    """A session as rmw_zenoh opens one: a peer that listens for other peers, whom it hears of by gossip."""
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("connect/endpoints", json.dumps([connect]))
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/{loopback_address()}:0"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/target", '{router: ["router", "peer"], peer: ["router"]}')
    config.insert_json5("scouting/gossip/autoconnect_strategy", '{peer: {to_router: "always", to_peer: "greater-zid"}}')
    with zenoh.open(config) as session:
        yield session


def received(session: zenoh.Session, key: str, count: int) -> list[zenoh.Sample]:
    samples: queue.Queue[zenoh.Sample] = queue.Queue()
    with session.declare_subscriber(key, samples.put):
        return [samples.get(timeout=PATIENCE_S) for _ in range(count)]


@contextlib.contextmanager
def graph(session: zenoh.Session, domain: int) -> Iterator[set[str]]:
    """The tokens that are alive in a domain, followed as rmw_zenoh follows them."""
    alive: set[str] = set()

    def on_change(sample: zenoh.Sample) -> None:
        (alive.add if sample.kind == zenoh.SampleKind.PUT else alive.discard)(str(sample.key_expr))

    with session.liveliness().declare_subscriber(f"@ros2_lv/{domain}/**", on_change, history=True):
        yield alive


def tokens(session: zenoh.Session) -> set[str]:
    """Those that answer a query."""
    replies = session.liveliness().get("@ros2_lv/**", timeout=PATIENCE_S)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


def named(alive: set[str]) -> set[tuple[str, ...]]:
    """Of each token: kind, enclave, namespace, node, topic."""
    return {tuple(token.split("/")[5:10]) for token in alive}


def test_ros2_finds_node_and_topics_and_gets_messages_through_its_router(tmp_path: Path) -> None:
    at = endpoint()
    config = PublishConfig(listen=(endpoint(),), connect=(at,), ros2_domain=7)
    with router(router_file(tmp_path, at)), node(at) as session, graph(session, 7) as alive:
        with publishing(config):
            wait_until(lambda: named(alive.copy()) == GRAPH, "the rig in the graph")
            check_messages(session)
        wait_until(lambda: not alive, "the end of the rig in the graph")


def check_messages(session: zenoh.Session) -> None:
    images = received(session, "7/rig/left/image_raw/**", 3)
    for sample in images:
        stamp_ns, image = read_image(sample.payload.to_bytes())
        assert abs(stamp_ns - time.time_ns()) < 60e9
        assert image.pixels.shape == (540, 720)
        assert np.all(image.pixels == image.pixels[0, 0])
    attached = [sample.attachment.to_bytes() for sample in images if sample.attachment is not None]
    numbers, times_ns, _, gids = zip(*(struct.unpack("<qqB16s", mark) for mark in attached), strict=True)
    assert len(attached) == len(set(numbers)) == 3
    assert list(numbers) == sorted(numbers)
    assert all(abs(time_ns - time.time_ns()) < 60e9 for time_ns in times_ns)
    assert len(set(gids)) == 1

    info = read_exposure_info(received(session, "7/rig/right/exposure/**", 1)[0].payload.to_bytes())
    assert info.header.frame_id == "rig_right_optical_frame"


def test_our_own_keys_are_there_as_well_and_nothing_is_attached_to_them() -> None:
    at = endpoint()
    with publishing(PublishConfig(listen=(at,), ros2_domain=0)), node(at) as session:
        plain = received(session, "autoexpose/rig/left/image", 1)[0]
        assert plain.attachment is None
        marked = received(session, "0/rig/left/image_raw/**", 1)[0]
        assert marked.attachment is not None
        assert len(marked.payload) == len(plain.payload)
        assert named(tokens(session)) == GRAPH


def test_nothing_of_it_is_there_unless_configured() -> None:
    at = endpoint()
    with publishing(PublishConfig(listen=(at,))), node(at) as session:
        samples = received(session, "**", 20)
        assert {str(sample.key_expr).split("/")[0] for sample in samples} == {"autoexpose"}
        assert tokens(session) == set()


SESSION = "8b20917502ee955ac4476e0266340d5c"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Of std_msgs/msg/String, in rmw_zenoh's docs/design.md."""
IMAGE_HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
"""As `ros2 topic info --verbose` of Jazzy has been seen to print it."""
CAMERA_INFO_HASH = "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
"""As in the tests of other programs that speak to ROS 2."""
NODE = Ros2Node(2, "talker", "autoexpose", SESSION)


@pytest.mark.parametrize(
    ("kind", "dds", "known"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_", STRING_HASH),
        (IMAGE, "sensor_msgs::msg::dds_::Image_", IMAGE_HASH),
        (CAMERA_INFO, "sensor_msgs::msg::dds_::CameraInfo_", CAMERA_INFO_HASH),
        (EXPOSURE_INFO, "autoexpose_msgs::msg::dds_::ExposureInfo_", TYPESTORE.hash_rihs01(EXPOSURE_INFO)),
    ],
)
def test_a_key_is_domain_topic_type_and_the_hash_of_ros2(kind: str, dds: str, known: str) -> None:
    assert NODE.topic(10, "/talker/chatter", kind).key == f"2/talker/chatter/{dds}/{known}"


def test_a_token_says_who_publishes_what_and_how() -> None:
    assert NODE.token == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%talker/autoexpose"
    topic = NODE.topic(10, "/talker/left/chatter", "std_msgs/msg/String")
    fields = topic.token.split("/")
    assert fields[:9] == ["@ros2_lv", "2", SESSION, "0", "10", "MP", "%", "%talker", "autoexpose"]
    assert fields[9:12] == ["%talker%left%chatter", "std_msgs::msg::dds_::String_", STRING_HASH]
    reliability, durability, history, deadline, lifespan, liveliness = fields[12].split(":")
    assert (reliability, durability, history) == ("2", "", ",5")  # best effort, volatile by default, keep last 5
    assert (deadline, lifespan, liveliness) == (",", ",", ",,")
    assert len(fields) == 13


def test_a_node_without_a_namespace_sends_commands_reliably_and_what_is_sent_once_is_kept() -> None:
    node = Ros2Node(0, "", "autoexpose_repeat", SESSION)
    assert node.token == f"@ros2_lv/0/{SESSION}/0/0/NN/%/%/autoexpose_repeat"
    topic = node.topic(1, "/cmd_vel", TWIST, DEFAULT)
    assert topic.key.startswith("0/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_")
    assert topic.token.split("/")[9] == "%cmd_vel"
    assert topic.token.split("/")[-1] == "::,10:,:,:,,"
    assert node.topic(1, "/setup", "std_msgs/msg/String", LATCHED).token.split("/")[-1] == ":1:,1:,:,:,,"


def test_messages_of_a_topic_are_heard_whatever_their_hash() -> None:
    assert key_of_topic(3, "/odom", ODOMETRY) == "3/odom/nav_msgs::msg::dds_::Odometry_/*"
    assert key_of_topic(3, "base/cmd_vel") == "3/base/cmd_vel/*/*"


def test_an_attachment_is_number_time_and_gid() -> None:
    attachments = Attachments(Ros2Topic("key", "token"))
    first, second = attachments.next(0x0102_0304_0506_0708), attachments.next(-1)
    assert first[:8].hex() == "0100000000000000"  # the number, little-endian
    assert first[8:16].hex() == "0807060504030201"  # ns since 1970
    assert first[16] == 16  # length of the gid, which follows
    assert len(first) == 33
    assert second[:8].hex() == "0200000000000000"
    assert second[16:] == first[16:]
    assert Attachments(Ros2Topic("key", "another")).next(0)[17:] != first[17:]
