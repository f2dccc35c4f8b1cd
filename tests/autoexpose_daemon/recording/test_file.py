"""The file itself: other tools open it, and whatever is done to it costs one sentence."""

from __future__ import annotations

import errno
import logging
import math
import os
import re
import resource
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.control.inputs import CELLS, LightAhead
from autoexpose_daemon.control.picture.steering import Steering
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.messages.types import EXPOSURE_INFO, TYPESTORE
from autoexpose_daemon.recording.file import METADATA, RESERVE_BYTES, Item, RecordingError, RecordingFile, Step
from autoexpose_daemon.recording.read import Mark, Recording
from autoexpose_daemon.recording.recorder import ContinuousRecorder, LastSecondsRecorder, new_recorder
from autoexpose_daemon.recording.replay import Replay, report_replay
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
from imaging.pixels import SAMPLES, PixelFormat
from tests.autoexpose_daemon.recording.runs import VirtualRun, copy, record, replayed

TOPICS = {
    *(f"/rig/{camera}/{what}" for camera in ("left", "right") for what in ("image_raw", "camera_info", "exposure")),
    "/rig/control/setup",
    "/rig/control/state",
}


STEPS = 40


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of some 2 MB, two chunks, nothing wrong with it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("autoexpose_daemon.recording.file._CHUNK_BYTES", 1 << 20)
        return record(tmp_path_factory.mktemp("recording") / "whole.mcap", VirtualRun(), STEPS)


def test_the_mcap_reader_opens_it(whole: Path) -> None:
    with whole.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == TOPICS
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        times = [message.log_time for _, _, message in reader.iter_messages(topics=["/rig/left/image_raw"])]
    assert len(times) == STEPS
    assert times == sorted(times)


def test_rosbags_opens_it_and_reads_every_message_by_the_definitions_in_it(whole: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    images = 0
    with Reader(whole) as reader:
        assert set(reader.topics) == TOPICS
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, _, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            images += connection.topic.endswith("image_raw")
            if connection.topic.endswith("exposure"):
                assert message.exposure_time_us >= 20.0  # type: ignore[attr-defined]
    assert images == 2 * STEPS


@settings(max_examples=25, deadline=None)
@given(cut=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_off_anywhere_is_read_up_to_there(whole: Path, cut: float) -> None:
    content = whole.read_bytes()
    path = whole.with_name("cut.mcap")
    path.write_bytes(content[: int(cut * len(content))])
    items, error = _read(path)
    steps = [item for item in items if isinstance(item, Step)]
    if error is None:
        assert [step.sequence for step in steps] == list(range(1, len(steps) + 1))
        assert all(each.same for each in replayed(path)[1:])


def test_a_file_cut_off_says_so(whole: Path) -> None:
    path = whole.with_name("cut.mcap")
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size - 300_000])
    said: list[str] = []
    assert report_replay(path, None, said.append)
    assert "the file ends in the middle of a record: what comes before that has been read" in said


@settings(max_examples=40, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bits=st.integers(1, 255), count=st.sampled_from([1, 1, 8, 4096]))
def test_damaged_bytes_are_one_sentence_or_change_nothing(whole: Path, where: float, bits: int, count: int) -> None:
    content = bytearray(whole.read_bytes())
    # Half of the damage to what is not pixels: the first chunk's head and the last bytes.
    at = int(where * len(content)) if count > 1 else int(where * 4000) - 2000
    for index in range(at, min(at + count, len(content))):
        content[index] ^= bits
    path = whole.with_name("damaged.mcap")
    path.write_bytes(content)
    items, error = _read(path)
    if error is None:
        assert all(np.isfinite(item.decision.level) for item in items if isinstance(item, Step))
        list(Replay().steps(items))


@settings(max_examples=200, deadline=None)
@given(content=st.binary(max_size=4000), with_magic=st.booleans())
def test_random_bytes_are_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, with_magic: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "random.mcap"
    path.write_bytes((b"\x89MCAP0\r\n" if with_magic else b"") + content)
    _, error = _read(path)
    assert error is not None


