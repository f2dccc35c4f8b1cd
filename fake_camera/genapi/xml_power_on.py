"""Power-on state of a camera known only by its description: features available, within limits, at usual values."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from fake_camera.genapi.description import NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.formula import Number
from fake_camera.genapi.solve import Wish, achieve, assign, fill
from fake_camera.imaging import PIXEL_FORMATS

TIME_UNITS_US = {"s": 1e6, "ms": 1e3, "ns": 1e-3}
"""Microseconds per unit of time, by the names in descriptions; any other name, or none, means microseconds."""
EXPOSURE_TIMES = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
TIME_BASE = "ExposureTimeBaseAbs"
"""Microseconds in a count of ExposureTimeRaw."""
GAINS = ("Gain", "GainAbs", "GainRaw")
FRAME_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
FRAME_RATE_SWITCHES = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
GAMMA_SWITCHES = ("GammaEnable", "GammaEnabled")
"""Names that vendors give these features, those in physical units first."""
CHUNK_CONTENTS = {
    "ExposureTime": "ExposureTime", "Gain": "Gain", "GainAll": "Gain", "FrameID": "FrameID", "FrameCounter": "FrameID",
    "Framecounter": "FrameID", "Timestamp": "Timestamp",
}  # fmt: skip
"""What simulated chunks contain, by the vendors' names for the entries of ChunkSelector."""
LIVE_COMMANDS = ("AcquisitionStart", "AcquisitionStop", "TimestampLatch", "TriggerSoftware")
LOCKED = "TLParamsLocked"


class Wished(NamedTuple):
    """Limits, increment and value of a number at power-on, where the description leaves them to registers."""

    low: float
    high: float
    step: float
    value: float

    def over(self, unit: float) -> Wished:
        """The same, counted in units of `unit`."""
        return Wished(*(number / unit for number in self))


_EXPOSURE_US = Wished(10.0, 1e6, 1.0, 5000.0)
_TIME_BASE_US = Wished(1.0, 100.0, 1.0, 10.0)
_GAIN_DB = Wished(0.0, 36.0, 0.01, 0.0)
_RAW_GAIN = Wished(0, 240, 1, 0)
_RATE_HZ = Wished(1.0, 200.0, 0.01, 30.0)
_GAMMA = Wished(0.25, 4.0, 0.01, 0.8)
_PACKET_BYTES = Wished(220, 9000, 4, 9000)
_FILLINGS = (0, 1, 10, 1_000_000)
"""What empty registers are filled with on trial, since formulas may divide by them: counts, a time base (us)."""
_CONDITIONS = (("pIsImplemented", True), ("pIsAvailable", True), ("pIsLocked", False))
_LIMITS = ("pMin", "pMax", "pInc")
_NUMBERS = ("Integer", "Float", "IntReg", "MaskedIntReg", "FloatReg", "Converter", "IntConverter")


