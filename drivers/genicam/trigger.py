"""Arming the trigger: a line or a command that starts each exposure, or the camera's own clock."""

from __future__ import annotations

import re

from drivers.config.setup import ACTION_KEYS, TriggerSetup
from drivers.errors import ConfigurationError, UnsupportedCameraError
from drivers.genicam.nodes import NodeMap
from drivers.genicam.quantity import find_quantity

RATE_NODES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
RATE_SWITCHES = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
FRAME_TRIGGERS = ("FrameStart", "ExposureStart")
"""The trigger that starts a frame, by the names of its selector's entry; the second is older."""
FIXED_RATE = "FixedRate"
"""Allied Vision's GigE cameras run at their frame rate by this trigger source; with triggers off, at full speed."""
SOFTWARE = "Software"
"""The trigger source of `SOFTWARE_TRIGGER`."""
SOFTWARE_TRIGGER = "TriggerSoftware"
ACTION = "Action1"
"""The trigger source that action commands drive; on some cameras another number."""
_ACTION = re.compile(r"Action(\d+)")
PTP_SWITCHES = ("PtpEnable", "GevIEEE1588")
"""What synchronises the camera's clock, by its SFNC name and that of older descriptions."""
ACTION_QUEUE = "ActionQueueSize"
ACTION_NODES = ("ActionDeviceKey", "ActionGroupKey", "ActionGroupMask")


def arm_trigger(nodes: NodeMap, setup: TriggerSetup) -> tuple[str, ...]:
    """Set the camera's trigger up as `setup` says, and return its limitations, in words.

    Raises
    ------
    ConfigurationError
        When the camera has no such line, or cannot run at that rate.
    UnsupportedCameraError
        When it has no such trigger, or no frame rate to set.
    """
    if "Continuous" in nodes.entries("AcquisitionMode"):
        nodes.write_entry("AcquisitionMode", "Continuous")
    _switch_triggers_off(nodes)
    if setup.mode == "free_run":
        _set_frame_rate(nodes, setup.rate_hz)
        if setup.output_line is not None:
            _drive_line(nodes, setup.output_line)
            return ()
        return () if _lines(nodes) else ("no hardware trigger line: it can only run freely",)
    _check_frame_trigger(nodes)
    match setup.mode:
        case "software":
            return _arm_software(nodes)
        case "ptp":
            return _arm_action(nodes)
        case _:
            return _arm_line(nodes, setup.line)


def _switch_triggers_off(nodes: NodeMap) -> None:
    """Switch off every trigger: one left on elsewhere (AcquisitionStart, LineStart) would starve that of the frames."""
    for selector in nodes.entries("TriggerSelector"):
        nodes.write_entry("TriggerSelector", selector)
        if "Off" in nodes.entries("TriggerMode"):  # some list selectors whose trigger has no mode
            nodes.write_entry("TriggerMode", "Off")
    frame_trigger = _frame_trigger(nodes)
    if frame_trigger is not None:
        nodes.write_entry("TriggerSelector", frame_trigger)


def _frame_trigger(nodes: NodeMap) -> str | None:
    return next((name for name in FRAME_TRIGGERS if name in nodes.entries("TriggerSelector")), None)


def _lines(nodes: NodeMap) -> tuple[str, ...]:
    return tuple(entry for entry in nodes.entries("TriggerSource") if entry.startswith(("Line", "Input")))


def _check_frame_trigger(nodes: NodeMap) -> None:
    selectors = nodes.entries("TriggerSelector")
    if selectors and _frame_trigger(nodes) is None:
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: no {' or '.join(FRAME_TRIGGERS)} trigger; its TriggerSelector offers "
            f"{', '.join(selectors)}"
        )


def _arm_line(nodes: NodeMap, line: str) -> tuple[str, ...]:
    if line not in nodes.entries("TriggerSource"):
        if not _lines(nodes):
            free = find_quantity(nodes, RATE_NODES) is not None
            advice = "; run it with trigger mode free_run" if free else f", and no {RATE_NODES[0]} to run freely at"
            raise UnsupportedCameraError(f"camera {nodes.serial}: no hardware trigger line{advice}")
        raise ConfigurationError(
            f"camera {nodes.serial}: no trigger line {line!r}; it has {', '.join(_lines(nodes))} (trigger line)"
        )
    return _arm(nodes, line, edge="RisingEdge")