def _read(path: Path) -> tuple[list[Item], RecordingError | None]:
    items: list[Item] = []
    try:
        items.extend(Recording(path))  # keeps nothing of a file that ends in an error
    except RecordingError as error:
        assert str(error).startswith(f"{path}: ")
        assert "\n" not in str(error)
        return items, error
    return items, None


@pytest.mark.parametrize("written_by", ["us", "others", "us, cut off"])
def test_a_recording_is_read_from_a_mark_as_from_its_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written_by: str
) -> None:
    """What steers control begins late, on topics of its own; chunks of others end within steps."""
    monkeypatch.setattr("autoexpose_daemon.recording.file._CHUNK_BYTES", 1 << 16)
    path = record(tmp_path / "run.mcap", VirtualRun("lu2010", steered=True), STEPS)
    if written_by == "others":
        monkeypatch.setattr(Writer.__init__, "__defaults__", (120_001, *(Writer.__init__.__defaults__ or ())[1:]))
        path = copy([path], tmp_path / "copy.mcap", lambda topic, data: (topic, data))
    elif written_by != "us":
        os.truncate(path, path.stat().st_size * 3 // 4)
    recording = Recording(path)
    seen: list[tuple[Mark, str]] = []
    for item in recording:
        seen.append((recording.mark, told(item)))
    firsts = [place for place in range(len(seen)) if place == 0 or seen[place][0] != seen[place - 1][0]]
    assert len(firsts) > 4 and any(len(seen[place][0].needs) > 1 for place in firsts)
    for place in firsts:
        assert [told(item) for item in Recording(path, seen[place][0])] == [words for _, words in seen[place:]]


def told(item: Item) -> str:
    """All of an item; items are not compared by their content."""
    if not isinstance(item, Step):
        return repr(item)
    pixels = {camera: frame.pixels.tobytes() for camera, frame in item.pair.frames.items()}
    return repr((item.sequence, item.stamp_ns, item.requests, item.inputs.override, item.decision, pixels))


def test_a_recording_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel("/chatter", "cdr", schema), 0, b"\0\1\0\0\1\0\0\0\0", 0)
        writer.finish()
    with pytest.raises(RecordingError, match="contains no steps of control: it is not a recording of autoexpose"):
        list(Recording(path))


def test_a_count_of_too_many_digits_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata(METADATA, {"dropped": "9" * 5000})
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match=r"run\.mcap: is damaged: a count of dropped steps of 5000 digits"):
        list(Recording(path))


def test_another_format_of_states_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autoexpose_daemon.recording.file.STATE_FORMAT", "autoexpose-control/0")
    path = record(tmp_path / "old.mcap", VirtualRun("fixed"), 5)
    with pytest.raises(RecordingError, match="of format 'autoexpose-control/0': only 'autoexpose-control/15' can be"):
        list(Recording(path))


def test_another_version_of_the_message_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "old.mcap", VirtualRun("fixed"), 5)
    monkeypatch.setattr("autoexpose_daemon.recording.read.definition", lambda _: "uint64 sequence")
    with pytest.raises(RecordingError, match=r"another version of ExposureInfo\.msg: replay it with that version"):
        list(Recording(path))


def recorded(path: Path, state: object = None, **inputs: Any) -> Path:
    """One step of a policy, with such inputs and such a state."""
    run = VirtualRun("fixed" if state is None else "lu2010", imu=True)
    pair = next(run.pairs())
    file = RecordingFile(path, "rig")
    file.write(Step(1, 2, StepInputs(pair, **inputs), run.loop.step(pair)), run.loop.setup, state)
    file.close(1, 0)
    return path


def impossible_light() -> LightAhead:
    ahead = LightAhead((9.0, 12.0), (0.0, -3.0), 1, 1.0)
    object.__setattr__(ahead, "now", 2)
    return ahead


