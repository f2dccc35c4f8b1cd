"""A recording on disk: MCAP that ROS 2 tools can read, plus what a replay needs."""

from __future__ import annotations

import base64
import binascii
import json
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import STATE_FORMAT
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import ARRAY_TYPES, Plain, plain
from autoexpose_daemon.control.step import NO_OVERRIDE, StepInputs
from autoexpose_daemon.messages.frames import MIDDLE, TOPICS, MessageWriter, Stamping, realtime_offset_ns
from autoexpose_daemon.messages.keys import DEFAULT, LATCHED, SENSOR_DATA, OfferedQos, ros_topic
from autoexpose_daemon.messages.types import IMAGE, TYPESTORE, definition
from imaging.errors import AutoexposeError
from imaging.frames import CameraName, FrameSet
from imaging.geometry import CameraGeometry

OFFERED_QOS: Final = "offered_qos_profiles"
"""Key in a channel's metadata: YAML that says how the topic was offered, so that `ros2 bag play` offers it that way."""

ROSBAG2: Final = "rosbag2"
EARLY_YAML: Final = {"serialized_metadata": ""}
"""A metadata record of this name and content: the policies in the YAML are numbers.

Up to Humble, rosbag2 reads nothing but numbers. Since Jazzy it takes them for names unless the file says that it is
older, and this is how: by a record without the metadata that rosbag2 has written into it since.
"""

# The numbers are those of rmw/types.h.
_KEEP_LAST, _AUTOMATIC = 1, 1
_RELIABLE, _BEST_EFFORT = 1, 2
_TRANSIENT_LOCAL, _VOLATILE = 1, 2

_FOREVER: Final = "{sec: 9223372036, nsec: 854775807}"
"""RMW_DURATION_INFINITE."""


def profiles(qos: OfferedQos) -> str:
    """The value of `OFFERED_QOS` for a topic with one publisher."""
    policies = {
        "history": _KEEP_LAST,
        "depth": qos.depth,
        "reliability": _RELIABLE if qos.reliable else _BEST_EFFORT,
        "durability": _TRANSIENT_LOCAL if qos.latched else _VOLATILE,
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": _AUTOMATIC,
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": "false",
    }
    return "- " + "\n  ".join(f"{policy}: {value}" for policy, value in policies.items())


_KEYS = {"dtype", "shape", "base64"}


def to_json(data: Plain) -> str:
    """JSON on one line; floats in the shortest form that reads back the same, as `json` writes them."""
    return json.dumps(data, default=_array_to_json, separators=(",", ":"))


def from_json(text: str) -> Any:
    """What `to_json` was given. Raises ValueError for text that `to_json` would not write."""
    try:
        return json.loads(text, object_hook=_array_from_json)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _array_to_json(array: object) -> dict[str, Any]:
    if not isinstance(array, np.ndarray) or array.dtype.name not in ARRAY_TYPES:
        raise TypeError(f"{type(array).__name__} is not an array of {', '.join(ARRAY_TYPES)}")
    little_endian = array.astype(array.dtype.newbyteorder("<"), copy=False)
    encoded = base64.b64encode(little_endian.tobytes()).decode()
    return {"dtype": array.dtype.name, "shape": list(array.shape), "base64": encoded}


def _array_from_json(members: dict[str, Any]) -> Any:
    if set(members) != _KEYS:
        return members
    try:
        if members["dtype"] not in ARRAY_TYPES:
            raise ValueError(f"an array of {members['dtype']}")
        content = base64.b64decode(members["base64"], validate=True)
        dtype = np.dtype(members["dtype"])
        return np.frombuffer(content, dtype.newbyteorder("<")).astype(dtype).reshape(members["shape"])
    except (TypeError, OverflowError, binascii.Error) as error:
        raise ValueError(f"a damaged array: {error}") from None