class PowerOn:
    """Sets the registers of one camera through its `evaluator`.

    Attributes
    ----------
    failed
        Features that could not be made available.
    """

    def __init__(self, evaluator: Evaluator, sensor_width: int, sensor_height: int) -> None:
        self._evaluator = evaluator
        self._selection: tuple[str, int] | None = None
        self._kept: dict[int, list[Wish]] = {}
        self.failed: list[str] = []
        self._image(sensor_width, sensor_height)
        self._exposure()
        with self._selecting("GainSelector", "All"):
            self._gain()
        with self._selecting("TriggerSelector", frame_trigger(evaluator)):
            self._trigger()
            self._command("TriggerSoftware")
        self._chunks()
        with self._at(LOCKED, 1):  # clients lock the transport parameters before they start
            self._command("AcquisitionStart")
            self._command("AcquisitionStop")
        self._command("TimestampLatch")
        self._switch("PtpEnable", False)
        for name in ("PayloadSize", "TimestampLatchValue"):
            self._open(name, writable=False)

    def _image(self, width: int, height: int) -> None:
        for axis, size in (("Width", width), ("Height", height)):
            for name in (f"Sensor{axis}", f"{axis}Max"):
                self._number(name, Wished(8, size, 1, size), writable=False)
        for name, size, step in (("Width", width, 4), ("Height", height, 2)):
            self._number(name, Wished(8, size, step, size))
        for name in ("OffsetX", "OffsetY"):
            self._open(name)
        self._choice("PixelFormat", tuple(PIXEL_FORMATS))
        self._number("GevSCPSPacketSize", _PACKET_BYTES)

    def _exposure(self) -> None:
        self._choice("ExposureMode", ("Timed",))
        self._choice("ExposureAuto", ("Off", "Continuous"))
        self._number(TIME_BASE, _TIME_BASE_US)
        for name in spoken(self._evaluator, EXPOSURE_TIMES):
            self._number(name, _EXPOSURE_US.over(time_unit_us(self._evaluator, name)))
        for name in FRAME_RATE_SWITCHES:
            self._switch(name, True)
        for name in spoken(self._evaluator, FRAME_RATES):
            self._number(name, _RATE_HZ)
        self._choice("AcquisitionMode", ("Continuous",))
        for name in GAMMA_SWITCHES:
            self._switch(name, False)
        self._number("Gamma", _GAMMA)

    def _gain(self) -> None:
        self._choice("GainAuto", ("Off", "Continuous"))
        for name in spoken(self._evaluator, GAINS):
            self._number(name, _GAIN_DB if in_db(self._evaluator, name) else _RAW_GAIN)

    def _trigger(self) -> None:
        self._choice("TriggerMode", ("Off", "On"))
        lines = trigger_lines(self._evaluator)
        actions = action_signals(self._evaluator)
        self._choice("TriggerSource", (*lines, "Software", "Freerun", "FixedRate", *actions))
        self._choice("TriggerActivation", ("RisingEdge",))
        self._choice("TriggerOverlap", ("Off", "ReadOut"))

    def _chunks(self) -> None:
        self._switch("ChunkModeActive", True)  # some selectors exist only while chunks are on
        if self._evaluator.kind("ChunkSelector") == "Enumeration":
            for entry in CHUNK_CONTENTS:
                with self._selecting("ChunkSelector", entry) as offered:
                    if offered:
                        self._switch("ChunkEnable", False)
        if self._evaluator.kind("ChunkModeActive"):
            assign(self._evaluator, "ChunkModeActive", 0)

    @contextlib.contextmanager
    def _selecting(self, selector: str, entry: str) -> Iterator[bool]:
        """Within the block the selector is at this entry; yields whether it has that entry."""
        if self._evaluator.kind(selector) != "Enumeration" or entry not in self._evaluator.node(selector).entries:
            yield False
            return
        self._choice(selector, (entry,))
        with self._at(selector, self._evaluator.node(selector).entries[entry].integer("Value", 0)):
            yield True

    @contextlib.contextmanager
    def _at(self, name: str, value: int) -> Iterator[None]:
        """Within the block conditions must hold while the client has set `name` to `value`."""
        if self._evaluator.kind(name) is None:
            yield
            return
        self._selection = (name, value)
        with self._evaluator.selecting(name, value):
            yield
        self._selection = None

    def _number(self, name: str, wished: Wished, writable: bool = True) -> None:
        """Open a number, set its limits where they are in registers, and its value within the limits it then has."""
        evaluator = self._evaluator
        if evaluator.kind(name) not in _NUMBERS or not self._open(name, writable):
            return
        parts = [name, *(node.text(tag) for node in evaluator.chain(name) for tag in _LIMITS if node.text(tag))]
        empty: list[str] = []
        for filling in _FILLINGS:
            for register in empty:
                evaluator.set(register, filling)
            empty += [register for register in fill(evaluator, parts, filling) if register not in empty]
            with contextlib.suppress(NodeError):
                self._limit(name, wished, filling)
                low, high = limits(evaluator, name)
                value = min(max(wished.value, low), high)
                assign(evaluator, name, value)
                taken = abs(evaluator.value(name) - value) <= 0.01 * abs(value)
                if low < high and taken and (value == wished.value or not filling):
                    return
        for register in empty:
            evaluator.set(register, 0)
        if writable:
            self.failed.append(name)

    def _limit(self, name: str, wished: Wished, filling: int) -> None:
        """Set the limits and increments that are in registers."""
        evaluator = self._evaluator
        holder, one = evaluator.bounded(name, wished.low)
        low, high = sorted((one, evaluator.bounded(name, wished.high)[1]))  # a decreasing converter swaps them
        step = max(evaluator.bounded(name, wished.step)[1], 1e-3)
        for tag, value in (("pInc", step), ("pMin", low), ("pMax", high)):
            limit = evaluator.node(holder).text(tag)
            if limit and any(evaluator.value(register) in (0, filling) for register in evaluator.fields(limit)):
                assign(evaluator, limit, value)

    def _command(self, name: str) -> None:
        if self._evaluator.kind(name) == "Command":
            self._open(name)

    def _switch(self, name: str, on: bool) -> None:
        if self._evaluator.kind(name) and self._open(name):
            assign(self._evaluator, name, int(on))

    def _choice(self, name: str, entries: Sequence[str]) -> None:
        """Open an enumeration and those of `entries` that it has, and choose the first of them."""
        if self._evaluator.kind(name) != "Enumeration" or not self._open(name):
            return
        there = {entry: node for entry, node in self._evaluator.node(name).entries.items() if entry in entries}
        for entry, node in there.items():
            for tag, wanted in _CONDITIONS:
                if node.text(tag):
                    self._fulfil(f"{name} {entry}", node.text(tag), wanted)
        for entry in entries:
            if entry in there:
                assign(self._evaluator, name, there[entry].integer("Value", 0))
                return

    def _open(self, name: str, writable: bool = True) -> bool:
        """Make a node, and those it depends on, implemented, available and not locked; False if it has no value."""
        evaluator = self._evaluator
        if evaluator.kind(name) is None:
            return False
        try:
            nodes = list(evaluator.chain(name))
            for limit in _LIMITS:
                nodes += [
                    part for node in tuple(nodes) if node.text(limit) for part in evaluator.chain(node.text(limit))
                ]
        except NodeError:  # a node is missing in the description
            self.failed.append(name)
            return False
        for node in nodes:
            for tag, wanted in _CONDITIONS[: 3 if writable else 2]:
                if node.text(tag):
                    self._fulfil(name, node.text(tag), wanted)
        return True

    def _fulfil(self, name: str, condition: str, wanted: bool) -> None:
        """Find register contents that make a condition true, and keep it true."""
        evaluator, selection = self._evaluator, self._selection

        def wish() -> bool:
            with contextlib.nullcontext() if selection is None else evaluator.selecting(*selection):
                return bool(evaluator.value(condition)) == wanted

        if not achieve(evaluator, wish, condition, self._kept):
            self.failed.append(name)
            return
        for field in evaluator.fields(condition).values():
            self._kept.setdefault(field.address, []).append(wish)


