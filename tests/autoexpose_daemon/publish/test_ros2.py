"""The rig in ROS 2, over real sessions; in the place of ROS 2 nodes plain zenoh, set up as rmw_zenoh does it."""

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
from tests.autoexpose_daemon.publish.router import router
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, publishing, wait_until
from tests.autoexpose_daemon.publish.test_router import router_file
from tests.fakes import loopback_address

pytestmark = pytest.mark.wire

NODE = ("%rig", "autoexpose")
GRAPH = {("NN", "%", *NODE)} | {
    ("MP", "%", *NODE, f"%rig%{side}%{topic}")
    for side in ("left", "right")
    for topic in ("image", "camera_info", "exposure")
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
    images = received(session, "7/rig/left/image/**", 3)
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
        marked = received(session, "0/rig/left/image/**", 1)[0]
        assert marked.attachment is not None
        assert len(marked.payload) == len(plain.payload)
        assert named(tokens(session)) == GRAPH


def test_nothing_of_it_is_there_unless_configured() -> None:
    at = endpoint()
    with publishing(PublishConfig(listen=(at,))), node(at) as session:
        samples = received(session, "**", 20)
        assert {str(sample.key_expr).split("/")[0] for sample in samples} == {"autoexpose"}
        assert tokens(session) == set()