def impossible_steering() -> Steering:
    steering = Steering({"left": (0.5,) * CELLS}, ("slam",), 0.1)
    steering.favours["right"] = (1.5,) * CELLS
    return steering


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"state": VirtualRun("kim2018").loop.state()}, "its state of control does not fit: Lu2010 needs query"),
        *(
            ({"angular_rate_rad_s": rate}, "is damaged: an angular rate of .* rad/s")
            for rate in (math.nan, -1e300, 101.0)
        ),
        ({"light_ahead": impossible_light()}, "is damaged: frame 2 of 2 levels"),
        (
            {"steering": impossible_steering()},
            "is damaged: steering of the right camera is not 48 numbers from -1 to 1",
        ),
    ],
)
def test_what_cannot_be_is_one_sentence(tmp_path: Path, content: dict[str, Any], why: str) -> None:
    with pytest.raises(RecordingError, match=why):
        replayed(recorded(tmp_path / "run.mcap", **content))


@pytest.mark.parametrize("missing", ["missing.mcap", "."])
def test_what_cannot_be_opened_is_one_sentence(tmp_path: Path, missing: str) -> None:
    with pytest.raises(RecordingError, match="cannot be read: "):
        list(Recording(tmp_path / missing))


def test_a_file_that_exists_or_cannot_be_is_refused_at_once(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="already exists: name a new file"):
        ContinuousRecorder(whole, 60, PublishConfig())
    nowhere = tmp_path / "no folder" / "run.mcap"
    with pytest.raises(RecordingError, match=r"run\.mcap: cannot be written: No such file or directory"):
        ContinuousRecorder(nowhere, 60, PublishConfig())
    with pytest.raises(RecordingError, match=r"run\.mcap: cannot be written; name a file in an existing folder"):
        LastSecondsRecorder(nowhere, 60, PublishConfig(), 5)


def test_a_disk_that_fills_up_ends_the_recording_and_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    run, path = VirtualRun("neves2009"), tmp_path / "run.mcap"
    with caplog.at_level(logging.WARNING), ContinuousRecorder(path, 200, PublishConfig()) as recorder:
        resource.setrlimit(resource.RLIMIT_FSIZE, (5 << 20, hard))
        try:
            run.feed(recorder, 200)
            recorder._thread.join(30)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert not recorder._thread.is_alive()
        run.feed(recorder, 10)
    assert len(run.decisions) == 210
    assert recorder.failure == f"{path}: cannot be written: File too large"
    assert [each.message for each in caplog.records] == [
        f"recording stops, control goes on: {path}: cannot be written: File too large"
    ]
    recording = Recording(path)
    steps = [item for item in recording if isinstance(item, Step)]
    assert recording.cut_off
    assert steps
    assert recorder.incomplete
    lost = recorder.steps - len(steps)
    assert recorder.summary == (
        f"{path}: {len(steps)} steps recorded, 0 dropped by the recorder, {lost} lost when it stopped"
    )
    assert all(each.same for each in replayed(path)[1:])


def test_some_of_the_disk_is_left_free_and_the_file_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = iter([*[RESERVE_BYTES] * 30, *[RESERVE_BYTES - 1] * 100])
    monkeypatch.setattr(os, "fstatvfs", lambda _: SimpleNamespace(f_bavail=next(free), f_frsize=1))
    run, path = VirtualRun("neves2009"), tmp_path / "run.mcap"
    with caplog.at_level(logging.WARNING), ContinuousRecorder(path, 60, PublishConfig()) as recorder:
        run.feed(recorder, 60)
    assert [each.message for each in caplog.records] == [
        f"recording stops, control goes on: {path}: less than 64 MiB are left on its disk: make room"
    ]
    recording = Recording(path)
    assert len([item for item in recording if isinstance(item, Step)]) == 30
    assert not recording.cut_off
    assert recorder.summary.startswith(f"{path}: 30 steps recorded, 0 dropped by the recorder, ")
    with Reader(path) as reader:
        assert reader.topics["/rig/left/image_raw"].msgcount == 30