class RecordingError(AutoexposeError):
    """A recording cannot be written or read; the message names the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of control."""

    sequence: int  # counts the steps of control: a gap is what the recorder dropped
    cameras: int  # how many cameras the rig has
    # what control was given. A gap in the triggers of pairs without one in `sequence` means pairs that never reached
    # control
    inputs: StepInputs
    decision: Decision  # what control decided
    requests: tuple[str, ...] = ()  # what was requested of control since the step before, and who asked
    # geometry of the calibrated cameras, in CameraInfo; a replay needs none
    calibrations: Mapping[CameraName, CameraGeometry] = field(default_factory=dict)
    stamp_ns: int = 0  # of a step that was read: the stamp of its messages

    @property
    def pair(self) -> FrameSet:
        """What control looked at."""
        return self.inputs.pair


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A new control loop, which makes the steps that follow."""

    control: ControlSetup  # what the loop is built from
    made_with: dict[str, str]  # the software that made the decisions, with versions


@dataclass(frozen=True, slots=True, eq=False)
class LoopState:
    """The state of the control loop after the step before it, `ControlLoop.state`."""

    control: Plain


Item = Setup | Step | LoopState
"""In the order of the file: a setup, its first step, the state after it, more steps, the next state, ..."""


CONTROL, SETUP, REQUESTS, STATE = "control", "setup", "requests", "state"
GIVEN = {each.name: each.name for each in fields(StepInputs) if each.name != "pair"}
GIVEN |= {"angular_rate_rad_s": "motion", "light_ahead": "light"}
"""The topic, below `CONTROL`, of each field of `StepInputs` besides the pair."""

STRING = "std_msgs/msg/String"
"""What control was built from and given is JSON in a String, so any ROS 2 tool shows it."""

FULL_SCALE = {"scale": "full"}
"""Metadata of image channels: samples of more than 8 bits are shifted to full scale. Earlier files lack it, and
hold them in the low bits. Tools that convert recordings drop it, but keep the QoS, which was added later."""

METADATA = "autoexpose"
COMPRESSION = CompressionType.LZ4
_CHUNK_BYTES = 4 << 20
"""Five pairs of 720x540: what a power cut costs. Smaller chunks mean more work for each pair."""

RESERVE_BYTES = 64 << 20
"""Left free on the disk: a robot needs some for its logs, and the recording for the index at its end."""

_String = TYPESTORE.types[STRING]


class RecordingFile:
    """A new file, written step by step, in chunks of whole steps.

    Every method raises RecordingError: when the file exists, cannot be written, or its disk is nearly full. Topics have
    the names of the rig's in ROS 2.
    """

    def __init__(self, path: Path, rig: str) -> None:
        self._path = path
        self._rig = rig
        self._offset_ns = realtime_offset_ns()  # for the whole file: its times must not run backwards
        self._time_ns = 0
        self._setup: ControlSetup | None = None
        self._broken = False
        self.steps = 0  # that can be read back whatever happens next: those in the chunks already written
        self._chunk_steps = self._chunk_bytes = 0
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._stream = path.open("xb")
        except FileExistsError:
            raise RecordingError(f"{path}: already exists: name a new file") from None
        except OSError as error:
            raise self._error(error) from error
        self._writer = Writer(self._stream, chunk_size=sys.maxsize, compression=COMPRESSION)
        self._writer.start(profile="ros2", library=f"autoexpose-daemon {version('autoexpose-daemon')}")
        self._writer.add_metadata(ROSBAG2, EARLY_YAML)

    def write(self, step: Step, setup: ControlSetup, state: Plain, stamping: Stamping = MIDDLE) -> None:
        """Append a step, with the setup of the loop that made it, and the loop's state after it unless None."""
        try:
            space = os.fstatvfs(self._stream.fileno())
            if space.f_bavail * space.f_frsize < RESERVE_BYTES:
                raise RecordingError(
                    f"{self._path}: less than {RESERVE_BYTES >> 20} MiB are left on its disk: make room"
                )
            self._time_ns = max(frame.arrival_time_ns for frame in step.pair.frames.values()) + self._offset_ns
            if setup is not self._setup:
                self._setup = setup
                self._say(SETUP, {"made_with": plain(software()), "setup": plain(setup)})
            if step.requests:
                self._say(REQUESTS, {"requests": plain(step.requests)})
            for name, topic in GIVEN.items():
                if (given := getattr(step.inputs, name)) not in (None, NO_OVERRIDE):
                    self._say(topic, {name: plain(given)})
            messages = MessageWriter(self._rig, step.cameras, stamping)
            decisions, calibrations = dict.fromkeys(step.pair.frames, step.decision), step.calibrations
            made = messages.messages(step.pair, decisions, step.sequence, self._offset_ns, calibrations=calibrations)
            for message in made:
                self._add(message.camera, message.topic, TOPICS[message.topic], message.data, step.sequence)
            if state is not None:
                self._say(STATE, {"state": state})
            self._chunk_steps += 1
            if self._chunk_bytes >= _CHUNK_BYTES:
                self._end_chunk()
        except OSError as error:
            raise self._error(error) from error

    def close(self, steps: int, dropped: int) -> None:
        """End the file with an index, and with the counts of steps to record and of steps dropped.

        After a write error there is no index, but everything written before can be read.
        """
        try:
            with self._stream:
                if not self._broken:
                    self._end_chunk()
                    self._writer.add_metadata(METADATA, {"steps": str(steps), "dropped": str(dropped)})
                    self._writer.finish()  # type: ignore[no-untyped-call]
        except OSError as error:
            raise self._error(error) from error

    def _end_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.steps += self._chunk_steps
        self._chunk_steps = self._chunk_bytes = 0

    def _say(self, what: str, content: dict[str, Plain]) -> None:
        text = to_json({"format": STATE_FORMAT, **content})
        self._add(CONTROL, what, STRING, TYPESTORE.serialize_cdr(_String(text), STRING), 0)

    def _add(self, owner: str, what: str, message_type: str, data: Any, sequence: int) -> None:
        topic = ros_topic(self._rig, owner, what)
        if message_type not in self._schemas:
            text = definition(message_type).encode()
            self._schemas[message_type] = self._writer.register_schema(message_type, "ros2msg", text)
        if topic not in self._channels:
            qos = SENSOR_DATA if owner != CONTROL else LATCHED if what == SETUP else DEFAULT
            notes = {OFFERED_QOS: profiles(qos), **(FULL_SCALE if message_type == IMAGE else {})}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[message_type], notes)
        self._writer.add_message(self._channels[topic], self._time_ns, data, self._time_ns, sequence & 0xFFFFFFFF)
        self._chunk_bytes += len(data)

    def _error(self, error: OSError) -> RecordingError:
        self._broken = True
        return RecordingError(f"{self._path}: cannot be written: {error.strerror}")


def software() -> dict[str, str]:
    """The software that decisions depend on, down to the last bit."""
    return {
        "autoexpose-daemon": version("autoexpose-daemon"),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
    }
