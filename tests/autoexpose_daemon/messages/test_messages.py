"""Messages as rosbags itself reads them, and read back; keys of messages from anyone; the package for ROS 2."""

from __future__ import annotations

import math
import re
import time
from dataclasses import replace
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon import messages
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import (
    LAST_STAMP_NS,
    MIDDLE,
    TOPICS,
    Message,
    MessageWriter,
    Moment,
    ReceivedImage,
    Stamping,
    decision_of,
    frame_of,
    read_exposure_info,
    read_image,
    realtime_offset_ns,
)
from autoexpose_daemon.messages.keys import camera_of, frame_key, last_but
from autoexpose_daemon.messages.types import EXPOSURE_INFO, TYPESTORE, definition
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import CameraGeometry
from imaging.pixels import SAMPLES, PixelFormat
from tests import REPOSITORY

DECISION = Decision(ExposureSetting(1500.0, 3.0), 11.05, "held", 0.01, 0.02, 0.03, 1.5)
REALS = st.floats(allow_nan=False)
REASONS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)
COUNTS = st.integers(0, 2**63 - 1)
SETTINGS = st.builds(ExposureSetting, st.floats(1e-3, 1e9), st.floats(-100, 100))
DECISIONS = st.builds(Decision, SETTINGS, REALS, REASONS, *[REALS] * 4)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    row = draw(st.sampled_from(PixelFormat))
    width, height = 2 * draw(st.integers(1, 4)), draw(st.integers(1, 9))
    numbers = np.random.default_rng(draw(st.integers(0, 99)))
    pixels = row.decode(memoryview(numbers.bytes(row.image_bytes(width, height))), width, height)
    pixels = pixels & pixels.dtype.type((1 << row.bit_depth) - 1)
    times = [draw(st.integers(0, 2**60)) for _ in range(3)]
    source = draw(st.sampled_from(["chunk", "ledger"]))
    return Frame(pixels, row.bit_depth, draw(COUNTS), *times, draw(SETTINGS), source, row.layout)


def written(
    pair: FrameSet,
    decision: Decision | None = DECISION,
    sequence: int = 0,
    *,
    offset_ns: int = 0,
    cameras: int = 2,
    stamping: Stamping = MIDDLE,
) -> dict[tuple[CameraName, str], Message]:
    decisions = {} if decision is None else dict.fromkeys(pair.frames, decision)
    messages = MessageWriter("robot", cameras, stamping).messages(pair, decisions, sequence, offset_ns)
    return {(message.camera, message.topic): message for message in messages}


def parsed(message: Message) -> Any:
    return TYPESTORE.deserialize_cdr(bytes(message.data), TOPICS[message.topic])


def facts(frame: Frame) -> list[Any]:
    return [getattr(frame, name) for name in Frame.__slots__ if name != "pixels"]


@given(frames(), frames(), DECISIONS | st.none(), COUNTS, COUNTS)
def test_what_is_written_is_read_back_to_the_bit(
    left: Frame, right: Frame, decision: Decision | None, trigger: int, sequence: int
) -> None:
    messages = written(FrameSet(trigger, {"left": left, "right": right}), decision, sequence)
    cameras: dict[CameraName, Frame] = {"left": left, "right": right}
    for camera, frame in cameras.items():
        info = read_exposure_info(bytes(messages[camera, "exposure"].data))
        _, image = read_image(bytes(messages[camera, "image"].data))
        again = frame_of(info, image)
        assert not again.pixels.flags.writeable
        assert facts(again) == facts(frame)
        assert again.pixels.dtype == frame.pixels.dtype
        assert np.array_equal(again.pixels, frame.pixels)
        assert decision_of(info) == decision
        assert (info.trigger, info.sequence, info.cameras, info.alone) == (trigger, sequence, 2, False)
        assert info.exposure_level == frame.setting.level


@given(frames(), frames(), st.sampled_from([("start", 0.0), ("middle", 0.5), ("end", 1.0)]))
def test_all_messages_of_a_pair_have_one_stamp_and_the_frame_of_their_camera(
    left: Frame, right: Frame, moment: tuple[Moment, float]
) -> None:
    offset_ns, (name, share) = 1_600_000_000_000_000_000, moment
    messages = written(FrameSet(1, {"left": left, "right": right}), offset_ns=offset_ns, stamping=Stamping(name))
    headers = {key: parsed(message).header for key, message in messages.items()}
    assert len(headers) == 6
    at_ns = left.host_time_ns + round(1e3 * share * left.setting.exposure_time_us) + offset_ns
    for (camera, _), header in headers.items():
        assert header.stamp.sec * 10**9 + header.stamp.nanosec == min(at_ns, LAST_STAMP_NS)
        assert header.frame_id == f"robot_{camera}_optical_frame"


