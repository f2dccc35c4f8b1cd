"""The daemon's status, as far as this node needs it. Others may have sent it, so it is believed only where it fits."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, fields
from typing import Any

VERSION = 1
LARGEST_BYTES = 1 << 20
MOST_CAMERAS = 16

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_ONE_GROUP = "all"


@dataclass(frozen=True)
class Bounds:
    """The exposures that control may choose."""

    min_time_us: float
    max_time_us: float
    min_gain_db: float
    max_gain_db: float


@dataclass(frozen=True)
class Control:
    """What applies to cameras that are exposed together."""

    policy: str
    locked: bool
    ev_stops: float
    taken: int  # requests, so far
    bounds: Bounds | None  # None before a camera is open


@dataclass(frozen=True)
class Group(Control):
    """The same with its cameras."""

    cameras: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pose:
    """Where a camera stands: in the optical axes of another one (x to the right, y down, z ahead), m and quaternion."""

    of: str
    translation_m: tuple[float, float, float]
    rotation_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True)
class Camera:
    """One camera."""

    hardware: str | None  # model and serial; None: gone
    exposure: tuple[float, float] | None  # us and dB of its newest frame
    misfit: str | None  # why its calibration does not fit
    temperature_c: float | None
    link_mbps: float | None
    frames: int
    lost: int
    pose: Pose | None  # None: it is calibrated with no other one
    # x, y, width and height of each rectangle that counts, none: all does; None: weights or a mask say what does
    region: tuple[tuple[int, ...], ...] | None


@dataclass(frozen=True)
class Status:
    """What the daemon says once a second."""

    rig: str
    state: str
    reasons: tuple[str, ...]
    cameras: dict[str, Camera]
    groups: dict[str, Group]
    rate_hz: float
    counts: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    shares: tuple[float, float] | None = None  # saturated and black
    frame_to_node_p99_ms: float | None = None


def read_status(data: bytes) -> Status | None:
    """The status in a message; None if it is damaged, or of another version."""
    if len(data) > LARGEST_BYTES:
        return None
    try:
        told = json.loads(data)
        return _status(told) if told["version"] == VERSION else None
    except (ValueError, TypeError, KeyError, LookupError, AttributeError, OverflowError, RecursionError):
        return None


def control_of(told: Any) -> Control:
    """What applies to a group, from a status or an answer."""
    requests = told["requests"] or {}  # an old daemon takes none
    bounds = requests.get("bounds")
    return Control(
        str(told["policy"]),
        requests.get("locked") is not None,
        float(requests.get("ev_stops", 0.0)),
        int(requests.get("taken", 0)),
        None if bounds is None else Bounds(**{name: float(bounds[name]) for name in Bounds.__annotations__}),
    )


def _status(told: Any) -> Status:
    cameras = {_name(name): _camera(camera) for name, camera in told["cameras"].items()}
    if not 0 < len(cameras) <= MOST_CAMERAS:
        raise ValueError(f"{len(cameras)} cameras")
    groups = {
        _name(name): Group(*_parts(control_of(group)), tuple(map(_name, group["cameras"])))
        for name, group in told.get("groups", {}).items()
    }
    decision = told.get("decision")
    return Status(
        str(told["rig"]),
        str(told["state"]),
        tuple(map(str, told["reasons"])),
        cameras,
        groups or {_ONE_GROUP: Group(*_parts(control_of(told)), tuple(cameras))},
        float(told["rate_hz"]),
        {str(name): int(count) for name, count in told["counts"].items()},
        {str(name): int(count) for name, count in told["lost"].items()},
        None if decision is None else (float(decision["saturated_share"]), float(decision["black_share"])),
        _number(told.get("frame_to_node_ms", {}).get("p99_ms")),
    )


def _parts(control: Control) -> tuple[Any, ...]:
    return tuple(getattr(control, field.name) for field in fields(control))


def _camera(told: Any) -> Camera:
    applied, pose, region = told["applied"], told.get("pose"), told.get("region")
    return Camera(
        _text(told["camera"]),
        None if applied is None else (float(applied["exposure_time_us"]), float(applied["gain_db"])),
        _text(told["misfit"]),
        _number(told.get("temperature_c")),
        _number(told.get("link_mbps")),
        int(told.get("frames", 0)),
        int(told.get("lost", 0)),
        None if pose is None else _pose(pose),
        None if region is None else tuple(tuple(map(int, box)) for box in region),
    )


def _pose(told: Any) -> Pose:
    x, y, z = map(float, told["translation_m"])
    qx, qy, qz, qw = map(float, told["rotation_xyzw"])
    return Pose(_name(told["of"]), (x, y, z), (qx, qy, qz, qw))


def _name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError("no name of a camera or a group")
    return name


def _text(value: Any) -> str | None:
    return None if value is None else str(value)


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
