"""The keys under which a rig is found in zenoh, the files that configure zenoh, and how topics are offered in ROS 2."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from documents.bounds import CAMERA_NAME
from documents.files import read_regular
from documents.text import readable
from drivers.log_throttle import LogThrottle
from imaging.errors import ConfigurationError

if TYPE_CHECKING:
    from imaging.frames import CameraName

ONE_GROUP = "all"
"""The group of cameras that name none."""

LOOPBACK = "tcp/127.0.0.1:7448"
"""Where a daemon listens unless configured otherwise; next to 7447, the port of zenoh routers."""

ROUTER = "tcp/127.0.0.1:7447"
"""Where a zenoh router of this machine listens unless configured otherwise, rmw_zenoh's too."""

RIG_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""What zenoh allows in a key and ROS 2 in the name of a coordinate frame."""

LAST_ROS2_DOMAIN = 232
"""The highest ROS_DOMAIN_ID that ROS 2 knows."""

log = logging.getLogger(__name__)
_SELDOM = LogThrottle(60.0)

CONSUMER_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_ENDPOINT = re.compile(r"[a-z][a-z0-9_-]*/\S+")
_LONGEST_KEY = 512
_CHUNK = r"(?:\*|(?!\*\*/\*)\*\*|[^/*$#?\s]+)"  # zenoh requires */** in place of **/*
_KEY_EXPRESSION = re.compile(f"{_CHUNK}(?:/{_CHUNK})*")


def check_rig_name(rig: str) -> None:
    """Raise ConfigurationError for an invalid name of a rig."""
    if not RIG_NAME.fullmatch(rig):
        raise ConfigurationError(f"{rig} is not a valid name for a rig: a letter, then letters, digits and _")


def check_endpoints(endpoints: Iterable[str]) -> None:
    """Raise ConfigurationError for invalid zenoh endpoints."""
    for endpoint in endpoints:
        if not _ENDPOINT.fullmatch(endpoint):
            raise ConfigurationError(f"{endpoint} is not an endpoint: write protocol/address, such as {LOOPBACK}")


def check_key_expression(key: str) -> str:
    """The key itself; raises ConfigurationError for an invalid key expression of zenoh."""
    if len(key) > _LONGEST_KEY or not key.isprintable() or not _KEY_EXPRESSION.fullmatch(key):
        raise ConfigurationError(
            f"{key[:_LONGEST_KEY]!a} is not a key expression of zenoh: write names with / between them and none at the "
            "ends, * for any one name, ** for any at the end"
        )
    return key


def frame_key(rig: str, camera: CameraName | Literal["*"], topic: str) -> str:
    """Where the messages of a camera, or of all (`*`), go; `topic` is one of `image`, `camera_info`, `exposure`."""
    return f"autoexpose/{rig}/{camera}/{topic}"


def all_of_rig(rig: str) -> str:
    """A key expression for all messages of a rig."""
    return f"autoexpose/{rig}/*/*"


def consumer_key(rig: str, name: str) -> str:
    """Where a consumer reports its losses; `*` for all of them."""
    return f"autoexpose/{rig}/consumers/{name}"


def ros_topic(rig: str, camera: CameraName, topic: str) -> str:
    """The same in ROS 2 and in recordings, under the names that camera drivers have there: the image is `image_raw`."""
    return f"/{rig}/{camera}/{'image_raw' if topic == 'image' else topic}"


RigTopic = Literal["status", "registration", "light_ahead", "tracking", "control", "grounds"]
"""What there is once for a rig: the daemon's status, and what its latest decision rests on (grounds), if asked; from
`autoexpose repeat` how views lie against the taught path (registration), and for the daemon how the light changed on an
earlier drive (light_ahead); from consumers where and how well they track; and control requests."""


def rig_key(rig: str, topic: RigTopic) -> str:
    """Where one of these goes, or is asked for."""
    return f"autoexpose/{rig}/{topic}"


def response_key(rig: str, camera: CameraName | Literal["*"]) -> str:
    """Where the response function of a camera goes; `*` for all of them."""
    return f"autoexpose/{rig}/{camera}/response"


def camera_of(key: str) -> CameraName | None:
    """The camera of a `frame_key` or `response_key`; None, and a line in the log, for what is no camera's name."""
    name = last_but(key, 1)
    if CAMERA_NAME.fullmatch(name):
        return name
    if _SELDOM.due("camera", time.monotonic_ns()):
        log.warning("messages of a camera named %a are ignored: that is no camera's name", name)
    return None


def last_but(key: str, parts: int) -> str:
    """The part of a key that is followed by `parts` others; empty if it has none: anyone may send to `**`."""
    names = key.split("/")
    return names[-1 - parts] if parts < len(names) else ""


@dataclass(frozen=True, slots=True)
class OfferedQos:
    """What a publisher offers to its subscribers.

    If `reliable`, lost messages are sent again; otherwise best effort. The last `depth` messages are kept to be sent;
    if `latched` also to subscribers that join later ("transient local"); otherwise volatile.
    """

    reliable: bool
    depth: int
    latched: bool = False


SENSOR_DATA: Final = OfferedQos(reliable=False, depth=5)
"""For frames and what belongs to a frame, as camera drivers offer them."""

DEFAULT: Final = OfferedQos(reliable=True, depth=10)

LATCHED: Final = OfferedQos(reliable=True, depth=1, latched=True)
"""For what is sent once and holds until it is sent again."""


_MOST_BYTES = 1 << 20
_DEEPEST = 100  # zenoh's own has 6 levels; at some 50,000 its parser overflows the stack
_PLACE = re.compile(r"--> (\d+):(\d+).*= (.*)", re.DOTALL)
_MESSAGE = re.compile(r'msg: "((?:[^"\\]|\\.)*)')
_LONGEST_REASON = 160


def check_zenoh_file(file: Path) -> None:
    """Raise ConfigurationError for a file that zenoh cannot use: without zenoh, only for one that cannot be read."""
    try:
        content = read_regular(file, _MOST_BYTES)  # given a pipe, zenoh itself would wait for a writer
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigurationError(f"{file} cannot be read ({reason}): name a zenoh configuration file") from error
    if _depth(content) > _DEEPEST:
        raise ConfigurationError(f"{file} is not a configuration of zenoh: it nests more than {_DEEPEST} levels")
    try:
        import zenoh  # noqa: PLC0415  part of an extra
    except ModuleNotFoundError:
        return  # whoever needs it says so
    try:
        zenoh.Config.from_file(file)
    except zenoh.ZError as error:
        raise ConfigurationError(f"{file} is not a configuration of zenoh: {_reason(str(error))}") from error


def _depth(content: bytes) -> int:
    depth = deepest = 0
    for byte in content:
        depth += (byte in b"[{") - (byte in b"]}")
        deepest = max(deepest, depth)
    return deepest


def _reason(text: str) -> str:
    """What zenoh says, in a line and without the places in its sources."""
    text = text.split(" at /", maxsplit=1)[0]
    if place := _PLACE.search(text):
        text = f"line {place[1]}, column {place[2]}: {place[3]}"
    elif message := _MESSAGE.search(text):
        text = message[1]
    text = readable(" ".join(text.split()))
    return text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]} ..."
