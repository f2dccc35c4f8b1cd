"""Reads a recording from its first item to its last, of whatever format, complete, cut off or damaged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, BinaryIO, cast, get_args, get_type_hints

import numpy as np
from mcap.exceptions import RecordLengthLimitExceeded
from mcap.records import Channel, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from autoexpose_daemon.control.loop import STATE_FORMAT
from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.control.policies.ids import REMOVED
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import parse
from autoexpose_daemon.control.step import Override, StepInputs
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import (
    decision_of,
    frame_of,
    read_camera_info,
    read_exposure_info,
    read_image,
)
from autoexpose_daemon.messages.types import EXPOSURE_INFO, TYPESTORE, definition
from autoexpose_daemon.recording.file import (
    CONTROL,
    FULL_SCALE,
    GIVEN,
    METADATA,
    OFFERED_QOS,
    REQUESTS,
    SETUP,
    STATE,
    STRING,
    Item,
    LoopState,
    RecordingError,
    Setup,
    Step,
    from_json,
)
from documents import bounds
from documents.files import open_regular
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES, CameraGeometry

FORMER_FORMATS = tuple(f"autoexpose-control/{number}" for number in range(2, 15))
"""In the fourteenth, topics began with `/autoexpose/`, and images were called `image`. In the thirteenth, cameras were
called sides. In the eleventh, motion was measured by DIS flow unless a paper has Farneback's. In the tenth, only the
latest delay of the loop was remembered. In the ninth, levels of light ahead followed the light and nothing else. In the
eighth, searches did not know whose frames they compared. In the sixth, nothing was bracketed. In the fifth, consumers
steered nothing, and no lens had a vignetting. In the fourth, gains had even steps, and nothing could override the
policy. In the second, control had one response, the left camera's, and one history of motion, whichever camera frames
were from.
"""

_FARNEBACK = {"begin2022", "begin2022-code", "mehta2020", "mehta2020-code"}


def upgraded_setup(setup: Any) -> Any:
    """A setup of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(setup, dict):
        return setup
    if "regions" in setup:
        setup = {"vignettings": {}, **setup}
    setup = _with_present_names(_with_defaults(setup, {"bracket": None}, "parameters"))
    setup = _with_defaults(setup, {"gains_db": []}, "limits")
    if "response" not in setup:
        return setup
    others = {key: value for key, value in setup.items() if key != "response"}
    others = _with_defaults(others, {"full_well_e": 10_500.0, "read_noise_e": 3.0}, "parameters")
    return {"responses": dict.fromkeys(SIDES, setup["response"]), **others}


def _with_present_names(setup: dict[str, Any]) -> dict[str, Any]:
    """What takes the place of `REMOVED` motion, and of a policy that decided on no frame of a bracket."""
    parameters, policy_id = setup.get("parameters"), setup.get("policy_id")
    if not isinstance(parameters, dict):
        return setup
    motion, bracket = parameters.get("motion"), parameters.get("bracket")
    if isinstance(motion, str):
        setup = {**setup, "parameters": {**parameters, "motion": REMOVED["motion"].get(motion, motion)}}
    if isinstance(policy_id, str) and isinstance(bracket, dict) and bracket.get("keep") is False:
        setup = {**setup, "policy_id": REMOVED["policy"].get(policy_id, policy_id)}
    return setup


def upgraded_light(light: Any) -> Any:
    """Light ahead of one of `FORMER_FORMATS` as of the present format; anything else is returned unchanged."""
    if isinstance(light, dict) and "risen" not in light and isinstance(light.get("levels"), list):
        return {**light, "risen": [-level if isinstance(level, int | float) else level for level in light["levels"]]}
    return light