def test_a_disk_that_fails_or_a_name_that_is_too_long_ends_the_recording_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def failing(_: int) -> os.statvfs_result:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    path, long = tmp_path / "run.mcap", tmp_path / f"{'x' * 250}.mcap"  # 255 characters: one with a number is too long
    with LastSecondsRecorder(long, 60, PublishConfig(), 1.0) as recorder:
        VirtualRun("fixed").feed(recorder, 3)
    assert recorder.incomplete
    monkeypatch.setattr(os, "fstatvfs", failing)
    with ContinuousRecorder(path, 60, PublishConfig()) as recorder:
        VirtualRun("fixed").feed(recorder, 3)
    assert caplog.messages == [
        f"nothing is saved, control goes on: {long}: cannot be written: File name too long",
        f"recording stops, control goes on: {path}: cannot be written: Input/output error",
    ]


def test_last_seconds_that_do_not_fit_on_the_disk_are_said_and_kept_for_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = iter([*[RESERVE_BYTES] * 10, RESERVE_BYTES - 1, *[RESERVE_BYTES] * 100])
    monkeypatch.setattr(os, "fstatvfs", lambda _: SimpleNamespace(f_bavail=next(free), f_frsize=1))
    run, path = VirtualRun("neves2009"), tmp_path / "run.mcap"
    with caplog.at_level(logging.WARNING), LastSecondsRecorder(path, 30, PublishConfig(), 1.0) as recorder:
        run.feed(recorder, 40)
        recorder.save()
        while not caplog.records:
            threading.Event().wait(0.001)
    assert [each.message for each in caplog.records] == [
        f"not all is saved, control goes on: {tmp_path}/run-1.mcap: less than 64 MiB are left on its disk: make room"
    ]
    assert len(replayed(tmp_path / "run-1.mcap")) == 10
    assert len(replayed(tmp_path / "run-2.mcap")) == 40
    assert recorder.incomplete
    assert recorder.failure is None
    assert re.fullmatch(
        rf"recordings written: {tmp_path}/run-1\.mcap \(10 of \d+ steps\), {tmp_path}/run-2\.mcap \(40 steps\)",
        recorder.summary,
    )


