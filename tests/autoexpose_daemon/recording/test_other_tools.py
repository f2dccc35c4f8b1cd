"""Recordings in other people's tools: played by rosbag2, converted by rosbags, shown by Foxglove."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Channel, Metadata, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rosbags.convert.commands import command as rosbags_convert
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader

from autoexpose_daemon.messages.types import CAMERA_INFO, IMAGE, TYPESTORE
from autoexpose_daemon.recording.file import Step
from autoexpose_daemon.recording.read import Recording
from tests.autoexpose_daemon.recording.runs import VirtualRun, record, replayed

STEPS = 6
LAYOUT = Path(__file__).parents[3] / "examples" / "foxglove.json"
MESSAGE_PATH = re.compile(r"(?P<topic>(?:/\w+)+)\.(?P<field>\w+)(?:\.@delta)?")
FOREVER = QosTime(9223372036, 854775807)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with deep pixels, and with messages on all topics but two."""
    run = VirtualRun(bits=12, imu=True, steered=True)
    return record(tmp_path_factory.mktemp("recording") / "run.mcap", run, STEPS)


def qos(depth: int, reliability: QosReliability, durability: QosDurability = QosDurability.VOLATILE) -> list[Qos]:
    automatic = QosLiveliness.AUTOMATIC
    times = FOREVER, FOREVER, automatic, FOREVER
    return [Qos(QosHistory.KEEP_LAST, depth, reliability, durability, *times, avoid_ros_namespace_conventions=False)]


def offers_of(connection: Connection) -> list[Qos]:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return list(connection.ext.offered_qos_profiles)


def test_every_topic_says_how_it_is_offered(recording: Path) -> None:
    with Reader(recording) as reader:
        offered = {connection.topic: offers_of(connection) for connection in reader.connections}
    for topic, profiles in offered.items():
        match topic.split("/")[-2:]:
            case ["control", "setup"]:
                assert profiles == qos(1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)
            case ["control", _]:
                assert profiles == qos(10, QosReliability.RELIABLE)
            case _:
                assert profiles == qos(5, QosReliability.BEST_EFFORT)


def test_offers_are_numbers_in_yaml_and_the_file_says_that_they_are(recording: Path) -> None:
    """rosbag2 of Humble reads only these; later ones take them for names without the record."""
    with recording.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert {record.name: record.metadata for record in reader.iter_metadata()}["rosbag2"] == {
            "serialized_metadata": ""
        }
        for channel in summary.channels.values():
            (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert {key: type(value) for key, value in profile.items()} == {
                "history": int, "depth": int, "reliability": int, "durability": int, "deadline": dict, "lifespan": dict,
                "liveliness": int, "liveliness_lease_duration": dict, "avoid_ros_namespace_conventions": bool,
            }  # fmt: skip


def test_rosbags_converts_a_recording_to_either_storage_of_rosbag2_and_it_is_still_replayed(
    recording: Path, tmp_path: Path
) -> None:
    assert rosbags_convert([recording], tmp_path / "bag", dst_storage="sqlite3") == 0
    assert rosbags_convert([tmp_path / "bag"], tmp_path / "back", dst_storage="mcap") == 0
    original = messages_of(recording)
    assert len(original) >= 6 * STEPS
    assert messages_of(tmp_path / "bag") == original
    assert messages_of(tmp_path / "back") == original
    back = tmp_path / "back" / "back.mcap"
    assert [step.same for step in replayed(back)] == [step.same for step in replayed(recording)]
    assert pixels_of(back) == pixels_of(recording)


def messages_of(path: Path) -> list[tuple[str, str, list[Qos], int, bytes]]:
    """Topic, type, offers, time and bytes of each message, in order."""
    with Reader(path) as reader:
        return [
            (each.topic, each.msgtype, offers_of(each), time_ns, bytes(data))
            for each, time_ns, data in reader.messages()
        ]


def pixels_of(path: Path) -> list[bytes]:
    steps = [item for item in Recording(path) if isinstance(item, Step)]
    return [frame.pixels.tobytes() for step in steps for frame in step.pair.frames.values()]


def test_a_recording_from_before_offers_is_read_the_same(recording: Path, tmp_path: Path) -> None:
    old = tmp_path / "old.mcap"
    with recording.open("rb") as source, old.open("wb") as target:
        writer = Writer(target)
        writer.start("ros2", "autoexpose-daemon 0")
        copy_without_offers(StreamReader(source).records, writer)
        writer.finish()  # type: ignore[no-untyped-call]
    assert [step.same for step in replayed(old)] == [step.same for step in replayed(recording)]
    assert pixels_of(old) == pixels_of(recording)


def copy_without_offers(records: Iterator[Any], writer: Writer) -> None:
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for each in records:
        match each:
            case Schema() if each.id not in schemas:
                schemas[each.id] = writer.register_schema(each.name, each.encoding, each.data)
            case Channel() if each.id not in channels:
                notes = {key: value for key, value in each.metadata.items() if key == "scale"}
                channels[each.id] = writer.register_channel(each.topic, "cdr", schemas[each.schema_id], notes)
            case McapMessage():
                channel = channels[each.channel_id]
                writer.add_message(channel, each.log_time, each.data, each.publish_time, each.sequence)
            case Metadata(name="autoexpose"):
                writer.add_metadata(each.name, each.metadata)


def test_the_layout_for_foxglove_places_each_of_its_panels_once() -> None:
    def places(node: str | dict[str, Any]) -> Iterator[str]:
        if isinstance(node, str):
            yield node
            return
        assert set(node) == {"direction", "first", "second", "splitPercentage"}
        assert node["direction"] in ("row", "column")
        yield from places(node["first"])
        yield from places(node["second"])

    layout = json.loads(LAYOUT.read_text())
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    placed = list(places(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    assert {panel.partition("!")[0] for panel in placed} == {"Image", "Plot", "StateTransitions"}


def test_the_layout_for_foxglove_shows_what_a_recording_has(recording: Path) -> None:
    with Reader(recording) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
    panels = json.loads(LAYOUT.read_text())["configById"]
    for name, panel in panels.items():
        if name.startswith("Image!"):
            assert types[panel["imageMode"]["imageTopic"]] == IMAGE
            assert types[panel["imageMode"]["calibrationTopic"]] == CAMERA_INFO
            continue
        for path in panel["paths"]:
            parts = MESSAGE_PATH.fullmatch(path["value"])
            assert parts is not None
            kind, of_what = dict(TYPESTORE.fielddefs[types[parts["topic"]]][1])[parts["field"]]
            assert kind == Nodetype.BASE
            assert name.startswith("StateTransitions!") or of_what[0] != "string"