def upgraded_state(state: Any, setup: ControlSetup) -> Any:
    """A state of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(state, dict):
        return state
    state = _with_reference(_of_third(state) if "motion" in state else state)
    motion = setup.parameters.motion
    by_paper = motion == "policy" and setup.policy_id in _FARNEBACK and setup.parameters.bracket is None
    if motion != "farneback" and not by_paper and isinstance(state.get("motions"), dict):
        state = {**state, "motions": {camera: _of_tiles(each) for camera, each in state["motions"].items()}}
    named: dict[str, Any] = _of_cameras(_with_delays(state))
    return named


def _of_cameras(state: Any) -> Any:
    """A state in which cameras were called sides."""
    if isinstance(state, dict):
        return {_CAMERAS.get(key, key): _of_cameras(each) for key, each in state.items()}
    return [_of_cameras(each) for each in state] if isinstance(state, list) else state


_CAMERAS = {"side": "camera", "motion_side": "motion_camera"}


def _of_tiles(motion: Any) -> Any:
    """For a motion that was measured by DIS, one that has seen no frame."""
    if isinstance(motion, dict) and "previous_level" in motion:
        return {"shape": [0, 0], "previous_time_ns": None, "previous": np.empty((0, 0), np.int16)}
    return motion


def _with_delays(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    policy = _with_delays(policy)
    latency = policy.get("latency")
    if isinstance(latency, dict) and "frames" in latency:
        policy = {**policy, "latency": {"level": latency.get("level"), "found": [latency["frames"]]}}
    return {**state, "policy": policy}


def _with_reference(state: dict[str, Any]) -> dict[str, Any]:
    """The state of whatever has a policy, as a loop or a bracket: a search takes the camera of its next frame."""
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    if policy.keys() >= {"query", "held"}:
        policy = {"reference": {"side": None, "missed": 0}, **policy}
    return {**state, "policy": _with_reference(policy)}


def _with_defaults(data: Any, defaults: dict[str, Any], key: str) -> Any:
    """Data with these entries, where missing, in what has a key; anything else stays."""
    inside = data.get(key)
    return {**data, key: {**defaults, **inside}} if isinstance(inside, dict) else data


def _of_third(state: dict[str, Any]) -> dict[str, Any]:
    unseen = {"shape": [0, 0], "previous": np.empty((0, 0), np.uint8), "previous_level": 0.0, "previous_time_ns": None}
    return {
        "past": state.get("past"),
        "motions": {"left": state["motion"], "right": unseen},
        "motion_side": "left",
        "motion_px": 0.0,
        "policy": state.get("policy"),
        "flicker": None,
    }


_TYPES = get_type_hints(StepInputs)
_FIELDS = {
    topic: (name, next((each for each in get_args(_TYPES[name]) if each is not NoneType), _TYPES[name]))
    for name, topic in GIVEN.items()
}
"""By topic: the field of `StepInputs`, and its type when it is given."""

_OF_CONTROL = {*_FIELDS, SETUP, REQUESTS, STATE}

_COUNT_DIGITS = 18
"""More steps than that fit into no file; Python itself refuses numbers of more than 4300 digits."""


_MAGIC_BYTES = 8  # What an MCAP file begins with


@dataclass(frozen=True, slots=True)
class Mark:
    """A place between two items of a file, from which it can be read without what is before."""

    at_byte: int
    # Where records begin, before it, that say something of all that follow: of channels, and setups.
    needs: tuple[int, ...] = ()


class Recording:
    """The items of a file in order, one at a time in memory; with `begin`, those from a mark on.

    Raises RecordingError while iterating: in one sentence, what is wrong with the file.
    """

    def __init__(self, path: Path, begin: Mark | None = None) -> None:
        # When all items have been read: whether the file ends within a record, as after a full disk or a power cut; and
        # the steps that the recorder dropped, according to the end of the file, None when that is missing.
        self.cut_off = False
        self.dropped: int | None = None
        # The last one before the item that was read last: where its chunk begins, unless an item spans two.
        self.mark = begin or Mark(_MAGIC_BYTES)
        self._begin = begin
        self._path = path
        self._rig: str | None = None  # what its topics begin with, known from the first that control has written
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._frames: dict[CameraName, Frame] = {}  # of the step that is being read
        self._infos: dict[CameraName, Any] = {}
        self._given: dict[str, Any] = {}
        self._requests: tuple[str, ...] = ()
        self._setup: ControlSetup | None = None
        self._calibrations: dict[CameraName, CameraGeometry] = {}

    @property
    def rig(self) -> str | None:
        """The name of the rig, once something of control has been read."""
        return None if self._rig is None else self._rig.rpartition("/")[2]

    def __iter__(self) -> Iterator[Item]:
        """Read from the start of the file, or from the mark."""
        try:
            with open_regular(self._path) as stream:
                yield from self._items(stream)
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be read: {error.strerror}") from error

    def _items(self, stream: BinaryIO) -> Iterator[Item]:
        items = 0
        for record in self._marking(stream):
            match record:
                case Metadata(name=name, metadata=notes) if name == METADATA:
                    dropped = notes.get("dropped", "")
                    if len(dropped) > _COUNT_DIGITS:
                        raise self._error(f"is damaged: a count of dropped steps of {len(dropped)} digits")
                    self.dropped = int(dropped) if dropped.isdecimal() else None
                case Message():
                    try:
                        item = self._item(record)
                    except ValueError as error:
                        raise self._error(f"is damaged: {error}") from error
                    if item is not None:
                        items += 1
                        yield item
        if items == 0:
            raise self._error("contains no steps of control: it is not a recording of autoexpose, or an empty one")

    def _marking(self, stream: BinaryIO) -> Iterator[Any]:
        """The records to read, while `mark` moves on."""
        if self._begin is not None:
            for needed in self._begin.needs:
                self._look_up(stream, needed)
            stream.seek(self._begin.at_byte)
        at = end = self.mark.at_byte  # of the chunk, or the record by itself, that holds the present one
        needs = dict.fromkeys(self.mark.needs)
        for record in self._records(stream):
            if stream.tell() != end:
                at, end = end, stream.tell()
                if not (self._infos or self._given or self._requests):
                    self.mark = Mark(at, tuple(needs))
            if self._learn(record):
                needs[at] = None
            yield record

    def _look_up(self, stream: BinaryIO, needed: int) -> None:
        """Read what the records at a place say of all that follow."""
        stream.seek(needed)
        end: int | None = None
        for record in self._records(stream):
            if end not in (None, stream.tell()):
                return
            end = stream.tell()
            if self._learn(record) and isinstance(record, Message):
                self._item(record)

    def _learn(self, record: Any) -> bool:
        """Whether a record says something of all that follow; channels and their schemas are noted."""
        match record:
            case Schema():
                known, self._schemas[record.id] = self._schemas.get(record.id), record
                return known != record
            case Channel():
                former, self._channels[record.id] = self._channels.get(record.id), record
                return former != record
            case Message():
                channel = self._channels.get(record.channel_id)
                return channel is not None and channel.topic.endswith(f"/{CONTROL}/{SETUP}")
        return False

    def _records(self, stream: BinaryIO) -> Iterator[Any]:
        """The records of the file from here up to where it was cut off, if it was."""
        size = self._path.stat().st_size
        begun = self._begin is not None
        reader = StreamReader(stream, skip_magic=begun, validate_crcs=True, record_size_limit=size)
        records = iter(reader.records)
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except Exception as error:  # bytes that are not MCAP break the reader in many ways
                if not begun:
                    raise self._error("is not an MCAP file, or is damaged from its first bytes on") from error
                if stream.tell() < size and not isinstance(error, RecordLengthLimitExceeded):
                    raise self._error(f"is damaged before byte {stream.tell()} of {size}") from error
                self.cut_off = True
                return
            begun = begun or isinstance(record, Header)
            if isinstance(record, Footer):
                return
            yield record

    def _item(self, message: Message) -> Item | None:
        """The item that a message completes."""
        channel = self._channels.get(message.channel_id)
        if channel is None:
            raise ValueError(f"a message of channel {message.channel_id}, which does not exist")
        rig, *place = channel.topic.rsplit("/", 2)
        match place:
            case ["control", what] if what in _OF_CONTROL and self._is_text(channel) and self._rig in (None, rig):
                item = self._of_control(what, message.data)
                self._rig = rig
                return item
            case ["control", "setup"] if self._is_text(channel):
                raise self._error(f"holds the recordings of {self._rig!a} and {rig!a}: replay them from a file each")
            case [camera, "exposure"] if rig == self._rig:
                self._check_version(channel)
                self._exposure(camera, message.data)
            case [camera, "camera_info"] if rig == self._rig:
                geometry = read_camera_info(message.data)
                if geometry is not None:
                    self._calibrations[camera] = geometry
            case [camera, "image_raw" | "image"] if rig == self._rig:
                notes = channel.metadata
                full_scale = FULL_SCALE.items() <= notes.items() or bool(notes.get(OFFERED_QOS))
                return self._image(camera, message.data, full_scale=full_scale)
        return None

    def _of_control(self, what: str, data: bytes) -> Setup | LoopState | None:
        try:
            text = cast(Any, TYPESTORE.deserialize_cdr(data, STRING)).data
        except Exception as error:  # rosbags checks nothing
            raise DamagedMessageError(f"control/{what} is not a String") from error
        content = from_json(text)
        if not isinstance(content, dict) or content.get("format") not in (STATE_FORMAT, *FORMER_FORMATS):
            found = content.get("format") if isinstance(content, dict) else None
            raise self._error(f"contains a state of control of format {found!r}: only {STATE_FORMAT!r} can be read")
        match what:
            case "setup":
                self._setup = parse(upgraded_setup(content.get("setup")), ControlSetup)
                return Setup(self._setup, parse(content.get("made_with"), dict[str, str]))
            case "state":
                state, former = content.get("state"), content["format"] in FORMER_FORMATS
                return LoopState(upgraded_state(state, self._setup) if former and self._setup is not None else state)
            case "requests":
                self._requests = parse(content.get("requests"), tuple[str, ...])
            case _:
                name, kind = _FIELDS[what]
                given = content.get(name)
                self._given[name] = _checked(parse(upgraded_light(given) if name == "light_ahead" else given, kind))
        return None

    def _exposure(self, camera: CameraName, data: bytes) -> None:
        info = read_exposure_info(data)
        for other in self._infos.values():
            if other.sequence != info.sequence:
                raise ValueError(f"step {other.sequence} is incomplete")
        self._infos[camera] = info

    def _image(self, camera: CameraName, data: bytes, *, full_scale: bool) -> Step | None:
        if camera not in self._infos or camera in self._frames:
            raise ValueError(f"an image of the {camera} camera without its exposure")
        stamp_ns, image = read_image(data)
        info = self._infos[camera]
        self._frames[camera] = frame_of(info, image, full_scale=full_scale)
        if len(self._frames) < (1 if info.alone else info.cameras):
            return None
        pair = FrameSet(info.trigger, self._frames)
        self._infos, self._frames = {}, {}
        decision = decision_of(info)
        if decision is None:
            raise ValueError(f"step {info.sequence} has no decision")
        given, self._given = self._given, {}
        requests, self._requests = self._requests, ()
        calibrations, self._calibrations = self._calibrations, {}
        inputs = StepInputs(pair, **given)
        return Step(info.sequence, info.cameras, inputs, decision, requests, calibrations, stamp_ns)

    def _is_text(self, channel: Channel) -> bool:
        schema = self._schemas.get(channel.schema_id)
        return schema is not None and schema.name == STRING

    def _check_version(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        if schema is None or schema.data != definition(EXPOSURE_INFO).encode():
            raise self._error("was recorded with another version of ExposureInfo.msg: replay it with that version")

    def _error(self, what: str) -> RecordingError:
        return RecordingError(f"{self._path}: {what}")


def _checked(given: Any) -> Any:
    """What the step that follows was given besides its frames; ValueError for what no recorder writes."""
    match given:
        case float() if not abs(given) <= FASTEST_TURN_RAD_S:
            raise ValueError(f"an angular rate of {given} rad/s")
        case Override(ev_stops) if ev_stops not in bounds.EV_STOPS:
            raise ValueError(f"an EV compensation of {ev_stops}")
        case Override(_, held, shot) if not all(one is None or one.is_physical for one in (held, shot)):
            raise ValueError(f"{given} is not an exposure")
        case Override(held=None, unseen=True):
            raise ValueError("a pair that is not shown to the policy, and nothing to hold")
    return given
