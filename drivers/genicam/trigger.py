"""Arming the trigger, which must leave time for exposure and readout, and the clock that scheduled triggers go by."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from drivers.camera import PtpState
from drivers.genicam.nodes import NodeMap, Quantity, hold, is_number, offered, switch
from drivers.setup import ACTION_KEYS, TriggerSetup
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError

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


@dataclass(frozen=True, slots=True)
class TriggerSources:
    """What can start a frame of a camera; None for `lines`: it shows its sources only while a trigger is on."""

    lines: tuple[str, ...] | None
    software: bool
    ptp: bool


def trigger_sources(nodes: NodeMap) -> TriggerSources:
    """What can start a frame, as far as the camera shows it without being set up."""
    sources = offered(nodes, "TriggerSource")
    clock = any(nodes.available(name) for name in PTP_SWITCHES)
    return TriggerSources(
        lines=None if _hides_sources(nodes) else _lines(nodes),
        software=SOFTWARE in sources and nodes.exists(SOFTWARE_TRIGGER),
        ptp=clock and any(map(_ACTION.fullmatch, sources)),
    )


def arm_trigger(nodes: NodeMap, setup: TriggerSetup) -> tuple[str, ...]:
    """Set the camera's trigger up as `setup` says, and return its limitations, in words.

    Raises ConfigurationError when the camera has no such line, or cannot run at that rate; UnsupportedCameraError when
    it has no such trigger, or no frame rate to set; NodeError when what is needed cannot be written, and is not as it
    should be.
    """
    if "Continuous" in nodes.entries("AcquisitionMode"):
        hold(nodes, "AcquisitionMode", "Continuous")
    _switch_triggers_off(nodes)
    if setup.mode == "free_run":
        of_rate = _set_frame_rate(nodes, setup.rate_hz)
        if setup.output_line is not None:
            _drive_line(nodes, setup.output_line)
            return of_rate
        if _lines(nodes) or _hides_sources(nodes):
            return of_rate
        return (*of_rate, "no hardware trigger line: it can only run freely")
    _check_frame_trigger(nodes)
    if _hides_sources(nodes):
        _switch_mode(nodes, True)
    match setup.mode:
        case "software":
            return _arm_software(nodes)
        case "ptp":
            return _arm_action(nodes)
        case _:
            return _arm_line(nodes, setup.line)


def _switch_triggers_off(nodes: NodeMap) -> None:
    """Switch off every trigger: one left on elsewhere (AcquisitionStart, LineStart) would starve that of the frames."""
    for selector in offered(nodes, "TriggerSelector"):
        hold(nodes, "TriggerSelector", selector)
        _switch_mode(nodes, False)
    frame_trigger = _frame_trigger(nodes)
    if frame_trigger is not None:
        hold(nodes, "TriggerSelector", frame_trigger)
    _switch_mode(nodes, False)  # without a selector, too


def _switch_mode(nodes: NodeMap, on: bool) -> None:
    """Switch the selected trigger, if it has a mode: some list selectors whose trigger has none."""
    if nodes.entries("TriggerMode") or nodes.kind("TriggerMode") in ("boolean", "integer"):
        switch(nodes, "TriggerMode", on)


def _frame_trigger(nodes: NodeMap) -> str | None:
    return next((name for name in FRAME_TRIGGERS if name in offered(nodes, "TriggerSelector")), None)


def _lines(nodes: NodeMap) -> tuple[str, ...]:
    return tuple(entry for entry in offered(nodes, "TriggerSource") if entry.startswith(("Line", "Input")))


def _hides_sources(nodes: NodeMap) -> bool:
    """Whether the sources of a trigger exist only while it is on."""
    return nodes.exists("TriggerSource") and not nodes.available("TriggerSource")


def _check_frame_trigger(nodes: NodeMap) -> None:
    selectors = offered(nodes, "TriggerSelector")
    if selectors and _frame_trigger(nodes) is None:
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: no {' or '.join(FRAME_TRIGGERS)} trigger; its TriggerSelector offers "
            f"{', '.join(selectors)}"
        )


def _arm_line(nodes: NodeMap, line: str) -> tuple[str, ...]:
    if line not in offered(nodes, "TriggerSource"):
        if not _lines(nodes):
            advice = (
                "; run it with trigger mode free_run"
                if _rate(nodes) is not None
                else f", and no {RATE_NODES[0]} to run freely at"
            )
            raise UnsupportedCameraError(f"camera {nodes.serial}: no hardware trigger line{advice}")
        raise ConfigurationError(
            f"camera {nodes.serial}: no trigger line {line!r}; it has {', '.join(_lines(nodes))} (trigger line)"
        )
    return _arm(nodes, line, edge="RisingEdge")


def _arm_software(nodes: NodeMap) -> tuple[str, ...]:
    if SOFTWARE not in offered(nodes, "TriggerSource") or not nodes.exists(SOFTWARE_TRIGGER):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: no software trigger (TriggerSource {SOFTWARE}, {SOFTWARE_TRIGGER}): choose "
            "another trigger.mode"
        )
    return _arm(nodes, SOFTWARE)


def _arm_action(nodes: NodeMap) -> tuple[str, ...]:
    source = next(filter(None, map(_ACTION.fullmatch, offered(nodes, "TriggerSource"))), None)
    missing = [name for name in ACTION_NODES if not nodes.available(name)]
    if source is None or missing:
        lacks = f"no {missing[0]}" if missing else f"no TriggerSource {ACTION}"
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has {lacks}, and so takes no action commands: choose another trigger.mode"
        )
    if is_number(nodes, "ActionSelector", "integer") and nodes.writable("ActionSelector"):
        hold(nodes, "ActionSelector", int(source[1]))
    elif source[0] in offered(nodes, "ActionSelector"):
        hold(nodes, "ActionSelector", source[0])
    keys = ACTION_KEYS
    for name, value in zip(ACTION_NODES, (keys.device, keys.group, keys.mask), strict=True):
        hold(nodes, name, value)
    return _arm(nodes, source[0])


def action_queue(nodes: NodeMap) -> int:
    """How many scheduled action commands the camera keeps; 1 if it does not say."""
    return max(int(nodes.read(ACTION_QUEUE)), 1) if is_number(nodes, ACTION_QUEUE, "integer") else 1


def _arm(nodes: NodeMap, source: str, edge: str | None = None) -> tuple[str, ...]:
    limitations = _limit_rate(nodes, False)  # some cameras cap triggered frames by it, too
    hold(nodes, "TriggerSource", source)
    _take_pulses(nodes, edge)  # some cameras lock these nodes while the trigger is on,
    _switch_mode(nodes, True)
    return *limitations, *_take_pulses(nodes, edge)  # others have them only then


def _take_pulses(nodes: NodeMap, edge: str | None) -> tuple[str, ...]:
    """Choose the edge of a pulse that triggers, and take pulses during readout; returns what the camera does not."""
    limitations = []
    edges = offered(nodes, "TriggerActivation") if edge is not None else ()
    if edge in edges:
        hold(nodes, "TriggerActivation", edge)
    elif edges:
        limitations.append(f"no TriggerActivation {edge}: it is triggered by {nodes.read('TriggerActivation')}")
    if "ReadOut" in offered(nodes, "TriggerOverlap"):
        hold(nodes, "TriggerOverlap", "ReadOut")
    else:
        limitations.append("no TriggerOverlap ReadOut: exposure and readout together must fit into a trigger period")
    return tuple(limitations)


def _drive_line(nodes: NodeMap, line: str) -> None:
    """Have an output line signal when the camera exposes."""
    lines = offered(nodes, "LineSelector")
    if line not in lines:
        has = f"it has {', '.join(lines)}" if lines else "it has no LineSelector"
        raise ConfigurationError(f"camera {nodes.serial}: no output line {line!r}; {has} (trigger output_line)")
    hold(nodes, "LineSelector", line)
    if "Output" in nodes.entries("LineMode"):
        hold(nodes, "LineMode", "Output")
    if "ExposureActive" not in offered(nodes, "LineSource"):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: {line} cannot signal when it exposes (no LineSource ExposureActive): choose an "
            "output line (trigger output_line), or trigger all cameras from outside"
        )
    hold(nodes, "LineSource", "ExposureActive")


def _limit_rate(nodes: NodeMap, limit: bool) -> tuple[str, ...]:
    """Have the camera keep to its frame rate, or not; returns what it does not do, in words."""
    try:
        for name in RATE_SWITCHES:
            if nodes.available(name):
                switch(nodes, name, limit)
    except NodeError as error:
        return (f"its frame rate stays {'without' if limit else 'under'} a limit ({error})",)
    return ()


def _set_frame_rate(nodes: NodeMap, rate_hz: float | None) -> tuple[str, ...]:
    if "Off" in offered(nodes, "AcquisitionFrameRateAuto"):
        hold(nodes, "AcquisitionFrameRateAuto", "Off")
    limitations = _limit_rate(nodes, rate_hz is not None)
    if rate_hz is None:
        return limitations
    if FIXED_RATE in offered(nodes, "TriggerSource"):
        hold(nodes, "TriggerSource", FIXED_RATE)
        _switch_mode(nodes, True)
    rate = _rate(nodes)
    if rate is None:
        raise UnsupportedCameraError(f"camera {nodes.serial}: no {RATE_NODES[0]} to set for a free run")
    if not nodes.writable(rate.node):
        if not math.isclose(present_hz := rate.read(nodes), rate_hz, rel_tol=0.01):
            raise ConfigurationError(
                f"camera {nodes.serial}: its {rate.node} is {present_hz:g} Hz and cannot be written: set "
                "trigger.rate_hz to that"
            )
        return limitations
    low, high = rate.bounds(nodes)
    if not low <= rate_hz <= high:
        raise ConfigurationError(
            f"camera {nodes.serial}: it cannot run at {rate_hz:g} Hz, only at {low:g} to {high:g} Hz (trigger rate_hz)"
        )
    rate.write(nodes, rate_hz)
    if nodes.kind(rate.node) == "integer" and rate.read(nodes) != rate_hz:
        raise ConfigurationError(
            f"camera {nodes.serial}: it runs at whole numbers of Hz, such as {rate.read(nodes):g}, but not at "
            f"{rate_hz:g} Hz (trigger rate_hz)"
        )
    return limitations


def _rate(nodes: NodeMap) -> Quantity | None:
    return next((Quantity(name) for name in RATE_NODES if is_number(nodes, name)), None)


_READOUT_NODES = ("SensorReadoutTime", "ReadoutTimeAbs")
"""Readout time in us (Basler's names; other makers have no such node)."""


def timing_limitations(nodes: NodeMap, trigger: TriggerSetup) -> tuple[str, ...]:
    """Why the longest exposure and the readout do not fit, in words; empty if the camera reports no readout.

    The camera must have been armed: with TriggerOverlap ReadOut a frame is read out while the next one is exposed.
    """
    readout_us = next((float(nodes.read(name)) for name in _READOUT_NODES if is_number(nodes, name, "float")), None)
    if readout_us is None or trigger.rate_hz is None:
        return ()
    period_us = 1e6 / trigger.rate_hz
    overlaps = "ReadOut" in nodes.entries("TriggerOverlap") and nodes.read("TriggerOverlap") == "ReadOut"
    left_us = period_us if overlaps else period_us - readout_us
    if readout_us > period_us:
        return (
            f"a readout of {readout_us:.0f} us does not fit into a trigger period of {period_us:.0f} us: lower "
            "trigger.rate_hz, or choose binning or a smaller region",
        )
    if trigger.longest_exposure_us <= left_us:
        return ()
    return (
        f"an exposure of {trigger.longest_exposure_us:g} us and a readout of {readout_us:.0f} us do not fit into a "
        f"trigger period of {period_us:.0f} us: lower exposure.max_time_us to {left_us:.0f}, or trigger.rate_hz",
    )


_LATCH_NODES = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
_STATUS_NODES = ("PtpStatus", "GevIEEE1588StatusLatched", "GevIEEE1588Status")
_OFFSET_NODES = ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched", "GevIEEE1588OffsetFromMaster")
"""Each by its SFNC name, then by those of older descriptions."""


class PtpNodes:
    """The PTP clock of a camera, switched on.

    Raises UnsupportedCameraError at construction, when the camera has none, or one without a status.
    """

    def __init__(self, nodes: NodeMap) -> None:
        self._nodes = nodes
        switch(nodes, self._required(PTP_SWITCHES), True)
        self._status = self._required(_STATUS_NODES)
        self._latch = self._first(_LATCH_NODES)
        self._offset = self._first(_OFFSET_NODES)

    @property
    def limitations(self) -> tuple[str, ...]:
        """What it cannot do, in words."""
        if self._offset is None:
            return (f"no {_OFFSET_NODES[0]}: how far its clock is from its master's is not known",)
        return ()

    def read(self) -> PtpState:
        """How its clock is synchronised now."""
        if self._latch is not None:
            self._nodes.execute(self._latch)
        offset_ns = None if self._offset is None else int(self._nodes.read(self._offset))
        if offset_ns is not None and offset_ns >= 1 << 63:  # some descriptions forget its sign
            offset_ns -= 1 << 64
        return PtpState(str(self._nodes.read(self._status)), offset_ns)

    def _first(self, names: tuple[str, ...]) -> str | None:
        return next((name for name in names if self._nodes.available(name)), None)

    def _required(self, names: tuple[str, ...]) -> str:
        name = self._first(names)
        if name is None:
            raise UnsupportedCameraError(
                f"camera {self._nodes.serial}: it has no {' or '.join(names)}, and so no clock that PTP synchronises: "
                "choose another trigger.mode"
            )
        return name
