"""The parameters by which ROS 2 sets control: what they are, what they ask of the daemon, and what its status says."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from autoexpose_ros.status import Group, Status

Value = Any
"""Of a parameter: bool, float or str."""


@dataclass(frozen=True)
class Setting:
    """A parameter of a group of cameras, or of a camera."""

    name: str
    description: str
    low: float | None = None
    high: float | None = None


TIME_US, GAIN_DB = (0.1, 10_000_000.0), (-60.0, 100.0)
"""What the daemon takes; the cameras' own bounds are within these."""

OF_GROUP = (
    Setting("ev", "EV compensation: stops added to what the policy decides", -3.0, 3.0),
    Setting("lock", "whether the exposure stays as it is"),
    Setting("policy", "the policy that decides, such as belief or neves2009"),
    Setting("min_time_us", "shortest exposure time, us", *TIME_US),
    Setting("max_time_us", "longest exposure time, us", *TIME_US),
    Setting("min_gain_db", "lowest gain, dB", *GAIN_DB),
    Setting("max_gain_db", "highest gain, dB", *GAIN_DB),
)
_LIMITS = ("min_time_us", "max_time_us", "min_gain_db", "max_gain_db")

REGION = Setting(
    "region",
    "what counts in the picture: rectangles X,Y,WIDTH,HEIGHT with blanks between them; empty: all of it, or what "
    "weights or a mask of the configuration say",
)
"""Text, as an empty list has no type in ROS 2."""


def settings(status: Status) -> Iterator[tuple[str, Setting, Value]]:
    """The parameters that a rig has, each with its full name, and its value now; those not known yet are left out."""
    for group_name, group in status.groups.items():
        for setting in OF_GROUP:
            value = _value(setting.name, group)
            if value is not None:
                yield _full(group_name, setting.name, status.groups), setting, value
    for name, camera in status.cameras.items():
        boxes = camera.region or ()
        yield f"{name}.{REGION.name}", REGION, " ".join(",".join(map(str, box)) for box in boxes)


def requests(changes: Mapping[str, Value], status: Status) -> Iterator[dict[str, Any]]:
    """What parameters, by their full names, ask of control: one request for each group concerned.

    Raises ValueError, with a sentence, for what is no region.
    """
    several = len(status.groups) > 1
    for group_name, group in status.groups.items():
        asked = dict(_of_group(changes, group_name, status.groups))
        region = dict(_regions(changes, group.cameras))
        if region:
            asked["region"] = region
        if asked:
            yield {**asked, "group": group_name} if several else asked


def _of_group(changes: Mapping[str, Value], group: str, groups: Mapping[str, Group]) -> Iterator[tuple[str, Any]]:
    given = {
        setting.name: changes[full] for setting in OF_GROUP if (full := _full(group, setting.name, groups)) in changes
    }
    for name, key in (("ev", "ev_stops"), ("lock", "locked"), ("policy", "policy")):
        if name in given:
            yield key, given[name]
    if limits := {name: given[name] for name in _LIMITS if name in given}:
        yield "limits", limits


def _regions(changes: Mapping[str, Value], cameras: Iterable[str]) -> Iterator[tuple[str, Any]]:
    for camera in cameras:
        full = f"{camera}.{REGION.name}"
        if full not in changes:
            continue
        boxes = [_box(full, box) for box in changes[full].split()]
        yield camera, {"rectangles": [{"box": box} for box in boxes]}


def _box(name: str, text: str) -> list[int]:
    try:
        x, y, width, height = map(int, text.split(","))
    except ValueError:
        raise ValueError(f"{name}: {text} is no rectangle: give X,Y,WIDTH,HEIGHT, such as 0,0,720,270") from None
    return [x, y, width, height]


def _full(group: str, name: str, groups: Mapping[str, Group]) -> str:
    return f"{group}.{name}" if len(groups) > 1 else name


def _value(name: str, group: Group) -> Value:
    if name in _LIMITS:
        return None if group.bounds is None else getattr(group.bounds, name)
    return {"ev": group.ev_stops, "lock": group.locked, "policy": group.policy}[name]


def geometry_of(info: Any) -> dict[str, Any]:
    """A CameraInfo as control takes it."""
    numbers = {name: [float(number) for number in getattr(info, name)] for name in ("d", "k", "r", "p")}
    size = {"width": int(info.width), "height": int(info.height)}
    return {**size, "distortion_model": info.distortion_model, **numbers}
