"""What needs no participant: the ROS domain, diagnostics, and messages as Cyclone writes them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from cyclonedds.idl import IdlStruct

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
from autoexpose_daemon.ros2.bridge import ERROR, OK, STALE, WARN, diagnostics
from autoexpose_daemon.ros2.domain import Domain
from autoexpose_daemon.ros2.node import dds_type
from autoexpose_daemon.status.document import CameraStatus, Status
from autoexpose_daemon.status.states import State
from imaging.errors import ConfigurationError
from tests.autoexpose_daemon.samples import EXPOSING


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