def spoken(evaluator: Evaluator, names: Sequence[str]) -> tuple[str, ...]:
    """Those of `names` that drive this camera; a raw one only if there is no other."""
    there = tuple(name for name in names if evaluator.kind(name) in _NUMBERS)
    return tuple(name for name in there if not name.endswith("Raw")) or there


def in_db(evaluator: Evaluator, name: str) -> bool:
    """Whether the unit of a gain is dB."""
    return evaluator.node(name).text("Unit").lower() == "db"


def time_unit_us(evaluator: Evaluator, name: str) -> float:
    """Microseconds per unit of a time; of a count, where there is a time base."""
    if name == "ExposureTimeRaw" and evaluator.kind(TIME_BASE) in _NUMBERS:
        with contextlib.suppress(NodeError):
            return evaluator.value(TIME_BASE) or 1.0
    return TIME_UNITS_US.get(evaluator.node(name).text("Unit"), 1.0)


def limits(evaluator: Evaluator, name: str) -> tuple[Number, Number]:
    """Lowest and highest value of a number; infinite where not declared."""
    low, high = evaluator.bound(name, "Min"), evaluator.bound(name, "Max")
    if low is not None and high is not None:
        return min(low, high), max(low, high)  # a decreasing converter swaps them
    return float("-inf") if low is None else low, float("inf") if high is None else high


def frame_trigger(evaluator: Evaluator) -> str:
    """The entry of TriggerSelector whose trigger starts a frame: FrameStart, or its older name."""
    entries = evaluator.node("TriggerSelector").entries if evaluator.kind("TriggerSelector") == "Enumeration" else {}
    return "ExposureStart" if "ExposureStart" in entries and "FrameStart" not in entries else "FrameStart"


def trigger_lines(evaluator: Evaluator) -> tuple[str, ...]:
    """The external lines among the trigger sources; the wire is plugged into the first."""
    return _sources(evaluator, ("Line", "Input"))


def action_signals(evaluator: Evaluator) -> tuple[str, ...]:
    """The action signals among the trigger sources; action commands raise the first."""
    return _sources(evaluator, ("Action",))


def _sources(evaluator: Evaluator, beginnings: tuple[str, ...]) -> tuple[str, ...]:
    if evaluator.kind("TriggerSource") != "Enumeration":
        return ()
    return tuple(entry for entry in evaluator.node("TriggerSource").entries if entry.startswith(beginnings))