@pytest.mark.parametrize("utc_offset_s", [0, 37])
def test_a_stamp_of_ptp_time_is_the_first_cameras_own_less_the_seconds_between_tai_and_utc(utc_offset_s: int) -> None:
    taken_ns = 1_700_000_000_123_456_789
    left, right = (replace(frame(), ptp_time_ns=taken_ns + apart_ns) for apart_ns in (0, 70))
    exposed = round(500 * left.setting.exposure_time_us)
    made = written(FrameSet(1, {"left": left, "right": right}), offset_ns=5, stamping=Stamping("middle", utc_offset_s))
    for message in made.values():
        stamp = parsed(message).header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == taken_ns + exposed - utc_offset_s * 10**9


@pytest.mark.parametrize(
    ("row", "encoding"),
    [
        (PixelFormat.MONO8, "mono8"), (PixelFormat.MONO10P, "mono16"), (PixelFormat.MONO16, "mono16"),
        (PixelFormat.BAYER_RG8, "bayer_rggb8"), (PixelFormat.BAYER_GB12_PACKED, "bayer_gbrg16"),
        (PixelFormat.RGB8, "rgb8"), (PixelFormat.BGR8, "bgr8"), (PixelFormat.YUV422_8, "yuv422_yuy2"),
    ],
)  # fmt: skip
def test_encodings_are_those_of_ros_and_deep_samples_reach_full_scale(row: PixelFormat, encoding: str) -> None:
    full = (1 << row.bit_depth) - 1
    shape = (2, 4, SAMPLES[row.layout]) if row.layout in SAMPLES else (2, 4)
    frame = Frame(
        np.full(shape, full, row.dtype), row.bit_depth, 1, 2, 3, 4, ExposureSetting(1.0, 0.0), layout=row.layout
    )
    image = parsed(written(FrameSet(1, {"left": frame}), cameras=1)["left", "image"])
    assert (image.encoding, image.height, image.width, image.step) == (encoding, 2, 4, frame.pixels.nbytes // 2)
    assert image.data.view(row.dtype).max() >= 0.998 * np.iinfo(row.dtype).max


def test_samples_that_are_not_at_full_scale_are_damaged() -> None:
    """As an earlier daemon sends them."""
    low = Frame(np.full((2, 4), 9, np.uint16), 12, 1, 2, 3, 4, ExposureSetting(1.0, 0.0))
    info = read_exposure_info(bytes(written(FrameSet(1, {"left": low}), cameras=1)["left", "exposure"].data))
    with pytest.raises(DamagedMessageError, match="not 12 bits shifted to full scale"):
        frame_of(info, ReceivedImage(low.pixels, "grey"))
    assert np.array_equal(frame_of(info, ReceivedImage(low.pixels, "grey"), full_scale=False).pixels, low.pixels)
    with pytest.raises(DamagedMessageError, match="an Image of more than 12 bits"):
        frame_of(info, ReceivedImage(low.pixels << 9, "grey"), full_scale=False)


def frame() -> Frame:
    return Frame(np.full((3, 5), 7, np.uint8), 8, 1, 2, 3, 4, ExposureSetting(100.0, 0.0))


def test_camera_info_is_what_a_calibration_of_frames_of_this_size_says() -> None:
    k, p = (8.0, 0.0, 2.0, 0.0, 8.0, 1.0, 0.0, 0.0, 1.0), (7.0, 0.0, 2.0, -0.56, 0.0, 7.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    r = (0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    right = CameraGeometry(5, 3, "equidistant", (0.1, 0.2, 0.3, 0.4), k, r, p)
    pair = FrameSet(1, {"left": frame(), "right": frame()})
    calibrations: dict[CameraName, CameraGeometry] = {"left": replace(right, width=6), "right": right}
    made = MessageWriter("robot", 2).messages(pair, {}, 0, 0, calibrations=calibrations)
    left_info, info = (parsed(message) for message in made if message.topic == "camera_info")
    assert (left_info.height, left_info.width, left_info.k.any()) == (3, 5, False)
    assert (info.height, info.width, info.distortion_model) == (3, 5, "equidistant")
    for read, said in ((info.d, right.distortion), (info.k, k), (info.r, r), (info.p, p)):
        assert tuple(read) == said


def test_a_lone_frame_keeps_its_camera() -> None:
    messages = written(FrameSet(1, {"right": frame()}))
    assert set(messages) == {("right", topic) for topic in TOPICS}
    assert parsed(messages["right", "exposure"]).alone
    assert not parsed(written(FrameSet(1, {"left": frame()}), cameras=1)["left", "exposure"]).alone


def test_the_definition_names_all_that_it_is_made_of() -> None:
    text = definition(EXPOSURE_INFO)
    assert "float64 exposure_time_us" in text
    assert "MSG: std_msgs/Header" in text


def test_the_offset_of_the_clocks_leads_to_the_time_of_day() -> None:
    before_ns = time.time_ns()
    by_offset_ns = time.monotonic_ns() + realtime_offset_ns()
    assert before_ns - 1_000_000 <= by_offset_ns <= time.time_ns() + 1_000_000


@given(st.integers(0, 200))
def test_a_truncated_message_is_refused(length: int) -> None:
    messages = written(FrameSet(1, {"left": frame(), "right": frame()}))
    whole = bytes(messages["left", "image"].data)
    with pytest.raises(DamagedMessageError):
        read_image(whole[: min(length, len(whole) - 1)])


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (3, 0)])
def test_a_frame_without_a_pixel_is_refused(shape: tuple[int, int]) -> None:
    empty = replace(frame(), pixels=np.empty(shape, np.uint8))
    with pytest.raises(DamagedMessageError, match="pixels"):
        read_image(bytes(written(FrameSet(1, {"left": empty}), cameras=1)["left", "image"].data))


@pytest.mark.parametrize("exposure", [(0.0, 0.0), (-1.0, 0.0), (1e300, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_an_exposure_that_no_camera_takes_is_refused_applied_or_decided(exposure: tuple[float, float]) -> None:
    impossible = ExposureSetting(*exposure)
    taken = written(FrameSet(1, {"left": replace(frame(), setting=ExposureSetting(1.0, 0.0))}), cameras=1)
    info = read_exposure_info(bytes(taken["left", "exposure"].data))
    info.exposure_time_us, info.gain_db = exposure
    with pytest.raises(DamagedMessageError, match="an exposure of"):
        frame_of(info, ReceivedImage(frame().pixels, "grey"))
    decided = written(FrameSet(1, {"left": frame()}), replace(DECISION, setting=impossible), cameras=1)
    with pytest.raises(DamagedMessageError, match="an exposure of"):
        decision_of(read_exposure_info(bytes(decided["left", "exposure"].data)))


def test_only_what_is_wanted_is_made() -> None:
    wanted: set[tuple[CameraName, str]] = {("left", "exposure"), ("right", "image")}
    made = MessageWriter("robot", 2).messages(FrameSet(1, {"left": frame(), "right": frame()}), {}, 0, 0, wanted)
    assert {(message.camera, message.topic) for message in made} == wanted


@pytest.mark.parametrize(("parts", "name"), [(0, "image"), (1, "left"), (3, "autoexpose"), (4, "")])
def test_a_part_of_a_key_is_counted_from_its_end(parts: int, name: str) -> None:
    assert last_but(frame_key("rig", "left", "image"), parts) == name


@pytest.mark.parametrize("key", ["**", "*/**", "**/response", "a/r/consumers/slam", "a/r/Left/image"])
def test_a_key_that_is_sent_to_all_names_no_camera(key: str) -> None:
    assert camera_of(key) is None


PACKAGE = REPOSITORY / "ros/autoexpose_msgs"
OURS = {file.name: file.read_text() for file in files(messages).joinpath("autoexpose_msgs/msg").iterdir()}
FIELD_NAME = re.compile(r"[a-z](_?[a-z0-9])*")
"""By the rules of ROS 2: no capitals, no two underscores in a row, none at the end."""


def test_its_definitions_are_those_of_the_daemon() -> None:
    theirs = {file.name: file.read_text() for file in (PACKAGE / "msg").iterdir()}
    assert theirs == OURS, "cp autoexpose_daemon/messages/autoexpose_msgs/msg/*.msg ros/autoexpose_msgs/msg/"


def test_it_builds_all_of_them() -> None:
    built = re.findall(r"^  msg/(\w+\.msg)$", (PACKAGE / "CMakeLists.txt").read_text(), re.MULTILINE)
    assert built == sorted(OURS)


def test_it_has_the_version_of_the_daemon() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    (version,) = re.findall(r'^version = "(.+)"$', (REPOSITORY / "pyproject.toml").read_text(), re.MULTILINE)
    assert manifest.findtext("version") == version


@pytest.mark.parametrize("file", sorted(OURS))
def test_ros_accepts_the_names_of_its_fields(file: str) -> None:
    _, fields = TYPESTORE.fielddefs[f"autoexpose_msgs/msg/{file.removesuffix('.msg')}"]
    assert [name for name, _ in fields if not FIELD_NAME.fullmatch(name)] == []