def _arm_software(nodes: NodeMap) -> tuple[str, ...]:
    if SOFTWARE not in nodes.entries("TriggerSource") or not nodes.exists(SOFTWARE_TRIGGER):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: no software trigger (TriggerSource {SOFTWARE}, {SOFTWARE_TRIGGER}): choose "
            "another trigger.mode"
        )
    return _arm(nodes, SOFTWARE)


def _arm_action(nodes: NodeMap) -> tuple[str, ...]:
    source = next(filter(None, map(_ACTION.fullmatch, nodes.entries("TriggerSource"))), None)
    missing = [name for name in ACTION_NODES if not nodes.available(name)]
    if source is None or missing:
        lacks = f"no {missing[0]}" if missing else f"no TriggerSource {ACTION}"
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has {lacks}, and so takes no action commands: choose another trigger.mode"
        )
    if nodes.kind("ActionSelector") == "integer" and nodes.writable("ActionSelector"):
        nodes.write_integer("ActionSelector", int(source[1]))
    elif source[0] in nodes.entries("ActionSelector") and nodes.writable("ActionSelector"):
        nodes.write_entry("ActionSelector", source[0])
    keys = ACTION_KEYS
    for name, value in zip(ACTION_NODES, (keys.device, keys.group, keys.mask), strict=True):
        nodes.write_integer(name, value)
    return _arm(nodes, source[0])


def action_queue(nodes: NodeMap) -> int:
    """How many scheduled action commands the camera keeps; 1 if it does not say."""
    return max(nodes.read_integer(ACTION_QUEUE), 1) if nodes.is_integer(ACTION_QUEUE) else 1


def _arm(nodes: NodeMap, source: str, edge: str | None = None) -> tuple[str, ...]:
    _limit_rate(nodes, False)  # some cameras cap triggered frames by it, too
    nodes.write_entry("TriggerSource", source)
    if edge in nodes.entries("TriggerActivation"):
        nodes.write_entry("TriggerActivation", edge)
    overlaps = "ReadOut" in nodes.entries("TriggerOverlap")
    if overlaps:
        nodes.write_entry("TriggerOverlap", "ReadOut")
    nodes.write_entry("TriggerMode", "On")
    if overlaps:
        return ()
    return ("no TriggerOverlap ReadOut: exposure and readout together must fit into a trigger period",)


def _drive_line(nodes: NodeMap, line: str) -> None:
    """Have an output line signal when the camera exposes."""
    lines = nodes.entries("LineSelector")
    if line not in lines:
        has = f"it has {', '.join(lines)}" if lines else "it has no LineSelector"
        raise ConfigurationError(f"camera {nodes.serial}: no output line {line!r}; {has} (trigger output_line)")
    nodes.write_entry("LineSelector", line)
    if "Output" in nodes.entries("LineMode") and nodes.read_entry("LineMode") != "Output":
        nodes.write_entry("LineMode", "Output")
    if "ExposureActive" not in nodes.entries("LineSource"):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: {line} cannot signal when it exposes (no LineSource ExposureActive): choose an "
            "output line (trigger output_line), or trigger both cameras from outside"
        )
    nodes.write_entry("LineSource", "ExposureActive")


def _limit_rate(nodes: NodeMap, limit: bool) -> None:
    for name in RATE_SWITCHES:
        if nodes.available(name):
            nodes.write_boolean(name, limit)


def _set_frame_rate(nodes: NodeMap, rate_hz: float | None) -> None:
    if "Off" in nodes.entries("AcquisitionFrameRateAuto"):
        nodes.write_entry("AcquisitionFrameRateAuto", "Off")
    _limit_rate(nodes, rate_hz is not None)
    if rate_hz is None:
        return
    if FIXED_RATE in nodes.entries("TriggerSource"):
        nodes.write_entry("TriggerSource", FIXED_RATE)
        nodes.write_entry("TriggerMode", "On")
    rate = find_quantity(nodes, RATE_NODES)
    if rate is None:
        raise UnsupportedCameraError(f"camera {nodes.serial}: no {RATE_NODES[0]} to set for a free run")
    low, high = rate.bounds(nodes)
    if not low <= rate_hz <= high:
        raise ConfigurationError(
            f"camera {nodes.serial}: it cannot run at {rate_hz:g} Hz, only at {low:g} to {high:g} Hz (trigger rate_hz)"
        )
    rate.write(nodes, rate_hz)
    if rate.integer and rate.read(nodes) != rate_hz:
        raise ConfigurationError(
            f"camera {nodes.serial}: it runs at whole numbers of Hz, such as {rate.read(nodes):g}, but not at "
            f"{rate_hz:g} Hz (trigger rate_hz)"
        )