def test_a_disk_that_fills_up_at_the_last_moment_is_no_success(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    run = VirtualRun("fixed")
    everything = ContinuousRecorder(tmp_path / "run.mcap", 60, PublishConfig())
    last = LastSecondsRecorder(tmp_path / "last.mcap", 60, PublishConfig(), 1.0)
    with caplog.at_level(logging.WARNING):
        for recorder in (everything, last):
            with recorder:
                run.feed(recorder, 20)  # less than a chunk: all of it is written at the end
                resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert everything.incomplete
    assert last.incomplete
    assert everything.summary.endswith("run.mcap: 0 steps recorded, 0 dropped by the recorder, 20 lost when it stopped")
    assert last.summary.endswith("last-1.mcap (0 of 20 steps)")
    assert [each.message.partition(":")[0] for each in caplog.records] == [
        "recording stops, control goes on", "not all is saved, control goes on"
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["run", "run.txt", "run.MCAP", ".mcap", "run.mcap.gz"])
@pytest.mark.parametrize("last_s", [None, 5.0])
def test_a_recording_is_named_for_what_it_is(tmp_path: Path, name: str, last_s: float | None) -> None:
    config = Config.model_validate({"cameras": {"left": {"serial": "A"}}})
    with pytest.raises(RecordingError, match=r"is not a name for a recording: it must end in \.mcap"):
        new_recorder(tmp_path / name, config, last_s)
    assert list(tmp_path.iterdir()) == []


def frames_of(path: Path) -> list[Frame]:
    return [frame for item in Recording(path) if isinstance(item, Step) for frame in item.pair.frames.values()]


@pytest.mark.parametrize(
    "row",
    [
        PixelFormat.MONO8,
        PixelFormat.MONO12,
        PixelFormat.MONO16,
        PixelFormat.BAYER_RG10P,
        PixelFormat.RGB8,
        PixelFormat.YUV422_8,
    ],
)
def test_every_layout_is_read_back_to_the_bit_and_replayed(tmp_path: Path, row: PixelFormat) -> None:
    """Of both cameras, and of either one alone."""
    kept: list[FrameSet] = []

    def in_this_format(pair: FrameSet) -> FrameSet:
        rng = np.random.default_rng(pair.trigger)
        shape = (136, 180, SAMPLES[row.layout]) if row.layout in SAMPLES else (136, 180)
        pixels = rng.integers(0, 1 << row.bit_depth, shape).astype(row.dtype)
        cameras: tuple[CameraName, ...] = ("left", "right") if pair.trigger % 4 > 1 else (SIDES[pair.trigger % 4],)
        frames = {
            camera: replace(pair.frames[camera], pixels=pixels, bit_depth=row.bit_depth, layout=row.layout)
            for camera in cameras
        }
        kept.append(FrameSet(pair.trigger, frames))
        return kept[-1]

    path = tmp_path / "run.mcap"
    with ContinuousRecorder(path, 8, PublishConfig()) as recorder:
        VirtualRun().feed(recorder, 8, in_this_format)
    read = [item.pair for item in Recording(path) if isinstance(item, Step)]
    for was, now in zip(kept, read, strict=True):
        assert (now.trigger, list(now.frames)) == (was.trigger, list(was.frames))
        for one, other in zip(was.frames.values(), now.frames.values(), strict=True):
            assert np.array_equal(one.pixels, other.pixels) and one.pixels.dtype == other.pixels.dtype
            assert all(getattr(one, name) == getattr(other, name) for name in Frame.__slots__ if name != "pixels")
    assert all(step.same for step in replayed(path)[1:])


def test_deep_pixels_of_former_recordings_are_in_the_low_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    new = record(tmp_path / "new.mcap", VirtualRun(bits=12), 4)
    with monkeypatch.context() as patch:
        patch.setattr("autoexpose_daemon.messages.frames.to_full_scale", lambda _depth: 0)
        patch.setattr("autoexpose_daemon.recording.file.FULL_SCALE", {})
        patch.setattr("autoexpose_daemon.recording.file.profiles", lambda _qos: "")
        old = record(tmp_path / "old.mcap", VirtualRun(bits=12), 4)
    pairs = zip(frames_of(new), frames_of(old), strict=True)
    assert all(np.array_equal(one.pixels, other.pixels) for one, other in pairs)


def test_last_seconds_are_as_many_when_the_rate_rises(tmp_path: Path) -> None:
    with LastSecondsRecorder(tmp_path / "a.mcap", 2, PublishConfig(), 10) as recorder:
        recorder.follow(20, PublishConfig())
        VirtualRun().feed(recorder, 100)
    assert recorder.summary.endswith("a-1.mcap (100 steps)")


def test_a_changed_stamp_is_recorded_from_then_on(tmp_path: Path) -> None:
    """As after a reload; the moment counts from the start of the exposure."""
    path, run = tmp_path / "a.mcap", VirtualRun()
    with ContinuousRecorder(path, 60, PublishConfig(rig="scout")) as recorder:
        run.feed(recorder, 4)
        recorder.follow(60, PublishConfig(rig="scout", stamp="start"))
        run.feed(recorder, 4)
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/scout/left/exposure"])
        infos = [TYPESTORE.deserialize_cdr(message.data, EXPOSURE_INFO) for _, _, message in messages]
    stamps = np.array([info.header.stamp.sec * 10**9 + info.header.stamp.nanosec - info.host_time_ns for info in infos])
    halves = np.array([500.0 * info.exposure_time_us for info in infos])
    assert len(stamps) == 8
    assert (np.abs(stamps - stamps[-1] - np.where(np.arange(8) < 4, halves, 0.0)) <= 1.0).all()
